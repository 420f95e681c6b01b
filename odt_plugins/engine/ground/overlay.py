"""How far a triangle is from a surface: height over the piece of the surface that lies under it.

Seen along the normal of the triangle T, a triangulated surface cuts T into polygons. Over each of
them the height is linear, so it is largest where an edge of the surface enters or leaves T, ends
within T, or under a corner of T. When every edge met within T has both its triangles in the piece,
the number of sheets over T, counted with sign, is the same everywhere; when it is not zero
somewhere, T is covered, and the largest height bounds the distance from T to the surface.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.closest import Ground
from odt_plugins.mesh.arrays import FloatArray, IntArray

PIECE = 1 << 9
"""Most triangles of the surface that are looked at under one triangle."""

SEARCH = 32
"""Most steps to a triangle of the surface under an inner point of T."""

DEEP = 12
"""Most times that a part of a triangle is cut into four."""

ROUNDING = 1e-14
"""Rounding of a double area, relative to the square of the coordinates it is made of."""


class Work(NamedTuple):
    """Work arrays of one thread.

    Attributes
    ----------
    queue, parents, slots : (PIECE,) int32    triangles met, from where, their places in ``table``
    table : (4 PIECE,) int32                  those that were met already, -1 elsewhere
    feet : (3,) int32                         triangles of the surface near three corners
    faces : (PIECE,) int32                    triangles of the surface near a triangle
    parts : (9 DEEP + 12, 3) float64          corners of the parts that are left to look at
    depths : (3 DEEP + 4,) int32              how often each was cut
    """

    queue: IntArray
    parents: IntArray
    slots: IntArray
    table: IntArray
    feet: IntArray
    faces: IntArray
    parts: FloatArray
    depths: IntArray


def make_overlay_work() -> Work:
    """Make the work arrays of one thread."""
    return Work(
        np.empty(PIECE, np.int32), np.empty(PIECE, np.int32), np.empty(PIECE, np.int32),
        np.full(4 * PIECE, -1, np.int32), np.empty(3, np.int32), np.empty(PIECE, np.int32),
        np.empty((9 * DEEP + 12, 3)), np.empty(3 * DEEP + 4, np.int32),
    )


@kernel
def enter(face: int, table: IntArray) -> int:
    """Enter a triangle into the table: its place, or -1 when it is there already."""
    mask = table.shape[0] - 1
    place = ((face * 40503) ^ (face >> 7)) & mask
    for _ in range(table.shape[0]):
        if table[place] < 0:
            table[place] = face
            return place
        if table[place] == face:
            return -1
        place = (place + 1) & mask
    return -1


@kernel
def _seen(p: FloatArray, i: int, frame: tuple[float, ...]) -> tuple[float, float, float]:
    """Coordinates of point i in a frame: its origin, and three orthonormal axes."""
    x, y, z = p[i, 0] - frame[0], p[i, 1] - frame[1], p[i, 2] - frame[2]
    return (
        x * frame[3] + y * frame[4] + z * frame[5],
        x * frame[6] + y * frame[7] + z * frame[8],
        x * frame[9] + y * frame[10] + z * frame[11],
    )


@kernel
def _triangle_under(
    surface: Ground, start: int, frame: tuple[float, ...], u: float, v: float
) -> int:
    """Walk from a triangle of the surface to one that is seen at (u, v); -1 when it is far."""
    p, t = surface.points, surface.triangles
    face = start
    for _ in range(SEARCH):
        iu, iv, _ = _seen(p, t[face, 0], frame)
        ju, jv, _ = _seen(p, t[face, 1], frame)
        ku, kv, _ = _seen(p, t[face, 2], frame)
        iu, iv, ju, jv, ku, kv = iu - u, iv - v, ju - u, jv - v, ku - u, kv - v
        wi, wj, wk = ju * kv - jv * ku, ku * iv - kv * iu, iu * jv - iv * ju
        if wi + wj + wk < 0.0:
            wi, wj, wk = -wi, -wj, -wk
        if wi >= 0.0 and wj >= 0.0 and wk >= 0.0:
            return face
        low = min(wi, wj, wk)
        out = 0 if wi == low else (1 if wj == low else 2)
        face = surface.neighbors[face, out]
        if face < 0:
            break
    return -1


@kernel
def _part_inside(
    pu: float, pv: float, qu: float, qv: float, corners: tuple[float, ...], slack: float
) -> tuple[float, float]:
    """Part of the edge pq within a triangle (a_u, a_v, b_u, b_v, c_u, c_v) of the plane.

    Returns
    -------
    low, top : float    between 0 at p and 1 at q; low > top when no part is
    """
    au, av, bu, bv, cu, cv = corners
    low, top = 0.0, 1.0
    for side in range(3):
        ou, ov, du, dv = au, av, bu - au, bv - av
        if side == 1:
            ou, ov, du, dv = bu, bv, cu - bu, cv - bv
        elif side == 2:
            ou, ov, du, dv = cu, cv, au - cu, av - cv
        first = du * (pv - ov) - dv * (pu - ou) + slack
        last = du * (qv - ov) - dv * (qu - ou) + slack
        if first < 0.0 and last < 0.0:
            return 2.0, 1.0
        if first < 0.0:
            low = max(low, first / (first - last))
        elif last < 0.0:
            top = min(top, first / (first - last))
    return low, top


@kernel
def height_over(
    points: FloatArray, a: int, b: int, c: int, start: int, surface: Ground,
    shrink: float, limit: float, work: Work,
) -> float:
    """Bound the distance from a triangle to a surface by the heights under it.

    Parameters
    ----------
    points : (n, 3) float64
    a, b, c : int                  corners of T
    start : int                    triangle of the surface near T
    surface : Ground               or any tuple with ``points``, ``triangles`` and ``neighbors``,
                                   triangles oriented alike across an edge that has a neighbour
    shrink : float                 T is shrunk towards its barycentre by this distance at most, so
                                   that edges of the surface along the boundary of T do not count
    limit : float                  stop at a height above this
    work : Work                    from :func:`make_overlay_work`

    Returns
    -------
    float                          no point of T is further from the surface than this; inf when
                                   it is above ``limit`` or nothing can be said
    """
    queue, parents, slots, table = work.queue, work.parents, work.slots, work.table
    p, t, neighbors = surface.points, surface.triangles, surface.neighbors
    gx = (points[a, 0] + points[b, 0] + points[c, 0]) / 3.0
    gy = (points[a, 1] + points[b, 1] + points[c, 1]) / 3.0
    gz = (points[a, 2] + points[b, 2] + points[c, 2]) / 3.0
    ax, ay, az = points[a, 0] - gx, points[a, 1] - gy, points[a, 2] - gz
    bx, by, bz = points[b, 0] - gx, points[b, 1] - gy, points[b, 2] - gz
    cx, cy, cz = points[c, 0] - gx, points[c, 1] - gy, points[c, 2] - gz
    ex, ey, ez = bx - ax, by - ay, bz - az
    fx, fy, fz = cx - ax, cy - ay, cz - az
    nx, ny, nz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
    area = math.sqrt(nx * nx + ny * ny + nz * nz)
    ee = ex * ex + ey * ey + ez * ez
    ff = fx * fx + fy * fy + fz * fz
    size = ee + ff
    if not area > 1e-9 * size:
        return math.inf
    nx, ny, nz = nx / area, ny / area, nz / area
    scale = 1.0 / math.sqrt(ee)
    ex, ey, ez = ex * scale, ey * scale, ez * scale
    fx, fy, fz = ny * ez - nz * ey, nz * ex - nx * ez, nx * ey - ny * ex
    radius = math.sqrt(
        max(ax * ax + ay * ay + az * az, bx * bx + by * by + bz * bz, cx * cx + cy * cy + cz * cz)
    )
    if shrink >= radius:
        return math.inf
    keep = 1.0 - shrink / radius
    # corners of the shrunk triangle in its plane, counterclockwise
    au, av = keep * (ax * ex + ay * ey + az * ez), keep * (ax * fx + ay * fy + az * fz)
    bu, bv = keep * (bx * ex + by * ey + bz * ez), keep * (bx * fx + by * fy + bz * fz)
    cu, cv = keep * (cx * ex + cy * ey + cz * ez), keep * (cx * fx + cy * fy + cz * fz)
    reach = radius
    # an inner point that lies on no edge by symmetry
    su = 0.3716 * au + 0.3301 * bu + 0.2983 * cu
    sv = 0.3716 * av + 0.3301 * bv + 0.2983 * cv
    frame = (gx, gy, gz, ex, ey, ez, fx, fy, fz, nx, ny, nz)
    face = _triangle_under(surface, start, frame, su, sv)
    if face < 0:
        return math.inf
    queue[0] = face
    parents[0] = -1
    slots[0] = enter(face, table)
    count = 1
    sheets = 0
    highest = 0.0
    corners = 0
    for head in range(PIECE):
        if head == count:
            break
        face = queue[head]
        parent = parents[head]
        i, j, k = t[face, 0], t[face, 1], t[face, 2]
        iu, iv, ih = _seen(p, i, frame)
        ju, jv, jh = _seen(p, j, frame)
        ku, kv, kh = _seen(p, k, frame)
        reach = max(reach, abs(iu), abs(iv), abs(ju), abs(jv), abs(ku), abs(kv))
        slack = ROUNDING * reach * reach
        for corner in range(4):
            u, v = au, av
            if corner == 1:
                u, v = bu, bv
            elif corner == 2:
                u, v = cu, cv
            elif corner == 3:
                u, v = su, sv
            wi = (ju - u) * (kv - v) - (jv - v) * (ku - u)
            wj = (ku - u) * (iv - v) - (kv - v) * (iu - u)
            wk = (iu - u) * (jv - v) - (iv - v) * (ju - u)
            low, top = min(wi, wj, wk), max(wi, wj, wk)
            if low < -slack and top > slack:
                continue
            if corner == 3:
                if low > slack:
                    sheets += 1
                elif top < -slack:
                    sheets -= 1
                else:
                    highest = math.inf
            elif top - low > 3.0 * slack:
                corners |= 1 << corner
                highest = max(highest, abs((wi * ih + wj * jh + wk * kh) / (wi + wj + wk)))
        if highest > limit:
            break
        for side in range(3):
            near = neighbors[face, side]
            if near >= 0 and near == parent:
                continue
            pu, pv, ph, qu, qv, qh = ju, jv, jh, ku, kv, kh
            if side == 1:
                pu, pv, ph, qu, qv, qh = ku, kv, kh, iu, iv, ih
            elif side == 2:
                pu, pv, ph, qu, qv, qh = iu, iv, ih, ju, jv, jh
            low, top = _part_inside(pu, pv, qu, qv, (au, av, bu, bv, cu, cv), slack)
            if low > top:
                continue
            highest = max(highest, abs(ph + low * (qh - ph)), abs(ph + top * (qh - ph)))
            if near < 0 or highest > limit:
                highest = math.inf
                break
            place = enter(near, table)
            if place >= 0:
                if count == PIECE:
                    table[place] = -1
                    highest = math.inf
                    break
                queue[count] = near
                parents[count] = face
                slots[count] = place
                count += 1
        if highest > limit:
            break
    for entry in range(count):
        table[slots[entry]] = -1
    if sheets == 0 or corners != 7 or highest > limit:
        return math.inf
    reach += abs(gx) + abs(gy) + abs(gz)
    return math.sqrt(highest * highest + shrink * shrink) + ROUNDING * reach
