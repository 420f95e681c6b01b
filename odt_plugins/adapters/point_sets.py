"""Sets of points where points were added: those within what the old points of a set make up."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.host import NewVertices, Result
from odt_plugins.mesh.facets import row_keys

ZERO = 1e-9
"""Barycentric coordinates below which a point is on the opposite face."""


def with_added(
    members: NDArray[np.integer], cells: NDArray[np.integer], result: Result,
    vertices: NewVertices, labels: NDArray[np.integer] | None,
    shape: NDArray[np.int64] | None = None,
) -> NDArray[np.int64]:
    """Points of the result that are in a set, those that were added behind those from before.

    A point that was added is in the set where the corners of the input around it all are: those
    of a cell where most points of the set are in cells that it has as a whole, those of a facet
    on the boundary or an interface where most are in such facets.

    Parameters
    ----------
    members : (q,) int           points of the input
    cells : (m, k) int           of the input
    result : Result
    vertices : NewVertices       of that result
    labels : (m,) int or None    regions of the cells of the input
    shape : (k, d + 1) int       whole barycentric weights of the nodes of cells of higher order
    """
    number: NDArray[np.int64] = vertices.number[members]
    number = number[number >= 0]
    new = vertices.origin[vertices.placed] < 0
    if not len(members) or not new.any():
        return number
    n, k = len(vertices.number), cells.shape[1]
    inside = np.zeros(n, dtype=np.bool_)
    inside[members] = True
    away = np.abs(vertices.weights[new]) > ZERO
    joins = (inside[vertices.corners[new]] | ~away).all(axis=1)
    joins &= away.any(axis=1)
    placed = vertices.placed[new]
    if not _filled(cells[inside[cells].all(axis=1)], members, n):
        walls = _walls(cells, labels, n, shape)
        if not _filled(walls[inside[walls].all(axis=1)], members, n):
            return number
        of_cells = None if labels is None else labels[result.source]
        on = np.zeros(len(result.points), dtype=np.bool_)
        on[_walls(result.cells, of_cells, len(result.points), shape)] = True
        joins &= on[placed] & (away.sum(axis=1) < k)
    return np.concatenate([number, placed[joins]])


def _filled(rows: NDArray[np.integer], members: NDArray[np.integer], n: int) -> bool:
    """Whether most members are corners of these rows."""
    corner = np.zeros(n, dtype=np.bool_)
    corner[rows] = True
    return bool(2 * corner[members].sum() > len(members))


def _walls(
    cells: NDArray[np.integer], labels: NDArray[np.integer] | None, n: int,
    shape: NDArray[np.int64] | None
) -> NDArray[np.int64]:
    """Facets of one cell alone, or of two of different labels, with all their nodes."""
    weights = np.eye(cells.shape[1], dtype=np.int64) if shape is None else shape
    d = weights.shape[1]
    facets = np.concatenate([cells[:, weights[:, i] == 0] for i in range(d)]).astype(np.int64)
    own = np.zeros(len(cells), dtype=np.int64) if labels is None else labels
    _, first, inverse, count = np.unique(row_keys(np.sort(facets[:, : d - 1], axis=1), n),
                                         return_index=True, return_inverse=True,
                                         return_counts=True)
    inverse = inverse.ravel()
    label = np.tile(own, d)
    differ = np.zeros(len(first), dtype=np.bool_)
    np.logical_or.at(differ, inverse, label != label[first[inverse]])
    return np.asarray(facets[first[(count == 1) | differ]])
