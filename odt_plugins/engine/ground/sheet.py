"""The surface while it is being changed, and the guards that every change of it must pass."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.triangle import triangle_in_space
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.closest import Ground, closest_on_triangle, walk
from odt_plugins.engine.ground.lines import Lines
from odt_plugins.engine.ground.trace import End, edge_is_near
from odt_plugins.engine.topology.lookup import place_in
from odt_plugins.engine.topology.star import Stars
from odt_plugins.engine.topology.triangles import EdgeNumbers
from odt_plugins.errors import endless_walk
from odt_plugins.mesh.arrays import BoolArray, ByteArray, FloatArray, IntArray

SMOOTH, LINE, LOCKED = 0, 1, 2
"""Kinds of vertices: movable on the surface, movable on a feature line, locked."""


class Sheet(NamedTuple):
    """A surface that lies on its ground, vertex by vertex.

    Attributes
    ----------
    points : (n, 3) float64         moved in place, each on the ground; more columns as in
                                    ``cells.metric``
    triangles : (m, 3) int32        oriented alike across every edge of two triangles
    neighbors : (m, 3) int32        triangle across the edge opposite to a corner, -1 where there is
                                    none and at edges of more than two triangles
    edges : EdgeNumbers             their numbers
    locked : (e,) bool              edges that stay: features, boundaries, borders of labels
    kind : (n,) uint8               SMOOTH, LINE or LOCKED
    pinched : (n,) bool             vertices around which the triangles form more than one fan
    foot : (n,) int32               triangle of the ground on which a vertex lies
    first : (m,) int32              first vertex of the ground that a triangle covers, or -1
    following : (n,) int32          next vertex of the ground covered by the same triangle, or -1
    lost : (1,) int32               a vertex at which a walk did not end, -1 as long as all do
    """

    points: FloatArray
    triangles: IntArray
    neighbors: IntArray
    edges: EdgeNumbers
    locked: BoolArray
    kind: ByteArray
    pinched: BoolArray
    foot: IntArray
    first: IntArray
    following: IntArray
    lost: IntArray

    def check(self) -> None:
        """Raise EndlessWalkError if a walk did not end."""
        if self.lost[0] >= 0:
            raise endless_walk(int(self.lost[0]))


class Work(NamedTuple):
    """Room that one thread works in; made by :func:`make_work`.

    Attributes
    ----------
    cells : (k,) int32               triangles of a star or of a pair
    pool : (n, 2) int32              vertex of the ground, triangle that is to cover it
    axes : (2, 3) float64            orthonormal directions
    derivatives : (5,) float64       first and second ones along the axes
    """

    cells: IntArray
    pool: IntArray
    axes: FloatArray
    derivatives: FloatArray


def make_work(ground: Ground, largest: int = 2) -> Work:
    """Give room for the largest star, or for the pair of triangles at an edge."""
    return Work(
        np.empty(largest, dtype=np.int32), np.empty((len(ground.points), 2), dtype=np.int32),
        np.empty((2, 3)), np.empty(5),
    )


class Limits(NamedTuple):
    """What every change must keep.

    Attributes
    ----------
    distance : float    squared distance between the surface and its ground
    line : float        squared distance between a feature line and what it was
    cosine : float      least cosine between the normal of a triangle and that of the ground
    """

    distance: float
    line: float
    cosine: float


class Guards(NamedTuple):
    """What every move of a vertex on a surface must heed.

    Attributes
    ----------
    ground : Ground    the surface as it was
    lines : Lines      its feature lines
    limits : Limits
    """

    ground: Ground
    lines: Lines
    limits: Limits


@kernel
def normal_cosine(sheet: Sheet, ground: Ground, a: int, b: int, c: int) -> float:
    """Cosine between the normal of (a, b, c) and that of the ground under its barycentre.

    -1 for a flat triangle.
    """
    p = sheet.points
    _, _, _, nx, ny, nz = triangle_in_space(p, a, b, c)
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    if not length > 0.0:
        return -1.0
    near = a
    if sheet.kind[a] != SMOOTH:
        near = b if sheet.kind[b] == SMOOTH else c
    x = (p[a, 0] + p[b, 0] + p[c, 0]) / 3.0
    y = (p[a, 1] + p[b, 1] + p[c, 1]) / 3.0
    z = (p[a, 2] + p[b, 2] + p[c, 2]) / 3.0
    _, face, _, _, _ = walk(x, y, z, sheet.foot[near], ground, False)
    n = ground.normals
    return (nx * n[face, 0] + ny * n[face, 1] + nz * n[face, 2]) / length


@kernel
def joined(sheet: Sheet, ground: Ground, a: int, b: int, limit: float) -> bool:
    """Whether the edge ab and the ground under it are close to each other."""
    return edge_is_near(_end(sheet, a), _end(sheet, b), ground, limit)


@kernel
def _end(sheet: Sheet, v: int) -> End:
    p = sheet.points
    face = np.int64(sheet.foot[v])
    return End(p[v, 0], p[v, 1], p[v, 2], face, sheet.kind[v] == SMOOTH)


@kernel
def claim(
    sheet: Sheet, ground: Ground, count: int, limit: float, work: Work
) -> int:
    """Find the nearest of some triangles for every vertex of the ground that they cover together.

    Parameters
    ----------
    count : int        the triangles are work.cells[:count]
    limit : float      squared distance
    work : Work        OUT: pool

    Returns
    -------
    int                rows of the pool, or -1 when a vertex is further from all of them
    """
    p, t, g = sheet.points, sheet.triangles, ground.points
    cells, pool = work.cells, work.pool
    number = 0
    for i in range(count):
        v = sheet.first[cells[i]]
        for _ in range(number, len(pool)):
            if v < 0:
                break
            best = limit
            found = -1
            for j in range(count):
                c = cells[j]
                d, _, _, _, _ = closest_on_triangle(
                    g[v, 0], g[v, 1], g[v, 2], p, t[c, 0], t[c, 1], t[c, 2]
                )
                if d <= best:
                    best = d
                    found = c
            if found < 0:
                return -1
            pool[number, 0] = v
            pool[number, 1] = found
            number += 1
            v = sheet.following[v]
        if v >= 0:
            sheet.lost[0] = v
            return -1
    return number


@kernel
def cover(sheet: Sheet, count: int, number: int, work: Work) -> None:
    """Write what :func:`claim` found into the lists of the triangles."""
    cells, pool = work.cells, work.pool
    for i in range(count):
        sheet.first[cells[i]] = -1
    for i in range(number - 1, -1, -1):
        v, c = pool[i, 0], pool[i, 1]
        sheet.following[v] = sheet.first[c]
        sheet.first[c] = v


@kernel
def star_fits(
    sheet: Sheet, ground: Ground, stars: Stars, vertex: int, limits: Limits, least: float,
    work: Work,
) -> int:
    """Check the star of a vertex against the ground.

    Parameters
    ----------
    stars : Stars        of the sheet
    vertex : int
    limits : Limits
    least : float        least cosine of a normal that is asked for
    work : Work          OUT: triangles of the star, and the pool of :func:`claim`

    Returns
    -------
    int                  rows of the pool, or -1 when the star leaves the limits
    """
    t, cells = sheet.triangles, work.cells
    start = stars.indptr[vertex]
    count = stars.indptr[vertex + 1] - start
    for s in range(count):
        c = stars.indices[start + s]
        cells[s] = c
        if normal_cosine(sheet, ground, t[c, 0], t[c, 1], t[c, 2]) < least:
            return -1
    for s in range(count):
        c = cells[s]
        i = place_in(t, c, vertex)
        # every edge of the vertex that has two triangles leaves one of them behind its corner
        if sheet.locked[sheet.edges.of_cell[c, (i + 2) % 3]]:
            continue
        if not joined(sheet, ground, vertex, t[c, (i + 1) % 3], limits.distance):
            return -1
    return claim(sheet, ground, count, limits.distance, work)
