"""An edge that is too long gets a vertex at its middle, on the ground or on its track."""

from __future__ import annotations

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.closest import walk
from odt_plugins.engine.ground.sheet import LINE, SMOOTH
from odt_plugins.engine.retile.lines import chain_of, part_of
from odt_plugins.engine.retile.net import (
    Net,
    Room,
    Rules,
    edge_triangles,
    exchange,
    fits,
    put,
    relative_square,
    third,
)
from odt_plugins.engine.retile.tracks import on_track, track_is_near
from odt_plugins.mesh.arrays import IntArray


@kernel
def split_edges(net: Net, rules: Rules, pairs: IntArray, room: Room) -> int:
    """Split those of the edges ``pairs`` (k, 2) that are too long, in this order; how many were."""
    count = 0
    for k in range(pairs.shape[0]):
        a, b = pairs[k, 0], pairs[k, 1]
        if relative_square(net, a, b) > rules.longest**2 and _split(net, rules, a, b, room):
            count += 1
    return count


@kernel
def _split(net: Net, rules: Rules, a: int, b: int, room: Room) -> bool:
    """Split one edge, when a place for its vertex is found that keeps the rules."""
    tracks = rules.tracks
    old = edge_triangles(net, a, b, room)
    if old <= 0:
        return False
    chain = chain_of(net, a, b)
    if chain >= 0 and tracks.held[chain]:
        return False
    v = net.count[0]
    for r in range(old):
        t = room.exchange.old[r]
        far = third(net, t, a, b)
        for half in range(2):
            gone, stays = (b, a) if half == 0 else (a, b)
            row = 2 * r + half
            put(net, room, row, t, gone, v)
            for i in range(3):
                if net.triangles[t, i] == stays:
                    room.marks[row, i] = -1
            room.marks[row, far] = chain
    p = net.points
    foot = net.foot[a] if net.kind[a] == SMOOTH else net.foot[b]
    net.kind[v] = SMOOTH
    net.size[v] = 0.5 * (net.size[a] + net.size[b])
    for k in range(3, net.points.shape[1]):
        net.points[v, k] = 0.5 * (net.points[a, k] + net.points[b, k])
    for turn in range(2):
        x = 0.5 * (p[a, 0] + p[b, 0])
        y = 0.5 * (p[a, 1] + p[b, 1])
        z = 0.5 * (p[a, 2] + p[b, 2])
        if chain >= 0:
            first, last, low, high = part_of(net, tracks, chain, a, b)
            place = 0.5 * (low + high)
            gx, gy, gz, foot = on_track(tracks, chain, place)
        else:
            _, foot, gx, gy, gz = walk(x, y, z, foot, rules.ground, False)
        p[v, 0], p[v, 1], p[v, 2] = (gx, gy, gz) if turn == 0 else (x, y, z)
        net.foot[v] = foot
        if chain >= 0:
            off = (p[v, 0] - gx) ** 2 + (p[v, 1] - gy) ** 2 + (p[v, 2] - gz) ** 2
            if (
                off > tracks.reach[chain] ** 2
                or not track_is_near(tracks, chain, low, place, p, first, v)
                or not track_is_near(tracks, chain, place, high, p, v, last)
            ):
                continue
        number = fits(net, rules, room, v, old, 2 * old, old)
        if number < 0:
            continue
        net.count[0] += 1
        exchange(net, room, old, 2 * old, number)
        if chain >= 0:
            net.kind[v] = LINE
            net.place[v] = place
            net.after[v] = last
            if net.kind[first] == LINE:
                net.after[first] = v
        return True
    return False
