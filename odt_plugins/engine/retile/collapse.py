"""An edge that is too short becomes one vertex, where topology, features and the ground allow."""

from __future__ import annotations

from odt_plugins.engine.cells.triangle import triangle_in_space
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.closest import walk
from odt_plugins.engine.ground.replace import ROOM
from odt_plugins.engine.ground.sheet import LINE, LOCKED
from odt_plugins.engine.retile.lines import chain_of, mark_edge, neighbor_on, part_of
from odt_plugins.engine.retile.net import (
    Net,
    Room,
    Rules,
    exchange,
    fits,
    is_edge,
    put,
    relative_square,
    standing,
    third,
)
from odt_plugins.engine.retile.tracks import Tracks, on_track, track_is_near
from odt_plugins.mesh.arrays import IntArray

THIN = 0.4
"""Radius ratio below which a collapse makes no triangle worse than the worst it removes."""


@kernel
def collapse_edges(net: Net, rules: Rules, pairs: IntArray, room: Room) -> int:
    """Collapse those of the edges ``pairs`` (k, 2) that are too short, in this order; how many."""
    count = 0
    for k in range(pairs.shape[0]):
        a, b = pairs[k, 0], pairs[k, 1]
        if net.head[a] < 0 or net.head[b] < 0:
            continue
        if relative_square(net, a, b) < rules.shortest**2 and _collapse(net, rules, a, b, room):
            count += 1
    return count


@kernel
def _collapse(net: Net, rules: Rules, a: int, b: int, room: Room) -> bool:
    """Collapse one edge into its middle or one of its ends."""
    kind = net.kind
    if kind[b] > kind[a]:
        a, b = b, a
    if kind[b] == LOCKED or not is_edge(net, a, b):
        return False
    chain = chain_of(net, a, b)
    if kind[b] == LINE and (chain < 0 or rules.tracks.held[chain]):
        return False
    if not _link_condition(net, a, b, chain):
        return False
    if kind[a] == kind[b] and _try(net, rules, a, b, chain, True, room):
        return True
    if _try(net, rules, a, b, chain, False, room):
        return True
    return kind[a] == kind[b] and _try(net, rules, b, a, chain, False, room)


@kernel
def _link_condition(net: Net, a: int, b: int, chain: int) -> bool:
    """Whether the surface and the lines on it stay what they are when b becomes a.

    Every common neighbour is opposite to the edge, no common neighbours form an edge of which
    both have the triangle, and of two edges that become one at most one is on a line.
    """
    if chain >= 0:
        for v, w in ((a, b), (b, a)):
            if net.kind[v] != LINE:
                continue
            x = neighbor_on(net, chain, v, w)
            if x < 0 or chain_of(net, w, x) >= 0:
                return False
    corner = net.head[b]
    for _ in range(net.chained.shape[0]):
        if corner < 0:
            break
        t, i = corner // 3, corner % 3
        x, y = net.triangles[t, (i + 1) % 3], net.triangles[t, (i + 2) % 3]
        if x == a or y == a:
            far = y if x == a else x
            if chain_of(net, a, far) >= 0 and chain_of(net, b, far) >= 0:
                return False
        else:
            for far in (x, y):
                if is_edge(net, a, far) and not _is_triangle(net, a, b, far):
                    return False
            if is_edge(net, a, x) and is_edge(net, a, y) and _is_triangle(net, a, x, y):
                return False
        corner = net.chained[corner]
    return True


@kernel
def _is_triangle(net: Net, a: int, b: int, c: int) -> bool:
    """Whether three vertices are those of a triangle."""
    corner = net.head[a]
    for _ in range(net.chained.shape[0]):
        if corner < 0:
            break
        t = corner // 3
        i = third(net, t, a, b)
        if i >= 0 and net.triangles[t, i] == c:
            return True
        corner = net.chained[corner]
    return False


