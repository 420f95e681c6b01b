"""A function of one vertex packed as [f, g_x g_y g_z, H_xx xy xz yy yz zz]."""

from __future__ import annotations

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.mesh.arrays import FloatArray


@kernel
def add_square(out: FloatArray, w: float, x: float, y: float, z: float) -> None:
    """Add w u u^T, u = (x, y, z), to the Hessian."""
    out[4] += w * x * x
    out[5] += w * x * y
    out[6] += w * x * z
    out[7] += w * y * y
    out[8] += w * y * z
    out[9] += w * z * z


@kernel
def add_identity(out: FloatArray, w: float) -> None:
    """Add w I to the Hessian."""
    out[4] += w
    out[7] += w
    out[9] += w
