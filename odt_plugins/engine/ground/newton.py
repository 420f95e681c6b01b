"""Newton steps on F_p along the ground, of the vertices of a surface or of those around a body.

F_p is that of the cells of the body around the vertex: the triangles of the surface themselves, or
tetrahedra whose boundary slides.
"""

from __future__ import annotations

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.cells.measures import Room, make_room, star_terms
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.ground.lines import Lines, line_direction
from odt_plugins.engine.ground.position import DECREASE, Body, Step, along_line, try_move
from odt_plugins.engine.ground.sheet import LINE, LOCKED, Guards, Sheet, Work
from odt_plugins.engine.moves.newton2d import newton_step_2d
from odt_plugins.engine.moves.plane_step import seen_plane_step
from odt_plugins.engine.moves.tangent import complete_axes, set_axes, star_normal
from odt_plugins.engine.topology.star import Stars
from odt_plugins.mesh.arrays import FloatArray, IntArray

NOWHERE = Step(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
"""No step."""


@allocating_kernel
def smooth_on_ground(
    sheet: Sheet, guards: Guards, own: Stars, body: Body, order: IntArray, cost: Cost,
    bounds: Extremes, work: Work, moved: FloatArray,
) -> int:
    """One guarded Newton step on F_p for every vertex of ``order``, in place.

    Parameters
    ----------
    sheet : Sheet, guards : Guards
    own : Stars               of the triangles of the sheet
    body : Body
    order : (k,) int32        vertices, visited one after the other
    cost : Cost
    bounds : Extremes         that no star may pass unless it does already
    work : Work               room for a star
    moved : (n,) float64      OUT: relative decrease of F_p over the star

    Returns
    -------
    int                       number of vertices moved

    Notes
    -----
    The Hessian is made positive definite by a shift; a vertex on a line has one direction only.
    """
    room, e = make_room(), work.axes
    count = 0
    for o in range(order.shape[0]):
        v = order[o]
        moved[v] = 0.0
        if sheet.kind[v] == LOCKED or own.indptr[v] == own.indptr[v + 1]:
            continue
        star = own.indices[own.indptr[v] : own.indptr[v + 1]]
        nx, ny, nz = star_normal(sheet.points, sheet.triangles, star)
        if sheet.kind[v] == LINE:
            lines = guards.lines
            e[0, 0], e[0, 1], e[0, 2] = line_direction(lines, sheet.points, lines.slot[v])
            complete_axes(nx, ny, nz, e)
        elif nx * nx + ny * ny + nz * nz > 0.0:
            set_axes(nx, ny, nz, e)
        else:
            continue
        if body.cells.shape[1] == 4:
            step = _body_step(sheet, body, v, cost, e, room)
        else:
            step = _surface_step(sheet, guards.lines, star, v, cost, e, work)
        if not -step.slope > DECREASE * step.before:
            continue
        moves, there = try_move(sheet, guards, own, body, v, step, cost, bounds, work)
        if moves:
            moved[v] = (step.before - there) / step.before
            count += 1
    return count


@kernel
def _surface_step(
    sheet: Sheet, lines: Lines, star: IntArray, v: int, cost: Cost, e: FloatArray, work: Work
) -> Step:
    """Newton step by the triangles around v along the axes e."""
    before, slope, dx, dy, dz = newton_step_2d(
        sheet.points, sheet.triangles, star, v, cost, e, sheet.kind[v] == LINE, work.derivatives
    )
    return Step(dx, dy, dz, along_line(sheet, lines, v, dx, dy, dz), before, slope)


@kernel
def _body_step(
    sheet: Sheet, body: Body, v: int, cost: Cost, e: FloatArray, room: Room
) -> Step:
    """Newton step by the tetrahedra around v along the axes e."""
    out = room.star
    indptr, indices = body.stars
    if not star_terms(
        sheet.points, body.cells, indices, indptr[v], indptr[v + 1], v, cost, room
    ):
        return NOWHERE
    ax, ay, az, bx, by, bz = e[0, 0], e[0, 1], e[0, 2], e[1, 0], e[1, 1], e[1, 2]
    g1 = ax * out[1] + ay * out[2] + az * out[3]
    g2 = bx * out[1] + by * out[2] + bz * out[3]
    h11 = _form(out, ax, ay, az, ax, ay, az)
    h12 = _form(out, ax, ay, az, bx, by, bz)
    h22 = _form(out, bx, by, bz, bx, by, bz)
    d1, d2 = seen_plane_step(
        sheet.points, v, e, g1, g2, h11, h12, h22, sheet.kind[v] == LINE)
    return Step(
        d1 * ax + d2 * bx, d1 * ay + d2 * by, d1 * az + d2 * bz, d1, out[0], g1 * d1 + g2 * d2
    )


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
