"""Feature edges of a surface, and the kinds of its vertices: smooth, on a line, or locked.

An edge is a feature on the boundary, where more than two triangles meet, between two labels, where
the caller marks it, or when the surface turns by more than the feature angle at it. The turn
must show in the normals of the triangles and in those averaged with the neighbours that agree,
which tells a crease from a bump. Of edges that merely turn, loose ends shorter than TRIM edges are
noise; so are the long edges of a flat triangle whose neighbours there agree with each other, unless
the triangle is in the plane of a larger one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.lines import Lines
from odt_plugins.engine.ground.sheet import LINE, LOCKED, SMOOTH
from odt_plugins.engine.topology.lookup import place_in
from odt_plugins.engine.topology.star import Stars
from odt_plugins.errors import endless_walk
from odt_plugins.mesh.arrays import BoolArray, ByteArray, FloatArray, IntArray, LongArray
from odt_plugins.mesh.simplex import diagonal
from odt_plugins.mesh.surface import Edges

TRIM = 5
"""A chain of sharp edges with a loose end is kept from this number of edges on."""

FLAT_QUALITY = 0.1
"""Radius ratio below which the normal of a triangle is not trusted against its neighbours."""

IN_PLANE = math.cos(math.radians(1.0))
"""Cosine between the normals of two triangles from which on they are in one plane."""

SHORT = 0.2
"""The shortest edge of a flat triangle counts when it is longer than this part of the longest."""

LARGEST_FAN = 1 << 10
"""A vertex of more triangles stays: the guards compare all that it covers with all of them."""

EXACT = 1e-6
"""A line vertex may slide where the line is straight, up to this part of the diagonal."""


@dataclass(frozen=True)
class Features:
    """What of a surface is kept.

    Attributes
    ----------
    edges : (e,) bool          feature edges, by their number in ``Edges``
    kind : (n,) uint8          SMOOTH, LINE or LOCKED
    pinched : (n,) bool        vertices around which the triangles form more than one fan
    lines : Lines              chains on which LINE vertices slide
    corners : int              locked vertices where features end, branch or bend
    """

    edges: BoolArray
    kind: ByteArray
    pinched: BoolArray
    lines: Lines
    corners: int


class _Chains(NamedTuple):
    """Chains of edges: nodes[offsets[i]:offsets[i + 1]], closed ones with the first node twice."""

    nodes: IntArray
    offsets: LongArray


def find_features(
    points: FloatArray,
    triangles: IntArray,
    edges: Edges,
    stars: Stars,
    *,
    angle: float,
    fixed: BoolArray,
    kept: BoolArray | None = None,
    slack: float = EXACT,
) -> Features:
    """Find the feature edges of a surface and say how its vertices may move.

    Parameters
    ----------
    points : (n, 3) float64
    triangles : (m, 3) int32            oriented alike
    edges : Edges, stars : Stars        of these triangles
    angle : float                       degrees by which the surface turns at a feature edge; also
                                        those by which a line turns at a corner
    fixed : (n,) bool                   vertices that must not move
    kept : (e,) bool, optional          edges that are features whatever their angle, see
                                        :func:`label_borders` and :func:`marked_edges`
    slack : float                       part of the bounding-box diagonal by which a line may
                                        change when a vertex slides along it

    Returns
    -------
    Features
    """
    n = len(points)
    fixed = fixed | (np.diff(stars.indptr) > LARGEST_FAN)
    kept = edges.degree != 2 if kept is None else kept | (edges.degree != 2)
    sharp = sharp_edges(points, triangles, edges, angle) & ~kept
    feature = kept | sharp
    while True:
        chains = _chains(edges.vertices[feature], n, _ends(edges.vertices[feature], n))
        loose = _loose_edges(chains, edges, feature, kept, n)
        if not loose.size:
            break
        feature[loose] = False
    pinched = pinched_vertices(triangles, edges, stars, n)
    ends = _ends(edges.vertices[feature], n)
    on_line = np.zeros(n, dtype=np.bool_)
    on_line[edges.vertices[feature]] = True
    ends |= on_line & (pinched & ~_on(edges.vertices[edges.degree > 2], n) | fixed)
    ends |= _bends(points, edges.vertices[feature], on_line & ~ends, angle)
    chains = _chains(edges.vertices[feature], n, ends)
    kind = np.full(n, SMOOTH, dtype=np.uint8)
    kind[on_line] = LINE
    kind[ends | fixed | pinched & ~on_line] = LOCKED
    kind[chains.nodes[chains.offsets[:-1]]] = LOCKED
    kind[np.diff(stars.indptr) == 0] = LOCKED
    corners = int((kind[on_line] == LOCKED).sum())
    _hold_bent(points, chains, kind, slack * diagonal(points))
    lines = _lines(points, chains, edges, triangles, kind)
    return Features(feature, kind, pinched, lines, corners)


def sharp_edges(
    points: FloatArray, triangles: IntArray, edges: Edges, angle: float
) -> BoolArray:
    """Edges of two triangles at which the surface turns by more than ``angle`` degrees, (e,)."""
    area, quality, lengths = _areas(points, triangles)
    normal = _unit(area)
    least = math.cos(math.radians(angle))
    turns = _cosines(normal, edges) < least
    mean = area.copy()
    for i in range(3):
        alike = (edges.neighbors[:, i] >= 0) & ~turns[:, i]
        mean[alike] += area[edges.neighbors[alike, i]]
    turns &= _cosines(_unit(mean), edges) < least
    sharp = np.zeros(len(edges.degree), dtype=np.bool_)
    sharp[edges.of_cell[turns]] = True
    flat = np.flatnonzero((quality < FLAT_QUALITY) & ~_in_plane(area, normal, edges))
    if flat.size:
        _settle_flat(sharp, flat, normal, quality, lengths, edges, least)
    return sharp


def _areas(
    points: FloatArray, triangles: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Twice the area vectors, radius ratios and lengths of the edges opposite the corners."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    area = np.cross(b - a, c - a)
    lengths = np.stack([np.sqrt((e * e).sum(axis=1)) for e in (c - b, a - c, b - a)], axis=1)
    product = lengths.prod(axis=1) * lengths.sum(axis=1)
    square = 4.0 * (area * area).sum(axis=1)
    quality = np.divide(square, product, out=np.zeros(len(a)), where=product > 0.0)
    return area, quality, lengths


def _unit(vectors: FloatArray) -> FloatArray:
    """Vectors of length 1; 0 stays."""
    length = np.sqrt((vectors * vectors).sum(axis=1))[:, None]
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)


def _cosines(normal: FloatArray, edges: Edges) -> FloatArray:
    """Cosine between the normals on both sides of every edge, (m, 3); 1 unless two triangles."""
    cosine = np.ones(edges.neighbors.shape)
    for i in range(3):
        near = edges.neighbors[:, i]
        inner = near >= 0
        cosine[inner, i] = (normal[inner] * normal[near[inner]]).sum(axis=1)
    return cosine


def _in_plane(area: FloatArray, normal: FloatArray, edges: Edges) -> BoolArray:
    """Triangles (m,) in the plane of a larger neighbour, as ears of the caps of CAD."""
    size = (area * area).sum(axis=1)
    larger = (edges.neighbors >= 0) & (size[edges.neighbors] > size[:, None])
    return np.asarray((larger & (_cosines(normal, edges) >= IN_PLANE)).any(axis=1))


def _settle_flat(
    sharp: BoolArray, flat: NDArray[np.intp], normal: FloatArray, quality: FloatArray,
    lengths: FloatArray, edges: Edges, least: float,
) -> None:
    """Let neighbours say, in place, which edges of flat triangles (k,) are sharp.

    The normal of a triangle that is nearly a line says little. Where the neighbours over its long
    edges agree, these edges are smooth, and their normal tells whether its short edge is on a
    crease.
    """
    near = edges.neighbors[flat]
    counts = (lengths[flat] > SHORT * lengths[flat].max(axis=1)[:, None]) & (near >= 0)
    counts &= quality[near] >= FLAT_QUALITY
    agree = counts.sum(axis=1) >= 2
    for i in range(3):
        j = (i + 1) % 3
        cosine = (normal[near[:, i]] * normal[near[:, j]]).sum(axis=1)
        agree &= ~(counts[:, i] & counts[:, j]) | (cosine >= least)
    flat, near, counts = flat[agree], near[agree], counts[agree]
    trusted = normal.copy()
    trusted[flat] = _unit((normal[near] * counts[:, :, None]).sum(axis=1))
    sharp[edges.of_cell[flat][counts]] = False
    row, corner = np.nonzero(~counts & (near >= 0))
    cosine = (trusted[flat[row]] * trusted[near[row, corner]]).sum(axis=1)
    sharp[edges.of_cell[flat[row], corner]] = cosine < least


def label_borders(edges: Edges, regions: IntArray) -> BoolArray:
    """Edges (e,) between triangles of different labels (m,)."""
    differs = (regions[edges.neighbors] != regions[:, None]) & (edges.neighbors >= 0)
    border = np.zeros(len(edges.degree), dtype=np.bool_)
    border[edges.of_cell[differs]] = True
    return border


def marked_edges(edges: Edges, marked: NDArray[np.integer], n: int) -> BoolArray:
    """Edges (e,) with the ends (k, 2); a pair of the n vertices that is no edge is passed over."""
    key = edges.vertices[:, 0].astype(np.int64) * n + edges.vertices[:, 1]
    wanted = np.sort(marked.astype(np.int64), axis=1)
    return np.isin(key, wanted[:, 0] * n + wanted[:, 1])


def _on(pairs: IntArray, n: int) -> BoolArray:
    mask = np.zeros(n, dtype=np.bool_)
    mask[pairs] = True
    return mask


def _ends(pairs: IntArray, n: int) -> BoolArray:
    """Vertices where features end or branch: not two edges."""
    degree = np.bincount(pairs.ravel(), minlength=n)
    return np.asarray((degree > 0) & (degree != 2))


def _bends(points: FloatArray, pairs: IntArray, inner: BoolArray, angle: float) -> BoolArray:
    """Vertices of two feature edges at which the line turns by more than ``angle`` degrees."""
    bends = np.zeros(len(points), dtype=np.bool_)
    vertex = pairs.ravel()
    other = pairs[:, ::-1].ravel()
    order = np.argsort(vertex, kind="stable")
    order = order[inner[vertex[order]]]
    first, second = order[::2], order[1::2]
    u = points[other[first]] - points[vertex[first]]
    v = points[other[second]] - points[vertex[second]]
    size = np.sqrt((u * u).sum(axis=1) * (v * v).sum(axis=1))
    turned = -(u * v).sum(axis=1) < math.cos(math.radians(angle)) * size
    bends[vertex[first[turned | (size == 0.0)]]] = True
    return bends


def _chains(pairs: IntArray, n: int, ends: BoolArray) -> _Chains:
    """Join edges to chains from one end to the next; closed loops start at their first vertex."""
    vertex = pairs.ravel()
    order = np.argsort(vertex, kind="stable")
    indptr = np.concatenate([[0], np.cumsum(np.bincount(vertex, minlength=n))]).astype(np.int64)
    other = pairs[:, ::-1].ravel()[order].astype(np.int32)
    edge = (order // 2).astype(np.int32)
    nodes = np.empty(2 * len(pairs) + 1, dtype=np.int32)
    offsets = np.zeros(len(pairs) + 1, dtype=np.int64)
    used = np.zeros(len(edge), dtype=np.bool_)
    count = _trace_chains(indptr, other, edge, ends, used, nodes, offsets)
    return _Chains(nodes[: offsets[count]], offsets[: count + 1])


@kernel
def _trace_chains(
    indptr: LongArray, other: IntArray, edge: IntArray, ends: BoolArray, used: BoolArray,
    nodes: IntArray, offsets: LongArray,
) -> int:
    """Walk every edge once, first from the ends, then round the loops that have none."""
    n = len(ends)
    count = 0
    size = 0
    for closed in (False, True):
        for v in range(n):
            if not closed and not ends[v]:
                continue
            for s in range(indptr[v], indptr[v + 1]):
                if used[edge[s]]:
                    continue
                nodes[size] = v
                size += 1
                step = s
                for _ in range(len(used)):
                    used[edge[step]] = True
                    w = other[step]
                    nodes[size] = w
                    size += 1
                    if ends[w] or w == v:
                        break
                    step = -1
                    for other_step in range(indptr[w], indptr[w + 1]):
                        if not used[edge[other_step]]:
                            step = other_step
                            break
                    if step < 0:
                        break
                count += 1
                offsets[count] = size
    return count


def _loose_edges(
    chains: _Chains, edges: Edges, feature: BoolArray, kept: BoolArray, n: int
) -> NDArray[np.intp]:
    """Edges of short chains with a loose end, all of them merely sharp."""
    numbers = np.flatnonzero(feature)
    degree = np.bincount(edges.vertices[numbers].ravel(), minlength=n)
    start, stop = chains.offsets[:-1], chains.offsets[1:]
    loose = (degree[chains.nodes[start]] == 1) | (degree[chains.nodes[stop - 1]] == 1)
    short = np.flatnonzero(loose & (stop - start - 1 < TRIM))
    if not short.size:
        return np.zeros(0, dtype=np.intp)
    key = edges.vertices[:, 0].astype(np.int64) * n + edges.vertices[:, 1]
    found = []
    for i in short.tolist():
        path = chains.nodes[start[i] : stop[i]].astype(np.int64)
        low, high = np.minimum(path[:-1], path[1:]), np.maximum(path[:-1], path[1:])
        number = np.searchsorted(key, low * n + high)
        if not kept[number].any():
            found.append(number)
    return np.concatenate(found) if found else np.zeros(0, dtype=np.intp)


def pinched_vertices(triangles: IntArray, edges: Edges, stars: Stars, n: int) -> BoolArray:
    """Vertices around which the triangles form more than one fan, (n,) bool.

    Raises
    ------
    EndlessWalkError    neighbours disagree about the outside
    """
    pinched = np.zeros(n, dtype=np.bool_)
    lost = int(_mark_pinched(triangles, edges.neighbors, stars.indptr, stars.indices, pinched))
    if lost >= 0:
        raise endless_walk(lost)
    return pinched


@kernel
def _mark_pinched(
    triangles: IntArray, neighbors: IntArray, indptr: LongArray, indices: IntArray,
    pinched: BoolArray,
) -> int:
    """Count how many triangles of a star one turn around the vertex reaches.

    Returns
    -------
    int      first vertex around which a turn visits more triangles than there are, or -1
    """
    for v in range(len(pinched)):
        count = indptr[v + 1] - indptr[v]
        if count == 0:
            continue
        start = indices[indptr[v]]
        reached = 1
        for way in (1, 2):
            c = start
            for _ in range(count):
                c = neighbors[c, (place_in(triangles, c, v) + way) % 3]
                if c < 0 or c == start:
                    break
                reached += 1
            if c >= 0:
                break
        if reached > count:
            return v
        pinched[v] = reached < count
    return -1


def _hold_bent(points: FloatArray, chains: _Chains, kind: ByteArray, slack: float) -> None:
    """Hold, in place, the line vertices that are further from their neighbours' chord.

    Neighbours at the same place, to the slack, are passed over.
    """
    nodes, offsets = chains.nodes, chains.offsets
    middle = np.arange(1, len(nodes) - 1)
    middle = middle[kind[nodes[middle]] == LINE]
    chain = np.searchsorted(offsets, middle, side="right")
    v = points[nodes[middle]]
    before, after = middle - 1, middle + 1
    for near, step, last in ((before, -1, offsets[chain - 1]), (after, 1, offsets[chain] - 1)):
        again = np.arange(len(middle))
        while again.size:
            away = points[nodes[near[again]]] - v[again]
            same = (away * away).sum(axis=1) <= slack * slack
            again = again[same & (near[again] != last[again])]
            near[again] += step
    a, b = points[nodes[before]], points[nodes[after]]
    u = b - a
    length = (u * u).sum(axis=1)
    w = np.divide(((v - a) * u).sum(axis=1), length, out=np.zeros(len(u)), where=length > 0.0)
    off = v - a - np.clip(w, 0.0, 1.0)[:, None] * u
    bent = np.sqrt((off * off).sum(axis=1)) > slack
    kind[nodes[middle[bent]]] = LOCKED


def _lines(
    points: FloatArray, chains: _Chains, edges: Edges, triangles: IntArray, kind: ByteArray
) -> Lines:
    """Measure the chains by arc length."""
    n = len(points)
    nodes = chains.nodes
    slot = np.full(n, -1, dtype=np.int32)
    if not len(nodes):
        empty = np.zeros(0)
        none = np.zeros(0, dtype=np.int32)
        return Lines(none, empty, empty.copy(), none, slot)
    slot[nodes] = np.arange(len(nodes), dtype=np.int32)
    slot[kind != LINE] = -1
    step = np.zeros(len(nodes))
    step[1:] = np.sqrt(((points[nodes[1:]] - points[nodes[:-1]]) ** 2).sum(axis=1))
    arc = np.cumsum(step)
    a_cell = np.zeros(len(edges.degree), dtype=np.int32)
    a_cell[edges.of_cell] = np.arange(len(triangles), dtype=np.int32)[:, None]
    key = edges.vertices[:, 0].astype(np.int64) * n + edges.vertices[:, 1]
    path = nodes.astype(np.int64)
    low, high = np.minimum(path[:-1], path[1:]), np.maximum(path[:-1], path[1:])
    number = np.minimum(np.searchsorted(key, low * n + high), len(key) - 1)
    face = np.append(a_cell[number], 0).astype(np.int32)
    return Lines(nodes, arc, arc.copy(), face, slot)
