"""Simplices in R^d, d = 2 or 3: volumes, centres, radii, boundary. Whole meshes at once."""

from __future__ import annotations

from itertools import combinations
from math import factorial

import numpy as np

from odt_plugins.engine.cells.corner import corner_edges, six_volumes
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.topology.adjacency import cell_neighbors
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray

FACETS = {
    3: np.array([[1, 2], [2, 0], [0, 1]]),
    4: np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]),
}
"""Corners of the facet opposite to each local vertex; normals of a positive cell point outwards."""


def edge_vectors(points: FloatArray, cells: IntArray) -> FloatArray:
    """Return x_k - x_0, k = 1..d, of every cell, shape (m, d, d)."""
    edges: FloatArray = points[cells[:, 1:]] - points[cells[:, :1]]
    return edges


@kernel
def _fill_volumes(points: FloatArray, cells: IntArray, volumes: FloatArray) -> None:
    m, k = cells.shape
    for c in range(m):
        o = cells[c, 0]
        i = cells[c, 1]
        j = cells[c, 2]
        if k == 3:
            ax, ay = points[i, 0] - points[o, 0], points[i, 1] - points[o, 1]
            bx, by = points[j, 0] - points[o, 0], points[j, 1] - points[o, 1]
            volumes[c] = (ax * by - ay * bx) / 2.0
        else:
            volumes[c] = six_volumes(*corner_edges(points, o, i, j, cells[c, 3])) / 6.0


def signed_volumes(points: FloatArray, cells: IntArray) -> FloatArray:
    """Signed volume of every cell; the area of triangles in space, which has no sign.

    Parameters
    ----------
    points : (n, d) float64
    cells : (m, d + 1) int32

    Returns
    -------
    (m,) float64               det(x_1 - x_0, ..., x_d - x_0) / d!  [length unit to the power d]
    """
    if cells.shape[1] == 3 and points.shape[1] == 3:
        e = edge_vectors(points, cells)
        areas: FloatArray = 0.5 * np.linalg.norm(np.cross(e[:, 0], e[:, 1]), axis=1)
        return areas
    volumes = np.empty(len(cells))
    _fill_volumes(
        np.ascontiguousarray(points, dtype=np.float64),
        np.ascontiguousarray(cells, dtype=np.int32),
        volumes,
    )
    return volumes


def volume_gradients(points: FloatArray, cells: IntArray) -> FloatArray:
    """Gradient of every cell's signed volume with respect to each of its vertices.

    Returns
    -------
    (m, d + 1, d) float64      nabla_{x_i}|tau|: normal to the facet opposite to x_i, towards x_i,
                               of length facet measure / d; (m, 3, 3) and in their planes for
                               triangles in space

    References
    ----------
    CMAME 200 (2011) 967-984, Lemma 4.2.
    """
    e = edge_vectors(points, cells)
    d = e.shape[1]
    gradients = np.empty((len(cells), d + 1, e.shape[2]))
    if e.shape[1:] == (2, 3):
        normal = np.cross(e[:, 0], e[:, 1])
        length = np.linalg.norm(normal, axis=1)[:, None]
        np.divide(normal, length, out=normal, where=length > 0.0)
        gradients[:, 1] = np.cross(e[:, 1], normal)
        gradients[:, 2] = np.cross(normal, e[:, 0])
    elif d == 2:
        gradients[:, 1, 0], gradients[:, 1, 1] = e[:, 1, 1], -e[:, 1, 0]
        gradients[:, 2, 0], gradients[:, 2, 1] = -e[:, 0, 1], e[:, 0, 0]
    else:
        gradients[:, 1] = np.cross(e[:, 1], e[:, 2])
        gradients[:, 2] = np.cross(e[:, 2], e[:, 0])
        gradients[:, 3] = np.cross(e[:, 0], e[:, 1])
    gradients[:, 1:] /= factorial(d)
    gradients[:, 0] = -gradients[:, 1:].sum(axis=1)
    return gradients


def barycenters(points: FloatArray, cells: IntArray) -> FloatArray:
    """Mean of the vertices of every cell, shape (m, d)."""
    centers: FloatArray = points[cells].mean(axis=1)
    return centers


