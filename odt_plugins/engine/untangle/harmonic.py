"""Places of free vertices in the middle of their neighbours: where untangling may start from.

With the boundary of a convex polygon these are valid (Tutte); for other boundaries and in space
few cells are inverted there, wherever the vertices were before.

References
----------
W. T. Tutte, How to draw a graph, Proc. London Math. Soc. 13 (1963) 743-767.
M. R. Hestenes, E. Stiefel, Methods of conjugate gradients for solving linear systems, J. Res. NBS
49 (1952) 409-436.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from odt_plugins.mesh.arrays import FloatArray, IntArray, LongArray

TOLERANCE = 1e-4
"""Residual of the mean place, relative to that of the start."""

ROUNDS = 500
"""Most steps of conjugate gradients."""


def harmonic(values: FloatArray, cells: IntArray, free: LongArray) -> FloatArray:
    """Values (k, c) at free vertices that are the means of those of their neighbours.

    Parameters
    ----------
    values : (n, c) float64        at all vertices; those at free ones do not matter
    cells : (m, d + 1) int32
    free : (k,) int64              vertices; others keep their values

    Notes
    -----
    Conjugate gradients with the diagonal as preconditioner, written out, since those of scipy go
    through BLAS.
    """
    from scipy.sparse import coo_array

    n, k = len(values), len(free)
    number = np.full(n, -1, dtype=np.int64)
    number[free] = np.arange(k)
    pairs = np.concatenate([cells[:, pair] for pair in combinations(range(cells.shape[1]), 2)])
    pairs = np.concatenate([pairs, pairs[:, ::-1]])
    pairs = pairs[number[pairs[:, 0]] >= 0]
    ones = np.ones(len(pairs))
    graph = coo_array((ones, (number[pairs[:, 0]], pairs[:, 1])), shape=(k, n)).tocsr()
    graph.data[:] = 1.0
    degree = np.diff(graph.indptr).astype(np.float64)[:, None]
    held = values.copy()
    held[free] = 0.0
    right = graph @ held
    inner = graph[:, free]
    x = right / degree
    residual = right - (degree * x - inner @ x)
    way = residual / degree
    size = (residual * way).sum(axis=0)
    least = TOLERANCE**2 * (right * right / degree).sum(axis=0)
    for _ in range(ROUNDS):
        if (size <= least).all():
            break
        image = degree * way - inner @ way
        length = (way * image).sum(axis=0)
        step = np.divide(size, length, out=np.zeros_like(size), where=length > 0.0)
        x += step * way
        residual -= step * image
        scaled = residual / degree
        now = (residual * scaled).sum(axis=0)
        way = scaled + np.divide(now, size, out=np.zeros_like(size), where=size > 0.0) * way
        size = now
    return np.asarray(x)
