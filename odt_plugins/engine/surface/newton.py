"""Newton steps on F_p = sum of q^-p for a surface, one vertex at a time in its tangent plane."""

from __future__ import annotations

import math

from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.cells.triangle import opposite_edge
from odt_plugins.engine.compiled.kernel import inner_kernel, kernel
from odt_plugins.engine.ground.lines import line_direction
from odt_plugins.engine.ground.position import (
    DECREASE,
    Step,
    along_line,
    axis_across,
    star_normal,
    star_shape,
    try_move,
)
from odt_plugins.engine.ground.sheet import LINE, LOCKED, Guards, Sheet, Work
from odt_plugins.engine.moves.plane_step import plane_step
from odt_plugins.engine.topology.star import Stars
from odt_plugins.mesh.arrays import FloatArray, IntArray


@inner_kernel
def star_cost(
    points: FloatArray, triangles: IntArray, stars: Stars, vertex: int, power: float,
    e: FloatArray, derivatives: FloatArray,
) -> float:
    """Sum of q^-p over the star of a vertex, with its derivatives along two directions.

    Parameters
    ----------
    points : (n, 3) float64, triangles : (m, 3) int32
    stars : Stars
    vertex : int
    power : float                 p
    e : (2, 3) float64            orthonormal directions
    derivatives : (5,) float64    OUT: F_1, F_2, F_11, F_12, F_22

    Returns
    -------
    float                         infinite when a triangle is flat

    Notes
    -----
    Opposite the edge w, with u and v from its ends to the vertex, log q is log B - log l1 -
    log l2 - log(l1 + l2 + |w|) + constant; B = |w|^2 |u|^2 - (u w)^2, four times the squared area,
    is a quadratic of the vertex.
    """
    indptr, indices = stars
    derivatives[:] = 0.0
    total = 0.0
    for s in range(indptr[vertex], indptr[vertex + 1]):
        t = indices[s]
        b, c = opposite_edge(triangles, t, vertex)
        uu = vv = ww = uw = 0.0
        u1 = u2 = v1 = v2 = w1 = w2 = 0.0
        for k in range(3):
            u = points[vertex, k] - points[b, k]
            v = points[vertex, k] - points[c, k]
            w = points[c, k] - points[b, k]
            uu += u * u
            vv += v * v
            ww += w * w
            uw += u * w
            u1 += u * e[0, k]
            u2 += u * e[1, k]
            v1 += v * e[0, k]
            v2 += v * e[1, k]
            w1 += w * e[0, k]
            w2 += w * e[1, k]
        square = ww * uu - uw * uw
        if not (square > 0.0 and uu > 0.0 and vv > 0.0):
            return math.inf
        l1 = math.sqrt(uu)
        l2 = math.sqrt(vv)
        perimeter = l1 + l2 + math.sqrt(ww)
        q = 4.0 * square / (perimeter * l1 * l2 * math.sqrt(ww))
        f = q**-power
        i1 = 1.0 / l1
        i2 = 1.0 / l2
        ip = 1.0 / perimeter
        ib = 2.0 / square
        # derivatives of log B
        a1 = (ww * u1 - uw * w1) * ib
        a2 = (ww * u2 - uw * w2) * ib
        a11 = (ww - w1 * w1) * ib - a1 * a1
        a12 = -w1 * w2 * ib - a1 * a2
        a22 = (ww - w2 * w2) * ib - a2 * a2
        # of the two lengths, by the cosines with the directions
        u1 *= i1
        u2 *= i1
        v1 *= i2
        v2 *= i2
        p1 = (u1 + v1) * ip
        p2 = (u2 + v2) * ip
        g1 = a1 - p1 - u1 * i1 - v1 * i2
        g2 = a2 - p2 - u2 * i1 - v2 * i2
        # -Hess log q; Hess l = (I - u u^T) / l, Hess log l = (I - 2 u u^T) / l^2
        iso = i1 * ip + i2 * ip + i1 * i1 + i2 * i2
        t1 = i1 * ip + 2.0 * i1 * i1
        t2 = i2 * ip + 2.0 * i2 * i2
        h11 = -a11 - p1 * p1 + iso - t1 * u1 * u1 - t2 * v1 * v1
        h12 = -a12 - p1 * p2 - t1 * u1 * u2 - t2 * v1 * v2
        h22 = -a22 - p2 * p2 + iso - t1 * u2 * u2 - t2 * v2 * v2
        pf = power * f
        total += f
        derivatives[0] -= pf * g1
        derivatives[1] -= pf * g2
        derivatives[2] += pf * (power * g1 * g1 + h11)
        derivatives[3] += pf * (power * g1 * g2 + h12)
        derivatives[4] += pf * (power * g2 * g2 + h22)
    return total


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
        nx, ny, nz = star_normal(sheet, stars, v)
        if on_a_line:
            e[0, 0], e[0, 1], e[0, 2] = line_direction(lines, sheet.points, lines.slot[v])
        else:
            if nx * nx + ny * ny + nz * nz == 0.0:
                continue
            e[0, 0], e[0, 1], e[0, 2] = axis_across(nx, ny, nz)
        e[1, 0] = ny * e[0, 2] - nz * e[0, 1]
        e[1, 1] = nz * e[0, 0] - nx * e[0, 2]
        e[1, 2] = nx * e[0, 1] - ny * e[0, 0]
        cost = star_cost(sheet.points, sheet.triangles, stars, v, power, e, derivatives)
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
