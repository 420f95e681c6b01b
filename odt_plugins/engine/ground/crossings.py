"""Where a triangulated surface, or a polygon in the plane, cuts through itself."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.corner import corner_edges, six_volumes
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.compiled.threads import pieces
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray, LongArray
from odt_plugins.mesh.exact import exact_sign, whole_numbers

FLAT = 1e-14
"""Bound of the rounding error of a volume or an area, as a part of the product of its extents."""

TINY = 1e-200
"""Volume and area below which products may underflow [length^3, length^2]."""

DOUBTFUL = -1
"""Answer where rounding decides."""

STRIP = 4
"""Triangles of mean size across a strip, about."""


class Doubts(NamedTuple):
    """Pairs of triangles that rounding decides on.

    Attributes
    ----------
    pairs : (k, 2) int32      the first of them, as many as there is room for
    total : (1,) int64        how many there are
    """

    pairs: IntArray
    total: LongArray


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
    int                         an edge of two triangles counts twice; touching does not count

    Notes
    -----
    Sweep and prune along the longest axis of the bounding box, in strips across it. Where a volume
    is within the bound of its rounding, whole numbers decide.
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
    doubts = Doubts(np.empty((len(triangles), 2), dtype=np.int32), np.zeros(1, dtype=np.int64))

    def swept(doubts: Doubts) -> int:
        return sum(
            int(_sweep(points, triangles, boxes, member, start, stop, end, s, other, doubts))
            for s, end in enumerate(begin[1:].tolist())
            for start, stop in pieces(int(begin[s]), end, costly=True)
        )

    count = swept(doubts)
    found = int(doubts.total[0])
    if found > len(doubts.pairs):
        doubts = Doubts(np.empty((found, 2), dtype=np.int32), np.zeros(1, dtype=np.int64))
        swept(doubts)
    for i, j in doubts.pairs[:found].tolist():
        cuts = _exact_crossings(points[triangles[[i, j]].ravel()])
        if cuts:
            other[i], other[j] = j, i
        count += cuts
    return count


def _exact_crossings(corners: FloatArray) -> int:
    """How many edges of two triangles, their corners (6, 3), go through the other one.

    Of edges in the plane, (4, 3) with z = 0: whether they cross each other.
    """
    if len(corners) == 4:
        a, b, c, d = whole_numbers(corners[:, :2])
        return int(exact_sign(a, b, c) * exact_sign(a, b, d) < 0
                   and exact_sign(c, d, a) * exact_sign(c, d, b) < 0)
    count = 0
    whole = whole_numbers(corners)
    for edges, plane in ((whole[:3], whole[3:]), (whole[3:], whole[:3])):
        side = [exact_sign(*plane, corner) for corner in edges]
        for e in range(3):
            if side[e] * side[e - 1] < 0:
                turns = {exact_sign(edges[e], edges[e - 1], plane[k], plane[k - 1])
                         for k in range(3)}
                count += turns in ({1}, {-1})
    return count


@kernel
def _sweep(
    points: FloatArray, triangles: IntArray, boxes: Boxes, member: IntArray, start: int,
    stop: int, end: int, strip: int, other: IntArray, doubts: Doubts,
) -> int:
    """Compare triangles of a strip with those behind them that begin before they end.

    ``member[start:stop]`` are compared with those behind them up to ``end``, sorted by ``low``; a
    pair counts in the first strip that both lie in. ``other`` gets the last triangle that each
    crosses. Pairs on which rounding decides are put down in ``doubts`` and do not count.
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
            found = 0
            doubtful = False
            if triangles.shape[1] == 2:
                area = FLAT * _extent(boxes, i, j, 0) * _extent(boxes, i, j, 1)
                found = _edges_cross(points, triangles, i, j, max(area, TINY))
                doubtful = found == DOUBTFUL
            else:
                x, y = _extent(boxes, i, j, 0), _extent(boxes, i, j, 1)
                z = _extent(boxes, i, j, 2)
                if x == 0.0 or y == 0.0 or z == 0.0:
                    continue
                bound = max(FLAT * x * y * z, TINY)
                for e in range(3):
                    here = _crosses(points, triangles, i, e, j, bound)
                    if here == DOUBTFUL and _beside(points, triangles, boxes, i, e, j):
                        here = 0
                    there = _crosses(points, triangles, j, e, i, bound)
                    if there == DOUBTFUL and _beside(points, triangles, boxes, j, e, i):
                        there = 0
                    if here == DOUBTFUL or there == DOUBTFUL:
                        found = 0
                        doubtful = not _apart(points, triangles, boxes, i, j)
                        break
                    found += here + there
            if doubtful:
                if doubts.total[0] < doubts.pairs.shape[0]:
                    doubts.pairs[doubts.total[0], 0] = i
                    doubts.pairs[doubts.total[0], 1] = j
                doubts.total[0] += 1
            elif found > 0:
                count += found
                other[i], other[j] = j, i
    return count


