"""Sparse Cholesky factorisation, that of Eigen through libigl.

The factorisations of scipy go through BLAS, whose sums have another order on every kind of
processor and for every number of threads. Eigen's has loops of its own, and is as fast on the
systems that are solved for directly here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from odt_plugins.mesh.arrays import FloatArray


def factorize(matrix: Any) -> Callable[[FloatArray], FloatArray]:
    """Factorise a symmetric positive definite (v, v) scipy matrix.

    Returns
    -------
    callable           (v, c) right-hand sides -> (v, c) solutions, every column on its own

    Raises
    ------
    RuntimeError       the matrix is not positive definite
    """
    import igl
    from scipy.sparse import csc_matrix

    none = np.empty(0, dtype=np.int64)
    factors = igl.min_quad_with_fixed_data()
    igl.min_quad_with_fixed_precompute(
        csc_matrix(matrix), none, csc_matrix((0, matrix.shape[0])), True, factors
    )

    def solve(right: FloatArray) -> FloatArray:
        # libigl minimises x A x / 2 + x B.
        absent = np.empty((0, right.shape[1]))
        return igl.min_quad_with_fixed_solve(factors, -right, absent, absent)

    return solve


def solve_direct(matrix: Any, right: FloatArray) -> FloatArray:
    """Solve A X = B, one factorisation for all columns of B, shape (v, c)."""
    return factorize(matrix)(right)
