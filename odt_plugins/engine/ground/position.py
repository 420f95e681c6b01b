"""One vertex of a surface on its way to a new place: back to the ground, shortened, or refused."""

from __future__ import annotations

import math
from typing import NamedTuple

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Extremes, keeps, worse
from odt_plugins.engine.cells.measures import QUALITY, star_state, star_state_2d
from odt_plugins.engine.cells.metric import has_metric, through, vertex_root
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.budget import affordable, spend, swept_volume
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
from odt_plugins.mesh.arrays import FloatArray, IntArray

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
    """Length of a step along the feature line of a vertex, 0 for one that is on none.

    It leads to the place on the line that is nearest as the vertex sees it.
    """
    slot = lines.slot[vertex]
    if slot < 0:
        return 0.0
    ex, ey, ez = line_direction(lines, sheet.points, slot)
    if not has_metric(sheet.points):
        return dx * ex + dy * ey + dz * ez
    root = vertex_root(sheet.points, vertex)
    ex, ey, ez = through(root, ex, ey, ez)
    dx, dy, dz = through(root, dx, dy, dz)
    square = ex * ex + ey * ey + ez * ez
    return (dx * ex + dy * ey + dz * ez) / square if square > 0.0 else 0.0


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


class Body(NamedTuple):
    """The cells whose costs count: the triangles of a surface, or tetrahedra behind it.

    Attributes
    ----------
    cells : (m, d + 1) int32
    stars : Stars                 of these cells
    volume : (n + 1, 2) float64   budgets of the change of the volume, see ``sliding.boundary``; of
                                  length 0 where there is none
    """

    cells: IntArray
    stars: Stars
    volume: FloatArray


@kernel
def _state(
    points: FloatArray, body: Body, v: int, cost: Cost, limit: float
) -> tuple[float, Extremes]:
    """F_p of the star of v in the body, and its extremes; of tetrahedra infinite above a limit."""
    indptr, indices = body.stars
    start, stop = indptr[v], indptr[v + 1]
    if body.cells.shape[1] == 4:
        return star_state(points, body.cells, indices, start, stop, cost, limit, 2.0)
    return star_state_2d(points, body.cells, indices[start:stop], cost)


@kernel
def try_move(
    sheet: Sheet, guards: Guards, own: Stars, body: Body, vertex: int, step: Step, cost: Cost,
    bounds: Extremes, work: Work,
) -> tuple[bool, float]:
    """Move a vertex by alpha times a step, alpha = 1, 1/2, ..., until every guard agrees.

    Parameters
    ----------
    own : Stars          of the sheet
    body : Body
    step : Step
    cost : Cost          of the sum F_p that must fall, or NO_COST
    bounds : Extremes    that the star may not pass unless it does already

    Returns
    -------
    moves : bool         whether the vertex did not stay
    there : float        F_p then
    """
    ground, lines, limits = guards
    p = sheet.points
    x, y, z, foot = p[vertex, 0], p[vertex, 1], p[vertex, 2], sheet.foot[vertex]
    slot = lines.slot[vertex]
    place = lines.place[slot] if slot >= 0 else 0.0
    _, here = _state(p, body, vertex, cost, math.inf)
    limit = worse(bounds, here)
    floor = 2.0
    alpha = 1.0
    for _ in range(HALVINGS + 1):
        good = put_vertex(
            sheet, ground, lines, vertex, x + alpha * step.x, y + alpha * step.y,
            z + alpha * step.z, alpha * step.along, limits.line,
        )
        there = swept = 0.0
        if good:
            there, found = _state(p, body, vertex, cost, step.before)
            good = keeps(found, limit)
            if cost.power > 0.0:
                good = good and (
                    there <= step.before + ARMIJO * alpha * step.slope
                    and there < (1.0 - DECREASE) * step.before
                )
        if good and body.volume.shape[0] > 0:
            swept = swept_volume(sheet, own, vertex, x, y, z)
            good = affordable(body.volume, swept, vertex)
        if good:
            number = star_fits(
                sheet, ground, own, vertex, limits, min(floor, limits.cosine), work
            )
            if number >= 0:
                cover(sheet, own.indptr[vertex + 1] - own.indptr[vertex], number, work)
                if body.volume.shape[0] > 0:
                    spend(body.volume, swept, vertex)
                return True, there
        if slot >= 0:
            lines.place[slot] = place
        sheet.foot[vertex] = foot
        if good and floor > 1.0:
            p[vertex, 0], p[vertex, 1], p[vertex, 2] = x, y, z
            floor = least_cosine(sheet, ground, own, vertex, limits)
        alpha *= 0.5
    p[vertex, 0], p[vertex, 1], p[vertex, 2] = x, y, z
    return False, step.before
