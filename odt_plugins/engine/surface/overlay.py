"""How far a triangle is from a surface: height over the piece of the surface that lies under it.

Seen along the normal of the triangle T, a triangulated surface cuts T into polygons. Over each of
them the height is linear, so it is largest where an edge of the surface enters or leaves T, ends
within T, or under a corner of T. When every edge met within T has both its triangles in the piece,
the number of sheets over T, counted with sign, is the same everywhere; when it is not zero
somewhere, T is covered, and the largest height bounds the distance from T to the surface.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from odt_plugins.engine.surface.closest import Ground, closest_on_triangle
from odt_plugins.mesh import FloatArray, IntArray

Work = tuple[IntArray, IntArray, FloatArray]

PIECE = 1 << 9
"""Most triangles of the surface that are looked at under one triangle."""

SEARCH = 32
"""Most steps to a triangle of the surface under an inner point of T."""

ROUNDING = 1e-14
"""Rounding of a double area, relative to the square of the coordinates it is made of."""

SHRINK = 0.25
"""Part of the envelope by which a triangle is shrunk before the heights under it are looked at."""

PARTS = 1 << 9
"""Most parts into which one triangle is cut."""

DEEP = 12
"""Most times that a triangle is halved."""


def make_overlay_work() -> Work:
    """Work arrays for one thread: queue and parents, table of what was met, parts."""
    return (
        np.empty((3, PIECE), np.int32),
        np.full(4 * PIECE, -1, np.int32),
        np.empty((3 * DEEP + 4, 10)),
    )


@njit(nogil=True, cache=True)
def _met(face: int, table: IntArray) -> int:
    """Enter a triangle into the table: its place, or -1 when it is there already."""
    mask = table.shape[0] - 1
    place = ((face * 40503) ^ (face >> 7)) & mask
    while table[place] >= 0:
        if table[place] == face:
            return -1
        place = (place + 1) & mask
    table[place] = face
    return place


@njit(nogil=True, cache=True)
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
                                   that edges of the surface along the rim of T do not count
    limit : float                  stop at a height above this
    work : Work                    from :func:`make_overlay_work`

    Returns
    -------
    float                          no point of T is further from the surface than this; inf when
                                   it is above ``limit`` or nothing can be said
    """
    queue, table, _ = work
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
    face = start
    found = False
    for _ in range(SEARCH):
        i, j, k = t[face, 0], t[face, 1], t[face, 2]
        x, y, z = p[i, 0] - gx, p[i, 1] - gy, p[i, 2] - gz
        iu, iv = x * ex + y * ey + z * ez - su, x * fx + y * fy + z * fz - sv
        x, y, z = p[j, 0] - gx, p[j, 1] - gy, p[j, 2] - gz
        ju, jv = x * ex + y * ey + z * ez - su, x * fx + y * fy + z * fz - sv
        x, y, z = p[k, 0] - gx, p[k, 1] - gy, p[k, 2] - gz
        ku, kv = x * ex + y * ey + z * ez - su, x * fx + y * fy + z * fz - sv
        wi, wj, wk = ju * kv - jv * ku, ku * iv - kv * iu, iu * jv - iv * ju
        if wi + wj + wk < 0.0:
            wi, wj, wk = -wi, -wj, -wk
        if wi >= 0.0 and wj >= 0.0 and wk >= 0.0:
            found = True
            break
        low = min(wi, wj, wk)
        out = 0 if wi == low else (1 if wj == low else 2)
        face = neighbors[face, out]
        if face < 0:
            break
    if not found:
        return math.inf
    queue[0, 0] = face
    queue[1, 0] = -1
    queue[2, 0] = _met(face, table)
    count = 1
    head = 0
    sheets = 0
    highest = 0.0
    corners = 0
    while head < count:
        face = queue[0, head]
        parent = queue[1, head]
        head += 1
        i, j, k = t[face, 0], t[face, 1], t[face, 2]
        x, y, z = p[i, 0] - gx, p[i, 1] - gy, p[i, 2] - gz
        iu, iv = x * ex + y * ey + z * ez, x * fx + y * fy + z * fz
        ih = x * nx + y * ny + z * nz
        x, y, z = p[j, 0] - gx, p[j, 1] - gy, p[j, 2] - gz
        ju, jv = x * ex + y * ey + z * ez, x * fx + y * fy + z * fz
        jh = x * nx + y * ny + z * nz
        x, y, z = p[k, 0] - gx, p[k, 1] - gy, p[k, 2] - gz
        ku, kv = x * ex + y * ey + z * ez, x * fx + y * fy + z * fz
        kh = x * nx + y * ny + z * nz
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
            low, top = 0.0, 1.0
            for rim in range(3):
                ou, ov, du, dv = au, av, bu - au, bv - av
                if rim == 1:
                    ou, ov, du, dv = bu, bv, cu - bu, cv - bv
                elif rim == 2:
                    ou, ov, du, dv = cu, cv, au - cu, av - cv
                first = du * (pv - ov) - dv * (pu - ou) + slack
                last = du * (qv - ov) - dv * (qu - ou) + slack
                if first < 0.0 and last < 0.0:
                    low = 2.0
                    break
                if first < 0.0:
                    low = max(low, first / (first - last))
                elif last < 0.0:
                    top = min(top, first / (first - last))
            if low > top:
                continue
            highest = max(highest, abs(ph + low * (qh - ph)), abs(ph + top * (qh - ph)))
            if near < 0 or highest > limit:
                highest = math.inf
                break
            place = _met(near, table)
            if place >= 0:
                if count == PIECE:
                    table[place] = -1
                    highest = math.inf
                    break
                queue[0, count] = near
                queue[1, count] = face
                queue[2, count] = place
                count += 1
        if highest > limit:
            break
    for entry in range(count):
        table[queue[2, entry]] = -1
    if sheets == 0 or corners != 7 or highest > limit:
        return math.inf
    reach += abs(gx) + abs(gy) + abs(gz)
    return math.sqrt(highest * highest + shrink * shrink) + ROUNDING * reach


