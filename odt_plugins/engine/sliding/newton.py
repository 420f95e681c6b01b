"""Vertices on the surface of a tetrahedral mesh: Newton steps on F_p along the input surface.

F_p is that of the tetrahedra around the vertex; where it may go is up to the guards of the
surface, and to the volume of the mesh.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Extremes, keeps, worse
from odt_plugins.engine.cells.measures import make_room, star_state, star_terms
from odt_plugins.engine.cells.triangle import opposite_edge
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.ground.lines import line_direction
from odt_plugins.engine.ground.position import (
    ARMIJO,
    DECREASE,
    HALVINGS,
    Step,
    least_cosine,
    put_vertex,
)
from odt_plugins.engine.ground.sheet import LINE, LOCKED, Sheet, Work, cover, star_fits
from odt_plugins.engine.moves.plane_step import plane_step
from odt_plugins.engine.moves.tangent import axis_across, star_normal
from odt_plugins.engine.sliding.boundary import Skin, affordable, spend
from odt_plugins.engine.topology.star import Stars
from odt_plugins.mesh.arrays import FloatArray, IntArray


@allocating_kernel
def slide_vertices(
    cells: IntArray, stars: Stars, order: IntArray, cost: Cost, limit: Extremes, skin: Skin,
    own: Stars, work: Work, moved: FloatArray,
) -> int:
    """One guarded Newton step on F_p for every surface vertex of ``order``, in place.

    Parameters
    ----------
    cells : (m, 4) int32
    stars : Stars             of the tetrahedra
    order : (k,) int32        vertices of the sheet, visited one after the other
    cost : Cost
    limit : Extremes          that no star may pass unless it does already
    skin : Skin               the boundary; its points are those of the tetrahedra
    own : Stars               of the triangles of the sheet
    work : Work               room for those
    moved : (n,) float64      OUT: relative decrease of the star's cost

    Returns
    -------
    int                       number of vertices moved
    """
    sheet, lines = skin.sheet, skin.lines
    points = sheet.points
    indptr, indices = stars
    room = make_room()
    out = room.star
    count = 0
    for o in range(len(order)):
        v = order[o]
        moved[v] = 0.0
        if sheet.kind[v] == LOCKED or own.indptr[v] == own.indptr[v + 1]:
            continue
        if not star_terms(points, cells, indices, indptr[v], indptr[v + 1], v, cost, room):
            continue
        on_a_line = sheet.kind[v] == LINE
        around = own.indices[own.indptr[v] : own.indptr[v + 1]]
        nx, ny, nz = star_normal(points, sheet.triangles, around)
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
        before = out[0]
        if not -slope > DECREASE * before:
            continue
        step = Step(
            d1 * ax + d2 * bx, d1 * ay + d2 * by, d1 * az + d2 * bz, d1, before, slope
        )
        gain = _try_slide(cells, stars, v, step, cost, limit, skin, own, work)
        if gain > 0.0:
            moved[v] = gain / before
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
def swept_volume(sheet: Sheet, own: Stars, v: int, x: float, y: float, z: float) -> float:
    """Volume that the star of v swept outwards when v moved from (x, y, z) to where it is."""
    p, t = sheet.points, sheet.triangles
    dx, dy, dz = p[v, 0] - x, p[v, 1] - y, p[v, 2] - z
    indptr, indices = own
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
    cells: IntArray, stars: Stars, v: int, step: Step, cost: Cost, limit: Extremes, skin: Skin,
    own: Stars, work: Work,
) -> float:
    """Move v by alpha step, alpha = 1, 1/2, ..., until every guard agrees; returns the decrease."""
    sheet, ground, lines, limits = skin.sheet, skin.ground, skin.lines, skin.limits
    points, before = sheet.points, step.before
    start, stop = stars.indptr[v], stars.indptr[v + 1]
    x, y, z, foot = points[v, 0], points[v, 1], points[v, 2], sheet.foot[v]
    slot = lines.slot[v]
    place = lines.place[slot] if slot >= 0 else 0.0
    _, here = star_state(points, cells, stars.indices, start, stop, cost, np.inf, 2.0)
    limit = worse(limit, here)
    floor = 2.0
    alpha = 1.0
    for _ in range(HALVINGS + 1):
        good = put_vertex(
            sheet, ground, lines, v, x + alpha * step.x, y + alpha * step.y, z + alpha * step.z,
            alpha * step.along, limits.line,
        )
        after = swept = 0.0
        if good:
            after, there = star_state(
                points, cells, stars.indices, start, stop, cost, before, 2.0
            )
            good = (
                after < (1.0 - DECREASE) * before
                and after <= before + ARMIJO * alpha * step.slope
                and keeps(there, limit)
            )
        if good:
            swept = swept_volume(sheet, own, v, x, y, z)
            good = affordable(skin.volume, swept, v)
        if good:
            number = star_fits(
                sheet, ground, own, v, limits, min(floor, limits.cosine), work
            )
            if number >= 0:
                cover(sheet, own.indptr[v + 1] - own.indptr[v], number, work)
                spend(skin.volume, swept, v)
                return before - after
        if slot >= 0:
            lines.place[slot] = place
        sheet.foot[v] = foot
        if good and floor > 1.0:
            points[v, 0], points[v, 1], points[v, 2] = x, y, z
            floor = least_cosine(sheet, ground, own, v, limits)
        alpha *= 0.5
    points[v, 0], points[v, 1], points[v, 2] = x, y, z
    return 0.0
