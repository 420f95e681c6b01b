"""A vertex moves to the mean barycentre of its star, weighted by sizes, and back to the ground.

Triangles weigh area times rho, rho = h^-4 (4.20): then neighbours share the error alike. In a
metric M they weigh W, area times M: then the pulls of triangles that have their lengths balance,
whether lengths along one axis grow or all. On a track a vertex moves to where both its edges are as
long, measured by their sizes.
"""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.measures import QUALITY
from odt_plugins.engine.cells.metric import (
    has_metric,
    product,
    solved,
    through,
    triangle_root,
    vertex_root,
)
from odt_plugins.engine.cells.triangle import offset, triangle_in_space
from odt_plugins.engine.compiled.kernel import apart_kernel, kernel
from odt_plugins.engine.ground.closest import walk
from odt_plugins.engine.ground.replace import ROOM
from odt_plugins.engine.ground.sheet import LINE, LOCKED
from odt_plugins.engine.moves.newton2d import newton_step_2d
from odt_plugins.engine.moves.tangent import axis_across, set_axes, star_normal
from odt_plugins.engine.retile.lines import chain_of, neighbor_on
from odt_plugins.engine.retile.net import (
    Net,
    Room,
    Rules,
    exchange,
    fits,
    put,
    relative_square,
    standing,
)
from odt_plugins.engine.retile.tracks import on_track, track_is_near
from odt_plugins.mesh.arrays import FloatArray

FINE = 0.5
"""Radius ratio below which a move makes no star worse."""

LITTLE = 0.01
"""Part of its size below which a vertex does not move."""

DECREASE = 1e-3
"""Part by which F_p of a star must be expected to fall for a vertex to move."""

ARMIJO = 0.1
"""Part of the decrease that the slope predicts which a step must reach."""

APART = 0.05
"""Part of the way between its neighbours on a track that a vertex keeps from each."""

HALVINGS = 3
"""How often a step is made shorter."""


@kernel
def shift_vertices(net: Net, rules: Rules, since: int, power: float, room: Room) -> int:
    """Move the vertices whose star has changed, in order; how many moved.

    Parameters
    ----------
    since : int      the last exchange that does not count
    power : float    0.0 for the mean barycentre; else p of F_p, the sum of q^-p, which a Newton
                     step is to lower
    """
    count = 0
    for v in range(net.count[0]):
        if net.head[v] < 0 or net.stamp[v] <= since or net.kind[v] == LOCKED:
            continue
        if net.kind[v] == LINE:
            count += _slide(net, rules, v, power, np.nan, room)
        elif power > 0.0:
            count += _polish(net, rules, v, power, room)
        else:
            count += _shift(net, rules, v, room)
    return count


@kernel
def slide_vertices(net: Net, rules: Rules, goals: FloatArray, room: Room) -> int:
    """Move vertices along their tracks to goals (n,), nan for those that stay; how many moved."""
    count = 0
    for v in range(goals.shape[0]):
        if goals[v] == goals[v] and _slide(net, rules, v, 0.0, goals[v], room):
            count += 1
    return count


@kernel
def _star(net: Net, v: int, room: Room) -> tuple[int, float]:
    """Write the star of a vertex into the room, to be replaced by itself; its worst shape."""
    count = 0
    worst = 1.0
    corner = net.head[v]
    for _ in range(net.chained.shape[0]):
        if corner < 0:
            break
        t = corner // 3
        corner = net.chained[corner]
        if count == ROOM:
            return 0, 0.0
        room.exchange.old[count] = t
        put(net, room, count, t, v, v)
        count += 1
        c = net.triangles[t]
        worst = min(worst, triangle_in_space(net.points, c[0], c[1], c[2])[0])
    return count, worst


@kernel
def _worst(net: Net, count: int, room: Room) -> float:
    """Least radius ratio of the triangles in the room."""
    worst = 1.0
    for i in range(count):
        c = room.exchange.new[i]
        worst = min(worst, triangle_in_space(net.points, c[0], c[1], c[2])[0])
    return worst


@kernel
def _moved(
    net: Net, rules: Rules, v: int, count: int, power: float, before: float, room: Room
) -> bool:
    """Let the star of a vertex that has moved be what it is now, if the rules allow.

    ``before`` is what F_p must stay below, without a power the least radius ratio that is left.
    """
    if power > 0.0:
        if not _cost(net, count, power, room) < before:
            return False
    elif _worst(net, count, room) < before:
        return False
    number = fits(net, rules, room, v, count, count, 0)
    if number >= 0:
        exchange(net, room, count, count, number)
    return number >= 0


