"""Forms of the ODT energy that the paper proves equal, and its lower bounds.

Densities as in :mod:`odt_plugins.engine.odt.energy`; the functions ending in ``_p1`` take one value
a vertex, (n,), and integrate the piecewise linear density exactly.
"""

from __future__ import annotations

from itertools import combinations
from math import factorial, sqrt

import numpy as np

from odt_plugins.engine.cells.geometry import signed_volumes
from odt_plugins.engine.odt.energy import CellDensity
from odt_plugins.engine.topology.star import star_sum
from odt_plugins.mesh.arrays import FloatArray, IntArray


def _squared_norm_integrals(points: FloatArray, cells: IntArray) -> FloatArray:
    """Integral of ||x||^2 over every cell, exact, shape (m,)."""
    d = cells.shape[1] - 1
    x = points[cells]
    moment = (x.sum(axis=1) ** 2).sum(axis=1) + (x**2).sum(axis=(1, 2))
    integrals: FloatArray = signed_volumes(points, cells) * moment / ((d + 1) * (d + 2))
    return integrals


def energy_by_stars(points: FloatArray, cells: IntArray, rho: CellDensity = 1.0) -> float:
    """ODT energy by Lemma 4.1 (4.2); with rho by (4.9), density constant on cells.

    Notes
    -----
    (1 / (d + 1)) sum_i ||x_i||^2 |omega_i| - int ||x||^2. The origin is put at the mean of the
    points, which changes nothing but the rounding.
    """
    d = cells.shape[1] - 1
    x = points - points.mean(axis=0)
    stars = star_sum(rho * signed_volumes(x, cells), cells, len(x))
    nodal = ((x**2).sum(axis=1) * stars).sum() / (d + 1)
    return float(nodal - np.sum(rho * _squared_norm_integrals(x, cells)))


def energy_by_patches(points: FloatArray, cells: IntArray, rho: CellDensity = 1.0) -> float:
    """ODT energy by Lemma 4.5 (4.14); with rho the energy E~ of (4.15).

    Notes
    -----
    (1 / (d + 3)) sum_i int_{omega_i} ||x - x_i||^2 rho. The printed factor is 1 / (d + 1): its
    proof leaves out that int lambda_i^2 is twice int lambda_i lambda_j. With 1 / (d + 3) the
    lemma holds, and E~ = E for rho constant on cells.
    """
    d = cells.shape[1] - 1
    volumes = rho * signed_volumes(points, cells)
    x = points[cells]
    total = 0.0
    for i in range(d + 1):
        y = x - x[:, i : i + 1]
        moment = (y.sum(axis=1) ** 2).sum(axis=1) + (y**2).sum(axis=(1, 2))
        total += float(np.sum(volumes * moment)) / ((d + 1) * (d + 2))
    return float(total / (d + 3))


def hat_weighted_volumes(points: FloatArray, cells: IntArray, vertex_rho: FloatArray) -> FloatArray:
    """Integral of rho_I times the hat function of every corner over every cell.

    Parameters
    ----------
    points : (n, d) float64
    cells : (m, d + 1) int32
    vertex_rho : (n,) float64    values of the piecewise linear density rho_I

    Returns
    -------
    (m, d + 1) float64           |tau|_{rho phi_i} = |tau| (rho_i + sum_k rho_k) / ((d + 1)(d + 2))

    Notes
    -----
    The quadrature below (4.11). In the plane it is |tau| / 12 (2 rho_i + rho_j + rho_k), which
    gives |tau| / 3 for rho = 1; the printed factor 1/6 is twice that.
    """
    d = cells.shape[1] - 1
    rho = vertex_rho[cells]
    volumes = signed_volumes(points, cells) / ((d + 1) * (d + 2))
    weighted: FloatArray = volumes[:, None] * (rho + rho.sum(axis=1, keepdims=True))
    return weighted


def energy_p1(points: FloatArray, cells: IntArray, vertex_rho: FloatArray) -> float:
    """ODT energy (4.9) of a piecewise linear density, integrated exactly.

    Notes
    -----
    int_tau lambda_i lambda_j rho_I = |tau| d!/(d + 3)! (rho_i + rho_j + sum_k rho_k).
    """
    d = cells.shape[1] - 1
    rho = vertex_rho[cells]
    total = rho.sum(axis=1)
    weighted = np.zeros(len(cells))
    for i, j in combinations(range(d + 1), 2):
        t = ((points[cells[:, i]] - points[cells[:, j]]) ** 2).sum(axis=1)
        weighted += t * (total + rho[:, i] + rho[:, j])
    scale = factorial(d) / factorial(d + 3)
    return float(scale * np.sum(signed_volumes(points, cells) * weighted))


def energy_tilde_p1(points: FloatArray, cells: IntArray, vertex_rho: FloatArray) -> float:
    """Energy E~ (4.15) of a piecewise linear density, integrated exactly.

    The factor is 1 / (d + 3) as in :func:`energy_by_patches`.

    Notes
    -----
    With y_a = x_a - x_i, int_tau ||sum_a lambda_a y_a||^2 rho_I
    = |tau| d!/(d + 3)! sum_{a,b} (y_a . y_b) (1 + [a = b]) (rho_a + rho_b + sum_k rho_k).
    """
    d = cells.shape[1] - 1
    rho = vertex_rho[cells]
    weight = rho.sum(axis=1)[:, None, None] + rho[:, :, None] + rho[:, None, :]
    weight = weight * (1.0 + np.eye(d + 1))
    volumes = signed_volumes(points, cells)
    x = points[cells]
    total = 0.0
    for i in range(d + 1):
        y = x - x[:, i : i + 1]
        products = (y[:, :, None] * y[:, None]).sum(axis=3)
        total += float((volumes * (products * weight).sum(axis=(1, 2))).sum())
    return float(total * factorial(d) / factorial(d + 3) / (d + 3))


def energy_constant(d: int) -> float:
    """C_d of Theorem 2.8: E(tau) = C_d |tau|^(1 + 2/d) for an equilateral simplex."""
    unit = sqrt(d + 1.0) / (factorial(d) * sqrt(2.0**d))
    return d / (2.0 * (d + 2)) * float(unit ** (-2.0 / d))


def lower_bounds(
    points: FloatArray, cells: IntArray, rho: CellDensity = 1.0
) -> tuple[float, float]:
    """Lower bounds of the energy: Theorem 2.8 (2.7), with rho (2.8) and (2.9).

    Parameters
    ----------
    points : (n, d) float64
    cells : (m, d + 1) int32
    rho : float or (m,) float64    density, constant on cells

    Returns
    -------
    shape : float      C_d sum |tau|_{rho^r}^(1 + 2/d), r = d/(d + 2); E if all cells equilateral
    size : float       C_d m^(-2/d) ||rho||_{L^r}; the same if |tau| rho^r is equal on all cells
    """
    d = cells.shape[1] - 1
    weighted = signed_volumes(points, cells) * np.asarray(rho) ** (d / (d + 2))
    constant = energy_constant(d)
    shape = constant * float(np.sum(weighted ** (1 + 2 / d)))
    size = constant * len(cells) ** (-2 / d) * float(np.sum(weighted)) ** ((d + 2) / d)
    return shape, size
