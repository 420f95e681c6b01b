"""Measures of one triangle, as compiled scalar code; see ``tetrahedron`` for those in space."""

from __future__ import annotations

import math

from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.cells.step import eighth_root
from odt_plugins.engine.cells.tetrahedron import MEAN_RATIO, QUALITY, STEP
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.topology.lookup import place_in
from odt_plugins.mesh.arrays import FloatArray, IntArray


@kernel
def _edges(
    points: FloatArray, a: int, b: int, c: int
) -> tuple[float, float, float, float, float, float]:
    """Edges bc, ca and ab of a planar triangle."""
    return (
        points[c, 0] - points[b, 0],
        points[c, 1] - points[b, 1],
        points[a, 0] - points[c, 0],
        points[a, 1] - points[c, 1],
        points[b, 0] - points[a, 0],
        points[b, 1] - points[a, 1],
    )


@kernel
def opposite_edge(triangles: IntArray, t: int, v: int) -> tuple[int, int]:
    """The other two vertices of triangle t, such that (v, b, c) turns as the triangle does."""
    i = place_in(triangles, t, v)
    return triangles[t, (i + 1) % 3], triangles[t, (i + 2) % 3]


@kernel
def triangle_shape(points: FloatArray, a: int, b: int, c: int) -> tuple[float, float, float]:
    """Radius ratio 2 r / R (5.1), cosine of the smallest and of the largest angle.

    The radius ratio is 0 or negative when (a, b, c) is not counterclockwise.
    """
    ux, uy, vx, vy, wx, wy = _edges(points, a, b, c)
    uu = ux * ux + uy * uy
    vv = vx * vx + vy * vy
    ww = wx * wx + wy * wy
    lu = math.sqrt(uu)
    lv = math.sqrt(vv)
    lw = math.sqrt(ww)
    if not (lu > 0.0 and lv > 0.0 and lw > 0.0):
        return 0.0, 1.0, -1.0
    double_area = vx * wy - vy * wx
    # 16 A^2 / (perimeter a b c), with the sign of the area
    q = 4.0 * double_area * abs(double_area) / ((lu + lv + lw) * lu * lv * lw)
    cu = -(vx * wx + vy * wy) / (lv * lw)
    cv = -(wx * ux + wy * uy) / (lw * lu)
    cw = -(ux * vx + uy * vy) / (lu * lv)
    return q, max(cu, cv, cw), min(cu, cv, cw)


@kernel
def triangle_extremes(points: FloatArray, a: int, b: int, c: int) -> Extremes:
    """What :func:`triangle_shape` gives in the plane, or :func:`triangle_in_space`, as extremes."""
    if points.shape[1] == 3:
        q, large, small, _, _, _ = triangle_in_space(points, a, b, c)
    else:
        q, large, small = triangle_shape(points, a, b, c)
    return Extremes(q, large, small)


@kernel
def offset(points: FloatArray, a: int, b: int) -> tuple[float, float, float]:
    """Vector from point a to point b in space."""
    return points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]


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
    ux, uy, uz = offset(points, b, c)
    vx, vy, vz = offset(points, c, a)
    wx, wy, wz = offset(points, a, b)
    nx, ny, nz = vy * wz - vz * wy, vz * wx - vx * wz, vx * wy - vy * wx
    lu = math.sqrt(ux * ux + uy * uy + uz * uz)
    lv = math.sqrt(vx * vx + vy * vy + vz * vz)
    lw = math.sqrt(wx * wx + wy * wy + wz * wz)
    if not (lu > 0.0 and lv > 0.0 and lw > 0.0):
        return 0.0, 1.0, -1.0, nx, ny, nz
    # 16 A^2 / (perimeter a b c)
    q = 4.0 * (nx * nx + ny * ny + nz * nz) / ((lu + lv + lw) * lu * lv * lw)
    cu = -(vx * wx + vy * wy + vz * wz) / (lv * lw)
    cv = -(wx * ux + wy * uy + wz * uz) / (lw * lu)
    cw = -(ux * vx + uy * vy + uz * vz) / (lu * lv)
    return q, max(cu, cv, cw), min(cu, cv, cw), nx, ny, nz


@kernel
def triangle_altitude(points: FloatArray, a: int, b: int, c: int) -> float:
    """Least altitude of a triangle in the plane or in space, 0 of a flat one.

    Twice the area is the product of two edges less their projections on each other, by Lagrange's
    identity: D^2 = sum_(i < j) (v_i w_j - v_j w_i)^2.
    """
    uu = vv = ww = d2 = 0.0
    for i in range(points.shape[1]):
        u = points[c, i] - points[b, i]
        v = points[a, i] - points[c, i]
        w = points[b, i] - points[a, i]
        uu += u * u
        vv += v * v
        ww += w * w
        for j in range(i):
            part = v * (points[b, j] - points[a, j]) - w * (points[a, j] - points[c, j])
            d2 += part * part
    most = max(uu, max(vv, ww))
    return math.sqrt(d2 / most) if most > 0.0 else 0.0


@kernel
def triangle_measure(points: FloatArray, a: int, b: int, c: int, objective: int) -> float:
    """Measure of one triangle, 1 for the regular one; 0 or negative when not counterclockwise.

    With D twice the area and l the lengths of the edges, the mean ratio is
    m = (2 sqrt(3) D / sum l^2)^2 = (2/E)^2, E = tr(J^T J) / det(J) the AMIPS energy; the measure
    of the smallest angle is m = (4/3) (1/3 sum_i sin^-8 theta_i)^(-1/4); that of the time step,
    m = (D^2 / sum l^2)^(1/8), is 1 for no triangle, see ``step``. Of a triangle in space there is
    the radius ratio alone.
    """
    if points.shape[1] == 3:
        return triangle_in_space(points, a, b, c)[0]
    if objective == QUALITY:
        return triangle_shape(points, a, b, c)[0]
    ux, uy, vx, vy, wx, wy = _edges(points, a, b, c)
    uu = ux * ux + uy * uy
    vv = vx * vx + vy * vy
    ww = wx * wx + wy * wy
    double_area = vx * wy - vy * wx
    d2 = double_area * double_area
    if not (double_area > 0.0 and d2 > 0.0):
        return -1.0
    if objective == MEAN_RATIO:
        t = uu + vv + ww
        return 12.0 * d2 / (t * t)
    if objective == STEP:
        return eighth_root(d2 / (uu + vv + ww))
    total = angle_cost(vv * ww, d2) + angle_cost(ww * uu, d2) + angle_cost(uu * vv, d2)
    return angle_measure(total)


@kernel
def angle_cost(sides: float, d2: float) -> float:
    """sin^-8 of the angle between two edges, from their squared lengths' product and D^2."""
    x = sides / d2
    x *= x
    return x * x


@kernel
def angle_measure(total: float) -> float:
    """Measure of the smallest angle from the sum of the three costs."""
    return 4.0 / 3.0 / math.sqrt(math.sqrt(total / 3.0))
