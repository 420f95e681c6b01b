"""Passes over a surface: flips, moves, and the descent of F_p that is stage 2."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.finish.phases import Phase
from odt_plugins.engine.ground.closest import Ground
from odt_plugins.engine.ground.lines import Lines
from odt_plugins.engine.ground.sheet import HELD, Limits, Sheet, make_work
from odt_plugins.engine.record.figures import cell_shapes
from odt_plugins.engine.surface.flips import flip_edges
from odt_plugins.engine.surface.newton import smooth_vertices
from odt_plugins.engine.surface.odt import move_vertices
from odt_plugins.engine.topology.active import spread
from odt_plugins.engine.topology.coloring import run_chunks, vertex_coloring
from odt_plugins.engine.topology.star import Stars, vertex_stars
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray

GAIN = 3e-3
"""A vertex whose star gained less than this part of F_p does not wake its neighbours."""


@dataclass(frozen=True)
class Surface:
    """A surface on its ground, with all that the stages need to know of it.

    Attributes
    ----------
    sheet : Sheet, ground : Ground, lines : Lines, limits : Limits
    regions : (m,) int32                                 labels; no flip crosses their borders
    pool : ThreadPoolExecutor or None, threads : int     see :func:`run_chunks`
    """

    sheet: Sheet
    ground: Ground
    lines: Lines
    limits: Limits
    regions: IntArray
    pool: ThreadPoolExecutor | None = None
    threads: int = 1

    @property
    def points(self) -> FloatArray:
        """Coordinates (n, 3), as they are now."""
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

    def _moving(self) -> tuple[NDArray[Any], ...]:
        sheet = self.sheet
        return sheet.points, sheet.foot, sheet.first, sheet.following, self.lines.place

    def stars(self) -> Stars:
        """Triangles around every vertex, as they are now."""
        return vertex_stars(self.sheet.triangles, len(self.sheet.points))


def flip_all(
    surface: Surface, power: float, bounds: FloatArray, seeds: BoolArray, changed: BoolArray
) -> int:
    """Flip from the seeds on; see :func:`flip_edges`."""
    return flip_edges(
        surface.sheet, surface.ground, surface.limits, power, bounds, seeds, changed
    )


def sweep(
    surface: Surface, wanted: BoolArray, moved: FloatArray,
    work: Callable[[IntArray, int, int], int],
) -> int:
    """Visit every wanted vertex that may move once, block after block."""
    coloring = vertex_coloring(surface.triangles, wanted & (surface.sheet.kind != HELD))
    moved[:] = 0.0
    moves = sum(run_chunks(
        surface.pool, surface.threads, coloring, partial(work, coloring.order)
    ))
    surface.sheet.check()
    return moves


def move_all(
    surface: Surface, target: int, rho: FloatArray, bounds: FloatArray, *,
    vectors: FloatArray | None = None, equal_weights: bool = False, omega: float = 1.0,
) -> tuple[int, FloatArray]:
    """Move every vertex once; returns how many moved and how far, (n,)."""
    stars = surface.stars()
    largest = stars.largest()
    moved = np.zeros(len(surface.points))
    given = np.zeros((0, 3)) if vectors is None else vectors

    def work(order: IntArray, start: int, stop: int) -> int:
        return int(move_vertices(
            surface.sheet, surface.ground, surface.lines, stars.indptr, stars.indices, order,
            start, stop, target, given, rho, equal_weights, omega, surface.limits, bounds,
            make_work(surface.ground, largest), moved,
        ))

    everything = np.ones(len(surface.points), dtype=np.bool_)
    return sweep(surface, everything, moved, work), moved


def finish_phase(surface: Surface, phase: Phase, bounds: FloatArray) -> tuple[int, int]:
    """Lower F_p, in place, from the worst triangles on; returns flips and moves."""
    q = cell_shapes(surface.points, surface.triangles)[:, 0]
    near = np.zeros(len(surface.points), dtype=np.bool_)
    near[surface.triangles[q <= np.quantile(q, phase.share)]] = True
    pending = np.asarray(near[surface.triangles].any(axis=1))
    wanted = np.zeros(len(surface.points), dtype=np.bool_)
    wanted[surface.triangles[pending]] = True
    moved = np.zeros(len(surface.points))
    flips = total = 0
    for _ in range(phase.rounds):
        changed = np.zeros(len(surface.triangles), dtype=np.bool_)
        flips += flip_all(surface, phase.power, bounds, pending, changed)
        wanted[surface.triangles[changed]] = True
        stars = surface.stars()
        status = np.zeros(len(surface.triangles), dtype=np.uint8)

        def work(
            order: IntArray, start: int, stop: int, stars: Stars = stars,
            largest: int = stars.largest(),
        ) -> int:
            return int(smooth_vertices(
                surface.sheet, surface.ground, surface.lines, stars.indptr, stars.indices, order,
                start, stop, phase.power, surface.limits, bounds,
                make_work(surface.ground, largest), moved,
            ))

        for _ in range(phase.sweeps):
            total += sweep(surface, wanted, moved, work)
            spread(surface.triangles, stars.indptr, stars.indices, moved, GAIN, wanted, status)
        pending = status == 1
        if not pending.any():
            break
    return flips, total
