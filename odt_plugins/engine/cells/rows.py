"""Several tetrahedra at once: their radius ratios and derivatives in rows, one number a cell.

A loop over rows has no indirect address, so that the compiler takes several cells at a time; every
number is what it would be for the cell alone.
"""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.cells.cost import SHIFT, quality_cost
from odt_plugins.engine.cells.dihedral import measure_of, six_cosines
from odt_plugins.engine.cells.metric import has_metric, tet_root, through
from odt_plugins.engine.cells.tetrahedron import opposite_vertices
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.mesh.arrays import FloatArray, IntArray

CHUNK = 64
"""Most cells that are worked on in rows."""

AX, AY, AZ, BX, BY, BZ, CX, CY, CZ, Q, GX, GY, GZ, XX, XY, XZ, YY, YZ, ZZ, SOUND = (
    CHUNK * row for row in range(20)
)
"""Where the rows begin: the other corners a, b, c of the cells, radius ratio q, gradient of log q,
-Hessian of log q, and a number that is positive for a positive cell."""

LARGE, SMALL, ALTITUDE = GX, GY, GZ
"""Where :func:`shape_rows` writes instead."""

ROWS = 20 * CHUNK
"""Length of all rows."""


@kernel
def gather_corners(
    points: FloatArray, cells: IntArray, indices: IntArray, start: int, stop: int, v: int,
    rows: FloatArray,
) -> None:
    """Write the corners other than v of the cells indices[start:stop], at most CHUNK of them."""
    for s in range(stop - start):
        i, j, k = opposite_vertices(cells, indices[start + s], v)
        rows[AX + s], rows[AY + s], rows[AZ + s] = points[i, 0], points[i, 1], points[i, 2]
        rows[BX + s], rows[BY + s], rows[BZ + s] = points[j, 0], points[j, 1], points[j, 2]
        rows[CX + s], rows[CY + s], rows[CZ + s] = points[k, 0], points[k, 1], points[k, 2]


@kernel
def gather_edges(
    points: FloatArray, cells: IntArray, slots: IntArray, first: int, count: int, rows: FloatArray
) -> None:
    """Write the edges, as seen, at the first corner of the cells slots[first:first + count].

    With that corner in the origin they are the other corners; a free slot gets those of no cell.
    """
    for s in range(count):
        c = slots[first + s]
        free = cells[c, 0] < 0
        l = 0 if free else cells[c, 0]
        i = 0 if free else cells[c, 1]
        j = 0 if free else cells[c, 2]
        k = 0 if free else cells[c, 3]
        x, y, z = points[l, 0], points[l, 1], points[l, 2]
        rows[AX + s], rows[AY + s] = points[i, 0] - x, points[i, 1] - y
        rows[AZ + s] = points[i, 2] - z
        rows[BX + s], rows[BY + s] = points[j, 0] - x, points[j, 1] - y
        rows[BZ + s] = points[j, 2] - z
        rows[CX + s], rows[CY + s] = points[k, 0] - x, points[k, 1] - y
        rows[CZ + s] = points[k, 2] - z
        if has_metric(points):
            root = tet_root(points, l, i, j, k)
            rows[AX + s], rows[AY + s], rows[AZ + s] = through(
                root, rows[AX + s], rows[AY + s], rows[AZ + s])
            rows[BX + s], rows[BY + s], rows[BZ + s] = through(
                root, rows[BX + s], rows[BY + s], rows[BZ + s])
            rows[CX + s], rows[CY + s], rows[CZ + s] = through(
                root, rows[CX + s], rows[CY + s], rows[CZ + s])


