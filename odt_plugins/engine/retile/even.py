"""Every line gets as many edges as the integral of 1 / h along it, of like length in h."""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.ground.build import ground_values
from odt_plugins.engine.ground.sheet import LINE
from odt_plugins.engine.retile.collapse import collapse_edges
from odt_plugins.engine.retile.grading import LEAST
from odt_plugins.engine.retile.net import Net, relative_lengths
from odt_plugins.engine.retile.passes import Passes, at_thin, grown
from odt_plugins.engine.retile.shift import slide_vertices
from odt_plugins.engine.retile.split import split_edges
from odt_plugins.engine.retile.tracks import Tracks
from odt_plugins.mesh.arrays import FloatArray, IntArray, LongArray

UNLIKE = 1e-3
"""Part of the area of a region by which lines may change it."""

RELENT, NEAR = 1.4, 3
"""Multiple of the mean of edges of a line above which sizes there are not kept, and how many of
them count on both sides."""

TURNS = 8
"""Most passes of splits and collapses."""

SWEEPS = 12
"""Moves of all vertices towards their goals."""


def even_lines(net: Net, passes: Passes) -> Net:
    """Give every line that is not held the integral of 1 / h along it, rounded, of like edges.

    What the envelope forbids stays; all of it, if the area of a region would change by more than
    UNLIKE.
    """
    tracks = passes.rules.tracks
    if not len(tracks.start):
        return net
    total = np.diff(_counted(tracks, passes)[[tracks.start, tracks.stop]], axis=0)[0]
    wanted = np.maximum(np.rint(total), 1).astype(np.int64)
    if net.count[1] + 2 * wanted.sum() > passes.most:
        return net
    before = passes.kept(net)
    areas = _areas(net)
    for _ in range(TURNS):
        pairs, chain, ratio = _line_edges(net)
        lacking = np.where(tracks.held, 0, wanted - np.bincount(chain, minlength=len(wanted)))
        done = 0
        for sign, change in ((1, _split), (-1, _collapse)):
            order = np.lexsort((-sign * ratio, chain))
            rank = np.arange(len(order)) - np.searchsorted(chain[order], chain[order])
            chosen = order[rank < sign * lacking[chain[order]]]
            net, count = change(net, passes, pairs[chosen])
            done += count
        if not done:
            break
        passes.measure(net)
        passes.follow(net)
    goals = _goals(net, passes)
    for _ in range(SWEEPS):
        if not slide_vertices(net, passes.rules, goals, passes.room):
            break
        passes.follow(net)
    passes.measure(net)
    if (np.abs(_areas(net) - areas) > UNLIKE * areas).any():
        return passes.back(before)
    return net


def relent_along(net: Net, passes: Passes, nodes: IntArray, edges: IntArray) -> None:
    """Make sizes smaller where edges of lines are much shorter, as the envelope asks them to be.

    Parameters
    ----------
    net : Net
    passes : Passes            their sizes change
    nodes : (k,) int32         vertices of the ground that those of the tracks are
    edges : (e, 2) int32       of the ground
    """
    tracks, n = passes.rules.tracks, int(net.count[0])
    places = np.sort(net.place[:n][(net.kind[:n] == LINE) & (net.head[:n] >= 0)])
    sizes = passes.sizes.copy()
    for first, last, held in zip(tracks.start, tracks.stop, tracks.held, strict=True):
        arc, at = tracks.arc[first : last + 1], nodes[first : last + 1]
        if held or not arc[-1] - arc[0] > LEAST * passes.sizes[at].max():
            continue
        inside = places[np.searchsorted(places, arc[0], side="right")
                        : np.searchsorted(places, arc[-1])]
        knots = np.concatenate([arc[:1], inside, arc[-1:]])
        near = np.searchsorted(knots, arc, side="right")
        low = np.maximum(near - NEAR, 0)
        high = np.minimum(near + NEAR - 1, len(knots) - 1)
        mean = (knots[high] - knots[low]) / (high - low)
        sizes[at] = np.minimum(sizes[at], np.maximum(RELENT * mean, LEAST * passes.sizes[at]))
    passes.give_way(net, edges, sizes)


def _areas(net: Net) -> FloatArray:
    """Area of every label of a net."""
    triangles, labels = net.triangles[: net.count[1]], net.labels[: net.count[1]]
    used = triangles[:, 0] >= 0
    a, b, c = (net.points[triangles[used, i], :3] for i in range(3))
    twice = np.sqrt((np.cross(b - a, c - a) ** 2).sum(axis=1))
    _, number = np.unique(labels[used], return_inverse=True)
    return np.asarray(np.bincount(number.ravel(), 0.5 * twice))


def _split(net: Net, passes: Passes, pairs: IntArray) -> tuple[Net, int]:
    """Split edges of lines, however short, but none of a thin triangle."""
    if len(pairs):
        pairs = pairs[~at_thin(net, pairs, 2.0 * passes.thin)]
    net = grown(net, len(pairs), 4 * len(pairs))
    return net, split_edges(net, passes.rules._replace(longest=0.0), pairs, passes.room)


def _collapse(net: Net, passes: Passes, pairs: IntArray) -> tuple[Net, int]:
    """Collapse edges of lines, however long."""
    rules = passes.rules._replace(longest=math.inf, shortest=math.inf)
    return net, collapse_edges(net, rules, pairs, passes.room)


def _counted(tracks: Tracks, passes: Passes) -> FloatArray:
    """Integral (k,) of 1 / h along the tracks up to each of their vertices."""
    size = np.empty(len(tracks.arc))
    face = tracks.face.copy()
    face[tracks.stop] = face[tracks.stop - 1]
    ground_values(passes.rules.ground, passes.sizes, tracks.points, face, size)
    density = 0.5 * (1.0 / size[1:] + 1.0 / size[:-1]) * np.diff(tracks.arc)
    return np.concatenate([[0.0], np.cumsum(density)])


def _line_edges(net: Net) -> tuple[IntArray, LongArray, FloatArray]:
    """Edges (e, 2) on tracks, their tracks, and their lengths as parts of their sizes."""
    triangles, marks = net.triangles[: net.count[1]], net.marks[: net.count[1]]
    row, corner = np.nonzero((marks >= 0) & (triangles[:, :1] >= 0))
    ends = np.sort(triangles[row[:, None], (corner[:, None] + [1, 2]) % 3], axis=1)
    pairs, first = np.unique(ends, axis=0, return_index=True)
    pairs = np.ascontiguousarray(pairs, dtype=np.int32)
    ratio = np.empty(len(pairs))
    relative_lengths(net, pairs, ratio)
    return pairs, marks[row, corner][first].astype(np.int64), ratio


def _goals(net: Net, passes: Passes) -> FloatArray:
    """Place that each vertex (n,) is to have on its track, nan for those on none."""
    tracks = passes.rules.tracks
    counted = _counted(tracks, passes)
    n = int(net.count[0])
    goals = np.full(n, np.nan)
    on = np.flatnonzero((net.kind[:n] == LINE) & (net.head[:n] >= 0))
    on = on[np.argsort(net.place[on], kind="stable")]
    chain = np.searchsorted(tracks.arc[tracks.start], net.place[on], side="right") - 1
    there = np.bincount(chain, minlength=len(tracks.start))
    rank = np.arange(len(on)) - (np.cumsum(there) - there)[chain] + 1
    low, high = counted[tracks.start[chain]], counted[tracks.stop[chain]]
    goals[on] = np.interp(low + (high - low) * rank / (there[chain] + 1), counted, tracks.arc)
    goals[on[tracks.held[chain]]] = np.nan
    return goals
