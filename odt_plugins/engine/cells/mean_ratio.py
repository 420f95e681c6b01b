"""Mean ratio of a tetrahedron, that is TetWild's AMIPS energy, with its derivatives.

With J the Jacobian of the map from the regular tetrahedron, the AMIPS energy is
E = tr(J^T J) / det(J)^(2/3) >= 3 (Fu et al. 2015; Hu et al. 2018, TetWild).  tr(J^T J) is half the
sum t of the squared edges, in units of the regular tetrahedron's edge, and det(J) is
sqrt(2) det, det six times the volume.  The measure is the cube (3/E)^3 = 432 det^2 / t^3: like the
radius ratio it falls with the square of the volume, and it needs no root.
"""

from __future__ import annotations

from odt_plugins.engine.cells.corner import Edges, six_volumes
from odt_plugins.engine.cells.packed import add_identity, add_square
from odt_plugins.engine.cells.triangle import MovingTriangle
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.mesh.arrays import FloatArray


@kernel
def _det_and_edges(edges: Edges) -> tuple[float, float]:
    """Six times the volume, and the sum of the six squared edges, from the edges at a vertex."""
    ax, ay, az, bx, by, bz, cx, cy, cz = edges
    det = six_volumes(ax, ay, az, bx, by, bz, cx, cy, cz)
    sx = ax + bx + cx
    sy = ay + by + cy
    sz = az + bz + cz
    squares = (
        ax * ax + ay * ay + az * az + bx * bx + by * by + bz * bz + cx * cx + cy * cy + cz * cz
    )
    return det, 4.0 * squares - (sx * sx + sy * sy + sz * sz)


@kernel
def tet_mean_ratio(edges: Edges) -> float:
    """Cube of the mean ratio of a tetrahedron; -1 if it is not positive."""
    det, t = _det_and_edges(edges)
    cube = t * t * t
    if not (det > 0.0 and cube > 0.0):
        return -1.0
    return 432.0 * det * det / cube


@kernel
def mean_ratio_terms(edges: Edges, out: FloatArray) -> bool:
    """Write m = :func:`tet_mean_ratio`, gradient and Hessian of log m in the corner of the edges.

    ``out`` is packed as in ``packed``.  False when the cell is not positive.
    """
    ax, ay, az, bx, by, bz, cx, cy, cz = edges
    det, t = _det_and_edges(edges)
    cube = t * t * t
    if not (det > 0.0 and cube > 0.0):
        return False
    # gradients of log det and log t
    dx = ((bz - az) * (cy - ay) - (by - ay) * (cz - az)) / det
    dy = ((bx - ax) * (cz - az) - (bz - az) * (cx - ax)) / det
    dz = ((by - ay) * (cx - ax) - (bx - ax) * (cy - ay)) / det
    tx = -2.0 * (ax + bx + cx) / t
    ty = -2.0 * (ay + by + cy) / t
    tz = -2.0 * (az + bz + cz) / t
    out[:] = 0.0
    out[0] = 432.0 * det * det / cube
    out[1] = 2.0 * dx - 3.0 * tx
    out[2] = 2.0 * dy - 3.0 * ty
    out[3] = 2.0 * dz - 3.0 * tz
    add_identity(out, -18.0 / t)
    add_square(out, -2.0, dx, dy, dz)
    add_square(out, 3.0, tx, ty, tz)
    return True


@kernel
def triangle_mean_ratio(uu: float, vv: float, ww: float, square: float) -> float:
    """Squared mean ratio (2 sqrt(3) D / t)^2 = (2/E)^2 of a triangle, t the sum of squared edges.

    Arguments as of ``triangle.squares``, positive; E = tr(J^T J) / det(J).
    """
    t = uu + vv + ww
    return 12.0 * square / (t * t)


@kernel
def triangle_mean_ratio_terms(
    t: MovingTriangle,
) -> tuple[float, float, float, float, float, float]:
    """Measure m of a triangle, gradient of log m and minus its Hessian in the moving corner."""
    total = t.total
    tx = 2.0 * (t.u1 + t.v1) / total
    ty = 2.0 * (t.u2 + t.v2) / total
    return (
        12.0 * t.square / (total * total),
        t.b1 - 2.0 * tx,
        t.b2 - 2.0 * ty,
        t.b11 - 2.0 * tx * tx + 8.0 / total,
        t.b12 - 2.0 * tx * ty,
        t.b22 - 2.0 * ty * ty + 8.0 / total,
    )
