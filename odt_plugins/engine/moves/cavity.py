"""Cavities of a tetrahedral mesh: rings around an edge, their best filling, and the exchange.

The ring of an edge is filled by dynamic programming (Klincsek 1980).  Every write of an exchange
can be journalled, so that a sequence of flips that does not pay is taken back.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.cost import Cost, least_cost
from odt_plugins.engine.cells.measures import cell_cost, tet_cost
from odt_plugins.engine.cells.sphere import apex_across
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.topology.active import DONE, IDLE, PENDING
from odt_plugins.engine.topology.lookup import place_in
from odt_plugins.engine.topology.tets import FREE, USED, Tets, give_slot, has_room, take_slot
from odt_plugins.mesh.arrays import FloatArray, IntArray, LongArray

MAX_RING = 10
"""Most vertices around an edge that is removed; the table of a ring grows with their square."""
CELL, NEIGHBOR, STATUS, STACK, SLOT = np.arange(5, dtype=np.int64)
"""What was overwritten, in an entry of a journal: an entry of ``cells``, ``neighbors``, ``status``,
``free`` or ``slots``."""
WRITES = 20
"""Most entries of a journal for every cell of an exchange; two more are for the slots."""
UNKNOWN = 0.0
"""Cost of a cell that was not computed yet; arrays of zeros take no memory until they are used."""


class Ring(NamedTuple):
    """Room in which one thread looks at the cells around an edge; made by :func:`make_ring`.

    Attributes
    ----------
    vertices : (MAX_RING,) int32       around the edge, in order
    cells : (4 MAX_RING,) int32        around the edge; after an exchange those in their place
    new : (2 MAX_RING, 4) int32        vertices of the cells that are to come
    best : (MAX_RING, MAX_RING) float64, split : same shape, int32
        least cost of a part of the ring, and the vertex with which it is reached
    stack : (2 MAX_RING, 2) int32      parts that are still to be written
    border : (16 MAX_RING, 5) int32    facets around the cavity, see :func:`replace_cavity`
    costs : (room,) float64            costs of the cells, UNKNOWN where not computed
    remembers : bool                   whether ``costs`` is in use; only where no vertex moves
    """

    vertices: IntArray
    cells: IntArray
    new: IntArray
    best: FloatArray
    split: IntArray
    stack: IntArray
    border: IntArray
    costs: FloatArray
    remembers: bool


class Journal(NamedTuple):
    """What was overwritten, so that it can be taken back; made by :func:`make_journal`.

    Attributes
    ----------
    on : bool                    nothing is written down without it
    length : (1,) int64          entries in use
    entries : (k, 4) int64       kind, row, column and value of what was overwritten
    """

    on: bool
    length: LongArray
    entries: LongArray


@allocating_kernel
def make_ring(costs: FloatArray, remembers: bool) -> Ring:
    """Room for one thread; ``costs`` (room,) are remembered if that is asked for."""
    return Ring(
        np.empty(MAX_RING, np.int32),
        np.empty(4 * MAX_RING, np.int32),
        np.empty((2 * MAX_RING, 4), np.int32),
        np.empty((MAX_RING, MAX_RING)),
        np.empty((MAX_RING, MAX_RING), np.int32),
        np.empty((2 * MAX_RING, 2), np.int32),
        np.empty((16 * MAX_RING, 5), np.int32),
        costs,
        remembers,
    )


@allocating_kernel
def make_journal(on: bool, room: int) -> Journal:
    """Journal for so many entries."""
    return Journal(on, np.zeros(1, np.int64), np.empty((room, 4), np.int64))


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
    tets: Tets, c: int, e: int, longest: int, fresh: bool, ring: Ring
) -> tuple[int, int, int]:
    """Collect the ring of edge e of cell c: its ends and length, 0 if the edge must stay.

    That is so on a boundary or interface, when the ring is longer than ``longest``, and when it
    is to be ``fresh`` but a cell around the edge was visited before.
    """
    cells, neighbors, regions = tets.cells, tets.neighbors, tets.regions
    vertices, around = ring.vertices, ring.cells
    i, j, k, l = local_edge(e)
    a = cells[c, i]
    b = cells[c, j]
    first = cells[c, k]
    head = cells[c, l]
    vertices[0] = first
    behind = k
    current = c
    for n in range(1, longest + 1):
        around[n - 1] = current
        if head == first:
            return a, b, n
        if n == longest:
            break
        vertices[n] = head
        across = neighbors[current, behind]
        if across < 0 or regions[across] != regions[c]:
            return a, b, 0
        if fresh and tets.status[across] == DONE:
            return a, b, 0
        pivot = head
        for m in range(4):
            v = cells[across, m]
            if v == pivot:
                behind = m
            elif v != a and v != b:
                head = v
        current = across
    return a, b, 0


@kernel
def known_cost(tets: Tets, c: int, cost: Cost, ring: Ring) -> float:
    """Cost of cell c, remembered until the cell is replaced where that is switched on."""
    if not ring.remembers:
        return cell_cost(tets.points, tets.cells, c, cost)
    costs = ring.costs
    if costs[c] == UNKNOWN:
        costs[c] = cell_cost(tets.points, tets.cells, c, cost)
    return costs[c]


@kernel
def forget_costs(n: int, ring: Ring) -> None:
    """Forget the costs of the first n of ``ring.cells``, which were replaced."""
    if ring.remembers:
        for m in range(n):
            ring.costs[ring.cells[m]] = UNKNOWN


@kernel
def triangulate_ring(
    points: FloatArray, a: int, b: int, n: int, cost: Cost, limit: float, ring: Ring
) -> float:
    """Least cost over all triangulations of the ring, by dynamic programming (Klincsek 1980).

    Only triangulations that cost less than ``limit`` are looked for; infinite if there is none.
    No triangle costs less than two perfect cells, which cuts most of the table short.
    """
    vertices, best, split = ring.vertices, ring.best, ring.split
    least = 2.0 * least_cost(cost.objective)
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
                x, y, z = vertices[i], vertices[k], vertices[j]
                total = below + tet_cost(points, a, x, y, z, cost)
                if total + 0.5 * least >= min(best[i, j], outside):
                    continue
                total += tet_cost(points, x, y, z, b, cost)
                if total < min(best[i, j], outside):
                    best[i, j] = total
                    split[i, j] = k
    return best[0, n - 1]


@kernel
def write_ring(a: int, b: int, n: int, ring: Ring) -> int:
    """Write the cells of the triangulation found by :func:`triangulate_ring`; their number."""
    vertices, split, new, stack = ring.vertices, ring.split, ring.new, ring.stack
    count = 0
    depth = 1
    stack[0, 0] = 0
    stack[0, 1] = n - 1
    # its n - 2 triangles, and the n - 1 edges of the ring between the ends
    for _ in range(2 * n - 3):
        depth -= 1
        i = stack[depth, 0]
        j = stack[depth, 1]
        if j - i < 2:
            continue
        k = split[i, j]
        new[count, 0] = a
        new[count, 1] = vertices[i]
        new[count, 2] = vertices[k]
        new[count, 3] = vertices[j]
        new[count + 1, 0] = vertices[i]
        new[count + 1, 1] = vertices[k]
        new[count + 1, 2] = vertices[j]
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
def _note(journal: Journal, kind: int, a: int, b: int, value: int) -> None:
    """Remember an entry before it is overwritten.

    All numbers are to be int64: for any other type, and for a literal, it would be compiled anew.
    """
    if not journal.on:
        return
    n = journal.length[0]
    journal.length[0] = n + 1
    entries = journal.entries
    entries[n, 0] = kind
    entries[n, 1] = a
    entries[n, 2] = b
    entries[n, 3] = value


@kernel
def take_back(tets: Tets, journal: Journal) -> None:
    """Undo all journalled writes, the last one first."""
    entries = journal.entries
    for n in range(journal.length[0] - 1, -1, -1):
        kind = entries[n, 0]
        a = entries[n, 1]
        b = entries[n, 2]
        value = entries[n, 3]
        if kind == CELL:
            tets.cells[a, b] = value
        elif kind == NEIGHBOR:
            tets.neighbors[a, b] = value
        elif kind == STATUS:
            tets.status[a] = value
        elif kind == STACK:
            tets.free[a] = value
        else:
            tets.slots[a] = value
    journal.length[0] = 0


@kernel
def replace_cavity(
    tets: Tets, old: IntArray, n_old: int, new: IntArray, n_new: int, border: IntArray,
    journal: Journal,
) -> bool:
    """Put new cells in the place of old ones and mend the adjacency around them.

    Parameters
    ----------
    old : (k,) int32            the first n_old are the cells that go; OUT: the n_new that came
    new : (k, 4) int32          vertices of the cells that come
    border : (k, 5) int32       room for the facets that have a cell on one side only so far:
                                three vertices, that cell, and its vertex opposite to the facet

    Returns
    -------
    bool                        False when there is no room for the cells or in the journal
    """
    cells, neighbors, regions, status = tets.cells, tets.neighbors, tets.regions, tets.status
    slots, free = tets.slots, tets.free
    if not has_room(tets, n_new - n_old):
        return False
    most = WRITES * (n_old + n_new) + 2
    if journal.on and journal.length[0] + most >= journal.entries.shape[0]:
        return False
    first = np.int64(0)
    if journal.on:
        _note(journal, SLOT, first + USED, first, slots[USED])
        _note(journal, SLOT, first + FREE, first, slots[FREE])
    label = regions[old[0]]
    n_border = 0
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
            border[n_border, 0] = x
            border[n_border, 1] = y
            border[n_border, 2] = z
            border[n_border, 3] = across
            if across >= 0:
                border[n_border, 4] = place_in(cells, across, apex_across(cells, c, f, across))
            n_border += 1
    for m in range(n_new, n_old):
        c = np.int64(old[m])
        _note(journal, CELL, c, first, np.int64(cells[c, 0]))
        _note(journal, STATUS, c, first, np.int64(status[c]))
        _note(journal, STACK, slots[FREE], first, np.int64(free[slots[FREE]]))
        status[c] = IDLE
        give_slot(tets, c)
    for m in range(n_old, n_new):
        old[m] = take_slot(tets)
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
            for r in range(n_border):
                if border[r, 0] == x and border[r, 1] == y and border[r, 2] == z:
                    match = r
                    break
            if match >= 0:
                beyond = np.int64(border[match, 3])
                neighbors[c, f] = beyond
                if beyond >= 0:
                    local = np.int64(border[match, 4])
                    _note(journal, NEIGHBOR, beyond, local, np.int64(neighbors[beyond, local]))
                    neighbors[beyond, local] = c
                n_border -= 1
                for t in range(5):
                    border[match, t] = border[n_border, t]
            else:
                neighbors[c, f] = -1
                border[n_border, 0] = x
                border[n_border, 1] = y
                border[n_border, 2] = z
                border[n_border, 3] = c
                border[n_border, 4] = f
                n_border += 1
    # Among flat cells a facet may be there more than twice: nothing leads to cells that went.
    for r in range(n_border):
        beyond = np.int64(border[r, 3])
        if beyond >= 0:
            local = np.int64(border[r, 4])
            _note(journal, NEIGHBOR, beyond, local, np.int64(neighbors[beyond, local]))
            neighbors[beyond, local] = -1
    return True
