"""Signed distance functions d(p): negative inside, zero on the boundary, positive outside.

Names and arguments are those of distmesh.  A function called exact has |grad d| = 1 wherever d is
differentiable; the others have the right sign everywhere and the right zero set, and a lower bound
of the distance as their value.

References
----------
P.-O. Persson, G. Strang, A simple mesh generator in MATLAB, SIAM Review 46 (2004) 329-345,
doi:10.1137/S0036144503429121.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import reduce

import numpy as np
from numpy.typing import ArrayLike

from odt_plugins.errors import InvalidOptionError
from odt_plugins.mesh.arrays import FloatArray

Distance = Callable[[FloatArray], ArrayLike]
"""d(p) of points (n, d), shape (n,)."""

CHUNK = 1 << 20
"""Pairs of a point and a side that are looked at together."""


def dcircle(p: ArrayLike, xc: float, yc: float, r: float) -> FloatArray:
    """Distances (n,) of points (n, 2) to the circle around (xc, yc) of radius r; exact."""
    x = _points(p, 2)
    return np.hypot(x[:, 0] - xc, x[:, 1] - yc) - r


def dsphere(p: ArrayLike, xc: float, yc: float, zc: float, r: float) -> FloatArray:
    """Distance (n,) of points (n, 3) to the sphere around (xc, yc, zc) of radius r; exact."""
    length: FloatArray = np.linalg.norm(_points(p, 3) - (xc, yc, zc), axis=1)
    return length - r


def drectangle(p: ArrayLike, x1: float, x2: float, y1: float, y2: float) -> FloatArray:
    """Distance (n,) to the rectangle [x1, x2] x [y1, y2], outside to the lines of its sides.

    Exact but beyond the corners; see :func:`drectangle0`.
    """
    return _box(_points(p, 2), (x1, y1), (x2, y2)).max(axis=1)


def drectangle0(p: ArrayLike, x1: float, x2: float, y1: float, y2: float) -> FloatArray:
    """Distance (n,) to the rectangle [x1, x2] x [y1, y2]; exact."""
    return _exact(_box(_points(p, 2), (x1, y1), (x2, y2)))


def dblock(
    p: ArrayLike, x1: float, x2: float, y1: float, y2: float, z1: float, z2: float
) -> FloatArray:
    """Distance (n,) of points (n, 3) to a block, outside to the planes of its sides.

    Exact but beyond edges and corners; see :func:`dblock0`.
    """
    return _box(_points(p, 3), (x1, y1, z1), (x2, y2, z2)).max(axis=1)


def dblock0(
    p: ArrayLike, x1: float, x2: float, y1: float, y2: float, z1: float, z2: float
) -> FloatArray:
    """Distance (n,) of points (n, 3) to the block [x1, x2] x [y1, y2] x [z1, z2]; exact."""
    return _exact(_box(_points(p, 3), (x1, y1, z1), (x2, y2, z2)))


def dpoly(p: ArrayLike, pv: ArrayLike) -> FloatArray:
    """Distances (n,) to a simple polygon; exact.

    Parameters
    ----------
    p : (n, 2) float
    pv : (k, 2) float    corners in either direction; the last may repeat the first

    Raises
    ------
    InvalidOptionError   fewer than three corners
    """
    x, corners = _points(p, 2), _points(pv, 2, "polygon corners")
    if len(corners) > 1 and (corners[0] == corners[-1]).all():
        corners = corners[:-1]
    if len(corners) < 3:
        msg = f"got {len(corners)} corners of a polygon; expected at least 3 different ones"
        raise InvalidOptionError(msg)
    out = np.empty(len(x))
    step = max(1, CHUNK // len(corners))
    for start in range(0, len(x), step):
        out[start:start + step] = _polygon(x[start:start + step], corners)
    return out


def dunion(*distances: ArrayLike) -> FloatArray:
    """Union: the least of the distances (n,); exact outside only."""
    return reduce(np.minimum, map(_values, distances))


def dintersect(*distances: ArrayLike) -> FloatArray:
    """Intersection: the greatest of the distances (n,); exact inside only."""
    return reduce(np.maximum, map(_values, distances))


def ddiff(d1: ArrayLike, *distances: ArrayLike) -> FloatArray:
    """The first without the others: max(d1, -d2, ...); exact inside only."""
    return reduce(np.maximum, [-_values(d) for d in distances], _values(d1))


def protate(p: ArrayLike, phi: float) -> FloatArray:
    """Points (n, 2) turned about the origin by -phi radians: a shape of them is turned by phi."""
    c, s = math.cos(phi), math.sin(phi)
    x, y = _points(p, 2).T
    return np.stack([c * x + s * y, c * y - s * x], axis=1)


def pshift(p: ArrayLike, x0: float, y0: float, z0: float | None = None) -> FloatArray:
    """Points (n, d) moved by (x0, y0) or (x0, y0, z0): a shape of them moves the other way."""
    shift = (x0, y0) if z0 is None else (x0, y0, z0)
    return _points(p, len(shift)) + shift


def _points(p: ArrayLike, dim: int, name: str = "points") -> FloatArray:
    x = np.asarray(p, dtype=np.float64)
    if x.ndim != 2 or x.shape[1] != dim:
        msg = f"got {name} of shape {x.shape}; expected (n, {dim}), one row for every point"
        raise InvalidOptionError(msg)
    return x


def _values(d: ArrayLike) -> FloatArray:
    return np.asarray(d, dtype=np.float64)


def _box(x: FloatArray, low: tuple[float, ...], high: tuple[float, ...]) -> FloatArray:
    """Signed distances (n, d) to the nearer of the two sides across every axis."""
    return np.maximum(np.asarray(low) - x, x - np.asarray(high))


def _exact(sides: FloatArray) -> FloatArray:
    outside: FloatArray = np.linalg.norm(np.maximum(sides, 0.0), axis=1)
    return outside + np.minimum(sides.max(axis=1), 0.0)


def _polygon(x: FloatArray, corners: FloatArray) -> FloatArray:
    """Least distance to a side, negative where a ray to the right crosses an odd number of them."""
    side = np.roll(corners, -1, axis=0) - corners
    rel = x[:, None, :] - corners
    length2 = np.maximum((side**2).sum(axis=1), np.finfo(float).tiny)
    along = np.clip((rel * side).sum(axis=2) / length2, 0.0, 1.0)
    nearest = np.linalg.norm(rel - along[:, :, None] * side, axis=2).min(axis=1)
    below = corners[:, 1] <= x[:, 1, None]
    crosses = below != (np.roll(corners[:, 1], -1) <= x[:, 1, None])
    cross = side[:, 0] * rel[:, :, 1] - side[:, 1] * rel[:, :, 0]
    left = np.where(below, cross, -cross) > 0.0
    inside = (crosses & left).sum(axis=1) % 2 == 1
    return np.where(inside, -nearest, nearest)