@kernel
def _extent(boxes: Boxes, i: int, j: int, axis: int) -> float:
    """Extent of two triangles along an axis."""
    return (max(boxes.high[i, axis], boxes.high[j, axis])
            - min(boxes.low[i, axis], boxes.low[j, axis]))


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
def _crosses(
    p: FloatArray, triangles: IntArray, i: int, e: int, j: int, bound: float
) -> int:
    """1 where edge e of triangle i goes through the inside of triangle j, else 0, or DOUBTFUL.

    Volumes up to ``bound`` may have the wrong sign.
    """
    u, v = triangles[i, e], triangles[i, (e + 1) % 3]
    a, b, c = triangles[j, 0], triangles[j, 1], triangles[j, 2]
    if u == a or u == b or u == c or v == a or v == b or v == c:
        return 0
    above, below = _side(p, a, b, c, u), _side(p, a, b, c, v)
    if min(above, below) > bound or max(above, below) < -bound:
        return 0
    first, second, third = _side(p, u, v, a, b), _side(p, u, v, b, c), _side(p, u, v, c, a)
    least, most = min(first, second, third), max(first, second, third)
    if least < -bound and most > bound:
        return 0
    sure = min(abs(above), abs(below)) > bound and (least > bound or most < -bound)
    return 1 if sure else DOUBTFUL


@kernel
def _apart(p: FloatArray, triangles: IntArray, boxes: Boxes, i: int, j: int) -> bool:
    """Whether two triangles lie on two sides of an edge, seen along an axis; corners may be common.

    Along the axis that is nearest to the normal of triangle i.
    """
    axis = _steepest(p, triangles, i)
    bound = _rounding(boxes, i, j, axis)
    return _on_two_sides(p, triangles, i, j, 0, 3, axis, bound) or _on_two_sides(
        p, triangles, j, i, 0, 3, axis, bound)


@kernel
def _beside(p: FloatArray, triangles: IntArray, boxes: Boxes, i: int, e: int, j: int) -> bool:
    """Whether an edge of triangle j parts it from edge e of triangle i, seen along an axis.

    Along the axis that is nearest to the normal of triangle j.
    """
    axis = _steepest(p, triangles, j)
    return _on_two_sides(p, triangles, j, i, e, 2, axis, _rounding(boxes, i, j, axis))


@kernel
def _steepest(p: FloatArray, triangles: IntArray, i: int) -> int:
    """The axis that is nearest to the normal of a triangle."""
    axis = 0
    largest = -1.0
    for x in range(3):
        size = abs(_area(p, triangles[i, 0], triangles[i, 1], triangles[i, 2], x))
        if size > largest:
            largest, axis = size, x
    return axis


@kernel
def _rounding(boxes: Boxes, i: int, j: int, axis: int) -> float:
    """Bound of the rounding error of areas of corners of two triangles, seen along an axis."""
    y, z = (axis + 1) % 3, (axis + 2) % 3
    return max(FLAT * _extent(boxes, i, j, y) * _extent(boxes, i, j, z), TINY)


@kernel
def _on_two_sides(
    p: FloatArray, triangles: IntArray, i: int, j: int, first: int, many: int, axis: int,
    bound: float,
) -> bool:
    """Whether an edge of triangle i parts it from some corners of j, seen along an axis.

    From the corners ``first``, ``first + 1``, ..., as ``many`` as are asked for.
    """
    y, z = (axis + 1) % 3, (axis + 2) % 3
    for e in range(3):
        s, t, w = triangles[i, e], triangles[i, (e + 1) % 3], triangles[i, (e + 2) % 3]
        own = _area(p, s, t, w, axis)
        parts = abs(own) > bound
        for m in range(first, first + many):
            v = triangles[j, m % 3]
            common = (p[v, y] == p[s, y] and p[v, z] == p[s, z]) or (
                p[v, y] == p[t, y] and p[v, z] == p[t, z])
            side = _area(p, s, t, v, axis)
            parts = parts and (common or (abs(side) > bound and (side > 0.0) != (own > 0.0)))
        if parts:
            return True
    return False


@kernel
def _edges_cross(p: FloatArray, edges: IntArray, i: int, j: int, bound: float) -> int:
    """1 where two edges in the plane z = 0 cross each other, else 0, or DOUBTFUL."""
    u, v, a, b = edges[i, 0], edges[i, 1], edges[j, 0], edges[j, 1]
    if u == a or u == b or v == a or v == b:
        return 0
    above, below = _area(p, u, v, a, 2), _area(p, u, v, b, 2)
    left, right = _area(p, a, b, u, 2), _area(p, a, b, v, 2)
    if (min(above, below) > bound or max(above, below) < -bound
            or min(left, right) > bound or max(left, right) < -bound):
        return 0
    sure = min(abs(above), abs(below), abs(left), abs(right)) > bound
    return 1 if sure else DOUBTFUL


@kernel
def _area(p: FloatArray, i: int, j: int, k: int, axis: int) -> float:
    """Twice the signed area of (i, j, k), seen along an axis."""
    y, z = (axis + 1) % 3, (axis + 2) % 3
    return ((p[j, y] - p[i, y]) * (p[k, z] - p[i, z])
            - (p[j, z] - p[i, z]) * (p[k, y] - p[i, y]))
