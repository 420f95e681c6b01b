"""Curvature of a triangulated surface, and a density that follows it."""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.density import smooth_over_stars
from odt_plugins.engine.star import star_sum
from odt_plugins.mesh import FloatArray, IntArray

AVERAGES = 3
"""Passes that average the curvature tensors, vertices to triangles and back."""

SMOOTHING = 3
"""Passes that average the logarithm of the sizes."""

SHARPEST = 0.5 * np.pi
"""Bend above which an edge is a fold and not part of a curved surface [radians]."""

FLAT = 0.1
"""Curvature, in units of 1 / diagonal of the bounding box, below which a surface is flat."""

ENTRIES = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0))
"""Entries of a symmetric tensor that are kept."""

RATIO = 4.0
"""Largest size over the smallest one."""


def vertex_curvature(
    points: FloatArray, triangles: IntArray, neighbors: IntArray, passes: int = AVERAGES
) -> FloatArray:
    """Curvature sqrt(kappa_1^2 + kappa_2^2) at the vertices of a surface.

    Parameters
    ----------
    points : (n, 3) float64
    triangles : (m, 3) int32    oriented alike across an edge that has a neighbour
    neighbors : (m, 3) int32    triangle across the edge opposite to a corner; -1 at the rim, and
                                where the surface is not to count as curved: at feature edges
    passes : int                averaging passes over the tensors, weighted by area

    Returns
    -------
    (n,) float64                [1 / length unit], 0 where nothing is known

    Notes
    -----
    The curvature tensor averaged over a set B is the sum over the edges of beta |e and B| e e^T,
    divided by the area of B; beta is the signed bend between the triangles of the unit edge e.
    Here B is one third of the star of a vertex and half its edges, then what the passes make of it.
    A bend that is noise has its counterpart nearby and drops out. Vertices on the rim or on a
    feature take the average of their neighbours.

    References
    ----------
    D. Cohen-Steiner, J.-M. Morvan, Restricted Delaunay triangulations and normal cycle, SoCG 2003.
    """
    n, m = len(points), len(triangles)
    if not m:
        return np.zeros(n)
    a, b, c = (points[triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    area = 0.5 * np.sqrt((normals * normals).sum(axis=1))
    np.divide(normals, 2.0 * area[:, None], out=normals, where=area[:, None] > 0.0)
    tensor = np.zeros((n, 6))
    cut = np.zeros(n, dtype=np.bool_)
    for i in range(3):
        start, end, across = triangles[:, (i + 1) % 3], triangles[:, (i + 2) % 3], neighbors[:, i]
        cut[start[across < 0]] = True
        cut[end[across < 0]] = True
        once = np.flatnonzero(across > np.arange(m))
        start, end = start[once], end[once]
        edge = points[end] - points[start]
        length = np.sqrt((edge * edge).sum(axis=1))
        np.divide(edge, length[:, None], out=edge, where=length[:, None] > 0.0)
        first, second = normals[once], normals[across[once]]
        bend = np.arctan2(
            (np.cross(first, second) * edge).sum(axis=1), (first * second).sum(axis=1)
        )
        bend[np.abs(bend) > SHARPEST] = 0.0
        weight = 0.5 * bend * length
        for entry, (j, k) in enumerate(ENTRIES):
            part = weight * edge[:, j] * edge[:, k]
            tensor[:, entry] += np.bincount(start, part, n) + np.bincount(end, part, n)
    tensor[cut] = 0.0
    share = star_sum(area, triangles, n) / 3.0
    share[cut] = 0.0
    i, j, k = triangles.T
    for _ in range(passes):
        tensor = star_sum(tensor[i] + tensor[j] + tensor[k], triangles, n)
        share = star_sum(share[i] + share[j] + share[k], triangles, n)
    square = (tensor[:, :3] ** 2).sum(axis=1) + 2.0 * (tensor[:, 3:] ** 2).sum(axis=1)
    curvature: FloatArray = np.zeros(n)
    np.divide(np.sqrt(square), share, out=curvature, where=share > 0.0)
    return curvature


def curvature_density(
    points: FloatArray, triangles: IntArray, neighbors: IntArray, ratio: float = RATIO
) -> FloatArray:
    """Density that makes triangles small where the surface is curved.

    Parameters
    ----------
    points : (n, 3) float64, triangles : (m, 3) int32, neighbors : (m, 3) int32
                                as for :func:`vertex_curvature`
    ratio : float               bound of the largest size over the smallest, at least 1

    Returns
    -------
    (n,) float64                rho = h^-4, the sizes h with mean 1

    Notes
    -----
    A chord of length h lies kappa h^2 / 8 below an arc of curvature kappa. The same depth
    everywhere asks for h = kappa^(-1/2), and rho = h^-(d + 2) with d = 2, since ODT equidistributes
    |tau| rho^(d / (d + 2)): the number of triangles per area follows the curvature. kappa is that
    of :func:`vertex_curvature`, but at least FLAT / diagonal, and within a factor ``ratio`` of its
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
    used = np.unique(triangles)
    diagonal = float(np.linalg.norm(np.ptp(points[used], axis=0)))
    if not share.sum() > 0.0:
        return np.ones(n)
    kappa = np.maximum(vertex_curvature(points, triangles, neighbors), FLAT / diagonal)
    mean = float((kappa * share).sum() / share.sum())
    kappa = np.clip(kappa, mean / ratio, mean * ratio)
    log_h = smooth_over_stars(-0.5 * np.log(kappa / mean), triangles, SMOOTHING)
    h = np.exp(log_h)
    h /= h[used].mean()
    rho: FloatArray = h**-4.0
    return rho
