"""Plane faces of a mesh of tetrahedra that are the same triangles up to a translation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from odt_plugins.mesh.arrays import BoolArray, FloatArray
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.simplex import diagonal, vertices_of

CLOSE = 1e-6
"""Distance, as a part of the diagonal, up to which places are in a plane or the same."""
SMALL = 2e-3
"""Least part of the surface that two opposite faces are."""
ALIKE = 1e-2
"""Difference of lengths, as a part of the longest, up to which edges count as alike: coordinates
are rounded, as those of float32 far from the origin and of text are."""
STEPS = 1000
"""Normals count as alike where so many times their coordinates round to the same numbers."""


def periodic_triangles(
    points: FloatArray, triangles: NDArray[np.int64], several: BoolArray | None = None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find the triangles of opposite faces of a mesh that match under one translation.

    A face are all triangles of the boundary in a plane that has the whole mesh on one side. Two
    match where there is a bijection of their vertices, all of them apart by the same vector, and
    of their triangles.

    Parameters
    ----------
    points : (n, 3) float64
    triangles : (t, 3) int64           of the boundary
    several : (n,) bool, optional      whether a vertex is between labels: faces without such ones,
                                       or whose triangles are all congruent, match by chance

    Returns
    -------
    (s, 3) int64, (c, 3) int64         those on faces that match, and those that do so by chance
    """
    found, chance = np.zeros((2, len(triangles)), dtype=np.bool_)
    used = vertices_of(triangles)
    if not used.size:
        return triangles[found], triangles[chance]
    x = points[used]
    rows = np.searchsorted(used, triangles)
    close = CLOSE * diagonal(x)
    for normal in _directions(x, rows):
        height = x[:, 0] * normal[0] + x[:, 1] * normal[1] + x[:, 2] * normal[2]
        ends = [np.abs(height - end) <= close for end in (height.min(), height.max())]
        if min(map(np.count_nonzero, ends)) < 3:
            continue
        low, high = (end[rows].all(axis=1) for end in ends)
        if _match(x, rows[low], rows[high], close):
            meant = several is None or (
                several[triangles[low]].any() and not _congruent(x, rows[low], close))
            (found if meant else chance)[low | high] = True
    return triangles[found], triangles[chance & ~found]


def _congruent(x: FloatArray, rows: NDArray[np.int64], close: float) -> bool:
    """Whether all of some triangles have edges of the same three lengths."""
    sides = x[rows] - x[rows[:, [1, 2, 0]]]
    lengths = np.sort(np.sqrt((sides * sides).sum(axis=2)), axis=1)
    most = max(2.0 * close, ALIKE * float(lengths.max()))
    return bool((np.ptp(lengths, axis=0) <= most).all())


def _directions(x: FloatArray, rows: NDArray[np.int64]) -> FloatArray:
    """Normals (k, 3) that a good part of the triangles has, up to their sign."""
    a, b = x[rows[:, 1]] - x[rows[:, 0]], x[rows[:, 2]] - x[rows[:, 0]]
    normal = np.stack([a[:, i] * b[:, j] - a[:, j] * b[:, i]
                       for i, j in ((1, 2), (2, 0), (0, 1))], axis=1)
    area = np.sqrt((normal**2).sum(axis=1))
    keep = area > 0.0
    normal, area = normal[keep] / area[keep, None], area[keep]
    near = np.rint(STEPS * normal).astype(np.int64)
    first = near[np.arange(len(near)), (near != 0).argmax(axis=1)]
    near *= np.where(first < 0, -1, 1)[:, None]
    _, group = np.unique(row_keys(near + STEPS, 2 * STEPS + 1), return_inverse=True)
    share = np.bincount(group, weights=area)
    order = np.lexsort((-area, group))
    largest = order[np.flatnonzero(np.diff(group[order], prepend=-1))]
    return np.asarray(normal[largest[share >= SMALL * area.sum()]])


def _match(x: FloatArray, low: NDArray[np.int64], high: NDArray[np.int64], close: float) -> bool:
    """Whether some triangles are others, apart by a translation."""
    from scipy.spatial import cKDTree

    ours, theirs = np.unique(low), np.unique(high)
    if not len(low) or len(low) != len(high) or len(ours) != len(theirs):
        return False
    by = x[theirs].mean(axis=0) - x[ours].mean(axis=0)
    away, partner = map(np.asarray, cKDTree(x[theirs]).query(x[ours] + by))
    if away.max() > close or len(np.unique(partner)) < len(partner):
        return False
    there = theirs[partner][np.searchsorted(ours, low)]
    keys = row_keys(np.sort(np.concatenate([there, high]), axis=1), len(x))
    return bool(np.array_equal(np.sort(keys[: len(low)]), np.sort(keys[len(low):])))
