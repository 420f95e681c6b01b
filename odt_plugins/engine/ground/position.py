"""One vertex of a surface on its way to a new place: back to the ground, shortened, or refused."""

from __future__ import annotations

from typing import NamedTuple

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Extremes, keeps, worse
from odt_plugins.engine.cells.measures import QUALITY, star_state_2d
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.closest import Ground, walk
from odt_plugins.engine.ground.lines import Lines, line_direction, line_is_near, on_line
from odt_plugins.engine.ground.sheet import (
    LINE,
    Guards,
    Limits,
    Sheet,
    Work,
    cover,
    normal_cosine,
    star_fits,
)
from odt_plugins.engine.topology.star import Stars

HALVINGS = 6
"""Step lengths alpha = 1, 1/2, 1/4, ... tried for one vertex."""

DECREASE = 1e-6
"""Least relative decrease of F_p over the star for which a vertex moves."""

ARMIJO = 1e-4
"""Part of the decrease that the slope predicts which a step must reach."""

NO_COST = Cost(QUALITY, 0.0)
"""A move need not lower F_p."""

APART = 0.05
"""Part of the way between its neighbours on the line that a vertex keeps from each."""


class Step(NamedTuple):
    """Where a vertex is to go.

    Attributes
    ----------
    x, y, z : float     in space
    along : float       along the feature line of a vertex that is on one
    before : float      F_p of the star before
    slope : float       derivative of F_p along the step
    """

    x: float
    y: float
    z: float
    along: float
    before: float
    slope: float


@kernel
def along_line(
    sheet: Sheet, lines: Lines, vertex: int, dx: float, dy: float, dz: float
) -> float:
    """Length of a step along the feature line of a vertex, 0 for one that is on none."""
    slot = lines.slot[vertex]
    if slot < 0:
        return 0.0
    ex, ey, ez = line_direction(lines, sheet.points, slot)
    return dx * ex + dy * ey + dz * ez


@kernel
def put_vertex(
    sheet: Sheet, ground: Ground, lines: Lines, vertex: int,
    x: float, y: float, z: float, along: float, line_limit: float,
) -> bool:
    """Put a vertex at the point of the ground near (x, y, z), or ``along`` its line."""
    p = sheet.points
    if sheet.kind[vertex] == LINE:
        k = lines.slot[vertex]
        low, high = lines.place[k - 1], lines.place[k + 1]
        gap = APART * (high - low)
        place = min(max(lines.place[k] + along, low + gap), high - gap)
        x, y, z, face = on_line(lines, ground.points, k, place)
        lines.place[k] = place
    else:
        _, face, x, y, z = walk(x, y, z, sheet.foot[vertex], ground, False)
    p[vertex, 0], p[vertex, 1], p[vertex, 2] = x, y, z
    sheet.foot[vertex] = face
    if sheet.kind[vertex] != LINE:
        return True
    return line_is_near(lines, p, ground.points, lines.slot[vertex], line_limit)


@kernel
def least_cosine(
    sheet: Sheet, ground: Ground, stars: Stars, vertex: int, limits: Limits
) -> float:
    """The limit for normals, or less where the star does not keep it as it is."""
    t = sheet.triangles
    least = limits.cosine
    for s in range(stars.indptr[vertex], stars.indptr[vertex + 1]):
        c = stars.indices[s]
        least = min(least, normal_cosine(sheet, ground, t[c, 0], t[c, 1], t[c, 2]))
    return least


@kernel
def try_move(
    sheet: Sheet, guards: Guards, stars: Stars, vertex: int, step: Step, cost: Cost,
    bounds: Extremes, work: Work,
) -> float:
    """Move a vertex by alpha times a step, alpha = 1, 1/2, ..., until every guard agrees.

    Parameters
    ----------
    stars : Stars        of the sheet
    step : Step
    cost : Cost          of the sum F_p that must fall, or NO_COST
    bounds : Extremes    that the star may not pass unless it does already

    Returns
    -------
    float      alpha, 0 when the vertex stayed
    """
    ground, lines, limits = guards
    p = sheet.points
    x, y, z, foot = p[vertex, 0], p[vertex, 1], p[vertex, 2], sheet.foot[vertex]
    slot = lines.slot[vertex]
    place = lines.place[slot] if slot >= 0 else 0.0
    star = stars.indices[stars.indptr[vertex] : stars.indptr[vertex + 1]]
    _, here = star_state_2d(p, sheet.triangles, star, NO_COST)
    limit = worse(bounds, here)
    floor = 2.0
    alpha = 1.0
    for _ in range(HALVINGS + 1):
        good = put_vertex(
            sheet, ground, lines, vertex, x + alpha * step.x, y + alpha * step.y,
            z + alpha * step.z, alpha * step.along, limits.line,
        )
        if good:
            there, found = star_state_2d(p, sheet.triangles, star, cost)
            good = keeps(found, limit)
            if cost.power > 0.0:
                good = good and (
                    there <= step.before + ARMIJO * alpha * step.slope
                    and there < (1.0 - DECREASE) * step.before
                )
        if good:
            number = star_fits(
                sheet, ground, stars, vertex, limits, min(floor, limits.cosine), work
            )
            if number >= 0:
                cover(sheet, stars.indptr[vertex + 1] - stars.indptr[vertex], number, work)
                return alpha
        if slot >= 0:
            lines.place[slot] = place
        sheet.foot[vertex] = foot
        if good and floor > 1.0:
            p[vertex, 0], p[vertex, 1], p[vertex, 2] = x, y, z
            floor = least_cosine(sheet, ground, stars, vertex, limits)
        alpha *= 0.5
    p[vertex, 0], p[vertex, 1], p[vertex, 2] = x, y, z
    return 0.0
