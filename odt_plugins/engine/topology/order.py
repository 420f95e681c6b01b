"""Vertices and cells by their place: along a Morton curve for the cache, and in slabs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.compiled.threads import run_pieces, thread_pool, worth
from odt_plugins.mesh.arrays import FloatArray, IntArray, LongArray

BITS = 10

LAYERS = 12
"""Least thickness of a slab, in vertices of a mesh with as many along every axis."""


def morton_keys(points: FloatArray) -> NDArray[np.uint64]:
    """Interleave the bits of the coordinates on a grid of 2^BITS steps an axis.

    Parameters
    ----------
    points : (n, d) float64

    Returns
    -------
    (n,) uint64                 nearby points mostly have nearby keys
    """
    low = points.min(axis=0)
    span = float((points.max(axis=0) - low).max())
    scale = ((1 << BITS) - 1) / span if span > 0.0 else 0.0
    grid = ((points - low) * scale).astype(np.uint64)
    d = points.shape[1]
    keys = np.zeros(len(points), dtype=np.uint64)
    for bit in range(BITS):
        for axis in range(d):
            keys |= ((grid[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(bit * d + axis)
    return keys


@kernel
def _sort_by_lowest(cells: IntArray, start: LongArray, order: IntArray) -> None:
    """Counting sort; start (n + 1,) holds zeros, free slots are left out."""
    m, k = cells.shape
    for turn in range(2):
        for c in range(m):
            if cells[c, 0] < 0:
                continue
            low = cells[c, 0]
            for a in range(1, k):
                low = min(low, cells[c, a])
            if turn == 0:
                start[low + 1] += 1
            else:
                order[start[low]] = c
                start[low] += 1
        if turn == 0:
            for v in range(start.shape[0] - 1):
                start[v + 1] += start[v]


def by_lowest_vertex(cells: IntArray, n: int) -> IntArray:
    """Order of the cells by their smallest vertex, (m',) int32.

    Parameters
    ----------
    cells : (m, d + 1) int32    a row that starts with -1 is a free slot and is left out
    n : int                     number of vertices
    """
    order = np.empty(int(np.count_nonzero(cells[:, 0] >= 0)), dtype=np.int32)
    _sort_by_lowest(cells, np.zeros(n + 1, dtype=np.int64), order)
    return order


@kernel
def _rarest(cells: IntArray, c: int, count: LongArray) -> int:
    """Vertex of a cell that the fewest cells have, of several the lowest."""
    rare = cells[c, 0]
    for a in range(1, cells.shape[1]):
        v = cells[c, a]
        if count[v] < count[rare] or (count[v] == count[rare] and v < rare):
            rare = v
    return rare


@kernel
def _sort_by_rarest(
    cells: IntArray, count: LongArray, start: LongArray, order: IntArray
) -> None:
    """Counting sort by the rarest vertex; those of v come to order[start[v - 1]:start[v]]."""
    for c in range(cells.shape[0]):
        start[_rarest(cells, c, count) + 1] += 1
    for v in range(start.shape[0] - 1):
        start[v + 1] += start[v]
    for c in range(cells.shape[0]):
        v = _rarest(cells, c, count)
        order[start[v]] = c
        start[v] += 1


@kernel
def _match_rows(
    old: IntArray, new: IntArray, count: LongArray, order: IntArray, ends: LongArray,
    source: IntArray,
) -> None:
    """Old row of the same vertices as each new one; they are sorted by their rarest vertex."""
    k = old.shape[1]
    for c in range(new.shape[0]):
        v = _rarest(new, c, count)
        for s in range(ends[v - 1] if v > 0 else 0, ends[v]):
            common = 0
            for a in range(k):
                for b in range(k):
                    common += old[order[s], a] == new[c, b]
            if common == k:
                source[c] = order[s]
                break


def same_vertices(old: IntArray, new: IntArray, n: int, threads: int = 1) -> IntArray:
    """Find the cells that are still there.

    Parameters
    ----------
    old, new : (m, d + 1), (m', d + 1) int32    cells, each of different vertices
    n : int                                     number of vertices
    threads : int                               how many share the work

    Returns
    -------
    (m',) int32    the first old cell with the same vertices as each new one, or -1
    """
    order, ends = np.empty(len(old), dtype=np.int32), np.zeros(n + 1, dtype=np.int64)
    count = np.bincount(old.ravel(), minlength=n)
    _sort_by_rarest(old, count, ends, order)
    source = np.full(len(new), -1, dtype=np.int32)

    def match(first: int, last: int) -> None:
        _match_rows(old, new[first:last], count, order, ends, source[first:last])

    with thread_pool(worth(threads, len(new))) as pool:
        run_pieces(pool, len(new), match)
    return source


def curve_order(points: FloatArray, cells: IntArray) -> tuple[IntArray, IntArray]:
    """Orders that put neighbours in space next to each other in memory.

    Parameters
    ----------
    points : (n, d) float64, cells : (m, d + 1) int32

    Returns
    -------
    vertices : (n,) int32    old index of every new vertex
    cells : (m,) int32       old index of every new cell, by its smallest new vertex
    """
    vertices = np.argsort(morton_keys(points), kind="stable").astype(np.int32)
    rank = np.empty(len(points), dtype=np.int32)
    rank[vertices] = np.arange(len(points), dtype=np.int32)
    return vertices, by_lowest_vertex(rank[cells], len(points))


def make_slabs(points: FloatArray) -> NDArray[np.uint8]:
    """Two numbers for every vertex: its slab among the first ones, and among the second ones.

    Parameters
    ----------
    points : (n, d) float64

    Returns
    -------
    (2, n) uint8               all 0 when the mesh is too small for slabs
    """
    n = len(points)
    count = min(2 * int(n ** (1.0 / 3.0) / (2 * LAYERS)), 128)
    if count < 2:
        return np.zeros((2, n), dtype=np.uint8)
    axis = int(np.argmax(points.max(axis=0) - points.min(axis=0)))
    rank = np.empty(n, dtype=np.int64)
    rank[np.argsort(points[:, axis], kind="stable")] = np.arange(n)
    return np.stack([rank * count // n, (rank * count + n // 2) // n]).astype(np.uint8)
