"""Passes of one operation over a net, each over what has changed since the last of its kind."""

from __future__ import annotations

from typing import Any

import numpy as np

from odt_plugins.engine.cells.content import cells_of_sizes
from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.ground.build import ground_values, resample_metric
from odt_plugins.engine.ground.sheet import SMOOTH
from odt_plugins.engine.record.figures import cell_shapes
from odt_plugins.engine.retile.collapse import THIN, collapse_edges
from odt_plugins.engine.retile.flip import swap_edges
from odt_plugins.engine.retile.grading import GROWTH
from odt_plugins.engine.retile.net import (
    THINNEST,
    Net,
    Rules,
    link_all,
    make_room,
    on_ground,
    relative_lengths,
)
from odt_plugins.engine.retile.shift import shift_vertices
from odt_plugins.engine.retile.split import split_edges
from odt_plugins.engine.topology.growth import grown_along
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray

LONGEST, SHORTEST = 4.0 / 3.0, 4.0 / 5.0
"""Multiples of its size at which an edge is split, and at which it collapses: halves of the one and
doubles of the other are nearer to the size."""

NEEDLES = 1e-4
"""Radius ratio below which triangles get other edges between two passes of splits."""

MANY, COARSER = 32.0, 0.5
"""Multiple of its size of a longest edge from which on splits in a metric have limits that fall,
and limit of a pass by that of the one before, or by the longest edge."""

MENDED = 2.0
"""Multiple of its size up to which an edge may be that comes instead of a thin triangle."""

RELENT = 1.5
"""Multiple of the harmonic mean of the edges at a vertex above which its size is not kept."""

PASSES = 24
"""Most passes of one operation in a round; a pass of splits halves the longest edges."""


