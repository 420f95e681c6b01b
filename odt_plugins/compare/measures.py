"""Further measures of cells, by which nobody here optimises: scaled Jacobian and mean ratio.

Source: P. M. Knupp, Algebraic mesh quality metrics, SIAM J. Sci. Comput. 23 (2001) 193-218;
A. Liu, B. Joe, Relationship between tetrahedron shape measures, BIT 34 (1994) 268-287.
"""

from __future__ import annotations

from itertools import combinations
from math import sqrt

import numpy as np

from odt_plugins.figures import volumes
from odt_plugins.mesh.arrays import FloatArray, IntArray


def scaled_jacobian(points: FloatArray, cells: IntArray) -> FloatArray:
    """Least of d! |tau| by the product of the lengths of the edges at a corner, scaled; (m,).

    1 for the regular simplex, 0 for a flat one, negative for an inverted one; of triangles in
    space never negative.
    """
    k = cells.shape[1]
    x = points[cells]
    products = np.ones((k, len(cells)))
    for a, b in combinations(range(k), 2):
        length = np.sqrt(((x[:, a] - x[:, b]) ** 2).sum(axis=1))
        products[a] *= length
        products[b] *= length
    jacobian = (2.0 if k == 3 else 6.0) * volumes(points, cells)
    regular = 2.0 / sqrt(3.0) if k == 3 else sqrt(2.0)
    largest = products.max(axis=0)
    out = np.zeros(len(cells))
    np.divide(regular * jacobian, largest, out=out, where=largest > 0.0)
    return out


def mean_ratio(points: FloatArray, cells: IntArray) -> FloatArray:
    """4 sqrt(3) |tau| / sum l^2 of triangles, 12 (3 |tau|)^(2/3) / sum l^2 of tetrahedra, (m,).

    1 for the regular simplex, 0 for a flat one, negative for an inverted one.
    """
    k = cells.shape[1]
    x = points[cells]
    squares = sum(((x[:, a] - x[:, b]) ** 2).sum(axis=1) for a, b in combinations(range(k), 2))
    volume = volumes(points, cells)
    over = 4.0 * sqrt(3.0) * volume
    if k == 4:
        over = np.sign(volume) * 12.0 * np.cbrt(9.0 * volume * volume)
    out = np.zeros(len(cells))
    np.divide(over, squares, out=out, where=np.asarray(squares) > 0.0)
    return out


FURTHER = tuple(f"{part}_{name}" for name in ("scaled_jacobian", "mean_ratio")
                for part in ("min", "mean"))
"""Names of what :func:`further` gives."""


def further(points: FloatArray, cells: IntArray) -> dict[str, float]:
    """Least and mean value of both, by their names in the tables."""
    out: dict[str, float] = {}
    for name, measure in (("scaled_jacobian", scaled_jacobian), ("mean_ratio", mean_ratio)):
        values = measure(points, cells)
        out |= {f"min_{name}": float(values.min()), f"mean_{name}": float(values.mean())}
    return out
