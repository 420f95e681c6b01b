"""The surface while its vertices come and go: triangles in slots, stars as chained lists.

Every triangle is three corners, 3 t + i; the corners at a vertex are chained, so an edge may have
any number of triangles. An operation writes what is to go and what is to come into a `Room`, asks
the guards, and `exchange` does it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.extremes import Extremes, keeps, worse
from odt_plugins.engine.cells.metric import seen_square
from odt_plugins.engine.cells.triangle import triangle_in_space
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.closest import Ground
from odt_plugins.engine.ground.replace import (
    ROOM,
    Exchange,
    facing,
    gather,
    make_exchange,
    may_replace,
    settle,
)
from odt_plugins.engine.ground.sheet import SMOOTH
from odt_plugins.engine.ground.trace import End, edge_is_near
from odt_plugins.engine.retile.tracks import Tracks
from odt_plugins.mesh.arrays import ByteArray, FloatArray, IntArray, LongArray

FOLD = -0.45
"""Cosine of the largest turn at an edge that is made; the judge allows 120 degrees."""

TURNED = 1e-6
"""Part by which the cosine of a turn towards the ground may fall where it is small already: that of
coordinates with seven digits."""

THINNEST = 1e-8
"""Least altitude of a triangle that is divided, as a part of its longest edge. Triangles that
are regular in an allowed metric have more."""


class Net(NamedTuple):
    """Triangles on the ground, with room for more.

    Attributes
    ----------
    points : (n, 3) float64      in the unit of the ground; more columns as in ``cells.metric``
    foot : (n,) int32            triangle of the ground near each
    kind : (n,) uint8            SMOOTH, LINE or LOCKED
    place : (n,) float64         where a LINE vertex is on the tracks
    after : (n,) int32           the next vertex on the track of a LINE vertex
    size : (n,) float64          length that edges are to have
    head : (n,) int32            first corner at a vertex, -1 where there is none
    triangles : (m, 3) int32     -1 first in a slot that is free
    marks : (m, 3) int32         track of the edge opposite to a corner, -1 for none
    labels : (m,) int32
    chained : (3 m,) int32       next corner at the same vertex, -1 for the last
    first : (m,) int32           first ground vertex in the list of a triangle, -1 for none
    following : (g,) int32       next ground vertex in the same list
    stamp : (n,) int64           exchange that last changed the star of a vertex
    count : (3,) int64           vertices and slots in use, and exchanges made
    """

    points: FloatArray
    foot: IntArray
    kind: ByteArray
    place: FloatArray
    after: IntArray
    size: FloatArray
    head: IntArray
    triangles: IntArray
    marks: IntArray
    labels: IntArray
    chained: IntArray
    first: IntArray
    following: IntArray
    stamp: LongArray
    count: LongArray  # type: ignore[assignment]


class Rules(NamedTuple):
    """What every operation must keep.

    Attributes
    ----------
    ground : Ground
    tracks : Tracks
    reach : (g,) float64    envelope around a triangle of the ground, as a length; inf on a plane
                            one, on which the tracks alone keep the shape
    cosine : float          least cosine between the normals of a triangle and of the ground
    bounds : Extremes       what no new triangle may pass, unless one that it replaces does
    turn : float            least cosine of the turn at an edge on a track, unless one that goes
                            turns by more than FOLD
    longest : float         edges longer than this multiple of their size are split, and none is
                            made by a collapse
    shortest : float        edges shorter than this multiple of their size collapse
    """

    ground: Ground
    tracks: Tracks
    reach: FloatArray
    cosine: float
    bounds: Extremes
    turn: float
    longest: float
    shortest: float


class Room(NamedTuple):
    """Room for one operation.

    Attributes
    ----------
    exchange : Exchange
    marks : (ROOM, 3) int32, labels : (ROOM,) int32    of the new triangles
    places : (ROOM,) int32                             their slots
    rows : (ROOM,) int32                               0, 1, 2, ...
    axes : (2, 3) float64, derivatives : (5,) float64  of a star
    """

    exchange: Exchange
    marks: IntArray
    labels: IntArray
    places: IntArray
    rows: IntArray
    axes: FloatArray
    derivatives: FloatArray


def make_room() -> Room:
    """Make the room of one thread."""
    return Room(make_exchange(), np.empty((ROOM, 3), np.int32), np.empty(ROOM, np.int32),
                np.empty(ROOM, np.int32), np.arange(ROOM, dtype=np.int32), np.empty((2, 3)),
                np.empty(5))


@kernel
def link(net: Net, t: int) -> None:
    """Enter the corners of a triangle into the stars of its vertices."""
    for i in range(3):
        v = net.triangles[t, i]
        net.chained[3 * t + i] = net.head[v]
        net.head[v] = 3 * t + i


@kernel
def link_all(net: Net) -> None:
    """Build the stars anew."""
    net.head[:] = -1
    for t in range(net.count[1] - 1, -1, -1):
        link(net, t)


@kernel
def _unlink(net: Net, t: int) -> None:
    """Take the corners of a triangle out of the stars of its vertices."""
    for i in range(3):
        v = net.triangles[t, i]
        corner = 3 * t + i
        if net.head[v] == corner:
            net.head[v] = net.chained[corner]
            continue
        at = net.head[v]
        for _ in range(net.chained.shape[0]):
            if at < 0:
                break
            if net.chained[at] == corner:
                net.chained[at] = net.chained[corner]
                break
            at = net.chained[at]


@kernel
def third(net: Net, t: int, a: int, b: int) -> int:
    """Corner of a triangle at neither of two of its vertices, -1 when it does not hold both."""
    i, j, k = net.triangles[t, 0], net.triangles[t, 1], net.triangles[t, 2]
    if (i == a and j == b) or (i == b and j == a):
        return 2
    if (j == a and k == b) or (j == b and k == a):
        return 0
    if (k == a and i == b) or (k == b and i == a):
        return 1
    return -1


@kernel
def edge_triangles(net: Net, a: int, b: int, room: Room) -> int:
    """Write the triangles at an edge into room.exchange.old: how many, -1 without room for all."""
    count = 0
    corner = net.head[a]
    for _ in range(net.chained.shape[0]):
        if corner < 0:
            break
        t = corner // 3
        if third(net, t, a, b) >= 0:
            if 2 * count + 2 > ROOM:
                return -1
            room.exchange.old[count] = t
            count += 1
        corner = net.chained[corner]
    return count


@kernel
def is_edge(net: Net, a: int, b: int) -> bool:
    """Whether some triangle holds both vertices."""
    corner = net.head[a]
    for _ in range(net.chained.shape[0]):
        if corner < 0:
            break
        if third(net, corner // 3, a, b) >= 0:
            return True
        corner = net.chained[corner]
    return False


@kernel
def put(
    net: Net, room: Room, row: int, t: int, gone: int, come: int
) -> None:
    """Write triangle t with another vertex in the place of one into a row of the room."""
    for i in range(3):
        v = net.triangles[t, i]
        room.exchange.new[row, i] = come if v == gone else v
        room.marks[row, i] = net.marks[t, i]
    room.labels[row] = net.labels[t]


@kernel
def fits(
    net: Net, rules: Rules, room: Room, centre: int, old: int, new: int, before: int
) -> int:
    """Ask the guards of the ground about the triangles in the room, at whose vertex they change.

    Parameters
    ----------
    old, new : int    triangles that go and that come
    before : int      those of the old ones that stand as they were, 0 where the rules know what
                      these had (:func:`standing`)

    Returns
    -------
    int    ground vertices that change their list, -1 when the triangles must not be exchanged
    """
    exchange = room.exchange
    ground, foot, t = rules.ground, net.foot, net.triangles
    found = _extremes(net.points, exchange.new, room.rows, new)
    if not keeps(found, rules.bounds):
        had = _extremes(net.points, t, exchange.old, before)
        if not keeps(found, worse(rules.bounds, had)):
            return -1
    reach = np.inf
    for i in range(new):
        for k in range(3):
            reach = min(reach, rules.reach[foot[exchange.new[i, k]]])
    if reach == np.inf:
        for i in range(new):
            cell = exchange.new[i]
            if not triangle_in_space(net.points, cell[0], cell[1], cell[2])[5] > 0.0:
                return -1
        return 0
    if _folded(net, rules, room, before, old, new) or _turned(net, rules, room, before, new):
        return -1
    for i in range(new):
        for k in range(3):
            if exchange.new[i, k] == centre and room.marks[i, (k + 2) % 3] < 0:
                far = exchange.new[i, (k + 1) % 3]
                if not edge_is_near(_end(net, centre), _end(net, far), ground, reach * reach):
                    return -1
    number = gather(net.first, net.following, old, exchange)
    if number < 0 or not may_replace(
        net.points, foot, new, number, -1.0, ground, reach, exchange
    ):
        return -1
    return number


@kernel
def _turned(net: Net, rules: Rules, room: Room, old: int, new: int) -> bool:
    """Whether a new triangle has less than the least cosine of `facing`, and than old ones have."""
    p, foot, ground, least = net.points, net.foot, rules.ground, rules.cosine
    poorest = 1.0
    for i in range(new):
        c = room.exchange.new[i]
        poorest = min(poorest, facing(p, foot, c[0], c[1], c[2], ground, least, 0.0))
    return poorest < least and poorest < _least_cosine(net, rules, room, old)


@kernel
def _least_cosine(net: Net, rules: Rules, room: Room, old: int) -> float:
    """Least cosine of `facing` that triangles may have in the place of old ones."""
    p, foot, ground, least = net.points, net.foot, rules.ground, rules.cosine
    for i in range(old):
        c = net.triangles[room.exchange.old[i]]
        least = min(least, facing(p, foot, c[0], c[1], c[2], ground, least, TURNED) - TURNED)
    return least


@kernel
def standing(net: Net, rules: Rules, room: Room, old: int) -> Rules:
    """Rules that allow what the old triangles of the room have before a vertex moves."""
    had = worse(rules.bounds, _extremes(net.points, net.triangles, room.exchange.old, old))
    cosine, turn = rules.cosine, rules.turn
    if rules.reach[net.foot[net.triangles[room.exchange.old[0], 0]]] < np.inf:
        cosine = _least_cosine(net, rules, room, old)
        turn = -2.0 if _sharpest(net, room, old) < FOLD else turn
    return Rules(rules.ground, rules.tracks, rules.reach, cosine, had, turn, rules.longest,
                 rules.shortest)


@kernel
def _sharpest(net: Net, room: Room, old: int) -> float:
    """Least cosine of the turn at edges of the old triangles on tracks."""
    p, least = net.points, 1.0
    for i in range(old):
        t = room.exchange.old[i]
        cell = net.triangles[t]
        _, _, _, x, y, z = triangle_in_space(p, cell[0], cell[1], cell[2])
        for k in range(3):
            if net.marks[t, k] < 0:
                continue
            a, b = cell[(k + 1) % 3], cell[(k + 2) % 3]
            corner = net.head[a]
            for _ in range(net.chained.shape[0]):
                if corner < 0:
                    break
                s = corner // 3
                corner = net.chained[corner]
                if s != t and third(net, s, a, b) >= 0:
                    least = min(least, _turn(p, x, y, z, net.triangles[s]))
    return least


@kernel
def _extremes(p: FloatArray, cells: IntArray, rows: IntArray, count: int) -> Extremes:
    """Extremes of the triangles cells[rows[:count]]."""
    found = Extremes(2.0, -1.0, 1.0)
    for i in range(count):
        c = cells[rows[i]]
        q, large, small, _, _, _ = triangle_in_space(p, c[0], c[1], c[2])
        found = worse(found, Extremes(q, large, small))
    return found


@kernel
def _folded(net: Net, rules: Rules, room: Room, before: int, old: int, new: int) -> bool:
    """Whether the surface would turn by more than FOLD at an edge of a new triangle.

    On tracks it may where it does at those of the old ones.
    """
    rows, gone, p = room.exchange.new, room.exchange.old, net.points
    sharpest = 1.0
    for i in range(new):
        _, _, _, x, y, z = triangle_in_space(p, rows[i, 0], rows[i, 1], rows[i, 2])
        for k in range(3):
            least = 1.0
            a, b = rows[i, (k + 1) % 3], rows[i, (k + 2) % 3]
            for j in range(i + 1, new):
                if _has(rows[j], a) and _has(rows[j], b):
                    least = min(least, _turn(p, x, y, z, rows[j]))
            corner = net.head[a]
            for _ in range(net.chained.shape[0]):
                if corner < 0:
                    break
                t = corner // 3
                corner = net.chained[corner]
                if third(net, t, a, b) < 0:
                    continue
                stays = True
                for j in range(old):
                    if gone[j] == t:
                        stays = False
                        break
                if stays:
                    least = min(least, _turn(p, x, y, z, net.triangles[t]))
            if room.marks[i, k] >= 0:
                sharpest = min(sharpest, least)
            elif least < FOLD:
                return True
    return sharpest < rules.turn and not _sharpest(net, room, before) < FOLD


@kernel
def _has(cell: IntArray, v: int) -> bool:
    return bool(cell[0] == v or cell[1] == v or cell[2] == v)


@kernel
def _turn(p: FloatArray, x: float, y: float, z: float, cell: IntArray) -> float:
    """Cosine between (x, y, z) and the normal of a triangle, 1 where one is zero."""
    _, _, _, u, v, w = triangle_in_space(p, cell[0], cell[1], cell[2])
    size = math.sqrt((x * x + y * y + z * z) * (u * u + v * v + w * w))
    return (x * u + y * v + z * w) / size if size > 0.0 else 1.0


@kernel
def _end(net: Net, v: int) -> End:
    p = net.points
    return End(p[v, 0], p[v, 1], p[v, 2], np.int64(net.foot[v]), net.kind[v] == SMOOTH)


@kernel
def exchange(net: Net, room: Room, old: int, new: int, number: int) -> None:
    """Put the new triangles of the room in the place of the old ones."""
    ends = room.exchange
    net.count[2] += 1
    for i in range(old):
        t = ends.old[i]
        _unlink(net, t)
        net.triangles[t, 0] = -1
        net.first[t] = -1
    for i in range(new):
        t = net.count[1]
        if i < old:
            t = np.int64(ends.old[i])
        else:
            net.count[1] += 1
        room.places[i] = t
        for k in range(3):
            net.triangles[t, k] = ends.new[i, k]
            net.marks[t, k] = room.marks[i, k]
            net.stamp[ends.new[i, k]] = net.count[2]
        net.labels[t] = room.labels[i]
        net.first[t] = -1
        link(net, t)
    settle(net.first, net.following, room.places, number, ends)


@kernel
def relative_square(net: Net, a: int, b: int) -> float:
    """Squared length of an edge as it is seen, as a part of that of its size."""
    size = 0.5 * (net.size[a] + net.size[b])
    return seen_square(net.points, a, b) / (size * size)


@kernel
def relative_lengths(net: Net, pairs: IntArray, out: FloatArray) -> None:
    """Lengths of edges (k, 2) as they are seen, as parts of those of their sizes."""
    for k in range(pairs.shape[0]):
        a, b = pairs[k, 0], pairs[k, 1]
        out[k] = math.sqrt(seen_square(net.points, a, b)) / (0.5 * (net.size[a] + net.size[b]))


@kernel
def on_ground(net: Net, values: FloatArray, out: FloatArray) -> None:
    """Mean of values at the corners of a triangle for every ground vertex in its list."""
    for t in range(net.count[1]):
        if net.triangles[t, 0] < 0:
            continue
        i, j, k = net.triangles[t, 0], net.triangles[t, 1], net.triangles[t, 2]
        mean = (values[i] + values[j] + values[k]) / 3.0
        v = net.first[t]
        for _ in range(net.following.shape[0]):
            if v < 0:
                break
            out[v] = mean
            v = net.following[v]
