"""What a caller gives as `metric=`, as one tensor for every vertex."""

from __future__ import annotations

from typing import Any

import numpy as np

from odt_plugins.adapters.fields import INPUT
from odt_plugins.engine.cells.tensors import PACKED, eigenvalues, full, product, transposed
from odt_plugins.errors import InvalidOptionError
from odt_plugins.mesh.arrays import BoolArray, FloatArray
from odt_plugins.mesh.numbers import real_numbers
from odt_plugins.mesh.plane import PlaneFrame
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.metric.implied import implied_metric

MOST_RATIO = 1e6
"""Largest ratio of the lengths that a metric may have in two directions."""

ASYMMETRY = 1e-6
"""Largest difference of two entries that should be equal, as a part of the largest entry: that of
float32."""

LONGEST = 1e20
"""Longest length of a metric, and one over the shortest, as parts of the diagonal."""

ROUNDING = 1e-3
"""Part by which rounding may take MOST_RATIO too far."""


def metric_at_vertices(
    mesh: SimplexMesh, given: Any, frame: PlaneFrame | None = None
) -> FloatArray:
    """One metric for every vertex.

    Parameters
    ----------
    mesh : SimplexMesh     vertices as the caller has them; others may have come behind
    given : array, callable or "input"
                           (n, d, d), (n, d d), or packed (n, d (d + 1) / 2) in the order m11 m12
                           m22 m13 m23 m33; a function metric(points) that gives one of these; or
                           the metric that the mesh has
    frame : PlaneFrame     of triangles in one plane in space, whose metrics may be those of space

    Returns
    -------
    (n, d, d) float64, d the dimension of the points of `mesh`; the identity at vertices without
    cells

    Raises
    ------
    InvalidOptionError     not one symmetric positive definite tensor for every vertex, or one with
                           lengths far from those of the mesh, or whose ratio is beyond MOST_RATIO
    """
    if isinstance(given, str) and given == INPUT:
        return implied_metric(mesh.points, mesh.cells)
    d = mesh.points.shape[1]
    used = np.zeros(len(mesh.points), dtype=np.bool_)
    used[mesh.cells] = True
    places = mesh.points if frame is None else frame.to_space(mesh.points)
    raw = given(places.copy()) if callable(given) else given
    real = real_numbers(raw, "a metric that is no array of real numbers",
                        "one symmetric tensor for every vertex, try metric='input'")
    tensors = _tensors(real, len(places), d, frame)
    out = np.broadcast_to(np.eye(d), (len(places), d, d)).copy()
    out[used] = _checked(tensors, used, mesh.extent)[used]
    return out


def _tensors(values: FloatArray, n: int, d: int, frame: PlaneFrame | None) -> FloatArray:
    """Tensors (n, d, d) of an array of one of the shapes that are taken."""
    space = d if frame is None else 3
    numbers = space * (space + 1) // 2
    shape = values.shape
    wanted = (f"({n}, {space}, {space}), or ({n}, {numbers}) in the order "
              f"{'m11 m12 m22' if space == 2 else 'm11 m12 m22 m13 m23 m33'}")
    if shape[:1] != (n,) or len(shape) not in (2, 3):
        more = ""
        if shape in ((n,), (n, 1)):
            more = ", try size= for lengths"
        elif shape in ((space, space), (numbers,)):
            more = ", try numpy.broadcast_to for the same tensor everywhere"
        msg = f"got a metric of shape {shape}; expected {wanted}{more}"
        raise InvalidOptionError(msg)
    if len(shape) == 2 and shape[1] in (4, 9):
        side = 2 if shape[1] == 4 else 3
        values = values.reshape(n, side, side)
    elif len(shape) == 2 and shape[1] in PACKED:
        values = full(values)
    if values.shape == (n, d, d):
        in_columns = frame is None or np.array_equal(frame.axes, np.eye(3)[:2])
        if in_columns:
            return values
        msg = (f"got a metric of shape {shape}, whose axes are ambiguous for triangles in a plane "
               f"in space; expected {wanted}")
        raise InvalidOptionError(msg)
    if frame is not None and values.shape == (n, 3, 3):
        axes = np.broadcast_to(frame.axes, (n, 2, 3))
        return product(product(axes, values), transposed(axes))
    msg = f"got a metric of shape {shape}; expected {wanted}"
    if shape == (n, 1):
        msg += ", try size= for lengths"
    raise InvalidOptionError(msg)


def _checked(tensors: FloatArray, used: BoolArray, extent: float) -> FloatArray:
    """Symmetric parts of tensors, all of which are metrics at vertices that are used."""
    tensors = tensors.copy()
    finite = np.asarray(np.isfinite(tensors).all(axis=(1, 2)))
    _refuse(used & ~finite, "metric with NaN or infinite entries", "finite ones")
    tensors[~finite] = 0.0
    largest = np.abs(tensors).max(axis=(1, 2))
    skew = np.abs(tensors - transposed(tensors)).max(axis=(1, 2))
    _refuse(used & (skew > ASYMMETRY * largest), "metric that is not symmetric",
            "m_ij = m_ji, try 0.5 * (m + m.swapaxes(1, 2))")
    tensors = 0.5 * tensors + 0.5 * transposed(tensors)
    values, _ = eigenvalues(tensors)
    least, most = values.min(axis=1), values.max(axis=1)
    _refuse(used & ~(least > 0.0), "metric that is not positive definite",
            "positive eigenvalues h^-2 for lengths h, try odt_plugins.metric_from_field")
    shortest, longest = extent / LONGEST, extent * LONGEST
    out = (most > shortest**-2) | (least < longest**-2)
    _refuse(used & out, f"metric with lengths beyond {shortest:.3g} to {longest:.3g}",
            "eigenvalues h^-2 for lengths h in the unit of the points")
    far = most > (MOST_RATIO * (1.0 + ROUNDING)) ** 2 * least
    _refuse(used & far, f"metric with lengths whose ratio is beyond {MOST_RATIO:g}",
            "smaller ratios, try larger values for the smallest eigenvalues")
    return tensors


def _refuse(bad: BoolArray, what: str, expected: str) -> None:
    if bad.any():
        first, count = int(np.argmax(bad)), int(bad.sum())
        msg = f"got a {what} at vertex {first} ({count} of them); expected {expected}"
        raise InvalidOptionError(msg)
