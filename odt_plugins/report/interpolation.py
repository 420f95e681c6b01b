"""How well piecewise linear functions on a mesh interpolate a function."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from math import factorial, hypot
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from odt_plugins.errors import InvalidOptionError, UnsupportedMeshError, expect
from odt_plugins.figures import volumes
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.simplex import vertices_of
from odt_plugins.table import text_html

PER_AXIS = 6
"""Points of the rule in each direction: it is exact for polynomials of degree 2 PER_AXIS - d."""

AT_ONCE = 4000
"""Cells whose points are evaluated together."""

HEADINGS = {"l1": "L1", "l2": "L2", "largest": "largest"}

Function = Callable[[FloatArray], ArrayLike]


@dataclass(frozen=True)
class Errors:
    """Norms of f - f_I on one mesh, f_I linear on every cell and f at its vertices.

    Attributes
    ----------
    l1, l2 : float      integral of abs(f - f_I), root of that of its square
    largest : float     largest abs(f - f_I) at the points of the quadrature rule
    """

    l1: float
    l2: float
    largest: float


@dataclass(frozen=True)
class InterpolationErrors:
    """Errors before and after; printed, a table."""

    before: Errors
    after: Errors

    def __str__(self) -> str:
        """A table, one row per norm."""
        rows = [f"{'error':<12}{'before':>12}{'after':>12}"]
        for field in fields(Errors):
            old, new = (getattr(mesh, field.name) for mesh in (self.before, self.after))
            rows.append(f"{HEADINGS[field.name]:<12}{old:>12.4g}{new:>12.4g}")
        return "\n".join(rows)

    def _repr_html_(self) -> str:
        return text_html(str(self))

    def to_dict(self) -> dict[str, Any]:
        """Plain values, by mesh and norm."""
        return asdict(self)


def errors_of_report(report: Any, f: Function) -> InterpolationErrors:
    """Errors before and after a run, over all parts of an object of several meshes."""
    expect(callable(f), "f", f, "a function f(x) -> (k,) of places x (k, d)")
    if report.parts:
        parts = [errors_of_report(part, f) for part in report.parts]
        return InterpolationErrors(*(Errors(
            sum(e.l1 for e in each), hypot(*(e.l2 for e in each)), max(e.largest for e in each)
        ) for each in ([p.before for p in parts], [p.after for p in parts])))
    plane = report.plane
    return InterpolationErrors(*(
        interpolation_errors(points if plane is None else plane.to_space(points), cells, f)
        for points, cells in meshes_of(report)))


def meshes_of(report: Any) -> tuple[tuple[FloatArray, IntArray], ...]:
    """Points and cells before and after, where a report has them.

    Raises
    ------
    UnsupportedMeshError    it is that of a file in pieces
    """
    if not report.meshes:
        msg = ("got a report of a file in pieces, which are never in memory together; expected "
               "that of one mesh, try reading the pieces as one")
        raise UnsupportedMeshError(msg)
    found: tuple[tuple[FloatArray, IntArray], ...] = report.meshes
    return found


def interpolation_errors(points: FloatArray, cells: IntArray, f: Function) -> Errors:
    """Errors of interpolating a function linearly on every cell.

    Parameters
    ----------
    points : (n, D) float64
    cells : (m, d + 1) int32     triangles, also in space, or tetrahedra
    f : callable                 f(x) -> (k,) for places x (k, D)

    Returns
    -------
    Errors                       by a rule of degree 10 in the plane, 9 in space: Gauss points of a
                                 cube, collapsed into the simplex

    Raises
    ------
    InvalidOptionError           f gives another number of values, or such as are no finite numbers
    """
    weights, places = conical_rule(cells.shape[1] - 1)
    content = np.abs(volumes(points, cells))
    used = vertices_of(cells)
    known = np.zeros(len(points))
    known[used] = _evaluated(f, points[used])
    first, second, largest = 0.0, 0.0, 0.0
    for start in range(0, len(cells), AT_ONCE):
        part = cells[start:start + AT_ONCE]
        x = np.einsum("qk,ckd->cqd", places, points[part])
        values = _evaluated(f, x.reshape(-1, points.shape[1])).reshape(len(part), -1)
        gap = np.abs(values - np.einsum("qk,ck->cq", places, known[part]))
        share = content[start:start + AT_ONCE, None] * weights
        first += float((share * gap).sum())
        second += float((share * gap * gap).sum())
        largest = max(largest, float(gap.max(initial=0.0)))
    return Errors(first, float(np.sqrt(second)), largest)


def conical_rule(d: int) -> tuple[FloatArray, FloatArray]:
    """Weights (q,) of sum 1 and barycentric places (q, d + 1) of a rule for simplices.

    References
    ----------
    A. H. Stroud, Approximate calculation of multiple integrals, 1971: conical product formulas.
    """
    nodes, gauss = np.polynomial.legendre.leggauss(PER_AXIS)
    nodes, gauss = 0.5 * (nodes + 1.0), 0.5 * gauss
    weights, places = [], []
    for index in itertools.product(range(PER_AXIS), repeat=d):
        left, weight, place = 1.0, float(factorial(d)), []
        for axis, i in enumerate(index):
            weight *= gauss[i] * (1.0 - nodes[i]) ** (d - 1 - axis)
            place.append(left * nodes[i])
            left *= 1.0 - nodes[i]
        weights.append(weight)
        places.append([*place, left])
    return np.array(weights), np.array(places)


def _evaluated(f: Function, x: FloatArray) -> FloatArray:
    """Values (k,) of a caller's function."""
    found = np.asarray(f(x))
    if found.shape != (len(x),) or found.dtype.kind not in "fiu":
        msg = (f"got values of shape {found.shape} and type {found.dtype} of the function; "
               f"expected ({len(x)},) real numbers for places of shape {x.shape}")
        raise InvalidOptionError(msg)
    bad = np.flatnonzero(~np.isfinite(found))
    if bad.size:
        msg = (f"got {found[bad[0]]} of the function at {x[bad[0]].tolist()} ({bad.size} of them); "
               f"expected finite numbers")
        raise InvalidOptionError(msg)
    return found.astype(np.float64)
