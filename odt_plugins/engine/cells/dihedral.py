"""Softened smallest dihedral angle of a tetrahedron, with its derivatives.

The measure is a power mean of the squared sines of the six dihedral angles theta_e,

    m = (9/8) (1/6 sum_e x_e)^(-1/k),    x_e = sin^(-2k) theta_e,  k = SHARP,

1 for the regular tetrahedron, whose sines are sqrt(8/9), and close to the least squared sine for
a bad one.

log sin theta_e = log det + log |e| - log |n_c| - log |n_d| + constant, n_c and n_d the normals of
the two faces at the edge e, so gradient and Hessian of log m are exact and cheap.
"""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.cells.corner import Edges, corner_normals, opposite_edges
from odt_plugins.engine.cells.packed import add_identity, add_square
from odt_plugins.engine.cells.triangle import MovingTriangle
from odt_plugins.engine.compiled.kernel import inlined_kernel, kernel
from odt_plugins.mesh.arrays import FloatArray

SHARP = 4.0
"""k: the larger, the more the smallest angle counts alone."""


@inlined_kernel
def six_cosines(edges: Edges) -> tuple[float, float, float, float, float, float, float]:
    """Six times the volume, and the cosines between the faces opposite the vertices a and b.

    Of the pairs ab = 01, 02, 03, 12, 13, 23 of the vertices; the two faces meet at the other edge.
    """
    ax, ay, az, bx, by, bz, cx, cy, cz = edges
    x1, y1, z1, x2, y2, z2, x3, y3, z3 = corner_normals(
        ax, ay, az, bx, by, bz, cx, cy, cz
    )
    x0 = -(x1 + x2 + x3)
    y0 = -(y1 + y2 + y3)
    z0 = -(z1 + z2 + z3)
    n0 = 1.0 / math.sqrt(max(x0 * x0 + y0 * y0 + z0 * z0, 1e-300))
    n1 = 1.0 / math.sqrt(max(x1 * x1 + y1 * y1 + z1 * z1, 1e-300))
    n2 = 1.0 / math.sqrt(max(x2 * x2 + y2 * y2 + z2 * z2, 1e-300))
    n3 = 1.0 / math.sqrt(max(x3 * x3 + y3 * y3 + z3 * z3, 1e-300))
    c01 = -(x0 * x1 + y0 * y1 + z0 * z1) * n0 * n1
    c02 = -(x0 * x2 + y0 * y2 + z0 * z2) * n0 * n2
    c03 = -(x0 * x3 + y0 * y3 + z0 * z3) * n0 * n3
    c12 = -(x1 * x2 + y1 * y2 + z1 * z2) * n1 * n2
    c13 = -(x1 * x3 + y1 * y3 + z1 * z3) * n1 * n3
    c23 = -(x2 * x3 + y2 * y3 + z2 * z3) * n2 * n3
    return ax * x1 + ay * y1 + az * z1, c01, c02, c03, c12, c13, c23


@kernel
def _edge_cost(cosine: float) -> float:
    """Term x_e of an edge."""
    x = 1.0 / max(1.0 - cosine * cosine, 1e-30)
    x *= x
    return x * x


@kernel
def _measure(total: float) -> float:
    """Measure m from the sum of the six terms."""
    return 1.125 / math.sqrt(math.sqrt(total / 6.0))


@inlined_kernel
def measure_of(
    c01: float, c02: float, c03: float, c12: float, c13: float, c23: float
) -> float:
    """Measure m from the six cosines."""
    total = _edge_cost(c01) + _edge_cost(c02) + _edge_cost(c03)
    total += _edge_cost(c12) + _edge_cost(c13) + _edge_cost(c23)
    return _measure(total) if total > 0.0 else 0.0


@kernel
def tet_dihedral(edges: Edges) -> float:
    """Softened smallest squared sine of a tetrahedron; -1 if it is not positive."""
    det, c01, c02, c03, c12, c13, c23 = six_cosines(edges)
    if not det > 0.0:
        return -1.0
    return measure_of(c01, c02, c03, c12, c13, c23)


