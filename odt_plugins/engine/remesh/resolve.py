"""More vertices for a mesh whose edges are too long for the sizes along them."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np

from odt_plugins.engine.cells.content import cells_of_sizes
from odt_plugins.engine.remesh.sizes import (
    Sizes,
    grown,
    lengths_at,
    lengths_of,
    unique_edges,
)
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.faces import Faces
from odt_plugins.mesh.simplex import SimplexMesh, with_vertices
from odt_plugins.mesh.surface import surface_edges

APART = 1.3
"""Ratio of the size in the middle of an edge to the mean of those at its ends from which on the
edge is halved."""

HALVINGS = 40
"""Most times that edges are halved, one in a cell at a time."""

LEVEL = 1.0 - 1e-9
"""Cosine of the angle between two triangles from which on these are in one plane."""


def resolved(
    mesh: SimplexMesh, sizes: Sizes, most: FloatArray, given: Any = None,
    most_cells: float = math.inf,
) -> tuple[SimplexMesh, Sizes]:
    """Halve edges along which sizes are not linear; the domain stays as it is.

    In the middle of an edge of length L the size is the mean of those asked for, at most the mean
    of what the envelope allows at its ends, and at most h + (growth - 1) L / 2 for the size h at
    either end. A plane part of a surface that is wider has no bound by the envelope inside.
    Needles of CAD, and flat sides without vertices inside, have such edges.

    Parameters
    ----------
    mesh : SimplexMesh            of any kind
    sizes : Sizes                 at its vertices
    most : (n,) float64           lengths that the envelope allows, inf without bound
    given : callable, optional    what is asked for at points (k, d)
    most_cells : float            cells that the sizes make from which on no edges are halved

    Returns
    -------
    finer : SimplexMesh    with the new vertices behind those of the mesh
    sizes : Sizes          at its vertices
    """
    stays, edges = _stays(mesh), unique_edges(mesh.cells)
    for _ in range(HALVINGS):
        low, high = edges.T
        length = lengths_of(mesh.points, edges)
        ends = sizes.values[edges]
        middle = 0.5 * (mesh.points[low] + mesh.points[high])
        wish = 0.5 * (sizes.asked[low] + sizes.asked[high])
        if given is not None:
            wish = lengths_at(given, middle, np.arange(len(middle), dtype=np.int32))
        size = np.minimum(wish, ends.min(axis=1) + 0.5 * (sizes.growth - 1.0) * length)
        long = (length > ends.min(axis=1)) & ~np.isin(_keys(edges), stays)
        if not (long & _apart(size, ends)).any():
            break
        allowed = _between(most[low], most[high])
        if mesh.is_surface:
            allowed[_widths(mesh, length) > allowed] = np.inf
        which = _one_in_a_cell(
            mesh.cells, edges, long & _apart(np.minimum(size, allowed), ends), length)
        if not len(which):
            break
        mesh = _halved(mesh, edges[which], middle[which])
        edges = unique_edges(mesh.cells)
        asked = np.concatenate([sizes.asked, wish[which]])
        most = np.concatenate([most, allowed[which]])
        values = grown(mesh.points, edges, np.minimum(asked, most), sizes.growth)
        cells = cells_of_sizes(mesh.points, mesh.cells, values)
        sizes = replace(sizes, values=values, asked=asked, cells=cells)
        if cells > most_cells:
            break
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
    """Keys of the edges that must not be split: marked edges, and edges of frozen cells."""
    frozen = mesh.cells[mesh.frozen]
    sides = [rows[:, list(pair)] for rows in (frozen, mesh.stays, mesh.lines)
             for pair in combinations(range(rows.shape[1]), 2)]
    return _keys(np.concatenate(sides))


def _between(one: FloatArray, two: FloatArray) -> FloatArray:
    """Means of two lengths; where one has no bound, the other one."""
    low = np.minimum(one, two)
    return np.where(np.isfinite(np.maximum(one, two)), 0.5 * (one + two), low)


def _widths(mesh: SimplexMesh, length: FloatArray) -> FloatArray:
    """Widths (e,) of the plane parts of a surface in which edges are, 0 of all other edges.

    Twice the area of a part by the length of its border: the width of a long strip.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    edges = surface_edges(mesh.cells, len(mesh.points))
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


def _one_in_a_cell(
    cells: IntArray, edges: IntArray, marked: BoolArray, length: FloatArray
) -> IntArray:
    """Marked edges, ascending, that are the longest marked edge of each of their cells."""
    rank = np.empty(len(edges), dtype=np.int64)
    rank[np.argsort(np.where(marked, length, -1.0), kind="stable")] = np.arange(len(edges))
    sides = _sides(cells, edges)
    best = rank[sides].max(axis=1)
    beaten = np.zeros(len(edges), dtype=np.bool_)
    for side in sides.T:
        beaten[side[rank[side] < best]] = True
    return np.flatnonzero(marked & ~beaten).astype(np.int32)


def _sides(cells: IntArray, edges: IntArray) -> IntArray:
    """Number (m, d (d + 1) / 2) of each edge of the cells among all edges, which are in order."""
    known = _keys(edges)
    return np.stack([np.searchsorted(known, _keys(cells[:, list(pair)]))
                     for pair in combinations(range(cells.shape[1]), 2)], axis=1)


def _halved(mesh: SimplexMesh, edges: IntArray, middle: FloatArray) -> SimplexMesh:
    """Halve edges, one in a cell at most: the second halves of cells stand at the end."""
    n = len(mesh.points)
    cells, was = _halves(mesh.cells, edges, n)
    lines, triangles = (
        Faces(rows, faces.labels[own]) for faces in mesh.faces
        for rows, own in [_halves(faces.rows, edges, n)])
    return replace(
        with_vertices(mesh, np.concatenate([mesh.points, middle])), cells=cells,
        regions=mesh.regions[was], frozen=mesh.frozen[was], faces=(lines, triangles))


def _halves(rows: IntArray, edges: IntArray, n: int) -> tuple[IntArray, IntArray]:
    """Rows (k, c) where edges have new vertices n, n + 1, ...; also the row that each was."""
    known = _keys(edges)
    first, seconds, own = rows.copy(), [], [np.arange(len(rows))]
    for a, b in combinations(range(rows.shape[1]), 2):
        key = _keys(rows[:, [a, b]])
        at = np.minimum(np.searchsorted(known, key), len(known) - 1)
        cut = np.flatnonzero(known[at] == key)
        first[cut, b] = n + at[cut]
        second = rows[cut].copy()
        second[:, a] = n + at[cut]
        seconds.append(second)
        own.append(cut)
    return np.ascontiguousarray(np.concatenate([first, *seconds])), np.concatenate(own)
