"""Newton smoothing of one vertex at a time for F_p, the sum of its star's costs, d = 3.

With only one vertex x moving, det is linear in x, the products of opposite edges are quadratic
and the Hessian of a face area is rank one, so gradient and Hessian of log q are exact and cheap.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.corner import corner_edges, corner_normals, opposite_edges
from odt_plugins.engine.cells.dihedral import dihedral_terms
from odt_plugins.engine.cells.extremes import Extremes, keeps, worse
from odt_plugins.engine.cells.mean_ratio import mean_ratio_terms
from odt_plugins.engine.cells.packed import add_square
from odt_plugins.engine.cells.rows import (
    CHUNK,
    ROWS,
    Q,
    add_star_terms,
    gather_corners,
    quality_rows,
)
from odt_plugins.engine.cells.step import step_terms
from odt_plugins.engine.cells.tetrahedron import (
    MEAN_RATIO,
    QUALITY,
    SHIFT,
    STEP,
    Cost,
    cell_cost,
    opposite_vertices,
    quality_cost,
    tet_cosines,
    tet_quality,
)
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.topology.star import Stars
from odt_plugins.mesh.arrays import FloatArray, IntArray

HALVINGS = 7
"""Step lengths alpha = 1, 1/2, 1/4, ... tried for one vertex."""

ROUNDING = 1e-12
"""By so much is 1 - cos^2 of an angle uncertain at most."""


class Derivatives(NamedTuple):
    """Room for one Newton step; made by :func:`make_derivatives`.

    Attributes
    ----------
    star : (10,) float64    sum over the cells of a star, packed as in ``packed``
    cell : (10,) float64    measure of one of them, packed in the same way
    step : (3,) float64     where the vertex goes
    rows : (ROWS,) float64  the cells of a star side by side, see ``star_rows``
    """

    star: FloatArray
    cell: FloatArray
    step: FloatArray
    rows: FloatArray


@allocating_kernel
def make_derivatives() -> Derivatives:
    """Room for one thread."""
    return Derivatives(np.empty(10), np.empty(10), np.empty(3), np.empty(ROWS))


@kernel
def add_quality_terms(
    points: FloatArray, v: int, i: int, j: int, k: int, power: float, out: FloatArray,
) -> bool:
    """Add the cost of a cell, its gradient and Hessian in x_v to [F, g, H_xx xy xz yy yz zz].

    False when the cell is not positive.
    """
    ax, ay, az, bx, by, bz, cx, cy, cz = corner_edges(points, v, i, j, k)
    nax, nay, naz, nbx, nby, nbz, ncx, ncy, ncz = corner_normals(
        ax, ay, az, bx, by, bz, cx, cy, cz
    )
    nox = nax + nbx + ncx
    noy = nay + nby + ncy
    noz = naz + nbz + ncz
    det = ax * nax + ay * nay + az * naz
    if not det > 0.0:
        return False
    na = math.sqrt(nax * nax + nay * nay + naz * naz)
    nb = math.sqrt(nbx * nbx + nby * nby + nbz * nbz)
    nc = math.sqrt(ncx * ncx + ncy * ncy + ncz * ncz)
    no = math.sqrt(nox * nox + noy * noy + noz * noz)
    s = na + nb + nc + no
    ex, ey, ez, fx, fy, fz, hx, hy, hz = opposite_edges(ax, ay, az, bx, by, bz, cx, cy, cz)
    ee = ex * ex + ey * ey + ez * ez
    ff = fx * fx + fy * fy + fz * fz
    hh = hx * hx + hy * hy + hz * hz
    u1 = (ax * ax + ay * ay + az * az) * ee
    u2 = (bx * bx + by * by + bz * bz) * ff
    u3 = (cx * cx + cy * cy + cz * cz) * hh
    h = 2.0 * (u1 * u2 + u2 * u3 + u3 * u1) - u1 * u1 - u2 * u2 - u3 * u3
    if not h > 0.0:
        return False
    q = 12.0 * det * det / (s * math.sqrt(h))
    ia = 1.0 / na
    ib = 1.0 / nb
    ic = 1.0 / nc
    nax *= ia
    nay *= ia
    naz *= ia
    nbx *= ib
    nby *= ib
    nbz *= ib
    ncx *= ic
    ncy *= ic
    ncz *= ic
    # gradient of the sum of the face normals' lengths
    sx = (ey * naz - ez * nay) + (fy * nbz - fz * nby) + (hy * ncz - hz * ncy)
    sy = (ez * nax - ex * naz) + (fz * nbx - fx * nbz) + (hz * ncx - hx * ncz)
    sz = (ex * nay - ey * nax) + (fx * nby - fy * nbx) + (hx * ncy - hy * ncx)
    # gradients of u1, u2, u3
    t1 = -2.0 * ee
    t2 = -2.0 * ff
    t3 = -2.0 * hh
    u1x = t1 * ax
    u1y = t1 * ay
    u1z = t1 * az
    u2x = t2 * bx
    u2y = t2 * by
    u2z = t2 * bz
    u3x = t3 * cx
    u3y = t3 * cy
    u3z = t3 * cz
    h1 = 2.0 * (u2 + u3 - u1)
    h2 = 2.0 * (u3 + u1 - u2)
    h3 = 2.0 * (u1 + u2 - u3)
    gx = h1 * u1x + h2 * u2x + h3 * u3x
    gy = h1 * u1y + h2 * u2y + h3 * u3y
    gz = h1 * u1z + h2 * u2z + h3 * u3z
    tx = u1x + u2x + u3x
    ty = u1y + u2y + u3y
    tz = u1z + u2z + u3z
    iso = 2.0 * (h1 * ee + h2 * ff + h3 * hh)
    idet = 1.0 / det
    dx = -nox * idet
    dy = -noy * idet
    dz = -noz * idet
    isum = 1.0 / s
    sx *= isum
    sy *= isum
    sz *= isum
    ih = 0.5 / h
    gx *= ih
    gy *= ih
    gz *= ih
    # grad log q, then -Hess log q
    lx = 2.0 * dx - sx - gx
    ly = 2.0 * dy - sy - gy
    lz = 2.0 * dz - sz - gz
    wa = ee * ia * isum
    wb = ff * ib * isum
    wc = hh * ic * isum
    w2 = 2.0 * ih
    w4 = 4.0 * ih
    f = quality_cost(q, power)
    share = q / (q + SHIFT)
    pf = power * f * share
    pp = pf * ((power + 1.0) * share - 1.0)
    out[0] += f
    out[1] -= pf * lx
    out[2] -= pf * ly
    out[3] -= pf * lz
    out[4] += pp * lx * lx + pf * (
        2.0 * dx * dx - sx * sx - 2.0 * gx * gx
        + wa * nax * nax + wb * nbx * nbx + wc * ncx * ncx
        + ih * iso + w2 * tx * tx - w4 * (u1x * u1x + u2x * u2x + u3x * u3x)
    )
    out[5] += pp * lx * ly + pf * (
        2.0 * dx * dy - sx * sy - 2.0 * gx * gy
        + wa * nax * nay + wb * nbx * nby + wc * ncx * ncy
        + w2 * tx * ty - w4 * (u1x * u1y + u2x * u2y + u3x * u3y)
    )
    out[6] += pp * lx * lz + pf * (
        2.0 * dx * dz - sx * sz - 2.0 * gx * gz
        + wa * nax * naz + wb * nbx * nbz + wc * ncx * ncz
        + w2 * tx * tz - w4 * (u1x * u1z + u2x * u2z + u3x * u3z)
    )
    out[7] += pp * ly * ly + pf * (
        2.0 * dy * dy - sy * sy - 2.0 * gy * gy
        + wa * nay * nay + wb * nby * nby + wc * ncy * ncy
        + ih * iso + w2 * ty * ty - w4 * (u1y * u1y + u2y * u2y + u3y * u3y)
    )
    out[8] += pp * ly * lz + pf * (
        2.0 * dy * dz - sy * sz - 2.0 * gy * gz
        + wa * nay * naz + wb * nby * nbz + wc * ncy * ncz
        + w2 * ty * tz - w4 * (u1y * u1z + u2y * u2z + u3y * u3z)
    )
    out[9] += pp * lz * lz + pf * (
        2.0 * dz * dz - sz * sz - 2.0 * gz * gz
        + wa * naz * naz + wb * nbz * nbz + wc * ncz * ncz
        + ih * iso + w2 * tz * tz - w4 * (u1z * u1z + u2z * u2z + u3z * u3z)
    )
    return True


@kernel
def add_cost_terms(
    points: FloatArray, v: int, i: int, j: int, k: int, cost: Cost, room: Derivatives
) -> bool:
    """As :func:`add_quality_terms` to ``room.star``, with any measure."""
    out, terms = room.star, room.cell
    if cost.objective == QUALITY:
        return add_quality_terms(points, v, i, j, k, cost.power, out)
    if cost.objective == MEAN_RATIO:
        if not mean_ratio_terms(points, v, i, j, k, terms):
            return False
    elif cost.objective == STEP:
        if not step_terms(points, v, i, j, k, terms):
            return False
    elif not dihedral_terms(points, v, i, j, k, terms):
        return False
    m = terms[0]
    f = quality_cost(m, cost.power)
    share = m / (m + SHIFT)
    pf = cost.power * f * share
    pp = pf * ((cost.power + 1.0) * share - 1.0)
    out[0] += f
    for a in range(1, 4):
        out[a] -= pf * terms[a]
    for a in range(4, 10):
        out[a] -= pf * terms[a]
    add_square(out, pp, terms[1], terms[2], terms[3])
    return True


@kernel
def _newton_direction(out: FloatArray, step: FloatArray) -> bool:
    """Solve (H + s I) step = -g with the least shift s of a short ladder that makes it SPD."""
    trace = abs(out[4]) + abs(out[7]) + abs(out[9])
    shift = 0.0
    for _ in range(12):
        a = out[4] + shift
        d = out[7] + shift
        f = out[9] + shift
        if a > 1e-12 * trace:
            l10 = out[5] / a
            l20 = out[6] / a
            d1 = d - l10 * out[5]
            if d1 > 1e-12 * trace:
                m = out[8] - l20 * out[5]
                l21 = m / d1
                d2 = f - l20 * out[6] - l21 * m
                if d2 > 1e-12 * trace:
                    y0 = -out[1]
                    y1 = -out[2] - l10 * y0
                    y2 = -out[3] - l20 * y0 - l21 * y1
                    step[2] = y2 / d2
                    step[1] = y1 / d1 - l21 * step[2]
                    step[0] = y0 / a - l10 * step[1] - l20 * step[2]
                    return True
        shift = 0.01 * trace if shift == 0.0 else 2.5 * shift
    return False


@kernel
def star_state(
    points: FloatArray, cells: IntArray, indices: IntArray, start: int, stop: int, cost: Cost,
    limit: float, sure: float,
) -> tuple[float, Extremes]:
    """Cost and extremes of the cells indices[start:stop].

    Parameters
    ----------
    limit : float    a sum of costs above it is given up
    sure : float     the angles of cells from this radius ratio on are not asked for

    Returns
    -------
    total : float          sum of the costs; infinite above the limit or if inverted
    extremes : Extremes
    """
    total = 0.0
    found = Extremes(1.0, -1.0, 1.0)
    for s in range(start, stop):
        c = indices[s]
        i, j, k, l = cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3]
        q = tet_quality(points, i, j, k, l)
        if q <= 1e-9:
            return np.inf, found
        if cost.objective == QUALITY:
            total += quality_cost(q, cost.power)
        else:
            total += cell_cost(points, cells, c, cost)
        if total >= limit:
            return np.inf, found
        large, small = -1.0, 1.0
        if q < sure:
            large, small = tet_cosines(points, i, j, k, l)
        found = worse(found, Extremes(q, large, small))
    return total, found


@kernel
def _row_state(
    points: FloatArray, cells: IntArray, indices: IntArray, start: int, v: int, power: float,
    limit: float, sure: float, count: int, rows: FloatArray,
) -> tuple[float, Extremes]:
    """As :func:`star_state` for radius ratios, with the other corners of the cells in rows."""
    quality_rows(points[v, 0], points[v, 1], points[v, 2], count, rows)
    total = 0.0
    found = Extremes(1.0, -1.0, 1.0)
    for s in range(count):
        q = rows[Q + s]
        if q <= 1e-9:
            return np.inf, found
        total += quality_cost(q, power)
    if total >= limit:
        return np.inf, found
    for s in range(count):
        q = rows[Q + s]
        large, small = -1.0, 1.0
        if q < sure:
            c = indices[start + s]
            large, small = tet_cosines(
                points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3]
            )
        found = worse(found, Extremes(q, large, small))
    return total, found


@kernel
def sure_quality(limit: Extremes) -> float:
    """Radius ratio from which on no dihedral angle passes the limit; above 1 if none is sure.

    The sine of a dihedral angle is at least q/3 = r/R.  With A <= A' the faces at its edge e and S
    the sum of all faces, sin = 3 V e / (2 A A'), 3 V = r S, S >= 2 A' since no face is larger than
    the other three together, and A <= e R since no height in a circle is longer than 2 R.
    """
    cosine = max(min(limit.large, -limit.small), 0.0)
    return 3.0 * math.sqrt(max(1.0 - cosine * cosine, 0.0) + ROUNDING)


@kernel
def newton_vertex(
    points: FloatArray, cells: IntArray, indices: IntArray, start: int, stop: int, v: int,
    cost: Cost, limit: Extremes, room: Derivatives,
) -> float:
    """One guarded Newton step on F_p for vertex v with the star indices[start:stop], in place.

    Returns the cost before minus the cost after, 0 when the vertex stays; room.star[0] is the cost
    before.
    """
    out, step, rows = room.star, room.step, room.rows
    out[:] = 0.0
    x = points[v, 0]
    y = points[v, 1]
    z = points[v, 2]
    count = stop - start
    in_rows = cost.objective == QUALITY and count <= CHUNK
    if in_rows:
        gather_corners(points, cells, indices, start, stop, v, rows)
        if not add_star_terms(x, y, z, count, cost.power, rows, out):
            return 0.0
    else:
        for s in range(start, stop):
            i, j, k = opposite_vertices(cells, indices[s], v)
            if not add_cost_terms(points, v, i, j, k, cost, room):
                return 0.0
    if not _newton_direction(out, step):
        return 0.0
    slope = out[1] * step[0] + out[2] * step[1] + out[3] * step[2]
    if -slope < 1e-9 * out[0]:
        return 0.0
    sure = sure_quality(limit)
    alpha = 1.0
    for _ in range(HALVINGS):
        points[v, 0] = x + alpha * step[0]
        points[v, 1] = y + alpha * step[1]
        points[v, 2] = z + alpha * step[2]
        most = out[0] + 1e-4 * alpha * slope
        if in_rows:
            after, there = _row_state(
                points, cells, indices, start, v, cost.power, most, sure, count, rows
            )
        else:
            after, there = star_state(points, cells, indices, start, stop, cost, most, sure)
        if after < out[0]:
            if keeps(there, limit):
                return out[0] - after
            new_x = points[v, 0]
            new_y = points[v, 1]
            new_z = points[v, 2]
            points[v, 0] = x
            points[v, 1] = y
            points[v, 2] = z
            _, here = star_state(points, cells, indices, start, stop, cost, np.inf, sure)
            if keeps(there, worse(limit, here)):
                points[v, 0] = new_x
                points[v, 1] = new_y
                points[v, 2] = new_z
                return out[0] - after
        alpha *= 0.5
    points[v, 0] = x
    points[v, 1] = y
    points[v, 2] = z
    return 0.0


@allocating_kernel
def smooth_vertices(
    points: FloatArray, cells: IntArray, stars: Stars, order: IntArray, start: int, stop: int,
    cost: Cost, limit: Extremes, moved: FloatArray,
) -> int:
    """One guarded Newton step on F_p for vertices order[start:stop], in place.

    Parameters
    ----------
    points : (n, 3) float64, cells : (m, 4) int32
    stars : Stars                        of the cells
    order : (k,) int32                   vertices, moved one after another
    cost : Cost
    limit : Extremes                     that no star may pass unless it does already
    moved : (n,) float64                 relative decrease of the star's cost is written here

    Returns
    -------
    int                                  number of vertices moved
    """
    room = make_derivatives()
    indptr, indices = stars
    count = 0
    for o in range(start, stop):
        v = order[o]
        gain = newton_vertex(
            points, cells, indices, indptr[v], indptr[v + 1], v, cost, limit, room
        )
        moved[v] = 0.0
        if gain > 0.0:
            moved[v] = gain / room.star[0]
            count += 1
    return count
