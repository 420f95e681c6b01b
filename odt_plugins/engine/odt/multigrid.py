"""Algebraic multigrid for the systems of the global step: smoothed aggregation with pyamg.

Strength of connection, aggregates and cycles are pyamg's. Ours are the loop that makes the levels
and the conjugate gradients. pyamg's own loop, `smoothed_aggregation_solver` with the same
parameters, takes 1.7 to 2.9 times as long for a system in all and 1.6 to 1.8 times the memory: it
keeps blocks and candidates of a near-nullspace, which is one constant here; with its default
parameters it starts from random numbers. Its conjugate gradients, as those of scipy, go through
BLAS, whose sums have another order on every kind of processor and for every number of threads.
`python tests/measure multigrid` measures both.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from odt_plugins.engine.odt.cholesky import factorize
from odt_plugins.errors import NotConvergedWarning, warn
from odt_plugins.mesh.arrays import FloatArray, IntArray

STEP_TOLERANCE = 1e-2
"""Relative residual of the system of a step. A is not the Hessian, a step takes away a factor of
about five of the error; with residuals of 1e-2 and 1e-12 the energies agree to three digits."""

ITERATIONS = 100
"""Most of CG for one solution; a handful are enough for a step."""

STRENGTH = 0.04
"""a_ij counts as a connection when |a_ij| is above this part of sqrt(a_ii a_jj). A row has 7
entries in the plane and 15 in space: lower values follow stretched cells less well, higher ones
tear rows of large stars apart and fill the coarse matrices."""

COARSEST = 500
"""Unknowns that are solved for directly."""

LATE = 10.0
"""Largest residual, in units of the tolerance, of which nothing is said."""

DAMPING = 4.0 / 3.0
"""Of the Jacobi step that smooths the prolongation, in units of 1 / (row sum of |a_ij|)."""

STALLED = 0.8
"""Coarsening ends when it leaves more than this part of the unknowns."""


def multigrid(matrix: Any) -> Any:
    """Build a hierarchy for a symmetric positive definite M-matrix, (v, v) scipy CSR.

    Returns
    -------
    pyamg.MultilevelSolver    its cycles take one Gauss-Seidel sweep forward, the coarse
                              correction, and one sweep backward: a symmetric preconditioner

    References
    ----------
    P. Vanek, J. Mandel, M. Brezina, Computing 56 (1996) 179-196: smoothed aggregation.
    """
    pyamg: Any = importlib.import_module("pyamg")

    levels = [_level(matrix.tocsr())]
    while (unknowns := levels[-1].A.shape[0]) > COARSEST:
        fine = levels[-1].A
        strong = pyamg.strength.symmetric_strength_of_connection(fine, STRENGTH)
        tentative, _ = pyamg.aggregation.standard_aggregation(strong)
        if not 0 < tentative.shape[1] < STALLED * unknowns:
            break
        prolongation = smoothed_prolongation(fine, tentative)
        restriction = prolongation.T.tocsr()
        levels[-1].P, levels[-1].R = prolongation, restriction
        coarse = (restriction @ (fine @ prolongation)).tocsr()
        coarse.sort_indices()
        levels.append(_level(coarse))
    solve = factorize(levels[-1].A)
    hierarchy = pyamg.MultilevelSolver(levels, coarse_solver=lambda _, b: solve(b[:, None])[:, 0])
    sweeps = [("gauss_seidel", {"sweep": way}) for way in ("forward", "backward")]
    pyamg.relaxation.smoothing.change_smoothers(hierarchy, *sweeps)
    return hierarchy


def _level(matrix: Any) -> Any:
    pyamg: Any = importlib.import_module("pyamg")
    level = pyamg.MultilevelSolver.Level()
    level.A = matrix
    return level


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
    hierarchy : pyamg.MultilevelSolver     of :func:`multigrid`
    right : (v, c) float64
    tolerance : float                      relative residual of every column
    iterations : int                       for every column, at most

    Returns
    -------
    solution : (v, c) float64              every column as if it were alone
    counts : (c,) int32                    iterations taken
    """
    columns = [
        _conjugate_gradients(hierarchy, np.ascontiguousarray(b), tolerance, iterations)
        for b in right.T
    ]
    counts = np.array([count for _, count in columns], dtype=np.int32)
    return np.stack([x for x, _ in columns], axis=1), counts


def _conjugate_gradients(
    hierarchy: Any, b: FloatArray, tolerance: float, iterations: int
) -> tuple[FloatArray, int]:
    """Solution for one column, and the iterations taken."""
    matrix, cycle = hierarchy.levels[0].A, hierarchy.aspreconditioner()
    x, r, p = np.zeros_like(b), b.copy(), np.zeros_like(b)
    target = tolerance**2 * _product(b, b)
    old = 1.0
    for count in range(iterations):
        if not _product(r, r) > target:
            return x, count
        z = cycle @ r
        new = _product(r, z)
        p *= new / old
        p += z
        q = matrix @ p
        curvature = _product(p, q)
        if not curvature > 0.0:
            return x, count
        alpha = new / curvature
        x += alpha * p
        r -= alpha * q
        old = new
    return x, iterations


def _product(a: FloatArray, b: FloatArray) -> float:
    """Scalar product that does not go through BLAS."""
    return float(np.sum(a * b))


def solve_amg(
    matrix: Any,
    right: FloatArray,
    tolerance: float = STEP_TOLERANCE,
    iterations: int = ITERATIONS,
) -> FloatArray:
    """Solve A X = B for X (v, c), with one hierarchy for all columns.

    Parameters
    ----------
    matrix : (v, v) scipy CSR      symmetric positive definite M-matrix
    right : (v, c) float64
    tolerance : float              relative residual of every column; the default is what a step of
                                   the modified Newton method (4.27) can use
    iterations : int               for every column, at most

    Warns
    -----
    NotConvergedWarning            a column's residual is above LATE times the tolerance after the
                                   last iteration

    References
    ----------
    CMAME 200 (2011) 967-984, Section 4.3: A is an M-matrix, so algebraic multigrid solves it.
    """
    matrix = matrix.tocsr()
    solution, _ = solve_columns(multigrid(matrix), right, tolerance, iterations)
    norms = np.linalg.norm(right, axis=0)
    residuals = np.linalg.norm(right - matrix @ solution, axis=0)
    late = np.flatnonzero(residuals > LATE * tolerance * norms)
    if late.size:
        worst = float((residuals[late] / norms[late]).max())
        msg = (
            f"got a relative residual of {worst:.1e} after {iterations} "
            f"multigrid iterations, expected at most {LATE * tolerance:.1e}, "
            "try smoothing={'linear_solver': 'direct'}"
        )
        warn(msg, NotConvergedWarning)
    return solution
