"""More vertices for a surface whose edges are too long for the sizes along them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from odt_plugins.engine.remesh.sizes import Sizes, grown, lengths_at, lengths_of, unique_edges
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.simplex import SimplexMesh, with_vertices
from odt_plugins.mesh.surface import Edges, surface_edges

APART = 1.3
"""Ratio of the size in the middle of an edge to the mean of those at its ends from which on the
edge is halved."""

HALVINGS = 40
"""Most times that edges are halved, one in a triangle at a time."""

LEVEL = 1.0 - 1e-9
"""Cosine of the angle between two triangles from which on these are in one plane."""


def resolved(
    mesh: SimplexMesh, sizes: Sizes, most: FloatArray, given: Any = None
) -> tuple[SimplexMesh, Sizes]:
    """Halve edges along which sizes are not linear; the surface stays as it is.

    In the middle of an edge of length L the size is the mean of those asked for, at most the mean
    of what the envelope allows at its ends, and at most h + (growth - 1) L / 2 for the size h at
    either end. A plane part of the surface that is wider has no bound by the envelope inside.
    Needles of CAD, and flat sides without vertices inside, have such edges.

    Parameters
    ----------
    mesh : SimplexMesh            triangles in space
    sizes : Sizes                 at its vertices
    most : (n,) float64           lengths that the envelope allows, inf without bound
    given : callable, optional    what is asked for at points (k, 3)

    Returns
    -------
    finer : SimplexMesh    with the new vertices behind those of the mesh
    sizes : Sizes          at its vertices
    """
    stays = _stays(mesh)
    for _ in range(HALVINGS):
        edges = surface_edges(mesh.cells, len(mesh.points))
        low, high = edges.vertices.T
        length = lengths_of(mesh.points, edges.vertices)
        ends = sizes.values[edges.vertices]
        middle = 0.5 * (mesh.points[low] + mesh.points[high])
        wish = 0.5 * (sizes.asked[low] + sizes.asked[high])
        if given is not None:
            wish = lengths_at(given, middle, np.arange(len(middle), dtype=np.int32))
        size = np.minimum(wish, ends.min(axis=1) + 0.5 * (sizes.growth - 1.0) * length)
        long = (length > ends.min(axis=1)) & ~np.isin(_keys(edges.vertices), stays)
        if not (long & _apart(size, ends)).any():
            break
        allowed = _between(most[low], most[high])
        allowed[_widths(mesh, edges, length) > allowed] = np.inf
        which = _one_in_a_triangle(
            edges, long & _apart(np.minimum(size, allowed), ends), length)
        if not len(which):
            break
        mesh = _halved(mesh, edges, which, middle[which])
        asked = np.concatenate([sizes.asked, wish[which]])
        most = np.concatenate([most, allowed[which]])
        values = grown(mesh.points, unique_edges(mesh.cells), np.minimum(asked, most), sizes.growth)
        sizes = replace(sizes, values=values, asked=asked)
    return mesh, sizes


def _apart(size: FloatArray, ends: FloatArray) -> BoolArray:
    """Whether sizes (e,) in the middle are much larger or smaller than the mean of the ends'."""
    mean = 0.5 * ends.sum(axis=1)
    return np.asarray((size > APART * mean) | (mean > APART * size))


def _keys(pairs: IntArray) -> IntArray:
    """A number for every edge (e, 2)."""
    low, high = np.sort(pairs.astype(np.int64), axis=1).T
    return np.asarray((low << 32) + high)


def _stays(mesh: SimplexMesh) -> IntArray:
    """Numbers of the edges that must stay whole: marked, labelled, or of triangles that stay."""
    frozen = mesh.cells[mesh.frozen]
    sides = [frozen[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))]
    return _keys(np.concatenate([mesh.stays, mesh.lines, mesh.faces[0].rows, *sides]))


def _between(one: FloatArray, two: FloatArray) -> FloatArray:
    """Means of two lengths, the other one where one is without bound."""
    low = np.minimum(one, two)
    return np.where(np.isfinite(np.maximum(one, two)), 0.5 * (one + two), low)


def _widths(mesh: SimplexMesh, edges: Edges, length: FloatArray) -> FloatArray:
    """Widths (e,) of the plane parts of a surface in which edges are, 0 of all other edges.

    Twice the area of a part by the length of its border: the width of a long strip.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    a, b, c = (mesh.points[mesh.cells[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    double = np.sqrt((normal * normal).sum(axis=1))
    unit = np.divide(normal, double[:, None], out=np.zeros_like(normal),
                     where=double[:, None] > 0.0)
    one, side = np.nonzero(edges.neighbors >= 0)
    two = edges.neighbors[one, side]
    level = (unit[one] * unit[two]).sum(axis=1) > LEVEL
    one, two, inner = one[level], two[level], edges.of_cell[one, side][level]
    m = len(mesh.cells)
    graph = coo_array((np.ones(len(one), dtype=np.bool_), (one, two)), shape=(m, m))
    count, part = connected_components(graph, directed=False)
    border = length.copy()
    border[inner] = 0.0
    around = np.bincount(part, border[edges.of_cell].sum(axis=1), minlength=count)
    area = np.bincount(part, 0.5 * double, minlength=count)
    width = np.divide(2.0 * area, around, out=np.full(count, np.inf), where=around > 0.0)
    out = np.zeros(len(length))
    out[inner] = width[part[one]]
    return out


def _one_in_a_triangle(edges: Edges, marked: BoolArray, length: FloatArray) -> IntArray:
    """Marked edges that are the longest marked one of all their triangles, ascending."""
    score = np.where(marked, length, -1.0)
    order = np.empty(len(score), dtype=np.int64)
    order[np.argsort(score, kind="stable")] = np.arange(len(score))
    best = order[edges.of_cell].max(axis=1)
    least = np.full(len(score), np.iinfo(np.int64).max)
    biggest = np.zeros(len(score), dtype=np.int64)
    for k in range(3):
        np.minimum.at(least, edges.of_cell[:, k], best)
        np.maximum.at(biggest, edges.of_cell[:, k], best)
    return np.flatnonzero(marked & (least == order) & (biggest == order)).astype(np.int32)


def _halved(mesh: SimplexMesh, edges: Edges, which: IntArray, middle: FloatArray) -> SimplexMesh:
    """Halve edges, one in a triangle at most: the second halves of triangles stand at the end."""
    n = len(mesh.points)
    new = np.full(len(edges.vertices), -1, dtype=np.int32)
    new[which] = n + np.arange(len(which), dtype=np.int32)
    corner = new[edges.of_cell]
    cut, side = np.nonzero(corner >= 0)
    vertex = corner[cut, side]
    first, second = mesh.cells[cut].copy(), mesh.cells[cut].copy()
    row = np.arange(len(cut))
    first[row, (side + 2) % 3] = vertex
    second[row, (side + 1) % 3] = vertex
    cells = mesh.cells.copy()
    cells[cut] = first
    return replace(
        with_vertices(mesh, np.concatenate([mesh.points, middle])),
        cells=np.concatenate([cells, second]),
        regions=np.concatenate([mesh.regions, mesh.regions[cut]]),
        frozen=np.concatenate([mesh.frozen, mesh.frozen[cut]]))
