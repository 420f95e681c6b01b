"""Where a surface cuts through itself, in whole numbers: a slow twin of the engine's kernel.

Boxes of triangles along a curve through space are put together in pairs; pairs of boxes that
meet are opened until pairs of triangles are left.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

ROUNDING = 1e-12
"""Rounding of a volume, at most, as a part of the cube of the extent."""

NEAR = 2.0
"""How far crossings of a surface may be from those of the input, in edges of their triangles."""

FAN = 2
"""Boxes in a larger one."""

BLOCK = 1 << 20
"""Pairs of boxes that are opened at once."""


def crossing_pairs(
    points: NDArray[np.float64], cells: NDArray[np.integer]
) -> NDArray[np.int64]:
    """List the pairs of triangles of which an edge of one goes through the inside of the other.

    Parameters
    ----------
    points : (n, 3) float64
    cells : (m, 3) int         all pairs are compared, those that share one vertex too

    Returns
    -------
    (k, 2) int64               smaller number first, in lexical order
    """
    if not len(cells):
        return np.zeros((0, 2), dtype=np.int64)
    found = [_crossing(points, cells, pairs) for pairs in _meeting(points, cells)]
    pairs = np.sort(np.concatenate(found), axis=1)
    return np.asarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))])


def new_crossings(
    old_points: NDArray[np.float64], old_cells: NDArray[np.integer],
    points: NDArray[np.float64], cells: NDArray[np.integer],
) -> NDArray[np.int64]:
    """List the crossing pairs (k, 2) of a surface that are not where the input crosses itself.

    A pair is where its smaller triangle is; a pair of the input is there when it is no further away
    than NEAR times both smaller triangles are long.
    """
    pairs = crossing_pairs(points, cells)
    if not len(pairs):
        return pairs
    old, before = _places(old_points, old_cells, crossing_pairs(old_points, old_cells))
    new, now = _places(points, cells, pairs)
    fresh = [not (((old - x) ** 2).sum(axis=1) <= (NEAR * (before + size)) ** 2).any()
             for x, size in zip(new, now, strict=True)]
    return np.asarray(pairs[np.array(fresh, dtype=np.bool_)])


def _places(
    points: NDArray[Any], cells: NDArray[Any], pairs: NDArray[Any]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centre (k, 3) and longest edge (k,) of the smaller triangle of every pair."""
    corner = points[cells[pairs]]
    size = np.sqrt(((corner - np.roll(corner, 1, axis=2)) ** 2).sum(axis=3)).max(axis=2)
    row, less = np.arange(len(pairs)), size.argmin(axis=1)
    return corner[row, less].mean(axis=1), size[row, less]


