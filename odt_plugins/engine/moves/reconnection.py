"""Reconnection of small polyhedra: the best cells between the vertices around a bad one.

A few cells around a bad one make a polyhedron without a vertex inside.  Of all ways to fill it with
cells between its vertices the one of least cost is looked for by branch and bound: the facet that
fewest vertices fit comes first, and what every facet costs at least, when the cost of a cell is
shared among the facets that it closes, bounds what is to come (Liu, Chen, Sun, *Small polyhedron
reconnection for mesh improvement and its implementation based on advancing front technique*, Int.
J. Numer. Meth. Engng. 79 (2009) 1004-1018).  Edge removal, its inverse and the flips are special
cases; no sequence of them that lowers the cost step by step need lead there.

Cells of positive volume whose facets match each other and the surface of the polyhedron fill it
exactly once, so nothing else has to be checked.
"""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.cells.corner import corner_edges, six_volumes
from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import BEST, Bounds, Extremes, keeps, rounded, worse
from odt_plugins.engine.cells.measures import cell_cost, tet_cost, tet_shape
from odt_plugins.engine.cells.tetrahedron import opposite_vertices
from odt_plugins.engine.compiled.kernel import allocating_kernel, inlined_kernel, kernel
from odt_plugins.engine.moves.cavity import Journal, make_journal, replace_cavity
from odt_plugins.engine.moves.flips3d import REAL, worst_of
from odt_plugins.engine.moves.polyhedron import (
    ALIKE,
    CLOSED,
    DEPTH,
    EVEN,
    INSIDE,
    MOST_VERTICES,
    UNSEEN,
    Room,
    ascending_cell,
    cell_number,
    facet_number,
    grow_polyhedron,
    make_room,
    place_of,
    sorted_facet,
)
from odt_plugins.engine.topology.lookup import is_in
from odt_plugins.engine.topology.tets import Tets, all_locked
from odt_plugins.mesh.arrays import IntArray

UNPROVEN, UNSIGNED = 2, 4
"""What ``Room.turned`` holds more until a cell was compared with the limits; all that it holds
until the sign of the cell's volume is known."""
MOST_NODES = 400
"""Nodes of the tree of fillings that are visited for one polyhedron."""


@inlined_kernel
def _begin(tets: Tets, n: int, n_vertices: int, cost: Cost, room: Room) -> bool:
    """Make the facets around the first n cells the front, and forget all costs but theirs.

    They may stay whatever their shape: with its vertices in another order a cell that is as bad as
    the limit could pass it by rounding.  False where a facet is there twice, as among flat cells.
    """
    room.state[:] = UNSEEN
    room.costs[:] = np.nan
    room.turned[:] = UNSIGNED
    front = np.int64(0)
    for m in range(n):
        c = room.cells[m]
        a, b, d, odd = sorted_facet(room.local[m, 1], room.local[m, 2], room.local[m, 3])
        i, j, k, l, less = ascending_cell(room.local[m, 0], a, b, d)
        number = cell_number(i, j, k, l)
        room.costs[number] = cell_cost(tets.points, tets.cells, c, cost)
        room.turned[number] = (less ^ odd) & 1
        for f in range(4):
            if room.side[m, f] == INSIDE:
                continue
            i, j, k = opposite_vertices(tets.cells, c, tets.cells[c, f])
            a, b, d, odd = sorted_facet(
                place_of(room.vertices, n_vertices, i), place_of(room.vertices, n_vertices, j),
                place_of(room.vertices, n_vertices, k),
            )
            number = facet_number(a, b, d)
            if room.state[number] != UNSEEN:
                return False
            room.state[number] = EVEN + odd
            room.front[0, front] = number
            front += 1
    room.n_front[0] = front
    room.total[0] = 0.0
    return True


@inlined_kernel
def _find_sign(tets: Tets, a: int, b: int, c: int, d: int, room: Room) -> None:
    """Write down whether the cell a < b < c < d is negative."""
    i, j, k, l = room.vertices[a], room.vertices[b], room.vertices[c], room.vertices[d]
    negative = six_volumes(*corner_edges(tets.points, i, j, k, l)) < 0.0
    room.turned[cell_number(a, b, c, d)] = UNPROVEN + negative


