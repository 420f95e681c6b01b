"""From which input cells do output cells and new vertices take their data?"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.chunks import chunks, spread
from odt_plugins.mesh.facets import sorted_columns
from odt_plugins.mesh.simplex import SimplexMesh, barycentric, corner_mean

NEAR = 16
"""In how many of the nearest cells a point is looked for where a walk did not find it."""

STEPS = 200
"""Most cells on a walk to a point."""

INSIDE = 1e-12
"""How negative the barycentric coordinates of a point in a cell may be, by rounding."""


FAR = 1.0
"""How negative they are where a point lies far from a cell, measured by the size of that cell."""


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
                   cell of the same region whose barycentre is nearest, see :func:`nearest_cells`;
                   of triangles in space, where vertices came, the triangle that is closest to the
                   barycentre, so that creases divide them
    """
    if np.array_equal(cells0, cells1):
        return np.arange(len(cells0), dtype=np.int32)
    from odt_plugins.engine.topology.nearest import nearest_cells
    from odt_plugins.engine.topology.order import same_vertices

    n = len(points1)
    source = same_vertices(cells0, cells1, n, threads)
    new = np.flatnonzero(source < 0)
    if not new.size:
        return source
    rows, labels = cells1[new], regions1[new]
    if cells0.shape[1] == points0.shape[1] == 3 and n > len(points0):
        source[new] = _closest(points0, cells0, regions0, corner_mean(points1, rows), labels)
        return source
    centres, x = corner_mean(points0, cells0, threads), corner_mean(points1, rows, threads)
    found = nearest_cells(cells0, centres, regions0, rows, x, labels, n, threads)
    far = np.flatnonzero(found < 0)
    if far.size:
        found[far] = _nearest(centres, regions0, x[far], labels[far], 1, threads)[:, 0]
    source[new] = found
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

    def as_before(part: slice) -> None:
        old = before.cells[source[part]]
        (was, odd0), (now, odd1) = sorted_columns(old), sorted_columns(cells[part])
        same = np.logical_and.reduce([odd0 == odd1, *map(np.equal, was, now)])
        cells[part] = np.where(same[:, None], old, cells[part])

    spread(as_before, chunks(len(cells)), threads)
    return cells, regions[order], source


def surrounding_cells(
    mesh: SimplexMesh, x: FloatArray, start: IntArray | None = None, threads: int = 1
) -> tuple[IntArray, FloatArray]:
    """Find the cells of a mesh in which some points lie.

    Parameters
    ----------
    mesh : SimplexMesh             tetrahedra, or triangles in the plane
    x : (k, d) float64
    start : (k,) int, optional     a cell near each point: cells of other regions are not looked at;
                                   unless given, the one with the nearest barycentre
    threads : int                  how many share the work

    Returns
    -------
    cell : (k,) int32              the cell around each point; of one outside of the mesh, one at
                                   the boundary near it
    weights : (k, d + 1) float64   its barycentric coordinates there, of sum 1: some are negative
                                   outside of the mesh, where linear fields are continued

    Notes
    -----
    A walk goes from cell to cell, over the facet that separates it most from the point. Where it
    ends at the boundary, another one starts from the best of the nearest cells. It is taken where
    it finds the point, or the first one ended far from it: a point that left the mesh a little does
    not belong to the other side of a gap.
    """
    from odt_plugins.engine.topology.adjacency import cell_neighbors

    neighbors = cell_neighbors(mesh.cells)
    regions = np.zeros_like(mesh.regions)
    if start is None:
        centres = corner_mean(mesh.points, mesh.cells, threads)
        start = _nearest(centres, regions, x, np.zeros(len(x), dtype=np.int32), 1, threads)[:, 0]
    else:
        regions = mesh.bodies()
        neighbors[regions[:, None] != regions[neighbors]] = -1
    cell = np.array(start, dtype=np.int32)
    weights = np.empty((len(x), mesh.cells.shape[1]))

    def walk(part: slice) -> None:
        cell[part], weights[part] = _walk(mesh, neighbors, x[part], cell[part])

    spread(walk, chunks(len(x)), threads)
    outside = np.flatnonzero(weights.min(axis=1) < -INSIDE)
    if not outside.size:
        return cell, weights
    centres = corner_mean(mesh.points, mesh.cells, threads)
    hit = _nearest(centres, regions, x[outside], regions[cell[outside]], NEAR, threads)

    def walk_again(part: slice) -> None:
        rows = outside[part]
        found = barycentric(mesh.points[mesh.cells[hit[part]]], x[rows, None]).min(axis=2)
        best = hit[part][np.arange(len(rows)), found.argmax(axis=1)]
        again, deep = _walk(mesh, neighbors, x[rows], best)
        least, now = weights[rows].min(axis=1), deep.min(axis=1)
        better = (now > least) & ((now >= -INSIDE) | (least < -FAR))
        cell[rows[better]], weights[rows[better]] = again[better], deep[better]

    spread(walk_again, chunks(len(outside)), threads)
    return cell, weights


