"""How far lines in the plane may leave their place if regions are to keep their areas.

An edge of length l that cuts an arc whose height over it is s takes an area of 2/3 l s. On curved
lines of length P around a region of area A, with heights up to s, that is at most 2/3 P s, so
heights up to 3/2 c A / P leave the part c of the area.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray, LongArray
from odt_plugins.mesh.surface import Edges

PART = 0.004
"""Part of the area of a region that arcs as high as allowed would take. The promise allows .003,
and few edges of a line are at their limit."""

STRAIGHT = 1e-6
"""Sine of the turn between edges of a line up to which it is straight."""


def heights(
    points: FloatArray, triangles: IntArray, labels: IntArray, edges: Edges, number: LongArray,
    ends: LongArray, chain: IntArray, count: int,
) -> FloatArray:
    """Length (count,) by which each line may leave its place; inf where no area depends on it.

    There are more parameters than most have, as several arrays tell the lines.

    Parameters
    ----------
    points : (n, 3) float64, triangles : (m, 3) int32, labels : (m,) int32
    edges : Edges             of the triangles
    number : (k,) int64       edges on lines, from end to end of one after another
    ends : (k, 2) int64       their vertices, in this order
    chain : (k,) int32        their lines
    count : int               lines
    """
    _, rank = np.unique(labels, return_inverse=True)
    low, high = labels_beside(rank, edges)
    step = points[ends[:, 1], :2] - points[ends[:, 0], :2]
    length = np.sqrt((step**2).sum(axis=1))
    curved = _turned(step, length, chain)
    sides = low[number], high[number]
    border = (edges.degree[number] == 1) | (sides[0] != sides[1])
    u, v = (points[triangles[:, i], :2] - points[triangles[:, 0], :2] for i in (1, 2))
    area = np.bincount(rank, 0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]))
    around = np.zeros(len(area))
    counted = curved & border
    np.add.at(around, sides[0][counted], length[counted])
    both = counted & (sides[1] != sides[0])
    np.add.at(around, sides[1][both], length[both])
    limit = 1.5 * PART * area / np.where(around > 0.0, around, 1.0)
    limit[around == 0.0] = np.inf
    out = np.full(count, np.inf)
    for side in sides:
        np.minimum.at(out, chain[border], limit[side[border]])
    return out


def labels_beside(labels: IntArray | LongArray, edges: Edges) -> tuple[LongArray, LongArray]:
    """Least and largest label (e,) of the triangles at every edge."""
    low = np.full(len(edges.degree), np.iinfo(np.int64).max, dtype=np.int64)
    high = np.full(len(edges.degree), np.iinfo(np.int64).min, dtype=np.int64)
    np.minimum.at(low, edges.of_cell.ravel(), np.repeat(labels, 3))
    np.maximum.at(high, edges.of_cell.ravel(), np.repeat(labels, 3))
    return low, high


def _turned(step: FloatArray, length: FloatArray, chain: IntArray) -> BoolArray:
    """Mark the edges (k,) at one of whose ends the line turns."""
    cross = step[:-1, 0] * step[1:, 1] - step[:-1, 1] * step[1:, 0]
    turns = (np.abs(cross) > STRAIGHT * length[:-1] * length[1:]) & (chain[:-1] == chain[1:])
    out = np.zeros(len(chain), dtype=np.bool_)
    out[:-1] |= turns
    out[1:] |= turns
    return out
