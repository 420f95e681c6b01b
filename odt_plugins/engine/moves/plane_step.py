"""The Newton step of a vertex in the plane, or in a tangent plane."""

from __future__ import annotations

import math

from odt_plugins.engine.cells.metric import has_metric, through, vertex_root
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.mesh.arrays import FloatArray

LEAST_CURVATURE = 1e-2
"""The smaller eigenvalue of the Hessian is lifted to about this part of the larger one."""


@kernel
def plane_step(
    g1: float, g2: float, h11: float, h12: float, h22: float, on_a_line: bool
) -> tuple[float, float]:
    """Solve (H + s I) d = -g with a shift s that makes the matrix positive definite.

    Parameters
    ----------
    g1, g2 : float            gradient along two orthonormal directions
    h11, h12, h22 : float     Hessian
    on_a_line : bool          it moves along the first direction alone

    Returns
    -------
    d1, d2 : float            0 where there is no step
    """
    if on_a_line:
        g2 = h12 = 0.0
        h22 = abs(h11)
    middle = 0.5 * (h11 + h22)
    radius = math.sqrt(0.25 * (h11 - h22) * (h11 - h22) + h12 * h12)
    shift = max(0.0, LEAST_CURVATURE * (abs(middle) + radius) - (middle - radius))
    h11 += shift
    h22 += shift
    determinant = h11 * h22 - h12 * h12
    if not determinant > 0.0:
        return 0.0, 0.0
    return (h12 * g2 - h22 * g1) / determinant, (h12 * g1 - h11 * g2) / determinant


@kernel
def seen_plane_step(
    points: FloatArray, v: int, axes: FloatArray, g1: float, g2: float, h11: float, h12: float,
    h22: float, on_a_line: bool,
) -> tuple[float, float]:
    """:func:`plane_step` along directions that are orthonormal as a vertex with a metric sees them.

    With G = L L^T the products of the axes (2, d) seen through S of vertex v, the step is
    d = L^-T d', d' that of L^-1 g and L^-1 H L^-T: the same for a mesh and its affine image.
    """
    if not has_metric(points):
        return plane_step(g1, g2, h11, h12, h22, on_a_line)
    root = vertex_root(points, v)
    third = axes.shape[1] == 3
    ax, ay, az = through(root, axes[0, 0], axes[0, 1], axes[0, 2] if third else 0.0)
    bx, by, bz = through(root, axes[1, 0], axes[1, 1], axes[1, 2] if third else 0.0)
    l11 = math.sqrt(ax * ax + ay * ay + az * az)
    l21 = (ax * bx + ay * by + az * bz) / l11
    bx, by, bz = bx - l21 * ax / l11, by - l21 * ay / l11, bz - l21 * az / l11
    l22 = math.sqrt(bx * bx + by * by + bz * bz)
    g1 /= l11
    g2 = (g2 - l21 * g1) / l22
    a11, a12 = h11 / l11, h12 / l11
    a21, a22 = (h12 - l21 * a11) / l22, (h22 - l21 * a12) / l22
    h11, h21 = a11 / l11, a21 / l11
    h12, h22 = (a12 - l21 * h11) / l22, (a22 - l21 * h21) / l22
    d1, d2 = plane_step(g1, g2, h11, h12, h22, on_a_line)
    d2 /= l22
    return (d1 - l21 * d2) / l11, d2
