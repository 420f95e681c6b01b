"""Places in rows, from the lines of a plane surface inwards: each makes a regular triangle.

An edge ab of the front, of length l, asks for the third corner of the triangle at its left. In a
triangle of sides h it is at the height (h^2 - l^2 / 4)^(1/2) over the middle of ab. Among what is
there, it is the vertex whose circle through a and b reaches least far. Where that circle is larger
than CIRCLE h / sqrt(3), and no vertex is nearer than APART h, a place is added: over the middle, at
that height but no higher than the centre of the circle, so that rows that meet share what is left
between them. The other two sides join the front, which is worked off in order.

References
----------
S. Rebay, Efficient unstructured mesh generation by means of Delaunay triangulation and
Bowyer-Watson algorithm, J. Comput. Phys. 106 (1993) 125-138, for places that are no farther than
the centre of a circle.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.build import ground_value
from odt_plugins.engine.ground.closest import Ground, walk
from odt_plugins.mesh.arrays import FloatArray, IntArray, LongArray

CIRCLE = 1.05
"""Multiple of the radius of the circle around a regular triangle up to which one is good."""

APART = 0.8
"""Part of its size that a place keeps from every other."""

REACH = 2.2
"""Multiple of its size within which an edge looks for its third corner."""

VARIED = 3.0
"""Ratio of sizes that are looked at together: more than those within REACH differ by growth."""

LEVELS = 64
"""Most halvings of the largest size."""

ROOM = 1024
"""Vertices around an edge."""


class Front(NamedTuple):
    """Vertices and edges in the order in which they were added, with room for more.

    Attributes
    ----------
    points : (n, 3) float64, foot : (n,) int32, size : (n,) float64
    base : (n,) int32          the vertex at which the edge began that asked for this one
    following : (n,) int32     next vertex in the same box, -1 for the last
    boxes : (s,) int32         first vertex of a box, by its hash; -1 for none; s is a power of 2
    edges : (q, 3) int32       ends, and the label of the triangles at the left
    known : (k,) int32         edges by their hash, -1 for none; k is a power of 2
    around : (ROOM,) int32     vertices that are looked at
    count : (2,) int64         vertices and edges
    """

    points: FloatArray
    foot: IntArray
    size: FloatArray
    base: IntArray
    following: IntArray
    boxes: IntArray
    edges: IntArray
    known: IntArray
    around: IntArray
    count: LongArray  # type: ignore[assignment]


def make_front(
    points: FloatArray, foot: IntArray, size: FloatArray, edges: IntArray, most: int
) -> Front:
    """Lay a front out.

    Parameters
    ----------
    points : (n, 3) float64, foot : (n,) int32, size : (n,) float64
    edges : (e, 3) int32    see :class:`Front`
    most : int              places that there is room for
    """
    n, e = len(points), len(edges)
    room, more = n + most, e + 6 * most
    slots = 1 << math.ceil(math.log2(2 * room + 1))
    known = 1 << math.ceil(math.log2(2 * more + 1))

    def longer(array: Any, rows: int) -> Any:
        out = np.zeros((rows, *array.shape[1:]), dtype=array.dtype)
        out[: len(array)] = array
        return out

    return Front(
        longer(points, room), longer(foot, room), longer(size, room), np.zeros(room, np.int32),
        np.empty(room, np.int32), np.full(slots, -1, np.int32), longer(edges, more),
        np.full(known, -1, np.int32), np.empty(ROOM, np.int32), np.array([n, e], np.int64),
    )


@kernel
def place_rows(
    front: Front, ground: Ground, sizes: FloatArray, labels: IntArray, least: float
) -> bool:
    """Add places until no edge of the front asks for one; False if there was too little room.

    Parameters
    ----------
    front : Front               changed
    ground : Ground
    sizes : (g,) float64        length that edges are to have, at the vertices of the ground
    labels : (m,) int32         of the triangles of the ground
    least : float               least size
    """
    for v in range(front.count[0]):
        _enter(front, v, least)
    for k in range(front.count[1]):
        _remember(front, k)
    for k in range(front.edges.shape[0]):
        if k >= front.count[1]:
            break
        if not _advance(front, k, ground, sizes, labels, least):
            return False
    return True


@kernel
def _advance(
    front: Front, k: int, ground: Ground, sizes: FloatArray, labels: IntArray, least: float
) -> bool:
    """Give an edge its third corner; False if there was too little room."""
    p, size = front.points, front.size
    a, b, label = front.edges[k, 0], front.edges[k, 1], front.edges[k, 2]
    ux, uy = p[b, 0] - p[a, 0], p[b, 1] - p[a, 1]
    square = ux * ux + uy * uy
    if not square > 0.0:
        return True
    length = math.sqrt(square)
    nx, ny = -uy / length, ux / length
    mx, my = 0.5 * (p[a, 0] + p[b, 0]), 0.5 * (p[a, 1] + p[b, 1])
    ends = 0.5 * (size[a] + size[b])
    h, height, face = ends, 0.0, front.foot[a]
    for _ in range(2):
        height = math.sqrt(max(h * h - 0.25 * square, 0.25 * h * h))
        x, y = mx + height * nx, my + height * ny
        _, face, gx, gy, gz = walk(x, y, 0.0, face, ground, False)
        h = 0.5 * (ends + ground_value(ground, sizes, face, gx, gy, gz))
    q, centre = _corner(front, a, b, h, least)
    if q >= 0:
        circle = CIRCLE * h
        if 3.0 * (centre * centre + 0.25 * square) <= circle * circle:
            return _join(front, a, q, label) and _join(front, q, b, label)
        height = min(height, centre)
        if not height > 0.0:
            return True
    x, y = mx + height * nx, my + height * ny
    off, face, gx, gy, gz = walk(x, y, 0.0, face, ground, False)
    if off > 1e-16 * square or labels[face] != label:
        return True
    if _is_near(front, x, y, APART * h, h, least):
        return True
    v = front.count[0]
    if v == p.shape[0]:
        return False
    front.count[0] += 1
    p[v, 0], p[v, 1], p[v, 2] = x, y, 0.0
    front.foot[v], front.base[v] = face, a
    size[v] = ground_value(ground, sizes, face, x, y, 0.0)
    _enter(front, v, least)
    return _join(front, a, v, label) and _join(front, v, b, label)


@kernel
def _corner(front: Front, a: int, b: int, h: float, least: float) -> tuple[int, float]:
    """The vertex left of ab of the least circle, and the height of its centre; -1 for none."""
    p = front.points
    ux, uy = p[b, 0] - p[a, 0], p[b, 1] - p[a, 1]
    square = ux * ux + uy * uy
    length = math.sqrt(square)
    mx, my = 0.5 * (p[a, 0] + p[b, 0]), 0.5 * (p[a, 1] + p[b, 1])
    found, lowest = -1, np.inf
    for i in range(_gather(front, mx, my, REACH * h, h, least)):
        v = front.around[i]
        if v == a or v == b:
            continue
        x, y = p[v, 0] - mx, p[v, 1] - my
        up = (ux * y - uy * x) / length
        if up <= 1e-9 * length:
            continue
        centre = (x * x + y * y - 0.25 * square) / (2.0 * up)
        if centre < lowest or (centre == lowest and v < found):
            found, lowest = v, centre
    return found, lowest


@kernel
def _is_near(front: Front, x: float, y: float, away: float, h: float, least: float) -> bool:
    """Whether a vertex is nearer to a place than a length."""
    p = front.points
    for i in range(_gather(front, x, y, away, h, least)):
        v = front.around[i]
        if (p[v, 0] - x) ** 2 + (p[v, 1] - y) ** 2 < away * away:
            return True
    return False


@kernel
def _gather(front: Front, x: float, y: float, away: float, h: float, least: float) -> int:
    """Write the vertices of the boxes near a place into front.around; how many.

    Those whose size is within VARIED of h: a box holds one size and those up to twice as large.
    """
    count = 0
    edge = 2.0 * least
    for level in range(LEVELS):
        if edge > 2.0 * VARIED * h:
            break
        if edge * VARIED >= h:
            for i in range(math.floor((x - away) / edge), math.floor((x + away) / edge) + 1):
                for j in range(math.floor((y - away) / edge), math.floor((y + away) / edge) + 1):
                    v = front.boxes[_slot(i, j, level, front.boxes.shape[0])]
                    for _ in range(front.points.shape[0]):
                        if v < 0 or count == ROOM:
                            break
                        if abs(front.points[v, 0] - x) <= away and abs(
                                front.points[v, 1] - y) <= away:
                            front.around[count] = v
                            count += 1
                        v = front.following[v]
        edge *= 2.0
    return count


@kernel
def _enter(front: Front, v: int, least: float) -> None:
    """Put a vertex into the box of its place and size."""
    edge, level = 2.0 * least, 0
    for _ in range(LEVELS - 1):
        if edge > front.size[v]:
            break
        edge *= 2.0
        level += 1
    s = _slot(math.floor(front.points[v, 0] / edge), math.floor(front.points[v, 1] / edge), level,
              front.boxes.shape[0])
    front.following[v] = front.boxes[s]
    front.boxes[s] = v


@kernel
def _slot(i: int, j: int, k: int, slots: int) -> int:
    """Hash of three numbers."""
    return int((i * 73856093 ^ j * 19349663 ^ k * 83492791) & (slots - 1))


@kernel
def _join(front: Front, a: int, b: int, label: int) -> bool:
    """Add an edge to the front unless it was there, either way round; False without room."""
    k = front.count[1]
    if k == front.edges.shape[0]:
        return False
    front.edges[k, 0], front.edges[k, 1], front.edges[k, 2] = a, b, label
    if _remember(front, k):
        front.count[1] += 1
    return True


@kernel
def _remember(front: Front, k: int) -> bool:
    """Whether an edge was not known yet, either way round; now it is."""
    a, b = front.edges[k, 0], front.edges[k, 1]
    s = _slot(np.int64(min(a, b)), np.int64(max(a, b)), 0, front.known.shape[0])
    for _ in range(front.known.shape[0]):
        e = front.known[s]
        if e < 0:
            front.known[s] = k
            return True
        x, y = front.edges[e, 0], front.edges[e, 1]
        if (x == a and y == b) or (x == b and y == a):
            return False
        s = (s + 1) & (front.known.shape[0] - 1)
    return False
