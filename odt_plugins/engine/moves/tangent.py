"""The tangent plane of a star of a surface: its normal and its axes."""

from __future__ import annotations

import math

from odt_plugins.engine.cells.triangle import triangle_in_space
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.mesh.arrays import FloatArray, IntArray


@kernel
def star_normal(
    points: FloatArray, triangles: IntArray, star: IntArray
) -> tuple[float, float, float]:
    """Unit normal of a star, (k,) triangles, area-weighted; 0 when there is none."""
    x = y = z = 0.0
    for s in range(star.shape[0]):
        c = star[s]
        _, _, _, nx, ny, nz = triangle_in_space(
            points, triangles[c, 0], triangles[c, 1], triangles[c, 2]
        )
        x += nx
        y += ny
        z += nz
    length = math.sqrt(x * x + y * y + z * z)
    if not length > 0.0:
        return 0.0, 0.0, 0.0
    return x / length, y / length, z / length


@kernel
def axis_across(nx: float, ny: float, nz: float) -> tuple[float, float, float]:
    """Unit vector at right angles to a unit vector."""
    if abs(nx) <= abs(ny) and abs(nx) <= abs(nz):
        x, y, z = 0.0, nz, -ny
    elif abs(ny) <= abs(nz):
        x, y, z = -nz, 0.0, nx
    else:
        x, y, z = ny, -nx, 0.0
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@kernel
def set_axes(nx: float, ny: float, nz: float, e: FloatArray) -> None:
    """Make e (2, 3) orthonormal directions at right angles to a unit vector."""
    e[0, 0], e[0, 1], e[0, 2] = axis_across(nx, ny, nz)
    complete_axes(nx, ny, nz, e)


@kernel
def complete_axes(nx: float, ny: float, nz: float, e: FloatArray) -> None:
    """Make e[1] the direction across a unit vector and e[0]."""
    e[1, 0] = ny * e[0, 2] - nz * e[0, 1]
    e[1, 1] = nz * e[0, 0] - nx * e[0, 2]
    e[1, 2] = nx * e[0, 1] - ny * e[0, 0]
