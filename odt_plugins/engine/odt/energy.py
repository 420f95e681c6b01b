"""The ODT energy E = int |u_I - u| rho, u = ||x||^2, (1.1).

Cells have positive volume, so u_I >= u and the modulus falls away. Densities are one number or
one value a cell, (m,), where rho is constant on cells.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.geometry import signed_volumes, squared_edge_sum
from odt_plugins.mesh.arrays import FloatArray, IntArray

CellDensity = float | FloatArray


def cell_energies(points: FloatArray, cells: IntArray) -> FloatArray:
    """Interpolation error of every cell, Lemma 2.7 (2.2), shape (m,).

    Notes
    -----
    |tau| / ((d + 1)(d + 2)) sum_{i<j} t_ij with t_ij the squared edge lengths.
    """
    d = cells.shape[1] - 1
    scale = 1.0 / ((d + 1) * (d + 2))
    return scale * signed_volumes(points, cells) * squared_edge_sum(points, cells)


def energy(points: FloatArray, cells: IntArray, rho: CellDensity = 1.0) -> float:
    """ODT energy by Lemma 2.7 (2.2), density constant on cells.

    Parameters
    ----------
    points : (n, d) float64
    cells : (m, d + 1) int32
    rho : float or (m,) float64    density

    Returns
    -------
    float                          E(T) [length unit to the power d + 2, times rho]

    References
    ----------
    CMAME 200 (2011) 967-984, (1.1), (2.2).
    """
    return float(np.sum(rho * cell_energies(points, cells)))
