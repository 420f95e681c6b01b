"""A mesh as it is seen through a metric: every cell by itself, through the mean of its vertices."""

from __future__ import annotations

import math
from itertools import combinations_with_replacement

import numpy as np

from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.symmetric import exponentials

NO_METRIC: FloatArray = np.zeros((0, 0))
"""Rows of no metric."""


def as_seen(points: FloatArray, cells: IntArray, metric: FloatArray) -> tuple[FloatArray, IntArray]:
    """Cells that share no vertices and have the shapes that a metric gives to those of a mesh.

    Parameters
    ----------
    points : (n, d) float64, cells : (m, k) int32
    metric : (n, d (d + 1) / 2) float64    see :class:`odt_plugins.mesh.simplex.SimplexMesh`; no
                                           rows for the mesh as it is

    Returns
    -------
    points : (m k, d) float64, cells : (m, k) int32
        every cell x_0, x_1, ... as 0, S (x_1 - x_0), ..., S the exponential of the mean of the rows
    """
    if not len(metric):
        return points, cells
    k = cells.shape[1]
    mean = metric[cells[:, 0]]
    for i in range(1, k):
        mean += metric[cells[:, i]]
    return seen_through(exponentials(full(mean / k)), points, cells)


def seen_through(
    roots: FloatArray, points: FloatArray, cells: IntArray
) -> tuple[FloatArray, IntArray]:
    """Cells as of :func:`as_seen`, with a matrix S of each cell (m, d, d)."""
    m, k = cells.shape
    d = points.shape[1]
    edges = points[cells] - points[cells[:, :1]]
    seen = edges[:, :, :1] * roots[:, :1]
    for i in range(1, d):
        seen += edges[:, :, i, None] * roots[:, None, i]
    return seen.reshape(m * k, d), np.arange(m * k, dtype=np.int32).reshape(m, k)


def full(rows: FloatArray) -> FloatArray:
    """Symmetric matrices (m, d, d) of upper triangles (m, d (d + 1) / 2), row by row."""
    d = {3: 2, 6: 3}[rows.shape[1]]
    i, j = zip(*combinations_with_replacement(range(d), 2), strict=True)
    out = np.zeros((len(rows), d, d))
    out[:, i, j] = out[:, j, i] = rows
    return out


def in_unit(metric: FloatArray, unit: float) -> FloatArray:
    """The metric for coordinates that are so many times as large: M / unit^2."""
    out = metric.copy()
    for column in {0: (), 3: (0, 2), 6: (0, 3, 5)}[metric.shape[1]]:
        out[:, column] -= math.log(unit)
    return out
