"""Certified bounds of the Jacobian determinant of curved triangles and tetrahedra.

The determinant of a cell of order p in dimension d is a polynomial of degree d (p - 1). It lies
between the least and the largest of its Bernstein coefficients, and takes the values of those at
the corners. Halving the edges of the reference cell brings bounds and values together.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import product
from math import factorial, prod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.mesh.arrays import BoolArray, FloatArray
from odt_plugins.mesh.simplex import determinant

LEVELS = 8
"""How often edges are halved."""

CLOSE = 1e-4
"""Bounds are sharp enough when they are as close as this part of the largest coefficient."""

AT_ONCE = 4_000_000
"""Most coefficients that are held at once."""


class Bounds(NamedTuple):
    """Bounds (m,) of the determinant in every cell, values that it takes, and the mean of all.

    Attributes
    ----------
    lower, least : (m,) float64      lower bound, and least value seen; twice or six times the area
                                     or volume in a straight cell
    upper : (m,) float64             upper bound
    mean : (m,) float64              mean over the reference cell, twice the area or six times the
                                     volume
    """

    lower: FloatArray
    least: FloatArray
    upper: FloatArray
    mean: FloatArray

    @property
    def valid(self) -> BoolArray:
        """Cells (m,) whose determinant is certainly positive everywhere."""
        return np.asarray(self.lower > 0.0)

    @property
    def scaled(self) -> FloatArray:
        """Scaled Jacobian (m,): lower bound by upper bound, 1 in straight cells, 0 in folded ones.

        It is 0 where no bound is positive.
        """
        safe = np.where(self.upper > 0.0, self.upper, 1.0)
        return np.asarray(np.where(self.upper > 0.0, np.maximum(self.lower, 0.0) / safe, 0.0))


def jacobian_bounds(x: FloatArray, shape: NDArray[np.int64]) -> Bounds:
    """Bound the determinants of cells.

    Parameters
    ----------
    x : (m, k, D) float64       nodes of the cells; D = d, or 3 for triangles in space, whose normal
                                is measured along that of the corners
    shape : (k, d + 1) int64    whole barycentric weights of the nodes

    Returns
    -------
    Bounds    of the determinants times the sign that those of the corners have
    """
    dim, order = shape.shape[1] - 1, int(shape[0].sum())
    parts = [_bounds(values, dim, dim * (order - 1)) for values in _in_parts(x, shape)]
    if not parts:
        return Bounds(*np.zeros((4, 0)))
    return Bounds(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def mean_determinants(x: FloatArray, shape: NDArray[np.int64]) -> FloatArray:
    """Means (m,) of :class:`Bounds` alone, of what :func:`jacobian_bounds` takes."""
    dim, order = shape.shape[1] - 1, int(shape[0].sum())
    return np.concatenate([np.zeros(0), *(_mean(values, dim, dim * (order - 1))
                                          for values in _in_parts(x, shape))])


def _in_parts(x: FloatArray, shape: NDArray[np.int64]) -> Iterator[FloatArray]:
    """The determinants of so many cells after the other that bounds of these fit in memory."""
    dim, order = shape.shape[1] - 1, int(shape[0].sum())
    step = max(AT_ONCE // (len(indices(dim, dim * (order - 1))) * 2**dim), 1)
    for i in range(0, len(x), step):
        yield _determinants(x[i : i + step], shape)


def _determinants(x: FloatArray, shape: NDArray[np.int64]) -> FloatArray:
    """Determinants (m, c) at all weights of their degree, times the signs of those of corners."""
    dim, order = shape.shape[1] - 1, int(shape[0].sum())
    x = np.asarray(x, dtype=np.float64)
    x = x - x[:, :1]
    corners = x[:, 1 : dim + 1]
    if x.shape[2] > dim:
        normal = np.cross(corners[:, 0], corners[:, 1])
        length = np.sqrt((normal * normal).sum(axis=1))
        corners = np.concatenate([corners, normal[:, None] / np.where(length > 0.0, length, 1.0)[
            :, None, None]], axis=1)
    sign = np.where(determinant(np.moveaxis(corners, (1, 2), (0, 1))) < 0.0, -1.0, 1.0)
    gradients = _gradients(dim, order, tuple(map(tuple, shape.tolist())))
    rows = np.einsum("qkd,mkx->mqdx", gradients, x)
    if x.shape[2] > dim:
        along = np.broadcast_to(corners[:, None, 2:], (*rows.shape[:2], 1, 3))
        rows = np.concatenate([rows, along], axis=2)
    return np.asarray(determinant(np.moveaxis(rows, (2, 3), (0, 1))) * sign[:, None])


@cache
def indices(dim: int, degree: int) -> NDArray[np.int64]:
    """Whole barycentric weights (c, dim + 1) of sum `degree`, the corners first."""
    rows = [a for a in product(range(degree + 1), repeat=dim + 1) if sum(a) == degree]
    rows.sort(key=lambda a: (max(a) < degree, [-v for v in a]))
    return np.array(rows, dtype=np.int64)


def _values(powers: NDArray[np.int64], at: FloatArray) -> FloatArray:
    """Bernstein polynomials (q, c) at barycentric coordinates (q, dim + 1)."""
    degree = int(powers[0].sum())
    scale = np.array([factorial(degree) / prod(map(factorial, a)) for a in powers.tolist()])
    return np.asarray(scale * (at[:, None] ** powers).prod(axis=2))


@cache
def _inverse(dim: int, degree: int) -> FloatArray:
    """Coefficients from the values at all weights."""
    powers = indices(dim, degree)
    return np.asarray(np.linalg.inv(_values(powers, powers / max(degree, 1) + (degree == 0))))


@cache
def _gradients(dim: int, order: int, shape: tuple[tuple[int, ...], ...]) -> FloatArray:
    """Gradients (c, k, dim) of the shape functions where the determinant is sampled."""
    powers, degree = indices(dim, order), dim * (order - 1)
    at = indices(dim, degree) / max(degree, 1) + (degree == 0)
    lower = _values(indices(dim, order - 1), at)
    place = {tuple(a): i for i, a in enumerate(indices(dim, order - 1).tolist())}
    slopes = np.zeros((len(at), len(powers), dim + 1))
    for k, a in enumerate(powers.tolist()):
        for i in range(dim + 1):
            if a[i]:
                less = tuple(v - (j == i) for j, v in enumerate(a))
                slopes[:, k, i] = order * lower[:, place[less]]
    from_nodes = np.linalg.inv(_values(powers, np.array(shape) / order))
    along = slopes[:, :, 1:] - slopes[:, :, :1]
    return np.asarray(np.einsum("qcd,ck->qkd", along, from_nodes))


@cache
def _halves(dim: int, degree: int) -> FloatArray:
    """Coefficients in every part (2^dim, c, c) of a cell whose edges are halved."""
    eye = np.eye(dim + 1)
    mid = {(i, j): (eye[i] + eye[j]) / 2 for i in range(dim + 1) for j in range(dim + 1)}
    if dim == 2:
        parts = [[mid[i, j] for j in range(3)] for i in range(3)]
        parts.append([mid[0, 1], mid[1, 2], mid[0, 2]])
    else:
        parts = [[mid[i, j] for j in range(4)] for i in range(4)]
        ring = [mid[0, 2], mid[0, 3], mid[1, 3], mid[1, 2]]
        parts += [[mid[0, 1], mid[2, 3], ring[i], ring[i - 1]] for i in range(4)]
    powers = indices(dim, degree)
    at = powers / max(degree, 1) + (degree == 0)
    inverse = _inverse(dim, degree)
    return np.stack([inverse @ _values(powers, at @ np.array(part)) for part in parts])


def _mean(values: FloatArray, dim: int, degree: int) -> FloatArray:
    """Mean (m,) of the coefficients from the values (m, c), as all have the same integral."""
    return np.asarray((values * _inverse(dim, degree).mean(axis=0)).sum(axis=1))


def _bounds(values: FloatArray, dim: int, degree: int) -> Bounds:
    """Bounds from the values (m, c) at all weights; rounding makes them wider."""
    found = np.asarray(values @ _inverse(dim, degree).T)
    lower, least = _least(found, dim, degree, decide=True)
    upper = -_least(-found, dim, degree, decide=False)[0]
    rounding = 8 * np.finfo(np.float64).eps * np.abs(_inverse(dim, degree)).sum(axis=1).max()
    rounding = rounding * np.abs(found).max(axis=1, initial=0.0)
    return Bounds(lower - rounding, least, upper + rounding, _mean(values, dim, degree))


def _least(
    found: FloatArray, dim: int, degree: int, *, decide: bool
) -> tuple[FloatArray, FloatArray]:
    """Lower bound (m,) and least value seen of polynomials with coefficients (m, c).

    To `decide` is to halve until the sign is known.
    """
    least = found[:, : dim + 1].min(axis=1)
    lower = np.full(len(found), np.inf)
    near = CLOSE * np.abs(found).max(axis=1, initial=0.0)
    cell, parts = np.arange(len(found)), found
    for level in range(LEVELS + 1):
        low = parts.min(axis=1)
        np.minimum.at(least, cell, parts[:, : dim + 1].min(axis=1))
        wide = low < least[cell] - near[cell]
        if decide:
            wide = (wide | (low <= 0.0)) & (least[cell] > 0.0)
        if level == LEVELS:
            wide[:] = False
        np.minimum.at(lower, cell[~wide], low[~wide])
        if not wide.any():
            break
        halves = _halves(dim, degree)
        every = halves.reshape(-1, parts.shape[1])
        parts = (parts[wide] @ every.T).reshape(-1, parts.shape[1])
        cell = np.repeat(cell[wide], len(halves))
    return lower, least