def circumcenters(points: FloatArray, cells: IntArray) -> FloatArray:
    """Centre of the sphere through the vertices of every cell.

    Parameters
    ----------
    points : (n, d) float64
    cells : (m, d + 1) int32

    Returns
    -------
    (m, d) float64             barycenter where a cell is too flat for a finite circumcenter

    Notes
    -----
    (4.6) with the origin at x_0: 2 |tau| (c - x_0) = sum_k ||x_k - x_0||^2 nabla_{x_k}|tau|,
    since the forces f_F of one cell sum to -sum_k ||x_k||^2 nabla_{x_k}|tau|. A local origin keeps
    the relative error at the rounding of the volume alone.

    References
    ----------
    CMAME 200 (2011) 967-984, (4.6).
    """
    e = edge_vectors(points, cells)
    moment = np.einsum("mk,mki->mi", (e**2).sum(axis=2), volume_gradients(points, cells)[:, 1:])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        offset = moment / (2.0 * signed_volumes(points, cells)[:, None])
    centers: FloatArray = points[cells[:, 0]] + offset
    flat = ~np.isfinite(centers).all(axis=1)
    if flat.any():
        centers[flat] = barycenters(points, cells[flat])
    return centers


def circumradii(points: FloatArray, cells: IntArray) -> FloatArray:
    """Radius of the sphere through the vertices of every cell, shape (m,)."""
    radii: FloatArray = np.linalg.norm(circumcenters(points, cells) - points[cells[:, 0]], axis=1)
    return radii


def squared_edge_sum(points: FloatArray, cells: IntArray) -> FloatArray:
    """Sum of the squared edge lengths t_ij of every cell, shape (m,)."""
    total = np.zeros(len(cells))
    for i, j in combinations(range(cells.shape[1]), 2):
        total += ((points[cells[:, i]] - points[cells[:, j]]) ** 2).sum(axis=1)
    return total


def boundary_facets(cells: IntArray, neighbors: IntArray | None = None) -> IntArray:
    """Facets that belong to one cell.

    Parameters
    ----------
    cells : (m, d + 1) int32                   positive
    neighbors : (m, d + 1) int32, optional     from :func:`cell_neighbors`, when already known

    Returns
    -------
    (b, d) int32                               normals point out of the domain; in order of cells
    """
    if neighbors is None:
        neighbors = cell_neighbors(cells)
    cell, opposite = np.nonzero(neighbors < 0)
    facets: IntArray = cells[cell[:, None], FACETS[cells.shape[1]][opposite]]
    return facets


def interface_vertices(cells: IntArray, n_points: int, regions: IntArray) -> BoolArray:
    """Mark the vertices (n,) of facets between two regions (m,)."""
    neighbors = cell_neighbors(cells)
    apart = (neighbors >= 0) & (regions[neighbors] != regions[:, None])
    cell, opposite = np.nonzero(apart)
    mask = np.zeros(n_points, dtype=np.bool_)
    mask[cells[cell[:, None], FACETS[cells.shape[1]][opposite]]] = True
    return mask


def boundary_vertices(
    cells: IntArray,
    n_points: int,
    regions: IntArray | None = None,
    neighbors: IntArray | None = None,
) -> BoolArray:
    """Mark the vertices of boundary facets and of interfaces between regions.

    Parameters
    ----------
    cells : (m, d + 1) int32
    n_points : int                             n
    regions : (m,) int32, optional             label of every cell
    neighbors : (m, d + 1) int32, optional     from :func:`cell_neighbors`, when already known

    Returns
    -------
    (n,) bool
    """
    if neighbors is None:
        neighbors = cell_neighbors(cells)
    wall = neighbors < 0
    if regions is not None:
        wall |= regions[neighbors] != regions[:, None]
    cell, opposite = np.nonzero(wall)
    mask = np.zeros(n_points, dtype=np.bool_)
    mask[cells[cell[:, None], FACETS[cells.shape[1]][opposite]]] = True
    return mask