@kernel
def _raw_cost(d2: float, e2: float, n2: float, o2: float) -> float:
    """sin^(-2k) of the angle at an edge, from squared det, edge and face normals."""
    x = n2 * o2 / max(d2 * e2, 1e-300)
    x *= x
    return x * x


@kernel
def _add_edge(out: FloatArray, u: float, x: float, y: float, z: float) -> None:
    """Add the share u of an edge whose log sine has the gradient (x, y, z)."""
    out[1] += 2.0 * u * x
    out[2] += 2.0 * u * y
    out[3] += 2.0 * u * z
    add_square(out, -4.0 * SHARP * u, x, y, z)


@kernel
def dihedral_terms(edges: Edges, out: FloatArray) -> bool:
    """Write m = :func:`tet_dihedral`, gradient and Hessian of log m in the corner of the edges.

    ``out`` is packed as in ``packed``.  False when the cell is not positive.
    """
    ax, ay, az, bx, by, bz, cx, cy, cz = edges
    nax, nay, naz, nbx, nby, nbz, ncx, ncy, ncz = corner_normals(
        ax, ay, az, bx, by, bz, cx, cy, cz
    )
    det = ax * nax + ay * nay + az * naz
    if not det > 0.0:
        return False
    nox = nax + nbx + ncx
    noy = nay + nby + ncy
    noz = naz + nbz + ncz
    d2 = det * det
    na2 = nax * nax + nay * nay + naz * naz
    nb2 = nbx * nbx + nby * nby + nbz * nbz
    nc2 = ncx * ncx + ncy * ncy + ncz * ncz
    no2 = nox * nox + noy * noy + noz * noz
    ex, ey, ez, fx, fy, fz, hx, hy, hz = opposite_edges(ax, ay, az, bx, by, bz, cx, cy, cz)
    aa = ax * ax + ay * ay + az * az
    bb = bx * bx + by * by + bz * bz
    cc = cx * cx + cy * cy + cz * cz
    ee = ex * ex + ey * ey + ez * ez
    ff = fx * fx + fy * fy + fz * fz
    hh = hx * hx + hy * hy + hz * hz
    ua = _raw_cost(d2, aa, nb2, nc2)
    ub = _raw_cost(d2, bb, nc2, na2)
    uc = _raw_cost(d2, cc, na2, nb2)
    ue = _raw_cost(d2, ee, na2, no2)
    uf = _raw_cost(d2, ff, nb2, no2)
    uh = _raw_cost(d2, hh, nc2, no2)
    total = ua + ub + uc + ue + uf + uh
    if not total < np.inf:
        return False
    ua /= total
    ub /= total
    uc /= total
    ue /= total
    uf /= total
    uh /= total
    out[:] = 0.0
    out[0] = _measure(total)
    # gradients of log det, log |n_a|, log |a|, ...
    dx = -nox / det
    dy = -noy / det
    dz = -noz / det
    rax = (ey * naz - ez * nay) / na2
    ray = (ez * nax - ex * naz) / na2
    raz = (ex * nay - ey * nax) / na2
    rbx = (fy * nbz - fz * nby) / nb2
    rby = (fz * nbx - fx * nbz) / nb2
    rbz = (fx * nby - fy * nbx) / nb2
    rcx = (hy * ncz - hz * ncy) / nc2
    rcy = (hz * ncx - hx * ncz) / nc2
    rcz = (hx * ncy - hy * ncx) / nc2
    wa = ub + uc + ue
    wb = uc + ua + uf
    wc = ua + ub + uh
    add_square(out, -2.0, dx, dy, dz)
    add_square(out, -4.0 * ua / (aa * aa), ax, ay, az)
    add_square(out, -4.0 * ub / (bb * bb), bx, by, bz)
    add_square(out, -4.0 * uc / (cc * cc), cx, cy, cz)
    add_square(out, -2.0 * wa * ee / (na2 * na2), nax, nay, naz)
    add_square(out, -2.0 * wb * ff / (nb2 * nb2), nbx, nby, nbz)
    add_square(out, -2.0 * wc * hh / (nc2 * nc2), ncx, ncy, ncz)
    add_square(out, 2.0 * wa, rax, ray, raz)
    add_square(out, 2.0 * wb, rbx, rby, rbz)
    add_square(out, 2.0 * wc, rcx, rcy, rcz)
    add_identity(out, 2.0 * (ua / aa + ub / bb + uc / cc))
    _add_edge(out, ua, dx - ax / aa - rbx - rcx, dy - ay / aa - rby - rcy, dz - az / aa - rbz - rcz)
    _add_edge(out, ub, dx - bx / bb - rcx - rax, dy - by / bb - rcy - ray, dz - bz / bb - rcz - raz)
    _add_edge(out, uc, dx - cx / cc - rax - rbx, dy - cy / cc - ray - rby, dz - cz / cc - raz - rbz)
    _add_edge(out, ue, dx - rax, dy - ray, dz - raz)
    _add_edge(out, uf, dx - rbx, dy - rby, dz - rbz)
    _add_edge(out, uh, dx - rcx, dy - rcy, dz - rcz)
    add_square(out, SHARP, out[1], out[2], out[3])
    return True


