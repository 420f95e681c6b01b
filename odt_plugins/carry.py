"""From which input cells do output cells and new vertices take their data?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from odt_plugins.mesh import FloatArray, IntArray, SimplexMesh, row_keys

NEAR = (16, 256)
"""How many of the nearest cells a point is looked for in, before all of them."""

CHUNK = 1 << 17


def cell_source(
    points0: FloatArray,
    cells0: IntArray,
    regions0: IntArray,
    points1: FloatArray,
    cells1: IntArray,
    regions1: IntArray,
) -> IntArray:
    """Input cell whose data every output cell takes.

    Parameters
    ----------
    points0, cells0, regions0 : (n, d) float64, (m, k) int32, (m,) int32    input mesh
    points1, cells1, regions1 : (n, d) float64, (m', k) int32, (m',) int32  output mesh with
                                                                            the same vertices,
                                                                            then perhaps more

    Returns
    -------
    (m',) int32    the input cell of the same vertices where there is one, otherwise the input
                   cell of the same region whose barycentre is nearest
    """
    if np.array_equal(cells0, cells1):
        return np.arange(len(cells0), dtype=np.int32)
    source = _same_vertices(cells0, cells1, len(points1))
    new = np.flatnonzero(source < 0)
    if new.size:
        source[new] = _nearest(
            points0[cells0].mean(axis=1), regions0, points1[cells1[new]].mean(axis=1), regions1[new]
        )
    return source


def in_input_order(
    before: SimplexMesh, points: FloatArray, cells: IntArray, regions: IntArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Sort output cells by the input cell they come from.

    Parameters
    ----------
    before : SimplexMesh            the input
    points, cells, regions          the output, positively oriented

    Returns
    -------
    cells : (m', d + 1) int32       a cell that is still there, the same way round, has its old
                                    row, and such cells keep their order; new cells stand next to
                                    where they come from
    regions : (m',) int32           their labels
    source : (m',) int32            :func:`cell_source`, increasing
    """
    source = cell_source(before.points, before.cells, before.regions, points, cells, regions)
    order = np.argsort(source, kind="stable")
    cells, source = cells[order], source[order]
    old = before.cells[source]
    same = (np.sort(old, axis=1) == np.sort(cells, axis=1)).all(axis=1)
    same &= _is_odd(old) == _is_odd(cells)
    return np.where(same[:, None], old, cells), regions[order], source


def surrounding_cells(
    points: FloatArray, cells: IntArray, x: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Find the cells of a mesh in which some points lie.

    Parameters
    ----------
    points, cells : (n, d) float64, (m, d + 1) int32    a mesh, positively oriented
    x : (k, d) float64                                  points in the mesh, to rounding

    Returns
    -------
    corners : (k, d + 1) int32                          vertices of the cell around each point
    weights : (k, d + 1) float64                        its barycentric coordinates there, not
                                                        negative, of sum 1
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(points[cells].mean(axis=1))
    corners = np.empty((len(x), cells.shape[1]), dtype=np.int32)
    weights = np.full(corners.shape, -np.inf)
    for near in NEAR:
        left = np.flatnonzero(weights.min(axis=1) < 0.0)
        for part in np.array_split(left, len(left) * near // CHUNK + 1):
            _, hit = tree.query(x[part], k=[*range(1, min(near, len(cells)) + 1)])
            corners[part], weights[part] = _best_cell(points, cells[hit], x[part])
    for i in np.flatnonzero(weights.min(axis=1) < 0.0):
        corners[i], weights[i] = _best_cell(points, cells[None], x[i : i + 1])
    weights = np.maximum(weights, 0.0)
    return corners, weights / weights.sum(axis=1, keepdims=True)


def _best_cell(
    points: FloatArray, cells: IntArray, x: FloatArray
) -> tuple[IntArray, FloatArray]:
    """The cell (k, d + 1) out of (k, c, d + 1) that a point is deepest in, and its coordinates."""
    found = _barycentric(points[cells], x)
    best = found.min(axis=2).argmax(axis=1)
    row = np.arange(len(x))
    return cells[row, best], found[row, best]


def _barycentric(corners: FloatArray, x: FloatArray) -> FloatArray:
    """Barycentric coordinates (k, c, d + 1) of points (k, d) in cells (k, c, d + 1, d) each."""
    edges = np.swapaxes(corners[:, :, 1:] - corners[:, :, :1], 2, 3)
    inner = np.linalg.solve(edges, (x[:, None] - corners[:, :, 0])[..., None])[..., 0]
    return np.concatenate([1.0 - inner.sum(axis=2, keepdims=True), inner], axis=2)


def _is_odd(rows: IntArray) -> NDArray[np.bool_]:
    """Whether each row is an odd permutation of its sorted self.

    Vertices that moved can bring back an old set of vertices the other way round.
    """
    odd = np.zeros(len(rows), dtype=np.bool_)
    for i in range(rows.shape[1]):
        for j in range(i):
            odd ^= rows[:, j] > rows[:, i]
    return odd


def _same_vertices(cells0: IntArray, cells1: IntArray, n: int) -> IntArray:
    """Input cell with the same vertices as each output cell, or -1."""
    m = len(cells0)
    keys = row_keys(np.sort(np.concatenate([cells0, cells1]), axis=1), n)
    order = np.argsort(keys[:m], kind="stable")
    place = np.searchsorted(keys[:m], keys[m:], sorter=order)
    found = order[np.minimum(place, m - 1)]
    return np.where(keys[:m][found] == keys[m:], found, -1).astype(np.int32)


def _nearest(
    centre0: FloatArray, regions0: IntArray, centre1: FloatArray, regions1: IntArray
) -> IntArray:
    from scipy.spatial import cKDTree

    source = np.full(len(centre1), -1, dtype=np.int32)
    by_region0, by_region1 = _groups(regions0), _groups(regions1)
    for label, targets in by_region1.items():
        candidates = by_region0[label]
        tree = cKDTree(centre0[candidates], balanced_tree=False, compact_nodes=False)
        _, hit = tree.query(centre1[targets])
        source[targets] = candidates[hit]
    return source


def _groups(labels: IntArray) -> dict[int, NDArray[np.intp]]:
    """Indices of the cells of every label, increasing."""
    order = np.argsort(labels, kind="stable")
    distinct, start = np.unique(labels[order], return_index=True)
    return dict(zip(distinct.tolist(), np.split(order, start[1:]), strict=True))
