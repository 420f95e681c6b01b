"""Shape of one triangle: radius ratio (5.1) and angles, as compiled scalar code."""

from __future__ import annotations

import math

from odt_plugins.engine.kernel import kernel
from odt_plugins.mesh import FloatArray


@kernel
def triangle_shape(points: FloatArray, a: int, b: int, c: int) -> tuple[float, float, float]:
    """Radius ratio 2 r / R (5.1), cosine of the smallest and of the largest angle.

    The radius ratio is 0 or negative when (a, b, c) is not counterclockwise.
    """
    ux = points[c, 0] - points[b, 0]
    uy = points[c, 1] - points[b, 1]
    vx = points[a, 0] - points[c, 0]
    vy = points[a, 1] - points[c, 1]
    wx = points[b, 0] - points[a, 0]
    wy = points[b, 1] - points[a, 1]
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
