"""The cell whose barycentre is nearest, found from star to star."""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.compiled.kernel import inlined_kernel, kernel
from odt_plugins.engine.compiled.threads import run_pieces, thread_pool, worth
from odt_plugins.engine.topology.lookup import is_in
from odt_plugins.engine.topology.star import Stars, vertex_stars
from odt_plugins.mesh.arrays import FloatArray, IntArray


@inlined_kernel
def _distance(centres: FloatArray, c: int, x: FloatArray, i: int, d: int) -> float:
    """Square of the distance, d 2 or 3; the compiler does not unroll a loop over coordinates."""
    u, v = centres[c, 0] - x[i, 0], centres[c, 1] - x[i, 1]
    w = centres[c, 2] - x[i, 2] if d == 3 else 0.0
    return u * u + v * v + w * w


@kernel
def _walk(
    cells: IntArray, stars: Stars, centres: FloatArray, regions: IntArray,
    rows: IntArray, x: FloatArray, labels: IntArray, found: IntArray,
) -> None:
    """Go on to the nearest cell around the vertices of the last one until it is that one."""
    k, d = cells.shape[1], x.shape[1]
    for i in range(rows.shape[0]):
        best, least = -1, np.inf
        last, here = rows[i], rows[i]
        for _ in range(cells.shape[0] + 1):
            start = best
            for a in range(k):
                v = here[a]
                if start >= 0 and is_in(v, last, k):
                    continue
                for s in range(stars.indptr[v], stars.indptr[v + 1]):
                    c = stars.indices[s]
                    square = _distance(centres, c, x, i, d)
                    nearer = square < least or (square == least and c < best)
                    if nearer and regions[c] == labels[i]:
                        best, least = c, square
            if best == start:
                break
            last, here = here, cells[best]
        found[i] = best


def nearest_cells(
    cells: IntArray, centres: FloatArray, regions: IntArray,
    rows: IntArray, x: FloatArray, labels: IntArray, n: int, threads: int = 1,
) -> IntArray:
    """Find the nearest of the cells of a region, from those on that have a vertex of a row.

    Parameters
    ----------
    cells : (m, d + 1) int32        of a mesh
    centres : (m, d) float64        their barycentres
    regions : (m,) int32
    rows : (k, d + 1) int32         vertices near each place
    x : (k, d) float64              the places
    labels : (k,) int32             their regions
    n : int                         number of vertices
    threads : int                   how many share the work

    Returns
    -------
    (k,) int32    the cell of the region whose barycentre is nearest, the first of several, as a
                  walk finds it that goes on to the nearest cell of the region around the vertices
                  of the last one; -1 where no cell of the region has a vertex of the row
    """
    found = np.empty(len(rows), dtype=np.int32)
    with thread_pool(worth(threads, len(cells))) as pool:
        stars = vertex_stars(cells, n, pool)

        def walk(first: int, last: int) -> None:
            _walk(cells, stars, centres, regions, rows[first:last], x[first:last],
                  labels[first:last], found[first:last])

        run_pieces(pool, len(rows), walk)
    return found
