"""Numbers of vertices when some were removed and others added.

``origin`` (n',) holds the old vertex of every vertex, increasing, and then -1 for the new ones.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.mesh.arrays import FloatArray, IntArray, LongArray
from odt_plugins.mesh.simplex import SimplexMesh

AS_MANY_AS_PAY = 0.5
"""Share of the vertices by which a mesh may grow where every vertex that pays is wanted."""


def most_vertices(n: int, insert: bool | float = True) -> int:
    """Give the number of vertices that a mesh of n vertices may have after insertion.

    Parameters
    ----------
    n : int
    insert : bool or float    the share of n that may come; True for as many as pay
    """
    return n + int((AS_MANY_AS_PAY if insert is True else insert) * n)


def removed_vertices(origin: LongArray, n: int) -> LongArray:
    """List the old vertices below n that are not in ``origin``."""
    there = np.zeros(n, dtype=np.bool_)
    there[origin[origin >= 0]] = True
    return np.flatnonzero(~there)


def old_numbers(origin: LongArray, n: int) -> IntArray:
    """Number of every vertex among the n old ones, removed ones included, and then the new ones."""
    number = origin.astype(np.int32)
    added = origin < 0
    number[added] = n + np.arange(int(added.sum()), dtype=np.int32)
    return number


def new_numbers(origin: LongArray, n: int) -> IntArray:
    """Give the inverse of :func:`old_numbers`; -1 for a removed vertex."""
    number = np.full(n + int((origin < 0).sum()), -1, dtype=np.int32)
    number[old_numbers(origin, n)] = np.arange(len(origin), dtype=np.int32)
    return number


def in_old_numbers(old_points: FloatArray, points: FloatArray, origin: LongArray) -> FloatArray:
    """Points in the order of :func:`old_numbers`; a removed vertex is where it was."""
    n = len(old_points)
    together = np.concatenate([old_points, points[origin < 0]])
    together[old_numbers(origin, n)] = points
    return together


def without_removed(
    before: SimplexMesh, points: FloatArray, cells: IntArray
) -> tuple[FloatArray, IntArray, LongArray | None]:
    """Leave out removed vertices: those that cells had before and have no more.

    Parameters
    ----------
    before : SimplexMesh
    points : (n', d) float64    vertices of the mesh before, then new ones
    cells : (m, d + 1) int32

    Returns
    -------
    points, cells               of the vertices that are left
    origin : (k,) int64         see above; None when the vertices are those of the mesh before
    """
    n = len(before.points)
    used, was = np.zeros(len(points), dtype=np.bool_), np.zeros(len(points), dtype=np.bool_)
    used[cells] = True
    was[n:] = True
    was[before.cells] = True
    left = np.flatnonzero(used | ~was)
    if len(points) == n == len(left):
        return points, cells, None
    number = np.empty(len(points), dtype=np.int32)
    number[left] = np.arange(len(left), dtype=np.int32)
    return points[left], number[cells], np.where(left < n, left, -1).astype(np.int64)
