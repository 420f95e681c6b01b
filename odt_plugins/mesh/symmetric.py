"""Eigenvalues and logarithms of small symmetric matrices, the same bits on every processor."""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np

from odt_plugins.mesh.arrays import FloatArray

SWEEPS = {2: 1, 3: 5}
"""Rounds of rotations after which matrices are diagonal to the last bits, by dimension."""
TERMS = 12
"""Terms of the series of the logarithm between 1 / sqrt(2) and sqrt(2)."""


def eigen(matrices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues and axes by the rotations of Jacobi.

    Parameters
    ----------
    matrices : (m, d, d) float64, d = 2 or 3    symmetric

    Returns
    -------
    values : (m, d) float64                     in no order
    axes : (m, d, d) float64                    axes[:, :, k] belongs to values[:, k]
    """
    d = matrices.shape[1]
    a = np.array(np.moveaxis(matrices, 0, -1))
    axes = np.zeros_like(a)
    for i in range(d):
        axes[i, i] = 1.0
    for _ in range(SWEEPS[d]):
        for p, q in combinations(range(d), 2):
            off = a[p, q].copy()
            half = 0.5 * (a[q, q] - a[p, p])
            root = np.abs(half) + np.sqrt(half * half + off * off)
            slope = np.where(half < 0.0, -off, off) / np.where(root > 0.0, root, 1.0)
            c = 1.0 / np.sqrt(slope * slope + 1.0)
            s = slope * c
            a[p, p] -= slope * off
            a[q, q] += slope * off
            a[p, q] = a[q, p] = 0.0
            for r in set(range(d)) - {p, q}:
                first, second = c * a[r, p] - s * a[r, q], s * a[r, p] + c * a[r, q]
                a[r, p] = a[p, r] = first
                a[r, q] = a[q, r] = second
            first, second = axes[:, p].copy(), axes[:, q].copy()
            axes[:, p], axes[:, q] = c * first - s * second, s * first + c * second
    values = np.stack([a[i, i] for i in range(d)], axis=1)
    return values, np.moveaxis(axes, -1, 0)


def logarithms(values: FloatArray) -> FloatArray:
    """Natural logarithms of positive numbers of any shape, to some 1e-15 of the larger of it and 1.

    Notes
    -----
    With x = 2^e y the series is log y = 2 (s + s^3 / 3 + ...), s = (y - 1) / (y + 1).
    """
    y, e = np.frexp(values)
    low = y < math.sqrt(0.5)
    y, e = np.where(low, 2.0 * y, y), e - low
    s = (y - 1.0) / (y + 1.0)
    square = s * s
    total = np.zeros_like(s)
    for k in reversed(range(TERMS)):
        total = total * square + 1.0 / (2 * k + 1)
    return np.asarray(e * math.log(2.0) + 2.0 * s * total)


def exponentials(matrices: FloatArray) -> FloatArray:
    """Exponentials (m, d, d) of symmetric matrices: (exp(A / 2^k))^(2^k), by its Taylor series.

    Notes
    -----
    One k serves all, so the error is about 2^k roundings of the largest eigenvalue's exponential.
    """
    size = float(np.abs(matrices).sum(axis=2).max(initial=0.0))
    halvings = max(0, math.frexp(size)[1] + 2)
    small = matrices * 0.5**halvings
    identity = np.broadcast_to(np.eye(matrices.shape[1]), matrices.shape)
    out = identity.copy()
    for k in range(TERMS, 0, -1):
        out = identity + _products(small, out) / k
    for _ in range(halvings):
        out = _products(out, out)
    return out


def _products(a: FloatArray, b: FloatArray) -> FloatArray:
    product: FloatArray = (a[:, :, :, None] * b[:, None, :, :]).sum(axis=2)
    return product
