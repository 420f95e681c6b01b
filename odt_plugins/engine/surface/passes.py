"""Passes over a surface: flips, moves, and what stage 2 does on it."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.finish.phases import Phase
from odt_plugins.engine.finish.triangles import TriangleDescent
from odt_plugins.engine.ground.build import resample_metric
from odt_plugins.engine.ground.newton import smooth_on_ground
from odt_plugins.engine.ground.position import Body
from odt_plugins.engine.ground.sheet import LOCKED, SMOOTH, Guards, Sheet, Work, make_work
from odt_plugins.engine.moves.compound2d import MOST_TOUCHED
from odt_plugins.engine.moves.flips2d import Rule
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.surface.compound import compound_pass
from odt_plugins.engine.surface.flips import flip_edges
from odt_plugins.engine.surface.odt import Target, move_vertices
from odt_plugins.engine.topology.coloring import run_chunks, vertex_coloring
from odt_plugins.engine.topology.star import Stars, vertex_stars
from odt_plugins.engine.topology.triangles import Triangles
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.chunks import Pool


@dataclass(frozen=True)
class Surface:
    """A surface on its ground, with all that the stages need to know of it.

    Attributes
    ----------
    sheet : Sheet, guards : Guards
    regions : (m,) int32                                 labels; no flip crosses their borders
    metric : (k, g) float64                              see ``ground.build.resample_metric``
    pool : Pool or None, threads : int     see :func:`run_chunks`
    """

    sheet: Sheet
    guards: Guards
    regions: IntArray
    metric: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    pool: Pool | None = None
    threads: int = 1

    @property
    def points(self) -> FloatArray:
        """Present coordinates (n, 3), followed by the metric if there is one."""
        return self.sheet.points

    @property
    def triangles(self) -> IntArray:
        """Triangles (m, 3), as they are now."""
        return self.sheet.triangles

    def mesh_arrays(self) -> tuple[IntArray, IntArray]:
        """Triangles and their labels, as they are now; copies."""
        return self.sheet.triangles.copy(), self.regions.copy()

    def copy(self) -> tuple[NDArray[Any], ...]:
        """All that a move of vertices changes."""
        return tuple(a.copy() for a in self._moving())

    def restore(self, copy: tuple[NDArray[Any], ...]) -> None:
        """Go back to where :meth:`copy` was called; there must have been no flip since."""
        for now, before in zip(self._moving(), copy, strict=True):
            now[:] = before

    def twin(self) -> Surface:
        """The same surface, for flips and moves of its own."""
        guards = self.guards._replace(lines=deepcopy(self.guards.lines))
        return replace(self, sheet=deepcopy(self.sheet), guards=guards)

    def _moving(self) -> tuple[NDArray[Any], ...]:
        sheet = self.sheet
        return sheet.points, sheet.foot, sheet.first, sheet.following, self.guards.lines.place

    def resample(self) -> None:
        """Let every vertex have the metric of the place where it is."""
        resample_metric(self.guards.ground, self.metric, self.sheet.points, self.sheet.foot)

    def stars(self) -> Stars:
        """Triangles around every vertex, as they are now."""
        return vertex_stars(self.sheet.triangles, len(self.sheet.points))

    def body(self, stars: Stars) -> Body:
        """The surface as what its moves lower the cost of."""
        return Body(self.sheet.triangles, stars, np.zeros((0, 2)))

    def room(self, stars: Stars) -> Work:
        """Room for the star of any vertex."""
        return make_work(self.guards.ground, stars.largest())


def flip_all(
    surface: Surface, cost: Cost, bounds: Extremes, seeds: BoolArray, changed: BoolArray
) -> int:
    """Flip from the seeds on; see :func:`flip_edges`."""
    return flip_edges(surface.sheet, surface.guards, cost, bounds, seeds, changed)


def sweep(surface: Surface, wanted: BoolArray, work: Callable[[IntArray, int, int], int]) -> int:
    """Visit every wanted vertex that may move once, block after block."""
    coloring = vertex_coloring(surface.triangles, wanted & (surface.sheet.kind != LOCKED))
    moves = sum(run_chunks(surface.pool, surface.threads, coloring, partial(work, coloring.order)))
    surface.sheet.check()
    return moves


def move_all(surface: Surface, target: Target, bounds: Extremes) -> tuple[int, FloatArray]:
    """Move every vertex once; returns how many moved and how far, (n,)."""
    stars = surface.stars()
    body = surface.body(stars)
    moved = np.zeros(len(surface.points))

    def work(order: IntArray, start: int, stop: int) -> int:
        return int(move_vertices(
            surface.sheet, surface.guards, body, order, start, stop, target, bounds,
            surface.room(stars), moved,
        ))

    return sweep(surface, np.ones(len(surface.points), dtype=np.bool_), work), moved


class SurfaceDescent(TriangleDescent):
    """A surface under one phase, see :class:`odt_plugins.engine.finish.descent.Descending`."""

    gain = POLICY.surface_gain

    def __init__(self, surface: Surface, phase: Phase, bounds: Extremes) -> None:
        sheet = surface.sheet
        super().__init__(
            Triangles(sheet.points, sheet.triangles, sheet.neighbors, surface.regions), phase
        )
        self.surface, self.bounds = surface, bounds

    def flip_some(self, seeds: BoolArray, changed: BoolArray) -> int:
        """Flip from the seeds on."""
        return flip_all(self.surface, self.phase.cost, self.bounds, seeds, changed)

    def compound_moves(self, tried: BoolArray, excess: FloatArray) -> Callable[[IntArray], int]:
        """What tries compound moves at some triangles."""
        sheet, guards = self.surface.sheet, self.surface.guards
        every = np.ones(len(self.cells), dtype=np.bool_)
        rule = Rule(self.phase.cost, self.bounds, every, sheet.kind != SMOOTH, True)
        work = make_work(guards.ground, MOST_TOUCHED)

        def move_some(order: IntArray) -> int:
            taken = compound_pass(sheet, guards, self.mesh, order, rule, tried, excess, work)
            sheet.check()
            return int(taken)

        return move_some

    def sweep(self, stars: Stars, active: BoolArray, moved: FloatArray) -> int:
        """Smooth every active vertex once along the surface; returns how many moved."""
        surface = self.surface

        def work(order: IntArray, start: int, stop: int) -> int:
            return int(smooth_on_ground(
                surface.sheet, surface.guards, stars, surface.body(stars), order[start:stop],
                self.phase.cost, self.bounds, surface.room(stars), moved,
            ))

        return sweep(surface, active, work)
