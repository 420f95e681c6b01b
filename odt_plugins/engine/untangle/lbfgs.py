"""Limited-memory BFGS without BLAS, so that its bits depend on no library.

References
----------
J. Nocedal, S. J. Wright, Numerical Optimization, Springer (2006), Algorithms 7.4 and 7.5.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import numpy as np

from odt_plugins.mesh.arrays import FloatArray

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


def _scaled(
    steps: deque[tuple[FloatArray, FloatArray, float]], slope: FloatArray
) -> FloatArray:
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
