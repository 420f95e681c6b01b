"""A metric in which a mesh of so many cells interpolates a field best."""

from __future__ import annotations

import math
from collections.abc import Sequence
from numbers import Integral
from typing import Any

import numpy as np

from odt_plugins.adapters.fields import named_field
from odt_plugins.adapters.host import HostMesh, flat_points, words_of
from odt_plugins.adapters.registry import find_adapter
from odt_plugins.engine.cells.content import CONTENT
from odt_plugins.engine.cells.elementary import power
from odt_plugins.engine.cells.geometry import signed_volumes
from odt_plugins.engine.cells.tensors import (
    determinants,
    eigenvalues,
    intersection,
    of_eigenvalues,
    positive_eigenvalues,
)
from odt_plugins.errors import InvalidOptionError, expect, is_number, plain_values
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.numbers import real_numbers
from odt_plugins.mesh.simplex import corner_mean, diagonal, vertices_of
from odt_plugins.metric.given import MOST_RATIO
from odt_plugins.metric.hessian import Tangents, recovered_hessians, tangents
from odt_plugins.metric.implied import star_means
from odt_plugins.metric.limits import GROWTH, bounded_metric, grown_metric

NOTHING = 1e-8
"""Second derivative times the squared diagonal, as a part of the range of the field, below which
there is none."""

LENGTHS = (1e-5, 0.5)
"""Shortest and longest length, as parts of the diagonal."""

SIGNED = {2: 3.5, 3: 4.0}
"""What the squared trace of a form counts for the squared error beside the trace of its square."""

LARGE = 1e300
"""Largest value of a field whose range surely is a number."""

TRIES = 12
"""Most scales that are tried until the metric has its number of cells."""

NEAR = 0.005
"""Part by which that number may be missed."""

RATIO = 1e3
"""Largest ratio of the lengths of a cell in two directions, unless another is given."""


def metric_from_field(
    mesh: Any, values: Any, cells: int, *, norm: float = 2.0, growth: float | None = None,
    ratio: float = RATIO,
) -> FloatArray:
    """Make a metric in which a mesh of so many cells interpolates a field with the least error.

    Parameters
    ----------
    mesh : object                one mesh of any kind that :func:`odt_plugins.optimize` takes
    values : array, str, list of str or callable
                                 of a field at the vertices: (n,), or (n, c) of one with c
                                 components, whose metrics are intersected; the name of a point
                                 array of the mesh, or the names of several, each of which that is
                                 not linear all over is scaled to `cells` before they are
                                 intersected; or a function values(points)
    cells : int                  about how many cells there are to be
    norm : float                 p of the L^p norm of the error that is to be least; inf for the
                                 largest error. The larger it is the more cells go to where the
                                 field is steepest
    growth : float               largest ratio of lengths at the ends of an edge of length 1, unless
                                 given 3
    ratio : float                largest ratio of the lengths of a cell in two directions

    Returns
    -------
    (n, d, d) float64            d the dimension of the points; for `metric` of
                                 :func:`odt_plugins.remesh`. Where the mesh is a surface in space,
                                 second derivatives are those along it, and lengths normal to it are
                                 the shorter ones along it. Cells of higher order have it at their
                                 corners, and means of these at the nodes between

    Raises
    ------
    InvalidOptionError           values that are not finite real numbers of every vertex, or options
                                 out of range

    Notes
    -----
    M = c det|H|^(-1 / (2 p + d)) |H|, where |H| is the mean over the cells around of the Hessian
    with the absolute values of its eigenvalues, where it is a saddle times
    :func:`error_by_signs`, and c such that the integral of sqrt(det M) is that of `cells` good
    cells. No length is beyond half the diagonal of the mesh; where one is at it, the others are
    those with the least error then.

    References
    ----------
    L. Chen, P. Sun, J. Xu, Optimal anisotropic meshes for minimizing interpolation errors in L^p
    norm, Math. Comp. 76 (2007) 179-204; A. Loseille, F. Alauzet, Continuous mesh framework, SIAM J.
    Numer. Anal. 49 (2011) 38-86.

    Examples
    --------
    >>> import numpy as np
    >>> import odt_plugins
    >>> x, y = np.meshgrid(np.linspace(0, 1, 6), np.linspace(0, 1, 6))
    >>> points = np.stack([x.ravel(), y.ravel()], axis=1)
    >>> from scipy.spatial import Delaunay
    >>> mesh = points, Delaunay(points).simplices
    >>> metric = odt_plugins.metric_from_field(mesh, 9 * points[:, 0]**2 + points[:, 1]**2, 1000)
    >>> stretch = np.sqrt(metric[:, 0, 0] / metric[:, 1, 1])
    >>> bool(np.allclose(stretch, 3.0, rtol=1e-3))
    True
    """
    return _with_least_error(mesh, values, cells, norm, growth, ratio, "field ")


