"""Where an edge of the new surface runs over the input surface, and how far from it.

Two triangulated surfaces that lie upon each other are furthest apart at a vertex of one of them
or where an edge of one crosses an edge of the other: the pieces between are convex, and so is the
distance to a convex piece. Vertices of the new surface lie on the input surface; this file looks
at the crossings, ``owners`` at the vertices of the input. Together they bound both one-sided
distances.
"""

from __future__ import annotations

import math

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.closest import Ground, closest_on_triangle, walk
from odt_plugins.engine.topology.lookup import place_in

CROSSINGS = 128
"""Most edges of the ground that one edge may cross."""

INWARD = 1e-6
"""A foot is taken this part of the way to the barycentre of its triangle: never on an edge."""

ARRIVED = 1e-18
"""Squared distance below which the end of an edge lies on a triangle; coordinates are about 1."""


@kernel
def edge_is_near(
    ax: float, ay: float, az: float, face_a: int, smooth_a: bool,
    bx: float, by: float, bz: float, face_b: int, smooth_b: bool,
    ground: Ground, limit: float,
) -> bool:
    """Whether a straight edge stays close to the ground, and the ground under it to the edge.

    Parameters
    ----------
    ax, ay, az, bx, by, bz : float    ends, on the ground
    face_a, face_b : int              triangle of the ground on which an end lies
    smooth_a, smooth_b : bool         whether the end lies on no feature line: only then is its
                                      triangle on the same side of the line as the edge
    ground : Ground
    limit : float                     squared distance
    """
    if smooth_a:
        return _trace(
            ax, ay, az, face_a, ax, ay, az, bx, by, bz, face_b, smooth_b, ground, limit
        )
    if smooth_b:
        return _trace(bx, by, bz, face_b, bx, by, bz, ax, ay, az, face_a, False, ground, limit)
    mx, my, mz = 0.5 * (ax + bx), 0.5 * (ay + by), 0.5 * (az + bz)
    far, face, x, y, z = walk(mx, my, mz, face_a, ground, False)
    if far > limit:
        return False
    return _trace(
        x, y, z, face, mx, my, mz, ax, ay, az, face_a, False, ground, limit
    ) and _trace(x, y, z, face, mx, my, mz, bx, by, bz, face_b, False, ground, limit)


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
    ax: float, ay: float, az: float, face: int, ox: float, oy: float, oz: float,
    bx: float, by: float, bz: float, last: int, inside: bool,
    ground: Ground, limit: float,
) -> bool:
    """Follow the plane through a, b and the normals from ``face``, which holds a, to b.

    What is crossed must be close to the segment from o, of which a is the foot, to b. ``inside``
    says that b lies within triangle ``last``; otherwise it lies on a feature line, and any
    triangle that holds it will do.
    """
    p = ground.points
    t = ground.triangles
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
