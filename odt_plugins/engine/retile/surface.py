"""Rounds of splits, collapses, flips and moves that bring a surface to sizes on its ground."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.extremes import FREELY, Extremes
from odt_plugins.engine.ground.build import make_ground, make_sheet
from odt_plugins.engine.ground.features import Features, find_features
from odt_plugins.engine.ground.feet import reaching
from odt_plugins.engine.ground.sheet import LINE
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.retile.areas import heights
from odt_plugins.engine.retile.even import relent_along
from odt_plugins.engine.retile.grading import fitted
from odt_plugins.engine.retile.net import FOLD, Net, Rules, link_all
from odt_plugins.engine.retile.passes import LONGEST, SHORTEST, Passes, compact
from odt_plugins.engine.retile.polish import polish
from odt_plugins.engine.retile.rows import lay_in_rows
from odt_plugins.engine.retile.tracks import Tracks
from odt_plugins.engine.topology.star import vertex_stars
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.components import components
from odt_plugins.mesh.surface import Edges

ROUNDS = 4
"""Rounds of splits, collapses, flips and moves; at the end of the first, vertices are laid out in
rows."""

MOVES, MOVES_SEEN = 1, 3
"""Flips and moves of all vertices in a round, and in one in a metric, which lays out no rows."""

FINISH = ((2.0, 3), (8.0, 3))
"""Powers p and sweeps of flips and Newton steps on F_p, in which vertices on lines take part."""


class Base(NamedTuple):
    """A surface that is to be resized, in inner numbering and coordinates.

    Attributes
    ----------
    points : (n, 3) float64, triangles : (m, 3) int32, labels : (m,) int32
    edges : Edges
    fixed : (n,) bool      vertices that stay
    kept : (e,) bool       edges that are feature edges whatever their angle
    held : (e,) bool       edges that stay as they are
    metric : (n, 6) float64 of the metric at the vertices; (n, 0) without one
    thin : float           altitude below which splits make no triangle
    """

    points: FloatArray
    triangles: IntArray
    labels: IntArray
    edges: Edges
    fixed: BoolArray
    kept: BoolArray
    held: BoolArray
    metric: FloatArray
    thin: float


def resize(
    base: Base, sizes: FloatArray, reach: FloatArray, bounds: Extremes, *, feature_angle: float,
    most: float = math.inf, tick: Callable[[float], None] = lambda _: None,
) -> tuple[Net, IntArray]:
    """Bring the edges of a surface to sizes, within an envelope around it.

    Parameters
    ----------
    base : Base
    sizes : (n,) float64        length that edges are to have at each vertex
    reach : (m,) float64        length of the envelope around each triangle; inf in the plane z = 0,
                                where it counts along rims and borders alone
    bounds : Extremes           what no triangle may pass at last, unless those of the base do
    feature_angle : float       degrees
    most : float                triangles from which on no edges are split
    tick : callable             called with the share of the work that is done

    Returns
    -------
    Net                         vertices of the base keep their number, those that are gone too; new
                                ones follow. Slots may be free
    (e,) int32                  number among its ``marks`` of the line that each edge of the base is
                                on, -1 for none
    """
    points, triangles, edges = base.points, base.triangles, base.edges
    stars = vertex_stars(triangles, len(points))
    features = find_features(
        points, triangles, edges, stars, angle=feature_angle, fixed=base.fixed, kept=base.kept,
        slack=math.inf,
    )
    ground = make_ground(points, triangles, edges, stars, features.edges)
    tracks, marks = _tracks(base, features, reach)
    cosine = math.cos(math.radians(POLICY.surface_turn))
    flat = not points[:, 2].any()
    given = math.inf
    if not base.metric.size:
        sizes, given = fitted(points, triangles, edges.vertices, sizes, features, tracks)
    around = np.full(len(triangles), np.inf) if flat else reach
    rules = Rules(ground, tracks, around, cosine, bounds, FOLD, LONGEST, SHORTEST)
    net = _net(base, features, marks, sizes)
    passes = Passes(rules, sizes, base.metric, base.thin, most, given)
    for turn in range(ROUNDS):
        net = passes.split(net, bounds if turn else FREELY)
        passes.collapse(net)
        for _ in range(MOVES_SEEN if base.metric.size else MOVES):
            passes.flip(net, 1.0)
            passes.shift(net, 0.0)
        net = compact(net)
        if not flat and turn >= 1:
            passes.relent(net, edges.vertices)
        if turn == 0 and not base.metric.size:
            relent_along(net, passes, features.lines.nodes, edges.vertices)
            net = lay_in_rows(net, passes, _patches(edges, features))
        tick((turn + 1.0) / (ROUNDS + 2.0))
    if not base.metric.size:
        passes.mend(net)
    for power, sweeps in FINISH:
        for _ in range(sweeps):
            passes.flip(net, power)
            passes.shift(net, power)
    net = compact(net)
    tick((ROUNDS + 1.0) / (ROUNDS + 2.0))
    polish(net, rules, passes.metric)
    return net, marks


def _patches(edges: Edges, features: Features) -> IntArray:
    """Number (m,) of the piece of the ground, between lines, that a triangle is on."""
    apart = (edges.neighbors < 0) | features.edges[edges.of_cell]
    row, side = np.nonzero(~apart)
    return components(row, edges.neighbors[row, side], len(edges.of_cell))


def _tracks(base: Base, features: Features, reach: FloatArray) -> tuple[Tracks, IntArray]:
    """The feature lines as they are, and the one that every edge is on, (e,), -1 for none."""
    lines, edges, n = features.lines, base.edges, len(base.points)
    nodes = lines.nodes
    ends = np.flatnonzero(features.kind[nodes] != LINE).astype(np.int32)
    start, stop = ends[::2].copy(), ends[1::2].copy()
    chain = np.repeat(np.arange(len(start), dtype=np.int32), stop - start)
    slot = np.concatenate(
        [np.zeros(0, np.int32), *(np.arange(a, b) for a, b in zip(start, stop, strict=True))]
    ).astype(np.int64)
    key = edges.vertices[:, 0].astype(np.int64) * n + edges.vertices[:, 1]
    one, two = nodes[slot].astype(np.int64), nodes[slot + 1].astype(np.int64)
    number = np.searchsorted(key, np.minimum(one, two) * n + np.maximum(one, two))
    marks = np.full(len(key), -1, dtype=np.int32)
    marks[number] = chain
    held = np.zeros(len(start), dtype=np.bool_)
    held[chain[base.held[number]]] = True
    near = np.full(len(start), np.inf)
    np.minimum.at(near, chain, reach[lines.face[slot]])
    if not base.points[:, 2].any():
        near = np.minimum(near, heights(
            base.points, base.triangles, base.labels, edges, number, np.column_stack([one, two]),
            chain, len(near)))
    return Tracks(
        np.ascontiguousarray(base.points[nodes]), lines.arc, lines.face, start, stop, held, near
    ), marks


def _net(base: Base, features: Features, marks: IntArray, sizes: FloatArray) -> Net:
    """The surface before anything is changed."""
    n, m = len(base.points), len(base.triangles)
    sheet = make_sheet(base.points, base.triangles, base.edges, features)
    lines = features.lines
    place, after = np.zeros(n), np.full(n, -1, dtype=np.int32)
    on = np.flatnonzero(lines.slot >= 0)
    place[on] = lines.arc[lines.slot[on]]
    after[on] = lines.nodes[lines.slot[on] + 1]
    net = Net(
        np.column_stack([sheet.points, base.metric]),
        reaching(sheet.triangles, sheet.foot, _patches(base.edges, features)),
        features.kind.copy(), place, after, sizes.astype(np.float64),
        np.full(n, -1, dtype=np.int32), sheet.triangles,
        marks[base.edges.of_cell],
        base.labels.copy(), np.full(3 * m, -1, dtype=np.int32), sheet.first, sheet.following,
        np.zeros(n, dtype=np.int64), np.array([n, m, 0], dtype=np.int64),
    )
    link_all(net)
    return net
