"""What a phase of stage 2 does alike on planar and on curved meshes of triangles."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from odt_plugins.engine.finish.phases import Phase
from odt_plugins.engine.topology.active import IDLE, PENDING
from odt_plugins.engine.topology.star import Stars, vertex_stars
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray


class TriangleDescent(ABC):
    """Triangles under one phase: flips start from the pending ones and go on from what they change.

    Parameters
    ----------
    points : (n, d) float64, cells : (m, 3) int32    changed in place
    phase : Phase
    """

    def __init__(self, points: FloatArray, cells: IntArray, phase: Phase) -> None:
        self.points, self.cells, self.phase = points, cells, phase
        self.status = np.zeros(len(cells), dtype=np.uint8)

    @abstractmethod
    def measures(self) -> FloatArray:
        """Measure of every triangle, (m,)."""

    @abstractmethod
    def flip_some(self, seeds: BoolArray, changed: BoolArray) -> int:
        """Flip from the seeds (m,) on; ``changed`` (m,) is set where a triangle was replaced."""

    def worst(self) -> BoolArray:
        """Make the worst triangles and those beside them pending; their vertices move first."""
        measures = self.measures()
        near = np.zeros(len(self.points), dtype=np.bool_)
        near[self.cells[measures <= np.quantile(measures, self.phase.share)]] = True
        pending = near[self.cells].any(axis=1)
        self.status[pending] = PENDING
        active = np.zeros(len(self.points), dtype=np.bool_)
        active[self.cells[pending]] = True
        return active

    def flip(self, active: BoolArray) -> int:
        """Flip from the pending triangles on; the vertices of new triangles become active."""
        changed = np.zeros(len(self.cells), dtype=np.bool_)
        flips = self.flip_some(self.status == PENDING, changed)
        active[self.cells[changed]] = True
        self.status[:] = IDLE
        return flips

    def stars(self) -> Stars:
        """Stars of all vertices."""
        return vertex_stars(self.cells, len(self.points))

    def settled(self, flips: int, woke: int) -> bool:
        """Whether no triangle waits for a flip."""
        return not (self.status == PENDING).any()
