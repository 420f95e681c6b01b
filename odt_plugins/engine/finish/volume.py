"""Stage 2 in space: descent of F_p first everywhere, then where cells are bad.

F_p is the sum over all cells of about q^-p, see ``tetrahedron.quality_cost``.  Both moves lower
the same sum, so they cannot undo each other's work.  A small p serves the mean, a large p the
worst cells; bounds keep every change within the extremes that the input had.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from odt_plugins.engine.cells.extremes import FREELY, Bounds, Extremes, better, part_of, together
from odt_plugins.engine.cells.measures import NO_CELL, QUALITY
from odt_plugins.engine.compiled.threads import run_ranges
from odt_plugins.engine.finish.descent import finish_phase
from odt_plugins.engine.finish.phases import Phase
from odt_plugins.engine.moves.compound import compound_pass
from odt_plugins.engine.moves.newton3d import smooth_vertices
from odt_plugins.engine.moves.passes import flip_pending, grow, measures
from odt_plugins.engine.moves.reconnection import reconnection_pass
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import cell_shapes, tet_extremes
from odt_plugins.engine.topology.active import DONE, PENDING, around_vertices, vertices_of_pending
from odt_plugins.engine.topology.coloring import run_chunks, touching_blocks, vertex_coloring
from odt_plugins.engine.topology.complex import Complex, slot_stars
from odt_plugins.engine.topology.slabs import Work, side_by_side
from odt_plugins.engine.topology.star import Stars
from odt_plugins.engine.topology.tets import Tets
from odt_plugins.engine.topology.triangles import Triangles
from odt_plugins.mesh.arrays import BoolArray, ByteArray, FloatArray, IntArray
from odt_plugins.mesh.chunks import Pool
from odt_plugins.mesh.quantiles import quantile

FEW = 20
"""Cells at which reconnection is tried however small a part of the mesh they are."""


def worst_count(q: FloatArray, phase: Phase) -> int:
    """How many cells a phase starts from, besides the best of all; ``q`` as of :func:`measures`."""
    cells = int((q < NO_CELL).sum())
    if phase.count:
        return min(phase.count, cells - 1)
    most = min(int(phase.share * cells + 1e-6), cells - 1)
    return min(most, max(most // 10, int((q < phase.enough).sum())))


def _large_cosines(mesh: Complex, pool: Pool | None) -> FloatArray:
    """Largest cosine of an angle of every cell."""
    def part(start: int, stop: int) -> FloatArray:
        cells = mesh.cells[start:stop]
        live = np.flatnonzero(cells[:, 0] >= 0)
        return cell_shapes(mesh.points, np.take(cells, live, axis=0))[:, 1]

    return np.concatenate(run_ranges(pool, mesh.used, part))


def held_angles(mesh: Complex, bounds: Bounds, share: float, pool: Pool | None = None) -> Bounds:
    """Bounds under which no new cell gets a smaller angle than a share of the cells has now."""
    return bounds.with_large(quantile(_large_cosines(mesh, pool), 1.0 - share))


def reached(mesh: Complex, pool: Pool | None = None) -> Extremes:
    """Extremes of all cells."""
    parts = run_ranges(pool, mesh.used, partial(tet_extremes, mesh.points, mesh.cells))
    return together(Extremes(*part) for part in parts)


def guarded(mesh: Complex, phase: Phase, bounds: Bounds, pool: Pool | None = None) -> Bounds:
    """Bounds for a phase by its guard and its least angle, see :class:`Phase`."""
    if phase.least is not None:
        cosines = _large_cosines(mesh, pool)
        least = math.cos(math.radians(phase.least))
        reached = cosines.max()
        few = (cosines > least).mean() <= POLICY.many_small_angles
        bounds = bounds.with_large(min(least, reached) if few else reached)
    if phase.guard is not None:
        q = measures(mesh, QUALITY, pool)
        reached = quantile(q[q < NO_CELL], phase.guard)
        bounds = bounds.with_quality(max(bounds.cells.quality, reached))
    return bounds


class _VolumeDescent:
    """Tetrahedra under one phase, see :class:`odt_plugins.engine.finish.descent.Descending`."""

    gain = POLICY.volume_gain

    def __init__(
        self, mesh: Complex, phase: Phase, bounds: Bounds, pool: Pool | None,
        threads: int, q: FloatArray,
    ) -> None:
        self.mesh, self.phase, self.bounds, self.q = mesh, phase, bounds, q
        self.pool, self.threads = pool, threads
        self.zone = ~mesh.locked
        self.touch: BoolArray | None = None

    @property
    def points(self) -> FloatArray:
        """Coordinates (n, 3)."""
        return self.mesh.points

    @property
    def cells(self) -> IntArray:
        """Slots in use, (k, 4)."""
        return self.mesh.cells[: self.mesh.used]

    @property
    def status(self) -> ByteArray:
        """Whether flips are to be tried at a slot."""
        return self.mesh.status

    def worst(self) -> BoolArray:
        """Make the worst cells pending; the vertices of all cells that touch them move first.

        A phase that starts from every cell moves every vertex.
        """
        mesh, cells, q = self.mesh, self.cells, self.q
        used = len(q)
        mesh.status[:] = 0
        if mesh.skin is not None:
            mesh.skin.allow(self.phase.share < 1.0)
        if self.phase.share == 1.0:
            mesh.status[:used][q < NO_CELL] = PENDING
            return np.ones(len(mesh.points), dtype=np.bool_)
        count = worst_count(q, self.phase)
        bad = q < np.partition(q, count)[count]
        touched = np.zeros(len(mesh.points), dtype=np.bool_)
        touched[cells[bad].ravel()] = True
        active = np.zeros(len(mesh.points), dtype=np.bool_)
        around_vertices(cells, touched, mesh.status)
        vertices_of_pending(cells, mesh.status, active)
        mesh.status[:used][~bad] = 0
        self.zone &= active
        return active

    def flip(self, active: BoolArray) -> int:
        """Flip edges of a surface that slides, then inside; returns the number of flips."""
        mesh = self.mesh
        flips = _flip_surface(mesh, self.phase, self.bounds)
        flips += flip_pending(
            mesh, self.phase.cost, POLICY.quality_ring, self.bounds, POLICY.quality_passes,
            self.pool,
        )
        mesh.status[mesh.status == DONE] = 0
        return flips

    def stars(self) -> Stars:
        """Stars of all vertices; also which blocks of them touch, for the sweeps."""
        self.touch = touching_blocks(self.cells, self.zone, self.pool)
        return slot_stars(self.mesh, self.pool)

    def sweep(self, stars: Stars, active: BoolArray, moved: FloatArray) -> int:
        """Smooth the active vertices once, those of a surface that slides after the others."""
        mesh, phase, limit = self.mesh, self.phase, self.bounds.cells
        coloring = vertex_coloring(self.cells, active & self.zone, self.touch)

        def work(start: int, stop: int) -> int:
            return int(smooth_vertices(
                mesh.points, self.cells, stars, coloring.order, start, stop, phase.cost, limit,
                moved,
            ))

        moves = sum(run_chunks(self.pool, self.threads, coloring, work))
        if mesh.skin is not None:
            from odt_plugins.engine.sliding.skin import slide

            moves += slide(mesh, mesh.skin, stars, active, phase.cost, limit, moved)
        return moves

    def settled(self, flips: int, woke: int) -> bool:
        """Whether the last round changed nothing that matters."""
        return flips == 0 and woke == 0


def descend(
    mesh: Complex,
    phase: Phase,
    bounds: Bounds,
    pool: Pool | None,
    threads: int,
) -> tuple[int, int]:
    """One phase with its compound moves, after reconnections of the same cells.

    Returns the numbers of flips, reconnections and compound moves among them, and of vertex moves.
    """
    bounds = guarded(mesh, phase, bounds, pool)
    q = measures(mesh, phase.objective, pool)
    before = 0
    if phase.compound and phase.fills:
        before = reconnections(mesh, phase, bounds, pool, q)
        q = measures(mesh, phase.objective, pool) if before else q
    flips, moves = finish_phase(_VolumeDescent(mesh, phase, bounds, pool, threads, q), phase)
    flips += before
    tried = np.zeros(0, dtype=bool)
    for _ in range(phase.compound):
        tried = np.concatenate([tried, np.zeros(len(mesh.cells) - len(tried), dtype=bool)])
        taken = compound_moves(mesh, phase, bounds, tried, pool)
        flips += taken
        if taken == 0:
            break
    return flips, moves


def _flip_surface(mesh: Complex, phase: Phase, bounds: Bounds) -> int:
    """Flip edges of a surface that slides, around the pending cells."""
    if mesh.skin is None:
        return 0
    from odt_plugins.engine.sliding.skin import flip_skin

    near = mesh.status[: mesh.used] == PENDING
    flips = flip_skin(mesh, mesh.skin, near, phase.cost, bounds)
    if mesh.full:
        grow(mesh)
    return flips


def compound_moves(
    mesh: Complex, phase: Phase, bounds: Bounds, tried: BoolArray, pool: Pool | None
) -> int:
    """Try compound moves at the worst share of the cells; returns how many stayed."""
    work = partial(_compound_part, phase, bounds, tried)
    q = measures(mesh, phase.objective, pool)
    return _at_the_worst(mesh, phase, pool, work, q, rare=POLICY.compound_rare)


def reconnections(
    mesh: Complex, phase: Phase, bounds: Bounds, pool: Pool | None, q: FloatArray
) -> int:
    """Fill polyhedra around the worst share of the cells anew; returns how many.

    ``q`` as of :func:`measures`.
    """
    work = partial(_reconnected_part, mesh, phase, bounds)
    return _at_the_worst(mesh, phase, pool, work, q, most=POLICY.reconnected)


def _at_the_worst(
    mesh: Complex, phase: Phase, pool: Pool | None, work: Work, q: FloatArray, most: float = 1.0,
    rare: float = 0.0,
) -> int:
    """Work at the worst share of the cells, ``most`` of them, in slabs where these are many, and
    no longer where less than ``rare`` of them pay.
    """
    count = min(worst_count(q, phase), max(int(most * mesh.count()), FEW))
    worst = np.flatnonzero(q <= np.partition(q, count)[count])
    order = worst[np.argsort(q[worst], kind="stable")][: count + 1].astype(np.int32)
    mesh.status[:] = 0
    taken = side_by_side(mesh, order, pool, work, costly=True, rare=rare)
    if mesh.full:
        grow(mesh)
    return taken


def _compound_part(
    phase: Phase, bounds: Bounds, tried: BoolArray, order: IntArray, tets: Tets
) -> int:
    """Try compound moves at the cells of one slab."""
    return int(compound_pass(tets, order, phase.cost, POLICY.quality_ring, bounds, tried))


def _reconnected_part(
    mesh: Complex, phase: Phase, bounds: Bounds, order: IntArray, tets: Tets
) -> int:
    """Reconnect at the cells of one slab; no vertex moves, so those at its cuts are not locked."""
    own = tets._replace(locked=mesh.locked)
    return int(reconnection_pass(own, order, phase.cost, bounds))


def finish(
    mesh: Complex,
    phases: tuple[Phase, ...],
    bounds: Bounds,
    pool: Pool | None,
    threads: int,
) -> tuple[int, int]:
    """Run phases of the finishing stage on a complex, in place; gives how many flips and moves.

    Parameters
    ----------
    mesh : Complex
    phases : tuple of Phase
    bounds : Bounds            the plane uses those of all cells
    pool, threads              see ``run_chunks``; the result does not depend on them
    """
    if mesh.dim == 2:
        from odt_plugins.engine.finish.plane import finish2d

        return finish2d(
            Triangles(mesh.points, mesh.cells, mesh.neighbors, mesh.regions), ~mesh.locked,
            bounds=bounds.cells, phases=phases, pool=pool, threads=threads,
        )
    flips = moves = 0
    best = FREELY
    for phase in phases:
        limits = bounds
        if phase.hold:
            now = reached(mesh, pool)
            best = better(best, now)
            limits = bounds.within(together((now, part_of(best, phase.hold))))
        more_flips, more_moves = descend(mesh, phase, limits, pool, threads)
        flips += more_flips
        moves += more_moves
    return flips, moves
