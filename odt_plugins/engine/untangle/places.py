"""Places of the free vertices of a tangled mesh at which no cell is inverted.

From harmonic places, or those of the input where fewer cells are inverted there, the distortion of
`energy` is lowered with an eps that follows the worst cell; first around the inverted cells, then
further around them, at last everywhere. L-BFGS is written out: its bits depend on no BLAS.

References
----------
J. Nocedal, S. J. Wright, Numerical Optimization, Springer (2006), Algorithms 7.4 and 7.5.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from functools import partial

import numpy as np

from odt_plugins.engine.untangle.energy import REGULAR, Distortion
from odt_plugins.engine.untangle.harmonic import harmonic
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray, LongArray
from odt_plugins.mesh.chunks import Pool
from odt_plugins.mesh.simplex import cell_signs, determinant

MEMORY = 8
"""Steps that are remembered."""

ARMIJO, WOLFE, TRIALS, FIRST = 1e-4, 0.9, 20, 0.1
"""Bounds of a step length, how many lengths are tried, and the longest first step."""

Function = Callable[[FloatArray], tuple[float, FloatArray]]


def lbfgs(
    function: Function, x: FloatArray, most: int, done: Callable[[], bool], gain: float = 1e-4
) -> tuple[FloatArray, float]:
    """Lower a function until it is done, gains too little, or took so many steps.

    Parameters
    ----------
    function : callable      value and gradient at x, which has any shape
    x : array                where it starts; not changed
    most : int               most steps
    done : callable          asked after every step, right after the function was called there
    gain : float             least relative gain of ten steps with which it goes on

    Returns
    -------
    x : array
    value : float            that of the function there, never above the first
    """
    value, slope = function(x)
    steps: deque[tuple[FloatArray, FloatArray, float]] = deque(maxlen=MEMORY)
    values = [value]
    for _ in range(most):
        way = -_scaled(steps, slope)
        along = _dot(way, slope)
        if not along < 0.0:
            steps.clear()
            way = -_scaled(steps, slope)
            along = _dot(way, slope)
        found = _search(function, x, value, way, along)
        if found is None:
            break
        new, value, new_slope = found
        step, change = new - x, new_slope - slope
        x, slope = new, new_slope
        curvature = _dot(step, change)
        if curvature > 1e-12 * _dot(change, change):
            steps.append((step, change, curvature))
        values.append(value)
        if done() or (len(values) > 10 and values[-11] - value < gain * value):
            break
    return x, value


def _dot(a: FloatArray, b: FloatArray) -> float:
    return float((a * b).sum())


def _scaled(steps: deque[tuple[FloatArray, FloatArray, float]], slope: FloatArray) -> FloatArray:
    """The inverse Hessian, as far as it is known, times a gradient: the two loops."""
    way = slope.copy()
    if not steps:
        return way * min(1.0, FIRST / max(float(np.abs(slope).max()), 1e-300))
    weights = []
    for step, change, curvature in reversed(steps):
        weights.append(_dot(step, way) / curvature)
        way -= weights[-1] * change
    _, change, curvature = steps[-1]
    way *= curvature / _dot(change, change)
    for step, change, curvature in steps:
        way += step * (weights.pop() - _dot(change, way) / curvature)
    return way


def _search(
    function: Function, x: FloatArray, value: float, way: FloatArray, along: float
) -> tuple[FloatArray, float, FloatArray] | None:
    """The place after a step that lowers the function enough, None if there is none."""
    low, high, length = 0.0, np.inf, 1.0
    for _ in range(TRIALS):
        new = x + length * way
        found, slope = function(new)
        if not found <= value + ARMIJO * length * along:
            high = length
            length = 0.5 * (low + high) if low > 0.0 else length * _shorter(
                found - value, length * along)
        elif high == np.inf and _dot(slope, way) < WOLFE * along:
            low, length = length, 2.0 * length
        else:
            return new, found, slope
    return None


def _shorter(rise: float, along: float) -> float:
    """Part of a step at which the parabola through both ends is lowest, from 0.1 to 0.5."""
    if not np.isfinite(rise):
        return 0.1
    return min(0.5, max(0.1, -along / (2.0 * (rise - along))))


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
    return cell_signs(points, cells)[0] <= 0


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
