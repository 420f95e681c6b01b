"""Edges of the sheet that lie on tracks: which part of one they stand for, and their neighbours."""

from __future__ import annotations

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.sheet import LINE
from odt_plugins.engine.retile.net import Net, third
from odt_plugins.engine.retile.tracks import Tracks


@kernel
def chain_of(net: Net, a: int, b: int) -> int:
    """Track on which an edge lies, -1 for none."""
    corner = net.head[a]
    for _ in range(net.chained.shape[0]):
        if corner < 0:
            break
        t = corner // 3
        i = third(net, t, a, b)
        if i >= 0:
            return int(net.marks[t, i])
        corner = net.chained[corner]
    return -1


@kernel
def part_of(
    net: Net, tracks: Tracks, chain: int, a: int, b: int
) -> tuple[int, int, float, float]:
    """Ends of an edge in the order of its track, and their places."""
    line_a, line_b = net.kind[a] == LINE, net.kind[b] == LINE
    if line_a and net.after[a] == b:
        first, last = a, b
    elif line_b and net.after[b] == a:
        first, last = b, a
    elif line_b or (not line_a and _starts_at(net, tracks, chain, a)):
        first, last = a, b
    else:
        first, last = b, a
    low, high = tracks.arc[tracks.start[chain]], tracks.arc[tracks.stop[chain]]
    if net.kind[first] == LINE:
        low = net.place[first]
    if net.kind[last] == LINE:
        high = net.place[last]
    return first, last, low, high


@kernel
def _starts_at(net: Net, tracks: Tracks, chain: int, v: int) -> bool:
    """Whether a track starts at a locked vertex, which is where it was."""
    k = tracks.start[chain]
    return bool(
        net.points[v, 0] == tracks.points[k, 0] and net.points[v, 1] == tracks.points[k, 1]
        and net.points[v, 2] == tracks.points[k, 2]
    )


@kernel
def neighbor_on(net: Net, chain: int, v: int, other: int) -> int:
    """The neighbour of a LINE vertex along its track that is not ``other``; -1 when there is none.

    With -1 for ``other`` any of both.
    """
    corner = net.head[v]
    for _ in range(net.chained.shape[0]):
        if corner < 0:
            break
        t, i = corner // 3, corner % 3
        for k in range(1, 3):
            w = net.triangles[t, (i + 3 - k) % 3]
            if net.marks[t, (i + k) % 3] == chain and w != other:
                return int(w)
        corner = net.chained[corner]
    return -1


@kernel
def mark_edge(net: Net, a: int, b: int, chain: int) -> None:
    """Say on which track an edge lies."""
    corner = net.head[a]
    for _ in range(net.chained.shape[0]):
        if corner < 0:
            break
        t = corner // 3
        i = third(net, t, a, b)
        if i >= 0:
            net.marks[t, i] = chain
        corner = net.chained[corner]
