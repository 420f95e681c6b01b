"""What the engine hands back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.run.judge import Slid
from odt_plugins.figures import CellFigures, cell_figures
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.faces import Faces, no_faces
from odt_plugins.mesh.simplex import SimplexMesh


@dataclass(frozen=True)
class Outcome:
    """What the engine hands back.

    Attributes
    ----------
    points : (n, d) float64         same numbering as the input
    cells : (m', d + 1) int32       positively oriented
    regions : (m',) int32           exact region labels
    energy : list of (stage, E)     ODT energy after every round
    times : dict stage -> seconds   wall time
    stop_reason : str               one sentence
    fallback : str or None          why an earlier state is returned, when it is
    counts : dict name -> int       sweeps, flips, exchanges, refusals
    slid : Slid or None             how far the boundary moved, when it may slide and did
    sizes : (n',) float64 or None   values of a :class:`NodalDensity` where the vertices are now,
                                    None without one
    origin : (n',) int64 or None    input vertex of every vertex, -1 for the new ones at the end;
                                    None when the vertices are those of the input
    written : (n', D) or None       points in the caller's type and space, as they leave
    source : (m',) int32 or None    input cell of which every cell takes the data, as it leaves
    vetoed : dict or None           of a state with a better mean that was refused: the figures that
                                    were "worse", name -> (before, there), and its "mean_quality"
                                    and "min_quality"
    notes : tuple of str            what the report says besides
    faces : (Faces, Faces)          those that the faces of the input have become
    metric : (n', k) float64         of the metric where the vertices are now, see ``SimplexMesh``
    measured : tuple or None        points and cells whose :meth:`figures` are at hand, and those
    """

    points: FloatArray
    cells: IntArray
    regions: IntArray
    energy: list[tuple[str, float]] = field(default_factory=list)
    times: dict[str, float] = field(default_factory=dict)
    stop_reason: str = ""
    fallback: str | None = None
    counts: dict[str, int] = field(default_factory=dict)
    slid: Slid | None = None
    sizes: FloatArray | None = None
    origin: NDArray[np.int64] | None = None
    written: NDArray[Any] | None = None
    source: IntArray | None = None
    vetoed: dict[str, Any] | None = None
    notes: tuple[str, ...] = ()
    faces: tuple[Faces, Faces] = field(default_factory=no_faces)
    metric: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    measured: tuple[FloatArray, IntArray, CellFigures] | None = None

    def figures(self, threads: int = 1) -> CellFigures:
        """Measure every cell without a metric, once, also for outcomes with these very arrays."""
        known = self.measured
        if known is None or known[0] is not self.points or known[1] is not self.cells:
            known = self.points, self.cells, cell_figures(self.points, self.cells, threads)
            object.__setattr__(self, "measured", known)
        return known[2]


Leaving = Callable[[Outcome], Outcome]
"""What a mesh goes through before the caller has it: its points are rounded to the caller's type,
its cells sorted. The points of the new outcome are those that the caller will read."""


def as_it_is(outcome: Outcome) -> Outcome:
    """Let a mesh leave as the engine has it."""
    return outcome


def unchanged(mesh: SimplexMesh, reason: str) -> Outcome:
    """The input as the outcome."""
    return Outcome(mesh.points.copy(), mesh.cells.copy(), mesh.regions.copy(), stop_reason=reason,
                   faces=mesh.faces, metric=mesh.metric)