@inlined_kernel
def _positive(
    n: int, a: int, b: int, c: int, d: int, room: Room
) -> tuple[int, int, int, int]:
    """Vertices of the n-th cell, a < b < c < d, by their global numbers and in positive order."""
    i, j, k, l = room.vertices[a], room.vertices[b], room.vertices[c], room.vertices[d]
    return (j, i, k, l) if room.turned[n] & 1 else (i, j, k, l)


@inlined_kernel
def _weigh(
    tets: Tets, a: int, b: int, c: int, d: int, cost: Cost, most: float, room: Room
) -> None:
    """Write down what the cell a < b < c < d, of known sign, costs, infinite beyond ``most``."""
    n = cell_number(a, b, c, d)
    i, j, k, l = _positive(n, a, b, c, d, room)
    own = tet_cost(tets.points, i, j, k, l, cost)
    room.costs[n] = own if own < most else np.inf


@inlined_kernel
def _allowed(
    tets: Tets, a: int, b: int, c: int, d: int, limit: Extremes, locked: Extremes, room: Room
) -> bool:
    """Whether the cell a < b < c < d is within the limits; costs are infinite beyond them."""
    n = cell_number(a, b, c, d)
    room.turned[n] -= UNPROVEN
    i, j, k, l = _positive(n, a, b, c, d, room)
    if keeps(tet_shape(tets.points, i, j, k, l), locked if all_locked(tets, i, j, k, l) else limit):
        return True
    room.costs[n] = np.inf
    return False


@inlined_kernel
def _next_cell(facet: int, x: int, room: Room) -> tuple[int, int, int, int, int]:
    """Vertices of the cell of x and a facet in ascending order."""
    corners = room.corners
    return ascending_cell(x, corners[facet, 0], corners[facet, 1], corners[facet, 2])


@inlined_kernel
def _closes(facet: int, x: int, odd: int, room: Room) -> int:
    """How many facets of the front the cell of x and a facet closes, 0 if it does not fit."""
    count = 1
    for place in range(1, 4):
        code = room.tables[facet, x, place]
        found = room.state[code >> 1]
        if found == CLOSED or found == EVEN + (odd ^ (code & 1)):
            return 0
        if found != UNSEEN:
            count += 1
    return count


@inlined_kernel
def _branch(
    tets: Tets, depth: int, n_vertices: int, cost: Cost, most: float, left: float,
    limit: Extremes, locked: Extremes, room: Room,
) -> None:
    """Choose the facet that fewest vertices fit, and put these in the order of their costs.

    There are no choices where a facet fits no vertex, or all together cost more than is ``left``.
    """
    costs, turned, prices, tables = room.costs, room.turned, room.prices, room.tables
    choices, n_choices = room.choices[depth], 0
    room.n_choices[depth] = 0
    room.turn[depth] = 0
    fewest = MOST_VERTICES + 1
    together = 0.0
    for p in range(room.n_front[depth]):
        facet = room.front[depth, p]
        odd = np.int64(room.state[facet]) - EVEN
        count = 0
        least = share = np.inf
        for x in range(n_vertices):
            code = tables[facet, x, 0]
            if code < 0:
                continue
            n = code >> 1
            if turned[n] == UNSIGNED:
                i, j, k, l, _ = _next_cell(facet, x, room)
                _find_sign(tets, i, j, k, l, room)
            if (turned[n] ^ code ^ odd) & 1:
                continue
            if math.isnan(costs[n]):
                i, j, k, l, _ = _next_cell(facet, x, room)
                _weigh(tets, i, j, k, l, cost, most, room)
            own = costs[n]
            if not own < left:
                continue
            closed = _closes(facet, x, odd, room)
            if closed > 0:
                if turned[n] >= UNPROVEN:
                    i, j, k, l, _ = _next_cell(facet, x, room)
                    if not _allowed(tets, i, j, k, l, limit, locked, room):
                        continue
                room.fits[count] = x
                prices[count] = own
                count += 1
                least = min(least, own)
                share = min(share, own / closed)
        together += share
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
        code = np.int64(room.tables[chosen, x, 1 + place])
        other, wanted = code >> 1, EVEN + (odd ^ (code & 1))
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


@kernel
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
    if not _begin(tets, n, n_vertices, cost, room):
        return False
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
