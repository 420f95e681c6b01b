"""Integrals over what the cells of one mesh have in common with those of another, by clipping.

A cell is clipped by the facets of another one in barycentric coordinates of both, which are linear:
all parts of what is left are simplices, and over one of volume V the product of two linear
functions f, g with values f_i, g_i at its corners has the integral

    V / ((d + 1) (d + 2)) (sum f_i sum g_i + sum f_i g_i).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odt_plugins.engine.compiled.kernel import inlined_kernel, kernel
from odt_plugins.mesh.arrays import FloatArray, IntArray

PARTS = 81
"""Most simplices that four cuts make of one, of which each makes three at most."""

BESIDE = 1e-13
"""Cells whose barycentric coordinates exceed a facet of the other one by less do not overlap."""

ROUNDING = 1e-12
"""Difference of two fields, by their values in the cell, up to which these count as equal."""

SPLIT = np.array([
    [[[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]],
     [[0, 4, 5, 0], [0, 0, 0, 0], [0, 0, 0, 0]],
     [[0, 1, 5, 0], [0, 4, 5, 0], [0, 0, 0, 0]],
     [[0, 1, 2, 0], [0, 0, 0, 0], [0, 0, 0, 0]],
     [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]]],
    [[[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]],
     [[0, 4, 5, 6], [0, 0, 0, 0], [0, 0, 0, 0]],
     [[0, 4, 5, 7], [0, 4, 6, 7], [0, 1, 6, 7]],
     [[0, 1, 2, 6], [0, 1, 5, 6], [0, 4, 5, 6]],
     [[0, 1, 2, 3], [0, 0, 0, 0], [0, 0, 0, 0]]],
])
"""Corners of the simplices that are left of one, by its dimension less 2 and the number of its
corners inside: 0 to 3 are its corners, those inside first; from 4 on the cuts of the edges from
every one inside to every one outside."""

COUNT = np.array([[0, 1, 2, 1, 0], [0, 1, 3, 3, 1]])
"""How many these are."""


class Sampled(NamedTuple):
    """A mesh with values.

    Attributes
    ----------
    points, cells : (n, d) float64, (m, d + 1) int32
    of_cells : (m, a) float64       constant in every cell
    of_points : (n, b) float64      linear in every cell
    """

    points: FloatArray
    cells: IntArray
    of_cells: FloatArray
    of_points: FloatArray


class Sums(NamedTuple):
    """Integrals over the part of some new cells that old ones cover.

    Attributes
    ----------
    covered : (k,) float64          volume of this part by that of the cell
    of_cells : (k, a) float64       of the old values less those of the first cell that is looked at
    of_points : (k, d + 1, b)       of the old field less the new one, times the function that is 1
                                    in a corner and 0 in the others; by the volume of the cell too
    """

    covered: FloatArray
    of_cells: FloatArray
    of_points: FloatArray


class Room(NamedTuple):
    """Where a cell is clipped, and which cells were looked at.

    Attributes
    ----------
    now, then : (PARTS, d + 1, 2 d + 2) float64   corners of simplices, in coordinates of both cells
    products : (d + 1, 2 d + 2) float64           integrals of products of coordinates
    own, matrix : (2, d, d) float64               edges of the new and of an old cell, the inverse
    level : (2, d + 1, d + 1) float64             coordinates of the corners of either cell
    order : (d + 1,) int32                        corners of a simplex, those inside first
    seen : (m,) int32                             last new cell for which an old one was looked at
    queue : (m,) int32                            old cells to be looked at
    """

    now: FloatArray
    then: FloatArray
    products: FloatArray
    own: FloatArray
    matrix: FloatArray
    level: FloatArray
    order: IntArray
    seen: IntArray
    queue: IntArray


def make_room(m: int, d: int) -> Room:
    """Room for one thread, for an old mesh of m cells in d dimensions."""
    k = d + 1
    return Room(np.empty((PARTS, k, 2 * k)), np.empty((PARTS, k, 2 * k)),
                np.empty((k, 2 * k)), np.empty((2, d, d)), np.empty((2, d, d)),
                np.empty((2, k, k)), np.empty(k, dtype=np.int32),
                np.full(m, -1, dtype=np.int32), np.empty(m, dtype=np.int32))


@inlined_kernel
def _invert(points: FloatArray, row: IntArray, matrix: FloatArray) -> float:
    """Gradients of the barycentric coordinates of a cell but the first; the volume by d!."""
    d = points.shape[1]
    for i in range(d):
        for x in range(d):
            matrix[0, i, x] = points[row[i + 1], x] - points[row[0], x]
    e = matrix[0]
    if d == 2:
        volume = e[0, 0] * e[1, 1] - e[0, 1] * e[1, 0]
        matrix[1, 0, 0], matrix[1, 0, 1] = e[1, 1], -e[1, 0]
        matrix[1, 1, 0], matrix[1, 1, 1] = -e[0, 1], e[0, 0]
    else:
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            for x in range(3):
                y, z = (x + 1) % 3, (x + 2) % 3
                matrix[1, i, x] = e[j, y] * e[k, z] - e[j, z] * e[k, y]
        volume = e[0, 0] * matrix[1, 0, 0] + e[0, 1] * matrix[1, 0, 1] + e[0, 2] * matrix[1, 0, 2]
    for i in range(d):
        for x in range(d):
            matrix[1, i, x] /= volume
    return volume


@inlined_kernel
def _levels(
    base: FloatArray, row: IntArray, gradients: FloatArray, points: FloatArray, corners: IntArray,
    level: FloatArray,
) -> bool:
    """Coordinates in a cell of the corners of another one; whether no facet separates both."""
    d = points.shape[1]
    for v in range(d + 1):
        rest = 1.0
        for i in range(d):
            value = 0.0
            for x in range(d):
                value += gradients[i, x] * (points[corners[v], x] - base[row[0], x])
            level[v, i + 1] = value
            rest -= value
        level[v, 0] = rest
    for i in range(d + 1):
        most = level[0, i]
        for v in range(1, d + 1):
            most = max(most, level[v, i])
        if most <= BESIDE:
            return False
    return True


@inlined_kernel
def _cut(now: FloatArray, count: int, then: FloatArray, plane: int, order: IntArray) -> int:
    """Number of the simplices that are left of some where a coordinate is positive."""
    k, width, made = now.shape[1], now.shape[2], 0
    for s in range(count):
        inside, top = 0, 0.0
        for v in range(k):
            if now[s, v, plane] >= 0.0:
                order[inside] = v
                inside += 1
                top = max(top, now[s, v, plane])
        if top == 0.0:
            continue
        last = inside
        for v in range(k):
            if now[s, v, plane] < 0.0:
                order[last] = v
                last += 1
        outside = k - inside
        for part in range(COUNT[k - 3, inside]):
            for v in range(k):
                corner = SPLIT[k - 3, inside, part, v]
                if corner < 4:
                    one = order[corner]
                    for x in range(width):
                        then[made, v, x] = now[s, one, x]
                    continue
                one = order[(corner - 4) // outside]
                other = order[inside + (corner - 4) % outside]
                share = now[s, one, plane] / (now[s, one, plane] - now[s, other, plane])
                for x in range(width):
                    then[made, v, x] = now[s, one, x] + share * (now[s, other, x] - now[s, one, x])
                then[made, v, plane] = 0.0
            made += 1
    return made


@inlined_kernel
def _share(part: FloatArray, d: int) -> float:
    """Volume of a simplex by that of the new cell, in whose coordinates its corners are given."""
    a, b = part[1, 1] - part[0, 1], part[1, 2] - part[0, 2]
    p, q = part[2, 1] - part[0, 1], part[2, 2] - part[0, 2]
    if d == 2:
        return abs(a * q - b * p)
    c, r = part[1, 3] - part[0, 3], part[2, 3] - part[0, 3]
    u, v, w = part[3, 1] - part[0, 1], part[3, 2] - part[0, 2], part[3, 3] - part[0, 3]
    return abs(a * (q * w - r * v) - b * (p * w - r * u) + c * (p * v - q * u))


@inlined_kernel
def _clip(room: Room) -> tuple[int, FloatArray]:
    """The simplices that the new cell and the old one have in common, and their number."""
    k, now, then = room.now.shape[1], room.now, room.then
    for v in range(k):
        for i in range(k):
            now[0, v, i] = 1.0 if v == i else 0.0
            now[0, v, k + i] = room.level[1, v, i]
    count = 1
    for plane in range(k, 2 * k):
        least = 0.0
        for v in range(k):
            least = min(least, room.level[1, v, plane - k])
        if least == 0.0:
            continue
        count = _cut(now, count, then, plane, room.order)
        now, then = then, now
    return count, now


@inlined_kernel
def _products(
    simplices: FloatArray, count: int, products: FloatArray, linear: bool
) -> float:
    """Volume of some simplices by that of the new cell; if asked to, integrals of products.

    Those of each coordinate in the new cell by every coordinate in both go to `products`.
    """
    k = products.shape[0]
    whole, scale = 0.0, 1.0 / (k * (k + 1))
    for i in range(k):
        for x in range(2 * k):
            products[i, x] = 0.0
    for s in range(count):
        part = simplices[s]
        share = _share(part, k - 1)
        whole += share
        if not linear:
            continue
        for x in range(2 * k):
            total = 0.0
            for v in range(k):
                total += part[v, x]
            for i in range(k):
                lot, both = 0.0, 0.0
                for v in range(k):
                    lot += part[v, i]
                    both += part[v, i] * part[v, x]
                products[i, x] += scale * share * (lot * total + both)
    return whole


@inlined_kernel
def _add(
    old: Sampled, new: Sampled, pair: tuple[int, int, int, int], room: Room, share: float,
    sums: Sums,
) -> None:
    """Add the integrals over a share of a new cell: its row and place, the old cell, the first."""
    at, j, c, first = pair
    k, products = room.now.shape[1], room.products
    for a in range(old.of_cells.shape[1]):
        sums.of_cells[at, a] += share * (old.of_cells[c, a] - old.of_cells[first, a])
    for b in range(old.of_points.shape[1]):
        top = 0.0
        for v in range(k):
            top = max(top, abs(old.of_points[old.cells[c, v], b]),
                      abs(new.of_points[new.cells[j, v], b]))
        for i in range(k):
            gap = 0.0
            for v in range(k):
                gap += products[i, k + v] * old.of_points[old.cells[c, v], b]
                gap -= products[i, v] * new.of_points[new.cells[j, v], b]
            if abs(gap) > ROUNDING * top * share:
                sums.of_points[at, i, b] += gap


@kernel
def overlaps(
    old: Sampled, neighbors: IntArray, new: Sampled, rows: IntArray, seeds: IntArray, room: Room,
    sums: Sums,
) -> None:
    """Integrate over the common parts of new cells and the old ones that are found around seeds.

    Parameters
    ----------
    old, new : Sampled          positively oriented
    neighbors : (m, d + 1)      old cell across every facet, -1 where none is to be looked at
    rows : (k,) int32           new cells
    seeds : (k, s) int32        old cells near each, the first of which gives the offset of `Sums`
    room : Room                 of `old`
    sums : Sums                 zeros (k, ...)
    """
    k, linear = old.cells.shape[1], old.of_points.shape[1] > 0
    for c in range(room.seen.shape[0]):
        room.seen[c] = -1
    for at in range(rows.shape[0]):
        j = rows[at]
        last = 0
        for s in range(seeds.shape[1]):
            c = seeds[at, s]
            if room.seen[c] != at:
                room.seen[c] = at
                room.queue[last] = c
                last += 1
        given = last
        _invert(new.points, new.cells[j], room.own)
        for at_queue in range(room.queue.shape[0]):
            if at_queue >= last:
                break
            c = room.queue[at_queue]
            share = 0.0
            if _levels(new.points, new.cells[j], room.own[1], old.points, old.cells[c],
                       room.level[0]):
                _invert(old.points, old.cells[c], room.matrix)
                if _levels(old.points, old.cells[c], room.matrix[1], new.points, new.cells[j],
                           room.level[1]):
                    count, simplices = _clip(room)
                    share = _products(simplices, count, room.products, linear)
                    sums.covered[at] += share
                    _add(old, new, (at, j, c, seeds[at, 0]), room, share, sums)
            if share > 0.0 or at_queue < given:
                for i in range(k):
                    beside = neighbors[c, i]
                    if beside >= 0 and room.seen[beside] != at:
                        room.seen[beside] = at
                        room.queue[last] = beside
                        last += 1
