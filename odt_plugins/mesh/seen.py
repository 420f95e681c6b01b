"""A mesh as it is seen through a metric: every cell by itself, through the mean of its vertices."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np

from odt_plugins.mesh.arrays import FloatArray, IntArray


NO_ROOTS: FloatArray = np.zeros((0, 0))
"""Roots of no metric."""


def as_seen(
    points: FloatArray, cells: IntArray, roots: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Cells that share no vertices and have the shapes that a metric gives to those of a mesh.

    Parameters
    ----------
    points : (n, d) float64, cells : (m, k) int32
    roots : (n, d (d + 1) / 2) float64    see :class:`odt_plugins.mesh.simplex.SimplexMesh`; no rows
                                          for the mesh as it is

    Returns
    -------
    points : (m k, d) float64, cells : (m, k) int32
        every cell x_0, x_1, ... as 0, S (x_1 - x_0), ..., S the mean over its vertices
    """
    if not len(roots):
        return points, cells
    m, k = cells.shape
    d = points.shape[1]
    mean = roots[cells].mean(axis=1)
    edges = points[cells] - points[cells[:, :1]]
    seen = np.zeros((m, k, d))
    for (i, j), root in zip(combinations_with_replacement(range(d), 2), mean.T, strict=True):
        seen[:, :, i] += root[:, None] * edges[:, :, j]
        if i != j:
            seen[:, :, j] += root[:, None] * edges[:, :, i]
    return seen.reshape(m * k, d), np.arange(m * k, dtype=np.int32).reshape(m, k)
