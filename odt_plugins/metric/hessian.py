"""Second derivatives of a field that is known at the vertices: fits of quadratic functions."""

from __future__ import annotations

from itertools import combinations_with_replacement
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.cells.tensors import cholesky, product, transposed
from odt_plugins.engine.topology.star import Stars, star_sum, vertex_neighbors, vertex_stars
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.metric.implied import implied_metric

AT_ONCE = 20_000
"""Vertices whose fits are made together."""

RIDGE = 1e-8
"""Weight that pulls second derivatives towards 0, as a part of the mean of the weights: it decides
where neighbours lie on two layers only and tell first and second derivatives not apart."""


NEAREST = 0.3
"""Squared length, as the metric of the mesh sees it, below which neighbours weigh about alike."""


class Tangents(NamedTuple):
    """Directions along a curved surface.

    Attributes
    ----------
    axes : (n, 2, 3) float64     orthonormal, along the surface at every vertex
    normals : (n, 3) float64     of length 1
    """

    axes: FloatArray
    normals: FloatArray

    def along(self, tensors: FloatArray) -> FloatArray:
        """Tensors (n, 2, 2) along the surface of tensors (n, 3, 3)."""
        return product(product(self.axes, tensors), transposed(self.axes))

    def lifted(self, tensors: FloatArray) -> FloatArray:
        """Metrics (n, 3, 3) of metrics (n, 2, 2), normal to the surface as short as along it."""
        half = 0.5 * (tensors[:, 0, 0] - tensors[:, 1, 1])
        most = 0.5 * (tensors[:, 0, 0] + tensors[:, 1, 1]) + np.sqrt(
            half**2 + tensors[:, 0, 1] ** 2)
        flat = product(product(transposed(self.axes), tensors), self.axes)
        square = self.normals[:, :, None] * self.normals[:, None, :]
        return np.asarray(flat + most[:, None, None] * square)


def tangents(points: FloatArray, cells: IntArray) -> Tangents:
    """Directions along triangles in space: normal to the sums of area vectors around vertices."""
    corner = points[cells]
    area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normals = star_sum(area, cells, len(points))
    length = np.sqrt((normals**2).sum(axis=1, keepdims=True))
    normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0.0)
    normals[length[:, 0] == 0.0] = [0.0, 0.0, 1.0]
    across = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    first = np.cross(across, normals)
    first /= np.sqrt((first**2).sum(axis=1, keepdims=True))
    return Tangents(np.stack([first, np.cross(normals, first)], axis=1), normals)


def recovered_hessians(
    points: FloatArray, cells: IntArray, values: FloatArray, along: Tangents | None = None
) -> FloatArray:
    """Hessians at the vertices of fields that are known at the vertices.

    Parameters
    ----------
    points : (n, D) float64
    cells : (m, d + 1) int32
    values : (n, c) float64      c fields
    along : Tangents             of triangles in space

    Returns
    -------
    (c, n, d, d) float64         exact for quadratic functions where neighbours determine them

    Notes
    -----
    The quadratic function through the value at a vertex that fits best, in the sum of squares, the
    values at the neighbours and their neighbours, with weights (NEAREST + |e|^2)^-2 for edges e as
    the metric of the mesh around sees them. Of smooth functions on jittered lattices they are at
    least twice as near as gradients that are projected twice.

    References
    ----------
    M.-G. Vallet, C.-M. Manole, J. Dompierre, S. Dufour, F. Guibault, Numerical comparison of some
    Hessian recovery techniques, Int. J. Numer. Meth. Engng 72 (2007) 987-1007: quadratic fitting.
    """
    d, count = cells.shape[1] - 1, values.shape[1]
    metric = implied_metric(points, cells)
    if along is not None:
        metric = along.along(metric)
    factor = cholesky(metric)
    neighbors = vertex_neighbors(cells, vertex_stars(cells, len(points)))
    out = np.zeros((count, len(points), d, d))
    for first in range(0, len(points), AT_ONCE):
        rows = np.arange(first, min(first + AT_ONCE, len(points)))
        i, j = _two_rings(neighbors, rows)
        edge = points[j] - points[i]
        if along is not None:
            edge = _times(along.axes[i], edge)
        edge = _times(transposed(factor)[i], edge)
        fitted = _fits(edge, i - first, values[j] - values[i], len(rows))
        for k in range(count):
            out[k, rows] = product(product(factor[rows], fitted[k]), transposed(factor[rows]))
    return out


