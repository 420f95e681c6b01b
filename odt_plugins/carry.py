"""From which input cell does an output cell take its data?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from odt_plugins.mesh import FloatArray, IntArray, SimplexMesh, row_keys


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
                                                                            the same vertices

    Returns
    -------
    (m',) int32    the input cell of the same vertices where there is one, otherwise the input
                   cell of the same region whose barycentre is nearest
    """
    if np.array_equal(cells0, cells1):
        return np.arange(len(cells0), dtype=np.int32)
    source = _same_vertices(cells0, cells1, len(points0))
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