@kernel
def quality_rows(x: float, y: float, z: float, count: int, rows: FloatArray) -> None:
    """Write radius ratios with v at (x, y, z), as ``tetrahedron.tet_quality``."""
    for s in range(count):
        ax, ay, az = rows[AX + s] - x, rows[AY + s] - y, rows[AZ + s] - z
        bx, by, bz = rows[BX + s] - x, rows[BY + s] - y, rows[BZ + s] - z
        cx, cy, cz = rows[CX + s] - x, rows[CY + s] - y, rows[CZ + s] - z
        ux, uy, uz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        vx, vy, vz = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
        wx, wy, wz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        det = ax * ux + ay * uy + az * uz
        ox, oy, oz = ux + vx + wx, uy + vy + wy, uz + vz + wz
        faces = (
            math.sqrt(ox * ox + oy * oy + oz * oz)
            + math.sqrt(ux * ux + uy * uy + uz * uz)
            + math.sqrt(vx * vx + vy * vy + vz * vz)
            + math.sqrt(wx * wx + wy * wy + wz * wz)
        )
        ex, ey, ez = bx - cx, by - cy, bz - cz
        fx, fy, fz = cx - ax, cy - ay, cz - az
        hx, hy, hz = ax - bx, ay - by, az - bz
        p = math.sqrt((ax * ax + ay * ay + az * az) * (ex * ex + ey * ey + ez * ez))
        q = math.sqrt((bx * bx + by * by + bz * bz) * (fx * fx + fy * fy + fz * fz))
        r = math.sqrt((cx * cx + cy * cy + cz * cz) * (hx * hx + hy * hy + hz * hz))
        h = (p + q + r) * (p + q - r) * (q + r - p) * (r + p - q)
        ratio = 12.0 * det * det / (faces * math.sqrt(max(h, 1e-300)))
        signed = ratio if det > 0.0 else -ratio
        flat = 0.0 if det > 0.0 else -1.0
        rows[Q + s] = signed if min(h, faces) > 0.0 else flat


@kernel
def shape_rows(count: int, rows: FloatArray) -> None:
    """Write largest and smallest cosine of the dihedral angles, and least altitudes.

    From the rows of :func:`gather_edges`, as ``tet_cosines`` and ``tet_altitude`` do.
    """
    for s in range(count):
        ax, ay, az = rows[AX + s], rows[AY + s], rows[AZ + s]
        bx, by, bz = rows[BX + s], rows[BY + s], rows[BZ + s]
        cx, cy, cz = rows[CX + s], rows[CY + s], rows[CZ + s]
        x1, y1, z1 = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        x2, y2, z2 = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
        x3, y3, z3 = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        x0, y0, z0 = -(x1 + x2 + x3), -(y1 + y2 + y3), -(z1 + z2 + z3)
        s0 = x0 * x0 + y0 * y0 + z0 * z0
        s1 = x1 * x1 + y1 * y1 + z1 * z1
        s2 = x2 * x2 + y2 * y2 + z2 * z2
        s3 = x3 * x3 + y3 * y3 + z3 * z3
        n0 = 1.0 / math.sqrt(max(s0, 1e-300))
        n1 = 1.0 / math.sqrt(max(s1, 1e-300))
        n2 = 1.0 / math.sqrt(max(s2, 1e-300))
        n3 = 1.0 / math.sqrt(max(s3, 1e-300))
        c01 = -(x0 * x1 + y0 * y1 + z0 * z1) * n0 * n1
        c02 = -(x0 * x2 + y0 * y2 + z0 * z2) * n0 * n2
        c03 = -(x0 * x3 + y0 * y3 + z0 * z3) * n0 * n3
        c12 = -(x1 * x2 + y1 * y2 + z1 * z2) * n1 * n2
        c13 = -(x1 * x3 + y1 * y3 + z1 * z3) * n1 * n3
        c23 = -(x2 * x3 + y2 * y3 + z2 * z3) * n2 * n3
        rows[LARGE + s] = max(max(max(c01, c02), max(c03, c12)), max(c13, c23))
        rows[SMALL + s] = min(min(min(c01, c02), min(c03, c12)), min(c13, c23))
        det = ax * x1 + ay * y1 + az * z1
        most = max(max(s1, s2), max(s3, s0))
        height = det / math.sqrt(max(most, 1e-300))
        rows[ALTITUDE + s] = height if most > 0.0 else 0.0


@kernel
def dihedral_rows(count: int, rows: FloatArray) -> None:
    """Write the measures ``dihedral.tet_dihedral`` from the rows of :func:`gather_edges`."""
    for s in range(count):
        det, c01, c02, c03, c12, c13, c23 = six_cosines((
            rows[AX + s], rows[AY + s], rows[AZ + s], rows[BX + s], rows[BY + s], rows[BZ + s],
            rows[CX + s], rows[CY + s], rows[CZ + s],
        ))
        measure = measure_of(c01, c02, c03, c12, c13, c23)
        rows[Q + s] = measure if det > 0.0 else -1.0