def _times(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """Products (n, i) of matrices (n, i, k) and vectors (n, k)."""
    return product(matrices, vectors[:, :, None])[:, :, 0]


def _two_rings(
    neighbors: Stars, rows: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs of a vertex of `rows` and one that is at most two edges away, each once, by vertex."""
    n = len(neighbors.indptr) - 1
    one, near = _next(neighbors, rows, rows)
    two, far = _next(neighbors, one, near)
    # a neighbour is one of a neighbour, too, since they share a cell with a third vertex
    key = np.sort(two * n + far)
    key = key[np.diff(key, prepend=-1) != 0]
    i, j = key // n, key % n
    other = i != j
    return i[other], j[other]


def _next(
    neighbors: Stars, owner: NDArray[np.intp], vertices: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """For every neighbour of the vertices, their owner and the neighbour."""
    start = neighbors.indptr[vertices].astype(np.intp)
    count = neighbors.indptr[vertices + 1].astype(np.intp) - start
    place = np.arange(count.sum()) + np.repeat(start - np.cumsum(count) + count, count)
    return np.repeat(owner, count), neighbors.indices[place].astype(np.intp)


def _fits(edge: FloatArray, owner: NDArray[np.intp], rise: FloatArray, n: int) -> FloatArray:
    """Hessians (c, n, d, d) of quadratic functions that fit rises (k, c) along edges (k, d)."""
    d, count = edge.shape[1], rise.shape[1]
    pairs = list(combinations_with_replacement(range(d), 2))
    columns = [*edge.T, *(edge[:, a] * edge[:, b] * (0.5 if a == b else 1.0) for a, b in pairs)]
    square = (edge**2).sum(axis=1)
    weight = 1.0 / (NEAREST + square) ** 2
    whole = np.bincount(owner, weight, n)
    weight /= np.where(whole > 0.0, whole, 1.0)[owner]
    size = len(columns)
    normal = np.zeros((size, size, n))
    right = np.zeros((size, count, n))
    for a, column in enumerate(columns):
        weighted = weight * column
        for b in range(a + 1):
            normal[a, b] = np.bincount(owner, weighted * columns[b], n)
        for k in range(count):
            right[a, k] = np.bincount(owner, weighted * rise[:, k], n)
    for a in range(size):
        normal[a, a] += 1e-14 if a < d else RIDGE
    found = _solved(normal, right)
    out = np.zeros((count, n, d, d))
    for k, (a, b) in enumerate(pairs):
        out[:, :, a, b] = out[:, :, b, a] = found[d + k]
    return out


def _solved(normal: FloatArray, right: FloatArray) -> FloatArray:
    """Solutions (k, c, n) of symmetric systems (k, k, n), lower triangles, by Cholesky."""
    size = len(normal)
    factor, out = normal.copy(), right.copy()
    for a in range(size):
        for b in range(a):
            for k in range(b):
                factor[a, b] -= factor[a, k] * factor[b, k]
            factor[a, b] /= factor[b, b]
            out[a] -= factor[a, b] * out[b]
        for k in range(a):
            factor[a, a] -= factor[a, k] ** 2
        factor[a, a] = np.sqrt(np.maximum(factor[a, a], 1e-16))
        out[a] /= factor[a, a]
    for a in reversed(range(size)):
        for b in range(a + 1, size):
            out[a] -= factor[b, a] * out[b]
        out[a] /= factor[a, a]
    return out
