"""Newton steps on F_p = sum of q^-p for a surface, one vertex at a time in its tangent plane."""

from __future__ import annotations

import math

from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.lines import line_direction
from odt_plugins.engine.ground.position import (
    DECREASE,
    Step,
    along_line,
    star_shape,
    try_move,
)
from odt_plugins.engine.ground.sheet import LINE, LOCKED, Guards, Sheet, Work
from odt_plugins.engine.moves.plane_step import plane_step
from odt_plugins.engine.moves.tangent import complete_axes, set_axes, star_cost, star_normal
from odt_plugins.engine.topology.star import Stars
from odt_plugins.mesh.arrays import FloatArray, IntArray


@kernel
def smooth_vertices(
    sheet: Sheet, guards: Guards, stars: Stars, order: IntArray, start: int, stop: int,
    power: float, bounds: Extremes, work: Work, moved: FloatArray,
) -> int:
    """One guarded Newton step on F_p for every vertex of order[start:stop], in place.

    Parameters as for :func:`move_vertices`; ``power`` is p, and ``moved`` becomes the relative
    decrease of F_p over the star.

    Returns
    -------
    int          number of vertices moved

    Notes
    -----
    The Hessian is made positive definite by a shift; a vertex on a line has one direction only.
    """
    lines = guards.lines
    e, derivatives = work.axes, work.derivatives
    count = 0
    for o in range(start, stop):
        v = order[o]
        moved[v] = 0.0
        if sheet.kind[v] == LOCKED or stars.indptr[v] == stars.indptr[v + 1]:
            continue
        on_a_line = sheet.kind[v] == LINE
        star = stars.indices[stars.indptr[v] : stars.indptr[v + 1]]
        nx, ny, nz = star_normal(sheet.points, sheet.triangles, star)
        if on_a_line:
            e[0, 0], e[0, 1], e[0, 2] = line_direction(lines, sheet.points, lines.slot[v])
            complete_axes(nx, ny, nz, e)
        elif nx * nx + ny * ny + nz * nz == 0.0:
            continue
        else:
            set_axes(nx, ny, nz, e)
        cost = star_cost(sheet.points, sheet.triangles, star, v, power, e, derivatives)
        if not cost < math.inf:
            continue
        g1, g2 = derivatives[0], derivatives[1]
        h11, h12, h22 = derivatives[2], derivatives[3], derivatives[4]
        d1, d2 = plane_step(g1, g2, h11, h12, h22, on_a_line)
        slope = g1 * d1 + g2 * d2
        if not -slope > DECREASE * cost:
            continue
        dx = d1 * e[0, 0] + d2 * e[1, 0]
        dy = d1 * e[0, 1] + d2 * e[1, 1]
        dz = d1 * e[0, 2] + d2 * e[1, 2]
        step = Step(dx, dy, dz, along_line(sheet, lines, v, dx, dy, dz), cost, slope)
        if try_move(sheet, guards, stars, v, step, power, bounds, work) > 0.0:
            there, _ = star_shape(sheet, stars, v, power)
            moved[v] = 1.0 - there / cost
            count += 1
    return count
