"""Flips of a tetrahedral mesh on incrementally kept adjacency (Section 3.1 in three dimensions).

Edge removal finds the best triangulation of the ring by dynamic programming (Klincsek 1980);
with rings of 3 and 4 it contains the 3-2 and 4-4 flips.  The 2-3 flip is its inverse on one
facet.  Each is taken only when the sum of the cell costs strictly falls, so that a sequence of
flips terminates.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from odt_plugins.engine.tetrahedron import (
    ENERGY,
    tet_cosines,
    tet_cost,
    tet_quality,
)

IDLE, PENDING, DONE = 0, 1, 2
MAX_RING = 10


@njit(nogil=True, cache=True)
def _edge(e):
    """Local vertices (i, j, k, l) of edge e = (i, j), an even permutation."""
    if e == 0:
        return 0, 1, 2, 3
    if e == 1:
        return 0, 2, 3, 1
    if e == 2:
        return 0, 3, 1, 2
    if e == 3:
        return 1, 2, 0, 3
    if e == 4:
        return 1, 3, 2, 0
    return 2, 3, 0, 1


@njit(nogil=True, cache=True)
def _walk_ring(cells, neighbors, regions, c, e, ring, around):
    """Collect the ring of edge e of cell c: its ends and length, 0 if the edge must stay."""
    i, j, k, l = _edge(e)
    a = cells[c, i]
    b = cells[c, j]
    first = cells[c, k]
    head = cells[c, l]
    ring[0] = first
    behind = k
    n = 0
    current = c
    while True:
        around[n] = current
        n += 1
        if head == first:
            return a, b, n
        if n == MAX_RING:
            return a, b, 0
        ring[n] = head
        across = neighbors[current, behind]
        if across < 0 or regions[across] != regions[c]:
            return a, b, 0
        pivot = head
        for m in range(4):
            v = cells[across, m]
            if v == pivot:
                behind = m
            elif v != a and v != b:
                head = v
        current = across


@njit(nogil=True, cache=True)
def _triangulate_ring(points, a, b, ring, n, objective, power, best, split):
    """Least cost over all triangulations of the ring, by dynamic programming (Klincsek 1980)."""
    for i in range(n - 1):
        best[i, i + 1] = 0.0
    for span in range(2, n):
        for i in range(n - span):
            j = i + span
            best[i, j] = np.inf
            split[i, j] = -1
            for k in range(i + 1, j):
                below = best[i, k] + best[k, j]
                if below >= best[i, j]:
                    continue
                cost = below + tet_cost(points, a, ring[i], ring[k], ring[j], objective, power)
                if cost >= best[i, j]:
                    continue
                cost += tet_cost(points, ring[i], ring[k], ring[j], b, objective, power)
                if cost < best[i, j]:
                    best[i, j] = cost
                    split[i, j] = k
    return best[0, n - 1]


@njit(nogil=True, cache=True)
def _write_ring(a, b, ring, n, split, new, stack):
    """Write the cells of the triangulation found by :func:`_triangulate_ring`."""
    count = 0
    depth = 1
    stack[0, 0] = 0
    stack[0, 1] = n - 1
    while depth > 0:
        depth -= 1
        i = stack[depth, 0]
        j = stack[depth, 1]
        if j - i < 2:
            continue
        k = split[i, j]
        new[count, 0] = a
        new[count, 1] = ring[i]
        new[count, 2] = ring[k]
        new[count, 3] = ring[j]
        new[count + 1, 0] = ring[i]
        new[count + 1, 1] = ring[k]
        new[count + 1, 2] = ring[j]
        new[count + 1, 3] = b
        count += 2
        stack[depth, 0] = i
        stack[depth, 1] = k
        stack[depth + 1, 0] = k
        stack[depth + 1, 1] = j
        depth += 2
    return count


@njit(nogil=True, cache=True)
def _admissible(points, cells, locked, old, n_old, new, n_new, objective, bounds):
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


@njit(nogil=True, cache=True)
def _sorted3(cells, c, f):
    """Vertices of the facet opposite local vertex f, ascending."""
    x = cells[c, (f + 1) & 3]
    y = cells[c, (f + 2) & 3]
    z = cells[c, (f + 3) & 3]
    if x > y:
        x, y = y, x
    if y > z:
        y, z = z, y
    if x > y:
        x, y = y, x
    return x, y, z


@njit(nogil=True, cache=True)
def _replace_cavity(cells, neighbors, regions, status, old, n_old, new, n_new, slots,
                    free, rim):
    """Put the new cells in the place of the old ones and mend the adjacency around them.

    ``slots`` = [cells in use, length of the free list, out of room].  False when out of room.
    """
    if n_new - n_old > slots[1] + cells.shape[0] - slots[0]:
        slots[2] = 1
        return False
    label = regions[old[0]]
    n_rim = 0
    for m in range(n_old):
        c = old[m]
        for f in range(4):
            across = neighbors[c, f]
            inside = False
            for m2 in range(n_old):
                if old[m2] == across:
                    inside = True
                    break
            if inside:
                continue
            x, y, z = _sorted3(cells, c, f)
            rim[n_rim, 0] = x
            rim[n_rim, 1] = y
            rim[n_rim, 2] = z
            rim[n_rim, 3] = across
            rim[n_rim, 4] = -1
            if across >= 0:
                for g in range(4):
                    if neighbors[across, g] == c:
                        rim[n_rim, 4] = g
                        break
            n_rim += 1
    for m in range(n_new, n_old):
        c = old[m]
        cells[c, 0] = -1
        status[c] = IDLE
        free[slots[1]] = c
        slots[1] += 1
    for m in range(n_old, n_new):
        if slots[1] > 0:
            slots[1] -= 1
            old[m] = free[slots[1]]
        else:
            old[m] = slots[0]
            slots[0] += 1
    for m in range(n_new):
        c = old[m]
        for i in range(4):
            cells[c, i] = new[m, i]
        regions[c] = label
        status[c] = PENDING
        for f in range(4):
            x, y, z = _sorted3(cells, c, f)
            match = -1
            for r in range(n_rim):
                if rim[r, 0] == x and rim[r, 1] == y and rim[r, 2] == z:
                    match = r
                    break
            if match >= 0:
                across = rim[match, 3]
                neighbors[c, f] = across
                if across >= 0:
                    neighbors[across, rim[match, 4]] = c
                n_rim -= 1
                for t in range(5):
                    rim[match, t] = rim[n_rim, t]
            else:
                rim[n_rim, 0] = x
                rim[n_rim, 1] = y
                rim[n_rim, 2] = z
                rim[n_rim, 3] = c
                rim[n_rim, 4] = f
                n_rim += 1
    return True


@njit(nogil=True, cache=True)
def _outside_sphere(points, i, j, k, l, v):
    """Whether point v is outside the circumsphere of cell (i, j, k, l), or on it to rounding."""
    x = points[v, 0]
    y = points[v, 1]
    z = points[v, 2]
    ax = points[i, 0] - x
    ay = points[i, 1] - y
    az = points[i, 2] - z
    bx = points[j, 0] - x
    by = points[j, 1] - y
    bz = points[j, 2] - z
    cx = points[k, 0] - x
    cy = points[k, 1] - y
    cz = points[k, 2] - z
    dx = points[l, 0] - x
    dy = points[l, 1] - y
    dz = points[l, 2] - z
    aa = ax * ax + ay * ay + az * az
    bb = bx * bx + by * by + bz * bz
    cc = cx * cx + cy * cy + cz * cz
    dd = dx * dx + dy * dy + dz * dz
    ab = ax * by - bx * ay
    bc = bx * cy - cx * by
    cd = cx * dy - dx * cy
    da = dx * ay - ax * dy
    ac = ax * cy - cx * ay
    bd = bx * dy - dx * by
    abc = az * bc - bz * ac + cz * ab
    bcd = bz * cd - cz * bd + dz * bc
    cda = cz * da + dz * ac + az * cd
    dab = dz * ab + az * bd + bz * da
    inside = (cc * dab - dd * abc) + (aa * bcd - bb * cda)
    scale = max(max(aa, bb), max(cc, dd))
    return not inside > 1e-9 * scale * scale * np.sqrt(scale)


@njit(nogil=True, cache=True)
def flip_pass(points, cells, neighbors, regions, locked, status, order, slots, free,
              objective, power, max_ring, bounds, threshold):
    """Try every edge removal and 2-3 flip at the pending cells, in the given order.

    Parameters
    ----------
    points : (n, 3) float64
    cells, neighbors : (room, 4) int32    changed in place; free slots hold -1 in column 0
    regions : (room,) int32
    locked : (n,) bool                    vertices that no smoothing can move
    status : (room,) uint8                IDLE, PENDING or DONE; changed in place
    order : (k,) int32                    cells to visit, worst first
    slots, free                           see ``_replace_cavity``
    objective, power                      see ``tetrahedron.tet_cost``
    max_ring : int                        longest ring that edge removal takes
    bounds : (6,) float64                 least q, largest and smallest cosine that may appear;
                                          the same for a cell with locked vertices only
    threshold : float                     with QUALITY: cells of better quality are passed over

    Returns
    -------
    int                                   number of flips taken
    """
    ring = np.empty(MAX_RING, np.int32)
    around = np.empty(4 * MAX_RING, np.int32)
    new = np.empty((2 * MAX_RING, 4), np.int32)
    best = np.empty((MAX_RING, MAX_RING))
    split = np.empty((MAX_RING, MAX_RING), np.int32)
    stack = np.empty((2 * MAX_RING, 2), np.int32)
    rim = np.empty((16 * MAX_RING, 5), np.int32)
    flips = 0
    for o in range(order.shape[0]):
        c = order[o]
        if status[c] != PENDING or cells[c, 0] < 0:
            continue
        status[c] = DONE
        if objective != ENERGY and (
            tet_quality(points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3]) > threshold
        ):
            continue
        bad_facets = 15
        if objective == ENERGY:
            bad_facets = 0
            for f in range(4):
                across = neighbors[c, f]
                if across < 0 or regions[across] != regions[c]:
                    continue
                apex = -1
                for g in range(4):
                    if neighbors[across, g] == c:
                        apex = cells[across, g]
                if not _outside_sphere(
                    points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3], apex
                ):
                    bad_facets |= 1 << f
            if bad_facets == 0:
                continue
        flipped = False
        for e in range(6):
            i, j, k, l = _edge(e)
            if bad_facets & ((1 << k) | (1 << l)) == 0:
                continue
            a, b, n = _walk_ring(cells, neighbors, regions, c, e, ring, around)
            if n < 3 or n > max_ring:
                continue
            before = 0.0
            seen = False
            for m in range(n):
                t = around[m]
                if objective != ENERGY and status[t] == DONE and t != c:
                    seen = True
                    break
                before += tet_cost(
                    points, cells[t, 0], cells[t, 1], cells[t, 2], cells[t, 3], objective, power
                )
            if seen:
                continue
            after = _triangulate_ring(points, a, b, ring, n, objective, power, best, split)
            if not after < before * (1.0 - 1e-9):
                continue
            n_new = _write_ring(a, b, ring, n, split, new, stack)
            if not _admissible(
                points, cells, locked, around, n, new, n_new, objective, bounds
            ):
                continue
            if _replace_cavity(cells, neighbors, regions, status, around, n, new, n_new,
                               slots, free, rim):
                flips += 1
                flipped = True
                break
        if flipped:
            continue
        for f in range(4):
            if bad_facets & (1 << f) == 0:
                continue
            across = neighbors[c, f]
            if across < 0 or regions[across] != regions[c]:
                continue
            if status[across] == DONE and objective != ENERGY:
                continue
            apex = -1
            for g in range(4):
                if neighbors[across, g] == c:
                    apex = cells[across, g]
            if f == 0:
                i, j, k = 1, 2, 3
            elif f == 1:
                i, j, k = 0, 3, 2
            elif f == 2:
                i, j, k = 0, 1, 3
            else:
                i, j, k = 0, 2, 1
            base = cells[c, f]
            u = cells[c, i]
            v = cells[c, j]
            w = cells[c, k]
            before = tet_cost(
                points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3], objective, power
            ) + tet_cost(
                points, cells[across, 0], cells[across, 1], cells[across, 2], cells[across, 3],
                objective, power,
            )
            before *= 1.0 - 1e-9
            after = tet_cost(points, base, u, v, apex, objective, power)
            if not after < before:
                continue
            after += tet_cost(points, base, v, w, apex, objective, power)
            if not after < before:
                continue
            after += tet_cost(points, base, w, u, apex, objective, power)
            if not after < before:
                continue
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
            if not _admissible(
                points, cells, locked, around, 2, new, 3, objective, bounds
            ):
                continue
            if _replace_cavity(cells, neighbors, regions, status, around, 2, new, 3,
                               slots, free, rim):
                flips += 1
                break
    return flips