def adapted_metric(
    mesh: Any, names: str | Sequence[str], cells: int | None, vertices: int | None,
    growth: float | None, ratio: float | None,
) -> FloatArray:
    """As :func:`metric_from_field` of point arrays, for so many cells or about so many vertices."""
    listed = [names] if isinstance(names, str) else list(names)
    count = cells or 5 * (vertices or 1)
    return _with_least_error(mesh, listed, count, 2.0, growth, ratio or RATIO, "adapt=")


def _with_least_error(
    mesh: Any, values: Any, cells: int, norm: float, growth: float | None, ratio: float, what: str
) -> FloatArray:
    """As :func:`metric_from_field`; ``what`` is before the names of fields in errors."""
    cells, norm, growth, ratio = (plain_values(name, value) for name, value in (
        ("cells", cells), ("norm", norm), ("growth", growth), ("ratio", ratio)))
    expect(isinstance(cells, Integral) and not isinstance(cells, bool) and cells >= 1, "cells",
            cells, "an integer of at least 1")
    expect(is_number(norm) and norm >= 1.0, "norm", norm, "a number of at least 1, or inf")
    good = growth is None or (is_number(growth) and 1.0 < growth < math.inf)
    expect(good, "growth", growth, "a number above 1, such as 3")
    expect(is_number(ratio) and 1.0 <= ratio <= MOST_RATIO, "ratio", ratio,
            f"a number from 1 to {MOST_RATIO:g}")
    host = find_adapter(mesh).read(mesh)
    with words_of(host):
        points, frame = flat_points(host)
        corners = np.ascontiguousarray(host.cells, dtype=np.int32)
        fields = [_of_unit_range(_values(host, part, what), corners) for part in _parts(values)]
    along = tangents(points, corners) if points.shape[1] == corners.shape[1] else None
    limits = growth or GROWTH, ratio
    known = [(recovered_hessians(points, corners, field, along), _least(points, corners, field))
             for field in fields]
    bent = [pair for pair in known if np.abs(pair[0]).max() > pair[1]] or known[:1]
    found = [hessians_to_metric(points, corners, *pair, cells, norm, limits, along)
             for pair in bent]
    metric = found[0]
    if len(found) > 1:
        for other in found[1:]:
            metric = intersection(metric, other)
        metric = scaled_to(points, corners, metric, cells, limits, along)
    if frame is not None:
        normal = np.cross(frame.axes[0], frame.axes[1])
        plane = Tangents(np.broadcast_to(frame.axes, (len(points), 2, 3)),
                         np.broadcast_to(normal, (len(points), 3)))
        metric = plane.lifted(metric)
    return _at_nodes(host, metric)


def _at_nodes(host: HostMesh, metric: FloatArray) -> FloatArray:
    """A metric known at corners of cells, also at the nodes between those of higher order."""
    if host.nodes is None or host.shape is None:
        return metric
    nodes, k = np.asarray(host.nodes), host.shape.shape[1]
    out, weights = metric.copy(), host.shape[k:, :, None, None] / host.shape[0].sum()
    for i in range(nodes.shape[1] - k):
        out[nodes[:, k + i]] = sum(weights[i, c] * metric[nodes[:, c]] for c in range(k))
    return out


