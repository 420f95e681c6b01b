"""Whether a vertex may move, or another one take its place: shapes, envelope, lines, volumes.

A vertex that goes to the place of another one takes all simplices of both with it, which vanish.
What is left are the simplices around it, each with its corner at another place: one test serves
the vertex that moves and the one that goes.
"""

from __future__ import annotations

import math

from odt_plugins.engine.cells.corner import corner_edges, six_volumes
from odt_plugins.engine.cells.extremes import BEST, keeps, worse
from odt_plugins.engine.cells.measures import tet_shape
from odt_plugins.engine.cells.tetrahedron import tet_quality
from odt_plugins.engine.cells.triangle import triangle_in_space
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.closest import closest_on_triangle, walk
from odt_plugins.engine.ground.replace import COVERED, ROOM, gather, may_replace, settle
from odt_plugins.engine.remesh.body import INSIDE, LINE, Body, Guard, Scratch
from odt_plugins.engine.remesh.boxes import closest_of
from odt_plugins.engine.remesh.simplices import holds, star
from odt_plugins.mesh.arrays import FloatArray, IntArray

FLAT = 1e-6
"""No new tetrahedron has a smaller radius ratio."""

POOR = 0.5
"""Radius ratio below which the angles of new tetrahedra count: those of no better one are below 15
or above 150 degrees."""


@kernel
def fits(body: Body, guard: Guard, u: int, v: int, scratch: Scratch) -> bool:
    """Whether vertex u may go to the place in points[v], as v or, if v is the last row, itself.

    The last row of the points is no vertex.

    Parameters
    ----------
    scratch : Scratch    OUT: tetrahedra around u in ``first``, triangles in ``second``, segments in
                         ``third``, and what the new triangles and segments are to carry
    """
    cells = star(body.tets, u, scratch.first)
    if cells < 0 or not _tets_fit(body, guard, u, v, cells, scratch.first):
        return False
    if body.kind[u] == INSIDE:
        return True
    triangles = star(body.triangles, u, scratch.second)
    if triangles < 0 or triangles > ROOM:
        return False
    if not _triangles_fit(body, guard, u, v, triangles, scratch):
        return False
    if body.kind[u] == LINE:
        segments = star(body.segments, u, scratch.third)
        if segments != 2 or not _line_fits(body, guard, u, v, scratch.third):
            return False
    return _volume_fits(body, guard, u, v, cells, scratch.first)


@kernel
def corner(rows: IntArray, c: int, i: int, u: int, v: int) -> int:
    """Vertex i of simplex c, v for u."""
    w = rows[c, i]
    return v if w == u else w


@kernel
def _tets_fit(body: Body, guard: Guard, u: int, v: int, count: int, cells: IntArray) -> bool:
    """Whether the new tetrahedra are positive, and none passes the limits and those that go."""
    t, p = body.tets.rows, body.points
    new, old = BEST, BEST
    for s in range(count):
        c = cells[s]
        if holds(body.tets, c, v):
            continue
        i, j = corner(t, c, 0, u, v), corner(t, c, 1, u, v)
        k, l = corner(t, c, 2, u, v), corner(t, c, 3, u, v)
        quality = tet_quality(p, i, j, k, l)
        if not quality >= FLAT:
            return False
        if quality < POOR:
            new = worse(new, tet_shape(p, i, j, k, l))
    if keeps(new, guard.least):
        return True
    for s in range(count):
        c = cells[s]
        old = worse(old, tet_shape(p, t[c, 0], t[c, 1], t[c, 2], t[c, 3]))
    return keeps(new, worse(old, guard.least))


@kernel
def _volume_fits(body: Body, guard: Guard, u: int, v: int, count: int, cells: IntArray) -> bool:
    """Whether no region gains or loses too much; what it does is written down then."""
    t, p, volume = body.tets.rows, body.points, guard.volume
    for s in range(count):
        c = cells[s]
        now = 0.0
        if not holds(body.tets, c, v):
            now = six_volumes(*corner_edges(
                p, corner(t, c, 0, u, v), corner(t, c, 1, u, v), corner(t, c, 2, u, v),
                corner(t, c, 3, u, v)))
        was = six_volumes(*corner_edges(p, t[c, 0], t[c, 1], t[c, 2], t[c, 3]))
        volume[body.tets.tag[c], 2] += (now - was) / 6.0
    good = True
    for s in range(count):
        r = body.tets.tag[cells[s]]
        after = abs(volume[r, 0] + volume[r, 2])
        good = good and (after <= volume[r, 1] or after <= abs(volume[r, 0]))
    for s in range(count):
        r = body.tets.tag[cells[s]]
        if good:
            volume[r, 0] += volume[r, 2]
        volume[r, 2] = 0.0
    return good


