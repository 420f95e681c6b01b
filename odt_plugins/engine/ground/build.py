"""From arrays to the ground and the sheet on it."""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.closest import Ground
from odt_plugins.engine.ground.features import Features, marked_edges
from odt_plugins.engine.ground.reference import make_reference
from odt_plugins.engine.ground.sheet import Sheet
from odt_plugins.engine.topology.star import Stars, vertex_stars
from odt_plugins.engine.topology.triangles import EdgeNumbers
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.mesh.surface import Edges, surface_edges


def make_ground(
    points: FloatArray, triangles: IntArray, edges: Edges, stars: Stars, apart: BoolArray
) -> Ground:
    """Lay the input surface out for the kernels.

    Parameters
    ----------
    points : (n, 3) float64, triangles : (m, 3) int32
    edges : Edges, stars : Stars     of these triangles
    apart : (e,) bool                feature edges, across which normals are not averaged
    """
    a, b, c = (points[triangles[:, i]] for i in range(3))
    area = np.cross(b - a, c - a)
    normals = area.copy()
    for i in range(3):
        near = edges.neighbors[:, i]
        alike = (near >= 0) & ~apart[edges.of_cell[:, i]]
        normals[alike] += area[near[alike]]
    length = np.sqrt((normals * normals).sum(axis=1))
    np.divide(normals, length[:, None], out=normals, where=length[:, None] > 0.0)
    return Ground(
        points.copy(), triangles.copy(), edges.neighbors, stars.indptr, stars.indices, normals
    )


def make_sheet(
    points: FloatArray, triangles: IntArray, edges: Edges, features: Features
) -> Sheet:
    """Lay the surface out that is to be changed: at first the same as its ground.

    Parameters
    ----------
    points : (n, 3) float64, triangles : (m, 3) int32, edges : Edges
    features : Features    their edges are locked
    """
    n, m = len(points), len(triangles)
    a, b, c = (points[triangles[:, i]] for i in range(3))
    size = (np.cross(b - a, c - a) ** 2).sum(axis=1)
    foot = np.full(n, -1, dtype=np.int32)
    _largest_of_star(triangles, size, foot)
    first = np.full(m, -1, dtype=np.int32)
    following = np.full(n, -1, dtype=np.int32)
    _cover_first(foot, first, following)
    locked = features.edges | (edges.degree != 2)
    edge_cell = np.zeros(len(edges.degree), dtype=np.int32)
    edge_cell[edges.of_cell] = np.arange(m, dtype=np.int32)[:, None]
    return Sheet(
        points.copy(), triangles.copy(), edges.neighbors.copy(),
        EdgeNumbers(edges.of_cell.copy(), edge_cell),
        locked, features.kind, features.pinched, foot, first, following,
        np.full(1, -1, dtype=np.int32),
    )


def earlier_ground(surface: SimplexMesh, points: FloatArray) -> Ground:
    """Lay out the surface that a mesh has slid on before, its vertices at ``points`` (n, 3)."""
    n, triangles = len(points), surface.cells
    edges = surface_edges(triangles, n)
    apart = marked_edges(edges, surface.lines, n)
    return make_ground(points, triangles, edges, vertex_stars(triangles, n), apart)


def laid_on(sheet: Sheet, ground: Ground, limit: float) -> Sheet:
    """Put a sheet on a ground other than itself.

    Every vertex lies on the closest triangle of the ground. Vertices of the ground within the
    squared distance ``limit`` are covered by the closest triangle of the sheet.
    """
    used = np.unique(sheet.triangles)
    foot = np.full(len(sheet.points), -1, dtype=np.int32)
    foot[used] = make_reference(ground.points, ground.triangles).closest(sheet.points[used])[1]
    under = np.unique(ground.triangles)
    distance, face, _ = make_reference(sheet.points, sheet.triangles).closest(ground.points[under])
    near = distance * distance <= limit
    covered_by = np.full(len(ground.points), -1, dtype=np.int32)
    covered_by[under[near]] = face[near]
    first = np.full(len(sheet.triangles), -1, dtype=np.int32)
    following = np.full(len(ground.points), -1, dtype=np.int32)
    _cover_first(covered_by, first, following)
    return sheet._replace(foot=foot, first=first, following=following)


@kernel
def _largest_of_star(triangles: IntArray, size: FloatArray, foot: IntArray) -> None:
    """Give every vertex the largest triangle of its star."""
    for t in range(triangles.shape[0]):
        for i in range(3):
            v = triangles[t, i]
            if foot[v] < 0 or size[t] > size[foot[v]]:
                foot[v] = t


@kernel
def _cover_first(by: IntArray, first: IntArray, following: IntArray) -> None:
    """Let every vertex of the ground be covered by a triangle."""
    for v in range(by.shape[0] - 1, -1, -1):
        t = by[v]
        if t >= 0:
            following[v] = first[t]
            first[t] = v


@kernel
def ground_value(
    ground: Ground, values: FloatArray, f: int, x: float, y: float, z: float
) -> float:
    """Value at a point of a triangle of the ground, linear between values at its vertices."""
    g, t = ground.points, ground.triangles
    a, b, c = t[f, 0], t[f, 1], t[f, 2]
    uu = uv = vv = up = vp = 0.0
    for k in range(3):
        u = g[b, k] - g[a, k]
        w = g[c, k] - g[a, k]
        p = (x if k == 0 else y if k == 1 else z) - g[a, k]
        uu += u * u
        uv += u * w
        vv += w * w
        up += u * p
        vp += w * p
    det = uu * vv - uv * uv
    if not det > 0.0:
        return float((values[a] + values[b] + values[c]) / 3.0)
    s = min(max((vv * up - uv * vp) / det, 0.0), 1.0)
    r = min(max((uu * vp - uv * up) / det, 0.0), 1.0 - s)
    return float((1.0 - s - r) * values[a] + s * values[b] + r * values[c])


@kernel
def ground_values(
    ground: Ground, values: FloatArray, points: FloatArray, foot: IntArray, out: FloatArray
) -> None:
    """Interpolate values at the vertices of the ground linearly at the feet of points."""
    for v in range(points.shape[0]):
        f = foot[v]
        if f >= 0:
            out[v] = ground_value(ground, values, f, points[v, 0], points[v, 1], points[v, 2])


def resample_metric(
    ground: Ground, metric: FloatArray, points: FloatArray, foot: IntArray
) -> None:
    """Write a metric behind the coordinates of points as it is at their feet.

    Parameters
    ----------
    ground : Ground
    metric : (k, g) float64        at the vertices of the ground, one column of ``cells.metric``
                                   after another; k = 0 without one
    points : (n, 3 + k) float64    changed
    foot : (n,) int32              triangles of the ground
    """
    for k, column in enumerate(metric):
        found = points[:, 3 + k].copy()
        ground_values(ground, column, points, foot, found)
        points[:, 3 + k] = found
