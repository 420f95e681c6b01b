"""Small polyhedra: a few cells around a bad one, and numbers for all that fits between them.

Cells are added while every vertex stays on the surface.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.measures import cell_cost
from odt_plugins.engine.compiled.kernel import allocating_kernel, inlined_kernel, kernel
from odt_plugins.engine.topology.lookup import is_in
from odt_plugins.engine.topology.tets import Tets
from odt_plugins.mesh.arrays import ByteArray, FloatArray, IntArray, LongArray

ShortArray = NDArray[np.int16]

MOST_VERTICES, MOST_CELLS = 13, 24
"""Of one polyhedron."""
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
INSIDE, SHUT, AJAR = 0, 1, 2
"""Facet of a cell of a polyhedron that grows: between two of its cells; on its surface, without a
cell across that may be added; with one."""


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
    apex : (MOST_CELLS, 4) int32           their vertices that are not on these facets
    side : (MOST_CELLS, 4) uint8           see :data:`INSIDE`
    local : (MOST_CELLS, 4) int64          vertices of its cells
    shown : (MOST_VERTICES,) int64         number of facets of its surface around every vertex
    corners : (FACETS, 3) int64            vertices of every facet
    tables : (FACETS, MOST_VERTICES, 4) int16
        of the cell of a facet and a vertex: twice its number, odd if so many vertices come before
        that one; the same of its facets in which that one has the first, second or third place,
        odd if the order is; negative for a vertex of the facet
    state : (FACETS,) uint8                see :data:`UNSEEN`
    costs : (TETRAHEDRA,) float64          nan where not computed, inf where not allowed
    turned : (TETRAHEDRA,) uint8           odd when the vertices in ascending order are negative;
                                           ``reconnection.UNPROVEN`` tells what is not known
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
    apex: IntArray
    side: ByteArray
    local: LongArray
    shown: LongArray
    corners: LongArray
    tables: ShortArray
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


@kernel
def facet_number(a: int, b: int, c: int) -> int:
    """Number of the facet with the vertices a < b < c."""
    return c * (c - 1) * (c - 2) // 6 + b * (b - 1) // 2 + a


@kernel
def cell_number(a: int, b: int, c: int, d: int) -> int:
    """Number of the cell with the vertices a < b < c < d."""
    return d * (d - 1) * (d - 2) * (d - 3) // 24 + facet_number(a, b, c)


@kernel
def ascending_cell(x: int, a: int, b: int, c: int) -> tuple[int, int, int, int, int]:
    """The vertices x and a < b < c in ascending order, and how many are less than x."""
    if x < a:
        return x, a, b, c, 0
    if x < b:
        return a, x, b, c, 1
    if x < c:
        return a, b, x, c, 2
    return a, b, c, x, 3


@kernel
def sorted_facet(a: int, b: int, c: int) -> tuple[int, int, int, int]:
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


@kernel
def _beside(a: int, b: int, c: int, place: int, x: int) -> int:
    """Twice the number of the facet with x at a place of facet (a, b, c); odd if the order is."""
    if place == 0:
        a = x
    elif place == 1:
        b = x
    else:
        c = x
    a, b, c, odd = sorted_facet(a, b, c)
    return 2 * facet_number(a, b, c) + odd


@allocating_kernel
def make_room() -> Room:
    """Room for one thread."""
    corners = np.empty((FACETS, 3), np.int64)
    tables = np.empty((FACETS, MOST_VERTICES, 4), np.int16)
    for c in range(MOST_VERTICES):
        for b in range(c):
            for a in range(b):
                n = facet_number(a, b, c)
                corners[n, 0] = a
                corners[n, 1] = b
                corners[n, 2] = c
                for x in range(MOST_VERTICES):
                    if x in (a, b, c):
                        tables[n, x, 0] = -1
                        continue
                    i, j, k, l, less = ascending_cell(x, a, b, c)
                    tables[n, x, 0] = 2 * cell_number(i, j, k, l) + (less & 1)
                    for place in range(3):
                        tables[n, x, 1 + place] = _beside(a, b, c, place, x)
    return Room(
        np.empty(MOST_CELLS + DEPTH, np.int32),
        np.empty(MOST_VERTICES, np.int32),
        np.empty(MOST_CELLS, np.int32),
        np.empty((MOST_CELLS, 4)),
        np.empty((MOST_CELLS, 4), np.int32),
        np.empty((MOST_CELLS, 4), np.uint8),
        np.empty((MOST_CELLS, 4), np.int64),
        np.empty(MOST_VERTICES, np.int64),
        corners,
        tables,
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


@kernel
def place_of(vertices: IntArray, n: int, v: int) -> int:
    """Place of vertex v among the first n, -1 if it is not there."""
    for k in range(n):
        if vertices[k] == v:
            return k
    return -1


@inlined_kernel
def _show(tets: Tets, n: int, n_vertices: int, t: int, room: Room) -> int:
    """Give the vertices of cell t places, and count their facets as if it were the n-th cell.

    Returns the number of vertices then.
    """
    for a in range(4):
        v = tets.cells[t, a]
        at = place_of(room.vertices, n_vertices, v)
        if at < 0:
            at = n_vertices
            room.vertices[at] = v
            room.shown[at] = 0
            n_vertices += 1
        room.local[n, a] = at
    for f in range(4):
        room.side[n, f] = INSIDE if is_in(tets.neighbors[t, f], room.cells, n) else SHUT
        for a in range(4):
            if a != f:
                room.shown[room.local[n, a]] += 2 * int(room.side[n, f]) - 1
    return n_vertices


@inlined_kernel
def _hide(n: int, room: Room) -> None:
    """Take the counts of :func:`_show` back."""
    for f in range(4):
        for a in range(4):
            if a != f:
                room.shown[room.local[n, a]] -= 2 * int(room.side[n, f]) - 1


@inlined_kernel
def _add_cell(tets: Tets, n: int, n_spoils: int, t: int, room: Room) -> None:
    """Make cell t, which is shown, the n-th one."""
    cells, neighbors = tets.cells, tets.neighbors
    room.cells[n] = t
    own = cells[t, 0] ^ cells[t, 1] ^ cells[t, 2] ^ cells[t, 3]
    for f in range(4):
        across = neighbors[t, f]
        if room.side[n, f] == INSIDE:
            _set_side(tets, n, t, INSIDE, room)
        elif (
            across >= 0 and tets.regions[across] == tets.regions[t]
            and not is_in(across, room.spoils, n_spoils)
        ):
            room.side[n, f] = AJAR
            room.beside[n, f] = np.nan
            other = cells[across, 0] ^ cells[across, 1] ^ cells[across, 2] ^ cells[across, 3]
            room.apex[n, f] = other ^ own ^ cells[t, f]


@inlined_kernel
def _set_side(tets: Tets, n: int, t: int, side: int, room: Room) -> None:
    """Give all facets of the first n cells with cell t across the same state."""
    for m in range(n):
        for f in range(4):
            if tets.neighbors[room.cells[m], f] == t:
                room.side[m, f] = side


@inlined_kernel
def grow_polyhedron(tets: Tets, c: int, cost: Cost, room: Room) -> tuple[int, int]:
    """Collect cells around cell c until no more fit; the numbers of cells and of vertices.

    Cells between the vertices that are there come first, then the worst ones.
    """
    n = np.int64(1)
    n_spoils = np.int64(0)
    n_vertices = np.int64(_show(tets, 0, 0, c, room))
    _add_cell(tets, 0, n_spoils, c, room)
    for _ in range(2 * MOST_CELLS):
        if n == MOST_CELLS:
            break
        found = -1
        most = 0.0
        for m in range(n):
            for f in range(4):
                if room.side[m, f] != AJAR:
                    continue
                missing = place_of(room.vertices, n_vertices, room.apex[m, f]) < 0
                if missing and n_vertices == MOST_VERTICES:
                    continue
                t = tets.neighbors[room.cells[m], f]
                if math.isnan(room.beside[m, f]):
                    room.beside[m, f] = cell_cost(tets.points, tets.cells, t, cost)
                badness = room.beside[m, f]
                rank = badness / (1.0 + badness) + (0.0 if missing else 1.0)
                if rank > most * (1.0 + ALIKE):
                    most = rank
                    found = t
        if found < 0:
            break
        more = np.int64(_show(tets, n, n_vertices, found, room))
        encloses = False
        for v in range(more):
            encloses = encloses or room.shown[v] == 0
        if not encloses:
            _add_cell(tets, n, n_spoils, found, room)
            n += 1
            n_vertices = more
            continue
        if n_spoils == MOST_CELLS:
            break
        _hide(n, room)
        _set_side(tets, n, found, SHUT, room)
        room.spoils[n_spoils] = found
        n_spoils += 1
    return int(n), int(n_vertices)
