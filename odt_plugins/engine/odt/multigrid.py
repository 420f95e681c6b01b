"""Algebraic multigrid for the systems of the global step: smoothed aggregation on pyamg's parts.

The graph Laplacian annihilates constants, so one constant a level is all the near-nullspace there
is: aggregates need no candidates and no block matrices. Nothing here draws random numbers, and
the cycles run through kernels of our own: all components of the points at once, on one thread,
every sum in the order of the indices.
"""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.errors import NotConvergedWarning
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

DAMPING = 4.0 / 3.0
"""Of the Jacobi step that smooths the prolongation, in units of 1 / (row sum of |a_ij|)."""

STALLED = 0.8
"""Coarsening ends when it leaves more than this part of the unknowns."""

TOGETHER = 3
"""Columns that the kernels take at once: as many as points have components."""


class Rows(NamedTuple):
    """A sparse matrix in compressed rows, as the kernels take it."""

    indptr: IntArray
    indices: IntArray
    data: FloatArray


class Level(NamedTuple):
    """A matrix, and the way to the next coarser one."""

    matrix: Any
    prolongation: Any
    rows: Rows
    prolong: Rows
    restrict: Rows


class Hierarchy(NamedTuple):
    """Levels from fine to coarse, and the factorised coarsest matrix.

    Attributes
    ----------
    levels : list of Level     all but the coarsest
    matrix : (v, v) CSR        the finest
    coarsest : (w, w) CSR
    solve : callable           with the coarsest matrix, b -> x
    """

    levels: list[Level]
    matrix: Any
    coarsest: Any
    solve: Callable[[FloatArray], FloatArray]

    @property
    def complexity(self) -> float:
        """Entries of all matrices over those of the finest."""
        entries = sum(level.matrix.nnz for level in self.levels) + self.coarsest.nnz
        return float(entries / self.matrix.nnz)


@kernel
def _relax(rows: Rows, b: FloatArray, forward: bool, x: FloatArray) -> None:
    """One Gauss-Seidel sweep on A x = b for up to three columns."""
    indptr, indices, data = rows
    n, columns = x.shape
    for count in range(n):
        i = count if forward else n - 1 - count
        s0 = b[i, 0]
        s1 = b[i, 1] if columns > 1 else 0.0
        s2 = b[i, 2] if columns > 2 else 0.0
        diagonal = 1.0
        for t in range(indptr[i], indptr[i + 1]):
            j = indices[t]
            a = data[t]
            if j == i:
                diagonal = a
                continue
            s0 -= a * x[j, 0]
            if columns > 1:
                s1 -= a * x[j, 1]
            if columns > 2:
                s2 -= a * x[j, 2]
        x[i, 0] = s0 / diagonal
        if columns > 1:
            x[i, 1] = s1 / diagonal
        if columns > 2:
            x[i, 2] = s2 / diagonal


@kernel
def _add_product(rows: Rows, x: FloatArray, scale: float, out: FloatArray) -> None:
    """Add scale A x to out, up to three columns."""
    indptr, indices, data = rows
    n, columns = out.shape
    for i in range(n):
        s0 = s1 = s2 = 0.0
        for t in range(indptr[i], indptr[i + 1]):
            j = indices[t]
            a = data[t]
            s0 += a * x[j, 0]
            if columns > 1:
                s1 += a * x[j, 1]
            if columns > 2:
                s2 += a * x[j, 2]
        out[i, 0] += scale * s0
        if columns > 1:
            out[i, 1] += scale * s1
        if columns > 2:
            out[i, 2] += scale * s2


