"""On which side of a seam vertices lie, where triangles on both have vertices of their own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.surface.judge import barycentric, feet_on
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.components import components
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.surface import surface_edges

INWARDS = 1e-3
"""How far from an open edge to the middle of its triangle one sees on which side of a seam it is.

Places of single precision are off by less.
"""


def on_own_side(
    old: FloatArray, rows: IntArray, feet: tuple[IntArray, FloatArray], points: FloatArray,
    cells: NDArray[np.integer], vertices: NDArray[np.integer],
) -> tuple[IntArray, FloatArray]:
    """Feet of vertices of a new surface on its old triangles, on the side where they belong.

    Parameters
    ----------
    old : (n, 3), rows : (m, 3)         old surface
    feet : (k,) int32, (k, 3) float64   old triangles closest to the vertices, and barycentric
                                        coordinates there
    points : (n', 3), cells : (m', 3)   new surface
    vertices : (k,) int

    Returns
    -------
    face : (k,) int32, weights : (k, 3) float64    others at open edges where triangles that do not
                                                   share their vertices lie at the same place
    """
    face, weights = feet
    row, inner = _beside_open_edges(points, cells, vertices)
    if not len(row):
        return feet
    own, _ = feet_on(old, rows, inner)
    far = weights[row] > INWARDS
    shared = (rows[face[row], :, None] == rows[own][:, None, :]).any(axis=2)
    other = (far & ~shared).any(axis=1) & ~far.all(axis=1)
    before, after = patches(old, rows, points, cells)
    least, most = np.full(len(points), len(rows)), np.full(len(points), -1)
    for corner in cells.T:
        np.minimum.at(least, corner, after)
        np.maximum.at(most, corner, after)
    wanted = np.full(len(vertices), -1)
    wanted[row] = np.where(least == most, most, -1)[vertices[row]]
    row, own = row[other], own[other]
    there = np.maximum(barycentric(old, rows[own], points[vertices[row]]), 0.0)
    face, weights = face.copy(), weights.copy()
    face[row], weights[row] = own, there / there.sum(axis=1)[:, None]
    wrong = (wanted >= 0) & (before[face] != wanted)
    for patch in np.unique(wanted[wrong]).tolist():
        part, here = np.flatnonzero(before == patch), np.flatnonzero(wrong & (wanted == patch))
        foot, weights[here] = feet_on(old, rows[part], points[vertices[here]])
        face[here] = part[foot]
    return face, weights


def patches(
    old: FloatArray, rows: IntArray, points: FloatArray, cells: NDArray[np.integer]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Patch (m,) of old triangles, which hang together over edges, and (m',) of new ones.

    Parameters
    ----------
    old : (n, 3), rows : (m, 3)         old surface
    points : (n', 3), cells : (m', 3)   new surface, whose patches are numbered as those of the old
                                        one under most of their triangles
    """
    before = _connected(rows, len(old))
    if not before.any():
        return before, np.zeros(len(cells), dtype=np.int64)
    after = _connected(cells, len(points))
    under = before[feet_on(old, rows, points[cells].mean(axis=1))[0]]
    pairs, votes = np.unique(np.stack([after, under], axis=1), axis=0, return_counts=True)
    pairs = pairs[np.argsort(votes, kind="stable")]
    became = np.zeros(len(cells), dtype=np.int64)
    became[pairs[:, 0]] = pairs[:, 1]
    return before, became[after]


def _connected(cells: NDArray[np.integer], n: int) -> NDArray[np.int64]:
    """Number (m,) of the patch of every triangle."""
    across = surface_edges(cells.astype(np.int32), n).neighbors
    triangle, corner = np.nonzero(across >= 0)
    return components(triangle, across[triangle, corner], len(cells)).astype(np.int64)


def _beside_open_edges(
    points: FloatArray, cells: NDArray[np.integer], vertices: NDArray[np.integer]
) -> tuple[NDArray[np.int64], FloatArray]:
    """Which of some vertices are on open edges, and a place (k, 3) inside near each of these."""
    n = len(points)
    ends = np.sort(cells[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    first, count = np.unique(row_keys(ends, n), return_index=True, return_counts=True)[1:]
    edge = first[count == 1]
    middle = points[cells[edge // 3]].mean(axis=1)
    away, edges = np.zeros((n, 3)), np.zeros(n)
    for vertex in ends[edge].T:
        np.add.at(away, vertex, middle - points[vertex])
        np.add.at(edges, vertex, 1.0)
    row = np.flatnonzero(edges[vertices])
    vertex = vertices[row]
    return row, points[vertex] + INWARDS * away[vertex] / edges[vertex, None]
