"""Where a triangulated surface, or a polygon in the plane, cuts through itself."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.corner import corner_edges, six_volumes
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.compiled.threads import pieces
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray

ROUNDING = 1e-12
"""Volume below which four vertices lie in a plane, as a part of the cube of the longest edge."""

STRIP = 4
"""Triangles of mean size across a strip, about."""


class Boxes(NamedTuple):
    """Bounding boxes of triangles, and the strips that they lie in.

    Attributes
    ----------
    low, high : (m, 3) float64    corners
    axis : int                    the longest of the bounding box of all
    first : (m,) int32            first strip of every triangle
    joined : bool                 whether triangles that share a vertex are compared
    """

    low: FloatArray
    high: FloatArray
    axis: int
    first: IntArray
    joined: bool


def count_crossings(points: FloatArray, triangles: IntArray) -> int:
    """Count the pairs of an edge and a triangle that cross each other.

    Parameters
    ----------
    points : (n, 3) float64
    triangles : (m, 3) int32    two that share a vertex are not compared

    Returns
    -------
    int                         an edge of two triangles counts twice; touching does not count, nor
                                does what is within rounding

    Notes
    -----
    Sweep and prune along the longest axis of the bounding box, in strips across it.
    """
    return _crossings(points, triangles, np.full(len(triangles), -1, dtype=np.int32))


def crossing_triangles(points: FloatArray, triangles: IntArray) -> BoolArray:
    """Mark the triangles, (m,), that cross others or are crossed, those that share a vertex too."""
    other = np.full(len(triangles), -1, dtype=np.int32)
    _crossings(points, triangles, other, joined=True)
    hit: BoolArray = other >= 0
    return hit


def crossed_facets(points: FloatArray, facets: IntArray) -> IntArray:
    """For every facet one that it crosses, (k,), -1 for none.

    Parameters
    ----------
    points : (n, d) float64
    facets : (k, d) int32      triangles in space, edges in the plane; those that share a vertex are
                               compared too
    """
    other = np.full(len(facets), -1, dtype=np.int32)
    in_space = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    _crossings(in_space, facets, other, joined=True)
    return other


def _crossings(
    points: FloatArray, triangles: IntArray, other: IntArray, *, joined: bool = False
) -> int:
    m = len(triangles)
    if not m:
        return 0
    low, high = points[triangles].min(axis=1), points[triangles].max(axis=1)
    span = high.max(axis=0) - low.min(axis=0)
    axes = np.argsort(-span, kind="stable")
    along, across = int(axes[0]), int(axes[1])
    # strips with about as many triangles each
    count = max(int(np.sqrt(m)) // STRIP, 1)
    borders = np.sort(low[:, across])[np.arange(1, count) * m // count]
    first = np.searchsorted(borders, low[:, across], side="right").astype(np.int32)
    last = np.searchsorted(borders, high[:, across], side="right").astype(np.int32)
    times = last - first + 1
    member = np.repeat(np.arange(m, dtype=np.int32), times)
    strip = np.arange(len(member)) - np.repeat(np.cumsum(times) - times, times) + first[member]
    order = np.argsort(low[member, along], kind="stable")
    order = order[np.argsort(strip[order], kind="stable")]
    begin = np.searchsorted(strip[order], np.arange(count + 1))
    member = member[order]
    boxes = Boxes(low, high, along, first, joined)
    return sum(
        int(_sweep(points, triangles, boxes, member, start, stop, end, s, other))
        for s, end in enumerate(begin[1:].tolist())
        for start, stop in pieces(int(begin[s]), end, costly=True)
    )


@kernel
def _sweep(
    points: FloatArray, triangles: IntArray, boxes: Boxes, member: IntArray, start: int,
    stop: int, end: int, strip: int, other: IntArray,
) -> int:
    """Compare triangles of a strip with those behind them that begin before they end.

    ``member[start:stop]`` are compared with those behind them up to ``end``, sorted by ``low``; a
    pair counts in the first strip that both lie in. ``other`` gets the last triangle that each
    crosses.
    """
    low, high, axis, first, joined = boxes
    second, third = (axis + 1) % 3, (axis + 2) % 3
    count = 0
    for k in range(start, stop):
        i = member[k]
        for l in range(k + 1, end):
            j = member[l]
            if low[j, axis] > high[i, axis]:
                break
            if (
                low[j, second] > high[i, second]
                or low[i, second] > high[j, second]
                or low[j, third] > high[i, third]
                or low[i, third] > high[j, third]
                or max(first[i], first[j]) != strip
                or (not joined and _meet(triangles, i, j))
            ):
                continue
            before = count
            if triangles.shape[1] == 2:
                count += _edges_cross(points, triangles, i, j)
            else:
                for e in range(3):
                    if _crosses(points, triangles, i, e, j):
                        count += 1
                    if _crosses(points, triangles, j, e, i):
                        count += 1
            if count > before:
                other[i], other[j] = j, i
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
    return -six_volumes(*corner_edges(p, l, i, j, k))


@kernel
def _crosses(p: FloatArray, triangles: IntArray, i: int, e: int, j: int) -> bool:
    """Whether edge e of triangle i goes through the inside of triangle j, by more than rounding."""
    u, v = triangles[i, e], triangles[i, (e + 1) % 3]
    a, b, c = triangles[j, 0], triangles[j, 1], triangles[j, 2]
    above, below = _side(p, a, b, c, u), _side(p, a, b, c, v)
    if above * below >= 0.0:
        return False
    first, second, third = _side(p, u, v, a, b), _side(p, u, v, b, c), _side(p, u, v, c, a)
    if not (
        (first > 0.0 and second > 0.0 and third > 0.0)
        or (first < 0.0 and second < 0.0 and third < 0.0)
    ):
        return False
    least = min(abs(above), abs(below), abs(first), abs(second), abs(third))
    length = max(_squared(p, u, v), _squared(p, a, b), _squared(p, b, c), _squared(p, c, a))
    return least > ROUNDING * length * math.sqrt(length)


@kernel
def _edges_cross(p: FloatArray, edges: IntArray, i: int, j: int) -> bool:
    """Whether two edges in the plane z = 0 cross each other, by more than rounding."""
    u, v, a, b = edges[i, 0], edges[i, 1], edges[j, 0], edges[j, 1]
    above, below = _area(p, u, v, a), _area(p, u, v, b)
    left, right = _area(p, a, b, u), _area(p, a, b, v)
    if above * below >= 0.0 or left * right >= 0.0:
        return False
    least = min(abs(above), abs(below), abs(left), abs(right))
    return least > ROUNDING * max(_squared(p, u, v), _squared(p, a, b))


@kernel
def _area(p: FloatArray, i: int, j: int, k: int) -> float:
    """Twice the signed area of (i, j, k) in the plane."""
    return ((p[j, 0] - p[i, 0]) * (p[k, 1] - p[i, 1])
            - (p[j, 1] - p[i, 1]) * (p[k, 0] - p[i, 0]))


@kernel
def _squared(p: FloatArray, i: int, j: int) -> float:
    """Squared distance of two vertices."""
    return (p[i, 0] - p[j, 0]) ** 2 + (p[i, 1] - p[j, 1]) ** 2 + (p[i, 2] - p[j, 2]) ** 2