@kernel
def _angle_cost(sides: float, square: float) -> float:
    """sin^-8 of the angle between two edges, from their squared lengths' product and D^2."""
    x = sides / square
    x *= x
    return x * x


@kernel
def _angle_measure(total: float) -> float:
    """Measure of the smallest angle from the sum of the three costs."""
    return 4.0 / 3.0 / math.sqrt(math.sqrt(total / 3.0))


@kernel
def triangle_angle(uu: float, vv: float, ww: float, square: float) -> float:
    """Softened smallest squared sine (4/3) (1/3 sum_i sin^-8 theta_i)^(-1/4) of a triangle.

    Arguments as of ``triangle.squares``, positive.
    """
    total = _angle_cost(vv * ww, square)
    total += _angle_cost(ww * uu, square)
    total += _angle_cost(uu * vv, square)
    return _angle_measure(total)


@kernel
def triangle_angle_terms(
    t: MovingTriangle,
) -> tuple[float, float, float, float, float, float]:
    """Measure m of a triangle, gradient of log m and minus its Hessian in the moving corner."""
    s1, s2, s3 = t.uu, t.vv, t.w * t.w
    w1 = _angle_cost(s1 * s2, t.square)
    w2 = _angle_cost(s1 * s3, t.square)
    w3 = _angle_cost(s2 * s3, t.square)
    total = w1 + w2 + w3
    w1 /= total
    w2 /= total
    w3 /= total
    # gradients of log uu and log vv, then of the three log sin^2
    px = 2.0 * t.u1 / s1
    py = 2.0 * t.u2 / s1
    rx = 2.0 * t.v1 / s2
    ry = 2.0 * t.v2 / s2
    x1 = t.b1 - px - rx
    y1 = t.b2 - py - ry
    x2 = t.b1 - px
    y2 = t.b2 - py
    x3 = t.b1 - rx
    y3 = t.b2 - ry
    gx = w1 * x1 + w2 * x2 + w3 * x3
    gy = w1 * y1 + w2 * y2 + w3 * y3
    b = w1 + w2
    c = w1 + w3
    iso = 2.0 * (b / s1 + c / s2)
    return (
        _angle_measure(total),
        gx,
        gy,
        t.b11 + iso - b * px * px - c * rx * rx
        + 4.0 * (w1 * x1 * x1 + w2 * x2 * x2 + w3 * x3 * x3 - gx * gx),
        t.b12 - b * px * py - c * rx * ry
        + 4.0 * (w1 * x1 * y1 + w2 * x2 * y2 + w3 * x3 * y3 - gx * gy),
        t.b22 + iso - b * py * py - c * ry * ry
        + 4.0 * (w1 * y1 * y1 + w2 * y2 * y2 + w3 * y3 * y3 - gy * gy),
    )
