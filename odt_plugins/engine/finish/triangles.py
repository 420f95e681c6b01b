"""What a phase of stage 2 does alike on planar and on curved meshes of triangles."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np

from odt_plugins.engine.cells.measures import cell_measures
from odt_plugins.engine.compiled.threads import pieces
from odt_plugins.engine.finish.phases import Phase
from odt_plugins.engine.moves.compound2d import excess_degrees
from odt_plugins.engine.topology.active import IDLE, PENDING
from odt_plugins.engine.topology.star import Stars, vertex_stars
from odt_plugins.engine.topology.triangles import Triangles
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.quantiles import quantile


class TriangleDescent(ABC):
    """Descent of triangles in one phase: flips start at pending triangles, then at changed ones.

    Parameters
    ----------
    mesh : Triangles    changed in place
    phase : Phase
    """

    def __init__(self, mesh: Triangles, phase: Phase) -> None:
        self.mesh, self.phase = mesh, phase
        self.points, self.cells = mesh.points, mesh.cells
        self.status = np.zeros(len(mesh.cells), dtype=np.uint8)

    def measures(self) -> FloatArray:
        """Measure of every triangle, (m,)."""
        m = np.empty(len(self.cells))
        for first, last in pieces(0, len(self.cells)):
            cell_measures(self.points, self.cells[first:last], self.phase.objective, m[first:last])
        return m

    @abstractmethod
    def flip_some(self, seeds: BoolArray, changed: BoolArray) -> int:
        """Flip from the seeds (m,) on; ``changed`` (m,) is set where a triangle was replaced."""

    @abstractmethod
    def compound_moves(self, tried: BoolArray, excess: FloatArray) -> Callable[[IntArray], int]:
        """What tries compound moves at some cells; parameters as of ``compound_pass_2d``."""

    def compound(self) -> int:
        """Try compound moves at the worst triangles; returns how many stayed."""
        phase = self.phase
        tried = np.zeros(len(self.cells), dtype=np.bool_)
        taken = 0
        for _ in range(phase.compound):
            measures = self.measures()
            most = math.ceil(phase.share * len(measures))
            count = min(most, max(most // 10, int((measures < phase.enough).sum())))
            order = np.argsort(measures, kind="stable")[:count].astype(np.int32)
            move_some = self.compound_moves(tried, excess_degrees(self.mesh))
            now = sum(
                int(move_some(order[first:last])) for first, last in pieces(0, count, costly=True)
            )
            taken += now
            if now == 0:
                break
        return taken

    def worst(self) -> BoolArray:
        """Make the worst triangles and those beside them pending; their vertices move first."""
        measures = self.measures()
        near = np.zeros(len(self.points), dtype=np.bool_)
        near[self.cells[measures <= quantile(measures, self.phase.share)]] = True
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
