"""Which block a cell belongs to: bricks first, then what lies around the cuts between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray, LongArray
from odt_plugins.mesh.components import components

RINGS = 3
"""Cells within so many rings of a vertex that was held in every round yet are improved again."""

WORST_RINGS = 3
"""Cells within so many rings of the worst cells of all are improved again in the last round."""


def bricks(points: FloatArray, cells: IntArray, count: int) -> IntArray:
    """Cut cells into bricks of equal numbers, across the longest sides of the mesh.

    Parameters
    ----------
    points : (n, d) float64
    cells : (m, d + 1) int32
    count : int                 of bricks, at most m

    Returns
    -------
    (m,) int32                  brick of every cell, 0 to count - 1
    """
    centres = points[cells[:, 0]].copy()
    for corner in cells.T[1:]:
        centres += points[corner]
    label = np.zeros(len(cells), dtype=np.int32)
    pending = [(np.arange(len(cells)), 0, count)]
    while pending:
        members, first, parts = pending.pop()
        if parts == 1:
            label[members] = first
            continue
        at = centres[members]
        axis = int(np.argmax(at.max(axis=0) - at.min(axis=0)))
        low = parts // 2
        inside = _lowest(at[:, axis], len(members) * low // parts)
        pending.append((members[inside], first, low))
        pending.append((members[~inside], first + low, parts - low))
    return label


def _lowest(values: FloatArray, count: int) -> BoolArray:
    """Say which are the lowest ``count``, fewer than all; of equal ones the first."""
    limit = np.partition(values, count)[count]
    inside: BoolArray = values < limit
    equal = np.flatnonzero(values == limit)
    inside[equal[: count - int(inside.sum())]] = True
    return inside


def clusters(cells: IntArray, count: int) -> IntArray:
    """Put whole connected components of cells into at most ``count`` groups of like size.

    Returns
    -------
    (m,) int32                  group of every cell; cells with a common vertex are together
    """
    used = np.zeros(int(cells.max()) + 1, dtype=np.bool_)
    used[cells] = True
    local: LongArray = (np.cumsum(used) - 1)[cells]
    rows, columns = np.repeat(local[:, 0], cells.shape[1] - 1), local[:, 1:].ravel()
    of_cell = components(rows, columns, int(used.sum()))[local[:, 0]]
    before = np.cumsum(np.bincount(of_cell)) - 1
    return np.asarray(before * count // len(cells), dtype=np.int32)[of_cell]


def seams(cells: IntArray, label: IntArray, n: int) -> tuple[BoolArray, IntArray]:
    """Find where labels meet; negative ones count too.

    Parameters
    ----------
    cells : (m, d + 1) int32
    label : (m,) int32
    n : int                     number of vertices

    Returns
    -------
    shared : (n,) bool          vertices of cells of several labels
    patch : (n,) int32          equal for those between the same two labels; -1 for all others, and
                                where three or more meet
    """
    low = np.full(n, np.iinfo(np.int32).max, dtype=np.int32)
    high = np.full(n, np.iinfo(np.int32).min, dtype=np.int32)
    for corner in cells.T:
        np.minimum.at(low, corner, label)
        np.maximum.at(high, corner, label)
    shared = low < high
    several = np.zeros(n, dtype=np.bool_)
    for corner in cells.T:
        several[corner[(label != low[corner]) & (label != high[corner])]] = True
    patch = np.full(n, -1, dtype=np.int32)
    pairs = np.flatnonzero(shared & ~several)
    keys = low[pairs].astype(np.int64) << 32 | (high[pairs].astype(np.int64) + 1)
    patch[pairs] = np.unique(keys, return_inverse=True)[1]
    return np.asarray(shared), patch


def grown(patch: IntArray, cells: IntArray, rings: int) -> IntArray:
    """Grow labels of vertices (n,) into the cells around them; the lower one where several meet.

    Returns
    -------
    (m,) int32                  -1 for cells further away than so many rings
    """
    far = np.int32(np.iinfo(np.int32).max)
    at = np.where(patch < 0, far, patch)
    label = np.full(len(cells), far, dtype=np.int32)
    for _ in range(rings):
        label = np.where(label == far, at[cells].min(axis=1), label)
        reached = at.copy()
        for corner in cells.T:
            np.minimum.at(reached, corner, label)
        at = np.where(at == far, reached, at)
    return np.where(label == far, np.int32(-1), label)


def groups(label: IntArray) -> list[NDArray[np.intp]]:
    """Cells of every label from 0 on, increasing; negative labels and empty ones are left out."""
    order = np.argsort(label, kind="stable")
    ordered = label[order]
    starts = np.flatnonzero(np.diff(ordered, prepend=-1))
    parts = np.split(order, starts)[1:]
    return [part for part in parts if label[part[0]] >= 0]
