"""Algebraic multigrid for the systems of the global step: smoothed aggregation on pyamg's parts.

The graph Laplacian annihilates constants, so one constant a level is all the near-nullspace there
is: aggregates need no candidates and no block matrices. Nothing here draws random numbers.
"""

from __future__ import annotations

import importlib
import warnings
from typing import Any

import numpy as np

from odt_plugins.errors import NotConvergedWarning
from odt_plugins.mesh import FloatArray, IntArray

STEP_TOLERANCE = 1e-2
"""Relative residual of the system of a step. A is not the Hessian, a step takes away a factor of
about five of the error; with residuals of 1e-2 and 1e-12 the energies agree to three digits."""

ITERATIONS = 100

STRENGTH = 0.04
"""a_ij counts as a connection when |a_ij| is above this part of sqrt(a_ii a_jj). A row has 7
entries in the plane and 15 in space: lower values follow stretched cells less well, higher ones
tear rows of large stars apart and fill the coarse matrices."""

COARSEST = 500
"""Unknowns that are solved for directly."""

DAMPING = 4.0 / 3.0
"""Of the Jacobi step that smooths the prolongation, in units of 1 / (row sum of |a_ij|)."""

STALLED = 0.8
"""Coarsening ends when it leaves more than this part of the unknowns."""


def multigrid(matrix: Any) -> Any:
    """Build a hierarchy for a symmetric positive definite M-matrix.

    Parameters
    ----------
    matrix : (v, v) scipy CSR

    Returns
    -------
    pyamg.MultilevelSolver     V-cycles are symmetric: forward Gauss-Seidel before the coarse
                               correction, backward after

    References
    ----------
    P. Vanek, J. Mandel, M. Brezina, Computing 56 (1996) 179-196: smoothed aggregation.
    """
    multilevel: Any = importlib.import_module("pyamg.multilevel")
    aggregate: Any = importlib.import_module("pyamg.aggregation.aggregate")
    strength: Any = importlib.import_module("pyamg.strength")
    smoothing: Any = importlib.import_module("pyamg.relaxation.smoothing")

    levels = []
    fine = matrix.tocsr()
    while True:
        level = multilevel.MultilevelSolver.Level()
        level.A = fine
        levels.append(level)
        if fine.shape[0] <= COARSEST:
            break
        strong = strength.symmetric_strength_of_connection(fine, STRENGTH)
        tentative, _ = aggregate.standard_aggregation(strong)
        if not 0 < tentative.shape[1] < STALLED * fine.shape[0]:
            break
        level.P = smoothed_prolongation(fine, tentative)
        level.R = level.P.T.tocsr()
        fine = (level.R @ (fine @ level.P)).tocsr()
        fine.sort_indices()
    hierarchy = multilevel.MultilevelSolver(levels, coarse_solver="splu")
    smoothing.change_smoothers(
        hierarchy, ("gauss_seidel", {"sweep": "forward"}), ("gauss_seidel", {"sweep": "backward"})
    )
    return hierarchy


def smoothed_prolongation(fine: Any, tentative: Any) -> Any:
    """One damped Jacobi step on the constants of the aggregates.

    Parameters
    ----------
    fine : (v, v) scipy CSR
    tentative : (v, w) scipy CSR      1 where an unknown belongs to an aggregate

    Returns
    -------
    (v, w) scipy CSR                  (I - omega D^-1 A) T, D_i = sum_j |a_ij|: no estimate of a
                                      spectral radius, which would start from random numbers
    """
    tentative = tentative.tocsr().astype(np.float64)
    step = fine @ tentative
    weights = DAMPING / (abs(fine) @ np.ones(fine.shape[0]))
    step.data *= np.repeat(-weights, np.diff(step.indptr))
    prolongation = (tentative + step).tocsr()
    prolongation.sort_indices()
    return prolongation


def solve_columns(
    hierarchy: Any, right: FloatArray, tolerance: float, iterations: int
) -> tuple[FloatArray, IntArray]:
    """Solve for every column by conjugate gradients, one V-cycle a time as preconditioner.

    Parameters
    ----------
    hierarchy : from :func:`multigrid`
    right : (v, c) float64
    tolerance : float              relative residual of every column
    iterations : int               for every column, at most

    Returns
    -------
    solution : (v, c) float64
    counts : (c,) int32            iterations taken
    """
    solution = np.empty_like(right)
    counts = np.zeros(right.shape[1], dtype=np.int32)
    for column in range(right.shape[1]):
        residuals: list[float] = []
        b = np.ascontiguousarray(right[:, column])
        solution[:, column] = hierarchy.solve(
            b, tol=tolerance, maxiter=iterations, accel="cg", residuals=residuals
        )
        counts[column] = len(residuals) - 1
    return solution, counts


def solve_amg(
    matrix: Any,
    right: FloatArray,
    tolerance: float = STEP_TOLERANCE,
    iterations: int = ITERATIONS,
) -> FloatArray:
    """Solve A X = B with one hierarchy for all columns.

    Parameters
    ----------
    matrix : (v, v) scipy CSR      symmetric positive definite M-matrix
    right : (v, c) float64
    tolerance : float              relative residual of every column; the default is what a step of
                                   the modified Newton method (4.27) can use
    iterations : int               for every column, at most

    Returns
    -------
    (v, c) float64

    Warns
    -----
    NotConvergedWarning            a column's residual is above the tolerance at the last iteration
    """
    matrix = matrix.tocsr()
    solution, _ = solve_columns(multigrid(matrix), right, tolerance, iterations)
    norms = np.linalg.norm(right, axis=0)
    residuals = np.linalg.norm(right - matrix @ solution, axis=0)
    late = np.flatnonzero(residuals > 10.0 * tolerance * norms)
    if late.size:
        worst = float((residuals[late] / norms[late]).max())
        msg = (
            f"got a relative residual of {worst:.1e} after {iterations} "
            f"multigrid iterations, expected {tolerance:.1e}, try linear_solver='direct'"
        )
        warnings.warn(msg, NotConvergedWarning, stacklevel=2)
    return solution