@kernel
def _dots(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Scalar products of the columns."""
    n, columns = a.shape
    for c in range(columns):
        out[c] = 0.0
    for i in range(n):
        for c in range(columns):
            out[c] += a[i, c] * b[i, c]


def multigrid(matrix: Any) -> Hierarchy:
    """Build a hierarchy for a symmetric positive definite M-matrix, (v, v) scipy CSR.

    References
    ----------
    P. Vanek, J. Mandel, M. Brezina, Computing 56 (1996) 179-196: smoothed aggregation.
    """
    from scipy.sparse.linalg import splu

    aggregate: Any = importlib.import_module("pyamg.aggregation.aggregate")
    strength: Any = importlib.import_module("pyamg.strength")

    matrix = matrix.tocsr()
    levels, fine = [], matrix
    while fine.shape[0] > COARSEST:
        strong = strength.symmetric_strength_of_connection(fine, STRENGTH)
        tentative, _ = aggregate.standard_aggregation(strong)
        if not 0 < tentative.shape[1] < STALLED * fine.shape[0]:
            break
        prolongation = smoothed_prolongation(fine, tentative)
        restriction = prolongation.T.tocsr()
        levels.append(
            Level(fine, prolongation, _rows(fine), _rows(prolongation), _rows(restriction))
        )
        fine = (restriction @ (fine @ prolongation)).tocsr()
        fine.sort_indices()
    return Hierarchy(levels, matrix, fine, splu(fine.tocsc()).solve)


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


def _rows(matrix: Any) -> Rows:
    return Rows(
        matrix.indptr.astype(np.int32, copy=False),
        matrix.indices.astype(np.int32, copy=False),
        matrix.data.astype(np.float64, copy=False),
    )


def v_cycle(hierarchy: Hierarchy, b: FloatArray, depth: int = 0) -> FloatArray:
    """Apply one V-cycle, a symmetric positive definite approximation of A^-1, to up to 3 columns.

    One Gauss-Seidel sweep forward, the coarse correction, one sweep backward.
    """
    if depth == len(hierarchy.levels):
        x: FloatArray = hierarchy.solve(b)
        return np.ascontiguousarray(x)
    level = hierarchy.levels[depth]
    x = np.zeros_like(b)
    _relax(level.rows, b, True, x)
    residual = b.copy()
    _add_product(level.rows, x, -1.0, residual)
    coarse = np.zeros((level.prolongation.shape[1], b.shape[1]))
    _add_product(level.restrict, residual, 1.0, coarse)
    _add_product(level.prolong, v_cycle(hierarchy, coarse, depth + 1), 1.0, x)
    _relax(level.rows, b, False, x)
    return x


def solve_columns(
    hierarchy: Hierarchy, right: FloatArray, tolerance: float, iterations: int
) -> tuple[FloatArray, IntArray]:
    """Solve for every column by conjugate gradients, one V-cycle a time as preconditioner.

    Parameters
    ----------
    hierarchy : Hierarchy          of the matrix
    right : (v, c) float64
    tolerance : float              relative residual of every column
    iterations : int               for every column, at most

    Returns
    -------
    solution : (v, c) float64
    counts : (c,) int32            iterations taken
    """
    rows = _rows(hierarchy.matrix)
    solution = np.zeros(right.shape)
    counts = np.zeros(right.shape[1], dtype=np.int32)
    for first in range(0, right.shape[1], TOGETHER):
        part = slice(first, first + TOGETHER)
        solution[:, part], counts[part] = _conjugate_gradients(
            hierarchy, rows, np.ascontiguousarray(right[:, part]), tolerance, iterations
        )
    return solution, counts


def _conjugate_gradients(
    hierarchy: Hierarchy, rows: Rows, b: FloatArray, tolerance: float, iterations: int
) -> tuple[FloatArray, IntArray]:
    columns = b.shape[1]
    x, r = np.zeros_like(b), b.copy()
    p = np.zeros_like(b)
    counts = np.zeros(columns, dtype=np.int32)
    norm, size, old, new, curvature = np.zeros((5, columns))
    _dots(b, b, norm)
    size[:] = norm
    old[:] = 1.0
    for _ in range(iterations):
        active = size > tolerance**2 * norm
        if not active.any():
            break
        counts += active
        z = v_cycle(hierarchy, r)
        _dots(r, z, new)
        p *= np.where(active, new / old, 0.0)
        p += z
        q = np.zeros_like(b)
        _add_product(rows, p, 1.0, q)
        _dots(p, q, curvature)
        alpha = np.where(active, new / np.where(curvature > 0.0, curvature, 1.0), 0.0)
        x += alpha * p
        r -= alpha * q
        old[:] = np.where(new > 0.0, new, 1.0)
        _dots(r, r, size)
    return x, counts


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

    References
    ----------
    CMAME 200 (2011) 967-984, Section 4.3: A is an M-matrix, so algebraic multigrid solves it.
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
