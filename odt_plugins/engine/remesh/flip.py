"""Flip: an edge of a patch gives way to the other diagonal, with the tetrahedra on its sides.

The tetrahedra around an edge ab on one side of the surface form an open ring r0, ..., rn from one
triangle to the other. The polygon r0 ... rn is filled anew, which leaves out ab and puts r0 rn on
the surface; one tetrahedron alone is flat against the surface and goes to the other side.
"""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.cells.corner import corner_edges, six_volumes
from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import keeps, worse
from odt_plugins.engine.cells.measures import QUALITY, tet_shape
from odt_plugins.engine.cells.triangle import offset, triangle_in_space
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.ground.replace import gather, may_replace, settle
from odt_plugins.engine.moves.cavity import MAX_RING, Ring, make_ring, triangulate_ring, write_ring
from odt_plugins.engine.remesh.body import FREELY, Body, Guard, Scratch
from odt_plugins.engine.remesh.guard import FLAT, POOR, near_ground
from odt_plugins.engine.remesh.simplices import (
    Simplices,
    around,
    become,
    copied,
    has_room_for,
    holds,
    remove,
)
from odt_plugins.mesh.arrays import IntArray

POWER = 2.0
"""Exponent p of F_p = sum of q^-p."""

LEAST = 1e-6
"""Radius ratio of a triangle that worse ones count as."""

GAIN = 0.05
"""Part by which F_p of the two triangles must fall."""

LIFT = 0.5
"""Part of the envelope by which the surface may go up or down in the middle of an edge."""

BENT = 0.8
"""Least cosine between the normals of the new triangles and that of both together."""


@allocating_kernel
def flip_patches(body: Body, guard: Guard, edges: IntArray, scratch: Scratch) -> int:
    """Flip edges of patches where the triangles become better; returns how many.

    Parameters
    ----------
    edges : (e, 2) int32    any edges of the surface, one after the other
    """
    rings = (make_ring(np.empty(0), np.bool_(False)), make_ring(np.empty(0), np.bool_(False)))
    done = 0
    for e in range(edges.shape[0]):
        if _flip(body, guard, edges[e, 0], edges[e, 1], rings, scratch):
            done += 1
    return done


@kernel
def _flip(
    body: Body, guard: Guard, a: int, b: int, rings: tuple[Ring, Ring], scratch: Scratch
) -> bool:
    """Flip one edge, if that pays and may be."""
    triangles, tets = body.triangles, body.tets
    if body.hold[a] != FREELY and body.hold[b] != FREELY:
        return False
    if around(triangles, a, b, scratch.second) != 2 or around(
            body.segments, a, b, scratch.third) != 0:
        return False
    t, s = scratch.second[0], scratch.second[1]
    if triangles.tag[t] != triangles.tag[s] or triangles.held[t] or triangles.held[s]:
        return False
    c, d = _third(triangles, t, a, b), _third(triangles, s, a, b)
    if not _follows(triangles, t, a, b):
        a, b = b, a
    if not _follows(triangles, s, b, a) or not _pays(body, a, b, c, d):
        return False
    if around(triangles, c, d, scratch.third) != 0 or around(
            body.segments, c, d, scratch.third) != 0:
        return False
    cells = around(tets, a, b, scratch.first)
    linked = around(tets, c, d, scratch.third)
    if cells <= 0 or linked < 0:
        return False
    low, high = guard.sides[triangles.tag[t], 0], guard.sides[triangles.tag[t], 1]
    first = _ring(body, a, b, c, d, low, cells, scratch.first, rings[0])
    second = 0
    if high >= 0:
        second = _ring(body, a, b, c, d, high, cells, scratch.first, rings[1])
        if second == 0:
            return False
    if first == 0 or first + second != cells:
        return False
    # where one tetrahedron goes, its edge cd is one of others of its region as well
    apart = linked == 0
    if first == 1 or second == 1:
        apart = linked > 1 and first != second
        for i in range(linked):
            apart = apart and tets.tag[scratch.third[i]] == (low if first == 1 else high)
    if not apart or not has_room_for(tets, cells):
        return False
    if not _filled(body, guard, a, b, first, rings[0]):
        return False
    if not _filled(body, guard, a, b, second, rings[1]):
        return False
    if not _volumes_fit(body, guard, low, high, first, second, rings):
        return False
    if not _stands(body, guard, a, b, c, d, t, s, scratch):
        return False
    _spend(body, guard, low, first, rings[0])
    _spend(body, guard, high, second, rings[1])
    _exchange(tets, first, rings[0])
    _exchange(tets, second, rings[1])
    room = scratch.exchange
    become(triangles, t, room.new, 0)
    become(triangles, s, room.new, 1)
    return True