def hessians_to_metric(
    points: FloatArray, cells: IntArray, hessians: FloatArray, least: float, count: float,
    norm: float, limits: tuple[float, float], along: Tangents | None = None,
) -> FloatArray:
    """The metric (n, D, D) of fields of one unit whose Hessians are known, by eight parameters.

    Parameters
    ----------
    points, cells : arrays       see :func:`odt_plugins.metric.hessian.recovered_hessians`
    hessians : (c, n, d, d)
    least : float                absolute value below which a second derivative is taken for this
    count, norm : float          see :func:`metric_from_field`
    limits : growth and ratio    see :func:`metric_from_field`
    along : Tangents             of triangles in space
    """
    d = hessians.shape[-1]
    parts = []
    for hessian in hessians:
        values, axes = eigenvalues(hessian)
        sizes = np.maximum(np.abs(values), least)
        sizes = np.maximum(sizes, sizes.max(axis=1, keepdims=True) / limits[1] ** 2)
        level = error_by_signs(values / sizes)
        part = of_eigenvalues(level[:, None] * sizes, axes)
        parts.append(_around(points, cells, part, along))
    metric = parts[0]
    for other in parts[1:]:
        metric = intersection(metric, other)
    if norm < math.inf:
        metric = power(determinants(metric), -1.0 / (2.0 * norm + d))[:, None, None] * metric
    if along is not None:
        metric = along.lifted(metric)
    return scaled_to(points, cells, metric, count, limits, along, norm)


def error_by_signs(signs: FloatArray) -> FloatArray:
    """Error of a quadratic function beside that of a definite one of the same |H|.

    Parameters
    ----------
    signs : (n, d) float64    eigenvalues of H over those of |H|: from -1 to 1

    Returns
    -------
    (n,) float64              at most 1: .35 of a saddle in the plane, .42 of one in space

    Notes
    -----
    The root of the mean over all rotations of the squared L^2 error on a cell that is regular in
    |H|. It is a quadratic function of T = diag(signs) that rotations leave as it is, so of d, for
    the trace of T^2, and of t, the trace of T: that of d + SIGNED t^2, by the moments of
    barycentric coordinates. Cells err as if H were this factor times |H|: where H is no saddle they
    err most, so that those have to be smaller.

    References
    ----------
    J.-M. Mirebeau, Optimal meshes for finite elements of arbitrary order, Constr. Approx. 32 (2010)
    339-383: the error on the best mesh depends on the determinant and on the signs.
    """
    d = signs.shape[1]
    signed = SIGNED[d] * signs.sum(axis=1) ** 2
    out: FloatArray = np.sqrt((d + signed) / (d + SIGNED[d] * d * d))
    return out


def _around(
    points: FloatArray, cells: IntArray, tensors: FloatArray, along: Tangents | None
) -> FloatArray:
    """Means of tensors over the cells around vertices.

    The error of a cell is that of |H| all over it, which may be 0 at a vertex.
    """
    if along is not None:
        tensors = along.lifted(tensors)
    mean = star_means(points, cells, tensors[cells].mean(axis=1))
    unused = np.bincount(cells.ravel(), minlength=len(points)) == 0
    mean[unused] = tensors[unused]
    return mean if along is None else along.along(mean)


