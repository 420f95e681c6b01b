"""Symmetric positive definite tensors of two and three dimensions: metrics M, of lengths
sqrt(e^T M e). The same bits on every processor.

Packed tensors (n, d (d + 1) / 2) have the order of MEDIT's .sol: m11 m12 m22 in the plane, and
m11 m12 m22 m13 m23 m33 in space, the lower triangle row by row.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.elementary import exp, log
from odt_plugins.mesh.arrays import FloatArray
from odt_plugins.mesh.symmetric import eigen

ROUNDED = 1e-16
"""Part of the largest eigenvalue below which one is rounding error."""

PACKED = {3: 2, 6: 3}
"""Dimension d of the tensors that have so many numbers, d (d + 1) / 2, when packed."""


def full(packed: FloatArray) -> FloatArray:
    """Tensors (..., d, d) of packed ones (..., d (d + 1) / 2), m11 m12 m22 m13 m23 m33."""
    d = PACKED[packed.shape[-1]]
    out = np.empty((*packed.shape[:-1], d, d))
    for k, (i, j) in enumerate(_places(d)):
        out[..., i, j] = out[..., j, i] = packed[..., k]
    return out


def packed(tensors: FloatArray) -> FloatArray:
    """Packed tensors (..., d (d + 1) / 2), m11 m12 m22 m13 m23 m33, of full ones (..., d, d)."""
    return np.stack([tensors[..., i, j] for i, j in _places(tensors.shape[-1])], axis=-1)


def _places(d: int) -> list[tuple[int, int]]:
    return [(i, j) for i in range(d) for j in range(i + 1)]


def product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Matrix products (..., i, j) of (..., i, k) and (..., k, j)."""
    out = a[..., :, 0, None] * b[..., None, 0, :]
    for k in range(1, a.shape[-1]):
        out = out + a[..., :, k, None] * b[..., None, k, :]
    return out


def transposed(a: FloatArray) -> FloatArray:
    """Matrices (..., j, i) of (..., i, j)."""
    return np.swapaxes(a, -1, -2)


def determinants(tensors: FloatArray) -> FloatArray:
    """Determinants (...) of positive definite tensors (..., d, d), to rounding of each."""
    factor = cholesky(tensors)
    root = factor[..., 0, 0]
    for i in range(1, tensors.shape[-1]):
        root = root * factor[..., i, i]
    return np.asarray(root * root)


