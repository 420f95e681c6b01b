"""Whether a triangle is certainly within an envelope around a surface: compiled, for one triangle.

Three reasons are enough. The distance to one convex triangle is a convex function, so a triangle is
close when its corners are close to one and the same triangle of the surface. It is close when the
heights under it are small (``overlay``). And the distance to the whole surface grows no faster than
a point moves, so it is close when its barycentre is, with the radius to spare. Where none of them
holds the triangle is cut into four, until the barycentre of a part is too far or the parts are too
many: then the answer is no.
"""

from __future__ import annotations

import math

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.closest import Ground, closest_on_triangle
from odt_plugins.engine.ground.overlay import DEEP, PIECE, Work, enter, height_over
from odt_plugins.mesh.arrays import FloatArray, IntArray

SHRINK = 0.25
"""Part of the envelope by which a triangle is shrunk before the heights under it are looked at."""

PARTS = 1 << 8
"""Most parts of one triangle that are looked at."""


@kernel
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
    work : Work                 OUT: the triangles, in ``faces``

    Returns
    -------
    int                         how many, at most PIECE
    """
    queue, slots, table = work.faces, work.slots, work.table
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
        place = enter(feet[f], table)
        if place >= 0:
            queue[count] = feet[f]
            slots[count] = place
            count += 1
    for head in range(PIECE):
        if head == count or count == PIECE:
            break
        face = queue[head]
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
                place = enter(near, table)
                if place < 0:
                    continue
                if count == PIECE:
                    table[place] = -1
                    break
                queue[count] = near
                slots[count] = place
                count += 1
    for entry in range(count):
        table[slots[entry]] = -1
    return count


@kernel
def _near_one(
    points: FloatArray, a: int, b: int, c: int, face: int, surface: Ground, limit: float
) -> bool:
    """Whether all corners are within the squared distance of one triangle of the surface."""
    p, t = surface.points, surface.triangles
    i, j, k = t[face, 0], t[face, 1], t[face, 2]
    for corner in range(3):
        v = a if corner == 0 else (b if corner == 1 else c)
        x, y, z = points[v, 0], points[v, 1], points[v, 2]
        if not closest_on_triangle(x, y, z, p, i, j, k)[0] <= limit:
            return False
    return True


@kernel
def triangle_within(
    points: FloatArray, a: int, b: int, c: int, feet: IntArray, surface: Ground,
    envelope: float, work: Work,
) -> bool:
    """Whether every point of a triangle is certainly within an envelope around a surface.

    Parameters
    ----------
    points : (n, 3) float64
    a, b, c : int               corners
    feet : (3,) int32           triangles of the surface near the corners, e.g. those of their feet;
                                wrong ones make the answer False more often, never True
    surface : Ground
    envelope : float            length
    work : Work                 from :func:`~odt_plugins.engine.ground.overlay.make_overlay_work`,
                                one for each thread

    Returns
    -------
    bool                        False also where nothing can be said
    """
    limit = envelope * envelope
    for i in range(3):
        if _near_one(points, a, b, c, feet[i], surface, limit):
            return True
    shrink = SHRINK * envelope
    height = math.sqrt(limit - shrink * shrink)
    faces, parts, depths = work.faces, work.parts, work.depths
    for k in range(3):
        parts[0, k], parts[1, k], parts[2, k] = points[a, k], points[b, k], points[c, k]
    depths[0] = 0
    left = 1
    face = feet[0]
    count = 0
    last = 0
    for _ in range(PARTS):
        left -= 1
        row = 3 * left
        close = False
        for turn in range(count):
            f = (last + turn) % count
            if _near_one(parts, row, row + 1, row + 2, faces[f], surface, limit):
                close = True
                last = f
                break
        if count > 0 and not close:
            far, face = _to_barycenter(parts, row, faces, count, surface)
            if far > envelope:
                return False
            close = far + _radius(parts, row) <= envelope
        if not close and (count == 0 or left > 0 or depths[0] > 0):
            over = height_over(parts, row, row + 1, row + 2, face, surface, shrink, height, work)
            close = over <= envelope
        if not close:
            if count == 0:
                count = faces_near(points, a, b, c, feet, surface, envelope, work)
                left += 1
                continue
            if depths[left] == DEEP:
                return False
            _cut(parts, row)
            depth = depths[left] + 1
            for i in range(4):
                depths[left + i] = depth
            left += 4
        if left == 0:
            return True
    return False


@kernel
def _to_barycenter(
    parts: FloatArray, row: int, faces: IntArray, count: int, surface: Ground
) -> tuple[float, int]:
    """Distance of the barycentre of a part from some triangles, and the closest of them."""
    p, t = surface.points, surface.triangles
    x = (parts[row, 0] + parts[row + 1, 0] + parts[row + 2, 0]) / 3.0
    y = (parts[row, 1] + parts[row + 1, 1] + parts[row + 2, 1]) / 3.0
    z = (parts[row, 2] + parts[row + 1, 2] + parts[row + 2, 2]) / 3.0
    nearest = math.inf
    face = -1
    for f in range(count):
        g = faces[f]
        far = closest_on_triangle(x, y, z, p, t[g, 0], t[g, 1], t[g, 2])[0]
        if far < nearest:
            nearest = far
            face = g
    return math.sqrt(nearest), face


@kernel
def _radius(parts: FloatArray, row: int) -> float:
    """Largest distance of a corner of a part from its barycentre."""
    square = 0.0
    for corner in range(3):
        total = 0.0
        for k in range(3):
            middle = (parts[row, k] + parts[row + 1, k] + parts[row + 2, k]) / 3.0
            total += (parts[row + corner, k] - middle) ** 2
        square = max(square, total)
    return math.sqrt(square)


@kernel
def _cut(parts: FloatArray, row: int) -> None:
    """Replace a part, three rows of points, by its four quarters."""
    for k in range(3):
        a, b, c = parts[row, k], parts[row + 1, k], parts[row + 2, k]
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        parts[row, k], parts[row + 1, k], parts[row + 2, k] = ab, bc, ca
        parts[row + 3, k], parts[row + 4, k], parts[row + 5, k] = a, ab, ca
        parts[row + 6, k], parts[row + 7, k], parts[row + 8, k] = b, bc, ab
        parts[row + 9, k], parts[row + 10, k], parts[row + 11, k] = c, ca, bc