@kernel
def _third(triangles: Simplices, t: int, a: int, b: int) -> int:
    """Vertex of a triangle that is neither a nor b."""
    rows = triangles.rows
    return rows[t, 0] + rows[t, 1] + rows[t, 2] - a - b


@kernel
def _follows(triangles: Simplices, t: int, a: int, b: int) -> bool:
    """Whether b comes after a in triangle t."""
    rows = triangles.rows
    for i in range(3):
        if rows[t, i] == a:
            return rows[t, (i + 1) % 3] == b
    return False


@kernel
def _pays(body: Body, a: int, b: int, c: int, d: int) -> bool:
    """Whether F_p of the triangles falls, whose normals hardly turn."""
    p = body.points
    q, _, _, px, py, pz = triangle_in_space(p, a, b, c)
    r, _, _, qx, qy, qz = triangle_in_space(p, b, a, d)
    now = max(q, LEAST) ** -POWER + max(r, LEAST) ** -POWER
    x, y, z = px + qx, py + qy, pz + qz
    q, _, _, px, py, pz = triangle_in_space(p, a, d, c)
    r, _, _, qx, qy, qz = triangle_in_space(p, b, c, d)
    then = max(q, LEAST) ** -POWER + max(r, LEAST) ** -POWER
    if not then < (1.0 - GAIN) * now:
        return False
    whole = x * x + y * y + z * z
    one = math.sqrt(whole * (px * px + py * py + pz * pz))
    other = math.sqrt(whole * (qx * qx + qy * qy + qz * qz))
    return (one > 0.0 and other > 0.0 and x * px + y * py + z * pz >= BENT * one
            and x * qx + y * qy + z * qz >= BENT * other)


