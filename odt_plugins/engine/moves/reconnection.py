"""Reconnection of small polyhedra: the best cells between the vertices around a bad one.

A few cells around a bad one make a polyhedron without a vertex inside.  Of all ways to fill it with
cells between its vertices the one of least cost is looked for by branch and bound: the facet that
fewest vertices fit comes first, and what every facet costs at least bounds what is to come
(Liu, Chen, Sun, *Small polyhedron reconnection for mesh improvement and its implementation based on
advancing front technique*, Int. J. Numer. Meth. Engng. 79 (2009) 1004-1018).  Edge removal, its
inverse and the flips are special cases; no sequence of them that lowers the cost step by step need
lead there.

Cells of positive volume whose facets match each other and the surface of the polyhedron fill it
exactly once, so nothing else has to be checked.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.extremes import BEST, Bounds, Extremes, keeps, rounded, worse
from odt_plugins.engine.cells.tetrahedron import (
    Cost,
    cell_cost,
    opposite_vertices,
    tet_cosines,
    tet_cost,
    tet_quality,
)
from odt_plugins.engine.compiled.kernel import allocating_kernel, inlined_kernel, inner_kernel
from odt_plugins.engine.moves.cavity import Journal, make_journal, replace_cavity
from odt_plugins.engine.moves.flips3d import REAL, worst_of
from odt_plugins.engine.topology.lookup import is_in
from odt_plugins.engine.topology.tets import Tets, all_locked
from odt_plugins.mesh.arrays import ByteArray, FloatArray, IntArray, LongArray

MOST_VERTICES, MOST_CELLS, MOST_NODES = 13, 24, 400
"""Of one polyhedron: vertices and cells, and nodes of the tree of its fillings that are visited."""
FACETS = MOST_VERTICES * (MOST_VERTICES - 1) * (MOST_VERTICES - 2) // 6
TETRAHEDRA = FACETS * (MOST_VERTICES - 3) // 4
"""Facets and cells that some vertices of a polyhedron can have."""
DEPTH = 48
"""Most cells of a filling."""
ALIKE = 1e-9
"""Costs that differ by no more than this part of them are equal: rounding, which is another for
another unit, must not decide between cells that are mirror images of each other."""
UNSEEN, EVEN, CLOSED = 0, 1, 3
"""Facet of no cell so far; one that wants a cell on its positive side, with its vertices in
ascending order (one more: on the other side); one between two cells, or a cell and the outside."""


class Room(NamedTuple):
    """Room in which one thread looks for fillings; made by :func:`make_room`.

    Vertices of the polyhedron go by their place in ``vertices``, facets and cells by the number
    that :func:`facet_number` and :func:`cell_number` give their vertices in ascending order.

    Attributes
    ----------
    cells : (MOST_CELLS + DEPTH,) int32    of the polyhedron; after an exchange those in their place
    vertices : (MOST_VERTICES,) int32      global numbers
    spoils : (MOST_CELLS,) int32           cells that would put a vertex inside
    beside : (MOST_CELLS, 4) float64       costs of the cells across its facets, nan where not
                                           computed
    corners : (FACETS, 3) int64            vertices of every facet
    state : (FACETS,) uint8                see :data:`UNSEEN`
    costs : (TETRAHEDRA,) float64          nan where not computed, inf where not allowed
    turned : (TETRAHEDRA,) uint8           1 when the vertices in ascending order are negative
    front, n_front : (DEPTH + 1, FACETS) and (DEPTH + 1,) int64
        facets at every depth that still want a cell
    total : (DEPTH + 1,) float64           cost of the cells so far
    fits, prices : (MOST_VERTICES,) int64, float64
        vertices that fit a facet, and what the cells cost
    choices, price : (DEPTH + 1, MOST_VERTICES) int64, float64
        the same at every depth for the chosen facet, the cheapest first
    n_choices, turn : (DEPTH + 1,) int64   how many they are, and how many of them were tried
    chosen : (DEPTH + 1, 4) int64          vertices of the cell at every depth; the first is the
                                           tried one, the others the chosen facet
    before : (DEPTH + 1, 4, 2) int64       its facets and their states before it came
    best : (DEPTH, 4) int64                the best filling so far
    new : (DEPTH, 4) int32                 the same by global numbers
    border : (4 MOST_CELLS + 4 DEPTH, 5) int32
        see ``cavity.replace_cavity``
    """

    cells: IntArray
    vertices: IntArray
    spoils: IntArray
    beside: FloatArray
    corners: LongArray
    state: ByteArray
    costs: FloatArray
    turned: ByteArray
    front: LongArray
    n_front: LongArray
    total: FloatArray
    fits: LongArray
    prices: FloatArray
    choices: LongArray
    price: FloatArray
    n_choices: LongArray
    turn: LongArray
    chosen: LongArray
    before: LongArray
    best: LongArray
    new: IntArray
    border: IntArray


@inner_kernel
def facet_number(a: int, b: int, c: int) -> int:
    """Number of the facet with the vertices a < b < c."""
    return c * (c - 1) * (c - 2) // 6 + b * (b - 1) // 2 + a


@inner_kernel
def cell_number(a: int, b: int, c: int, d: int) -> int:
    """Number of the cell with the vertices a < b < c < d."""
    return d * (d - 1) * (d - 2) * (d - 3) // 24 + facet_number(a, b, c)


@allocating_kernel
def make_room() -> Room:
    """Room for one thread."""
    corners = np.empty((FACETS, 3), np.int64)
    for c in range(MOST_VERTICES):
        for b in range(c):
            for a in range(b):
                n = facet_number(a, b, c)
                corners[n, 0] = a
                corners[n, 1] = b
                corners[n, 2] = c
    return Room(
        np.empty(MOST_CELLS + DEPTH, np.int32),
        np.empty(MOST_VERTICES, np.int32),
        np.empty(MOST_CELLS, np.int32),
        np.empty((MOST_CELLS, 4)),
        corners,
        np.empty(FACETS, np.uint8),
        np.empty(TETRAHEDRA),
        np.empty(TETRAHEDRA, np.uint8),
        np.empty((DEPTH + 1, FACETS), np.int64),
        np.empty(DEPTH + 1, np.int64),
        np.empty(DEPTH + 1),
        np.empty(MOST_VERTICES, np.int64),
        np.empty(MOST_VERTICES),
        np.empty((DEPTH + 1, MOST_VERTICES), np.int64),
        np.empty((DEPTH + 1, MOST_VERTICES)),
        np.empty(DEPTH + 1, np.int64),
        np.empty(DEPTH + 1, np.int64),
        np.empty((DEPTH + 1, 4), np.int64),
        np.empty((DEPTH + 1, 4, 2), np.int64),
        np.empty((DEPTH, 4), np.int64),
        np.empty((DEPTH, 4), np.int32),
        np.empty((4 * MOST_CELLS + 4 * DEPTH, 5), np.int32),
    )


@inner_kernel
def _place(vertices: IntArray, n: int, v: int) -> int:
    """Place of vertex v among the first n, -1 if it is not there."""
    for k in range(n):
        if vertices[k] == v:
            return k
    return -1


@inner_kernel
def _sorted_facet(a: int, b: int, c: int) -> tuple[int, int, int, int]:
    """Three vertices in ascending order, and 1 if that is an odd permutation."""
    odd = 0
    if a > b:
        a, b = b, a
        odd ^= 1
    if b > c:
        b, c = c, b
        odd ^= 1
    if a > b:
        a, b = b, a
        odd ^= 1
    return a, b, c, odd


@inner_kernel
def _encloses(tets: Tets, n: int, n_vertices: int, room: Room) -> bool:
    """Whether a vertex of the first n cells lies on no facet around them."""
    seen = 0
    for m in range(n):
        c = room.cells[m]
        for f in range(4):
            if is_in(tets.neighbors[c, f], room.cells, n):
                continue
            for a in range(4):
                if a != f:
                    seen |= 1 << _place(room.vertices, n_vertices, tets.cells[c, a])
    return seen != (1 << n_vertices) - 1


@inlined_kernel
def grow_polyhedron(tets: Tets, c: int, cost: Cost, room: Room) -> tuple[int, int]:
    """Collect cells around cell c until no more fit; the numbers of cells and of vertices.

    Cells between the vertices that are there come first, then the worst ones.
    """
    cells, neighbors, regions = tets.cells, tets.neighbors, tets.regions
    mine, vertices = room.cells, room.vertices
    n = np.int64(1)
    n_vertices = np.int64(4)
    n_spoils = np.int64(0)
    mine[0] = c
    room.beside[:] = np.nan
    for a in range(4):
        vertices[a] = cells[c, a]
    for _ in range(2 * MOST_CELLS):
        if n == MOST_CELLS:
            break
        found = -1
        most = 0.0
        for m in range(n):
            for f in range(4):
                t = neighbors[mine[m], f]
                if t < 0 or regions[t] != regions[c] or is_in(t, mine, n):
                    continue
                if is_in(t, room.spoils, n_spoils):
                    continue
                missing = 0
                for a in range(4):
                    if _place(vertices, n_vertices, cells[t, a]) < 0:
                        missing += 1
                if n_vertices + missing > MOST_VERTICES:
                    continue
                if math.isnan(room.beside[m, f]):
                    room.beside[m, f] = cell_cost(tets.points, cells, t, cost)
                badness = room.beside[m, f]
                rank = badness / (1.0 + badness) + (1.0 if missing == 0 else 0.0)
                if rank > most * (1.0 + ALIKE):
                    most = rank
                    found = t
        if found < 0:
            break
        more = n_vertices
        for a in range(4):
            v = cells[found, a]
            if _place(vertices, more, v) < 0:
                vertices[more] = v
                more += 1
        mine[n] = found
        if not _encloses(tets, n + 1, more, room):
            n += 1
            n_vertices = more
        elif n_spoils == MOST_CELLS:
            break
        else:
            room.spoils[n_spoils] = found
            n_spoils += 1
    return int(n), int(n_vertices)


@inner_kernel
def _inserted(x: int, a: int, b: int, c: int) -> tuple[int, int, int, int, int]:
    """The vertices x and a < b < c in ascending order, and how many are less than x."""
    if x < a:
        return x, a, b, c, 0
    if x < b:
        return a, x, b, c, 1
    if x < c:
        return a, b, x, c, 2
    return a, b, c, x, 3


@inlined_kernel
def _begin(tets: Tets, n: int, n_vertices: int, cost: Cost, room: Room) -> None:
    """Make the facets around the first n cells the front, and forget all costs but theirs.

    They may stay whatever their shape: with its vertices in another order a cell that is as bad as
    the limit could pass it by rounding.
    """
    room.state[:] = UNSEEN
    room.costs[:] = np.nan
    front = np.int64(0)
    for m in range(n):
        c = room.cells[m]
        x = _place(room.vertices, n_vertices, tets.cells[c, 0])
        a, b, d, odd = _sorted_facet(
            _place(room.vertices, n_vertices, tets.cells[c, 1]),
            _place(room.vertices, n_vertices, tets.cells[c, 2]),
            _place(room.vertices, n_vertices, tets.cells[c, 3]),
        )
        i, j, k, l, less = _inserted(x, a, b, d)
        number = cell_number(i, j, k, l)
        room.costs[number] = cell_cost(tets.points, tets.cells, c, cost)
        room.turned[number] = (less ^ odd) & 1
        for f in range(4):
            if is_in(tets.neighbors[c, f], room.cells, n):
                continue
            i, j, k = opposite_vertices(tets.cells, c, tets.cells[c, f])
            a, b, d, odd = _sorted_facet(
                _place(room.vertices, n_vertices, i), _place(room.vertices, n_vertices, j),
                _place(room.vertices, n_vertices, k),
            )
            number = facet_number(a, b, d)
            room.state[number] = EVEN + odd
            room.front[0, front] = number
            front += 1
    room.n_front[0] = front
    room.total[0] = 0.0


@inlined_kernel
def _weigh(
    tets: Tets, a: int, b: int, c: int, d: int, cost: Cost, most: float, limit: Extremes,
    locked: Extremes, room: Room,
) -> None:
    """Write down what the cell a < b < c < d costs, infinite beyond the limits or ``most``."""
    points, vertices = tets.points, room.vertices
    i, j, k, l = vertices[a], vertices[b], vertices[c], vertices[d]
    turned = 0
    own = tet_cost(points, i, j, k, l, cost)
    if own == np.inf:
        i, j = j, i
        turned = 1
        own = tet_cost(points, i, j, k, l, cost)
    if own < most:
        large, small = tet_cosines(points, i, j, k, l)
        shape = Extremes(tet_quality(points, i, j, k, l), large, small)
        if not keeps(shape, locked if all_locked(tets, i, j, k, l) else limit):
            own = np.inf
    else:
        own = np.inf
    n = cell_number(a, b, c, d)
    room.costs[n] = own
    room.turned[n] = turned


@inlined_kernel
def _beside(a: int, b: int, c: int, odd: int, place: int, x: int) -> tuple[int, int]:
    """Number and state of the facet that is left open when x closes facet (a, b, c)."""
    if place == 0:
        a = x
    elif place == 1:
        b = x
    else:
        c = x
    a, b, c, more = _sorted_facet(a, b, c)
    return facet_number(a, b, c), EVEN + (odd ^ more)


@inlined_kernel
def _matches(a: int, b: int, c: int, odd: int, x: int, state: ByteArray) -> bool:
    """Whether every other facet of the cell of x and facet (a, b, c) is still wanted, or unseen."""
    for place in range(3):
        other, wanted = _beside(a, b, c, odd, place, x)
        if state[other] == CLOSED or state[other] == wanted:
            return False
    return True


@inlined_kernel
def _branch(
    tets: Tets, depth: int, n_vertices: int, cost: Cost, most: float, left: float,
    limit: Extremes, locked: Extremes, room: Room,
) -> None:
    """Choose the facet that fewest vertices fit, and put these in the order of their costs.

    There are no choices where a facet fits no vertex, or all together cost more than is ``left``.
    """
    state, costs, turned, prices = room.state, room.costs, room.turned, room.prices
    choices, n_choices = room.choices[depth], 0
    room.n_choices[depth] = 0
    room.turn[depth] = 0
    fewest = MOST_VERTICES + 1
    together = 0.0
    for p in range(room.n_front[depth]):
        facet = room.front[depth, p]
        a, b, c = room.corners[facet, 0], room.corners[facet, 1], room.corners[facet, 2]
        odd = np.int64(state[facet]) - EVEN
        count = 0
        least = np.inf
        for x in range(n_vertices):
            if x == a or x == b or x == c:
                continue
            i, j, k, l, less = _inserted(x, a, b, c)
            n = cell_number(i, j, k, l)
            if math.isnan(costs[n]):
                _weigh(tets, i, j, k, l, cost, most, limit, locked, room)
            own = costs[n]
            if not own < left or turned[n] != (less ^ odd) & 1:
                continue
            if _matches(a, b, c, odd, x, state):
                room.fits[count] = x
                prices[count] = own
                count += 1
                least = min(least, own)
        # no cell has more than four of the facets
        together += 0.25 * least
        if not max(least, together) < left:
            return
        if count < fewest:
            fewest = count
            room.before[depth, 3, 0] = facet
            n_choices = count
            for m in range(count):
                place = m
                for _ in range(m):
                    if room.price[depth, place - 1] <= prices[m] * (1.0 + ALIKE):
                        break
                    choices[place] = choices[place - 1]
                    room.price[depth, place] = room.price[depth, place - 1]
                    place -= 1
                choices[place] = room.fits[m]
                room.price[depth, place] = prices[m]
    room.n_choices[depth] = n_choices


@inlined_kernel
def _put_cell(depth: int, x: int, room: Room) -> None:
    """Put the cell of vertex x on the chosen facet; what is open then is the next front."""
    state, front, before = room.state, room.front, room.before
    chosen = before[depth, 3, 0]
    room.chosen[depth, 0] = x
    n = np.int64(0)
    for p in range(room.n_front[depth]):
        if front[depth, p] != chosen:
            front[depth + 1, n] = front[depth, p]
            n += 1
    odd = np.int64(state[chosen]) - EVEN
    before[depth, 3, 1] = state[chosen]
    a, b, c = room.corners[chosen, 0], room.corners[chosen, 1], room.corners[chosen, 2]
    room.chosen[depth, 1] = a if odd == 0 else b
    room.chosen[depth, 2] = b if odd == 0 else a
    room.chosen[depth, 3] = c
    for place in range(3):
        other, wanted = _beside(a, b, c, odd, place, x)
        before[depth, place, 0] = other
        before[depth, place, 1] = state[other]
        if state[other] == UNSEEN:
            state[other] = wanted
            front[depth + 1, n] = other
            n += 1
            continue
        state[other] = CLOSED
        for p in range(n):
            if front[depth + 1, p] == other:
                n -= 1
                front[depth + 1, p] = front[depth + 1, n]
                break
    state[chosen] = CLOSED
    room.n_front[depth + 1] = n


@inlined_kernel
def fill_polyhedron(
    tets: Tets, n_vertices: int, cost: Cost, most: float, limit: Extremes, locked: Extremes,
    room: Room,
) -> tuple[float, int]:
    """Look for the filling of least cost below ``most``; its cost and number of cells, 0 if none.

    Parameters
    ----------
    limit : Extremes     that no cell may pass
    locked : Extremes    the same for cells with locked vertices only
    room : Room          with the front at depth 0; OUT: ``best``
    """
    least = most
    n_best = 0
    depth = 0
    arrived = True
    # a node is arrived at, and left once for each of its choices
    nodes = 0
    for _ in range(MOST_VERTICES * MOST_NODES):
        if arrived:
            nodes += 1
            room.n_choices[depth] = 0
            room.turn[depth] = 0
            if room.n_front[depth] == 0:
                least = REAL * room.total[depth]
                n_best = depth
                for m in range(depth):
                    for a in range(4):
                        room.best[m, a] = room.chosen[m, a]
            elif depth < DEPTH and nodes <= MOST_NODES:
                _branch(
                    tets, depth, n_vertices, cost, most, least - room.total[depth], limit, locked,
                    room,
                )
        arrived = False
        if room.turn[depth] < room.n_choices[depth] and nodes <= MOST_NODES:
            turn = room.turn[depth]
            room.turn[depth] += 1
            total = room.total[depth] + room.price[depth, turn]
            if not total < least:
                continue
            _put_cell(depth, room.choices[depth, turn], room)
            room.total[depth + 1] = total
            depth += 1
            arrived = True
            continue
        depth -= 1
        if depth < 0:
            break
        for place in range(4):
            room.state[room.before[depth, place, 0]] = room.before[depth, place, 1]
    return least, n_best


@inner_kernel
def _as_it_was(cells: IntArray, n: int, m: int, room: Room) -> None:
    """Give a new cell the order of vertices of the old one that it equals, and so its figures."""
    new = room.new[m]
    for k in range(n):
        c = room.cells[k]
        same = True
        for a in range(4):
            same = same and is_in(cells[c, a], new, np.int64(4))
        if same:
            for a in range(4):
                new[a] = cells[c, a]
            return


@inlined_kernel
def reconnect_cell(
    tets: Tets, c: int, cost: Cost, bounds: Bounds, room: Room, journal: Journal
) -> bool:
    """Fill the polyhedron around cell c anew if that lowers the cost within the bounds."""
    n, n_vertices = grow_polyhedron(tets, c, cost, room)
    before = 0.0
    for m in range(n):
        before += cell_cost(tets.points, tets.cells, room.cells[m], cost)
    worst, worst_locked = worst_of(tets, room.cells, n, Bounds(BEST, BEST))
    limit = worse(bounds.cells, rounded(worst))
    locked = worse(bounds.locked, rounded(worst_locked))
    _begin(tets, n, n_vertices, cost, room)
    _, n_new = fill_polyhedron(tets, n_vertices, cost, REAL * before, limit, locked, room)
    if n_new == 0:
        return False
    for m in range(n_new):
        for a in range(4):
            room.new[m, a] = room.vertices[room.best[m, a]]
        _as_it_was(tets.cells, n, m, room)
    return replace_cavity(tets, room.cells, n, room.new, np.int64(n_new), room.border, journal)


@allocating_kernel
def reconnection_pass(tets: Tets, order: IntArray, cost: Cost, bounds: Bounds) -> int:
    """Fill the polyhedra around the cells of ``order`` anew, one after another.

    Parameters
    ----------
    tets : Tets            changed in place
    order : (k,) int32     cells to visit, worst first
    cost : Cost            whose sum falls with every change
    bounds : Bounds        that no new cell passes unless one that it replaces does

    Returns
    -------
    int                    number of polyhedra that were filled anew
    """
    room = make_room()
    journal = make_journal(np.bool_(False), np.int64(0))
    count = 0
    for o in range(order.shape[0]):
        c = order[o]
        if tets.cells[c, 0] >= 0 and reconnect_cell(tets, c, cost, bounds, room, journal):
            count += 1
    return count
