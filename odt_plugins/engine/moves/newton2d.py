"""Newton smoothing of one vertex at a time for F_p = sum over its star of m^-p, d = 2.

With only one vertex x moving, opposite the edge (b, c), the area A is linear in x and
log q = 2 log A - log(l1 + l2 + |bc|) - log l1 - log l2 + constant, l1 = |x - b|, l2 = |x - c|,
for m = q, the radius ratio (5.1); so gradient and Hessian are exact and cheap.  Those of the
other measures, see ``triangle.triangle_measure``, are made of log A, log l1 and log l2 too.
"""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.cells.extremes import Extremes, keeps, worse
from odt_plugins.engine.cells.step import ROOT, eighth_root
from odt_plugins.engine.cells.tetrahedron import MEAN_RATIO, QUALITY, STEP, Cost
from odt_plugins.engine.cells.triangle import (
    angle_cost,
    angle_measure,
    opposite_edge,
    triangle_extremes,
    triangle_measure,
)
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.moves.plane_step import plane_step
from odt_plugins.engine.moves.tangent import set_axes, star_cost, star_normal
from odt_plugins.engine.topology.star import Stars
from odt_plugins.mesh.arrays import FloatArray, IntArray

HALVINGS = 8
"""Step lengths alpha = 1, 1/2, 1/4, ... tried for one vertex."""
DECREASE = 1e-10
"""Least relative decrease of F_p over the star for which a vertex moves."""
ARMIJO = 1e-4
"""Part of the decrease that the slope predicts which a step must reach."""


@kernel
def _mean_ratio_terms(
    ux: float, uy: float, vx: float, vy: float, l3: float, ax: float, ay: float, d2: float
) -> tuple[float, float, float, float, float, float]:
    """Mean ratio m of a triangle, gradient of log m and minus its Hessian, see below."""
    t = ux * ux + uy * uy + vx * vx + vy * vy + l3 * l3
    tx = 2.0 * (ux + vx) / t
    ty = 2.0 * (uy + vy) / t
    return (
        12.0 * d2 / (t * t),
        2.0 * (ax - tx),
        2.0 * (ay - ty),
        2.0 * (ax * ax - tx * tx) + 8.0 / t,
        2.0 * (ax * ay - tx * ty),
        2.0 * (ay * ay - ty * ty) + 8.0 / t,
    )


@kernel
def _step_terms(
    ux: float, uy: float, vx: float, vy: float, l3: float, ax: float, ay: float, d2: float
) -> tuple[float, float, float, float, float, float]:
    """Measure m of the time step, gradient of log m and minus its Hessian, see below."""
    t = ux * ux + uy * uy + vx * vx + vy * vy + l3 * l3
    tx = 2.0 * (ux + vx) / t
    ty = 2.0 * (uy + vy) / t
    return (
        eighth_root(d2 / t),
        ROOT * (2.0 * ax - tx),
        ROOT * (2.0 * ay - ty),
        ROOT * (2.0 * ax * ax - tx * tx + 4.0 / t),
        ROOT * (2.0 * ax * ay - tx * ty),
        ROOT * (2.0 * ay * ay - ty * ty + 4.0 / t),
    )


@kernel
def _angle_terms(
    ux: float, uy: float, vx: float, vy: float, l3: float, ax: float, ay: float, d2: float
) -> tuple[float, float, float, float, float, float]:
    """Measure m of the smallest angle, gradient of log m and minus its Hessian.

    u = x - b, v = x - c, l3 = |bc|, a the gradient of log A and d2 = 4 A^2.
    """
    s1 = ux * ux + uy * uy
    s2 = vx * vx + vy * vy
    s3 = l3 * l3
    w1 = angle_cost(s1 * s2, d2)
    w2 = angle_cost(s1 * s3, d2)
    w3 = angle_cost(s2 * s3, d2)
    total = w1 + w2 + w3
    w1 /= total
    w2 /= total
    w3 /= total
    # gradients of log l1^2 and log l2^2, then of the three log sin^2
    px = 2.0 * ux / s1
    py = 2.0 * uy / s1
    rx = 2.0 * vx / s2
    ry = 2.0 * vy / s2
    x1 = 2.0 * ax - px - rx
    y1 = 2.0 * ay - py - ry
    x2 = 2.0 * ax - px
    y2 = 2.0 * ay - py
    x3 = 2.0 * ax - rx
    y3 = 2.0 * ay - ry
    gx = w1 * x1 + w2 * x2 + w3 * x3
    gy = w1 * y1 + w2 * y2 + w3 * y3
    b = w1 + w2
    c = w1 + w3
    iso = 2.0 * (b / s1 + c / s2)
    return (
        angle_measure(total),
        gx,
        gy,
        2.0 * ax * ax + iso - b * px * px - c * rx * rx
        + 4.0 * (w1 * x1 * x1 + w2 * x2 * x2 + w3 * x3 * x3 - gx * gx),
        2.0 * ax * ay - b * px * py - c * rx * ry
        + 4.0 * (w1 * x1 * y1 + w2 * x2 * y2 + w3 * x3 * y3 - gx * gy),
        2.0 * ay * ay + iso - b * py * py - c * ry * ry
        + 4.0 * (w1 * y1 * y1 + w2 * y2 * y2 + w3 * y3 * y3 - gy * gy),
    )