def scaled_to(
    points: FloatArray, cells: IntArray, metric: FloatArray, count: float,
    limits: tuple[float, float], along: Tangents | None = None, norm: float = math.inf,
) -> FloatArray:
    """The multiple of a metric that, once it is limited, has a number of cells.

    Growth and bounds add cells, by how many depends on the scale, which is found by steps that
    divide the error in log(cells) by its slope between the last two scales.  For `norm` see
    :func:`..limits.bounded_metric`.
    """
    d = cells.shape[1] - 1
    growth, ratio = limits
    size = diagonal(points[vertices_of(cells)])
    least, most = LENGTHS[0] * size, LENGTHS[1] * size

    def limited(scale: float) -> tuple[FloatArray, float]:
        out = scale * (metric if along is None else along.along(metric))
        out = bounded_metric(out, ratio, least, most, norm)
        out = out if along is None else along.lifted(out)
        out = bounded_metric(grown_metric(points, cells, out, growth), ratio)
        if along is not None:
            out = along.lifted(along.along(out))
        return out, math.log(cells_of_metric(points, cells, out, along) / count)

    now = math.log(count / cells_of_metric(points, cells, metric, along)) * 2.0 / d
    slope = 0.5 * d
    out, over = limited(math.exp(now))
    for _ in range(TRIES):
        if abs(over) <= NEAR:
            break
        before, was = now, over
        now -= max(-8.0, min(8.0, over / slope))
        out, over = limited(math.exp(now))
        if now != before:
            slope = max(0.05 * d, min(0.5 * d, (over - was) / (now - before)))
    return out


def cells_of_metric(
    points: FloatArray, cells: IntArray, metric: FloatArray, along: Tangents | None = None
) -> float:
    """About how many cells with edges of length 1 in a metric fill a mesh."""
    content = np.abs(signed_volumes(points, cells))
    dense = np.sqrt(determinants(metric if along is None else along.along(metric)))
    return float((content * corner_mean(dense, cells)).sum()) / CONTENT[cells.shape[1]]


def largest_ratio(metric: FloatArray) -> float:
    """Largest ratio of lengths in two directions of a metric (n, d, d)."""
    values = positive_eigenvalues(metric)[0]
    return float(np.sqrt(values.max(axis=1) / values.min(axis=1)).max())


def _of_unit_range(field: FloatArray, cells: IntArray) -> FloatArray:
    """A field times the power of two that brings its range near 1: units do not change metrics."""
    field = np.ldexp(field, -2) if np.abs(field).max() > LARGE else field
    spread = float(np.ptp(field[vertices_of(cells)], axis=0).max())
    return np.ldexp(field, -math.frexp(spread)[1])


def _least(points: FloatArray, cells: IntArray, field: FloatArray) -> float:
    """The second derivative that counts as none."""
    used = vertices_of(cells)
    spread = float(np.ptp(field[used], axis=0).max()) or 1.0
    return NOTHING * spread / diagonal(points[used]) ** 2


def _parts(values: Any) -> list[Any]:
    """Fields that have units of their own: one for each listed name, else a single one."""
    names = isinstance(values, list | tuple) and values and isinstance(values[0], str)
    return list(values) if names else [values]


def _values(host: HostMesh, given: Any, what: str) -> FloatArray:
    """Components (n, c) of one field."""
    n, name = len(host.points), "a field"
    if isinstance(given, str):
        name, given = f"{what}{given!r}", named_field(host, given, what)
    raw = given(np.array(host.points, dtype=np.float64)) if callable(given) else given
    raw = plain_values("values", raw)
    field = real_numbers(
        raw, "values of a field that are no real numbers", f"({n},) or ({n}, c)")
    if field.shape[:1] != (n,) or not field.size:
        turned = ", try their transpose" if field.shape[1:] == (n,) else ""
        msg = f"got values of a field of shape {field.shape}; expected ({n},) or ({n}, c){turned}"
        raise InvalidOptionError(msg)
    field = field.reshape(n, -1)
    used = np.unique(np.asarray(host.cells, dtype=np.int64))
    bad = used[~np.isfinite(field[used]).all(axis=1)]
    if bad.size:
        msg = (f"got {name} with NaN or infinite values at vertex {bad[0]} ({bad.size} of them); "
               f"expected finite ones")
        raise InvalidOptionError(msg)
    rest = np.setdiff1d(np.arange(n), used)
    if rest.size:
        field[rest] = 0.0
    return field
