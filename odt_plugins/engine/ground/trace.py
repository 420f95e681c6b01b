"""Where an edge of the new surface runs over the input surface, and how far from it.

Two triangulated surfaces that lie upon each other are furthest apart at a vertex of one of them
or where an edge of one crosses an edge of the other: the pieces between are convex, and so is the
distance to a convex piece. Vertices of the new surface lie on the input surface; this file looks
at the crossings, ``owners`` at the vertices of the input. Together they bound both one-sided
distances.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.closest import Ground, closest_on_triangle, walk
from odt_plugins.engine.topology.lookup import place_in

CROSSINGS = 1 << 10
"""Most edges of the ground that one edge may cross: all needles of a fan, for one."""

INWARD = 1e-6
"""A foot is taken this part of the way to the barycentre of its triangle: never on an edge."""

ARRIVED = 1e-18
"""Squared distance below which the end of an edge lies on a triangle; coordinates are about 1."""


class End(NamedTuple):
    """An end of an edge.

    Attributes
    ----------
    x, y, z : float    on the ground
    face : int64       triangle of the ground on which it lies
    inside : bool      whether it lies on no feature line: only then is its triangle on the same
                       side of the line as the edge
    """

    x: float
    y: float
    z: float
    face: np.int64
    inside: bool


@kernel
def edge_is_near(a: End, b: End, ground: Ground, limit: float) -> bool:
    """Whether a straight edge stays close to the ground, and the ground under it to the edge.

    Parameters
    ----------
    a, b : End
    ground : Ground
    limit : float    squared distance
    """
    if a.inside:
        return _trace(a, a.x, a.y, a.z, b, ground, limit)
    if b.inside:
        return _trace(b, b.x, b.y, b.z, a, ground, limit)
    mx, my, mz = 0.5 * (a.x + b.x), 0.5 * (a.y + b.y), 0.5 * (a.z + b.z)
    far, face, x, y, z = walk(mx, my, mz, a.face, ground, False)
    if far > limit:
        return False
    middle = End(x, y, z, np.int64(face), True)
    return _trace(middle, mx, my, mz, a, ground, limit) and _trace(
        middle, mx, my, mz, b, ground, limit
    )


@kernel
def _inward(
    x: float, y: float, z: float, face: int, ground: Ground
) -> tuple[float, float, float]:
    """Shift a point of a triangle a little towards its barycentre."""
    p = ground.points
    a, b, c = ground.triangles[face, 0], ground.triangles[face, 1], ground.triangles[face, 2]
    return (
        x + INWARD * ((p[a, 0] + p[b, 0] + p[c, 0]) / 3.0 - x),
        y + INWARD * ((p[a, 1] + p[b, 1] + p[c, 1]) / 3.0 - y),
        z + INWARD * ((p[a, 2] + p[b, 2] + p[c, 2]) / 3.0 - z),
    )


@kernel
def _trace(
    a: End, ox: float, oy: float, oz: float, b: End, ground: Ground, limit: float
) -> bool:
    """Follow the plane through a, b and the normals from the triangle of a to that of b.

    What is crossed must be close to the segment from o, of which a is the foot, to b. Any triangle
    that holds b will do where b lies on a feature line.
    """
    p = ground.points
    t = ground.triangles
    ax, ay, az, face, _ = a
    bx, by, bz, last, inside = b
    nx, ny, nz = ground.normals[face, 0], ground.normals[face, 1], ground.normals[face, 2]
    ax, ay, az = _inward(ax, ay, az, face, ground)
    if inside:
        bx, by, bz = _inward(bx, by, bz, last, ground)
        nx += ground.normals[last, 0]
        ny += ground.normals[last, 1]
        nz += ground.normals[last, 2]
    dx, dy, dz = bx - ax, by - ay, bz - az
    ux, uy, uz = bx - ox, by - oy, bz - oz
    length = ux * ux + uy * uy + uz * uz
    # normal of the plane
    mx, my, mz = ny * dz - nz * dy, nz * dx - nx * dz, nx * dy - ny * dx
    entry = -1
    s0, s1, s2 = _sides(ground, face, ax, ay, az, mx, my, mz)
    for _ in range(CROSSINGS):
        if inside:
            if face == last:
                return True
        elif (
            closest_on_triangle(bx, by, bz, p, t[face, 0], t[face, 1], t[face, 2])[0] < ARRIVED
        ):
            return True
        furthest = -math.inf
        exit_edge = -1
        qx = qy = qz = 0.0
        for i in range(3):
            if i == entry:
                continue
            if i == 0:
                s, r = s1, s2
            elif i == 1:
                s, r = s2, s0
            else:
                s, r = s0, s1
            if (s >= 0.0) == (r >= 0.0):
                continue
            j, k = t[face, (i + 1) % 3], t[face, (i + 2) % 3]
            w = s / (s - r)
            x = p[j, 0] + w * (p[k, 0] - p[j, 0])
            y = p[j, 1] + w * (p[k, 1] - p[j, 1])
            z = p[j, 2] + w * (p[k, 2] - p[j, 2])
            along = (x - ax) * dx + (y - ay) * dy + (z - az) * dz
            if along > furthest:
                furthest = along
                exit_edge = i
                qx, qy, qz = x, y, z
        if exit_edge < 0:
            return False
        qx -= ox
        qy -= oy
        qz -= oz
        w = (qx * ux + qy * uy + qz * uz) / length if length > 0.0 else 0.0
        w = min(max(w, 0.0), 1.0)
        ex, ey, ez = qx - w * ux, qy - w * uy, qz - w * uz
        if ex * ex + ey * ey + ez * ez > limit:
            return False
        near = ground.neighbors[face, exit_edge]
        if near < 0:
            return False
        entry = (place_in(t, near, t[face, (exit_edge + 1) % 3]) + 1) % 3
        face = near
        s0, s1, s2 = _sides(ground, face, ax, ay, az, mx, my, mz)
    return False


@kernel
def _sides(
    ground: Ground, face: int, x: float, y: float, z: float, mx: float, my: float, mz: float
) -> tuple[float, float, float]:
    """On which side of the plane through (x, y, z) with normal m the corners of a triangle lie."""
    p = ground.points
    a, b, c = ground.triangles[face, 0], ground.triangles[face, 1], ground.triangles[face, 2]
    return (
        mx * (p[a, 0] - x) + my * (p[a, 1] - y) + mz * (p[a, 2] - z),
        mx * (p[b, 0] - x) + my * (p[b, 1] - y) + mz * (p[b, 2] - z),
        mx * (p[c, 0] - x) + my * (p[c, 1] - y) + mz * (p[c, 2] - z),
    )