@njit(nogil=True, cache=True)
def parts_within(
    points: FloatArray, a: int, b: int, c: int, faces: IntArray, count: int, surface: Ground,
    envelope: float, work: Work,
) -> bool:
    """Whether a triangle stays close to some triangles of a surface, by cutting it into parts.

    The distance to one convex triangle is a convex function, so a part is close when its corners
    are close to one and the same triangle. The distance to all of them grows no faster than the
    point moves, so a part is close when its barycentre is closer by the radius of the part, and
    the whole is not close when one barycentre is not. Otherwise the part is cut into four.

    Parameters
    ----------
    points : (n, 3) float64
    a, b, c : int               corners
    faces : (k,) int32          triangles of the surface that count are faces[:count]
    surface : Ground            or any tuple with ``points`` and ``triangles``
    envelope : float
    work : Work

    Returns
    -------
    bool                        True only if every point is within ``envelope`` of those triangles
    """
    if count == 0:
        return False
    parts = work[2]
    p, t = surface.points, surface.triangles
    limit = envelope * envelope
    for k in range(3):
        parts[0, k], parts[0, 3 + k], parts[0, 6 + k] = points[a, k], points[b, k], points[c, k]
    parts[0, 9] = 0.0
    left = 1
    last = 0
    for _ in range(PARTS):
        if left == 0:
            return True
        left -= 1
        part = parts[left]
        close = False
        for turn in range(count):
            f = (last + turn) % count
            face = faces[f]
            close = True
            for corner in range(3):
                far = closest_on_triangle(
                    part[3 * corner], part[3 * corner + 1], part[3 * corner + 2],
                    p, t[face, 0], t[face, 1], t[face, 2],
                )[0]
                if far > limit:
                    close = False
                    break
            if close:
                last = f
                break
        if close:
            continue
        x = (part[0] + part[3] + part[6]) / 3.0
        y = (part[1] + part[4] + part[7]) / 3.0
        z = (part[2] + part[5] + part[8]) / 3.0
        nearest = math.inf
        for f in range(count):
            face = faces[f]
            far = closest_on_triangle(x, y, z, p, t[face, 0], t[face, 1], t[face, 2])[0]
            nearest = min(nearest, far)
        if nearest > limit:
            return False
        radius = 0.0
        for corner in range(3):
            radius = max(
                radius,
                (part[3 * corner] - x) ** 2
                + (part[3 * corner + 1] - y) ** 2
                + (part[3 * corner + 2] - z) ** 2,
            )
        if math.sqrt(nearest) + math.sqrt(radius) <= envelope:
            continue
        depth = part[9] + 1.0
        if depth > DEEP:
            return False
        _cut(parts, left, depth)
        left += 4
    return left == 0


@njit(nogil=True, cache=True)
def _cut(parts: FloatArray, row: int, depth: float) -> None:
    """Replace a part by its four quarters."""
    for k in range(3):
        a, b, c = parts[row, k], parts[row, 3 + k], parts[row, 6 + k]
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        parts[row, k], parts[row, 3 + k], parts[row, 6 + k] = ab, bc, ca
        parts[row + 1, k], parts[row + 1, 3 + k], parts[row + 1, 6 + k] = a, ab, ca
        parts[row + 2, k], parts[row + 2, 3 + k], parts[row + 2, 6 + k] = b, bc, ab
        parts[row + 3, k], parts[row + 3, 3 + k], parts[row + 3, 6 + k] = c, ca, bc
    for i in range(4):
        parts[row + i, 9] = depth


