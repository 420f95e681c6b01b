"""A surface in the plane whose inner vertices give way to others, laid out in rows from its lines.

Vertices are inserted at the places of ``front``; then those that were there collapse into them.
"""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.cells.extremes import FREELY
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.sheet import LINE, LOCKED, SMOOTH
from odt_plugins.engine.retile.collapse import collapse_edges
from odt_plugins.engine.retile.even import even_lines
from odt_plugins.engine.retile.front import Front, make_front, place_rows
from odt_plugins.engine.retile.net import Net, Room, Rules, edge_triangles, exchange, fits, put
from odt_plugins.engine.retile.passes import Passes, edges_of, grown
from odt_plugins.mesh.arrays import IntArray

INSIDE = 0.02
"""Least barycentric coordinate of a vertex in the triangle into which it is put."""

STEPS = 1000
"""Most triangles on the way to a place."""

SPARE = 1.5
"""Multiple of the vertices that sizes ask for that there is room for."""

TURNS = 20
"""Most passes in which vertices that give way collapse."""


def lay_in_rows(net: Net, passes: Passes, labels: IntArray) -> Net:
    """Lay the inner vertices of a surface in the plane out anew.

    Parameters
    ----------
    net : Net           changed
    passes : Passes
    labels : (m,) int32    of the triangles of the ground

    Returns
    -------
    Net
    """
    net = even_lines(net, passes)
    n, ground, sizes = int(net.count[0]), passes.rules.ground, passes.sizes
    alive = net.head[:n] >= 0
    outer = np.flatnonzero(alive & (net.kind[:n] != SMOOTH)).astype(np.int32)
    rank = np.full(n, -1, dtype=np.int32)
    rank[outer] = np.arange(len(outer))
    corners = ground.points[ground.triangles, :2]
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    wanted = float((area * (sizes[ground.triangles] ** -2.0).mean(axis=1)).sum())
    if not 2.0 * wanted < passes.most:
        return net
    front = make_front(net.points[outer, :3], net.foot[outer], net.size[outer],
                       _front_edges(net, rank), int(SPARE * wanted) + 100)
    if not place_rows(front, ground, sizes, labels, float(sizes.min())):
        return net
    more = int(front.count[0]) - len(outer)
    net = grown(net, more, 2 * more)
    number = np.zeros(len(front.points), dtype=np.int32)
    number[: len(outer)] = outer
    free = passes.rules._replace(bounds=FREELY, longest=math.inf, shortest=math.inf)
    insert_vertices(net, free, front, number, len(outer), passes.room)
    for _ in range(TURNS):
        passes.flip(net, 1.0)
        passes.shift(net, 0.0)
        pairs, ratio, _ = edges_of(net, -1)
        old = (net.kind[pairs] == SMOOTH) & (pairs < n)
        chosen = np.flatnonzero(old.any(axis=1) & ~old.all(axis=1))
        chosen = chosen[np.argsort(ratio[chosen], kind="stable")]
        if not collapse_edges(net, free, pairs[chosen], passes.room):
            break
    net.kind[n : net.count[0]] = SMOOTH
    passes.measure(net)
    return net


def _front_edges(net: Net, rank: IntArray) -> IntArray:
    """Edges along one line after another with the triangles at their left, as in :class:`Front`."""
    triangles, marks = net.triangles[: net.count[1]], net.marks[: net.count[1]]
    row, corner = np.nonzero((marks >= 0) & (triangles[:, :1] >= 0))
    ends = triangles[row[:, None], (corner[:, None] + [1, 2]) % 3]
    on = net.kind[ends] == LINE
    place = (net.place[ends] * on).sum(axis=1) / np.maximum(on.sum(axis=1), 1)
    along = np.lexsort((place, marks[row, corner]))
    row, ends = row[along], ends[along]
    return np.column_stack([rank[ends], net.labels[row]]).astype(np.int32)


@kernel
def insert_vertices(
    net: Net, rules: Rules, front: Front, number: IntArray, first: int, room: Room
) -> int:
    """Insert the vertices of a front from a first one on; how many were.

    They are LOCKED. ``number`` (n,) gets the vertex of the net that each of the front is, or is
    near.
    """
    count = 0
    for k in range(first, front.count[0]):
        start = number[front.base[k]]
        x, y = front.points[k, 0], front.points[k, 1]
        number[k] = start
        t = _holder(net, x, y, start, room)
        if t >= 0 and _insert(net, rules, t, front, k, room):
            number[k] = net.count[0] - 1
            count += 1
    return count


@kernel
def _part(net: Net, t: int, i: int, x: float, y: float) -> float:
    """Twice the area of a triangle with a place at one of its corners."""
    p = net.points
    a, b = net.triangles[t, (i + 1) % 3], net.triangles[t, (i + 2) % 3]
    return float((p[b, 0] - p[a, 0]) * (y - p[a, 1]) - (p[b, 1] - p[a, 1]) * (x - p[a, 0]))


@kernel
def _holder(net: Net, x: float, y: float, start: int, room: Room) -> int:
    """Triangle that holds a place, on a walk from a vertex; -1 where a rim is in between."""
    t = net.head[start] // 3
    for _ in range(STEPS):
        least, side = 0.0, -1
        for i in range(3):
            part = _part(net, t, i, x, y)
            if part < least:
                least, side = part, i
        if side < 0:
            return int(t)
        a, b = net.triangles[t, (side + 1) % 3], net.triangles[t, (side + 2) % 3]
        if edge_triangles(net, a, b, room) != 2:
            return -1
        t = room.exchange.old[1] if room.exchange.old[0] == t else room.exchange.old[0]
    return -1


@kernel
def _insert(net: Net, rules: Rules, t: int, front: Front, k: int, room: Room) -> bool:
    """Divide a triangle into three at a place, at least INSIDE from its sides."""
    p, v = net.points, net.count[0]
    x, y = front.points[k, 0], front.points[k, 1]
    c = net.triangles[t]
    parts = (_part(net, t, 0, x, y), _part(net, t, 1, x, y), _part(net, t, 2, x, y))
    whole = parts[0] + parts[1] + parts[2]
    if not whole > 0.0:
        return False
    wa, wb, wc = (max(parts[0] / whole, INSIDE), max(parts[1] / whole, INSIDE),
                  max(parts[2] / whole, INSIDE))
    whole = wa + wb + wc
    for i in range(2):
        p[v, i] = (wa * p[c[0], i] + wb * p[c[1], i] + wc * p[c[2], i]) / whole
    p[v, 2] = 0.0
    net.foot[v], net.size[v], net.kind[v] = front.foot[k], front.size[k], LOCKED
    room.exchange.old[0] = t
    for i in range(3):
        put(net, room, i, t, c[i], v)
        room.marks[i, (i + 1) % 3] = -1
        room.marks[i, (i + 2) % 3] = -1
    if fits(net, rules, room, v, 1, 3) < 0:
        net.kind[v] = SMOOTH
        return False
    net.count[0] += 1
    exchange(net, room, 1, 3, 0)
    return True
