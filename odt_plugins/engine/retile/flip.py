"""An edge of two triangles gives way to the other diagonal where F_p = sum of q^-p falls."""

from __future__ import annotations

from odt_plugins.engine.cells.triangle import triangle_in_space
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.retile.net import (
    Net,
    Room,
    Rules,
    edge_triangles,
    exchange,
    fits,
    is_edge,
    third,
)
from odt_plugins.mesh.arrays import FloatArray, IntArray

LEAST = 1e-6
"""Radius ratio that worse ones count as."""

GAIN = 1e-6
"""Part by which F_p must fall."""


@kernel
def swap_edges(net: Net, rules: Rules, pairs: IntArray, power: float, room: Room) -> int:
    """Flip those of the edges ``pairs`` (k, 2) where q_1^-p + q_2^-p falls; how many were."""
    count = 0
    for k in range(pairs.shape[0]):
        if _flip(net, rules, pairs[k, 0], pairs[k, 1], power, room):
            count += 1
    return count


@kernel
def _flip(net: Net, rules: Rules, b: int, c: int, power: float, room: Room) -> bool:
    """Flip one edge, if that pays and keeps the rules."""
    if edge_triangles(net, b, c, room) != 2:
        return False
    t, s = room.exchange.old[0], room.exchange.old[1]
    i, j = third(net, t, b, c), third(net, s, b, c)
    if net.marks[t, i] >= 0:
        return False
    cells, marks = net.triangles, net.marks
    a, d = cells[t, i], cells[s, j]
    b, c = cells[t, (i + 1) % 3], cells[t, (i + 2) % 3]
    if cells[s, (j + 1) % 3] != c:
        return False
    p = net.points
    now = _cost(p, a, b, c, power) + _cost(p, d, c, b, power)
    then = _cost(p, a, b, d, power) + _cost(p, a, d, c, power)
    if not then < (1.0 - GAIN) * now or is_edge(net, a, d):
        return False
    new = room.exchange.new
    new[0, 0], new[0, 1], new[0, 2] = a, b, d
    new[1, 0], new[1, 1], new[1, 2] = a, d, c
    room.marks[0, 0], room.marks[0, 1] = marks[s, (j + 1) % 3], -1
    room.marks[0, 2] = marks[t, (i + 2) % 3]
    room.marks[1, 0], room.marks[1, 1] = marks[s, (j + 2) % 3], marks[t, (i + 1) % 3]
    room.marks[1, 2] = -1
    room.labels[0], room.labels[1] = net.labels[t], net.labels[s]
    number = fits(net, rules, room, a, 2, 2, 2)
    if number < 0:
        return False
    exchange(net, room, 2, 2, number)
    return True


@kernel
def _cost(p: FloatArray, a: int, b: int, c: int, power: float) -> float:
    """q^-p of a triangle, with q at least LEAST."""
    return max(triangle_in_space(p, a, b, c)[0], LEAST) ** -power
