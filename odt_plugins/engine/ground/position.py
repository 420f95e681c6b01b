"""One vertex of a surface on its way to a new place: back to the ground, shortened, or refused."""

from __future__ import annotations

import math

from odt_plugins.engine.cells.bounds import relaxed
from odt_plugins.engine.cells.triangle import triangle_in_space
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.closest import Ground, walk
from odt_plugins.engine.ground.lines import Lines, line_direction, line_is_near, on_line
from odt_plugins.engine.ground.sheet import (
    LINE,
    Limits,
    Sheet,
    Work,
    cover,
    normal_cosine,
    star_fits,
)
from odt_plugins.engine.topology.star import OffsetArray
from odt_plugins.mesh.arrays import FloatArray, IntArray

HALVINGS = 6
"""Step lengths alpha = 1, 1/2, 1/4, ... tried for one vertex."""

DECREASE = 1e-6
"""Least relative decrease of F_p over the star for which a vertex moves."""

ARMIJO = 1e-4
"""Part of the decrease that the slope predicts which a step must reach."""

APART = 0.05
"""Part of the way between its neighbours on the line that a vertex keeps from each."""


@kernel
def star_normal(
    sheet: Sheet, indptr: OffsetArray, indices: IntArray, vertex: int
) -> tuple[float, float, float]:
    """Unit normal of a star, area-weighted; 0 when there is none."""
    x = y = z = 0.0
    for s in range(indptr[vertex], indptr[vertex + 1]):
        c = indices[s]
        t = sheet.triangles
        _, _, _, nx, ny, nz = triangle_in_space(sheet.points, t[c, 0], t[c, 1], t[c, 2])
        x += nx
        y += ny
        z += nz
    length = math.sqrt(x * x + y * y + z * z)
    if not length > 0.0:
        return 0.0, 0.0, 0.0
    return x / length, y / length, z / length


@kernel
def axis_across(nx: float, ny: float, nz: float) -> tuple[float, float, float]:
    """Unit vector at right angles to a unit vector."""
    if abs(nx) <= abs(ny) and abs(nx) <= abs(nz):
        x, y, z = 0.0, nz, -ny
    elif abs(ny) <= abs(nz):
        x, y, z = -nz, 0.0, nx
    else:
        x, y, z = ny, -nx, 0.0
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@kernel
def star_shape(
    sheet: Sheet, indptr: OffsetArray, indices: IntArray, vertex: int, power: float
) -> tuple[float, float, float, float]:
    """F_p, worst radius ratio, cosines of the smallest and of the largest angle of a star."""
    total = 0.0
    worst = 1.0
    large = -1.0
    small = 1.0
    t = sheet.triangles
    for s in range(indptr[vertex], indptr[vertex + 1]):
        c = indices[s]
        q, hi, lo, _, _, _ = triangle_in_space(sheet.points, t[c, 0], t[c, 1], t[c, 2])
        total += q**-power if q > 0.0 else math.inf
        worst = min(worst, q)
        large = max(large, hi)
        small = min(small, lo)
    return total, worst, large, small


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
    sheet: Sheet, ground: Ground, indptr: OffsetArray, indices: IntArray, vertex: int,
    limits: Limits,
) -> float:
    """The limit for normals, or less where the star does not keep it as it is."""
    t = sheet.triangles
    least = limits.cosine
    for s in range(indptr[vertex], indptr[vertex + 1]):
        c = indices[s]
        least = min(least, normal_cosine(sheet, ground, t[c, 0], t[c, 1], t[c, 2]))
    return least


@kernel
def try_move(
    sheet: Sheet, ground: Ground, lines: Lines, indptr: OffsetArray, indices: IntArray,
    vertex: int, dx: float, dy: float, dz: float, limits: Limits, power: float, cost: float,
    slope: float, bounds: FloatArray, work: Work,
) -> float:
    """Move a vertex by alpha d, alpha = 1, 1/2, ..., until every guard agrees.

    Returns
    -------
    float      alpha, 0 when the vertex stayed; ``power`` = 0 asks for no decrease of F_p
    """
    p = sheet.points
    x, y, z, foot = p[vertex, 0], p[vertex, 1], p[vertex, 2], sheet.foot[vertex]
    slot = lines.slot[vertex]
    place = lines.place[slot] if slot >= 0 else 0.0
    length = 0.0
    if slot >= 0:
        ex, ey, ez = line_direction(lines, p, slot)
        length = dx * ex + dy * ey + dz * ez
    _, worst, large, small = star_shape(sheet, indptr, indices, vertex, 1.0)
    least, most, fewest = relaxed(bounds, worst, large, small)
    floor = 2.0
    alpha = 1.0
    for _ in range(HALVINGS + 1):
        good = put_vertex(
            sheet, ground, lines, vertex, x + alpha * dx, y + alpha * dy, z + alpha * dz,
            alpha * length, limits.line,
        )
        if good:
            there, worst, large, small = star_shape(sheet, indptr, indices, vertex, power)
            good = worst >= least and large <= most and small >= fewest
            if power > 0.0:
                good = good and (
                    there <= cost + ARMIJO * alpha * slope and there < (1.0 - DECREASE) * cost
                )
        if good:
            number = star_fits(
                sheet, ground, indptr, indices, vertex, limits, min(floor, limits.cosine), work
            )
            if number >= 0:
                cover(sheet, indptr[vertex + 1] - indptr[vertex], number, work)
                return alpha
        if slot >= 0:
            lines.place[slot] = place
        sheet.foot[vertex] = foot
        if good and floor > 1.0:
            p[vertex, 0], p[vertex, 1], p[vertex, 2] = x, y, z
            floor = least_cosine(sheet, ground, indptr, indices, vertex, limits)
        alpha *= 0.5
    p[vertex, 0], p[vertex, 1], p[vertex, 2] = x, y, z
    return 0.0
