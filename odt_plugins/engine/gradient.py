"""Gradients of the ODT energy, Lemmas 4.2 to 4.6, and the diagonal of its Hessian.

Every function returns values at all vertices; the formulas are derivatives at interior vertices,
whose star does not change its shape when the vertex moves.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.energy import CellDensity, hat_weighted_volumes
from odt_plugins.engine.geometry import (
    barycenters,
    circumcenters,
    signed_volumes,
    squared_edge_sum,
    volume_gradients,
)
from odt_plugins.engine.star import star_average, star_sum
from odt_plugins.mesh import BoolArray, FloatArray, IntArray


def _scatter(corner_values: FloatArray, cells: IntArray, n_points: int) -> FloatArray:
    """Sum (m, d + 1, c) corner values into their vertices, (n, c)."""
    corners = cells.ravel()
    flat = corner_values.reshape(corners.size, -1)
    columns = [
        np.bincount(corners, flat[:, c], minlength=n_points) for c in range(flat.shape[1])
    ]
    return np.stack(columns, axis=1)


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
    forces = _scatter(others[:, :, None] * volume_gradients(x, cells), cells, len(x))
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
    gradient: FloatArray = _scatter(forces, cells, len(points)) / (d + 1)
    return gradient


def centers_gradient(
    points: FloatArray, cells: IntArray, centers: FloatArray, rho: CellDensity = 1.0
) -> FloatArray:
    """Pull of the cells' centres: 2/(d + 1) sum_tau (x_i - c_tau) rho_tau |tau|.

    Parameters
    ----------
    points : (n, d) float64
    cells : (m, d + 1) int32
    centers : (m, d) float64       circumcenters for (4.5) and (4.11), barycenters for (4.19)
    rho : float or (m,) float64    density, constant on cells

    Returns
    -------
    (n, d) float64
    """
    d = cells.shape[1] - 1
    weights = rho * signed_volumes(points, cells)
    pull = weights[:, None, None] * (points[cells] - centers[:, None, :])
    gradient: FloatArray = _scatter(pull, cells, len(points)) * (2.0 / (d + 1))
    return gradient


def gradient(points: FloatArray, cells: IntArray, rho: CellDensity = 1.0) -> FloatArray:
    """Gradient of E by circumcenters: (4.5), and (4.11) with a density.

    Parameters
    ----------
    points : (n, d) float64
    cells : (m, d + 1) int32
    rho : float or (m,) float64    density, constant on cells and frozen as the vertices move

    Returns
    -------
    (n, d) float64                 2/(d + 1) sum_tau (x_i - c_tau) rho_tau |tau|

    Notes
    -----
    (4.11) prints 2/(d + 2); its own quadrature |tau|_{rho phi_i} = rho_tau |tau| / (d + 1) gives
    2/(d + 1), as in (4.5).

    References
    ----------
    CMAME 200 (2011) 967-984, Lemma 4.2 (4.5), Lemma 4.4 (4.11).
    """
    return centers_gradient(points, cells, circumcenters(points, cells), rho)


def energy_gradient(points: FloatArray, cells: IntArray, rho: CellDensity = 1.0) -> FloatArray:
    """Exact derivative of (2.2) with rho_tau fixed to the cells, at every vertex, shape (n, d).

    Notes
    -----
    rho_tau / ((d + 1)(d + 2)) [nabla_{x_i}|tau| sum t + 2 |tau| sum_k (x_i - x_k)]. At interior
    vertices and rho = 1 it equals (4.3)-(4.5). With a density it differs from (4.11), where rho is
    fixed in space; folded cells are allowed.
    """
    d = cells.shape[1] - 1
    x = points[cells]
    pull = 2.0 * ((d + 1) * x - x.sum(axis=1, keepdims=True))
    forces = (
        squared_edge_sum(points, cells)[:, None, None] * volume_gradients(points, cells)
        + signed_volumes(points, cells)[:, None, None] * pull
    )
    weights = np.broadcast_to(np.asarray(rho) / ((d + 1) * (d + 2)), (len(cells),))
    return _scatter(weights[:, None, None] * forces, cells, len(points))


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
    return _scatter(2.0 * weights[:, :, None] * pull, cells, len(points))


def approximate_gradient(
    points: FloatArray, cells: IntArray, rho: CellDensity = 1.0
) -> FloatArray:
    """Derivative of E~_i with respect to x_i by barycenters, (4.19) and (4.23), shape (n, d).

    Notes
    -----
    2/(d + 1) sum_tau (x_i - b_tau) rho_tau |tau|: the change of the other patches is left out.
    One-point quadrature of (4.17), Lemma 4.6, exact for rho constant on cells; 0 at every inner
    vertex of a centroidal patch triangulation, Definition 4.7.
    """
    return centers_gradient(points, cells, barycenters(points, cells), rho)


def hessian_diagonal(points: FloatArray, cells: IntArray, rho: CellDensity = 1.0) -> FloatArray:
    """Second derivative of E in every direction at every vertex, Lemma 4.3 (4.8), shape (n,).

    Notes
    -----
    2/(d + 1) |omega_i|, with a density frozen on cells 2/(d + 1) |omega_i|_rho.
    """
    d = cells.shape[1] - 1
    stars = star_sum(rho * signed_volumes(points, cells), cells, len(points))
    diagonal: FloatArray = stars * (2.0 / (d + 1))
    return diagonal


def optimality_residual(
    points: FloatArray, cells: IntArray, movable: BoolArray, rho: CellDensity = 1.0
) -> float:
    """How far the mesh is from (4.7), x_i = sum |tau| c_tau / |omega_i|.

    Parameters
    ----------
    points : (n, d) float64
    cells : (m, d + 1) int32
    movable : (n,) bool            vertices of which (4.7) is asked
    rho : float or (m,) float64    density, constant on cells

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
    weights = (rho * volumes)[touched]
    centers = circumcenters(points, cells[touched])
    target = star_average(centers, weights, local_cells, len(used))
    size = star_average(
        volumes[touched, None] ** (1 / d), np.ones(len(weights)), local_cells, len(used)
    )
    distance = np.linalg.norm(target - points[used], axis=1) / size[:, 0]
    return float(distance[movable[used]].max(initial=0.0))
