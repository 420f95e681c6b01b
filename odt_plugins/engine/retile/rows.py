"""A surface whose inner vertices give way to others, laid out in rows from its lines.

Vertices are inserted at the places of ``front``; then those that were there collapse into them.
"""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.cells.extremes import FREELY
from odt_plugins.engine.cells.triangle import offset
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.closest import CLOSER, closest_on_triangle, walk
from odt_plugins.engine.ground.reference import make_reference
from odt_plugins.engine.ground.sheet import LINE, LOCKED, SMOOTH
from odt_plugins.engine.retile.collapse import collapse_edges
from odt_plugins.engine.retile.even import even_lines
from odt_plugins.engine.retile.front import Field, Front, make_front, place_rows
from odt_plugins.engine.retile.net import (
    THINNEST,
    Net,
    Room,
    Rules,
    edge_triangles,
    exchange,
    fits,
    put,
)
from odt_plugins.engine.retile.passes import Passes, edges_of, grown
from odt_plugins.mesh.arrays import IntArray

INSIDE = 0.02
"""Least barycentric coordinate of a vertex in the triangle into which it is put."""

LEVEL, BEND = 1e-8, 0.25
"""Part of its size that a place may be over a plane ground, and over a curved one."""

STEPS = 1000
"""Most triangles on the way to a place."""

SPARE = 1.5
"""Multiple of the vertices that sizes ask for that there is room for."""

MOST_LEFT = 0.06
"""Part of the vertices that may be some which did not give way, as the envelope holds them; where
there are more, all stay."""

TURNS = 20
"""Most passes in which vertices that give way collapse."""


def lay_in_rows(net: Net, passes: Passes, patches: IntArray) -> Net:
    """Lay the inner vertices of a surface out anew.

    Parameters
    ----------
    net : Net           changed
    passes : Passes
    patches : (m,) int32    of the triangles of the ground, which lines divide
    """
    net = even_lines(net, passes)
    n, ground, sizes = int(net.count[0]), passes.rules.ground, passes.sizes
    u, v = (ground.points[ground.triangles[:, i]] - ground.points[ground.triangles[:, 0]]
            for i in (1, 2))
    area = 0.5 * np.sqrt((np.cross(u, v) ** 2).sum(axis=1))
    wanted = float((area * (sizes[ground.triangles] ** -2.0).mean(axis=1)).sum())
    if not 2.0 * wanted < passes.most:
        return net
    flat = not ground.points[:, 2].any()
    field = Field(ground, sizes, patches, float(sizes.min()),
                  LEVEL if flat else BEND)
    outer, foot, edges = _first_edges(net, field)
    before = passes.kept(net)
    seeds = outer[net.kind[outer] == SMOOTH]
    net.kind[seeds] = LOCKED
    front = make_front(net.points[outer, :3], foot, net.size[outer], edges,
                       int(SPARE * wanted) + 100)
    if not place_rows(front, field):
        return passes.back(before)
    more = int(front.count[0]) - len(outer)
    net = grown(net, more, 2 * more)
    number = np.zeros(len(front.points), dtype=np.int32)
    number[: len(outer)] = outer
    free = passes.rules._replace(bounds=FREELY, longest=math.inf, shortest=math.inf)
    insert_vertices(net, free, front, number, len(outer), passes.thin, passes.room)
    for _ in range(TURNS):
        passes.flip(net, 1.0)
        passes.shift(net, 0.0)
        pairs, ratio, _ = edges_of(net, -1)
        old = (net.kind[pairs] == SMOOTH) & (pairs < n)
        chosen = np.flatnonzero(old.any(axis=1) & ~old.all(axis=1))
        chosen = chosen[np.argsort(ratio[chosen], kind="stable")]
        if not collapse_edges(net, free, pairs[chosen], passes.room):
            break
    alive = net.head[: net.count[0]] >= 0
    if (alive[:n] & (net.kind[:n] == SMOOTH)).sum() > MOST_LEFT * alive.sum():
        return passes.back(before)
    net.kind[n : net.count[0]] = SMOOTH
    net.kind[seeds] = SMOOTH
    passes.measure(net)
    return net


def _first_edges(net: Net, field: Field) -> tuple[IntArray, IntArray, IntArray]:
    """Vertices (k,) of the net in the front, their triangles of the ground, and edges (e, 2).

    Edges along one line after another with the patch at their left; in a patch without a line those
    of one triangle, and its outside.
    """
    triangles, marks = net.triangles[: net.count[1]], net.marks[: net.count[1]]
    row, corner = np.nonzero((marks >= 0) & (triangles[:, :1] >= 0))
    ends = triangles[row[:, None], (corner[:, None] + [1, 2]) % 3]
    on = net.kind[ends] == LINE
    place = (net.place[ends] * on).sum(axis=1) / np.maximum(on.sum(axis=1), 1)
    along = np.lexsort((place, marks[row, corner]))
    row, ends = row[along], ends[along]
    alive = np.flatnonzero(net.head[: net.count[0]] >= 0)
    foot = net.foot[alive]
    reference = make_reference(field.ground.points, field.ground.triangles)
    under = reference.closest(net.points[triangles[row], :3].mean(axis=1))[1]
    inner = (net.kind[alive] == SMOOTH) & ~np.isin(field.patches[foot], field.patches[under])
    _, first = np.unique(field.patches[foot[inner]], return_index=True)
    alone = net.head[alive[inner][first]] // 3
    ends = np.concatenate([ends, triangles[alone][:, [[1, 0], [2, 1], [0, 2]]].reshape(-1, 2)])
    under = np.concatenate([under, np.repeat(foot[inner][first], 3)])
    n = len(net.points)
    key = field.patches[under].astype(np.int64)[:, None] * n + ends
    known, at, edges = np.unique(key, return_index=True, return_inverse=True)
    outer, foot = (known % n).astype(np.int32), np.repeat(under, 2)[at]
    held = alive[(net.kind[alive] == LOCKED) & ~np.isin(alive, outer)].astype(np.int32)
    return (np.concatenate([outer, held]), np.concatenate([foot, net.foot[held]]),
            edges.reshape(-1, 2).astype(np.int32))


