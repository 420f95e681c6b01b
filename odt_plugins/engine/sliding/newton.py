"""Vertices on the surface of a tetrahedral mesh: Newton steps on F_p along the input surface.

F_p is that of the tetrahedra around the vertex; where it may go is up to the guards of the
surface, and to the volume of the mesh.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.bounds import relaxed
from odt_plugins.engine.cells.tetrahedron import opposite_vertices
from odt_plugins.engine.cells.triangle import opposite_edge
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.ground.closest import Ground
from odt_plugins.engine.ground.lines import Lines, line_direction
from odt_plugins.engine.ground.position import (
    ARMIJO,
    DECREASE,
    HALVINGS,
    axis_across,
    least_cosine,
    put_vertex,
    star_normal,
)
from odt_plugins.engine.ground.sheet import HELD, LINE, Limits, Sheet, Work, cover, star_fits
from odt_plugins.engine.moves.newton3d import add_cost_terms, star_state
from odt_plugins.engine.moves.plane_step import plane_step
from odt_plugins.engine.topology.star import OffsetArray
from odt_plugins.mesh.arrays import FloatArray, IntArray, LongArray


@allocating_kernel
def slide_vertices(
    cells: IntArray, indptr: LongArray, indices: IntArray, order: IntArray, objective: int,
    power: float, bounds: FloatArray, sheet: Sheet, ground: Ground, lines: Lines,
    sheet_indptr: OffsetArray, sheet_indices: IntArray, limits: Limits, volume: FloatArray,
    work: Work, moved: FloatArray,
) -> int:
    """One guarded Newton step on F_p for every surface vertex of ``order``, in place.

    Parameters
    ----------
    cells : (m, 4) int32
    indptr, indices                    stars of the tetrahedra in CSR form
    order : (k,) int32                 vertices of the sheet, visited one after the other
    objective, power                   see ``tetrahedron.tet_cost``
    bounds : (6,) float64              least q, largest and smallest cosine that may appear
    sheet : Sheet                      the boundary; its points are those of the tetrahedra
    ground : Ground, lines : Lines, limits : Limits
    sheet_indptr, sheet_indices        stars of the sheet
    volume : (n + 1, 2) float64        see :func:`affordable`
    work : Work                        room for the stars of the sheet
    moved : (n,) float64               OUT: relative decrease of the star's cost

    Returns
    -------
    int                                number of vertices moved
    """
    points = sheet.points
    out = np.empty(20)
    count = 0
    for o in range(len(order)):
        v = order[o]
        moved[v] = 0.0
        if sheet.kind[v] == HELD or sheet_indptr[v] == sheet_indptr[v + 1]:
            continue
        lo, hi = indptr[v], indptr[v + 1]
        out[:10] = 0.0
        positive = True
        for s in range(lo, hi):
            i, j, k = opposite_vertices(cells, indices[s], v)
            if not add_cost_terms(points, v, i, j, k, objective, power, out):
                positive = False
                break
        if not positive:
            continue
        on_a_line = sheet.kind[v] == LINE
        nx, ny, nz = star_normal(sheet, sheet_indptr, sheet_indices, v)
        if on_a_line:
            ax, ay, az = line_direction(lines, points, lines.slot[v])
        elif nx * nx + ny * ny + nz * nz > 0.0:
            ax, ay, az = axis_across(nx, ny, nz)
        else:
            continue
        bx, by, bz = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
        g1 = ax * out[1] + ay * out[2] + az * out[3]
        g2 = bx * out[1] + by * out[2] + bz * out[3]
        h11 = _form(out, ax, ay, az, ax, ay, az)
        h12 = _form(out, ax, ay, az, bx, by, bz)
        h22 = _form(out, bx, by, bz, bx, by, bz)
        d1, d2 = plane_step(g1, g2, h11, h12, h22, on_a_line)
        slope = g1 * d1 + g2 * d2
        cost = out[0]
        if not -slope > DECREASE * cost:
            continue
        gain = _try_slide(
            cells, indices, lo, hi, v, d1 * ax + d2 * bx, d1 * ay + d2 * by, d1 * az + d2 * bz,
            d1, objective, power, bounds, cost, slope, sheet, ground, lines, sheet_indptr,
            sheet_indices, limits, volume, work,
        )
        if gain > 0.0:
            moved[v] = gain / cost
            count += 1
    return count


@kernel
def _form(
    out: FloatArray, ax: float, ay: float, az: float, bx: float, by: float, bz: float
) -> float:
    """a^T H b for the Hessian out[4:10] = [xx xy xz yy yz zz]."""
    return (
        ax * (out[4] * bx + out[5] * by + out[6] * bz)
        + ay * (out[5] * bx + out[7] * by + out[8] * bz)
        + az * (out[6] * bx + out[8] * by + out[9] * bz)
    )


@kernel
def affordable(volume: FloatArray, change: float, v: int) -> bool:
    """Whether vertex v may change the volume: within all budgets, or if debts are paid back.

    ``volume`` (n + 1, 2): [change so far, largest change] of the mesh, then for every vertex
    [change so far, part of the largest change that is its own].
    """
    after = abs(volume[0, 0] + change)
    if after > volume[0, 1] and after > abs(volume[0, 0]):
        return False
    after = abs(volume[v + 1, 0] + change)
    return after <= volume[v + 1, 1] * volume[0, 1] or after <= abs(volume[v + 1, 0])


@kernel
def spend(volume: FloatArray, change: float, v: int) -> None:
    """Write down that vertex v changed the volume."""
    volume[0, 0] += change
    volume[v + 1, 0] += change


@kernel
def swept_volume(
    sheet: Sheet, indptr: OffsetArray, indices: IntArray, v: int, x: float, y: float, z: float,
) -> float:
    """Volume that the star of v swept outwards when v moved from (x, y, z) to where it is."""
    p, t = sheet.points, sheet.triangles
    dx, dy, dz = p[v, 0] - x, p[v, 1] - y, p[v, 2] - z
    total = 0.0
    for s in range(indptr[v], indptr[v + 1]):
        c = indices[s]
        b, d = opposite_edge(t, c, v)
        ux, uy, uz = p[b, 0] - x, p[b, 1] - y, p[b, 2] - z
        wx, wy, wz = p[d, 0] - x, p[d, 1] - y, p[d, 2] - z
        total += (
            dx * (uy * wz - uz * wy) + dy * (uz * wx - ux * wz) + dz * (ux * wy - uy * wx)
        )
    return total / 6.0


@kernel
def _try_slide(
    cells: IntArray, indices: IntArray, lo: int, hi: int, v: int, dx: float, dy: float, dz: float,
    along: float, objective: int, power: float, bounds: FloatArray, cost: float, slope: float,
    sheet: Sheet, ground: Ground, lines: Lines, sheet_indptr: OffsetArray,
    sheet_indices: IntArray, limits: Limits, volume: FloatArray, work: Work,
) -> float:
    """Move v by alpha d, alpha = 1, 1/2, ..., until every guard agrees; returns the decrease."""
    points = sheet.points
    x, y, z, foot = points[v, 0], points[v, 1], points[v, 2], sheet.foot[v]
    slot = lines.slot[v]
    place = lines.place[slot] if slot >= 0 else 0.0
    _, worst, large, small = star_state(
        points, cells, indices, lo, hi, objective, power, np.inf, 2.0
    )
    least, most, fewest = relaxed(bounds, worst, large, small)
    floor = 2.0
    alpha = 1.0
    for _ in range(HALVINGS + 1):
        good = put_vertex(
            sheet, ground, lines, v, x + alpha * dx, y + alpha * dy, z + alpha * dz,
            alpha * along, limits.line,
        )
        there = swept = 0.0
        if good:
            there, worst, large, small = star_state(
                points, cells, indices, lo, hi, objective, power, cost, 2.0
            )
            good = there < (1.0 - DECREASE) * cost and there <= cost + ARMIJO * alpha * slope
        if good:
            swept = swept_volume(sheet, sheet_indptr, sheet_indices, v, x, y, z)
            good = (
                affordable(volume, swept, v)
                and worst >= least
                and large <= most
                and small >= fewest
            )
        if good:
            number = star_fits(
                sheet, ground, sheet_indptr, sheet_indices, v, limits,
                min(floor, limits.cosine), work,
            )
            if number >= 0:
                cover(sheet, sheet_indptr[v + 1] - sheet_indptr[v], number, work)
                spend(volume, swept, v)
                return cost - there
        if slot >= 0:
            lines.place[slot] = place
        sheet.foot[v] = foot
        if good and floor > 1.0:
            points[v, 0], points[v, 1], points[v, 2] = x, y, z
            floor = least_cosine(sheet, ground, sheet_indptr, sheet_indices, v, limits)
        alpha *= 0.5
    points[v, 0], points[v, 1], points[v, 2] = x, y, z
    return 0.0
