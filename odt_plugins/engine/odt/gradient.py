"""Gradients of the ODT energy, Lemmas 4.2 to 4.6, and the diagonal of its Hessian.

Every function returns values at all vertices; the formulas are derivatives at interior vertices,
whose star does not change its shape when the vertex moves.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.geometry import (
    circumcenters,
    signed_volumes,
    squared_edge_sum,
    volume_gradients,
)
from odt_plugins.engine.odt.energy import CellDensity
from odt_plugins.engine.topology.star import star_sum
from odt_plugins.mesh.arrays import FloatArray, IntArray


def corner_sums(corner_values: FloatArray, cells: IntArray, n_points: int) -> FloatArray:
    """Sum (m, d + 1, c) corner values into their vertices, (n, c)."""
    corners = cells.ravel()
    flat = corner_values.reshape(corners.size, -1)
    columns = [np.bincount(corners, flat[:, c], minlength=n_points) for c in range(flat.shape[1])]
    return np.stack(columns, axis=1)


def centers_gradient(
    points: FloatArray, cells: IntArray, centers: FloatArray, rho: CellDensity = 1.0
) -> FloatArray:
    """Pull (n, d) of the cells' centres: 2/(d + 1) sum_tau (x_i - c_tau) rho_tau |tau|.

    Parameters
    ----------
    points : (n, d) float64
    cells : (m, d + 1) int32
    centers : (m, d) float64       circumcenters for (4.5) and (4.11), barycenters for (4.19)
    rho : float or (m,) float64    density, constant on cells
    """
    d = cells.shape[1] - 1
    weights = rho * signed_volumes(points, cells)
    pull = weights[:, None, None] * (points[cells] - centers[:, None, :])
    return corner_sums(pull, cells, len(points)) * (2.0 / (d + 1))


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
    return corner_sums(weights[:, None, None] * forces, cells, len(points))


def hessian_diagonal(points: FloatArray, cells: IntArray, rho: CellDensity = 1.0) -> FloatArray:
    """Second derivative of E in every direction at every vertex, Lemma 4.3 (4.8), shape (n,).

    Notes
    -----
    2/(d + 1) |omega_i|, with a density frozen on cells 2/(d + 1) |omega_i|_rho.
    """
    d = cells.shape[1] - 1
    stars = star_sum(rho * signed_volumes(points, cells), cells, len(points))
    return stars * (2.0 / (d + 1))
