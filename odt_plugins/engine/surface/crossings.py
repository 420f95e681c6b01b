"""Where a triangulated surface cuts through itself."""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.kernel import kernel
from odt_plugins.mesh import BoolArray, FloatArray, IntArray


def count_crossings(points: FloatArray, triangles: IntArray) -> int:
    """Count the pairs of an edge and a triangle that cross each other.

    Parameters
    ----------
    points : (n, 3) float64
    triangles : (m, 3) int32    two that share a vertex are not compared

    Returns
    -------
    int                         an edge of two triangles counts twice; touching does not count

    Notes
    -----
    Sweep and prune along the longest axis of the bounding box: about m^1.5 comparisons of boxes.
    """
    return _crossings(points, triangles, np.zeros(len(triangles), dtype=np.bool_))


def crossing_triangles(points: FloatArray, triangles: IntArray) -> BoolArray:
    """Mark the triangles, (m,), that cross others or are crossed; as in :func:`count_crossings`."""
    hit = np.zeros(len(triangles), dtype=np.bool_)
    _crossings(points, triangles, hit)
    return hit


def _crossings(points: FloatArray, triangles: IntArray, hit: BoolArray) -> int:
    if not len(triangles):
        return 0
    corners = points[triangles]
    low, high = corners.min(axis=1), corners.max(axis=1)
    axis = int(np.argmax(high.max(axis=0) - low.min(axis=0)))
    order = np.argsort(low[:, axis], kind="stable")
    sorted_hit = np.zeros(len(triangles), dtype=np.bool_)
    count = int(_sweep(
        points, np.ascontiguousarray(triangles[order]), np.ascontiguousarray(low[order]),
        np.ascontiguousarray(high[order]), axis, sorted_hit,
    ))
    hit[order] = sorted_hit
    return count


@kernel
def _sweep(
    points: FloatArray, triangles: IntArray, low: FloatArray, high: FloatArray, axis: int,
    hit: BoolArray,
) -> int:
    """Compare every triangle with those that begin before it ends; sorted by ``low``.

    Marks in ``hit`` the triangles of every crossing.
    """
    m = len(triangles)
    other, third = (axis + 1) % 3, (axis + 2) % 3
    count = 0
    for i in range(m):
        for j in range(i + 1, m):
            if low[j, axis] > high[i, axis]:
                break
            if (
                low[j, other] > high[i, other]
                or low[i, other] > high[j, other]
                or low[j, third] > high[i, third]
                or low[i, third] > high[j, third]
                or _meet(triangles, i, j)
            ):
                continue
            before = count
            for e in range(3):
                if _crosses(points, triangles, i, e, j):
                    count += 1
                if _crosses(points, triangles, j, e, i):
                    count += 1
            if count > before:
                hit[i] = hit[j] = True
    return count


@kernel
def _meet(triangles: IntArray, i: int, j: int) -> bool:
    """Whether two triangles share a vertex."""
    for a in range(3):
        for b in range(3):
            if triangles[i, a] == triangles[j, b]:
                return True
    return False


@kernel
def _side(p: FloatArray, i: int, j: int, k: int, l: int) -> float:
    """Six times the signed volume of (i, j, k, l)."""
    ax, ay, az = p[i, 0] - p[l, 0], p[i, 1] - p[l, 1], p[i, 2] - p[l, 2]
    bx, by, bz = p[j, 0] - p[l, 0], p[j, 1] - p[l, 1], p[j, 2] - p[l, 2]
    cx, cy, cz = p[k, 0] - p[l, 0], p[k, 1] - p[l, 1], p[k, 2] - p[l, 2]
    return -(
        ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    )


@kernel
def _crosses(p: FloatArray, triangles: IntArray, i: int, e: int, j: int) -> bool:
    """Whether edge e of triangle i goes through the inside of triangle j."""
    u, v = triangles[i, e], triangles[i, (e + 1) % 3]
    a, b, c = triangles[j, 0], triangles[j, 1], triangles[j, 2]
    if _side(p, a, b, c, u) * _side(p, a, b, c, v) >= 0.0:
        return False
    first, second, third = _side(p, u, v, a, b), _side(p, u, v, b, c), _side(p, u, v, c, a)
    return (first > 0.0 and second > 0.0 and third > 0.0) or (
        first < 0.0 and second < 0.0 and third < 0.0
    )
