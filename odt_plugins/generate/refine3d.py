"""Uniform (red) refinement of triangles and tetrahedra: every edge is halved.

A tetrahedron is cut into four at its corners and an octahedron in the middle, which is cut into
four more around one of its three diagonals. A fixed diagonal makes shapes worse at each level;
the one that leaves the best worst of the four keeps them bounded.

References
----------
J. Bey, Tetrahedral grid refinement, Computing 55 (1995) 355-378, doi:10.1007/BF02238487.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import InvalidMeshError, counted
from odt_plugins.figures import radius_ratio
from odt_plugins.mesh.arrays import FloatArray, IntArray, LongArray

EDGES = {
    2: np.array([[0, 1]]),
    3: np.array([[1, 2], [2, 0], [0, 1]]),
    4: np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]),
}
"""Edges of a line, a triangle and a tetrahedron; that of a triangle is opposite to its corner.
Their mid-nodes are numbered in this order after the corners."""

CHILDREN = {
    1: np.array([[0]]),
    2: np.array([[0, 2], [2, 1]]),
    3: np.array([[0, 5, 4], [5, 1, 3], [4, 3, 2], [3, 4, 5]]),
    4: np.array([[0, 4, 5, 6], [4, 1, 7, 8], [5, 7, 2, 9], [6, 8, 9, 3]]),
}
"""Parts of a point, a line and a triangle, and those at the corners of a tetrahedron, oriented like
the whole."""

AROUND_DIAGONAL = np.array([
    [[4, 9, 5, 6], [4, 9, 7, 5], [4, 9, 8, 7], [4, 9, 6, 8]],
    [[5, 8, 6, 4], [5, 8, 9, 6], [5, 8, 7, 9], [5, 8, 4, 7]],
    [[6, 7, 4, 5], [6, 7, 8, 4], [6, 7, 9, 8], [6, 7, 5, 9]],
])
"""The octahedron cut along each of its diagonals, mid-nodes of opposite edges."""

MOST_CELLS = 200_000_000
"""More cells than this are refused before anything is made."""

CHUNK = 1 << 16

TIE = 1e-9
"""Difference of radius ratios that is rounding: a tie does not depend on it.

A regular tetrahedron has three equal diagonals, and so have all meshes of its parts."""


class Refined(NamedTuple):
    """A mesh whose edges were halved.

    Attributes
    ----------
    points : (n + e, D) float64      the old vertices, then the mid-point of every edge
    cells : (c m, k) int             the parts of cell i are rows c i, ..., c i + c - 1, with c
                                     = 4 for triangles and 8 for tetrahedra, oriented like it
    edges : (e, 2) int64             ends of the edges, lower first, in increasing order
    """

    points: FloatArray
    cells: IntArray
    edges: LongArray


def red_refinement(points: FloatArray, cells: IntArray) -> Refined:
    """Halve every edge of a mesh of triangles or tetrahedra.

    Parameters
    ----------
    points : (n, D) float64     D = 2 or 3
    cells : (m, k) int32        k = 3 or 4, of any orientation

    Returns
    -------
    Refined                     conforming if the input is: the cut of a facet depends on nothing
                                but its vertices
    """
    n, (m, k) = len(points), cells.shape
    edges, number = numbered_edges(cells, n)
    new = np.empty((n + len(edges), points.shape[1]))
    new[:n] = points
    new[n:] = 0.5 * (points[edges[:, 0]] + points[edges[:, 1]])
    nodes = np.concatenate([cells, n + number], axis=1).astype(np.int32)
    out = np.empty((m, 1 << (k - 1), k), dtype=np.int32)
    out[:, : len(CHILDREN[k])] = nodes[:, CHILDREN[k]]
    if k == 4:
        for start in range(0, m, CHUNK):
            part = nodes[start : start + CHUNK]
            inner = AROUND_DIAGONAL[best_diagonals(new, part)]
            out[start : start + CHUNK, 4:] = part[np.arange(len(part))[:, None, None], inner]
    return Refined(new, out.reshape(-1, k), edges)


def numbered_edges(cells: IntArray, n: int) -> tuple[LongArray, LongArray]:
    """List the edges of a mesh of n vertices.

    Returns
    -------
    edges : (e, 2) int64      ends, lower first, in increasing order
    number : (m, q) int64     number of every edge of every cell, as in ``EDGES``
    """
    ends = np.sort(cells[:, EDGES[cells.shape[1]]].astype(np.int64), axis=2)
    keys, number = np.unique(ends[..., 0] * n + ends[..., 1], return_inverse=True)
    return np.stack([keys // n, keys % n], axis=1), number.reshape(ends.shape[:2])


def best_diagonals(points: FloatArray, nodes: IntArray) -> LongArray:
    """Choose the diagonal of every inner octahedron whose worst tetrahedron is best.

    Parameters
    ----------
    points : (n, 3) float64
    nodes : (m, 10) int32       corners and mid-nodes

    Returns
    -------
    (m,) int64                  0, 1 or 2, see ``AROUND_DIAGONAL``; of equal ones the first
    """
    worst = np.stack([
        np.min([radius_ratio(points, nodes[:, rows]) for rows in around], axis=0)
        for around in AROUND_DIAGONAL
    ])
    return (worst - TIE * np.arange(3)[:, None]).argmax(axis=0)


def refined_rows(rows: NDArray[np.integer], edges: LongArray, n: int) -> NDArray[np.int64]:
    """Refine points, lines or triangles that lie on a mesh with it.

    Parameters
    ----------
    rows : (q, r) int        r = 1, 2, 3: vertices of points, lines or triangles
    edges : (e, 2) int64     of the mesh, see :class:`Refined`
    n : int                  vertices before

    Returns
    -------
    (c q, r) int64           c = 1, 2, 4; the parts of row i are c i, ..., c i + c - 1

    Raises
    ------
    InvalidMeshError         an edge of a line or triangle is none of the mesh
    """
    rows = nodes = rows.astype(np.int64)
    if rows.shape[1] > 1:
        ends = np.sort(rows[:, EDGES[rows.shape[1]]], axis=2)
        keys = edges[:, 0] * n + edges[:, 1]
        asked = ends[..., 0] * n + ends[..., 1]
        place = np.minimum(np.searchsorted(keys, asked), len(keys) - 1)
        missing = np.flatnonzero((keys[place] != asked).any(axis=1))
        if missing.size:
            kind = {2: "line", 3: "triangle"}[rows.shape[1]]
            msg = (f"got {counted(missing.size, kind)} (first: {rows[missing[0]].tolist()}) with "
                   "an edge that no refined cell has; expected lines and triangles on edges and "
                   "faces of the mesh, try removing the others")
            raise InvalidMeshError(msg)
        nodes = np.concatenate([rows, n + place], axis=1)
    return nodes[:, CHILDREN[rows.shape[1]]].reshape(-1, rows.shape[1])


def check_size(m: int, dim: int, levels: int) -> int:
    """Give the number of cells after some levels.

    Raises
    ------
    InvalidMeshError    it is too large
    """
    count = m << (dim * levels)
    if count > MOST_CELLS:
        noun = "triangles" if dim == 2 else "tetrahedra"
        msg = (f"{counted(levels, 'level')} of refinement would make {count} {noun} of {m}; "
               f"expected at most {MOST_CELLS}, try fewer levels or a coarser mesh")
        raise InvalidMeshError(msg)
    return count