@kernel
def _ring(
    body: Body, a: int, b: int, c: int, d: int, tag: int, count: int, cells: IntArray, ring: Ring
) -> int:
    """Collect the tetrahedra of a region around ab, from c to d or back; 0 where it cannot be."""
    tets = body.tets
    ring.vertices[0] = c
    at, behind = c, -1
    for n in range(1, MAX_RING):
        found = -1
        for i in range(count):
            k = cells[i]
            if k != behind and tets.tag[k] == tag and holds(tets, k, at):
                found = k
        if found < 0:
            return 0
        rows = tets.rows
        at = rows[found, 0] + rows[found, 1] + rows[found, 2] + rows[found, 3] - a - b - at
        behind = found
        ring.cells[n - 1], ring.vertices[n] = found, at
        if at == d:
            if six_volumes(*corner_edges(
                    body.points, a, b, ring.vertices[0], ring.vertices[1])) < 0.0:
                for i in range((n + 1) // 2):
                    v = ring.vertices[i]
                    ring.vertices[i] = ring.vertices[n - i]
                    ring.vertices[n - i] = v
            return n
    return 0


@kernel
def _filled(body: Body, guard: Guard, a: int, b: int, n: int, ring: Ring) -> bool:
    """Fill the polygon of a ring of n; whether none passes the limits and those that go."""
    if n <= 1:
        return True
    p, t = body.points, body.tets.rows
    limit = guard.least
    for m in range(n):
        k = ring.cells[m]
        limit = worse(limit, tet_shape(p, t[k, 0], t[k, 1], t[k, 2], t[k, 3]))
    cost = Cost(QUALITY, POWER)
    if not triangulate_ring(p, a, b, n + 1, cost, math.inf, ring) < math.inf:
        return False
    for m in range(write_ring(a, b, n + 1, ring)):
        v = ring.new
        found = tet_shape(p, v[m, 0], v[m, 1], v[m, 2], v[m, 3])
        if not found.quality >= FLAT or (found.quality < POOR and not keeps(found, limit)):
            return False
    return True


@kernel
def _change(body: Body, n: int, ring: Ring) -> float:
    """Volume that a region gains."""
    p, t, v = body.points, body.tets.rows, ring.new
    total = 0.0
    for m in range(n):
        k = ring.cells[m]
        total -= six_volumes(*corner_edges(p, t[k, 0], t[k, 1], t[k, 2], t[k, 3]))
    for m in range(2 * (n - 1)):
        total += six_volumes(*corner_edges(p, v[m, 0], v[m, 1], v[m, 2], v[m, 3]))
    return total / 6.0


@kernel
def _volumes_fit(
    body: Body, guard: Guard, low: int, high: int, first: int, second: int,
    rings: tuple[Ring, Ring],
) -> bool:
    """Whether no region gains or loses too much."""
    for i in range(2):
        n, region = (first, low) if i == 0 else (second, high)
        if n > 0:
            change = _change(body, n, rings[0] if i == 0 else rings[1])
            after = abs(guard.volume[region, 0] + change)
            if after > guard.volume[region, 1] and after > abs(guard.volume[region, 0]):
                return False
    return True


@kernel
def _spend(body: Body, guard: Guard, region: int, n: int, ring: Ring) -> None:
    """Write down what a region gains."""
    if n > 0:
        guard.volume[region, 0] += _change(body, n, ring)


@kernel
def _stands(
    body: Body, guard: Guard, a: int, b: int, c: int, d: int, t: int, s: int, scratch: Scratch
) -> bool:
    """Whether the new triangles are within the envelope and cover the ground; written down then."""
    room, tag = scratch.exchange, body.triangles.tag[t]
    room.old[0], room.old[1] = t, s
    room.new[0, 0], room.new[0, 1], room.new[0, 2] = a, d, c
    room.new[1, 0], room.new[1, 1], room.new[1, 2] = b, c, d
    reach = guard.limits[0]
    for i in range(2):
        for j in range(3):
            reach = min(reach, near_ground(body, guard, tag, room.new[i, j], scratch))
    if reach < 0.0 or not _between(body, a, b, c, d) <= LIFT * reach:
        return False
    number = gather(guard.first, guard.following, 2, room)
    if number < 0 or not may_replace(
            body.points, scratch.foot, 2, number, guard.limits[1], guard.ground, reach, room):
        return False
    guard.first[t] = guard.first[s] = -1
    scratch.places[0], scratch.places[1] = t, s
    settle(guard.first, guard.following, scratch.places, number, room)
    return True


@kernel
def _between(body: Body, a: int, b: int, c: int, d: int) -> float:
    """Distance between the lines ab and cd: that by which the surface goes up or down."""
    p = body.points
    ux, uy, uz = offset(p, a, b)
    vx, vy, vz = offset(p, c, d)
    x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    area = math.sqrt(x * x + y * y + z * z)
    if not area > 0.0:
        return math.inf
    return abs(six_volumes(*corner_edges(p, a, b, c, d))) / area


@kernel
def _exchange(tets: Simplices, n: int, ring: Ring) -> None:
    """Put the new tetrahedra of a ring in the place of its n old ones."""
    new = 2 * (n - 1) if n > 0 else 0
    for m in range(n, new):
        ring.cells[m] = copied(tets, ring.cells[0], 0, 0)
    for m in range(n):
        if m < new:
            become(tets, ring.cells[m], ring.new, m)
        else:
            remove(tets, ring.cells[m])
    for m in range(n, new):
        become(tets, ring.cells[m], ring.new, m)
