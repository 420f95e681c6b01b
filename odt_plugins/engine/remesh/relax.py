"""Relaxation: a vertex of a patch or a line goes towards the middle of those around it."""

from __future__ import annotations

import math

from odt_plugins.engine.cells.metric import has_metric, seen_square
from odt_plugins.engine.cells.triangle import squares, triangle_in_space
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.remesh.body import FREELY, LINE, PATCH, Body, Guard, Scratch
from odt_plugins.engine.remesh.boxes import closest_of
from odt_plugins.engine.remesh.guard import move, normal_of_star
from odt_plugins.engine.remesh.simplices import star
from odt_plugins.mesh.arrays import FloatArray, IntArray


@kernel
def relax_surface(
    body: Body, guard: Guard, order: IntArray, offset: FloatArray, scratch: Scratch
) -> int:
    """Move vertices of patches and lines once; returns how many moved.

    A vertex of a patch goes towards the mean of the barycentres of its triangles, by their areas
    over the squared sizes, at a right angle to the vector area of its star: so no volume changes.
    One of a line goes to the middle of its neighbours in units of the size, on the line. Where the
    guard refuses, it goes half as far.

    Parameters
    ----------
    order : (k,) int32           vertices
    offset : (patches,) float64  how far those of a patch go out of its first region besides
    """
    moved = 0
    p = body.points
    for k in range(order.shape[0]):
        u = order[k]
        if body.hold[u] != FREELY or body.tets.head[u] < 0:
            continue
        if body.kind[u] == PATCH:
            x, y, z = _middle_of_patch(body, u, scratch)
            nx, ny, nz, size = normal_of_star(body, u, scratch)
            if not size > 0.0:
                continue
            dx, dy, dz = x - p[u, 0], y - p[u, 1], z - p[u, 2]
            out = offset[body.triangles.tag[body.triangles.head[u] // 3]]
            out -= dx * nx + dy * ny + dz * nz
            dx, dy, dz = dx + out * nx, dy + out * ny, dz + out * nz
        elif body.kind[u] == LINE:
            x, y, z = _middle_of_line(body, u, scratch)
            dx, dy, dz = x - p[u, 0], y - p[u, 1], z - p[u, 2]
        else:
            continue
        for _ in range(3):
            x, y, z = p[u, 0] + dx, p[u, 1] + dy, p[u, 2] + dz
            if body.kind[u] == LINE:
                line = body.segments.tag[body.segments.head[u] // 2]
                _, _, x, y, z = closest_of(guard.curves, line, x, y, z, math.inf)
            if move(body, guard, u, (x, y, z), scratch):
                moved += 1
                break
            dx, dy, dz = 0.5 * dx, 0.5 * dy, 0.5 * dz
    return moved


@kernel
def _middle_of_patch(body: Body, u: int, scratch: Scratch) -> tuple[float, float, float]:
    t, p, h = body.triangles.rows, body.points, body.size
    count = star(body.triangles, u, scratch.first)
    x = y = z = total = 0.0
    for s in range(count):
        a, b, c = t[scratch.first[s], 0], t[scratch.first[s], 1], t[scratch.first[s], 2]
        _, _, _, nx, ny, nz = triangle_in_space(p, a, b, c)
        size = (h[a] + h[b] + h[c]) / 3.0
        area = nx * nx + ny * ny + nz * nz
        if has_metric(p):
            area = squares(p, a, b, c)[3]
        weight = math.sqrt(area) / (size * size)
        x += weight * (p[a, 0] + p[b, 0] + p[c, 0]) / 3.0
        y += weight * (p[a, 1] + p[b, 1] + p[c, 1]) / 3.0
        z += weight * (p[a, 2] + p[b, 2] + p[c, 2]) / 3.0
        total += weight
    if not total > 0.0:
        return p[u, 0], p[u, 1], p[u, 2]
    return x / total, y / total, z / total


@kernel
def _middle_of_line(body: Body, u: int, scratch: Scratch) -> tuple[float, float, float]:
    rows, p, h = body.segments.rows, body.points, body.size
    count = star(body.segments, u, scratch.first)
    if count != 2:
        return p[u, 0], p[u, 1], p[u, 2]
    c, d = scratch.first[0], scratch.first[1]
    a = rows[c, 0] + rows[c, 1] - u
    b = rows[d, 0] + rows[d, 1] - u
    first = math.sqrt(seen_square(p, a, u)) / (h[a] + h[u])
    second = math.sqrt(seen_square(p, b, u)) / (h[b] + h[u])
    # both parts are alike where u is moved by half of their difference along the longer one
    far = a if first > second else b
    longer, shorter = max(first, second), min(first, second)
    w = 0.5 * (longer - shorter) / longer if longer > 0.0 else 0.0
    return (p[u, 0] + w * (p[far, 0] - p[u, 0]), p[u, 1] + w * (p[far, 1] - p[u, 1]),
            p[u, 2] + w * (p[far, 2] - p[u, 2]))

