"""Newton smoothing of one vertex at a time for F_p, the sum of its star's costs, d = 3.

With only one vertex x moving, det is linear in x, the products of opposite edges are quadratic
and the Hessian of a face area is rank one, so gradient and Hessian of log q are exact and cheap.
"""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Extremes, keeps, worse
from odt_plugins.engine.cells.measures import Room, make_room, moved_state, star_state, star_terms
from odt_plugins.engine.cells.metric import add_seen_terms, has_metric, inverse_root, through
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.topology.star import Stars
from odt_plugins.mesh.arrays import FloatArray, IntArray

HALVINGS = 7
"""Step lengths alpha = 1, 1/2, 1/4, ... tried for one vertex."""

ROUNDING = 1e-12
"""By so much is 1 - cos^2 of an angle uncertain at most."""


@kernel
def _newton_direction(out: FloatArray) -> tuple[bool, float, float, float]:
    """Solve (H + s I) d = -g with the least shift s of a short ladder that makes it SPD."""
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
                    dz = y2 / d2
                    dy = y1 / d1 - l21 * dz
                    return True, y0 / a - l10 * dy - l20 * dz, dy, dz
        shift = 0.01 * trace if shift == 0.0 else 2.5 * shift
    return False, 0.0, 0.0, 0.0


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
    cost: Cost, limit: Extremes, room: Room,
) -> float:
    """One guarded Newton step on F_p for vertex v with the star indices[start:stop], in place.

    Returns the cost before minus the cost after, 0 when the vertex stays; room.star[0] is the cost
    before.
    """
    out = room.star
    x = points[v, 0]
    y = points[v, 1]
    z = points[v, 2]
    if not star_terms(points, cells, indices, start, stop, v, cost, room):
        return 0.0
    if has_metric(points):
        # orthonormal directions are those that the vertex sees so: y = S x
        inverse = inverse_root(points, v)
        room.seen[:] = 0.0
        add_seen_terms(out, inverse, room.seen)
        found, dx, dy, dz = _newton_direction(room.seen)
        dx, dy, dz = through(inverse, dx, dy, dz)
    else:
        found, dx, dy, dz = _newton_direction(out)
    if not found:
        return 0.0
    slope = out[1] * dx + out[2] * dy + out[3] * dz
    if -slope < 1e-9 * out[0]:
        return 0.0
    sure = sure_quality(limit)
    alpha = 1.0
    for _ in range(HALVINGS):
        points[v, 0] = x + alpha * dx
        points[v, 1] = y + alpha * dy
        points[v, 2] = z + alpha * dz
        most = out[0] + 1e-4 * alpha * slope
        after, there = moved_state(
            points, cells, indices, start, stop, v, cost, most, sure, room.rows
        )
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
    room = make_room()
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