@kernel
def star_cost_2d(
    points: FloatArray, cells: IntArray, star: IntArray, vertex: int, kind: Cost,
    derivatives: FloatArray,
) -> float:
    """Sum of m^-p over the star of a vertex, with gradient and Hessian in its position.

    Parameters
    ----------
    points : (n, 2) float64, cells : (m, 3) int32 counterclockwise
    star : (k,) int32             the cells around it
    vertex : int
    kind : Cost                   measure m, see ``triangle_measure``, and p
    derivatives : (5,) float64    OUT: F_x, F_y, F_xx, F_xy, F_yy

    Returns
    -------
    float                         infinite when a triangle is not positive
    """
    objective, power = kind
    derivatives[:] = 0.0
    total = 0.0
    x = points[vertex, 0]
    y = points[vertex, 1]
    for s in range(star.shape[0]):
        t = star[s]
        b, c = opposite_edge(cells, t, vertex)
        ux = x - points[b, 0]
        uy = y - points[b, 1]
        vx = x - points[c, 0]
        vy = y - points[c, 1]
        wx = points[c, 0] - points[b, 0]
        wy = points[c, 1] - points[b, 1]
        double_area = ux * vy - uy * vx
        l1 = math.sqrt(ux * ux + uy * uy)
        l2 = math.sqrt(vx * vx + vy * vy)
        l3 = math.sqrt(wx * wx + wy * wy)
        if not (double_area > 0.0 and l1 > 0.0 and l2 > 0.0):
            return np.inf
        # grad log A
        ax = -wy / double_area
        ay = wx / double_area
        if objective == QUALITY:
            perimeter = l1 + l2 + l3
            q = 4.0 * double_area * double_area / (perimeter * l1 * l2 * l3)
            i1 = 1.0 / l1
            i2 = 1.0 / l2
            ip = 1.0 / perimeter
            ux *= i1
            uy *= i1
            vx *= i2
            vy *= i2
            # grad log perimeter
            px = (ux + vx) * ip
            py = (uy + vy) * ip
            gx = 2.0 * ax - px - ux * i1 - vx * i2
            gy = 2.0 * ay - py - uy * i1 - vy * i2
            # -Hess log q; Hess l = (I - u u^T) / l, Hess log l = (I - 2 u u^T) / l^2
            r1 = i1 * ip
            r2 = i2 * ip
            s1 = i1 * i1
            s2 = i2 * i2
            iso = r1 + r2 + s1 + s2
            t1 = r1 + 2.0 * s1
            t2 = r2 + 2.0 * s2
            hxx = 2.0 * ax * ax - px * px + iso - t1 * ux * ux - t2 * vx * vx
            hxy = 2.0 * ax * ay - px * py - t1 * ux * uy - t2 * vx * vy
            hyy = 2.0 * ay * ay - py * py + iso - t1 * uy * uy - t2 * vy * vy
        elif objective == MEAN_RATIO:
            q, gx, gy, hxx, hxy, hyy = _mean_ratio_terms(
                ux, uy, vx, vy, l3, ax, ay, double_area * double_area
            )
        elif objective == STEP:
            q, gx, gy, hxx, hxy, hyy = _step_terms(
                ux, uy, vx, vy, l3, ax, ay, double_area * double_area
            )
        else:
            q, gx, gy, hxx, hxy, hyy = _angle_terms(
                ux, uy, vx, vy, l3, ax, ay, double_area * double_area
            )
        f = q**-power
        pf = power * f
        total += f
        derivatives[0] -= pf * gx
        derivatives[1] -= pf * gy
        derivatives[2] += pf * (power * gx * gx + hxx)
        derivatives[3] += pf * (power * gx * gy + hxy)
        derivatives[4] += pf * (power * gy * gy + hyy)
    return total


