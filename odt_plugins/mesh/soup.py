"""Soups: cells that do not share their vertices, although they meet."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import counted
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.simplex import SimplexMesh, freeze, with_same_cells

HELD = "stay, so that patches do not come apart there; try merging vertices at the same place"
"""What is told of vertices that are held since they share their places."""


def same_places(
    points: NDArray[np.floating], cells: NDArray[np.integer]
) -> NDArray[np.int64] | None:
    """Find the vertices that a soup has several times.

    A mesh is a soup when more than half of its facets are of one cell, and more than half of those
    are no longer once vertices with equal coordinates count as one. Cracks, and seams of a texture,
    are never that many.

    Parameters
    ----------
    points : (n, D)          finite
    cells : (m, d + 1)       in [0, n)

    Returns
    -------
    (n,) int64 or None       first vertex at the place of every vertex; None for all but soups
    """
    n, d = len(points), cells.shape[1] - 1
    if d * n <= 2 * len(cells):  # open facets in such a number have more vertices
        return None
    alone, facets = _open_facets(cells, n)
    if 2 * alone <= facets:
        return None
    same = first_there(points)
    closed = alone - _open_facets(same[cells], n)[0]
    return same if 2 * closed > alone else None


def twins(points: NDArray[np.floating], cells: NDArray[np.integer]) -> NDArray[np.int64]:
    """Vertices (k,) of cells (m, d + 1) that share their place with one of no cell of theirs.

    Patches that meet there come apart where such vertices move each by itself.
    """
    used, rows = np.unique(cells, return_inverse=True)
    first = first_there(points[used])
    count = np.bincount(first, minlength=len(used))
    place = first[rows.reshape(cells.shape)]
    for i, j in combinations(range(cells.shape[1]), 2):
        count[place[place[:, i] == place[:, j], i]] = 1
    return np.asarray(used[count[first] > 1], dtype=np.int64)


def doubled_edges(
    points: NDArray[np.floating], cells: NDArray[np.integer], copies: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Edges (k, 2) at such :func:`twins` of cells (m, d + 1) that lie on others."""
    corners = list(combinations(range(cells.shape[1]), 2))
    near = cells[np.isin(cells, copies).any(axis=1)]
    edges = np.unique(np.sort(near[:, corners].reshape(-1, 2), axis=1), axis=0)
    return np.asarray(edges[doubled_rows(points, edges, copies)], dtype=np.int64)


