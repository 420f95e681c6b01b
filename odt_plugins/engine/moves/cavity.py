"""Cavities of a tetrahedral mesh: rings around an edge, their best filling, and the exchange.

The ring of an edge is filled by dynamic programming (Klincsek 1980).  Every write of an exchange
can be journalled, so that a sequence of flips that does not pay is taken back.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.tetrahedron import ENERGY, tet_cost
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.topology.active import DONE, IDLE, PENDING
from odt_plugins.mesh.arrays import ByteArray, FloatArray, IntArray, LongArray

MAX_RING = 10
"""Most vertices around an edge that is removed; the table of a ring grows with their square."""
CELL, NEIGHBOR, STATUS, FREE, SLOT = np.arange(5, dtype=np.int64)
"""What an entry of a journal says was overwritten."""
UNKNOWN = 0.0
"""Cost of a cell that was not computed yet; arrays of zeros take no memory until they are used."""

Work = tuple[IntArray, IntArray, IntArray, FloatArray, IntArray, IntArray, IntArray, FloatArray]


@allocating_kernel
def make_work(costs: FloatArray) -> Work:
    """Work arrays for one thread: ring, cells around, new cells, table, splits, stack, rim, costs.

    ``costs`` (room,) holds what is known of the cells' costs, see :func:`cell_cost`; empty when
    the cells change in other ways than by flips.
    """
    return (
        np.empty(MAX_RING, np.int32),
        np.empty(4 * MAX_RING, np.int32),
        np.empty((2 * MAX_RING, 4), np.int32),
        np.empty((MAX_RING, MAX_RING)),
        np.empty((MAX_RING, MAX_RING), np.int32),
        np.empty((2 * MAX_RING, 2), np.int32),
        np.empty((16 * MAX_RING, 5), np.int32),
        costs,
    )


@kernel
def local_edge(e: int) -> tuple[int, int, int, int]:
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


@kernel
def walk_ring(
    cells: IntArray, neighbors: IntArray, regions: IntArray, status: ByteArray, c: int, e: int,
    longest: int, fresh: bool, ring: IntArray, around: IntArray,
) -> tuple[int, int, int]:
    """Collect the ring of edge e of cell c: its ends and length, 0 if the edge must stay.

    That is so on a boundary or interface, when the ring is longer than ``longest``, and when it
    is to be ``fresh`` but a cell around the edge was visited before.
    """
    i, j, k, l = local_edge(e)
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
        if n == longest:
            return a, b, 0
        ring[n] = head
        across = neighbors[current, behind]
        if across < 0 or regions[across] != regions[c] or (fresh and status[across] == DONE):
            return a, b, 0
        pivot = head
        for m in range(4):
            v = cells[across, m]
            if v == pivot:
                behind = m
            elif v != a and v != b:
                head = v
        current = across


@kernel
def cell_cost(
    points: FloatArray, cells: IntArray, c: int, objective: int, power: float, costs: FloatArray
) -> float:
    """Cost of cell c, remembered in ``costs`` until the cell is replaced."""
    if costs.shape[0] == 0:
        return tet_cost(
            points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3], objective, power
        )
    if costs[c] == UNKNOWN:
        costs[c] = tet_cost(
            points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3], objective, power
        )
    return costs[c]


@kernel
def triangulate_ring(
    points: FloatArray, a: int, b: int, ring: IntArray, n: int, objective: int, power: float,
    limit: float, best: FloatArray, split: IntArray,
) -> float:
    """Least cost over all triangulations of the ring, by dynamic programming (Klincsek 1980).

    Only triangulations that cost less than ``limit`` are looked for; infinite if there is none.
    No triangle costs less than two perfect cells, which cuts most of the table short.
    """
    least = 0.0 if objective == ENERGY else 2.0
    for i in range(n - 1):
        best[i, i + 1] = 0.0
    for span in range(2, n):
        outside = limit - least * (n - 1 - span)
        for i in range(n - span):
            j = i + span
            best[i, j] = np.inf
            split[i, j] = -1
            for k in range(i + 1, j):
                below = best[i, k] + best[k, j]
                if below + least >= min(best[i, j], outside):
                    continue
                cost = below + tet_cost(points, a, ring[i], ring[k], ring[j], objective, power)
                if cost + 0.5 * least >= min(best[i, j], outside):
                    continue
                cost += tet_cost(points, ring[i], ring[k], ring[j], b, objective, power)
                if cost < min(best[i, j], outside):
                    best[i, j] = cost
                    split[i, j] = k
    return best[0, n - 1]


@kernel
def write_ring(
    a: int, b: int, ring: IntArray, n: int, split: IntArray, new: IntArray, stack: IntArray,
) -> int:
    """Write the cells of the triangulation found by :func:`triangulate_ring`."""
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


@kernel
def _sorted3(cells: IntArray, c: int, f: int) -> tuple[int, int, int]:
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


@kernel
def _note(journal: LongArray, kind: int, a: int, b: int, value: int) -> None:
    """Remember an entry before it is overwritten; journal[0, 0] counts, -1 switches off.

    All numbers are to be int64: for any other type, and for a literal, it would be compiled anew.
    """
    n = journal[0, 0]
    if n < 0:
        return
    n += 1
    journal[0, 0] = n
    journal[n, 0] = kind
    journal[n, 1] = a
    journal[n, 2] = b
    journal[n, 3] = value


@kernel
def take_back(
    cells: IntArray, neighbors: IntArray, status: ByteArray, slots: LongArray, free: IntArray,
    journal: LongArray,
) -> None:
    """Undo all journalled writes, the last one first."""
    for n in range(journal[0, 0], 0, -1):
        kind = journal[n, 0]
        a = journal[n, 1]
        b = journal[n, 2]
        value = journal[n, 3]
        if kind == CELL:
            cells[a, b] = value
        elif kind == NEIGHBOR:
            neighbors[a, b] = value
        elif kind == STATUS:
            status[a] = value
        elif kind == FREE:
            free[a] = value
        else:
            slots[a] = value
    journal[0, 0] = 0


@kernel
def replace_cavity(
    cells: IntArray, neighbors: IntArray, regions: IntArray, status: ByteArray, old: IntArray,
    n_old: int, new: IntArray, n_new: int, slots: LongArray, free: IntArray, rim: IntArray,
    journal: LongArray,
) -> bool:
    """Put the new cells in the place of the old ones and mend the adjacency around them.

    ``slots`` = [cells in use, length of the free list, out of room].  False when there is no room
    for the cells or in the journal.
    """
    if n_new - n_old > slots[1] + cells.shape[0] - slots[0]:
        slots[2] = 1
        return False
    if journal[0, 0] >= 0 and journal[0, 0] + 20 * (n_old + n_new) + 2 >= journal.shape[0]:
        return False
    first = np.int64(0)
    if journal[0, 0] >= 0:
        _note(journal, SLOT, first, first, slots[0])
        _note(journal, SLOT, first + 1, first, slots[1])
    label = regions[old[0]]
    n_rim = 0
    for m in range(n_old):
        c = np.int64(old[m])
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
        c = np.int64(old[m])
        _note(journal, CELL, c, first, np.int64(cells[c, 0]))
        _note(journal, STATUS, c, first, np.int64(status[c]))
        _note(journal, FREE, slots[1], first, np.int64(free[slots[1]]))
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
        c = np.int64(old[m])
        _note(journal, STATUS, c, first, np.int64(status[c]))
        for i in range(4):
            _note(journal, CELL, c, i, np.int64(cells[c, i]))
            _note(journal, NEIGHBOR, c, i, np.int64(neighbors[c, i]))
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
                beyond = np.int64(rim[match, 3])
                neighbors[c, f] = beyond
                if beyond >= 0:
                    local = np.int64(rim[match, 4])
                    _note(journal, NEIGHBOR, beyond, local, np.int64(neighbors[beyond, local]))
                    neighbors[beyond, local] = c
                n_rim -= 1
                for t in range(5):
                    rim[match, t] = rim[n_rim, t]
            else:
                neighbors[c, f] = -1
                rim[n_rim, 0] = x
                rim[n_rim, 1] = y
                rim[n_rim, 2] = z
                rim[n_rim, 3] = c
                rim[n_rim, 4] = f
                n_rim += 1
    return True
