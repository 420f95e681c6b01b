"""Planar finishing: descent of F_p = sum of m^-p by edge flips and vertex smoothing.

A small p over the whole mesh serves the mean, a large p near the worst triangles the minimum.
Flips and moves lower the same sum, so neither undoes the other.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from odt_plugins.engine.cells.triangle import triangle_measure
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.compiled.threads import pieces
from odt_plugins.engine.finish.phases import Phase, bulk, tail
from odt_plugins.engine.moves.flips2d import quality_flips
from odt_plugins.engine.moves.newton2d import smooth_vertices_2d
from odt_plugins.engine.record.figures import cell_shapes
from odt_plugins.engine.topology.active import spread
from odt_plugins.engine.topology.coloring import run_chunks, vertex_coloring
from odt_plugins.engine.topology.star import Stars, vertex_stars
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray

SETTLED = 1e-3
"""A vertex whose star gained less than this part of F_p does not wake its neighbours."""


def finish2d(
    points: FloatArray,
    cells: IntArray,
    neighbors: IntArray,
    regions: IntArray,
    movable: BoolArray,
    *,
    movable_cells: BoolArray | None = None,
    bounds: FloatArray | None = None,
    phases: tuple[Phase, ...] | None = None,
    pool: ThreadPoolExecutor | None = None,
    threads: int = 1,
) -> tuple[int, int]:
    """Improve the shape of a planar mesh in place; its boundary and its vertices all stay.

    Parameters
    ----------
    points : (n, 2) float64       changed
    cells : (m, 3) int32          counterclockwise; changed
    neighbors : (m, 3) int32      cells across the edges, -1 at the boundary; changed
    regions : (m,) int32          region labels; row t of the result has the label of row t
    movable : (n,) bool           vertices that may move; none on the boundary or an interface
    movable_cells : (m,) bool     an edge is flipped only between two such cells; None means all
    bounds : (3,) float64         least radius ratio, largest and smallest cosine of an angle that
                                  may appear where it was not before; None takes those of the mesh
    phases : tuple of Phase       what is done, in order; None takes the whole schedule
    pool, threads                 see :func:`run_chunks`; the result does not depend on them

    Returns
    -------
    flips, moves : int            edges that were flipped, moves of vertices
    """
    if len(cells) == 0:
        return 0, 0
    if bounds is None:
        shapes = cell_shapes(points, cells)
        bounds = np.array([shapes[:, 0].min(), shapes[:, 1].max(), shapes[:, 2].min()])
    flips = moves = 0
    for phase in bulk(2) + tail(2) if phases is None else phases:
        m = np.empty(len(cells))
        for first, last in pieces(0, len(cells)):
            _measures(points, cells[first:last], phase.objective, m[first:last])
        near = np.zeros(len(points), dtype=np.bool_)
        near[cells[m <= np.quantile(m, phase.share)]] = True
        pending = np.asarray(near[cells].any(axis=1))
        more_flips, more_moves = _descend(points, cells, neighbors, regions, movable,
                                          movable_cells, bounds, phase, pending, pool, threads)
        flips += more_flips
        moves += more_moves
    return flips, moves


def _descend(
    points: FloatArray, cells: IntArray, neighbors: IntArray, regions: IntArray,
    movable: BoolArray, movable_cells: BoolArray | None, bounds: FloatArray, phase: Phase,
    pending: BoolArray, pool: ThreadPoolExecutor | None, threads: int,
) -> tuple[int, int]:
    """Flip and smooth, in place, from the pending cells on, until nothing gains; counts both."""
    flips = moves = 0
    wanted = np.zeros(len(points), dtype=np.bool_)
    wanted[cells[pending]] = True
    moved = np.zeros(len(points))
    for _ in range(phase.rounds):
        changed = np.zeros(len(cells), dtype=np.bool_)
        flips += quality_flips(points, cells, neighbors, regions, movable_cells, phase.power,
                               bounds, seeds=pending, changed=changed, objective=phase.objective)
        wanted[cells[changed]] = True
        stars = vertex_stars(cells, len(points))
        status = np.zeros(len(cells), dtype=np.uint8)
        for _ in range(phase.sweeps):
            moves += _sweep(points, cells, stars, wanted & movable, phase, bounds, moved, pool,
                            threads)
            spread(cells, stars.indptr, stars.indices, moved, SETTLED, wanted, status)
        pending = status == 1
        if not pending.any():
            break
    return flips, moves


def _sweep(
    points: FloatArray, cells: IntArray, stars: Stars, wanted: BoolArray, phase: Phase,
    bounds: FloatArray, moved: FloatArray, pool: ThreadPoolExecutor | None, threads: int,
) -> int:
    """Smooth every wanted vertex once, block after block; returns how many moved."""
    coloring = vertex_coloring(cells, wanted)
    moved[:] = 0.0

    def work(start: int, stop: int) -> int:
        return int(smooth_vertices_2d(points, cells, stars.indptr, stars.indices,
                                      coloring.order, start, stop, phase.objective,
                                      phase.power, bounds, moved))

    return sum(run_chunks(pool, threads, coloring, work))


@kernel
def _measures(points: FloatArray, cells: IntArray, objective: int, m: FloatArray) -> None:
    """Measure of every triangle."""
    for t in range(cells.shape[0]):
        m[t] = triangle_measure(points, cells[t, 0], cells[t, 1], cells[t, 2], objective)
