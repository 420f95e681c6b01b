"""Curvature of a triangulated surface, and a density that follows it."""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.elementary import exp, log, power
from odt_plugins.engine.odt.density import smooth_over_stars
from odt_plugins.engine.topology.star import star_sum
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.simplex import diagonal, vertices_of

AVERAGES = 3
"""Passes that average the curvature tensors, vertices to triangles and back."""

SMOOTHING = 3
"""Passes that average the logarithm of the sizes."""

DOUBTFUL = 0.05
"""Weight of a triangle that touches the boundary or a feature against the others."""

FLAT = 0.1
"""Curvature, in units of 1 / diagonal of the bounding box, below which a surface is flat."""

ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))
"""Entries of a symmetric tensor that are kept."""

RATIO = 4.0
"""Largest size over the smallest one."""


def vertex_curvature(points: FloatArray, triangles: IntArray, neighbors: IntArray) -> FloatArray:
    """Curvature sqrt(kappa_1^2 + kappa_2^2) at the vertices of a surface.

    Parameters
    ----------
    points : (n, 3) float64
    triangles : (m, 3) int32    oriented alike across an edge that has a neighbour
    neighbors : (m, 3) int32    triangle across the edge opposite to a corner; -1 outside and
                                where the surface is not to count as curved: at feature edges

    Returns
    -------
    (n,) float64                [1 / length unit], 0 where nothing is known
    """
    tensor, share = shape_operators(points, triangles, neighbors)
    square = (tensor[:, :3] ** 2).sum(axis=1) + 2.0 * (tensor[:, 3:] ** 2).sum(axis=1)
    curvature: FloatArray = np.zeros(len(points))
    np.divide(np.sqrt(square), share, out=curvature, where=share > 0.0)
    return curvature


def shape_operators(
    points: FloatArray, triangles: IntArray, neighbors: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Shape operators at the vertices of a surface, times areas.

    Parameters as for :func:`vertex_curvature`.

    Returns
    -------
    (n, 6) float64              the :data:`ENTRIES` of the shape operator times the area
    (n,) float64                the area, 0 where nothing is known

    Notes
    -----
    The shape operator is the gradient of the normals n_i at the vertices, linear on a triangle:
    |tau| grad n = sum_i n_i (n x e_i)^T / 2, with n its normal and e_i the edge opposite to corner
    i. This is bounded whatever the shape of the triangle, and linear in the normals, so that noise
    averages out. A vertex normal is the sum of the area vectors of its star; on the boundary or a
    feature, of those of a triangle and its two neighbours at that vertex.

    References
    ----------
    S. Rusinkiewicz, Estimating curvatures and their derivatives on triangle meshes, 3DPVT 2004:
    curvature from differences of vertex normals.
    """
    n = len(points)
    if not len(triangles):
        return np.zeros((n, 6)), np.zeros(n)
    corners = points[triangles]
    area_vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = _unit(area_vectors)
    area = 0.5 * np.sqrt((area_vectors**2).sum(axis=1))
    cut = np.zeros(n, dtype=np.bool_)
    for i in range(3):
        open_ = triangles[neighbors[:, i] < 0]
        cut[open_[:, (i + 1) % 3]] = True
        cut[open_[:, (i + 2) % 3]] = True
    around = star_sum(area_vectors, triangles, n)
    tensors = np.zeros((len(triangles), 6))
    for i in range(3):
        corner_normals = around[triangles[:, i]]
        some = cut[triangles[:, i]]
        corner_normals[some] = area_vectors[some]
        for side in ((i + 1) % 3, (i + 2) % 3):
            near = neighbors[some, side]
            corner_normals[some] += np.where(near[:, None] < 0, 0.0, area_vectors[near])
        corner_normals = _unit(corner_normals)
        across = 0.5 * np.cross(normals, corners[:, (i + 2) % 3] - corners[:, (i + 1) % 3])
        for entry, (j, k) in enumerate(ENTRIES):
            both = corner_normals[:, j] * across[:, k] + corner_normals[:, k] * across[:, j]
            tensors[:, entry] += 0.5 * both
    weight = np.where(cut[triangles].any(axis=1), DOUBTFUL, 1.0)
    tensor = star_sum(tensors * weight[:, None], triangles, n)
    share = star_sum(area * weight, triangles, n)
    i, j, k = triangles.T
    for _ in range(AVERAGES):
        tensor = star_sum(tensor[i] + tensor[j] + tensor[k], triangles, n)
        share = star_sum(share[i] + share[j] + share[k], triangles, n)
    return tensor, share


def _unit(vectors: FloatArray) -> FloatArray:
    """Vectors of length 1, or 0, (k, 3)."""
    length = np.sqrt((vectors * vectors).sum(axis=1))[:, None]
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)


def curvature_density(points: FloatArray, triangles: IntArray, neighbors: IntArray) -> FloatArray:
    """Density that makes triangles small where the surface is curved.

    Parameters
    ----------
    points : (n, 3) float64, triangles : (m, 3) int32, neighbors : (m, 3) int32
                                as for :func:`vertex_curvature`

    Returns
    -------
    (n,) float64                rho = h^-4, the sizes h with mean 1

    Notes
    -----
    A chord of length h lies kappa h^2 / 8 below an arc of curvature kappa. The same depth
    everywhere asks for h = kappa^(-1/2), and rho = h^-(d + 2) with d = 2, since ODT equidistributes
    |tau| rho^(d / (d + 2)): the number of triangles per area follows the curvature. kappa is that
    of :func:`vertex_curvature`, but at least FLAT / diagonal, and within a factor RATIO of its
    mean over the surface; log h is averaged SMOOTHING times.

    References
    ----------
    CMAME 200 (2011) 967-984, Theorem 2.8.
    """
    n = len(points)
    if not len(triangles):
        return np.ones(n)
    a, b, c = (points[triangles[:, i]] for i in range(3))
    share = star_sum(np.sqrt((np.cross(b - a, c - a) ** 2).sum(axis=1)), triangles, n)
    used = vertices_of(triangles)
    length = diagonal(points[used])
    if not share.sum() > 0.0:
        return np.ones(n)
    kappa = np.maximum(vertex_curvature(points, triangles, neighbors), FLAT / length)
    mean = float((kappa * share).sum() / share.sum())
    kappa = np.clip(kappa, mean / RATIO, mean * RATIO)
    log_h = smooth_over_stars(-0.5 * log(kappa / mean), triangles, SMOOTHING)
    h = exp(log_h)
    h /= h[used].mean()
    return power(h, -4.0)