@kernel
def derivative_rows(x: float, y: float, z: float, count: int, rows: FloatArray) -> None:
    """Write radius ratios, gradients and Hessians of their logarithm with v at (x, y, z).

    With n_a, n_b, n_c the normals of the faces at v, u_1, u_2, u_3 the squared products of opposite
    edges, h the Heron form of these products: log q = 2 log det - log sum |n| - 1/2 log h + const.
    """
    for s in range(count):
        ax, ay, az = rows[AX + s] - x, rows[AY + s] - y, rows[AZ + s] - z
        bx, by, bz = rows[BX + s] - x, rows[BY + s] - y, rows[BZ + s] - z
        cx, cy, cz = rows[CX + s] - x, rows[CY + s] - y, rows[CZ + s] - z
        nax, nay, naz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        nbx, nby, nbz = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
        ncx, ncy, ncz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        nox, noy, noz = nax + nbx + ncx, nay + nby + ncy, naz + nbz + ncz
        det = ax * nax + ay * nay + az * naz
        na = math.sqrt(nax * nax + nay * nay + naz * naz)
        nb = math.sqrt(nbx * nbx + nby * nby + nbz * nbz)
        nc = math.sqrt(ncx * ncx + ncy * ncy + ncz * ncz)
        total = na + nb + nc + math.sqrt(nox * nox + noy * noy + noz * noz)
        ex, ey, ez = bx - cx, by - cy, bz - cz
        fx, fy, fz = cx - ax, cy - ay, cz - az
        hx, hy, hz = ax - bx, ay - by, az - bz
        ee = ex * ex + ey * ey + ez * ez
        ff = fx * fx + fy * fy + fz * fz
        hh = hx * hx + hy * hy + hz * hz
        u1 = (ax * ax + ay * ay + az * az) * ee
        u2 = (bx * bx + by * by + bz * bz) * ff
        u3 = (cx * cx + cy * cy + cz * cz) * hh
        h = 2.0 * (u1 * u2 + u2 * u3 + u3 * u1) - u1 * u1 - u2 * u2 - u3 * u3
        rows[SOUND + s] = min(det, h)
        rows[Q + s] = 12.0 * det * det / (total * math.sqrt(max(h, 1e-300)))
        ia, ib, ic = 1.0 / na, 1.0 / nb, 1.0 / nc
        nax, nay, naz = nax * ia, nay * ia, naz * ia
        nbx, nby, nbz = nbx * ib, nby * ib, nbz * ib
        ncx, ncy, ncz = ncx * ic, ncy * ic, ncz * ic
        # gradient of the sum of the lengths of the normals
        isum = 1.0 / total
        sx = isum * ((ey * naz - ez * nay) + (fy * nbz - fz * nby) + (hy * ncz - hz * ncy))
        sy = isum * ((ez * nax - ex * naz) + (fz * nbx - fx * nbz) + (hz * ncx - hx * ncz))
        sz = isum * ((ex * nay - ey * nax) + (fx * nby - fy * nbx) + (hx * ncy - hy * ncx))
        # gradients of u1, u2, u3, their sum, and of h
        t1, t2, t3 = -2.0 * ee, -2.0 * ff, -2.0 * hh
        u1x, u1y, u1z = t1 * ax, t1 * ay, t1 * az
        u2x, u2y, u2z = t2 * bx, t2 * by, t2 * bz
        u3x, u3y, u3z = t3 * cx, t3 * cy, t3 * cz
        h1, h2, h3 = 2.0 * (u2 + u3 - u1), 2.0 * (u3 + u1 - u2), 2.0 * (u1 + u2 - u3)
        tx, ty, tz = u1x + u2x + u3x, u1y + u2y + u3y, u1z + u2z + u3z
        ih = 0.5 / h
        gx = ih * (h1 * u1x + h2 * u2x + h3 * u3x)
        gy = ih * (h1 * u1y + h2 * u2y + h3 * u3y)
        gz = ih * (h1 * u1z + h2 * u2z + h3 * u3z)
        iso = ih * 2.0 * (h1 * ee + h2 * ff + h3 * hh)
        idet = 1.0 / det
        dx, dy, dz = -nox * idet, -noy * idet, -noz * idet
        rows[GX + s] = 2.0 * dx - sx - gx
        rows[GY + s] = 2.0 * dy - sy - gy
        rows[GZ + s] = 2.0 * dz - sz - gz
        wa, wb, wc = ee * ia * isum, ff * ib * isum, hh * ic * isum
        w2, w4 = 2.0 * ih, 4.0 * ih
        rows[XX + s] = (
            2.0 * dx * dx - sx * sx - 2.0 * gx * gx
            + wa * nax * nax + wb * nbx * nbx + wc * ncx * ncx
            + iso + w2 * tx * tx - w4 * (u1x * u1x + u2x * u2x + u3x * u3x)
        )
        rows[XY + s] = (
            2.0 * dx * dy - sx * sy - 2.0 * gx * gy
            + wa * nax * nay + wb * nbx * nby + wc * ncx * ncy
            + w2 * tx * ty - w4 * (u1x * u1y + u2x * u2y + u3x * u3y)
        )
        rows[XZ + s] = (
            2.0 * dx * dz - sx * sz - 2.0 * gx * gz
            + wa * nax * naz + wb * nbx * nbz + wc * ncx * ncz
            + w2 * tx * tz - w4 * (u1x * u1z + u2x * u2z + u3x * u3z)
        )
        rows[YY + s] = (
            2.0 * dy * dy - sy * sy - 2.0 * gy * gy
            + wa * nay * nay + wb * nby * nby + wc * ncy * ncy
            + iso + w2 * ty * ty - w4 * (u1y * u1y + u2y * u2y + u3y * u3y)
        )
        rows[YZ + s] = (
            2.0 * dy * dz - sy * sz - 2.0 * gy * gz
            + wa * nay * naz + wb * nby * nbz + wc * ncy * ncz
            + w2 * ty * tz - w4 * (u1y * u1z + u2y * u2z + u3y * u3z)
        )
        rows[ZZ + s] = (
            2.0 * dz * dz - sz * sz - 2.0 * gz * gz
            + wa * naz * naz + wb * nbz * nbz + wc * ncz * ncz
            + iso + w2 * tz * tz - w4 * (u1z * u1z + u2z * u2z + u3z * u3z)
        )