@njit(nogil=True, cache=True)
def faces_near(
    points: FloatArray, a: int, b: int, c: int, feet: IntArray, surface: Ground,
    envelope: float, work: Work,
) -> int:
    """Collect triangles of a surface around a triangle, walking from some that are near.

    Parameters
    ----------
    points : (n, 3) float64
    a, b, c : int               corners
    feet : (k,) int32           triangles to start from
    surface : Ground            or any tuple with ``points``, ``triangles`` and stars
    envelope : float            only triangles whose box is within this of the triangle's box
    work : Work                 OUT: the triangles, in the first row of its first array

    Returns
    -------
    int                         how many, at most PIECE
    """
    queue, table, _ = work
    p, t = surface.points, surface.triangles
    indptr, indices = surface.indptr, surface.indices
    x0 = min(points[a, 0], points[b, 0], points[c, 0]) - envelope
    y0 = min(points[a, 1], points[b, 1], points[c, 1]) - envelope
    z0 = min(points[a, 2], points[b, 2], points[c, 2]) - envelope
    x1 = max(points[a, 0], points[b, 0], points[c, 0]) + envelope
    y1 = max(points[a, 1], points[b, 1], points[c, 1]) + envelope
    z1 = max(points[a, 2], points[b, 2], points[c, 2]) + envelope
    count = 0
    for f in range(feet.shape[0]):
        place = _met(feet[f], table)
        if place >= 0:
            queue[0, count] = feet[f]
            queue[2, count] = place
            count += 1
    head = 0
    while head < count and count < PIECE:
        face = queue[0, head]
        head += 1
        for corner in range(3):
            v = t[face, corner]
            for s in range(indptr[v], indptr[v + 1]):
                near = indices[s]
                i, j, k = t[near, 0], t[near, 1], t[near, 2]
                if (
                    min(p[i, 0], p[j, 0], p[k, 0]) > x1 or max(p[i, 0], p[j, 0], p[k, 0]) < x0
                    or min(p[i, 1], p[j, 1], p[k, 1]) > y1 or max(p[i, 1], p[j, 1], p[k, 1]) < y0
                    or min(p[i, 2], p[j, 2], p[k, 2]) > z1 or max(p[i, 2], p[j, 2], p[k, 2]) < z0
                ):
                    continue
                place = _met(near, table)
                if place < 0:
                    continue
                if count == PIECE:
                    table[place] = -1
                    break
                queue[0, count] = near
                queue[2, count] = place
                count += 1
    for entry in range(count):
        table[queue[2, entry]] = -1
    return count


@njit(nogil=True, cache=True)
def triangle_within(
    points: FloatArray, a: int, b: int, c: int, feet: IntArray, surface: Ground,
    envelope: float, work: Work,
) -> bool:
    """Whether every point of a triangle is certainly within ``envelope`` of a surface.

    Parameters
    ----------
    points : (n, 3) float64
    a, b, c : int               corners
    feet : (3,) int32           triangles of the surface near the corners, e.g. those of their feet;
                                wrong ones make the answer False more often, never True
    surface : Ground            see :func:`odt_plugins.engine.surface.closest.walk`
    envelope : float            length
    work : Work                 from :func:`make_overlay_work`, one for each thread

    Returns
    -------
    bool                        False also where nothing can be said
    """
    p, t = surface.points, surface.triangles
    limit = envelope * envelope
    for i in range(3):
        face = feet[i]
        i0, i1, i2 = t[face, 0], t[face, 1], t[face, 2]
        if (
            closest_on_triangle(points[a, 0], points[a, 1], points[a, 2], p, i0, i1, i2)[0] <= limit
            and closest_on_triangle(points[b, 0], points[b, 1], points[b, 2], p, i0, i1, i2)[0]
            <= limit
            and closest_on_triangle(points[c, 0], points[c, 1], points[c, 2], p, i0, i1, i2)[0]
            <= limit
        ):
            return True
    shrink = SHRINK * envelope
    height = math.sqrt(limit - shrink * shrink)
    far = height_over(points, a, b, c, feet[0], surface, shrink, height, work)
    if far <= envelope:
        return True
    count = faces_near(points, a, b, c, feet, surface, envelope, work)
    return parts_within(points, a, b, c, work[0][0], count, surface, envelope, work)
