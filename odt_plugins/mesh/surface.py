"""Triangles in space: the edges of a surface, and the checks it passes on its way in."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from odt_plugins.errors import InvalidMeshError, counted
from odt_plugins.mesh.arrays import BoolArray, IntArray
from odt_plugins.mesh.components import components
from odt_plugins.mesh.numbers import vertex_mask
from odt_plugins.mesh.simplex import (
    SimplexMesh,
    check_vertices,
    compact_labels,
    freeze,
    mesh_arrays,
    refuse_repeated,
    reverse,
)

FEW = 0.05
"""Largest part of the edges whose cells may disagree about the outside and be worked around."""


class Edges(NamedTuple):
    """The edges of triangles, each once.

    Attributes
    ----------
    vertices : (e, 2) int32     smaller index first, in lexical order
    degree : (e,) int32         triangles that hold it
    of_cell : (m, 3) int32      number of the edge opposite to each corner
    forward : (m, 3) bool       whether the triangle runs through it from the smaller index
    neighbors : (m, 3) int32    triangle across, -1 unless exactly two triangles hold the edge
    """

    vertices: IntArray
    degree: IntArray
    of_cell: IntArray
    forward: BoolArray
    neighbors: IntArray


def surface_edges(triangles: IntArray, n: int) -> Edges:
    """List the edges of a surface with ``n`` vertices, manifold or not."""
    m = len(triangles)
    start, end = triangles[:, [1, 2, 0]], triangles[:, [2, 0, 1]]
    forward = start < end
    low, high = np.where(forward, start, end).ravel(), np.where(forward, end, start).ravel()
    key = low.astype(np.int64) * n + high
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    fresh = np.ones(3 * m, dtype=np.bool_)
    fresh[1:] = ordered[1:] != ordered[:-1]
    number = np.empty(3 * m, dtype=np.int32)
    number[order] = np.cumsum(fresh, dtype=np.int32) - 1
    first = np.flatnonzero(fresh)
    count = np.diff(np.append(first, 3 * m)).astype(np.int32)
    neighbors = np.full(3 * m, -1, dtype=np.int32)
    two = first[count == 2]
    a, b = order[two], order[two + 1]
    neighbors[a], neighbors[b] = b // 3, a // 3
    head = order[first]
    return Edges(
        np.stack([low[head], high[head]], axis=1),
        count,
        number.reshape(m, 3),
        forward,
        neighbors.reshape(m, 3),
    )


def surface_mesh(
    points: ArrayLike,
    cells: ArrayLike,
    *,
    regions: ArrayLike | None = None,
    fixed: ArrayLike | None = None,
    selection: ArrayLike | None = None,
    orient: bool = False,
) -> SimplexMesh:
    """Check a curved surface and bring it into the form the engine works on.

    Parameters
    ----------
    points : (n, 3) float32 or float64
    cells : (m, 3) int
    regions, fixed, selection              as for :func:`odt_plugins.mesh.simplex.simplex_mesh`
    orient : bool                          turn triangles so that neighbours agree

    Returns
    -------
    SimplexMesh                            triangles that run through every edge of two triangles
                                           once each way. Flat triangles, rims, edges of more than
                                           two triangles, vertices where several fans of triangles
                                           meet, and vertices of no triangle are allowed. Where few
                                           neighbours disagree about the outside, they are frozen

    Raises
    ------
    InvalidMeshError                       wrong shapes, types, indices, coordinates; repeated
                                           triangles; many neighbours that disagree about the
                                           outside; with ``orient`` a surface with one side only
    InvalidOptionError                     `regions`, `fixed` or `selection` does not fit the mesh
    """
    p, t = mesh_arrays(points, cells)
    n = len(p)
    check_vertices(t)
    refuse_repeated(t, n)
    if (p[t] == p[t[0, 0]]).all():
        msg = (f"got {counted(len(t), 'cell')} (first: cell 0) with all vertices at one place; "
               f"expected a surface")
        raise InvalidMeshError(msg)
    edges = surface_edges(t, n)
    count = 0
    turned = opposed(edges)
    if turned.size and orient:
        against = to_turn(t, edges)
        if against is not None:
            t, count = reverse(t, against), int(against.sum())
            edges, turned = surface_edges(t, n), turned[:0]
    few = turned.size <= FEW * len(edges.degree)
    if turned.size and not few:
        a, b = edges.vertices[turned[0]].tolist()
        what, hope = ("disagree about the outside", "one orientation, try repair='orient'")
        if orient:
            what, hope = ("disagree however they are turned, as on a Moebius strip, non-orientable",
                          "two sides, try cutting it open")
        msg = (f"got {counted(turned.size, 'edge')} (first: the edge of vertices {a} and {b}) "
               f"whose two cells {what}; expected {hope}")
        raise InvalidMeshError(msg)
    mesh = SimplexMesh(
        points=p,
        cells=t,
        regions=compact_labels(regions, len(t)),
        fixed=vertex_mask(fixed, n, "fixed", "vertices"),
        turned=count,
    )
    if selection is not None:
        mesh = freeze(mesh, ~vertex_mask(selection, len(t), "selection", "cells"))
    if turned.size:
        around = np.zeros(len(edges.degree), dtype=np.bool_)
        around[turned] = True
        mesh = freeze(mesh, mesh.frozen | around[edges.of_cell].any(axis=1))
    return mesh


def disagreeing_edges(mesh: SimplexMesh) -> IntArray:
    """Edges (k, 2) of two triangles that disagree about the outside."""
    edges = surface_edges(mesh.cells, len(mesh.points))
    return edges.vertices[opposed(edges)]


def ways_out(mesh: SimplexMesh) -> str:
    """What helps where triangles disagree about the outside."""
    turned = to_turn(mesh.cells, surface_edges(mesh.cells, len(mesh.points)))
    return "removing them" if turned is None else "repair='orient', or removing them"


def opposed(edges: Edges) -> NDArray[np.intp]:
    """Edges of two triangles that run through them the same way."""
    ways = np.bincount(edges.of_cell.ravel(), edges.forward.ravel(), minlength=len(edges.degree))
    return np.flatnonzero((edges.degree == 2) & (ways != 1))


def to_turn(t: IntArray, edges: Edges) -> BoolArray | None:
    """Triangles to turn so that neighbours agree: the smaller part of every connected piece.

    None where there is no such choice.
    """
    m = len(t)
    cell, corner = np.nonzero(edges.neighbors >= 0)
    other = edges.neighbors[cell, corner]
    across = edges.of_cell[other] == edges.of_cell[cell, corner][:, None]
    same_way = edges.forward[cell, corner] == edges.forward[other][across]
    # every triangle twice, as it is and turned; neighbours that agree are joined like with like
    turned = same_way.astype(np.int64)
    rows = np.concatenate([cell, cell + m])
    columns = np.concatenate([other + turned * m, other + (1 - turned) * m])
    piece = components(rows, columns, 2 * m)
    if (piece[:m] == piece[m:]).any():
        return None
    # of the two ways to orient a piece take the one that leaves more triangles as they are
    kept = np.bincount(piece[:m], minlength=int(piece.max()) + 1)
    as_is, flipped = kept[piece[:m]], kept[piece[m:]]
    return np.asarray((as_is < flipped) | ((as_is == flipped) & (piece[:m] > piece[m:])))
