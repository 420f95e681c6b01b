"""A domain as the mesh generator sees it: checked values of fd and fh, projection to fd = 0."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from odt_plugins.errors import InvalidOptionError, counted
from odt_plugins.generate.distance import Distance
from odt_plugins.generate.sizes import Size
from odt_plugins.mesh.arrays import FloatArray

STEPS = 12
"""Newton steps of a projection; an exact distance needs two."""

ON_BOUNDARY = 1e-12
"""A point is on the boundary when |fd| is below this part of the bounding box's diagonal."""

DIFFERENCE = 1e-7
"""Step of the numerical gradient, as a part of the diagonal."""


@dataclass(frozen=True)
class Domain:
    """Where fd is negative, in a box, with a size function.

    Attributes
    ----------
    fd : callable              signed distance function; any function with its sign will do
    fh : callable              size function
    low, high : (d,) float64   corners of the bounding box
    """

    fd: Distance
    fh: Size
    low: FloatArray
    high: FloatArray

    @property
    def diagonal(self) -> float:
        """Length of the diagonal of the bounding box."""
        return math.dist(self.low, self.high)

    def distance(self, points: FloatArray) -> FloatArray:
        """Values fd(points), (n,).

        Raises
        ------
        InvalidOptionError    fd gives another shape, or NaN or infinity
        """
        return _values(self.fd, "fd", points)

    def size(self, points: FloatArray) -> FloatArray:
        """Values fh(points), (n,).

        Raises
        ------
        InvalidOptionError    fh gives another shape, NaN, infinity, zero or less
        """
        values = _values(self.fh, "fh", points)
        bad = np.flatnonzero(values <= 0.0)
        if bad.size:
            _refuse("fh", values, bad, points, "sizes above 0 in the whole domain")
        return values

    def gradient(self, points: FloatArray) -> FloatArray:
        """Gradient of fd by central differences, (n, d)."""
        step = DIFFERENCE * self.diagonal
        out = np.empty_like(points)
        for k in range(points.shape[1]):
            shift = np.zeros(points.shape[1])
            shift[k] = step
            ahead, behind = self.distance(points + shift), self.distance(points - shift)
            out[:, k] = (ahead - behind) / (2.0 * step)
        return out

    def project(self, points: FloatArray) -> FloatArray:
        """Move points to fd = 0 along the gradient, by a damped Newton method.

        Parameters
        ----------
        points : (n, d) float64    near the boundary

        Returns
        -------
        (n, d) float64             |fd| falls with every step; points where it does not stay
        """
        out = points.copy()
        value = self.distance(out)
        share = np.ones(len(out))
        for _ in range(STEPS):
            far = np.flatnonzero(np.abs(value) > ON_BOUNDARY * self.diagonal)
            if not far.size:
                break
            slope = self.gradient(out[far])
            square = np.maximum((slope**2).sum(axis=1), 1e-12)
            moved = out[far] - (share[far] * value[far] / square)[:, None] * slope
            now = self.distance(moved)
            better = np.abs(now) < np.abs(value[far])
            out[far[better]] = moved[better]
            value[far[better]] = now[better]
            share[far] = np.where(better, 1.0, 0.25 * share[far])
        return out


def make_domain(fd: Distance, fh: Size, bbox: ArrayLike) -> Domain:
    """Check the arguments of distmesh2d that do not depend on h0.

    Raises
    ------
    InvalidOptionError    fd or fh cannot be called, bbox has another shape than (2, d), is not
                          finite or reversed
    """
    for name, function in (("fd", fd), ("fh", fh)):
        if not callable(function):
            msg = f"got {name} of type {type(function).__name__}; expected a function of points"
            raise InvalidOptionError(msg)
    box = as_floats(bbox, "bbox", "[[xmin, ymin], [xmax, ymax]]")
    if box.shape != (2, 2):
        msg = f"got bbox of shape {box.shape}; expected (2, 2), [[xmin, ymin], [xmax, ymax]]"
        raise InvalidOptionError(msg)
    if not (np.isfinite(box).all() and (box[0] < box[1]).all()):
        msg = (f"got bbox={box.tolist()}; expected [[xmin, ymin], [xmax, ymax]] of finite numbers "
               "with xmin < xmax and ymin < ymax")
        raise InvalidOptionError(msg)
    return Domain(fd, fh, box[0].copy(), box[1].copy())


def fixed_points(pfix: ArrayLike | None, domain: Domain, h0: float) -> FloatArray:
    """Check the fixed points of a mesh of edges about h0, and leave out repeated ones, (f, 2).

    Raises
    ------
    InvalidOptionError    wrong shape, not finite, outside the domain or the box
    """
    if pfix is None:
        return np.empty((0, 2))
    fixed = as_floats(pfix, "pfix", "points (f, 2)")
    if fixed.size == 0:
        return np.empty((0, 2))
    if fixed.ndim != 2 or fixed.shape[1] != 2:
        msg = f"got pfix of shape {fixed.shape}; expected (f, 2), one row for every fixed point"
        raise InvalidOptionError(msg)
    bad = np.flatnonzero(~np.isfinite(fixed).all(axis=1))
    if bad.size:
        msg = (f"got the fixed point {fixed[bad[0]].tolist()} at index {bad[0]} ({bad.size} of "
               "them); expected finite coordinates")
        raise InvalidOptionError(msg)
    first = np.sort(np.unique(fixed, axis=0, return_index=True)[1])
    fixed = fixed[first]
    beyond = (fixed < domain.low) | (fixed > domain.high)
    slack = 1e-9 * domain.diagonal
    away = domain.distance(fixed)
    out = np.flatnonzero((away > min(1e-3 * h0, 1e-3 * domain.diagonal) + slack)
                         | beyond.any(axis=1))
    if out.size:
        msg = (f"got the fixed point {fixed[out[0]].tolist()} at index {first[out[0]]} "
               f"({out.size} of them), where fd = {away[out[0]]:.3g}; expected points of the "
               "domain, where fd is 0 or less, in bbox")
        raise InvalidOptionError(msg)
    return fixed


def as_floats(value: Any, name: str, expected: str) -> FloatArray:
    """Array of float64 from what a user gave.

    Raises
    ------
    InvalidOptionError    it is no array of numbers
    """
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as exc:
        msg = f"got {name} of type {type(value).__name__}, no array of numbers; expected {expected}"
        raise InvalidOptionError(msg) from exc


def _values(function: Any, name: str, points: FloatArray) -> FloatArray:
    given = function(points.copy())
    values = as_floats(given, f"{name}(points)", f"one number for each of {len(points)} points")
    if values.shape != (len(points),):
        msg = (f"got shape {values.shape} from {name} for {counted(len(points), 'point')}; "
               f"expected ({len(points)},), one number for each row of points")
        raise InvalidOptionError(msg)
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        _refuse(name, values, bad, points, "finite values in the whole bounding box")
    return values


def _refuse(name: str, values: FloatArray, bad: Any, points: FloatArray, expected: str) -> None:
    where = ", ".join(f"{x:.6g}" for x in points[bad[0]])
    msg = (f"got {name} = {values[bad[0]]} at the point ({where}) ({bad.size} of "
           f"{counted(len(points), 'point')}); expected {expected}")
    raise InvalidOptionError(msg)
