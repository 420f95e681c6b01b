"""Forms of the gradient of the ODT energy that the paper proves equal, and its condition (4.7)."""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.elementary import power
from odt_plugins.engine.cells.geometry import (
    barycenters,
    circumcenters,
    signed_volumes,
    volume_gradients,
)
from odt_plugins.engine.odt.energy import CellDensity
from odt_plugins.engine.odt.gradient import centers_gradient, corner_sums
from odt_plugins.engine.topology.star import star_average, star_sum
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.paper.energy import hat_weighted_volumes


def gradient_by_norms(points: FloatArray, cells: IntArray) -> FloatArray:
    """Gradient of E, rho = 1, by (4.3), shape (n, d).

    Notes
    -----
    1/(d + 1) [2 x_i |omega_i| + sum_tau sum_{k != i} ||x_k||^2 nabla_{x_i}|tau|]. The origin is
    put at the mean of the points; squared distances from it cancel, so (4.4) and (4.5) round less.
    """
    d = cells.shape[1] - 1
    x = points - points.mean(axis=0)
    norms = (x**2).sum(axis=1)[cells]
    others = norms.sum(axis=1, keepdims=True) - norms
    forces = corner_sums(others[:, :, None] * volume_gradients(x, cells), cells, len(x))
    stars = star_sum(signed_volumes(x, cells), cells, len(x))
    gradient: FloatArray = (2.0 * x * stars[:, None] + forces) / (d + 1)
    return gradient


def gradient_by_edges(points: FloatArray, cells: IntArray) -> FloatArray:
    """Gradient of E, rho = 1, by (4.4), shape (n, d).

    Notes
    -----
    1/(d + 1) sum_tau sum_{k != i} ||x_k - x_i||^2 nabla_{x_i}|tau|.
    """
    d = cells.shape[1] - 1
    x = points[cells]
    lengths = ((x[:, :, None] - x[:, None, :]) ** 2).sum(axis=(2, 3))
    forces = lengths[:, :, None] * volume_gradients(points, cells)
    gradient: FloatArray = corner_sums(forces, cells, len(points)) / (d + 1)
    return gradient


def gradient_p1(points: FloatArray, cells: IntArray, vertex_rho: FloatArray) -> FloatArray:
    """Gradient of E by (4.10) with the density interpolated at the vertices, shape (n, d).

    Parameters
    ----------
    points : (n, d) float64
    cells : (m, d + 1) int32
    vertex_rho : (n,) float64    rho(x_i)

    Returns
    -------
    (n, d) float64               2 sum_tau (x_i - c_tau) |tau|_{rho_I phi_i}

    Notes
    -----
    With rho fixed in space only u_I depends on x_i, and the corners' barycentric coordinates
    change by -lambda_i nabla lambda_k. With the origin at x_i,
    sum_k ||x_k - x_i||^2 nabla_{x_k}|tau| = 2 |tau| (c_tau - x_i) by (4.6), so
    2 sum_tau (x_i - c_tau) |tau|_{rho phi_i} is the gradient without the approximation of (4.10),
    and (4.11) is its one-point quadrature. Here |tau|_{rho phi_i} is the quadrature below (4.11),
    exact for rho linear on every cell.
    """
    weights = hat_weighted_volumes(points, cells, vertex_rho)
    pull = points[cells] - circumcenters(points, cells)[:, None, :]
    return corner_sums(2.0 * weights[:, :, None] * pull, cells, len(points))


def approximate_gradient(points: FloatArray, cells: IntArray, rho: CellDensity = 1.0) -> FloatArray:
    """Derivative of E~_i with respect to x_i by barycenters, (4.19) and (4.23), shape (n, d).

    Notes
    -----
    2/(d + 1) sum_tau (x_i - b_tau) rho_tau |tau|: the change of the other patches is left out.
    One-point quadrature of (4.17), Lemma 4.6, exact for rho constant on cells; 0 at every inner
    vertex of a centroidal patch triangulation, Definition 4.7.
    """
    return centers_gradient(points, cells, barycenters(points, cells), rho)


def optimality_residual(points: FloatArray, cells: IntArray, movable: BoolArray) -> float:
    """How far the mesh is from (4.7), x_i = sum |tau| c_tau / |omega_i|.

    Parameters
    ----------
    points : (n, d) float64
    cells : (m, d + 1) int32
    movable : (n,) bool            vertices of which (4.7) is asked

    Returns
    -------
    float                          largest distance to the weighted mean of the circumcenters, in
                                   mean cell sizes |tau|^(1/d) of the vertex's star; 0 at an ODT
    """
    d = cells.shape[1] - 1
    if not movable.any():
        return 0.0
    volumes = signed_volumes(points, cells)
    touched = movable[cells].any(axis=1)
    used, local = np.unique(cells[touched], return_inverse=True)
    local_cells = local.reshape(-1, d + 1).astype(np.int32)
    weights = volumes[touched]
    centers = circumcenters(points, cells[touched])
    target = star_average(centers, weights, local_cells, len(used))
    size = star_average(
        power(volumes[touched, None], 1 / d), np.ones(len(weights)), local_cells, len(used)
    )
    distance = np.linalg.norm(target - points[used], axis=1) / size[:, 0]
    return float(distance[movable[used]].max(initial=0.0))
