"""The Newton step of a vertex in the plane, or in a tangent plane."""

from __future__ import annotations

import math

from odt_plugins.engine.compiled.kernel import kernel

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