def doubled_rows(
    points: NDArray[np.floating], rows: NDArray[np.integer], copies: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Which of different edges or cells (k, j) share the places of all corners, some of them such
    :func:`twins`, with another one.
    """
    there = np.arange(len(points))
    there[copies] = copies[first_there(points[copies])]
    out = np.zeros(len(rows), dtype=np.bool_)
    near = np.flatnonzero(np.isin(rows, copies).any(axis=1))
    _, place, count = np.unique(
        np.sort(there[rows[near]], axis=1), axis=0, return_inverse=True, return_counts=True)
    out[near] = count[place.ravel()] > 1
    return out


def hold_twins(mesh: SimplexMesh, copies: NDArray[np.int64]) -> SimplexMesh:
    """Fix such :func:`twins`, and let edges and facets stay that share their places with others."""
    facets = mesh.cells if mesh.is_surface else mesh.uneven.open
    double = doubled_rows(mesh.points, facets, copies)
    edges = doubled_edges(mesh.points, mesh.cells, copies)
    if mesh.is_surface:
        held = with_same_cells(mesh, lines=np.concatenate([mesh.lines, edges.astype(np.int32)]))
        return freeze(held, held.frozen | double, np.append(copies, edges), edges)
    corners = list(combinations(range(facets.shape[1]), 2))
    edges = np.concatenate([edges, facets[double][:, corners].reshape(-1, 2)])
    return freeze(mesh, mesh.frozen, np.append(copies, edges), edges)


def told_of_twins(copies: NDArray[np.int64], told: str) -> str:
    """A note on such :func:`twins`, and what is told of them."""
    count = counted(len(copies), "vertex", "vertices")
    return f"{count} (first: {copies[0]}) at the place of another one {told}"


def first_there(points: NDArray[np.floating]) -> NDArray[np.int64]:
    """First point (n,) with the coordinates of every one."""
    rows = np.ascontiguousarray(points + 0.0)
    raw = rows.view(np.dtype((np.void, rows.dtype.itemsize * rows.shape[1]))).ravel()
    _, first, place = np.unique(raw, return_index=True, return_inverse=True)
    return np.asarray(first[place], dtype=np.int64)


def _open_facets(cells: NDArray[np.integer], n: int) -> tuple[int, int]:
    """How many facets are of one cell, and how many there are."""
    ordered = np.sort(cells, axis=1)
    d = cells.shape[1] - 1
    facets = np.concatenate([ordered[:, columns] for columns in combinations(range(d + 1), d)])
    count = np.unique(row_keys(facets, n), return_counts=True)[1]
    return int((count == 1).sum()), len(count)


def at_copies(
    cells: NDArray[Any], source: NDArray[np.integer], old: NDArray[np.integer],
    same: NDArray[np.int64], charts: NDArray[np.integer] | None = None,
) -> NDArray[Any]:
    """Let the corners of new cells be vertices of a soup again.

    Parameters
    ----------
    cells : (m', d + 1)         new cells, of the first vertices at each place
    source : (m',)              old cell from which each takes its data
    old : (m, d + 1)            old cells, as the soup has them
    same : (n,)                 first vertex at the place of every vertex
    charts : (m,) optional      labels of old cells that shall have no vertices in common

    Returns
    -------
    (m', d + 1)                 the vertex that the source has at this place; where it has none, one
                                that no other new cell has as long as there are such, of a cell with
                                the label of the source if there is one
    """
    out = cells.copy()
    todo = np.ones(cells.shape, dtype=np.bool_)
    before = old[source]
    for i in range(cells.shape[1]):
        for j in range(cells.shape[1]):
            here = same[before[:, j]] == cells[:, i]
            out[here, i] = before[here, j]
            todo[here, i] = False
    labels = np.zeros(len(old), dtype=np.int64) if charts is None else charts
    for label in (labels, np.zeros(len(old), dtype=np.int64)):
        row, corner = np.nonzero(todo)
        if not len(row):
            break
        taken = np.zeros(len(same), dtype=np.bool_)
        taken[out[~todo]] = True
        found, vertex = _offered(cells[row, corner], label[source[row]], old, label, same, taken)
        out[row[found], corner[found]] = vertex
        todo[row[found], corner[found]] = False
    return out


def _offered(
    wanted: NDArray[np.integer], wanted_label: NDArray[np.integer], old: NDArray[np.integer],
    label: NDArray[np.integer], same: NDArray[np.int64], taken: NDArray[np.bool_],
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Which of the wanted places have a vertex of that label, and a vertex for each of these."""
    count = int(label.max()) + 1
    pairs = np.unique(
        np.stack([old.ravel(), np.repeat(label, old.shape[1])], axis=1).astype(np.int64), axis=0)
    key = same[pairs[:, 0]] * count + pairs[:, 1]
    order = np.lexsort((pairs[:, 0], taken[pairs[:, 0]], key))
    key, vertices = key[order], pairs[order, 0]
    sought = wanted.astype(np.int64) * count + wanted_label
    low = np.searchsorted(key, sought, side="left")
    size = np.searchsorted(key, sought, side="right") - low
    found = size > 0
    sought, low, size = sought[found], low[found], size[found]
    turn = np.argsort(sought, kind="stable")
    start = np.searchsorted(sought[turn], sought[turn], side="left")
    rank = np.empty(len(sought), dtype=np.int64)
    rank[turn] = np.arange(len(sought)) - start
    return found, vertices[low + rank % size]
