"""Places of the free vertices of a tangled mesh at which no cell is inverted.

From harmonic places, or those of the input where fewer cells are inverted there, the distortion of
`energy` is lowered with an eps that follows the worst cell; first around the inverted cells, then
further around them, at last everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from odt_plugins.engine.untangle.energy import REGULAR, Distortion
from odt_plugins.engine.untangle.harmonic import harmonic
from odt_plugins.engine.untangle.lbfgs import lbfgs
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray, LongArray
from odt_plugins.mesh.chunks import Pool
from odt_plugins.mesh.simplex import cell_signs, determinant

RINGS = (2, 5)
"""How many rings of cells around inverted ones are moved, before all of them are."""

SHARE = 0.5
"""Share of the free vertices from which on all of them are moved."""

ROUNDS, PATIENCE, STEPS = 12, 3, 60
"""Most values of eps, most without fewer inverted cells, and most steps with each."""

LEAST_EPS, FOLLOW = 1e-6, 0.2
"""eps = sqrt(LEAST_EPS^2 + (FOLLOW min(det, 0))^2), as in the program of Garanzha et al. (2021)."""


def untangled_places(
    points: FloatArray, cells: IntArray, movable: BoolArray, reference: FloatArray | None = None,
    moved: FloatArray | None = None, pool: Pool | None = None,
    tell: Callable[[int], object] = int,
) -> FloatArray:
    """Move vertices until no cell is inverted or flat, or fewer are.

    Parameters
    ----------
    points : (n, d) float64                     not changed
    cells : (m, d + 1) int32                    that agree about their orientation
    movable : (n,) bool
    reference : (m, d, d) float64, optional     edges of a cell of the wanted shape at its first
                                                vertex, one a column, which all cells are brought
                                                near to; regular ones unless given
    moved : (n, d) float64, optional            other places to start from
    pool : Pool, optional         shares the work; the result does not depend on it
    tell : callable                             is told how many cells are inverted after every step

    Returns
    -------
    (n, d) float64                              the places found with the fewest such cells
    """
    best = points
    left = bad_cells(points, cells)
    count = int(movable.sum())
    for rings in (*RINGS, None) if reference is None else (None,):
        if not left.any():
            break
        near = movable if rings is None else movable & _around(cells, left, rings, len(points))
        if rings is not None and near.sum() > SHARE * count:
            continue
        if not near.any():
            continue
        found = _moved(best, cells, np.flatnonzero(near), reference, moved, pool, tell)
        bad = bad_cells(found, cells)
        if bad.sum() < left.sum():
            best, left = found, bad
    return best


def bad_cells(points: FloatArray, cells: IntArray) -> BoolArray:
    """Mark the cells (m,) that are inverted or flat."""
    bad: BoolArray = cell_signs(points, cells)[0] <= 0
    return bad


def _around(cells: IntArray, which: BoolArray, rings: int, n: int) -> BoolArray:
    """Mark the vertices (n,) of some cells, and of so many rings of cells around them."""
    near = np.zeros(n, dtype=np.bool_)
    near[cells[which]] = True
    for _ in range(rings):
        near[cells[near[cells].any(axis=1)]] = True
    return near


def _moved(
    points: FloatArray, cells: IntArray, free: LongArray, reference: FloatArray | None,
    moved: FloatArray | None, pool: Pool | None, tell: Callable[[int], object],
) -> FloatArray:
    """The same with some vertices moved, in units of the cells that have them."""
    d = points.shape[1]
    is_free = np.zeros(len(points), dtype=np.bool_)
    is_free[free] = True
    touched = is_free[cells].any(axis=1)
    vertices = np.unique(cells[touched])
    inner: IntArray = np.searchsorted(vertices, cells[touched]).astype(np.int32)
    free = np.searchsorted(vertices, free)
    shapes = _shapes(points, cells[touched], None if reference is None else reference[touched])
    unit = float(np.abs(determinant(np.moveaxis(shapes, 0, -1))).mean()) ** (1 / d)
    # each cell is a single point, or each reference flat: there is no unit of length
    if unit == 0.0:
        return points
    centre = points[vertices].mean(axis=0)
    starts = [points[vertices]]
    if moved is not None:
        starts.append(np.where(is_free[vertices, None], moved[vertices], points[vertices]))
    else:
        starts.append(starts[0].copy())
        starts[1][free] = harmonic(starts[0] - centre, inner, free) + centre
    start = min(starts, key=lambda p: int(bad_cells(p, inner).sum()))
    distortion = Distortion((start - centre) / unit, inner, free, shapes / unit, pool)
    out = points.copy()
    x = _lowered(distortion, tell)
    x = x if reference is None else _shaped(distortion, x)
    out[vertices[free]] = x * unit + centre
    return out


def _shapes(points: FloatArray, cells: IntArray, reference: FloatArray | None) -> FloatArray:
    """Reference cells; regular ones have the mean volume, which is that of any places inside."""
    if reference is not None:
        return reference
    d = points.shape[1]
    corners = points[cells]
    edges = np.moveaxis(corners[:, 1:] - corners[:, :1], 0, -1)
    mean = abs(float(determinant(edges).mean()))
    regular = float(determinant(REGULAR[d]))
    size = (mean / regular) ** (1 / d) if mean > 0.0 else float(np.ptp(corners, axis=1).max())
    return np.repeat(size * REGULAR[d][None], len(cells), axis=0)


def _lowered(distortion: Distortion, tell: Callable[[int], object]) -> FloatArray:
    """Places of the free vertices with the fewest inverted cells on the way to the least sum."""
    x = distortion.points[distortion.free]
    distortion(x, 1.0)
    best, fewest, waited = x, len(distortion.dets) + 1, 0
    for _ in range(ROUNDS):
        bad = int(bad_cells(distortion.points, distortion.cells).sum())
        waited = 0 if bad < fewest else waited + 1
        if bad < fewest:
            best, fewest = x, bad
        if not bad or waited == PATIENCE:
            break
        least = float(distortion.dets.min())
        eps = math.hypot(LEAST_EPS, FOLLOW * min(least, 0.0))
        x, _ = lbfgs(partial(distortion, eps=eps), x, STEPS,
                     partial(_turned, distortion, tell) if least <= 0.0 else bool)
        distortion(x, eps)
    return best


def _shaped(distortion: Distortion, x: FloatArray) -> FloatArray:
    """Places from x on at which cells are more like their references, if none is inverted."""
    new, _ = lbfgs(partial(distortion, eps=LEAST_EPS), x, ROUNDS * STEPS, bool)
    distortion(new, LEAST_EPS)
    return x if bad_cells(distortion.points, distortion.cells).any() else new


def _turned(distortion: Distortion, tell: Callable[[int], object]) -> bool:
    """Whether all cells are positive now; tells how many are not."""
    left = int((~(distortion.dets > 0.0)).sum())
    tell(left)
    return left == 0