@kernel
def _star_shape(
    points: FloatArray, cells: IntArray, star: IntArray, kind: Cost
) -> tuple[float, Extremes]:
    """F_p of some cells, and their extremes; F_p is infinite where a triangle is not positive."""
    total = 0.0
    found = Extremes(1.0, -1.0, 1.0)
    for s in range(star.shape[0]):
        t = star[s]
        a, b, c = cells[t, 0], cells[t, 1], cells[t, 2]
        own = triangle_extremes(points, a, b, c)
        if not own.quality > 0.0:
            return np.inf, Extremes(own.quality, 1.0, -1.0)
        m = own.quality
        if kind.objective != QUALITY:
            m = triangle_measure(points, a, b, c, kind.objective)
        total += m**-kind.power
        found = worse(found, own)
    return total, found


@kernel
def newton_vertex_2d(
    points: FloatArray, cells: IntArray, star: IntArray, v: int, kind: Cost, bounds: Extremes,
    derivatives: FloatArray, axes: FloatArray,
) -> tuple[float, float]:
    """One guarded Newton step on F_p for vertex v, in place; in space in its tangent plane.

    Parameters as for :func:`star_cost_2d` and :func:`smooth_vertices_2d`, and

    Parameters
    ----------
    axes : (2, d) float64    orthonormal directions of the plane; OUT where d = 3

    Returns
    -------
    before, after : float    F_p over the star, the same when the vertex stays

    Notes
    -----
    The Hessian is made positive definite by a shift; alpha = 1, 1/2, 1/4, ... until F_p decreases
    strictly with every area positive.
    """
    dim = points.shape[1]
    if dim == 2:
        cost = star_cost_2d(points, cells, star, v, kind, derivatives)
    else:
        set_axes(*star_normal(points, cells, star), axes)
        cost = star_cost(points, cells, star, v, kind.power, axes, derivatives)
    if not cost < np.inf:
        return cost, cost
    g1, g2 = derivatives[0], derivatives[1]
    d1, d2 = plane_step(g1, g2, derivatives[2], derivatives[3], derivatives[4], False)
    slope = g1 * d1 + g2 * d2
    if not -slope > DECREASE * cost:
        return cost, cost
    x, y, z = points[v, 0], points[v, 1], points[v, dim - 1]
    dx = d1 * axes[0, 0] + d2 * axes[1, 0]
    dy = d1 * axes[0, 1] + d2 * axes[1, 1]
    dz = d1 * axes[0, dim - 1] + d2 * axes[1, dim - 1]
    alpha = 1.0
    for _ in range(HALVINGS):
        _put(points, v, x + alpha * dx, y + alpha * dy, z + alpha * dz)
        there, found = _star_shape(points, cells, star, kind)
        if there <= cost + ARMIJO * alpha * slope and there < (1.0 - DECREASE) * cost:
            if keeps(found, bounds):
                return cost, there
            _put(points, v, x, y, z)
            _, here = _star_shape(points, cells, star, kind)
            if keeps(found, worse(bounds, here)):
                _put(points, v, x + alpha * dx, y + alpha * dy, z + alpha * dz)
                return cost, there
        alpha *= 0.5
    _put(points, v, x, y, z)
    return cost, cost


@kernel
def _put(points: FloatArray, v: int, x: float, y: float, z: float) -> None:
    """Put vertex v at (x, y), or (x, y, z) in space; y and z are the same in the plane."""
    points[v, points.shape[1] - 1] = z
    points[v, 0] = x
    points[v, 1] = y


@allocating_kernel
def smooth_vertices_2d(
    points: FloatArray, cells: IntArray, stars: Stars, order: IntArray, start: int, stop: int,
    kind: Cost, bounds: Extremes, moved: FloatArray,
) -> int:
    """One :func:`newton_vertex_2d` for every vertex of order[start:stop], in place.

    Parameters
    ----------
    points : (n, 2) float64         changed in place
    cells : (m, 3) int32            counterclockwise
    stars : Stars
    order : (k,) int32              vertices, moved one after another
    start, stop : int
    kind : Cost                     measure m, see ``triangle_measure``, and p > 0
    bounds : Extremes               a step that passes one of them and makes the star worse there
                                    is shortened
    moved : (n,) float64            OUT: relative decrease of F_p over the star, 0 if it stays

    Returns
    -------
    int                             number of vertices moved
    """
    derivatives = np.empty(5)
    axes = np.eye(2)
    count = 0
    for o in range(start, stop):
        v = order[o]
        moved[v] = 0.0
        first, last = stars.indptr[v], stars.indptr[v + 1]
        if first == last:
            continue
        before, after = newton_vertex_2d(
            points, cells, stars.indices[first:last], v, kind, bounds, derivatives, axes
        )
        if after < before:
            moved[v] = 1.0 - after / before
        if moved[v] > 0.0:
            count += 1
    return count
