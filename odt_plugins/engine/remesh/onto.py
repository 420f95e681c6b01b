"""Vertices of a resized surface onto the geometry that it was made of, unless cells fold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from odt_plugins.engine.cells.geometry import signed_volumes
from odt_plugins.engine.run.outcome import Outcome
from odt_plugins.errors import counted
from odt_plugins.mesh.simplex import Smooth

SHARES = (1.0, 0.5, 0.25, 0.0)
"""Parts of its way that a vertex goes whose cells fold, one after the other."""


def on_smooth(outcome: Outcome, smooth: Smooth) -> tuple[Outcome, tuple[str, ...]]:
    """Put vertices on the geometry, those of cells that would fold a part of the way.

    Parameters
    ----------
    outcome : Outcome     of positive tetrahedra
    smooth : Smooth

    Returns
    -------
    outcome : Outcome     of positive tetrahedra
    notes : tuple of str  what the report says of vertices that are not on the geometry
    """
    start, way = outcome.points, smooth.put(outcome) - outcome.points
    share = np.zeros(len(start), dtype=np.intp)
    for _ in range(len(SHARES) * len(start)):
        gone = np.array(SHARES)[share][:, None] * way
        # -0.0 of what stays would become 0.0
        points = np.where(gone != 0.0, start + gone, start)
        folded = np.unique(outcome.cells[~(signed_volumes(points, outcome.cells) > 0.0)])
        more = folded[share[folded] < len(SHARES) - 1]
        if not len(more):
            break
        share[more] += 1
    off = int(((share > 0) & (way != 0.0).any(axis=1)).sum())
    are = counted(off, "vertex of the surface is", "vertices of the surface are")
    notes = (f"{are} not on the geometry, since cells would fold there",) if off else ()
    return replace(outcome, points=points), notes
