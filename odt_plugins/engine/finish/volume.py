"""Stage 2: descent of F_p by flips and smoothing, first everywhere, then where cells are bad.

F_p is the sum over all cells of about q^-p, see ``tetrahedron.quality_cost``.  Both moves lower
the same sum, so they cannot undo each other's work.  A small p serves the mean, a large p the
worst cells; bounds keep every change within the extremes that the input had.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np

from odt_plugins.engine.cells.extremes import Bounds, Extremes
from odt_plugins.engine.cells.tetrahedron import QUALITY, Cost
from odt_plugins.engine.finish.phases import MOST, Phase
from odt_plugins.engine.finish.plane import finish2d
from odt_plugins.engine.moves import compound
from odt_plugins.engine.moves import newton3d as smooth3d
from odt_plugins.engine.moves.passes import flip_pending, grow, measures
from odt_plugins.engine.record.figures import cell_shapes
from odt_plugins.engine.sliding.skin import flip_skin, slide
from odt_plugins.engine.topology.active import (
    DONE,
    PENDING,
    around_vertices,
    spread,
    vertices_of_pending,
)
from odt_plugins.engine.topology.coloring import run_chunks, touching_blocks, vertex_coloring
from odt_plugins.engine.topology.complex import Complex, slot_stars
from odt_plugins.engine.topology.slabs import side_by_side
from odt_plugins.engine.topology.star import Stars
from odt_plugins.engine.topology.tets import Tets
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray

GAIN = 3e-3
RING = 10
WORTH_COMPOUND = 0.01
"""Part of the cells from which on compound moves, slower than flips, are made in slabs."""



def worst_count(q: FloatArray, phase: Phase) -> int:
    """How many cells a phase starts from, besides the best of all; ``q`` as of :func:`measures`."""
    cells = int((q < 1.5).sum())
    most = min(int(phase.share * cells + 1e-6), cells - 1)
    return min(most, max(most // 10, int((q < phase.enough).sum())))


def held_angles(mesh: Complex, bounds: Bounds, share: float) -> Bounds:
    """Bounds under which no new cell gets a smaller angle than a share of the cells has now."""
    cells, _ = mesh.mesh_arrays()
    return bounds.with_large(np.quantile(cell_shapes(mesh.points, cells)[:, 1], 1.0 - share))


def guarded(
    mesh: Complex, phase: Phase, bounds: Bounds, pool: ThreadPoolExecutor | None = None
) -> Bounds:
    """Bounds for a phase, see :class:`Phase`."""
    if phase.least is not None:
        cells, _ = mesh.mesh_arrays()
        cosines = cell_shapes(mesh.points, cells)[:, 1]
        least = math.cos(math.radians(phase.least))
        reached = cosines.max()
        few = (cosines > least).mean() <= MOST
        bounds = bounds.with_large(min(least, reached) if few else reached)
    if phase.guard is not None:
        q = measures(mesh, QUALITY, pool)
        reached = np.quantile(q[q < 1.5], phase.guard)
        bounds = bounds.with_quality(max(bounds.cells.quality, reached))
    return bounds


def descend(
    mesh: Complex,
    phase: Phase,
    bounds: Bounds,
    pool: ThreadPoolExecutor | None,
    threads: int,
) -> tuple[int, int]:
    """Lower F_p by flips and smoothing; returns the numbers of flips and of vertex moves."""
    bounds = guarded(mesh, phase, bounds, pool)
    q = measures(mesh, phase.objective, pool)
    used = len(q)
    mesh.status[:] = 0
    active = np.zeros(len(mesh.points), dtype=bool)
    if phase.share < 1.0:
        count = worst_count(q, phase)
        bad = q < np.partition(q, count)[count]
        touched = np.zeros(len(mesh.points), dtype=bool)
        touched[mesh.cells[:used][bad].ravel()] = True
        around_vertices(mesh.cells[:used], touched, mesh.status)
        vertices_of_pending(mesh.cells[:used], mesh.status, active)
        mesh.status[:used][~bad] = 0
    else:
        mesh.status[:used][q < 1.5] = PENDING
        active[:] = True
    zone = ~mesh.locked if phase.share == 1.0 else active & ~mesh.locked
    moved = np.zeros(len(mesh.points))
    if mesh.skin is not None:
        mesh.skin.allow(phase.share < 1.0)
    flips = moves = 0
    for _ in range(phase.rounds):
        round_flips = _flip_surface(mesh, phase, bounds)
        round_flips += flip_pending(mesh, phase.cost, RING, bounds, 4, pool)
        flips += round_flips
        mesh.status[mesh.status == DONE] = 0
        stars = slot_stars(mesh, pool)
        cells = mesh.cells[: mesh.used]
        touch = touching_blocks(cells, zone, pool)
        pushed = 0
        for _ in range(phase.sweeps):
            coloring = vertex_coloring(cells, active & zone, touch)
            moved[:] = 0.0
            work = partial(
                _smooth_chunk, mesh, stars, coloring.order, phase.cost, bounds.cells, moved
            )
            moves += sum(run_chunks(pool, threads, coloring, work))
            if mesh.skin is not None:
                moves += slide(mesh, mesh.skin, stars, active, phase.cost, bounds.cells, moved)
            pushed = spread(cells, stars.indptr, stars.indices, moved, GAIN, active, mesh.status)
        if pushed == 0 and round_flips == 0:
            break
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
    near = mesh.status[: mesh.used] == PENDING
    flips = flip_skin(mesh, mesh.skin, near, phase.cost, bounds)
    if mesh.full:
        grow(mesh)
    return flips


def _smooth_chunk(
    mesh: Complex, stars: Stars, order: IntArray, cost: Cost, limit: Extremes, moved: FloatArray,
    start: int, stop: int,
) -> int:
    """Smooth the vertices order[start:stop]."""
    return int(smooth3d.smooth_vertices(
        mesh.points, mesh.cells, stars, order, start, stop, cost, limit, moved
    ))


def compound_moves(
    mesh: Complex, phase: Phase, bounds: Bounds, tried: BoolArray, pool: ThreadPoolExecutor | None
) -> int:
    """Try compound moves at the worst share of the cells; returns how many stayed."""
    q = measures(mesh, phase.objective, pool)
    count = worst_count(q, phase)
    worst = np.argpartition(q, count)[: count + 1]
    order = worst[np.argsort(q[worst], kind="stable")].astype(np.int32)
    mesh.status[:] = 0
    work = partial(_compound_part, phase, bounds, tried)
    taken = side_by_side(mesh, order, pool, work, WORTH_COMPOUND, costly=True)
    if mesh.full:
        grow(mesh)
    return taken


def _compound_part(
    phase: Phase, bounds: Bounds, tried: BoolArray, order: IntArray, tets: Tets
) -> int:
    """Try compound moves at the cells of one slab."""
    return int(compound.compound_pass(tets, order, phase.cost, RING, bounds, tried))


def finish(
    mesh: Complex,
    phases: tuple[Phase, ...],
    bounds: Bounds,
    pool: ThreadPoolExecutor | None,
    threads: int,
) -> tuple[int, int]:
    """Run phases of the finishing stage on a complex, in place.

    Parameters
    ----------
    mesh : Complex
    phases : tuple of Phase
    bounds : Bounds            the plane uses those of all cells
    pool, threads              see ``run_chunks``; the result does not depend on them

    Returns
    -------
    flips, moves : int
    """
    if mesh.dim == 2:
        return finish2d(
            mesh.points, mesh.cells, mesh.neighbors, mesh.regions, ~mesh.locked,
            bounds=np.array(bounds.cells), phases=phases, pool=pool, threads=threads,
        )
    flips = moves = 0
    for phase in phases:
        more_flips, more_moves = descend(mesh, phase, bounds, pool, threads)
        flips += more_flips
        moves += more_moves
    return flips, moves
