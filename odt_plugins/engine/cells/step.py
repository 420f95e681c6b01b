"""Stable time step of a simplex, and its altitudes, with derivatives.

With h_i the altitudes and wave speed 1, explicit central differences with linear elements and
lumped masses are stable for every step of at most tau = (sum_i h_i^-2)^(-1/2) in all cells: on
one cell the eigenvalues of K u = lambda M u are at most (d + 1) sum_i h_i^-2, those of the mesh
are at most the greatest of its cells (Irons and Treharne), and a step of 2 / sqrt(lambda) is
stable. tau is between the least altitude over sqrt(d + 1) and all of it.  The measure tau^(1/4) is
below 1 in the unit of the engine, where a mesh has at most the size 1, and has no other unit.

References
----------
B. M. Irons, G. Treharne, A bound theorem in eigenvalues and its practical applications, Proc. 3rd
Conf. Matrix Methods in Structural Mechanics (1971).
"""

from __future__ import annotations

import math

from odt_plugins.engine.cells.corner import Edges, corner_normals, opposite_edges
from odt_plugins.engine.cells.packed import add_identity, add_square
from odt_plugins.engine.cells.triangle import MovingTriangle
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.mesh.arrays import FloatArray

ROOT = 0.125
"""Exponent of tau^2 in the measure."""


@kernel
def _eighth_root(x: float) -> float:
    """x^(1/8), by square roots."""
    return math.sqrt(math.sqrt(math.sqrt(x)))


@kernel
def _normal_squares(edges: Edges) -> tuple[float, float, float, float, float]:
    """Six times the volume, and the squares of twice the four areas."""
    ax, ay, az, bx, by, bz, cx, cy, cz = edges
    px, py, pz, qx, qy, qz, rx, ry, rz = corner_normals(ax, ay, az, bx, by, bz, cx, cy, cz)
    ox, oy, oz = px + qx + rx, py + qy + ry, pz + qz + rz
    return (
        ax * px + ay * py + az * pz,
        px * px + py * py + pz * pz, qx * qx + qy * qy + qz * qz,
        rx * rx + ry * ry + rz * rz, ox * ox + oy * oy + oz * oz,
    )


@kernel
def tet_altitude(edges: Edges) -> float:
    """Least altitude of a tetrahedron; negative if inverted."""
    det, p, q, r, o = _normal_squares(edges)
    most = max(max(p, q), max(r, o))
    return det / math.sqrt(most) if most > 0.0 else 0.0


@kernel
def tet_step(edges: Edges) -> float:
    """Fourth root of tau, det^2 / sum |n_i|^2 = tau^2, of a tetrahedron; -1 if not positive."""
    det, p, q, r, o = _normal_squares(edges)
    square = det * det
    if not (det > 0.0 and square > 0.0):
        return -1.0
    return _eighth_root(square / (p + q + r + o))


@kernel
def step_terms(edges: Edges, out: FloatArray) -> bool:
    """Write m = :func:`tet_step`, gradient and Hessian of log m in the corner v of the edges.

    ``out`` is packed as in ``packed``.  False when the cell is not positive.  The normal n of a
    face at v, whose edge opposite to v is e, changes by dx x e: |n|^2 is quadratic in x_v.
    """
    ax, ay, az, bx, by, bz, cx, cy, cz = edges
    px, py, pz, qx, qy, qz, rx, ry, rz = corner_normals(ax, ay, az, bx, by, bz, cx, cy, cz)
    ex, ey, ez, fx, fy, fz, gx, gy, gz = opposite_edges(ax, ay, az, bx, by, bz, cx, cy, cz)
    ox, oy, oz = px + qx + rx, py + qy + ry, pz + qz + rz
    det = ax * px + ay * py + az * pz
    total = (
        px * px + py * py + pz * pz + qx * qx + qy * qy + qz * qz
        + rx * rx + ry * ry + rz * rz + ox * ox + oy * oy + oz * oz
    )
    square = det * det
    if not (det > 0.0 and square > 0.0):
        return False
    # gradients of log det and log total
    dx, dy, dz = -ox / det, -oy / det, -oz / det
    w = 2.0 / total
    tx = w * ((ey * pz - ez * py) + (fy * qz - fz * qy) + (gy * rz - gz * ry))
    ty = w * ((ez * px - ex * pz) + (fz * qx - fx * qz) + (gz * rx - gx * rz))
    tz = w * ((ex * py - ey * px) + (fx * qy - fy * qx) + (gx * ry - gy * rx))
    out[:] = 0.0
    out[0] = _eighth_root(square / total)
    out[1] = ROOT * (2.0 * dx - tx)
    out[2] = ROOT * (2.0 * dy - ty)
    out[3] = ROOT * (2.0 * dz - tz)
    ee = ex * ex + ey * ey + ez * ez + fx * fx + fy * fy + fz * fz + gx * gx + gy * gy + gz * gz
    add_identity(out, -ROOT * w * ee)
    add_square(out, ROOT * w, ex, ey, ez)
    add_square(out, ROOT * w, fx, fy, fz)
    add_square(out, ROOT * w, gx, gy, gz)
    add_square(out, ROOT, tx, ty, tz)
    add_square(out, -2.0 * ROOT, dx, dy, dz)
    return True


@kernel
def triangle_step(uu: float, vv: float, ww: float, square: float) -> float:
    """Fourth root of tau, D^2 / sum l^2 = tau^2, of a triangle.

    Arguments as of ``triangle.squares``, positive.
    """
    return _eighth_root(square / (uu + vv + ww))


@kernel
def triangle_step_terms(t: MovingTriangle) -> tuple[float, float, float, float, float, float]:
    """Measure m of a triangle, gradient of log m and minus its Hessian in the moving corner."""
    total = t.total
    tx = 2.0 * (t.u1 + t.v1) / total
    ty = 2.0 * (t.u2 + t.v2) / total
    return (
        _eighth_root(t.square / total),
        ROOT * (t.b1 - tx),
        ROOT * (t.b2 - ty),
        ROOT * (t.b11 - tx * tx + 4.0 / total),
        ROOT * (t.b12 - tx * ty),
        ROOT * (t.b22 - ty * ty + 4.0 / total),
    )
