"""From which input cells do output cells and new vertices take their data?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.facets import sorted_columns
from odt_plugins.mesh.simplex import SimplexMesh, barycentric, corner_mean

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
    threads: int = 1,
) -> IntArray:
    """Input cell whose data every output cell takes.

    Parameters
    ----------
    points0, cells0, regions0 : (n, d) float64, (m, k) int32, (m,) int32    input mesh
    points1, cells1, regions1 : (n, d) float64, (m', k) int32, (m',) int32  output mesh with
                                                                            the same vertices,
                                                                            then perhaps more
    threads : int                                                           how many share the work

    Returns
    -------
    (m',) int32    the input cell of the same vertices where there is one, otherwise the input
                   cell of the same region whose barycentre is nearest
    """
    if np.array_equal(cells0, cells1):
        return np.arange(len(cells0), dtype=np.int32)
    from odt_plugins.engine.topology.order import same_vertices

    source = same_vertices(cells0, cells1, len(points1))
    new = np.flatnonzero(source < 0)
    if new.size:
        source[new] = _nearest(
            corner_mean(points0, cells0), regions0,
            corner_mean(points1, cells1[new]), regions1[new], threads,
        )
    return source


def in_input_order(
    before: SimplexMesh, points: FloatArray, cells: IntArray, regions: IntArray, threads: int = 1
) -> tuple[IntArray, IntArray, IntArray]:
    """Sort output cells by the input cell they come from.

    Parameters
    ----------
    before : SimplexMesh            the input
    points, cells, regions          the output, positively oriented
    threads : int                   how many share the work

    Returns
    -------
    cells : (m', d + 1) int32       a cell that is still there, the same way round, has its old
                                    row, and such cells keep their order; new cells stand next to
                                    where they come from
    regions : (m',) int32           their labels
    source : (m',) int32            :func:`cell_source`, increasing
    """
    source = cell_source(
        before.points, before.cells, before.regions, points, cells, regions, threads
    )
    order = np.argsort(source, kind="stable")
    cells, source = cells[order], source[order]
    old = before.cells[source]
    (was, odd0), (now, odd1) = sorted_columns(old), sorted_columns(cells)
    same = np.logical_and.reduce([odd0 == odd1, *map(np.equal, was, now)])
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

    tree = cKDTree(corner_mean(points, cells))
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
    found = barycentric(points[cells], x[:, None])
    best = found.min(axis=2).argmax(axis=1)
    row = np.arange(len(x))
    return cells[row, best], found[row, best]


def _nearest(
    centre0: FloatArray, regions0: IntArray, centre1: FloatArray, regions1: IntArray, threads: int
) -> IntArray:
    from scipy.spatial import cKDTree

    source = np.full(len(centre1), -1, dtype=np.int32)
    by_region0, by_region1 = _groups(regions0), _groups(regions1)
    for label, targets in by_region1.items():
        candidates = by_region0[label]
        tree = cKDTree(centre0[candidates], balanced_tree=False, compact_nodes=False)
        _, hit = tree.query(centre1[targets], workers=threads)
        source[targets] = candidates[hit]
    return source


def _groups(labels: IntArray) -> dict[int, NDArray[np.intp]]:
    """Indices of the cells of every label, increasing."""
    order = np.argsort(labels, kind="stable")
    distinct, start = np.unique(labels[order], return_index=True)
    return dict(zip(distinct.tolist(), np.split(order, start[1:]), strict=True))
