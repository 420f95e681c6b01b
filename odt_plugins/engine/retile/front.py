"""Places in rows, from the lines of a surface inwards: each makes a regular triangle.

An edge ab of the front, of length l, asks for the third corner of the triangle at its left, in the
tangent plane. In a triangle of sides h it is at the height (h^2 - l^2 / 4)^(1/2) over the middle of
ab. Among what is
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

from odt_plugins.engine.cells.triangle import offset
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.build import ground_value
from odt_plugins.engine.ground.closest import Ground, walk
from odt_plugins.mesh.arrays import FloatArray, IntArray, LongArray

CIRCLE = 1.05
"""Multiple of the radius of the circle around a regular triangle up to which one is good."""

LEFT = 0.5
"""Least cosine between the tangent plane and the way from an edge to its third corner."""

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

    A vertex on a line is there once for every patch beside it.

    Attributes
    ----------
    points : (n, 3) float64, foot : (n,) int32, size : (n,) float64
    base : (n,) int32          the vertex at which the edge began that asked for this one
    following : (n,) int32     next vertex in the same box, -1 for the last
    boxes : (s,) int32         first vertex of a box, by its hash; -1 for none; s is a power of 2
    rows : (LEVELS, 2) int32   first and last row of boxes along z that hold one, by level
    edges : (q, 2) int32       ends
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
    rows: IntArray
    edges: IntArray
    known: IntArray
    around: IntArray
    count: LongArray  # type: ignore[assignment]


class Field(NamedTuple):
    """Where places may be.

    Attributes
    ----------
    ground : Ground
    sizes : (g,) float64      length that edges are to have, at the vertices of the ground
    patches : (m,) int32      of the triangles of the ground, which lines divide
    least : float             least size
    bend : float              part of its size that a place may be over the ground
    """

    ground: Ground
    sizes: FloatArray
    patches: IntArray
    least: float
    bend: float


def make_front(
    points: FloatArray, foot: IntArray, size: FloatArray, edges: IntArray, most: int
) -> Front:
    """Lay a front out.

    Parameters
    ----------
    points : (n, 3) float64, foot : (n,) int32, size : (n,) float64
    edges : (e, 2) int32    see :class:`Front`
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
        np.empty(room, np.int32), np.full(slots, -1, np.int32),
        np.array([[1, 0]] * LEVELS, np.int32), longer(edges, more),
        np.full(known, -1, np.int32), np.empty(ROOM, np.int32), np.array([n, e], np.int64),
    )


@kernel
def place_rows(front: Front, field: Field) -> bool:
    """Add places until no edge of the front asks for one; False if there was too little room.

    Parameters
    ----------
    front : Front    changed
    field : Field
    """
    for v in range(front.count[0]):
        _enter(front, v, field.least)
    for k in range(front.count[1]):
        _remember(front, k)
    for k in range(front.edges.shape[0]):
        if k >= front.count[1]:
            break
        if not _advance(front, k, field):
            return False
    return True


@kernel
def _advance(front: Front, k: int, field: Field) -> bool:
    """Give an edge its third corner; False if there was too little room."""
    p, size, ground = front.points, front.size, field.ground
    a, b = front.edges[k, 0], front.edges[k, 1]
    face = front.foot[a]
    patch = field.patches[face]
    square, wx, wy, wz = _left(front, a, b, ground)
    if not square > 0.0:
        return True
    mx, my, mz = _middle(p, a, b)
    ends = 0.5 * (size[a] + size[b])
    h, height = ends, 0.0
    for _ in range(2):
        height = math.sqrt(max(h * h - 0.25 * square, 0.25 * h * h))
        _, face, gx, gy, gz = walk(
            mx + height * wx, my + height * wy, mz + height * wz, face, ground, False)
        h = 0.5 * (ends + ground_value(ground, field.sizes, face, gx, gy, gz))
    q, centre = _corner(front, a, b, h, field)
    if q >= 0:
        circle = CIRCLE * h
        if 3.0 * (centre * centre + 0.25 * square) <= circle * circle:
            return _join(front, a, q) and _join(front, q, b)
        height = min(height, centre)
        if not height > 0.0:
            return True
    off, face, x, y, z = walk(
        mx + height * wx, my + height * wy, mz + height * wz, face, ground, False)
    if off > field.bend * field.bend * h * h or field.patches[face] != patch:
        return True
    if _is_near(front, x, y, z, face, h, field):
        return True
    v = front.count[0]
    if v == p.shape[0]:
        return False
    front.count[0] += 1
    p[v, 0], p[v, 1], p[v, 2] = x, y, z
    front.foot[v], front.base[v] = face, a
    size[v] = ground_value(ground, field.sizes, face, x, y, z)
    _enter(front, v, field.least)
    return _join(front, a, v) and _join(front, v, b)


@kernel
def _middle(p: FloatArray, a: int, b: int) -> tuple[float, float, float]:
    """The middle of an edge."""
    return (0.5 * (p[a, 0] + p[b, 0]), 0.5 * (p[a, 1] + p[b, 1]), 0.5 * (p[a, 2] + p[b, 2]))