def in_order_of(
    caller: NDArray[Any], rows: NDArray[Any], cell: IntArray, weights: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Coordinates (k, c) in some cells `rows` (k,) in the order of the `caller`'s same corners."""
    ascending = np.take_along_axis(weights, np.argsort(rows[cell], axis=1), axis=1)
    place = np.argsort(np.argsort(caller[cell], axis=1), axis=1)
    return cell, np.take_along_axis(ascending, place, axis=1)


def _walk(
    mesh: SimplexMesh, neighbors: IntArray, x: FloatArray, start: IntArray
) -> tuple[IntArray, FloatArray]:
    """The deepest cell on the way from a cell towards each point, and its coordinates there."""
    cell, best = start.copy(), start.copy()
    weights = np.full((len(x), mesh.cells.shape[1]), -np.inf)
    left = np.arange(len(x))
    for step in range(STEPS):
        found = barycentric(mesh.points[mesh.cells[cell[left]]], x[left])
        deeper = found.min(axis=1) > weights[left].min(axis=1)
        best[left[deeper]], weights[left[deeper]] = cell[left[deeper]], found[deeper]
        across = neighbors[cell[left]]
        ways = (found < -INSIDE) & (across >= 0)
        # A walk straight on may run in a circle where cells are not Delaunay, one at random cannot.
        turn = found if step < STEPS // 4 else np.random.default_rng(step).random(found.shape)
        goes = ways.any(axis=1)
        way = np.where(ways, turn, np.inf).argmin(axis=1)
        left, across, way = left[goes], across[goes], way[goes]
        if not left.size:
            break
        cell[left] = across[np.arange(len(left)), way]
    return best, _refined(mesh.points[mesh.cells[best]], x, weights)


def _refined(corners: FloatArray, x: FloatArray, weights: FloatArray) -> FloatArray:
    """Refine barycentric coordinates of x by one step that removes the error of rounding."""
    edges = corners - corners[:, :1]
    rest = (x - corners[:, 0]) - np.einsum("kc,kcd->kd", weights, edges)
    step = barycentric(edges, rest)
    step[:, 0] -= 1.0
    refined: FloatArray = weights + step
    return refined


def _nearest(
    centres: FloatArray, regions: IntArray, x: FloatArray, labels: IntArray, count: int,
    threads: int = 1,
) -> IntArray:
    """Those (k, count) of centres (m, d) in regions (m,) nearest to x in the regions (k,)."""
    from scipy.spatial import cKDTree

    out = np.empty((len(x), count), dtype=np.int32)
    members = _groups(regions)
    for label, rows in _groups(labels).items():
        own = members[label]
        tree = cKDTree(centres[own], balanced_tree=False, compact_nodes=False)
        ranks = [min(i, len(own)) for i in range(1, count + 1)]
        out[rows] = own[tree.query(x[rows], k=ranks, workers=threads)[1]]
    return out


def _closest(
    points: FloatArray, cells: IntArray, regions: IntArray, x: FloatArray, labels: IntArray
) -> IntArray:
    """The triangles (k,) in space of the regions (k,) that are closest to places (k, 3)."""
    from odt_plugins.engine.ground.reference import make_reference

    out = np.empty(len(x), dtype=np.int32)
    members = _groups(regions)
    for label, rows in _groups(labels).items():
        own = members[label]
        out[rows] = own[make_reference(points, cells[own]).closest(x[rows])[1]]
    return out


def nearest_of(mesh: SimplexMesh, x: FloatArray, bodies: IntArray, threads: int = 1) -> IntArray:
    """Those NEAR cells (k, NEAR) of a mesh, or all, whose barycentres are nearest to places (k, d)
    in some of its bodies (k,).
    """
    centres = corner_mean(mesh.points, mesh.cells, threads)
    return _nearest(centres, mesh.bodies(), x, bodies, NEAR, threads)


def _groups(labels: IntArray) -> dict[int, NDArray[np.intp]]:
    """Indices of the cells of every label, increasing."""
    order = np.argsort(labels, kind="stable")
    distinct, start = np.unique(labels[order], return_index=True)
    return dict(zip(distinct.tolist(), np.split(order, start[1:]), strict=True))


def cell_origin(
    ids: NDArray[Any] | None, total: int, source: IntArray,
    others: Sequence[tuple[NDArray[Any], NDArray[np.int64]]] = (),
) -> NDArray[np.int64]:
    """Cell of an object of which every cell of the result takes the data.

    Parameters
    ----------
    ids : (m,) int, optional    place of every optimised cell among so many of the object, ascending
    total : int
    source : (m',) int          optimised cell that each new one comes from
    others : pairs              the same of cells beside them that are other ones now: their places,
                                and which of them each comes from
    """
    if ids is None:
        return source.astype(np.int64)
    other = np.ones(total, dtype=np.bool_)
    other[ids] = False
    for own, _ in others:
        other[own] = False
    return np.sort(np.concatenate([ids[source], *(own[now] for own, now in others),
                                   np.flatnonzero(other)]))