@kernel
def _triangles_fit(body: Body, guard: Guard, u: int, v: int, count: int, scratch: Scratch) -> bool:
    """Whether the new triangles are within the envelope of their patches and cover them."""
    t, p, cells = body.triangles.rows, body.points, scratch.second
    left = 0
    for s in range(count):
        c = cells[s]
        if body.triangles.held[c]:
            return False
        if holds(body.triangles, c, v):
            continue
        left += 1
        _, _, _, ax, ay, az = triangle_in_space(p, t[c, 0], t[c, 1], t[c, 2])
        _, _, _, bx, by, bz = triangle_in_space(
            p, corner(t, c, 0, u, v), corner(t, c, 1, u, v), corner(t, c, 2, u, v))
        length = math.sqrt((ax * ax + ay * ay + az * az) * (bx * bx + by * by + bz * bz))
        if not ax * bx + ay * by + az * bz >= guard.limits[2] * length or not length > 0.0:
            return False
    return left > 0 and _patches(body, guard, u, v, count, scratch, False)


@kernel
def _patches(
    body: Body, guard: Guard, u: int, v: int, count: int, scratch: Scratch, write: bool
) -> bool:
    """Whether every patch around u fits its ground; if asked to, write down who carries what."""
    tags, cells = body.triangles.tag, scratch.second
    for s in range(count):
        seen = False
        for r in range(s):
            seen = seen or tags[cells[r]] == tags[cells[s]]
        if not seen and not _patch(body, guard, u, v, count, scratch, tags[cells[s]], write):
            return False
    return True


@kernel
def _of_one_patch(body: Body, count: int, triangles: IntArray) -> bool:
    """Whether all of some triangles belong to one patch."""
    tags = body.triangles.tag
    for s in range(1, count):
        if tags[triangles[s]] != tags[triangles[0]]:
            return False
    return True


@kernel
def near_ground(body: Body, guard: Guard, tag: int, w: int, scratch: Scratch) -> float:
    """Length, how far a patch may be from its ground near vertex w, -1 where w is too far; the
    triangle of the ground is written down, and the next search starts there.
    """
    x, y, z = body.points[w, 0], body.points[w, 1], body.points[w, 2]
    square, face = math.inf, scratch.foot[w]
    limit = guard.limits[0] * guard.limits[0]
    if face >= 0 and guard.boxes.label[face] == tag:
        square, face, _, _, _ = walk(x, y, z, face, guard.ground, False)
    if not square <= limit:
        _, face, _, _, _ = closest_of(guard.boxes, tag, x, y, z, limit)
    if face < 0:
        return -1.0
    scratch.foot[w] = face
    return guard.reach[face]


@kernel
def _patch(
    body: Body, guard: Guard, u: int, v: int, count: int, scratch: Scratch, tag: int, write: bool
) -> bool:
    """The same of one patch."""
    p, room, limits = body.points, scratch.exchange, guard.limits
    old, new, reach = 0, 0, limits[0]
    scratch.clock[0] += 1
    for s in range(count):
        c = scratch.second[s]
        if body.triangles.tag[c] != tag:
            continue
        room.old[old] = c
        old += 1
        if holds(body.triangles, c, v):
            continue
        for i in range(3):
            w = corner(body.triangles.rows, c, i, u, v)
            room.new[new, i] = w
            if scratch.mark[w] == scratch.clock[0]:
                continue
            scratch.mark[w] = scratch.clock[0]
            reach = min(reach, near_ground(body, guard, tag, w, scratch))
            if reach < 0.0:
                return False
        scratch.places[new] = c
        new += 1
    number = gather(guard.first, guard.following, old, room)
    if number < 0 or not may_replace(
            p, scratch.foot, new, number, limits[1], guard.ground, reach, room):
        return False
    if write:
        _settle(guard, old, scratch)
    return True


@kernel
def _settle(guard: Guard, count: int, scratch: Scratch) -> None:
    """Give what ``count`` old triangles carried to the new ones, right after these were tested."""
    room = scratch.exchange
    number = gather(guard.first, guard.following, count, room)
    for s in range(count):
        guard.first[room.old[s]] = -1
    settle(guard.first, guard.following, scratch.places, number, room)


@kernel
def _line_fits(body: Body, guard: Guard, u: int, v: int, segments: IntArray) -> bool:
    """Whether the segments that are left are near all vertices of the line they stand for.

    A line whose vertices are near a segment between two points of it is near all of the segment.
    """
    rows, lines = body.segments.rows, guard.curves.points
    limit = guard.limits[0] * guard.limits[0]
    for s in range(2):
        if body.segments.held[segments[s]]:
            return False
        w = guard.on_line[segments[s]]
        for _ in range(guard.next_on_line.shape[0]):
            if w < 0:
                break
            best = math.inf
            for r in range(2):
                c = segments[r]
                if not holds(body.segments, c, v):
                    best = min(best, _from_segment(
                        lines, w, body.points, corner(rows, c, 0, u, v), corner(rows, c, 1, u, v)))
            if not best <= limit:
                return False
            w = guard.next_on_line[w]
    return True


