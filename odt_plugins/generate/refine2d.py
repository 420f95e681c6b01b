"""Uniform refinement of triangles: each is cut into four at the midpoints of its edges."""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.topology.adjacency import cell_neighbors
from odt_plugins.mesh.arrays import FloatArray, IntArray


@kernel
def _number_midpoints(
    cells: IntArray, neighbors: IntArray, first: int, middle: IntArray, ends: IntArray
) -> int:
    """Number the edges from ``first``: middle[t, i] is opposite to corner i; returns how many."""
    count = 0
    for t in range(cells.shape[0]):
        for i in range(3):
            s = neighbors[t, i]
            if 0 <= s < t:
                for j in range(3):
                    if neighbors[s, j] == t:
                        middle[t, i] = middle[s, j]
            else:
                middle[t, i] = first + count
                ends[count, 0] = cells[t, (i + 1) % 3]
                ends[count, 1] = cells[t, (i + 2) % 3]
                count += 1
    return count


def refine_triangles(
    points: FloatArray, cells: IntArray
) -> tuple[FloatArray, IntArray, IntArray]:
    """Cut every triangle into four similar ones.

    Parameters
    ----------
    points : (n, d) float64       d = 2 or 3
    cells : (m, 3) int32

    Returns
    -------
    points : (n + e, d) float64   the old ones first, then the midpoint of every edge
    cells : (4 m, 3) int32        same orientation; the children of triangle t are 4t ... 4t + 3,
                                  the inner one last
    ends : (e, 2) int32           end points of the edge of every new vertex

    References
    ----------
    CMAME 200 (2011) 967-984, Section 5.3, ``uniformrefine``.
    """
    cells = np.ascontiguousarray(cells, dtype=np.int32)
    m = len(cells)
    middle = np.empty((m, 3), dtype=np.int32)
    ends = np.empty((3 * m, 2), dtype=np.int32)
    count = _number_midpoints(cells, cell_neighbors(cells), len(points), middle, ends)
    ends = ends[:count].copy()
    new = np.concatenate([points, 0.5 * (points[ends[:, 0]] + points[ends[:, 1]])])
    a, b, c = cells.T
    ma, mb, mc = middle.T
    children = np.empty((m, 4, 3), dtype=np.int32)
    children[:, 0] = np.column_stack([a, mc, mb])
    children[:, 1] = np.column_stack([mc, b, ma])
    children[:, 2] = np.column_stack([mb, ma, c])
    children[:, 3] = middle
    return new, children.reshape(-1, 3), ends