@kernel
def _cost(net: Net, count: int, power: float, room: Room) -> float:
    """F_p of the triangles in the room."""
    total = 0.0
    for i in range(count):
        c = room.exchange.new[i]
        q = triangle_in_space(net.points, c[0], c[1], c[2])[0]
        total += q**-power if q > 0.0 else math.inf
    return total


@kernel
def _polish(net: Net, rules: Rules, v: int, power: float, room: Room) -> bool:
    """One Newton step on F_p in the tangent plane."""
    count, _ = _star(net, v, room)
    p, e, d, new = net.points, room.axes, room.derivatives, room.exchange.new
    star = room.rows[:count]
    nx, ny, nz = star_normal(p, new, star)
    if nx * nx + ny * ny + nz * nz == 0.0:
        return False
    set_axes(nx, ny, nz, e)
    cost, slope, dx, dy, dz = newton_step_2d(
        p, new, star, v, Cost(QUALITY, power), e, False, d)
    if not -slope > DECREASE * cost:
        return False
    x, y, z, foot = p[v, 0], p[v, 1], p[v, 2], net.foot[v]
    step, kept = 1.0, standing(net, rules, room, count)
    for _ in range(HALVINGS):
        _, face, gx, gy, gz = walk(
            x + step * dx, y + step * dy, z + step * dz, foot, rules.ground, False)
        p[v, 0], p[v, 1], p[v, 2], net.foot[v] = gx, gy, gz, face
        if _moved(net, kept, v, count, power, cost + ARMIJO * step * slope, room):
            return True
        step *= 0.5
    p[v, 0], p[v, 1], p[v, 2], net.foot[v] = x, y, z, foot
    return False


@kernel
def _shift(net: Net, rules: Rules, v: int, room: Room) -> bool:
    """Move a vertex on the ground."""
    count, before = _star(net, v, room)
    p = net.points
    x, y, z = p[v, 0], p[v, 1], p[v, 2]
    dx = dy = dz = weight = 0.0
    for i in range(count):
        c = room.exchange.new[i]
        _, _, _, nx, ny, nz = triangle_in_space(p, c[0], c[1], c[2])
        share = 0.0
        for k in range(3):
            h = net.size[c[k]]
            share += 1.0 / (h * h * h * h)
        area = math.sqrt(nx * nx + ny * ny + nz * nz)
        share *= area
        weight += share
        dx += share * ((p[c[0], 0] + p[c[1], 0] + p[c[2], 0]) / 3.0 - x)
        dy += share * ((p[c[0], 1] + p[c[1], 1] + p[c[2], 1]) / 3.0 - y)
        dz += share * ((p[c[0], 2] + p[c[1], 2] + p[c[2], 2]) / 3.0 - z)
    if has_metric(p):
        weight, dx, dy, dz = _pulled(net, v, count, room)
    if not weight > 0.0:
        return False
    foot = net.foot[v]
    step = 1.0 / weight
    if _seen_step(net, v, dx, dy, dz) < (LITTLE * net.size[v] * weight) ** 2:
        return False
    kept = standing(net, rules, room, count)
    for _ in range(HALVINGS):
        _, face, gx, gy, gz = walk(
            x + step * dx, y + step * dy, z + step * dz, foot, rules.ground, False)
        p[v, 0], p[v, 1], p[v, 2], net.foot[v] = gx, gy, gz, face
        if _moved(net, kept, v, count, 0.0, min(before, FINE), room):
            return True
        step *= 0.5
    p[v, 0], p[v, 1], p[v, 2], net.foot[v] = x, y, z, foot
    return False


@apart_kernel
def _pulled(net: Net, v: int, count: int, room: Room) -> tuple[float, float, float, float]:
    """Weight and pull of a star in a metric: 1 and (sum W)^-1 sum W (b - x), or 0."""
    p = net.points
    xx = xy = xz = yy = yz = zz = dx = dy = dz = 0.0
    for i in range(count):
        c = room.exchange.new[i]
        root = triangle_root(p, c[0], c[1], c[2])
        root = product(root, root)
        ux, uy, uz = offset(p, c[0], c[1])
        vx, vy, vz = offset(p, c[0], c[2])
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        share = math.sqrt(nx * nx + ny * ny + nz * nz)
        x, y, z = through(
            root, (p[c[0], 0] + p[c[1], 0] + p[c[2], 0]) / 3.0 - p[v, 0],
            (p[c[0], 1] + p[c[1], 1] + p[c[2], 1]) / 3.0 - p[v, 1],
            (p[c[0], 2] + p[c[1], 2] + p[c[2], 2]) / 3.0 - p[v, 2])
        dx, dy, dz = dx + share * x, dy + share * y, dz + share * z
        a, b, e, d, f, g = root
        xx, xy, xz = xx + share * a, xy + share * b, xz + share * e
        yy, yz, zz = yy + share * d, yz + share * f, zz + share * g
    if not xx > 0.0:
        return 0.0, 0.0, 0.0, 0.0
    dx, dy, dz = solved((xx, xy, xz, yy, yz, zz), dx, dy, dz)
    return 1.0, dx, dy, dz