@kernel
def insert_vertices(
    net: Net, rules: Rules, front: Front, number: IntArray, first: int, thin: float, room: Room
) -> int:
    """Insert the vertices of a front from a first one on; how many were.

    They are LOCKED. ``number`` (n,) gets the vertex of the net that each of the front is, or is
    near. No new triangle has an altitude below ``thin`` or THINNEST of its longest edge.
    """
    count = 0
    for k in range(first, front.count[0]):
        start = number[front.base[k]]
        number[k] = start
        t = _holder(net, front, k, start, room)
        if t >= 0 and _insert(net, rules, t, front, k, thin, room):
            number[k] = net.count[0] - 1
            count += 1
    return count


@kernel
def _distance(net: Net, front: Front, k: int, t: int) -> tuple[float, int]:
    """Squared distance of a place from a triangle, and where it is, see closest_on_triangle."""
    p, q = front.points, net.triangles
    far, where, _, _, _ = closest_on_triangle(
        p[k, 0], p[k, 1], p[k, 2], net.points, q[t, 0], q[t, 1], q[t, 2])
    return far, where


@kernel
def _around(
    net: Net, front: Front, k: int, v: int, least: float
) -> tuple[float, int, int]:
    """The triangle around a vertex that is closest to a place, if it is closer than ``least``."""
    found, where = -1, 0
    corner = net.head[v]
    for _ in range(net.chained.shape[0]):
        if corner < 0:
            break
        t = corner // 3
        far, at = _distance(net, front, k, t)
        if far < CLOSER * least:
            found, where, least = t, at, far
        corner = net.chained[corner]
    return least, found, where


@kernel
def _holder(net: Net, front: Front, k: int, start: int, room: Room) -> int:
    """The closest triangle to a place, on a walk from a vertex across no line."""
    least, t, where = _around(net, front, k, start, np.inf)
    for _ in range(STEPS):
        found, at = -1, 0
        if where > 3:
            least, found, at = _around(net, front, k, net.triangles[t, where - 4], least)
        elif where > 0 and net.marks[t, where - 1] < 0:
            a, b = net.triangles[t, where % 3], net.triangles[t, (where + 1) % 3]
            if edge_triangles(net, a, b, room) == 2:
                s = room.exchange.old[1] if room.exchange.old[0] == t else room.exchange.old[0]
                far, side = _distance(net, front, k, s)
                if far < CLOSER * least:
                    found, at, least = s, side, far
        if found < 0:
            break
        t, where = found, at
    return int(t)


@kernel
def _insert(
    net: Net, rules: Rules, t: int, front: Front, k: int, thin: float, room: Room
) -> bool:
    """Divide a triangle into three at a place, at least INSIDE from its sides."""
    p, v = net.points, net.count[0]
    c = net.triangles[t]
    parts = _parts(net, t, front, k)
    whole = parts[0] + parts[1] + parts[2]
    square = 0.0
    for i in range(3):
        x, y, z = offset(p, c[i], c[(i + 1) % 3])
        square = max(square, x * x + y * y + z * z)
    least = max(thin, THINNEST * math.sqrt(square)) / INSIDE
    if not whole > least * least * square:
        return False
    wa, wb, wc = (max(parts[0] / whole, INSIDE), max(parts[1] / whole, INSIDE),
                  max(parts[2] / whole, INSIDE))
    whole = wa + wb + wc
    for i in range(3):
        p[v, i] = (wa * p[c[0], i] + wb * p[c[1], i] + wc * p[c[2], i]) / whole
    _, face, x, y, z = walk(p[v, 0], p[v, 1], p[v, 2], front.foot[k], rules.ground, False)
    p[v, 0], p[v, 1], p[v, 2], net.foot[v] = x, y, z, face
    net.size[v], net.kind[v] = front.size[k], LOCKED
    room.exchange.old[0] = t
    for i in range(3):
        put(net, room, i, t, c[i], v)
        room.marks[i, (i + 1) % 3] = -1
        room.marks[i, (i + 2) % 3] = -1
    number = fits(net, rules, room, v, 1, 3, 1)
    if number < 0:
        net.kind[v] = SMOOTH
        return False
    net.count[0] += 1
    exchange(net, room, 1, 3, number)
    return True


@kernel
def _parts(net: Net, t: int, front: Front, k: int) -> tuple[float, float, float]:
    """Barycentric coordinates of a place over a triangle, times the square of its double area."""
    p, q = net.points, front.points
    a, b, c = net.triangles[t]
    ux, uy, uz = offset(p, a, b)
    vx, vy, vz = offset(p, a, c)
    x, y, z = q[k, 0] - p[a, 0], q[k, 1] - p[a, 1], q[k, 2] - p[a, 2]
    uu, uv = ux * ux + uy * uy + uz * uz, ux * vx + uy * vy + uz * vz
    vv = vx * vx + vy * vy + vz * vz
    up, vp = ux * x + uy * y + uz * z, vx * x + vy * y + vz * z
    s, r = vv * up - uv * vp, uu * vp - uv * up
    return uu * vv - uv * uv - s - r, s, r