class Passes:
    """Passes over what has changed since the last pass of the same kind."""

    def __init__(
        self, rules: Rules, sizes: FloatArray, metric: FloatArray, thin: float, most: float,
        given: float,
    ) -> None:
        self.rules, self.sizes, self.room = rules, sizes, make_room()
        self.most, self.given = most, given
        self.metric, self.thin = np.ascontiguousarray(metric.T), thin
        self.last: dict[object, int] = {}

    def _since(self, net: Net, kind: object) -> int:
        """The exchange before which nothing need be looked at."""
        last = self.last.get(kind, -1)
        self.last[kind] = int(net.count[2])
        return last

    def kept(self, net: Net) -> tuple[Net, dict[object, int]]:
        """A copy of a net, and what was looked at, for :meth:`back`."""
        copy = net._replace(**{name: np.copy(array) for name, array in net._asdict().items()})
        return copy, dict(self.last)

    def back(self, kept: tuple[Net, dict[object, int]]) -> Net:
        """The net of which a copy was kept."""
        net, self.last = kept
        return net

    def relent(self, net: Net, edges: IntArray) -> None:
        """Make sizes smaller where edges are much shorter, which collapse nowhere near their size.

        Lengths that vary from edge to edge make worse triangles than smaller ones.
        """
        pairs, ratio, _ = edges_of(net, -1)
        pairs, ratio = pairs[ratio > 0.0], ratio[ratio > 0.0]
        n = len(net.points)
        length = ratio * 0.5 * net.size[pairs].sum(axis=1)
        count = np.bincount(pairs.ravel(), minlength=n)
        inverse = np.bincount(pairs.ravel(), np.repeat(1.0 / length, 2), minlength=n)
        found = np.full(len(self.sizes), np.inf)
        on_ground(net, RELENT * count / np.where(count > 0, inverse, 1.0), found)
        self.give_way(net, edges, np.minimum(self.sizes, found))

    def give_way(self, net: Net, edges: IntArray, sizes: FloatArray) -> None:
        """Take sizes that are smaller somewhere, and grow as they may, if not too many come."""
        if not (sizes < self.sizes).any():
            return
        ground = self.rules.ground
        if not self.metric.size:
            sizes = grown_along(ground.points, edges, sizes, GROWTH)
            if cells_of_sizes(ground.points, ground.triangles, sizes) > self.given:
                return
        self.sizes = sizes
        self.measure(net)

    def split(self, net: Net, bounds: Extremes) -> Net:
        """Split edges, the longest first, until none is too long that keeps the bounds.

        In a metric edges many times too long come first, and what became short vanishes between
        the passes: halves of edges that need not be halved would become many more triangles.
        Otherwise edges of NEEDLES flip between the passes, or their halves would be ever thinner.
        """
        limit = np.inf if self.metric.size else LONGEST
        for _ in range(PASSES):
            if net.count[1] > self.most:
                break
            since = self._since(net, "split") if limit == LONGEST else -1
            pairs, ratio, degree = edges_of(net, since)
            longest = ratio.max(initial=0.0)
            limit = LONGEST if limit == np.inf and longest < MANY else max(
                LONGEST, COARSER * min(limit, longest))
            chosen = np.flatnonzero(ratio > limit)
            if len(chosen):
                # A half of a triangle has at least half its altitude.
                chosen = chosen[~at_thin(net, pairs[chosen], 2.0 * self.thin)]
            chosen = chosen[np.argsort(-ratio[chosen], kind="stable")]
            net = grown(net, len(chosen), 2 * int(degree[chosen].sum()))
            rules = self.rules._replace(bounds=bounds, longest=limit)
            done = split_edges(net, rules, pairs[chosen], self.room)
            self.measure(net)
            if limit > LONGEST:
                self.collapse(net)
                self.flip(net, 1.0)
                net = compact(net)
            elif not done:
                break
            if not self.metric.size and qualities(net)[1].min() < NEEDLES:
                self.flip(net, 1.0)
        return net

    def collapse(self, net: Net) -> None:
        """Collapse edges, the shortest first, until none that is too short may."""
        for _ in range(PASSES):
            pairs, ratio, _ = edges_of(net, self._since(net, "collapse"))
            chosen = np.flatnonzero(ratio < SHORTEST)
            chosen = chosen[np.argsort(ratio[chosen], kind="stable")]
            done = collapse_edges(net, self.rules, pairs[chosen], self.room)
            self.measure(net)
            if not done:
                break

    def mend(self, net: Net) -> None:
        """Collapse edges of thin triangles, the shortest first, if a vertex off all lines goes."""
        rules = self.rules._replace(shortest=np.inf, longest=MENDED)
        for _ in range(PASSES):
            pairs, ratio, _ = edges_of(net, self._since(net, "mend"))
            chosen = np.flatnonzero((net.kind[pairs] == SMOOTH).any(axis=1))
            chosen = chosen[of_thin(net, pairs[chosen])]
            chosen = chosen[np.argsort(ratio[chosen], kind="stable")]
            if not len(chosen) or not collapse_edges(net, rules, pairs[chosen], self.room):
                break
            self.measure(net)
            self.follow(net)

    def flip(self, net: Net, power: float) -> None:
        """Flip edges until few pay."""
        for _ in range(PASSES):
            pairs, _, _ = edges_of(net, self._since(net, ("flip", power)))
            if not swap_edges(net, self.rules, pairs, power, self.room):
                break

    def shift(self, net: Net, power: float) -> None:
        """Move vertices once."""
        since = self._since(net, ("shift", power))
        shift_vertices(net, self.rules, since, power, self.room)
        self.measure(net)

    def follow(self, net: Net) -> None:
        """Flip edges, and move vertices once whose stars other operations have changed."""
        self.flip(net, 1.0)
        self.shift(net, 0.0)
        self._since(net, ("shift", 0.0))

    def measure(self, net: Net) -> None:
        """Interpolate sizes and metric at the feet of all vertices, in place."""
        n = int(net.count[0])
        ground, points, foot = self.rules.ground, net.points[:n], net.foot[:n]
        ground_values(ground, self.sizes, points, foot, net.size[:n])
        resample_metric(ground, self.metric, points, foot)


