"""Flips of a tetrahedral mesh on incrementally kept adjacency (Section 3.1 in three dimensions).

Edge removal, which contains the 3-2 and 4-4 flips, and the 2-3 flip.  A flip is taken only when
the sum of the cell costs strictly falls, so that a sequence of flips terminates.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.sphere import apex_across, circumsphere, inside_sphere
from odt_plugins.engine.cells.tetrahedron import (
    ENERGY,
    opposite_vertices,
    tet_cosines,
    tet_cost,
    tet_quality,
)
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.moves.cavity import (
    UNKNOWN,
    Work,
    cell_cost,
    local_edge,
    make_work,
    replace_cavity,
    triangulate_ring,
    walk_ring,
    write_ring,
)
from odt_plugins.engine.topology.active import DONE, PENDING
from odt_plugins.mesh.arrays import BoolArray, ByteArray, FloatArray, IntArray, LongArray

REAL = 1.0 - 1e-9
"""A flip is taken when the cost after it is below this part of the cost before it."""


@kernel
def admissible(
    points: FloatArray, cells: IntArray, locked: BoolArray, old: IntArray, n_old: int,
    new: IntArray, n_new: int, objective: int, bounds: FloatArray,
) -> bool:
    """Whether no new cell is worse than both the bounds and the worst cell it replaces.

    A cell with locked vertices only can never be repaired by smoothing: it is held to the worst
    such cell among the old ones, other cells to the worst of all.  In the energy objective, which
    smoothing and finishing follow, only the locked cells are held to anything.
    """
    new_q = 2.0
    new_large = -1.0
    new_small = 1.0
    locked_q = 2.0
    locked_large = -1.0
    locked_small = 1.0
    for m in range(n_new):
        is_locked = (
            locked[new[m, 0]] and locked[new[m, 1]] and locked[new[m, 2]] and locked[new[m, 3]]
        )
        if objective == ENERGY and not is_locked:
            continue
        q = tet_quality(points, new[m, 0], new[m, 1], new[m, 2], new[m, 3])
        large, small = tet_cosines(points, new[m, 0], new[m, 1], new[m, 2], new[m, 3])
        if is_locked:
            locked_q = min(locked_q, q)
            locked_large = max(locked_large, large)
            locked_small = min(locked_small, small)
        else:
            new_q = min(new_q, q)
            new_large = max(new_large, large)
            new_small = min(new_small, small)
    if (
        new_q >= bounds[0]
        and locked_q >= bounds[3]
        and new_large <= bounds[1]
        and new_small >= bounds[2]
        and locked_large <= bounds[4]
        and locked_small >= bounds[5]
    ):
        return True
    q_floor, large_ceiling, small_floor = bounds[0], bounds[1], bounds[2]
    locked_floor, locked_ceiling, locked_depth = bounds[3], bounds[4], bounds[5]
    for m in range(n_old):
        c = old[m]
        q = tet_quality(points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3])
        large, small = tet_cosines(points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3])
        q_floor = min(q_floor, q)
        large_ceiling = max(large_ceiling, large)
        small_floor = min(small_floor, small)
        if (
            locked[cells[c, 0]]
            and locked[cells[c, 1]]
            and locked[cells[c, 2]]
            and locked[cells[c, 3]]
        ):
            locked_floor = min(locked_floor, q)
            locked_ceiling = max(locked_ceiling, large)
            locked_depth = min(locked_depth, small)
    return (
        new_q >= q_floor
        and new_large <= large_ceiling
        and new_small >= small_floor
        and locked_q >= locked_floor
        and locked_large <= locked_ceiling
        and locked_small >= locked_depth
    )


@kernel
def _forget(costs: FloatArray, around: IntArray, n: int) -> None:
    """Forget the costs of the cells that were replaced."""
    if costs.shape[0] > 0:
        for m in range(n):
            costs[around[m]] = UNKNOWN


@kernel
def remove_edge(
    points: FloatArray, cells: IntArray, neighbors: IntArray, regions: IntArray,
    locked: BoolArray, status: ByteArray, c: int, e: int, slots: LongArray, free: IntArray,
    objective: int, power: float, max_ring: int, bounds: FloatArray, allowance: float, work: Work,
    journal: LongArray,
) -> tuple[float, int]:
    """Remove edge e of cell c if that lowers the cost, or raises it by less than the allowance.

    With an ``allowance`` above 0 no bounds hold the flip back, and cells that were visited before
    take part in it.

    Returns
    -------
    gain : float     cost before minus cost after; 0 when nothing was done
    n_new : int      new cells, whose slots are in the second work array
    """
    ring, around, new, best, split, stack, rim, costs = work
    a, b, n = walk_ring(
        cells, neighbors, regions, status, c, e, max_ring, objective != ENERGY and allowance == 0.0,
        ring, around,
    )
    if n < 3:
        return 0.0, 0
    before = 0.0
    for m in range(n):
        before += cell_cost(points, cells, around[m], objective, power, costs)
    limit = before + allowance if allowance > 0.0 else before * REAL
    if objective != ENERGY and limit <= 2.0 * (n - 2):
        return 0.0, 0
    after = triangulate_ring(points, a, b, ring, n, objective, power, limit, best, split)
    if not after < limit:
        return 0.0, 0
    n_new = write_ring(a, b, ring, n, split, new, stack)
    if allowance == 0.0 and not admissible(
        points, cells, locked, around, n, new, n_new, objective, bounds
    ):
        return 0.0, 0
    if not replace_cavity(cells, neighbors, regions, status, around, n, new, n_new, slots, free,
                          rim, journal):
        return 0.0, 0
    _forget(costs, around, n_new)
    return before - after, n_new


@kernel
def flip_facet(
    points: FloatArray, cells: IntArray, neighbors: IntArray, regions: IntArray,
    locked: BoolArray, status: ByteArray, c: int, f: int, slots: LongArray, free: IntArray,
    objective: int, power: float, bounds: FloatArray, allowance: float, work: Work,
    journal: LongArray,
) -> tuple[float, int]:
    """2-3 flip of facet f of cell c; arguments and results as :func:`remove_edge`."""
    _, around, new, _, _, _, rim, costs = work
    across = neighbors[c, f]
    if across < 0 or regions[across] != regions[c]:
        return 0.0, 0
    if objective != ENERGY and allowance == 0.0 and status[across] == DONE:
        return 0.0, 0
    apex = apex_across(cells, c, f, across)
    base = cells[c, f]
    u, v, w = opposite_vertices(cells, c, base)
    before = cell_cost(points, cells, c, objective, power, costs)
    before += cell_cost(points, cells, across, objective, power, costs)
    limit = before + allowance if allowance > 0.0 else before * REAL
    if objective != ENERGY and limit <= 3.0:
        return 0.0, 0
    after = tet_cost(points, base, u, v, apex, objective, power)
    if not after < limit:
        return 0.0, 0
    after += tet_cost(points, base, v, w, apex, objective, power)
    if not after < limit:
        return 0.0, 0
    after += tet_cost(points, base, w, u, apex, objective, power)
    if not after < limit:
        return 0.0, 0
    for m in range(3):
        new[m, 0] = base
        new[m, 3] = apex
    new[0, 1] = u
    new[0, 2] = v
    new[1, 1] = v
    new[1, 2] = w
    new[2, 1] = w
    new[2, 2] = u
    around[0] = c
    around[1] = across
    n_old, n_new = np.int64(2), np.int64(3)
    if allowance == 0.0 and not admissible(
        points, cells, locked, around, n_old, new, n_new, objective, bounds
    ):
        return 0.0, 0
    if not replace_cavity(cells, neighbors, regions, status, around, n_old, new, n_new, slots,
                          free, rim, journal):
        return 0.0, 0
    _forget(costs, around, n_new)
    return before - after, int(n_new)


@kernel
def improve_cell(
    points: FloatArray, cells: IntArray, neighbors: IntArray, regions: IntArray,
    locked: BoolArray, status: ByteArray, c: int, slots: LongArray, free: IntArray,
    objective: int, power: float, max_ring: int, bounds: FloatArray, work: Work,
    journal: LongArray,
) -> tuple[float, int]:
    """Take the first flip at cell c that lowers the cost; results as :func:`remove_edge`.

    With the energy only facets that are not locally Delaunay are looked at, and their edges,
    once: not again from a cell across that was visited and is still the same.
    """
    facets = 15
    if objective == ENERGY:
        facets = 0
        det, gx, gy, gz, size = circumsphere(
            points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3]
        )
        for f in range(4):
            across = neighbors[c, f]
            if across < 0 or regions[across] != regions[c] or status[across] == DONE:
                continue
            apex = apex_across(cells, c, f, across)
            if inside_sphere(points, cells[c, 0], apex, det, gx, gy, gz, size):
                facets |= 1 << f
        if facets == 0:
            return 0.0, 0
    for e in range(6):
        _, _, k, l = local_edge(e)
        if facets & ((1 << k) | (1 << l)) == 0:
            continue
        gain, n_new = remove_edge(
            points, cells, neighbors, regions, locked, status, c, e, slots, free, objective,
            power, max_ring, bounds, 0.0, work, journal,
        )
        if n_new > 0:
            return gain, n_new
    for f in range(4):
        if facets & (1 << f) == 0:
            continue
        gain, n_new = flip_facet(
            points, cells, neighbors, regions, locked, status, c, f, slots, free, objective,
            power, bounds, 0.0, work, journal,
        )
        if n_new > 0:
            return gain, n_new
    return 0.0, 0


@allocating_kernel
def flip_pass(
    points: FloatArray, cells: IntArray, neighbors: IntArray, regions: IntArray,
    locked: BoolArray, status: ByteArray, costs: FloatArray, order: IntArray, slots: LongArray,
    free: IntArray, objective: int, power: float, max_ring: int, bounds: FloatArray,
) -> int:
    """Try every edge removal and 2-3 flip at the pending cells, in the given order.

    Parameters
    ----------
    points : (n, 3) float64
    cells, neighbors : (room, 4) int32    changed in place; free slots hold -1 in column 0
    regions : (room,) int32
    locked : (n,) bool                    vertices that no smoothing can move
    status : (room,) uint8                IDLE, PENDING or DONE; changed in place
    costs : (room,) float64               of the cells, UNKNOWN where not computed; kept up to date
    order : (k,) int32                    cells to visit, worst first
    slots, free                           see ``cavity.replace_cavity``
    objective, power                      see ``tetrahedron.tet_cost``
    max_ring : int                        longest ring that edge removal takes
    bounds : (6,) float64                 least q, largest and smallest cosine that may appear;
                                          the same for a cell with locked vertices only

    Returns
    -------
    int                                   number of flips taken
    """
    work = make_work(costs)
    journal = np.full((1, 4), -1, np.int64)
    flips = 0
    for o in range(order.shape[0]):
        c = order[o]
        if status[c] != PENDING or cells[c, 0] < 0:
            continue
        status[c] = DONE
        _, n_new = improve_cell(
            points, cells, neighbors, regions, locked, status, c, slots, free, objective, power,
            max_ring, bounds, work, journal,
        )
        if n_new > 0:
            flips += 1
    return flips
