"""Lines and triangles beside the cells that are known by labels, and follow where these are others.

A face with a label may become others of the same label, on the same line or piece of surface.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.mesh.arrays import BoolArray, IntArray, LongArray
from odt_plugins.mesh.components import components
from odt_plugins.mesh.facets import row_keys, sorted_columns


class Faces(NamedTuple):
    """Faces with labels, each once.

    Attributes
    ----------
    rows : (k, r) int32      vertices; r = 2 of lines, 3 of triangles
    labels : (k,) int32      0, 1, ...
    """

    rows: IntArray
    labels: IntArray


def no_faces() -> tuple[Faces, Faces]:
    """Neither lines nor triangles."""
    one, other = (Faces(np.zeros((0, size), dtype=np.int32), np.zeros(0, dtype=np.int32))
                  for size in (2, 3))
    return one, other


def renumbered(faces: Faces, number: NDArray[np.integer]) -> Faces:
    """Faces of vertices with other numbers, without those that have a vertex of number -1."""
    rows = number[faces.rows].astype(np.int32)
    there = (rows >= 0).all(axis=1)
    return Faces(rows[there], faces.labels[there])


def without(faces: Faces, rows: IntArray) -> Faces:
    """Those of the faces that none of the rows (k, r) are."""
    left = labels_at(faces.rows, Faces(rows, np.zeros(len(rows), dtype=np.int32))) < 0
    return Faces(faces.rows[left], faces.labels[left])


def joined(one: Faces, other: Faces) -> Faces:
    """Both."""
    return Faces(*(np.concatenate(pair) for pair in zip(one, other, strict=True)))


def labels_at(rows: NDArray[np.integer], faces: Faces) -> IntArray:
    """Label (k,) of the face that each row (k, r) is, in any order of its vertices; -1 of none."""
    out = np.full(len(rows), -1, dtype=np.int32)
    if len(rows) and len(faces.rows):
        both = np.sort(np.concatenate([faces.rows, rows]), axis=1)
        key = row_keys(both, int(both.max()) + 1)
        known, key = key[: len(faces.rows)], key[len(faces.rows):]
        order = np.argsort(known, kind="stable")
        place = np.minimum(np.searchsorted(known, key, sorter=order), len(known) - 1)
        found = known[order[place]] == key
        out[found] = faces.labels[order[place]][found]
    return out


def ends_of(lines: Faces, n: int) -> BoolArray:
    """Vertices (n,) at which lines end, branch, or have another label on the other side."""
    out = np.zeros(n, dtype=np.bool_)
    if len(lines.rows):
        label, vertex = np.repeat(lines.labels, 2), lines.rows.ravel()
        pairs, count = np.unique(np.stack([label, vertex], axis=1), axis=0, return_counts=True)
        out[pairs[count != 2, 1]] = True
        vertices, labels = np.unique(pairs[:, 1], return_counts=True)
        out[vertices[labels > 1]] = True
    return out


def borders_of(triangles: Faces) -> IntArray:
    """Edges (k, 2) of triangles at which there is not just another one of the same label."""
    edges = np.sort(triangles.rows[:, [[0, 1], [0, 2], [1, 2]]].reshape(-1, 2), axis=1)
    every, number, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    labels, number = np.repeat(triangles.labels, 3), number.ravel()
    first = np.zeros(len(every), dtype=np.int32)
    first[number] = labels
    differ = np.zeros(len(every), dtype=np.bool_)
    differ[number[labels != first[number]]] = True
    return np.asarray(every[(count != 2) | differ])


def turns_of(rows: NDArray[np.integer], facets: IntArray) -> tuple[BoolArray, BoolArray]:
    """Which rows (k, d) are among such facets (q, d), and which of those the other way round."""
    number = labels_at(rows, Faces(facets, np.arange(len(facets), dtype=np.int32)))
    odd = sorted_columns(facets)[1]
    found = number >= 0
    turned = np.zeros(len(rows), dtype=np.bool_)
    turned[found] = sorted_columns(rows)[1][found] ^ odd[number[found]]
    return found, turned


class Pieces(NamedTuple):
    """Triangles of surfaces.

    Attributes
    ----------
    rows : (k, 3) int32      turned alike within a piece
    piece : (k,) int32       piece of surface of each, such as that between two regions
    """

    rows: IntArray
    piece: IntArray


def followed(before: Pieces, labels: IntArray, after: Pieces, n: int) -> IntArray | None:
    """Label of every triangle of a surface whose edges were flipped, but none between two labels.

    Parameters
    ----------
    before, after : Pieces      of the same pieces, with the same vertices
    labels : (k,) int32         of the triangles before
    n : int                     vertices

    Returns
    -------
    (k',) int32, or None        where these contradict each other

    Notes
    -----
    Triangles that hang together over edges that are no border have one label: that on the same side
    of a border, or where there is none that of a vertex.
    """
    m = len(after.rows)
    size = max(n, int(after.piece.max(initial=0)) + 1, int(before.piece.max(initial=0)) + 1)
    (old_sides, of_old), (new_sides, of_new) = _sides(before), _sides(after)
    edges = np.concatenate([old_sides, new_sides])
    edges[:, 1:].sort(axis=1)
    edge = np.unique(row_keys(edges, size), return_inverse=True)[1].ravel()
    old, new = edge[: len(old_sides)], edge[len(old_sides):]
    count = int(edge.max(initial=-1)) + 1
    least, most = _range(labels[of_old], old, count)
    border = least < most
    free = ~border[new]
    part = components(of_new[free], m + new[free], m + count)[:m]
    on_border = np.zeros(n, dtype=np.bool_)
    on_border[old_sides[border[old], 1:]] = True

    def marks(pieces: Pieces, sides: LongArray, kept: BoolArray) -> tuple[LongArray, LongArray]:
        """Sides of borders and other vertices, as rows, and the triangles that they are of."""
        owner = np.repeat(np.arange(len(pieces.rows)), 3)
        vertex = pieces.rows.ravel()
        alone = ~on_border[vertex]
        rows = np.column_stack([pieces.piece[owner], vertex, vertex])[alone]
        return np.concatenate([sides[kept], rows]), np.concatenate([owner[kept], owner[alone]])

    was, of_was = marks(before, old_sides, border[old])
    now, of_now = marks(after, new_sides, border[new])
    name = np.unique(row_keys(np.concatenate([was, now]), size), return_inverse=True)[1].ravel()
    label = np.full(int(name.max(initial=-1)) + 1, -2, dtype=np.int32)
    label[name[: len(was)]] = labels[of_was]
    told = label[name[len(was):]]
    known = told > -2
    least, most = _range(told[known], part[of_now[known]], int(part.max(initial=-1)) + 1)
    return None if (least != most).any() else most[part]


def _sides(pieces: Pieces) -> tuple[LongArray, LongArray]:
    """Piece, start and end of the edges of all triangles, in their sense, and the triangles."""
    owner = np.repeat(np.arange(len(pieces.rows)), 3)
    ends = pieces.rows[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2)
    return np.column_stack([pieces.piece[owner], ends]).astype(np.int64), owner


def _range(values: IntArray, where: NDArray[np.integer], count: int) -> tuple[IntArray, IntArray]:
    """Least and largest of the values at each of so many places, crossed where none is."""
    least = np.full(count, np.iinfo(np.int32).max, dtype=np.int32)
    most = np.full(count, np.iinfo(np.int32).min, dtype=np.int32)
    np.minimum.at(least, where, values)
    np.maximum.at(most, where, values)
    return least, most