def edges_of(net: Net, since: int) -> tuple[IntArray, FloatArray, IntArray]:
    """Edges (e, 2) with an end whose star has changed since an exchange.

    Also their lengths as parts of their sizes, and how many triangles they have.
    """
    triangles = net.triangles[: net.count[1]]
    used = triangles[:, 0] >= 0
    triangles = triangles[used & (net.stamp[triangles] > since).any(axis=1)]
    a, b = triangles[:, [1, 2, 0]].ravel(), triangles[:, [2, 0, 1]].ravel()
    key = np.minimum(a, b).astype(np.int64) * len(net.points) + np.maximum(a, b)
    key, degree = np.unique(key, return_counts=True)
    pairs = np.stack([key // len(net.points), key % len(net.points)], axis=1).astype(np.int32)
    fresh = (net.stamp[pairs] > since).any(axis=1)
    pairs, degree = pairs[fresh], degree[fresh]
    length = np.empty(len(pairs))
    relative_lengths(net, pairs, length)
    return pairs, length, degree.astype(np.int32)


def qualities(net: Net) -> tuple[IntArray, FloatArray]:
    """Triangles (m, 3) without free slots, and their radius ratios (m,)."""
    triangles = net.triangles[: net.count[1]]
    triangles = triangles[triangles[:, 0] >= 0]
    return triangles, cell_shapes(np.ascontiguousarray(net.points[:, :3]), triangles)[:, 0]


def of_thin(net: Net, pairs: IntArray) -> BoolArray:
    """Mark the edges (k, 2), sorted, of triangles whose radius ratio is below THIN."""
    triangles, quality = qualities(net)
    return _edges_among(net, pairs, triangles[quality < THIN])


def at_thin(net: Net, pairs: IntArray, least: float) -> BoolArray:
    """Mark the edges (k, 2), sorted, of triangles whose altitude is below a length or THINNEST."""
    ends = np.zeros(len(net.points), dtype=np.bool_)
    ends[pairs] = True
    triangles = net.triangles[: net.count[1]]
    triangles = triangles[(triangles[:, 0] >= 0) & (ends[triangles].sum(axis=1) > 1)]
    corners = net.points[triangles.T, :3].transpose(2, 0, 1)
    edges = corners - corners[:, [1, 2, 0]]
    u, v = edges[:, 0], edges[:, 1]
    area = ((u[[1, 2, 0]] * v[[2, 0, 1]] - u[[2, 0, 1]] * v[[1, 2, 0]]) ** 2).sum(axis=0)
    longest = (edges**2).sum(axis=0).max(axis=0)
    return _edges_among(
        net, pairs, triangles[area < np.maximum(least**2, THINNEST**2 * longest) * longest])


def _edges_among(net: Net, pairs: IntArray, triangles: IntArray) -> BoolArray:
    """Mark the edges (k, 2), sorted, of some triangles."""
    thin = np.sort(triangles, axis=1)
    key = [a.astype(np.int64) * len(net.points) + b
           for a, b in (thin[:, [0, 1]].T, thin[:, [0, 2]].T, thin[:, [1, 2]].T, pairs.T)]
    return np.isin(key[3], np.concatenate(key[:3]))


def grown(net: Net, vertices: int, triangles: int) -> Net:
    """The net with room for so many more."""
    n, m = int(net.count[0]) + vertices, int(net.count[1]) + triangles
    if n <= len(net.points) and m <= len(net.triangles):
        return net
    n, m = max(n, int(1.2 * len(net.points))), max(m, int(1.2 * len(net.triangles)))

    def more(array: Any, rows: int) -> Any:
        shape = (rows - len(array), *array.shape[1:])
        return np.concatenate([array, np.full(shape, -1, dtype=array.dtype)])

    by_vertex: dict[str, Any] = {name: more(getattr(net, name), n)
                 for name in ("points", "foot", "place", "after", "size", "head", "stamp")}
    by_triangle: dict[str, Any] = {name: more(getattr(net, name), m)
                   for name in ("triangles", "marks", "labels", "first")}
    kind = np.concatenate([net.kind, np.zeros(n - len(net.kind), dtype=np.uint8)])
    return net._replace(kind=kind, chained=more(net.chained, 3 * m), **by_vertex, **by_triangle)


def compact(net: Net) -> Net:
    """The net without free slots among its triangles."""
    used = np.flatnonzero(net.triangles[: net.count[1], 0] >= 0)
    k = len(used)
    for array in (net.triangles, net.marks, net.labels, net.first):
        array[:k] = array[used]
    net.count[1] = k
    link_all(net)
    return net