@kernel
def _from_segment(lines: FloatArray, w: int, points: FloatArray, a: int, b: int) -> float:
    """Squared distance of a vertex of a line from a segment."""
    return closest_on_triangle(lines[w, 0], lines[w, 1], lines[w, 2], points, a, b, b)[0]


@kernel
def carry(body: Body, guard: Guard, u: int, v: int, scratch: Scratch) -> None:
    """Write down what the new triangles and segments carry, right after :func:`fits`."""
    if body.kind[u] == INSIDE:
        return
    count = star(body.triangles, u, scratch.second)
    if _of_one_patch(body, count, scratch.second):
        _settle(guard, count, scratch)
    else:
        _patches(body, guard, u, v, count, scratch, True)
    if body.kind[u] != LINE:
        return
    segments, rows, lines = scratch.third, body.segments.rows, guard.curves.points
    count = 0
    chosen = scratch.exchange.covered
    for s in range(2):
        w = guard.on_line[segments[s]]
        guard.on_line[segments[s]] = -1
        for _ in range(COVERED):
            if w < 0:
                break
            best, at = math.inf, 0
            for r in range(2):
                c = segments[r]
                if not holds(body.segments, c, v):
                    far = _from_segment(
                        lines, w, body.points, corner(rows, c, 0, u, v), corner(rows, c, 1, u, v))
                    if far < best:
                        best, at = far, r
            chosen[count, 0], chosen[count, 1] = w, at
            count += 1
            w = guard.next_on_line[w]
    for i in range(count):
        w, c = chosen[i, 0], segments[chosen[i, 1]]
        guard.next_on_line[w] = guard.on_line[c]
        guard.on_line[c] = w


@kernel
def move(
    body: Body, guard: Guard, u: int, place: tuple[float, float, float], scratch: Scratch
) -> bool:
    """Move vertex u if it may go there; says whether."""
    p = body.points
    last = p.shape[0] - 1
    p[last, 0], p[last, 1], p[last, 2] = place
    scratch.foot[last] = scratch.foot[u]
    if not fits(body, guard, u, last, scratch):
        return False
    carry(body, guard, u, last, scratch)
    scratch.foot[u] = scratch.foot[last]
    p[u, 0], p[u, 1], p[u, 2] = place
    return True


@kernel
def normal_of_star(
    body: Body, u: int, scratch: Scratch
) -> tuple[float, float, float, float]:
    """Direction of the vector area of the triangles around u, and twice its length."""
    t = body.triangles.rows
    count = star(body.triangles, u, scratch.second)
    x = y = z = 0.0
    for s in range(count):
        c = scratch.second[s]
        _, _, _, nx, ny, nz = triangle_in_space(body.points, t[c, 0], t[c, 1], t[c, 2])
        x, y, z = x + nx, y + ny, z + nz
    size = math.sqrt(x * x + y * y + z * z)
    return (x / size, y / size, z / size, size) if size > 0.0 else (0.0, 0.0, 0.0, 0.0)


@kernel
def share_triangle(body: Body, guard: Guard, c: int, d: int) -> None:
    """Give what triangle c carried to the nearer one of c and d, its halves."""
    t, p, g = body.triangles.rows, body.points, guard.ground.points
    w = guard.first[c]
    guard.first[c] = guard.first[d] = -1
    for _ in range(guard.following.shape[0]):
        if w < 0:
            break
        after = guard.following[w]
        x, y, z = g[w, 0], g[w, 1], g[w, 2]
        here = closest_on_triangle(x, y, z, p, t[c, 0], t[c, 1], t[c, 2])[0]
        there = closest_on_triangle(x, y, z, p, t[d, 0], t[d, 1], t[d, 2])[0]
        to = c if here <= there else d
        guard.following[w] = guard.first[to]
        guard.first[to] = w
        w = after


@kernel
def share_segment(body: Body, guard: Guard, c: int, d: int) -> None:
    """The same of a segment."""
    rows, lines = body.segments.rows, guard.curves.points
    w = guard.on_line[c]
    guard.on_line[c] = guard.on_line[d] = -1
    for _ in range(guard.next_on_line.shape[0]):
        if w < 0:
            break
        after = guard.next_on_line[w]
        here = _from_segment(lines, w, body.points, rows[c, 0], rows[c, 1])
        there = _from_segment(lines, w, body.points, rows[d, 0], rows[d, 1])
        to = c if here <= there else d
        guard.next_on_line[w] = guard.on_line[to]
        guard.on_line[to] = w
        w = after