@kernel
def _try(
    net: Net, rules: Rules, a: int, b: int, chain: int, middle: bool, room: Room
) -> bool:
    """Let b become a, at the middle of both or where a is."""
    p, tracks = net.points, rules.tracks
    old = _leaving(net, a, b, middle, room)
    if old == 0:
        return False
    kept, before = (standing(net, rules, room, old), 0) if middle else (rules, old)
    ax, ay, az = p[a, 0], p[a, 1], p[a, 2]
    foot, place = net.foot[a], net.place[a]
    first = a
    if chain >= 0:
        first, _, low, high = part_of(net, tracks, chain, a, b)
    if middle and chain >= 0:
        net.place[a] = 0.5 * (low + high)
        x, y, z, face = on_track(tracks, chain, net.place[a])
        p[a, 0], p[a, 1], p[a, 2], net.foot[a] = x, y, z, face
    elif middle:
        _, face, x, y, z = walk(
            0.5 * (ax + p[b, 0]), 0.5 * (ay + p[b, 1]), 0.5 * (az + p[b, 2]), foot, rules.ground,
            False)
        p[a, 0], p[a, 1], p[a, 2], net.foot[a] = x, y, z, face
    ahead = neighbor_on(net, chain, b, a) if chain >= 0 else -1
    if chain < 0 or _line_fits(net, tracks, chain, a, ahead, first == a, middle, b):
        new = _coming(net, rules, a, b, old, room)
        number = fits(net, kept, room, a, old, new, before) if new > 0 else -1
        if number >= 0:
            _keep_marks(net, a, b, old, new, room)
            if chain >= 0 and first != a and net.kind[ahead] == LINE:
                net.after[ahead] = a
            elif chain >= 0 and first == a and net.kind[a] == LINE:
                net.after[a] = ahead
            exchange(net, room, old, new, number)
            return True
    p[a, 0], p[a, 1], p[a, 2] = ax, ay, az
    net.foot[a], net.place[a] = foot, place
    return False


@kernel
def _line_fits(
    net: Net, tracks: Tracks, chain: int, a: int, ahead: int, forward: bool, middle: bool, b: int
) -> bool:
    """Whether the edges of a along its track are close to it when b is gone.

    ``ahead`` is the neighbour of b on the other side, ``forward`` whether b follows a.
    """
    if not _part_near(net, tracks, chain, a, ahead, forward):
        return False
    return not middle or _part_near(
        net, tracks, chain, a, neighbor_on(net, chain, a, b), not forward)


@kernel
def _part_near(
    net: Net, tracks: Tracks, chain: int, a: int, b: int, forward: bool
) -> bool:
    """Whether an edge would be close to the part of a track between its ends."""
    first, last = (a, b) if forward else (b, a)
    low = net.place[first] if net.kind[first] == LINE else tracks.arc[tracks.start[chain]]
    high = net.place[last] if net.kind[last] == LINE else tracks.arc[tracks.stop[chain]]
    return track_is_near(tracks, chain, low, high, net.points, first, last)


@kernel
def _leaving(net: Net, a: int, b: int, middle: bool, room: Room) -> int:
    """Write the triangles that change into the room: how many, 0 where it has no space for them."""
    old = 0
    for turn in range(2 if middle else 1):
        corner = net.head[b if turn == 0 else a]
        for _ in range(net.chained.shape[0]):
            if corner < 0:
                break
            t = corner // 3
            corner = net.chained[corner]
            if turn == 1 and third(net, t, a, b) >= 0:
                continue
            if old == ROOM:
                return 0
            room.exchange.old[old] = t
            old += 1
    return old


@kernel
def _coming(net: Net, rules: Rules, a: int, b: int, old: int, room: Room) -> int:
    """Write what is to come into the room: how many, 0 where that is no better.

    Triangles of a that go are seen with a where it is to be.
    """
    new, before, after = 0, 1.0, 1.0
    for k in range(old):
        t = room.exchange.old[k]
        before = min(before, _shape(net, net.triangles[t]))
        if third(net, t, a, b) >= 0:
            continue
        put(net, room, new, t, b, a)
        for i in range(3):
            far = room.exchange.new[new, i]
            if far != a and relative_square(net, a, far) > rules.longest**2:
                return 0
        after = min(after, _shape(net, room.exchange.new[new]))
        new += 1
    return 0 if after < THIN and after < before else new


@kernel
def _shape(net: Net, cell: IntArray) -> float:
    """Radius ratio of a triangle."""
    return triangle_in_space(net.points, cell[0], cell[1], cell[2])[0]


@kernel
def _keep_marks(net: Net, a: int, b: int, old: int, new: int, room: Room) -> None:
    """Let edges of a that are to be one with edges of b on tracks be on these tracks."""
    ends = room.exchange
    for k in range(old):
        i = third(net, ends.old[k], a, b)
        if i < 0:
            continue
        far = net.triangles[ends.old[k], i]
        chain = max(chain_of(net, a, far), chain_of(net, b, far))
        if chain < 0:
            continue
        mark_edge(net, a, far, chain)
        for row in range(new):
            for j in range(3):
                v, w = ends.new[row, (j + 1) % 3], ends.new[row, (j + 2) % 3]
                if (v == a and w == far) or (v == far and w == a):
                    room.marks[row, j] = chain
