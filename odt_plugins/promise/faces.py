"""The promise of lines with labels, whose edges are others where a mesh was resized."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.mesh.components import components
from odt_plugins.mesh.faces import Faces, labels_at

Shape = tuple[int, int, int]
"""Components, Euler characteristic, and vertices that are not within a line."""


def broken_lines(before: Faces, after: Faces, cells: NDArray[np.integer]) -> list[str]:
    """Say of which lines what does not hold.

    Parameters
    ----------
    before, after : Faces      lines with labels
    cells : (m, d + 1) int     of which those after are to be edges

    Returns
    -------
    list of str                one sentence per broken promise
    """
    if not len(before.rows) and not len(after.rows):
        return []
    columns = list(combinations(range(cells.shape[1]), 2))
    edges: Any = np.unique(np.sort(cells[:, columns].reshape(-1, 2), axis=1), axis=0)
    lost = labels_at(after.rows, Faces(edges, np.zeros(len(edges), dtype=np.int32))) < 0
    broken = []
    if lost.any():
        broken.append(f"the line {after.rows[lost][0].tolist()} is no edge of a cell, "
                      f"{int(lost.sum())} in all")
    was, now = _shapes(before), _shapes(after)
    broken += [f"lines with label {label} have {now.get(label)} components, Euler characteristic "
               f"and ends; they had {was.get(label)}"
               for label in sorted(was.keys() | now.keys()) if was.get(label) != now.get(label)]
    return broken


def _shapes(lines: Faces) -> dict[int, Shape]:
    """What tells the lines of every label."""
    out = {}
    for label in np.unique(lines.labels).tolist():
        used, rows = np.unique(lines.rows[lines.labels == label], return_inverse=True)
        rows = rows.reshape(-1, 2)
        whole = int(components(rows[:, 0], rows[:, 1], len(used)).max()) + 1
        ends = int((np.bincount(rows.ravel()) != 2).sum())
        out[label] = whole, len(used) - len(rows), ends
    return out