@kernel
def _seen_step(net: Net, v: int, x: float, y: float, z: float) -> float:
    """Squared length of a step of a vertex, as it is seen."""
    if has_metric(net.points):
        x, y, z = through(vertex_root(net.points, v), x, y, z)
    return x * x + y * y + z * z


@kernel
def _size_along(net: Net, v: int, w: int) -> float:
    """Twice the size along the edge vw: the length, as that of the coordinates, of a good edge."""
    if not has_metric(net.points):
        return net.size[v] + net.size[w]
    seen = relative_square(net, v, w)
    x, y, z = offset(net.points, v, w)
    return 2.0 * math.sqrt((x * x + y * y + z * z) / seen) if seen > 0.0 else 0.0


@kernel
def _slide(net: Net, rules: Rules, v: int, power: float, goal: float, room: Room) -> bool:
    """Move a vertex along its track, to a goal if there is one, else as :func:`shift_vertices`."""
    tracks, p = rules.tracks, net.points
    last = net.after[v]
    chain = chain_of(net, v, last)
    first = neighbor_on(net, chain, v, last)
    if chain < 0 or first < 0 or tracks.held[chain]:
        return False
    low = net.place[first] if net.kind[first] == LINE else tracks.arc[tracks.start[chain]]
    high = net.place[last] if net.kind[last] == LINE else tracks.arc[tracks.stop[chain]]
    count, before = _star(net, v, room)
    x, y, z, foot, place = p[v, 0], p[v, 1], p[v, 2], net.foot[v], net.place[v]
    left, right = _size_along(net, first, v), _size_along(net, v, last)
    if not count or not left + right > 0.0:
        return False
    target = low + (high - low) * left / (left + right)
    if goal == goal:
        target = goal
    elif power > 0.0:
        target = place + _along(net, v, first, last, count, power, room)
    target = min(max(target, low + APART * (high - low)), high - APART * (high - low))
    if power > 0.0:
        before = (1.0 - DECREASE) * _cost(net, count, power, room)
    else:
        before = min(before, FINE)
    if not abs(target - place) > LITTLE * (
            0.25 * (left + right) if has_metric(p) else net.size[v]):
        return False
    step, kept = 1.0, standing(net, rules, room, count)
    for _ in range(HALVINGS):
        net.place[v] = place + step * (target - place)
        gx, gy, gz, face = on_track(tracks, chain, net.place[v])
        p[v, 0], p[v, 1], p[v, 2], net.foot[v] = gx, gy, gz, face
        if (
            track_is_near(tracks, chain, low, net.place[v], p, first, v)
            and track_is_near(tracks, chain, net.place[v], high, p, v, last)
            and _moved(net, kept, v, count, power, before, room)
        ):
            return True
        step *= 0.5
    p[v, 0], p[v, 1], p[v, 2], net.foot[v], net.place[v] = x, y, z, foot, place
    return False


@kernel
def _along(
    net: Net, v: int, first: int, last: int, count: int, power: float, room: Room
) -> float:
    """Length of a Newton step on F_p along the chord of a vertex on a track."""
    p, e, d, new = net.points, room.axes, room.derivatives, room.exchange.new
    x, y, z = offset(p, first, last)
    length = math.sqrt(x * x + y * y + z * z)
    if not length > 0.0:
        return 0.0
    e[0, 0], e[0, 1], e[0, 2] = x / length, y / length, z / length
    e[1, 0], e[1, 1], e[1, 2] = axis_across(e[0, 0], e[0, 1], e[0, 2])
    _, _, dx, dy, dz = newton_step_2d(
        p, new, room.rows[:count], v, Cost(QUALITY, power), e, True, d)
    return (dx * x + dy * y + dz * z) / length
