"""One triangle in the plane or in space: its edges, what is made of them, and its radius ratio.

All measures of a triangle are functions of its squared edges and area, their derivatives of a
`MovingTriangle`. Edges are as they are seen, see ``metric``; area vectors are as they are.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from odt_plugins.engine.cells.corner import Edges
from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.cells.metric import (
    edges_through,
    has_metric,
    in_space,
    through,
    triangle_root,
)
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.topology.lookup import place_in
from odt_plugins.mesh.arrays import FloatArray, IntArray


@kernel
def offset(points: FloatArray, a: int, b: int) -> tuple[float, float, float]:
    """Vector from point a to point b in space."""
    return points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]


@kernel
def _edges(points: FloatArray, a: int, b: int, c: int) -> Edges:
    """Edges bc, ca and ab, one coordinate after another; in the plane with z = 0."""
    if in_space(points):
        return offset(points, b, c) + offset(points, c, a) + offset(points, a, b)
    return (
        points[c, 0] - points[b, 0], points[c, 1] - points[b, 1], 0.0,
        points[a, 0] - points[c, 0], points[a, 1] - points[c, 1], 0.0,
        points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], 0.0,
    )


@kernel
def _seen_edges(points: FloatArray, a: int, b: int, c: int) -> Edges:
    """The same edges as they are seen."""
    edges = _edges(points, a, b, c)
    if not has_metric(points):
        return edges
    return edges_through(triangle_root(points, a, b, c), edges)


@kernel
def opposite_edge(triangles: IntArray, t: int, v: int) -> tuple[int, int]:
    """The other two vertices of triangle t, such that (v, b, c) turns as the triangle does."""
    i = place_in(triangles, t, v)
    return triangles[t, (i + 1) % 3], triangles[t, (i + 2) % 3]


@kernel
def triangle_extremes(points: FloatArray, a: int, b: int, c: int) -> Extremes:
    """Radius ratio 2 r / R (5.1), cosine of the smallest and of the largest angle.

    In the plane the radius ratio is 0 or negative when (a, b, c) is not counterclockwise.
    """
    if in_space(points):
        q, large, small, _, _, _ = triangle_in_space(points, a, b, c)
        return Extremes(q, large, small)
    ux, uy, _, vx, vy, _, wx, wy, _ = _seen_edges(points, a, b, c)
    lu = math.sqrt(ux * ux + uy * uy)
    lv = math.sqrt(vx * vx + vy * vy)
    lw = math.sqrt(wx * wx + wy * wy)
    if not (lu > 0.0 and lv > 0.0 and lw > 0.0):
        return Extremes(0.0, 1.0, -1.0)
    double_area = vx * wy - vy * wx
    # 16 A^2 / (perimeter a b c), with the sign of the area
    q = 4.0 * double_area * abs(double_area) / ((lu + lv + lw) * lu * lv * lw)
    cu = -(vx * wx + vy * wy) / (lv * lw)
    cv = -(wx * ux + wy * uy) / (lw * lu)
    cw = -(ux * vx + uy * vy) / (lu * lv)
    return Extremes(q, max(cu, cv, cw), min(cu, cv, cw))


@kernel
def triangle_in_space(
    points: FloatArray, a: int, b: int, c: int
) -> tuple[float, float, float, float, float, float]:
    """Radius ratio 2 r / R (5.1), cosines of the smallest and largest angle, twice the area vector.

    Parameters
    ----------
    points : (n, 3) float64
    a, b, c : int              corners; a flat triangle has q = 0 and cosines 1 and -1
    """
    ux, uy, uz, vx, vy, vz, wx, wy, wz = _edges(points, a, b, c)
    nx, ny, nz = vy * wz - vz * wy, vz * wx - vx * wz, vx * wy - vy * wx
    if has_metric(points):
        ux, uy, uz, vx, vy, vz, wx, wy, wz = _seen_edges(points, a, b, c)
        sx, sy, sz = vy * wz - vz * wy, vz * wx - vx * wz, vx * wy - vy * wx
        q, large, small = _shape(
            ux, uy, uz, vx, vy, vz, wx, wy, wz, sx * sx + sy * sy + sz * sz)
        return q, large, small, nx, ny, nz
    q, large, small = _shape(ux, uy, uz, vx, vy, vz, wx, wy, wz, nx * nx + ny * ny + nz * nz)
    return q, large, small, nx, ny, nz


@kernel
def _shape(
    ux: float, uy: float, uz: float, vx: float, vy: float, vz: float, wx: float, wy: float,
    wz: float, square: float,
) -> tuple[float, float, float]:
    """Radius ratio, cosines of smallest and largest angle of edges and twice the area squared."""
    lu = math.sqrt(ux * ux + uy * uy + uz * uz)
    lv = math.sqrt(vx * vx + vy * vy + vz * vz)
    lw = math.sqrt(wx * wx + wy * wy + wz * wz)
    if not (lu > 0.0 and lv > 0.0 and lw > 0.0):
        return 0.0, 1.0, -1.0
    # 16 A^2 / (perimeter a b c)
    q = 4.0 * square / ((lu + lv + lw) * lu * lv * lw)
    cu = -(vx * wx + vy * wy + vz * wz) / (lv * lw)
    cv = -(wx * ux + wy * uy + wz * uz) / (lw * lu)
    cw = -(ux * vx + uy * vy + uz * vz) / (lu * lv)
    return q, max(cu, cv, cw), min(cu, cv, cw)


@kernel
def triangle_altitude(points: FloatArray, a: int, b: int, c: int) -> float:
    """Least altitude of a triangle in the plane or in space, 0 of a flat one.

    Twice the area is the product of two edges less their projections on each other, by Lagrange's
    identity: D^2 = sum_(i < j) (v_i w_j - v_j w_i)^2.
    """
    ux, uy, uz, vx, vy, vz, wx, wy, wz = _seen_edges(points, a, b, c)
    nz, ny, nx = vy * wx - wy * vx, vz * wx - wz * vx, vz * wy - wz * vy
    most = max(ux * ux + uy * uy + uz * uz, max(
        vx * vx + vy * vy + vz * vz, wx * wx + wy * wy + wz * wz))
    return math.sqrt((nz * nz + ny * ny + nx * nx) / most) if most > 0.0 else 0.0


@kernel
def squares(points: FloatArray, a: int, b: int, c: int) -> tuple[float, float, float, float]:
    """Squares of the edges bc, ca and ab and of twice the area D, in the plane with its sign."""
    if in_space(points):
        ux, uy, uz, vx, vy, vz, wx, wy, wz = _seen_edges(points, a, b, c)
        nx, ny, nz = vy * wz - vz * wy, vz * wx - vx * wz, vx * wy - vy * wx
        return (
            ux * ux + uy * uy + uz * uz, vx * vx + vy * vy + vz * vz,
            wx * wx + wy * wy + wz * wz, nx * nx + ny * ny + nz * nz,
        )
    ux, uy, _, vx, vy, _, wx, wy, _ = _seen_edges(points, a, b, c)
    double_area = vx * wy - vy * wx
    return (
        ux * ux + uy * uy, vx * vx + vy * vy, wx * wx + wy * wy,
        double_area * abs(double_area),
    )


class MovingTriangle(NamedTuple):
    """A triangle whose corner x moves along two orthonormal directions; opposite is the edge bc.

    Attributes
    ----------
    uu, vv : float             squares of u = x - b and v = x - c
    w : float                  length of bc
    total : float              sum of the three squared edges
    square : float             B = D^2, D twice the area; not positive for a triangle that is not
    u1, u2, v1, v2 : float     u and v along the directions
    b1, b2 : float             gradient of log B
    b11, b12, b22 : float      minus the Hessian of log B
    r11, r12, r21, r22 : float
        row i is how the corner is seen to move, along the directions above, where it moves along
        direction i of the caller; the identity without a metric
    """

    uu: float
    vv: float
    w: float
    total: float
    square: float
    u1: float
    u2: float
    v1: float
    v2: float
    b1: float
    b2: float
    b11: float
    b12: float
    b22: float
    r11: float
    r12: float
    r21: float
    r22: float


NO_ROOT = (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)
"""S of what is seen as it is."""

NOT_POSITIVE = MovingTriangle(
    0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0)
"""Of a triangle that is inverted or flat."""


@kernel
def moving_triangle(
    points: FloatArray, x: int, b: int, c: int, axes: FloatArray
) -> MovingTriangle:
    """The triangle (x, b, c) with what the derivatives of all measures are made of.

    In the plane, where the axes are those of the coordinates, D is linear; in space B is
    |w|^2 |u|^2 - (u w)^2, a quadratic of the vertex.

    Parameters
    ----------
    points : (n, d) float64
    x, b, c : int
    axes : (2, d) float64      orthonormal directions; not read where d = 2
    """
    edges = _edges(points, x, b, c)
    root = NO_ROOT
    if has_metric(points):
        root = triangle_root(points, x, b, c)
        edges = edges_through(root, edges)
    wx, wy, wz, vx, vy, vz, ux, uy, uz = edges
    ux, uy, uz = -ux, -uy, -uz
    if not in_space(points):
        double_area = ux * vy - uy * vx
        if not double_area > 0.0:
            return NOT_POSITIVE
        ax, ay, w = -wy / double_area, wx / double_area, math.sqrt(wx * wx + wy * wy)
        return MovingTriangle(
            ux * ux + uy * uy, vx * vx + vy * vy, w,
            ux * ux + uy * uy + vx * vx + vy * vy + w * w, double_area * double_area,
            ux, uy, vx, vy, 2.0 * ax, 2.0 * ay, 2.0 * ax * ax, 2.0 * ax * ay, 2.0 * ay * ay,
            root[0], root[1], root[1], root[3],
        )
    r11, r21, r22 = 1.0, 0.0, 1.0
    ex, ey, ez = axes[0, 0], axes[0, 1], axes[0, 2]
    fx, fy, fz = axes[1, 0], axes[1, 1], axes[1, 2]
    if has_metric(points):
        ex, ey, ez = through(root, ex, ey, ez)
        fx, fy, fz = through(root, fx, fy, fz)
        r11 = math.sqrt(ex * ex + ey * ey + ez * ez)
        ex, ey, ez = ex / r11, ey / r11, ez / r11
        r21 = fx * ex + fy * ey + fz * ez
        fx, fy, fz = fx - r21 * ex, fy - r21 * ey, fz - r21 * ez
        r22 = math.sqrt(fx * fx + fy * fy + fz * fz)
        fx, fy, fz = fx / r22, fy / r22, fz / r22
    uu = ux * ux + uy * uy + uz * uz
    vv = vx * vx + vy * vy + vz * vz
    ww = wx * wx + wy * wy + wz * wz
    uw = ux * wx + uy * wy + uz * wz
    u1, u2 = ux * ex + uy * ey + uz * ez, ux * fx + uy * fy + uz * fz
    v1, v2 = vx * ex + vy * ey + vz * ez, vx * fx + vy * fy + vz * fz
    w1, w2 = wx * ex + wy * ey + wz * ez, wx * fx + wy * fy + wz * fz
    square = ww * uu - uw * uw
    if not square > 0.0:
        return NOT_POSITIVE
    ib = 2.0 / square
    b1, b2 = (ww * u1 - uw * w1) * ib, (ww * u2 - uw * w2) * ib
    return MovingTriangle(
        uu, vv, math.sqrt(ww), uu + vv + ww, square, u1, u2, v1, v2, b1, b2,
        b1 * b1 - (ww - w1 * w1) * ib, b1 * b2 + w1 * w2 * ib, b2 * b2 - (ww - w2 * w2) * ib,
        r11, 0.0, r21, r22,
    )


@kernel
def triangle_quality(uu: float, vv: float, ww: float, square: float) -> float:
    """Radius ratio 2 r / R = 4 D^2 / (perimeter |u| |v| |w|) from what :func:`squares` gives."""
    lu, lv, lw = math.sqrt(uu), math.sqrt(vv), math.sqrt(ww)
    if not (lu > 0.0 and lv > 0.0 and lw > 0.0):
        return 0.0
    return 4.0 * square / ((lu + lv + lw) * lu * lv * lw)


@kernel
def triangle_quality_terms(
    t: MovingTriangle,
) -> tuple[float, float, float, float, float, float]:
    """Radius ratio q of a triangle, gradient of log q and minus its Hessian in the moving corner.

    log q = log B - log l1 - log l2 - log(l1 + l2 + |w|) + constant, l1 = |u|, l2 = |v|;
    Hess l = (I - u u^T) / l, Hess log l = (I - 2 u u^T) / l^2 for the unit vector u.
    """
    l1, l2 = math.sqrt(t.uu), math.sqrt(t.vv)
    perimeter = l1 + l2 + t.w
    i1 = 1.0 / l1
    i2 = 1.0 / l2
    ip = 1.0 / perimeter
    u1, u2, v1, v2 = t.u1 * i1, t.u2 * i1, t.v1 * i2, t.v2 * i2
    # gradient of log perimeter
    p1 = (u1 + v1) * ip
    p2 = (u2 + v2) * ip
    r1 = i1 * ip
    r2 = i2 * ip
    s1 = i1 * i1
    s2 = i2 * i2
    iso = r1 + r2 + s1 + s2
    t1 = r1 + 2.0 * s1
    t2 = r2 + 2.0 * s2
    return (
        4.0 * t.square / (perimeter * l1 * l2 * t.w),
        t.b1 - p1 - u1 * i1 - v1 * i2,
        t.b2 - p2 - u2 * i1 - v2 * i2,
        t.b11 - p1 * p1 + iso - t1 * u1 * u1 - t2 * v1 * v1,
        t.b12 - p1 * p2 - t1 * u1 * u2 - t2 * v1 * v2,
        t.b22 - p2 * p2 + iso - t1 * u2 * u2 - t2 * v2 * v2,
    )
