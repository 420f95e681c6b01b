"""Eigenvalues and logarithms of small symmetric matrices, the same bits on every processor."""

from __future__ import annotations

import math
from itertools import combinations, combinations_with_replacement

import numpy as np

from odt_plugins.mesh.arrays import FloatArray

SWEEPS = {2: 1, 3: 5}
"""Rounds of rotations after which matrices are diagonal to the last bits, by dimension."""
TERMS = 12
"""Terms of the series of the logarithm between 1 / sqrt(2) and sqrt(2)."""
AT_ONCE = 2048
"""Matrices whose exponentials are worked out together, as many as stay in the cache."""


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
    With A = 2^k (m I + D) and tr D = 0, Cayley and Hamilton's D^3 = j D + l I, j = tr(D^2) / 2 and
    l = tr(D^3) / 3, makes of exp(D) and its squares x I + y D + z D^2. One k serves all, so the
    error is about 2^k roundings of the largest eigenvalue's exponential.
    """
    d = matrices.shape[1]
    size = float(np.abs(matrices).sum(axis=2).max(initial=0.0))
    halvings = max(0, math.frexp(size)[1] + 2)
    result = np.empty(matrices.shape)
    for first in range(0, len(matrices), AT_ONCE):
        part = 0.5**halvings * np.ascontiguousarray(
            matrices[first : first + AT_ONCE].transpose(1, 2, 0))
        none = np.zeros(part.shape[2])
        mean = sum((part[i, i] for i in range(d)), none) / d
        small = _whole({(i, j): part[i, j] - mean * (i == j) for i, j in _upper(d)})
        square = _whole({
            (i, j): sum((small[i, k] * small[k, j] for k in range(d)), none)
            for i, j in _upper(d)})
        two = 0.5 * sum((square[i, i] for i in range(d)), none)
        three = sum((square[pair] * small[pair] for pair in small), none) / 3.0
        w = x = none + 1.0 / math.factorial(TERMS)
        y = z = none
        for k in range(TERMS - 1, -1, -1):
            w, x, y, z = (w * mean + 1.0 / math.factorial(k), z * three + 1.0 / math.factorial(k),
                          x + z * two, y)
        for _ in range(halvings):
            twice, own = 2.0 * z * y, z * z
            w, x, y, z = (w * w, x * x + twice * three, 2.0 * x * y + twice * two + own * three,
                          y * y + 2.0 * x * z + own * two)
        x, y, z = w * x, w * y, w * z
        for i, j in small:
            result[first : first + AT_ONCE, i, j] = (
                y * small[i, j] + z * square[i, j] + x * (i == j))
    return result


def _upper(d: int) -> list[tuple[int, int]]:
    """Rows and columns of an upper triangle, row by row."""
    return list(combinations_with_replacement(range(d), 2))


def _whole(upper: dict[tuple[int, int], FloatArray]) -> dict[tuple[int, int], FloatArray]:
    """All entries of symmetric matrices."""
    return upper | {(j, i): entry for (i, j), entry in upper.items()}
