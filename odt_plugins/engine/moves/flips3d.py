"""Flips of a tetrahedral mesh on incrementally kept adjacency (Section 3.1 in three dimensions).

Edge removal, which contains the 3-2 and 4-4 flips, and the 2-3 flip.  A flip is taken only when
the sum of the cell costs strictly falls, so that a sequence of flips terminates.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.cost import Cost, is_energy, least_cost
from odt_plugins.engine.cells.extremes import BEST, Bounds, Extremes, keeps, worse
from odt_plugins.engine.cells.measures import cell_extremes, tet_cost
from odt_plugins.engine.cells.sphere import apex_across, circumsphere, inside_sphere
from odt_plugins.engine.cells.tetrahedron import opposite_vertices
from odt_plugins.engine.compiled.kernel import allocating_kernel, inlined_kernel, kernel
from odt_plugins.engine.moves.cavity import (
    Journal,
    Ring,
    forget_costs,
    known_cost,
    local_edge,
    make_journal,
    make_ring,
    replace_cavity,
    triangulate_ring,
    walk_ring,
    write_ring,
)
from odt_plugins.engine.topology.active import DONE, PENDING
from odt_plugins.engine.topology.tets import Tets, all_locked
from odt_plugins.mesh.arrays import FloatArray, IntArray

REAL = 1.0 - 1e-9
"""A flip is taken when the cost after it is below this part of the cost before it."""
WITHIN_BOUNDS = 0.0
"""Allowance of a flip that must lower the cost and keep the bounds."""


@kernel
def worst_of(
    tets: Tets, old: IntArray, n_old: int, bounds: Bounds
) -> tuple[Extremes, Extremes]:
    """Worst of the bounds and the first n_old cells of ``old``: of all, of the locked ones."""
    cells = tets.cells
    limit, locked = bounds.cells, bounds.locked
    for m in range(n_old):
        c = old[m]
        own = cell_extremes(tets.points, cells, c)
        limit = worse(limit, own)
        if all_locked(tets, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3]):
            locked = worse(locked, own)
    return limit, locked


@kernel
def admissible(
    tets: Tets, old: IntArray, n_old: int, new: IntArray, n_new: int, objective: int,
    bounds: Bounds,
) -> bool:
    """Whether no new cell is worse than both the bounds and the worst cell it replaces.

    A cell with locked vertices only can never be repaired by smoothing: it is held to the worst
    such cell among the old ones, other cells to the worst of all.  In the energy objective, which
    smoothing and finishing follow, only the locked cells are held to anything.
    """
    points = tets.points
    free = locked = BEST
    for m in range(n_new):
        is_locked = all_locked(tets, new[m, 0], new[m, 1], new[m, 2], new[m, 3])
        if is_energy(objective) and not is_locked:
            continue
        # as the numbers of cells are: for another type it would be compiled once more
        own = cell_extremes(points, new, np.int32(m))
        if is_locked:
            locked = worse(locked, own)
        else:
            free = worse(free, own)
    if keeps(free, bounds.cells) and keeps(locked, bounds.locked):
        return True
    limit, locked_limit = worst_of(tets, old, n_old, bounds)
    return keeps(free, limit) and keeps(locked, locked_limit)


@kernel
def remove_edge(
    tets: Tets, c: int, e: int, cost: Cost, max_ring: int, bounds: Bounds, allowance: float,
    ring: Ring, journal: Journal,
) -> tuple[float, int]:
    """Remove edge e of cell c if that lowers the cost, or raises it by less than the allowance.

    With any ``allowance`` but WITHIN_BOUNDS no bounds hold the flip back, and cells that were
    visited before take part in it.

    Returns
    -------
    gain : float     cost before minus cost after; 0 when nothing was done
    n_new : int      new cells, whose slots are in ``ring.cells``
    """
    a, b, n, before = ring_worth(tets, c, e, cost, max_ring, allowance, ring)
    if n == 0:
        return 0.0, 0
    return _fill_ring(tets, a, b, n, before, cost, bounds, allowance, ring, journal)


@inlined_kernel
def ring_worth(
    tets: Tets, c: int, e: int, cost: Cost, max_ring: int, allowance: float, ring: Ring
) -> tuple[int, int, int, float]:
    """Look at the ring of edge e of cell c, before anything is tried; see :func:`remove_edge`.

    It is apart from what follows, since most edges end here and a call hands on every array.

    Returns
    -------
    a, b : int       ends of the edge
    n : int          length of the ring; 0 where no filling of it can lower the cost enough
    before : float   cost of the cells around the edge
    """
    once = not is_energy(cost.objective) and not allowance > WITHIN_BOUNDS
    a, b, n = walk_ring(tets, c, e, max_ring, once, ring)
    if n < 3:
        return a, b, 0, 0.0
    before = 0.0
    for m in range(n):
        before += known_cost(tets, ring.cells[m], cost, ring)
    if _cost_below(before, allowance) <= 2.0 * (n - 2) * least_cost(cost.objective):
        n = 0
    return a, b, n, before


@inlined_kernel
def _cost_below(before: float, allowance: float) -> float:
    """Cost below which a flip is taken."""
    return before + allowance if allowance > WITHIN_BOUNDS else before * REAL


@kernel
def _fill_ring(
    tets: Tets, a: int, b: int, n: int, before: float, cost: Cost, bounds: Bounds,
    allowance: float, ring: Ring, journal: Journal,
) -> tuple[float, int]:
    """Fill the ring of n cells found by :func:`ring_worth`; results as :func:`remove_edge`."""
    objective = cost.objective
    forced = allowance > WITHIN_BOUNDS
    limit = _cost_below(before, allowance)
    after = triangulate_ring(tets.points, a, b, n, cost, limit, ring)
    if not after < limit:
        return 0.0, 0
    n_new = write_ring(a, b, n, ring)
    if not forced and not admissible(tets, ring.cells, n, ring.new, n_new, objective, bounds):
        return 0.0, 0
    if not replace_cavity(tets, ring.cells, n, ring.new, n_new, ring.border, journal):
        return 0.0, 0
    forget_costs(n_new, ring)
    return before - after, n_new


@kernel
def flip_facet(
    tets: Tets, c: int, f: int, cost: Cost, bounds: Bounds, allowance: float, ring: Ring,
    journal: Journal,
) -> tuple[float, int]:
    """2-3 flip of facet f of cell c; arguments and results as :func:`remove_edge`."""
    before, across = facet_worth(tets, c, f, cost, allowance, ring)
    if across < 0:
        return 0.0, 0
    return _flip_facet(tets, c, f, across, before, cost, bounds, allowance, ring, journal)


@inlined_kernel
def facet_worth(
    tets: Tets, c: int, f: int, cost: Cost, allowance: float, ring: Ring
) -> tuple[float, np.int64]:
    """As :func:`ring_worth` for facet f of cell c: cost of its cells, the cell across or -1."""
    objective = cost.objective
    across = np.int64(tets.neighbors[c, f])
    if across < 0 or tets.regions[across] != tets.regions[c]:
        return 0.0, np.int64(-1)
    once = not is_energy(objective) and allowance <= WITHIN_BOUNDS
    if once and tets.status[across] == DONE:
        return 0.0, np.int64(-1)
    before = known_cost(tets, c, cost, ring) + known_cost(tets, across, cost, ring)
    if _cost_below(before, allowance) <= 3.0 * least_cost(objective):
        across = np.int64(-1)
    return before, across


@kernel
def _flip_facet(
    tets: Tets, c: int, f: int, across: np.int64, before: float, cost: Cost, bounds: Bounds,
    allowance: float, ring: Ring, journal: Journal,
) -> tuple[float, int]:
    """Flip a facet found by :func:`facet_worth`."""
    points, cells, objective = tets.points, tets.cells, cost.objective
    around, new = ring.cells, ring.new
    forced = allowance > WITHIN_BOUNDS
    limit = _cost_below(before, allowance)
    apex = apex_across(cells, c, f, across)
    base = cells[c, f]
    u, v, w = opposite_vertices(cells, c, base)
    after = tet_cost(points, base, u, v, apex, cost)
    if not after < limit:
        return 0.0, 0
    after += tet_cost(points, base, v, w, apex, cost)
    if not after < limit:
        return 0.0, 0
    after += tet_cost(points, base, w, u, apex, cost)
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
    if not forced and not admissible(tets, around, n_old, new, n_new, objective, bounds):
        return 0.0, 0
    if not replace_cavity(tets, around, n_old, new, n_new, ring.border, journal):
        return 0.0, 0
    forget_costs(n_new, ring)
    return before - after, int(n_new)


@inlined_kernel
def _improve_cell(
    tets: Tets, c: int, cost: Cost, max_ring: int, bounds: Bounds, ring: Ring, journal: Journal
) -> tuple[float, int]:
    """As :func:`improve_cell`, as part of its caller.

    With the energy only facets that are not locally Delaunay are looked at, and their edges,
    once: not again from a cell across that was visited and is still the same.
    """
    facets = 15
    if is_energy(cost.objective):
        points, cells, regions = tets.points, tets.cells, tets.regions
        facets = 0
        det, gx, gy, gz, size = circumsphere(
            points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3]
        )
        for f in range(4):
            across = tets.neighbors[c, f]
            if across < 0 or regions[across] != regions[c] or tets.status[across] == DONE:
                continue
            apex = apex_across(cells, c, f, across)
            if inside_sphere(points, cells, c, apex, det, gx, gy, gz, size):
                facets |= 1 << f
        if facets == 0:
            return 0.0, 0
    for e in range(6):
        _, _, k, l = local_edge(e)
        if facets & ((1 << k) | (1 << l)) == 0:
            continue
        a, b, n, before = ring_worth(tets, c, e, cost, max_ring, WITHIN_BOUNDS, ring)
        if n == 0:
            continue
        gain, n_new = _fill_ring(
            tets, a, b, n, before, cost, bounds, WITHIN_BOUNDS, ring, journal
        )
        if n_new > 0:
            return gain, n_new
    for f in range(4):
        if facets & (1 << f) == 0:
            continue
        before, across = facet_worth(tets, c, f, cost, WITHIN_BOUNDS, ring)
        if across < 0:
            continue
        gain, n_new = _flip_facet(
            tets, c, f, across, before, cost, bounds, WITHIN_BOUNDS, ring, journal
        )
        if n_new > 0:
            return gain, n_new
    return 0.0, 0


@kernel
def improve_cell(
    tets: Tets, c: int, cost: Cost, max_ring: int, bounds: Bounds, ring: Ring, journal: Journal
) -> tuple[float, int]:
    """Take the first flip at cell c that lowers the cost; results as :func:`remove_edge`."""
    return _improve_cell(tets, c, cost, max_ring, bounds, ring, journal)


@allocating_kernel
def flip_pass(
    tets: Tets, order: IntArray, cost: Cost, max_ring: int, bounds: Bounds, costs: FloatArray,
    remembers: bool,
) -> int:
    """Try every edge removal and 2-3 flip at the pending cells, in the given order.

    Parameters
    ----------
    tets : Tets                  changed in place
    order : (k,) int32           cells to visit, worst first
    cost : Cost
    max_ring : int               longest ring that edge removal takes
    bounds : Bounds
    costs : (room,) float64      of the cells, UNKNOWN where not computed; kept up to date
    remembers : bool             whether costs are looked up there, and not computed every time

    Returns
    -------
    int                          number of flips taken
    """
    ring = make_ring(costs, remembers)
    journal = make_journal(np.bool_(False), np.int64(0))
    flips = 0
    for o in range(order.shape[0]):
        c = order[o]
        if tets.status[c] != PENDING or tets.cells[c, 0] < 0:
            continue
        tets.status[c] = DONE
        _, n_new = _improve_cell(tets, c, cost, max_ring, bounds, ring, journal)
        if n_new > 0:
            flips += 1
    return flips


@allocating_kernel
def facet_pass(
    tets: Tets, order: IntArray, most: int, limit: float, cost: Cost, bounds: Bounds,
    costs: FloatArray,
) -> int:
    """Take at most so many 2-3 flips, whatever the two cells cost that become three.

    Parameters
    ----------
    tets : Tets                  changed in place
    order : (k,) int32           cells to visit
    most : int
    limit : float                what the three cost in sum at most
    cost : Cost
    bounds : Bounds
    costs : (room,) float64      place for costs of cells

    Returns
    -------
    int                          number of flips taken
    """
    ring = make_ring(costs, False)
    journal = make_journal(np.bool_(False), np.int64(0))
    flips = 0
    for o in range(order.shape[0]):
        c = order[o]
        for f in range(4):
            if flips == most or tets.cells[c, 0] < 0:
                break
            across = np.int64(tets.neighbors[c, f])
            if across < 0 or tets.regions[across] != tets.regions[c]:
                continue
            _, n_new = _flip_facet(
                tets, c, f, across, limit, cost, bounds, WITHIN_BOUNDS, ring, journal)
            if n_new > 0:
                flips += 1
                break
    return flips