@kernel
def add_star_terms(
    x: float, y: float, z: float, count: int, power: float, rows: FloatArray, out: FloatArray
) -> bool:
    """Add cost, gradient and Hessian of all cells to [F, g, H_xx xy xz yy yz zz].

    False when a cell is not positive.
    """
    derivative_rows(x, y, z, count, rows)
    f0, gx, gy, gz = out[0], out[1], out[2], out[3]
    xx, xy, xz, yy, yz, zz = out[4], out[5], out[6], out[7], out[8], out[9]
    least = np.inf
    for s in range(count):
        least = min(least, rows[SOUND + s])
        q = rows[Q + s]
        f = quality_cost(q, power)
        share = q / (q + SHIFT)
        pf = power * f * share
        pp = pf * ((power + 1.0) * share - 1.0)
        lx, ly, lz = rows[GX + s], rows[GY + s], rows[GZ + s]
        f0 += f
        gx -= pf * lx
        gy -= pf * ly
        gz -= pf * lz
        xx += pp * lx * lx + pf * rows[XX + s]
        xy += pp * lx * ly + pf * rows[XY + s]
        xz += pp * lx * lz + pf * rows[XZ + s]
        yy += pp * ly * ly + pf * rows[YY + s]
        yz += pp * ly * lz + pf * rows[YZ + s]
        zz += pp * lz * lz + pf * rows[ZZ + s]
    out[0], out[1], out[2], out[3] = f0, gx, gy, gz
    out[4], out[5], out[6], out[7], out[8], out[9] = xx, xy, xz, yy, yz, zz
    return least > 0.0