def eigenvalues(tensors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues and axes of symmetric tensors of any magnitude.

    Parameters
    ----------
    tensors : (..., d, d)     d = 2 or 3

    Returns
    -------
    values : (..., d)         in no order; errors are some 1e-16 of the largest
    axes : (..., d, d)        axes[..., :, k] of length 1 belongs to values[..., k]
    """
    d = tensors.shape[-1]
    flat = np.asarray(tensors, dtype=np.float64).reshape(-1, d, d)
    _, exponent = np.frexp(np.abs(flat).max(axis=(1, 2), initial=0.0))
    values, axes = eigen(np.ldexp(flat, -exponent[:, None, None]))
    values = np.ldexp(values, exponent[:, None])
    return values.reshape(tensors.shape[:-1]), axes.reshape(tensors.shape)


def of_eigenvalues(values: FloatArray, axes: FloatArray) -> FloatArray:
    """The symmetric tensors (..., d, d) that have these eigenvalues and axes."""
    return product(axes * values[..., None, :], transposed(axes))


def positive_eigenvalues(tensors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues of positive definite tensors, lifted where rounding made them less, and axes."""
    values, axes = eigenvalues(tensors)
    return np.maximum(values, ROUNDED * values.max(axis=-1, keepdims=True)), axes


def logarithm(tensors: FloatArray) -> FloatArray:
    """Logarithms (..., d, d) of positive definite tensors."""
    values, axes = positive_eigenvalues(tensors)
    return of_eigenvalues(log(values), axes)


def exponential(tensors: FloatArray) -> FloatArray:
    """Exponentials (..., d, d), which are positive definite, of symmetric tensors."""
    values, axes = eigenvalues(tensors)
    return of_eigenvalues(exp(values), axes)


def mean(tensors: FloatArray, weights: FloatArray | None = None) -> FloatArray:
    """Log-Euclidean means (n, d, d): the exponential of the mean of the logarithms.

    Parameters
    ----------
    tensors : (n, k, d, d)    positive definite
    weights : (n, k)          at least 0, with a positive sum each; all alike by default

    References
    ----------
    V. Arsigny, P. Fillard, X. Pennec, N. Ayache, Geometric means in a novel vector space structure
    on symmetric positive-definite matrices, SIAM J. Matrix Anal. Appl. 29 (2007) 328-347.
    """
    n, k = tensors.shape[:2]
    weights = np.ones((n, k)) if weights is None else weights
    logs = logarithm(tensors)
    total, whole = np.zeros((n, *tensors.shape[2:])), np.zeros(n)
    for i in range(k):
        total += weights[:, i, None, None] * logs[:, i]
        whole += weights[:, i]
    return exponential(total / whole[:, None, None])


def cholesky(tensors: FloatArray) -> FloatArray:
    """Lower triangular factors L (..., d, d), M = L L^T: edges e are seen as L^T e.

    Notes
    -----
    A pivot that rounding made negative is taken as ROUNDED of its diagonal entry.
    """
    d = tensors.shape[-1]
    out = np.zeros(tensors.shape)
    for j in range(d):
        for i in range(j, d):
            rest = np.array(tensors[..., i, j])
            for k in range(j):
                rest -= out[..., i, k] * out[..., j, k]
            if i == j:
                out[..., j, j] = np.sqrt(np.maximum(rest, ROUNDED * tensors[..., j, j]))
            else:
                out[..., i, j] = rest / out[..., j, j]
    return out


def inverse_factor(factor: FloatArray) -> FloatArray:
    """Inverses (..., d, d) of lower triangular matrices."""
    d = factor.shape[-1]
    out = np.zeros(factor.shape)
    for j in range(d):
        out[..., j, j] = 1.0 / factor[..., j, j]
        for i in range(j + 1, d):
            rest = factor[..., i, j] * out[..., j, j]
            for k in range(j + 1, i):
                rest = rest + factor[..., i, k] * out[..., k, j]
            out[..., i, j] = -rest / factor[..., i, i]
    return out


def reduced(first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
    """One basis in which two positive definite tensors are diagonal.

    Parameters
    ----------
    first, second : (..., d, d)

    Returns
    -------
    basis : (..., d, d)    B with first + second = B B^T and first = B diag(share) B^T
    share : (..., d)       from 0 to 1; second = B diag(1 - share) B^T

    Notes
    -----
    With the sum in the place of either tensor no ratio of the two makes the reduction inexact.
    """
    factor = cholesky(first + second)
    inverse = inverse_factor(factor)
    inside = product(product(inverse, first), transposed(inverse))
    share, turn = eigenvalues(0.5 * (inside + transposed(inside)))
    return product(factor, turn), np.minimum(np.maximum(share, 0.0), 1.0)


def intersection(first: FloatArray, second: FloatArray) -> FloatArray:
    """The tensors (..., d, d) of the largest ellipsoid inside both unit balls, in their basis.

    Of two sizes it is the smaller one: lengths are at least those of both metrics.

    References
    ----------
    F. Alauzet, Size gradation control of anisotropic meshes, Finite Elem. Anal. Des. 46 (2010)
    181-202: simultaneous reduction.
    """
    basis, share = reduced(first, second)
    return of_eigenvalues(np.maximum(share, 1.0 - share), basis)


def squared_lengths(edges: FloatArray, tensors: FloatArray) -> FloatArray:
    """Squared lengths e^T M e (...) of edges (..., d) in metrics (..., d, d)."""
    d = edges.shape[-1]
    total = np.zeros(np.broadcast_shapes(edges.shape[:-1], tensors.shape[:-2]))
    for i in range(d):
        for j in range(d):
            total += edges[..., i] * edges[..., j] * tensors[..., i, j]
    return total
