"""Feature lines: chains of edges along which their vertices slide.

Between two corners a chain has the same vertices in the same order before and after, so a vertex
is known by its arc length on the chain of the input.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from odt_plugins.engine.cells.triangle import offset
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.mesh.arrays import FloatArray, IntArray


class Lines(NamedTuple):
    """Chains of feature edges from one locked vertex to another, one after the other.

    Attributes
    ----------
    nodes : (k,) int32      vertices in order; only the ends of a chain belong to several
    arc : (k,) float64      arc length on the input, growing along the whole array
    place : (k,) float64    arc length at which the vertex lies now
    face : (k,) int32       a triangle of the ground at the edge from here to the next node
    slot : (n,) int32       where a LINE vertex stands in ``nodes``; -1 for all others
    """

    nodes: IntArray
    arc: FloatArray
    place: FloatArray
    face: IntArray
    slot: IntArray


@kernel
def on_line(
    lines: Lines, ground_points: FloatArray, slot: int, place: float
) -> tuple[float, float, float, int]:
    """Point of a chain at an arc length between those of its neighbours, and a triangle there."""
    k = slot
    for before in range(slot, -1, -1):
        k = before
        if not lines.arc[k] > place:
            break
    for after in range(k, len(lines.arc) - 1):
        k = after
        if not lines.arc[k + 1] < place:
            break
    a, b = lines.nodes[k], lines.nodes[k + 1]
    span = lines.arc[k + 1] - lines.arc[k]
    w = min(max((place - lines.arc[k]) / span, 0.0), 1.0) if span > 0.0 else 0.0
    p = ground_points
    return (
        p[a, 0] + w * (p[b, 0] - p[a, 0]),
        p[a, 1] + w * (p[b, 1] - p[a, 1]),
        p[a, 2] + w * (p[b, 2] - p[a, 2]),
        lines.face[k],
    )


@kernel
def line_is_near(
    lines: Lines, points: FloatArray, ground_points: FloatArray, slot: int, limit: float
) -> bool:
    """Whether the two edges of a line vertex and the chain under them are close to each other.

    Two polylines with common ends are furthest apart at a vertex of one of them.
    """
    for k in range(slot - 1, slot + 1):
        low, high = lines.place[k], lines.place[k + 1]
        if not low < high:
            return False
        a, b = lines.nodes[k], lines.nodes[k + 1]
        start = k
        for before in range(k, -1, -1):
            start = before
            if lines.arc[start] <= low:
                break
        for j in range(start, len(lines.arc)):
            if lines.arc[j] <= low:
                continue
            if lines.arc[j] >= high:
                break
            if _distance(points, a, b, ground_points, lines.nodes[j]) > limit:
                return False
    return True


@kernel
def line_direction(
    lines: Lines, points: FloatArray, slot: int
) -> tuple[float, float, float]:
    """Unit vector from the previous to the next vertex of the chain; 0 where they coincide."""
    a, b = lines.nodes[slot - 1], lines.nodes[slot + 1]
    x, y, z = offset(points, a, b)
    length = math.sqrt(x * x + y * y + z * z)
    if not length > 0.0:
        return 0.0, 0.0, 0.0
    return x / length, y / length, z / length


@kernel
def _distance(points: FloatArray, a: int, b: int, others: FloatArray, c: int) -> float:
    """Squared distance of point c of ``others`` from the segment ab."""
    ux, uy, uz = offset(points, a, b)
    x = others[c, 0] - points[a, 0]
    y = others[c, 1] - points[a, 1]
    z = others[c, 2] - points[a, 2]
    uu = ux * ux + uy * uy + uz * uz
    w = (ux * x + uy * y + uz * z) / uu if uu > 0.0 else 0.0
    w = min(max(w, 0.0), 1.0)
    x -= w * ux
    y -= w * uy
    z -= w * uz
    return x * x + y * y + z * z
