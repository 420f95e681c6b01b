"""Where the triangles of a result lie on those of the input, for their texture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.host import Feet, HostMesh
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.simplex import SimplexMesh

INWARDS = 1e-3
"""How far from an open edge to the middle of its triangle one sees on which side of a seam it is.

Places of single precision are off by less.
"""


def feet_of(
    host: HostMesh, mesh: SimplexMesh, points: FloatArray, cells: IntArray,
    origin: NDArray[np.int64] | None, *, follow: bool, soup: bool,
) -> Feet | None:
    """Feet of the vertices that moved along a textured surface or in its plane, or came.

    Where triangles on both sides of a seam have vertices of their own, at the same places, those
    lie on their side.

    Parameters
    ----------
    host, mesh : HostMesh, SimplexMesh    the input as it came and as the engine reads it
    points : (n', d) float64, cells : (m', 3) int
    origin : (n',) int or None            input vertex of every vertex where some came or went
    follow : bool                         whether those in a plane follow where none came or went
    soup : bool                           whether cells that meet do not share their vertices

    Returns
    -------
    Feet                                  None where no texture coordinates are others
    """
    stay = not (mesh.is_surface or follow or origin is not None)
    if not host.textured or host.cells.shape[1] != 3 or stay:
        return None
    from odt_plugins.engine.surface.in_plane import in_space
    from odt_plugins.engine.surface.judge import barycentric, feet_on

    old, points = in_space(mesh.points), in_space(points)
    known = old if origin is None else old[origin]
    mask = (points != known).any(axis=1)
    moved = np.flatnonzero(mask if origin is None else mask | (origin < 0))
    if not moved.size and origin is None:
        return None
    rows = host.cells.astype(np.int32)
    middle = points[cells].mean(axis=1)
    row, inner = (_beside_open_edges(points, cells, moved, middle) if not soup
                  else (moved[:0], middle[:0]))
    face, weights = feet_on(old, rows, np.concatenate([points[moved], middle, inner]))
    face, under, own = np.split(face, [len(moved), len(moved) + len(cells)])
    weights = weights[:len(moved)]
    far = weights[row] > INWARDS
    shared = (rows[face[row], :, None] == rows[own][:, None, :]).any(axis=2)
    other = (far & ~shared).any(axis=1) & ~far.all(axis=1)
    row, own = row[other], own[other]
    there = np.maximum(barycentric(old, rows[own], points[moved[row]]), 0.0)
    face[row], weights[row] = own, there / there.sum(axis=1)[:, None]
    corners = [barycentric(old, rows[under], points[cells[:, i]]) for i in range(3)]
    return Feet(moved, face, weights, under, np.stack(corners, axis=1), origin)


def _beside_open_edges(
    points: FloatArray, cells: IntArray, vertices: NDArray[np.int64], middle: FloatArray
) -> tuple[NDArray[np.int64], FloatArray]:
    """Which of some vertices are on open edges, and a place (k, 3) inside near each of these."""
    n = len(points)
    ends = np.sort(cells[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    first, count = np.unique(row_keys(ends, n), return_index=True, return_counts=True)[1:]
    edge = first[count == 1]
    away, edges = np.zeros((n, 3)), np.zeros(n)
    for vertex in ends[edge].T:
        np.add.at(away, vertex, middle[edge // 3] - points[vertex])
        np.add.at(edges, vertex, 1.0)
    row = np.flatnonzero(edges[vertices])
    vertex = vertices[row]
    return row, points[vertex] + INWARDS * away[vertex] / edges[vertex, None]