@kernel
def _left(front: Front, a: int, b: int, ground: Ground) -> tuple[float, float, float, float]:
    """Squared length of an edge, and the unit vector to its left in the tangent plane."""
    x, y, z = offset(front.points, a, b)
    f, g, n = front.foot[a], front.foot[b], ground.normals
    u, v, w = n[f, 0] + n[g, 0], n[f, 1] + n[g, 1], n[f, 2] + n[g, 2]
    lx, ly, lz = v * z - w * y, w * x - u * z, u * y - v * x
    length = math.sqrt(lx * lx + ly * ly + lz * lz)
    if not length > 0.0:
        return 0.0, 0.0, 0.0, 0.0
    return x * x + y * y + z * z, lx / length, ly / length, lz / length


@kernel
def _corner(front: Front, a: int, b: int, h: float, field: Field) -> tuple[int, float]:
    """The vertex left of ab of the least circle, and the height of its centre; -1 for none."""
    p = front.points
    ux, uy, uz = offset(p, a, b)
    square, wx, wy, wz = _left(front, a, b, field.ground)
    mx, my, mz = _middle(p, a, b)
    found, lowest = -1, np.inf
    for i in range(_gather(front, mx, my, mz, REACH * h, h, field.least)):
        v = front.around[i]
        if v == a or v == b or not _alike(field, front.foot[a], front.foot[v]):
            continue
        x, y, z = p[v, 0] - mx, p[v, 1] - my, p[v, 2] - mz
        far = x * x + y * y + z * z
        along = ux * x + uy * y + uz * z
        up = math.sqrt(max(far - along * along / square, 0.0))
        if wx * x + wy * y + wz * z <= LEFT * up:
            continue
        if up * up <= 1e-18 * square:
            continue
        centre = (far - 0.25 * square) / (2.0 * up)
        if centre < lowest or (centre == lowest and v < found):
            found, lowest = v, centre
    return found, lowest


@kernel
def _alike(field: Field, one: int, two: int) -> bool:
    """Whether two triangles of the ground are of one patch and face one way."""
    n = field.ground.normals
    return bool(field.patches[one] == field.patches[two]
                and n[one, 0] * n[two, 0] + n[one, 1] * n[two, 1] + n[one, 2] * n[two, 2] > 0.0)


@kernel
def _is_near(
    front: Front, x: float, y: float, z: float, face: int, h: float, field: Field
) -> bool:
    """Whether a vertex is nearer to a place than APART h."""
    p = front.points
    away = APART * h
    for i in range(_gather(front, x, y, z, away, h, field.least)):
        v = front.around[i]
        far = (p[v, 0] - x) ** 2 + (p[v, 1] - y) ** 2 + (p[v, 2] - z) ** 2
        if far < away * away and _alike(field, face, front.foot[v]):
            return True
    return False


@kernel
def _gather(
    front: Front, x: float, y: float, z: float, away: float, h: float, least: float
) -> int:
    """Write the vertices of the boxes near a place into front.around; how many.

    Those whose size is within VARIED of h: a box holds one size and those up to twice as large.
    """
    count = 0
    edge = 2.0 * least
    for level in range(LEVELS):
        if edge > 2.0 * VARIED * h:
            break
        low = max(math.floor((z - away) / edge), front.rows[level, 0])
        high = min(math.floor((z + away) / edge), front.rows[level, 1])
        if edge * VARIED >= h and low <= high:
            for i in range(math.floor((x - away) / edge), math.floor((x + away) / edge) + 1):
                for j in range(math.floor((y - away) / edge), math.floor((y + away) / edge) + 1):
                    for k in range(low, high + 1):
                        count = _look(front, _slot(i, j, k, level, front.boxes.shape[0]),
                                      x, y, z, away, count)
        edge *= 2.0
    return count


@kernel
def _look(
    front: Front, box: int, x: float, y: float, z: float, away: float, count: int
) -> int:
    """Write the vertices of one box that are near a place behind those that were found."""
    v = front.boxes[box]
    for _ in range(front.points.shape[0]):
        if v < 0 or count == ROOM:
            break
        p = front.points
        if (abs(p[v, 0] - x) <= away and abs(p[v, 1] - y) <= away and abs(p[v, 2] - z) <= away):
            front.around[count] = v
            count += 1
        v = front.following[v]
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
    p, rows = front.points, front.rows
    i, j, k = (math.floor(p[v, 0] / edge), math.floor(p[v, 1] / edge), math.floor(p[v, 2] / edge))
    s = _slot(i, j, k, level, front.boxes.shape[0])
    front.following[v] = front.boxes[s]
    front.boxes[s] = v
    if rows[level, 0] > rows[level, 1]:
        rows[level, 0], rows[level, 1] = k, k
    rows[level, 0], rows[level, 1] = min(rows[level, 0], k), max(rows[level, 1], k)


@kernel
def _slot(i: int, j: int, k: int, level: int, slots: int) -> int:
    """Hash of four numbers."""
    return int((i * 73856093 ^ j * 19349663 ^ k * 49979687 ^ level * 83492791) & (slots - 1))


@kernel
def _join(front: Front, a: int, b: int) -> bool:
    """Add an edge to the front unless it was there, either way round; False without room."""
    k = front.count[1]
    if k == front.edges.shape[0]:
        return False
    front.edges[k, 0], front.edges[k, 1] = a, b
    if _remember(front, k):
        front.count[1] += 1
    return True


@kernel
def _remember(front: Front, k: int) -> bool:
    """Whether an edge was not known yet, either way round; now it is."""
    a, b = front.edges[k, 0], front.edges[k, 1]
    s = _slot(np.int64(min(a, b)), np.int64(max(a, b)), 0, 0, front.known.shape[0])
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