def _meeting(points: NDArray[Any], cells: NDArray[Any]) -> list[NDArray[np.int64]]:
    """Pairs (k, 2) of triangles whose boxes meet, but for those that share an edge; in parts."""
    corner = points[cells]
    low, high = corner.min(axis=1), corner.max(axis=1)
    order = np.argsort(_curve(0.5 * (low + high)), kind="stable")
    levels = [(np.ascontiguousarray(low[order].T), np.ascontiguousarray(high[order].T))]
    while levels[-1][0].shape[1] > 1:
        first = np.arange(0, levels[-1][0].shape[1], FAN)
        levels.append((np.minimum.reduceat(levels[-1][0], first, axis=1),
                       np.maximum.reduceat(levels[-1][1], first, axis=1)))
    out = []
    waiting = [(len(levels) - 1, np.zeros((1, 2), dtype=np.int64))]
    while waiting:
        level, pairs = waiting.pop()
        if not level:
            pairs = order[pairs[pairs[:, 0] != pairs[:, 1]]]
            one, two = cells[pairs[:, 0]], cells[pairs[:, 1]]
            common = np.zeros(len(pairs), dtype=np.int8)
            for i in range(3):
                for j in range(3):
                    common += one[:, i] == two[:, j]
            out.append(pairs[common < 2])
            continue
        for start in range(0, len(pairs), BLOCK // FAN**2):
            opened = _opened(pairs[start : start + BLOCK // FAN**2], *levels[level - 1])
            waiting.append((level - 1, opened))
    return out


def _opened(pairs: NDArray[Any], low: NDArray[Any], high: NDArray[Any]) -> NDArray[np.int64]:
    """Pairs of the boxes in pairs of larger boxes (k, 2) that meet, each once."""
    size = low.shape[1]
    parts = []
    for i in range(FAN):
        for j in range(FAN):
            one, two = FAN * pairs[:, 0] + i, FAN * pairs[:, 1] + j
            keep = (one <= two) & (two < size)
            one, two = one[keep], two[keep]
            for k in range(3):
                meets = (low[k, one] <= high[k, two]) & (low[k, two] <= high[k, one])
                one, two = one[meets], two[meets]
            parts.append(np.stack([one, two], axis=1))
    return np.concatenate(parts)


def _curve(x: NDArray[np.float64]) -> NDArray[np.int64]:
    """Numbers along a curve through space on which neighbours are near each other."""
    low = x.min(axis=0)
    span = float((x.max(axis=0) - low).max())
    steps = ((x - low) * ((1 << 20) / span if span > 0.0 else 0.0)).astype(np.int64)
    key = np.zeros(len(x), dtype=np.int64)
    for axis in range(3):
        bits = np.minimum(steps[:, axis], (1 << 20) - 1)
        for shift, mask in ((32, 0x1F00000000FFFF), (16, 0x1F0000FF0000FF),
                            (8, 0x100F00F00F00F00F), (4, 0x10C30C30C30C30C3),
                            (2, 0x1249249249249249)):
            bits = (bits | bits << shift) & mask
        key |= bits << axis
    return key


def cut(points: NDArray[Any], triangle: Any, other: Any) -> bool:
    """Whether an edge of a triangle goes through the inside of another, in whole numbers."""
    corners = np.asarray([*triangle, *other])
    x = _whole(points[corners])
    return _cut(x[:3], x[3:])


def _whole(points: NDArray[Any]) -> list[list[int]]:
    """The same multiple of all coordinates, of which each is a whole number."""
    ratios = [[x.as_integer_ratio() for x in point] for point in points.tolist()]
    # These are powers of two, so the largest is a multiple of every other.
    unit = max((below for point in ratios for _, below in point), default=1)
    return [[above * (unit // below) for above, below in point] for point in ratios]


def _cut(triangle: list[list[int]], other: list[list[int]]) -> bool:
    """Whether an edge of a triangle goes through the inside of another."""
    a, b, c = other
    sides = [_exact_volume(a, b, c, v) for v in triangle]
    for i, j in ((0, 1), (1, 2), (2, 0)):
        if sides[i] * sides[j] < 0:
            u, v = triangle[i], triangle[j]
            turns = [_exact_volume(u, v, *pair) for pair in ((a, b), (b, c), (c, a))]
            if min(turns) > 0 or max(turns) < 0:
                return True
    return False


def _exact_volume(a: list[int], b: list[int], c: list[int], d: list[int]) -> int:
    """Six times the signed volume of a tetrahedron."""
    x, y, z = d
    ux, uy, uz = a[0] - x, a[1] - y, a[2] - z
    vx, vy, vz = b[0] - x, b[1] - y, b[2] - z
    wx, wy, wz = c[0] - x, c[1] - y, c[2] - z
    return (ux * (vy * wz - vz * wy) + uy * (vz * wx - vx * wz) + uz * (vx * wy - vy * wx))


def _crossing(
    points: NDArray[Any], cells: NDArray[Any], pairs: NDArray[Any]
) -> NDArray[np.int64]:
    """Those of the pairs (k, 2) that cross, by whole numbers where neither is on one side."""
    x = np.ascontiguousarray(points.T)
    corners = np.ascontiguousarray(cells.T)
    for one, two in ((0, 1), (1, 0)):
        sides = np.stack(_sides(x, corners, pairs[:, one], pairs[:, two]))
        own, other = cells[pairs[:, one]].T, cells[pairs[:, two]]
        apart = ~(own[:, :, None] == other).any(axis=2)
        corner = points[cells[pairs]].reshape(-1, 6, 3)
        near = ROUNDING * np.ptp(corner, axis=1).max(axis=1) ** 3
        above, below = ((apart & (s > -near)).any(axis=0) for s in (sides, -sides))
        pairs = pairs[above & below]
    used, number = np.unique(cells[pairs], return_inverse=True)
    whole = _whole(points[used])
    both = [([whole[k] for k in one], [whole[k] for k in two])
            for one, two in number.reshape(-1, 2, 3).tolist()]
    hit = [_cut(one, two) or _cut(two, one) for one, two in both]
    return np.asarray(pairs[np.array(hit, dtype=np.bool_)], dtype=np.int64)


def _sides(
    x: NDArray[Any], corners: NDArray[Any], one: NDArray[Any], two: NDArray[Any]
) -> list[NDArray[np.float64]]:
    """On which side of the planes of triangles `two` (k,) the vertices of others `one` (k,) lie."""
    a, b, c = (x[:, corners[i, two]] for i in range(3))
    return [_volume(a, b, c, x[:, corners[i, one]]) for i in range(3)]


def _volume(
    a: NDArray[Any], b: NDArray[Any], c: NDArray[Any], d: NDArray[Any]
) -> NDArray[np.float64]:
    """Six times the signed volumes (k,) of tetrahedra with corners (3, k)."""
    (ux, uy, uz), (vx, vy, vz), (wx, wy, wz) = a - d, b - d, c - d
    return np.asarray(
        ux * (vy * wz - vz * wy) + uy * (vz * wx - vx * wz) + uz * (vx * wy - vy * wx))
