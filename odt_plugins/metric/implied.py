"""The metric that a mesh has: in which its cells are regular with edges of length 1."""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.elementary import log
from odt_plugins.engine.cells.geometry import signed_volumes
from odt_plugins.engine.cells.tensors import ROUNDED, eigenvalues, exponential, of_eigenvalues
from odt_plugins.engine.topology.star import star_sum
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.layers import edge_products


def implied_metric(points: FloatArray, cells: IntArray) -> FloatArray:
    """The metric of a mesh: log-Euclidean means, weighted by volume, of those of the cells around.

    Parameters
    ----------
    points : (n, d) float64, d = 2 or 3    in any unit
    cells : (m, k + 1) int32               triangles or tetrahedra; triangles may lie in space

    Returns
    -------
    (n, d, d) float64    the identity where there are no cells. Normal to a triangle in space, it
                         has the larger of the two eigenvalues along the triangle
    """
    return exponential(star_means(points, cells, cell_logarithms(points, cells)))


def star_means(points: FloatArray, cells: IntArray, tensors: FloatArray) -> FloatArray:
    """Means (n, d, d) of tensors (m, d, d) of the cells around vertices, weighted by volume.

    They are 0 where there are no cells.
    """
    n, m, d = len(points), len(cells), tensors.shape[1]
    volumes = np.abs(signed_volumes(points, cells))[:, None]
    weight = star_sum(volumes, cells, n)
    total = star_sum(volumes * tensors.reshape(m, d * d), cells, n)
    mean = np.divide(total, weight, out=np.zeros_like(total), where=weight > 0.0)
    return mean.reshape(n, d, d)


def cell_logarithms(points: FloatArray, cells: IntArray) -> FloatArray:
    """Logarithms (m, d, d) of the metrics in which cells are regular with edges of length 1.

    Notes
    -----
    The sum of e e^T over the edges of a regular simplex with edges of length 1 is (k + 1) / 2 times
    the identity, since it is invariant; so M^-1 is 2 / (k + 1) times that sum.
    """
    d, k = points.shape[1], cells.shape[1] - 1
    values, axes = eigenvalues((2.0 / (k + 1)) * edge_products(points, cells))
    if k < d:
        order = np.argsort(values, axis=1, kind="stable")
        values = np.take_along_axis(values, order, axis=1)
        axes = np.take_along_axis(axes, order[:, None, :], axis=2)
        values[:, 0] = values[:, 1]
    values = np.maximum(values, ROUNDED * values.max(axis=1, keepdims=True))
    flat = values[:, -1] <= 0.0
    values[flat] = 1.0
    return of_eigenvalues(-log(values), axes)
