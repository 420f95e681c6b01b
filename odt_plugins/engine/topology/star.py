"""Stars: which cells contain a vertex, and averages over them."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.errors import InvalidMeshError
from odt_plugins.mesh.arrays import FloatArray, IntArray, LongArray
from odt_plugins.mesh.chunks import Pool

OffsetArray = NDArray[np.int64]

PARTS = 4
"""Parts of the cells that threads share when they sort the cells by vertices."""


class Stars(NamedTuple):
    """Compressed rows: the cells of vertex i are ``indices[indptr[i]:indptr[i + 1]]``, ascending.

    Attributes
    ----------
    indptr : (n + 1,) int64
    indices : (m * (d + 1),) int32
    """

    indptr: OffsetArray
    indices: IntArray

    def largest(self) -> int:
        """Most cells around a vertex."""
        return int(np.diff(self.indptr).max(initial=0))


@kernel
def _count(cells: IntArray, start: int, stop: int, count: LongArray) -> None:
    """Add to every vertex's count the cells start to stop that it is in."""
    for c in range(start, stop):
        if cells[c, 0] < 0:
            continue
        for a in range(cells.shape[1]):
            count[cells[c, a]] += 1


@kernel
def _places(count: LongArray, indptr: OffsetArray) -> None:
    """Turn counts by part and vertex into the place of the first such entry, and fill indptr."""
    total = 0
    for v in range(count.shape[1]):
        indptr[v] = total
        for part in range(count.shape[0]):
            entries = count[part, v]
            count[part, v] = total
            total += entries
    indptr[count.shape[1]] = total


@kernel
def _fill(cells: IntArray, start: int, stop: int, place: LongArray, indices: IntArray) -> None:
    """Write the cells start to stop to the places of their vertices."""
    for c in range(start, stop):
        if cells[c, 0] < 0:
            continue
        for a in range(cells.shape[1]):
            v = cells[c, a]
            at = place[v]
            indices[at] = c
            place[v] = at + 1


@kernel
def _sort_all(
    cells: IntArray, place: LongArray, indptr: OffsetArray, indices: IntArray
) -> None:
    """Sort all cells by their vertices in one part."""
    _count(cells, 0, cells.shape[0], place[0])
    _places(place, indptr)
    _fill(cells, 0, cells.shape[0], place[0], indices)


@kernel
def _add_to_corners(values: FloatArray, cells: IntArray, sums: FloatArray) -> None:
    for c in range(cells.shape[0]):
        for a in range(cells.shape[1]):
            for j in range(values.shape[1]):
                sums[cells[c, a], j] += values[c, j]


@kernel
def _neighbor_rows(
    cells: IntArray,
    star_indptr: OffsetArray,
    star_indices: IntArray,
    stamp: IntArray,
    indptr: OffsetArray,
    indices: IntArray,
) -> None:
    """Count the neighbours of every vertex; write them when ``indices`` is not empty."""
    n = star_indptr.shape[0] - 1
    k = cells.shape[1]
    write = indices.shape[0] > 0
    total = 0
    for i in range(n):
        indptr[i] = total
        for s in range(star_indptr[i], star_indptr[i + 1]):
            c = star_indices[s]
            for a in range(k):
                j = cells[c, a]
                if j != i and stamp[j] != i:
                    stamp[j] = i
                    if write:
                        indices[total] = j
                    total += 1
    indptr[n] = total


def vertex_stars(
    cells: IntArray, n_points: int, pool: Pool | None = None
) -> Stars:
    """List the cells around every vertex.

    Parameters
    ----------
    cells : (m, d + 1) int32    vertex indices, each below n_points; a row that starts with -1 is
                                a free slot and belongs to no star
    n_points : int              n
    pool : Pool, optional
        shares the work; the result does not depend on it

    Returns
    -------
    Stars                       compressed rows, cells of a row in ascending order
    """
    cells = np.ascontiguousarray(cells, dtype=np.int32)
    indptr = np.empty(n_points + 1, dtype=np.int64)
    indices = np.empty(cells.size, dtype=np.int32)
    parts = 1 if pool is None else PARTS
    place = np.zeros((parts, n_points), dtype=np.int64)
    if pool is None:
        _sort_all(cells, place, indptr, indices)
    else:
        cuts = [len(cells) * part // parts for part in range(parts + 1)]
        list(pool.map(partial(_count, cells), cuts[:-1], cuts[1:], place))
        _places(place, indptr)
        list(pool.map(lambda *part: _fill(cells, *part, indices), cuts[:-1], cuts[1:], place))
    return Stars(indptr, indices)


def vertex_neighbors(cells: IntArray, stars: Stars) -> Stars:
    """List the vertices that share a cell with every vertex, each once.

    Returns
    -------
    Stars    compressed rows whose indices are vertices, in the order in which the star meets them
    """
    n = stars.indptr.size - 1
    indptr = np.zeros(n + 1, dtype=np.int64)
    cells = np.ascontiguousarray(cells, dtype=np.int32)
    stamp = np.full(n, -1, dtype=np.int32)
    _neighbor_rows(cells, stars.indptr, stars.indices, stamp, indptr, np.empty(0, dtype=np.int32))
    indices = np.empty(int(indptr[n]), dtype=np.int32)
    stamp[:] = -1
    _neighbor_rows(cells, stars.indptr, stars.indices, stamp, indptr, indices)
    return Stars(indptr, indices)


def star_sum(values: FloatArray, cells: IntArray, n_points: int) -> FloatArray:
    """Sum a per-cell quantity over the star of every point.

    Parameters
    ----------
    values : (m,) or (m, c) float64
    cells : (m, d + 1) int32
    n_points : int                     n

    Returns
    -------
    (n,) or (n, c) float64             0 where a point belongs to no cell
    """
    cells = np.ascontiguousarray(cells, dtype=np.int32)
    columns = np.ascontiguousarray(values.reshape(len(cells), -1), dtype=np.float64)
    sums = np.zeros((n_points, columns.shape[1]))
    _add_to_corners(columns, cells, sums)
    return sums.reshape((n_points, *values.shape[1:]))


def star_average(
    values: FloatArray, weights: FloatArray, cells: IntArray, n_points: int
) -> FloatArray:
    """Average a per-cell quantity over the star of every point.

    Parameters
    ----------
    values : (m, c) float64    cell quantity c_tau, e.g. circumcenters
    weights : (m,) float64     w_tau > 0, e.g. |tau| (uniform density)
    cells : (m, d + 1) int32   point indices of each simplex tau
    n_points : int             n

    Returns
    -------
    (n, c) float64             sum_tau w_tau c_tau / sum_tau w_tau over tau containing x_i

    Raises
    ------
    InvalidMeshError           a point belongs to no cell

    References
    ----------
    L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007, the averages in
    (4.7), (4.13) and (4.20).
    """
    total = star_sum(weights, cells, n_points)
    alone = np.flatnonzero(total == 0.0)
    if alone.size:
        msg = (
            f"got a point without cells at index {alone[0]} ({alone.size} of them), expected "
            "every point in a cell, try leaving unused points out"
        )
        raise InvalidMeshError(msg)
    average: FloatArray = star_sum(values * weights[:, None], cells, n_points) / total[:, None]
    return average
