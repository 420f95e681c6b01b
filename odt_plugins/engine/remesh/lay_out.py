"""From a valid mesh of tetrahedra to a body that can be resized, and its edges."""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.cells.geometry import FACETS, signed_volumes
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.features import find_features, label_borders, marked_edges
from odt_plugins.engine.ground.reference import make_surface
from odt_plugins.engine.ground.replace import make_exchange
from odt_plugins.engine.remesh.body import (
    CORNER,
    FREELY,
    INSIDE,
    LINE,
    PATCH,
    STAR,
    STAYS,
    Body,
    Guard,
    Scratch,
    ratio,
)
from odt_plugins.engine.remesh.boxes import make_boxes
from odt_plugins.engine.remesh.simplices import make_simplices
from odt_plugins.engine.run.work import Start
from odt_plugins.engine.topology.adjacency import cell_neighbors
from odt_plugins.engine.topology.star import vertex_stars
from odt_plugins.mesh.arrays import BoolArray, ByteArray, FloatArray, IntArray
from odt_plugins.mesh.components import components
from odt_plugins.mesh.faces import Faces, ends_of, labels_at, renumbered
from odt_plugins.mesh.surface import Edges, surface_edges

SPARE = 1.3
"""Room at the beginning, as a multiple of what there is."""

EDGES = 8
"""Edges of a vertex for which there is room at first."""

TURN, NEW_TURN = 0.25, 0.6
"""Least cosine between a new triangle and the ground under it, and the triangle that it was."""

FLOOR = 0.12
"""Radius ratio of tetrahedra below which none becomes worse, whatever the input has."""


VOLUME = 1.7e-3
"""Largest change of the volume of a region, as a part of it; sliding has the rest."""


def surface_of(
    cells: IntArray, regions: IntArray, faces: Faces
) -> tuple[IntArray, IntArray, IntArray]:
    """Triangles (k, 3) of the boundary and of interfaces, out of the lower region, their patches.

    Facets of one patch have the same region, or the same two regions, on their sides, and the same
    label among ``faces``: (p, 3), the second -1 on the boundary, the last without a label.
    """
    neighbors = cell_neighbors(cells)
    triangles, sides = [], []
    for i in range(4):
        across = neighbors[:, i]
        other = np.where(across >= 0, regions[across], -1)
        here = np.flatnonzero((across < 0) | (regions < other))
        triangles.append(cells[here][:, FACETS[4][i]])
        sides.append(np.stack([regions[here], other[here]], axis=1))
    rows = np.concatenate(triangles).astype(np.int32)
    both, patch = np.unique(np.column_stack([np.concatenate(sides), labels_at(rows, faces)]),
                            axis=0, return_inverse=True)
    return rows, patch.ravel().astype(np.int32), both.astype(np.int32)


def apart(
    points: FloatArray, triangles: IntArray, patch: IntArray
) -> tuple[FloatArray, IntArray]:
    """The same triangles with vertices of their own for every patch."""
    n = len(points)
    key = triangles.astype(np.int64) + n * patch[:, None].astype(np.int64)
    pairs, number = np.unique(key, return_inverse=True)
    return points[pairs % n], number.reshape(-1, 3).astype(np.int32)


def lines_of(
    points: FloatArray, edges: Edges, feature: BoolArray, angle: float, n: int
) -> tuple[IntArray, ByteArray]:
    """Feature edges (s, 2), and the kinds of their vertices: LINE, CORNER at ends and bends."""
    segments = edges.vertices[feature]
    kind = np.zeros(n, dtype=np.uint8)
    degree = np.bincount(segments.ravel(), minlength=n)
    kind[degree > 0] = CORNER
    order = np.argsort(segments.ravel(), kind="stable")
    vertex, other = segments.ravel()[order], segments[:, ::-1].ravel()[order]
    two = degree[vertex] == 2
    first, second, middle = other[two][::2], other[two][1::2], vertex[two][::2]
    u, v = points[first] - points[middle], points[second] - points[middle]
    size = np.sqrt((u * u).sum(axis=1) * (v * v).sum(axis=1))
    straight = -(u * v).sum(axis=1) >= math.cos(math.radians(angle)) * size
    kind[middle[straight & (size > 0.0)]] = LINE
    return segments.astype(np.int32), kind


def line_numbers(segments: IntArray, kind: ByteArray) -> IntArray:
    """Number of the line of every segment: they hang together at vertices of the kind LINE."""
    count = len(segments)
    inner = kind[segments] == LINE
    rows = np.repeat(np.arange(count), 2).reshape(-1, 2)[inner]
    label = components(rows, count + segments[inner], count + len(kind))[:count]
    return np.unique(label, return_inverse=True)[1].ravel().astype(np.int32)


def lay_out(
    start: Start, hold: ByteArray, reach: FloatArray, angle: float, least: Extremes
) -> tuple[Body, Guard, Scratch, tuple[IntArray, IntArray]]:
    """Lay a mesh out.

    Parameters
    ----------
    start : Start            its lines count as feature edges, those with labels among them
    hold : (n,) uint8        FREELY, STAYS or STIFF
    reach : (n,) float64     length by which the surface may move at a vertex; 0 everywhere: it
                             stays as it is
    angle : float            degrees by which the surface turns at a feature edge
    least : Extremes         of tetrahedra that may come

    Returns
    -------
    Body, Guard, Scratch, and the labels of lines and of patches, -1 without one
    """
    points, metric, cells, regions = start.points, start.metric, start.cells, start.regions
    n, envelope = len(points), float(reach.max())
    lines, named = (renumbered(faces, start.number) for faces in start.mesh.faces)
    labels, inverse = np.unique(regions, return_inverse=True)
    tag: IntArray = inverse.ravel().astype(np.int32)
    triangles, patch, sides = surface_of(cells, tag, named)
    edges = surface_edges(triangles, n)
    on_surface = np.zeros(n, dtype=np.bool_)
    on_surface[triangles] = True
    kind = np.where(on_surface, PATCH, INSIDE).astype(np.uint8)
    segments = np.zeros((0, 2), dtype=np.int32)
    line = names = np.zeros(0, dtype=np.int32)
    own, ground_rows = apart(points, triangles, patch)
    if envelope > 0.0:
        features = find_features(
            points, triangles, edges, vertex_stars(triangles, n), angle=angle,
            fixed=hold != FREELY,
            kept=label_borders(edges, patch) | marked_edges(
                edges, start.pairs(start.mesh.lines), n),
        )
        segments, on_lines = lines_of(points, edges, features.edges, angle, n)
        kind = np.maximum(kind, on_lines)
        several = np.zeros(n, dtype=np.bool_)
        several[edges.vertices[edges.degree > 2]] = True
        kind[features.pinched & on_surface & ~(several & (on_lines == LINE))] = CORNER
        kind[ends_of(lines, n)] = CORNER
        line = line_numbers(segments, kind)
        names = np.full(int(line.max(initial=-1)) + 1, -1, dtype=np.int32)
        names[line] = labels_at(segments, lines)
    else:
        kind[on_surface] = CORNER
        hold = np.where(on_surface, np.maximum(hold, STAYS), hold).astype(np.uint8)
    room = int(SPARE * n) + 16
    held = np.full(len(triangles), not envelope > 0.0)
    body = Body(
        np.zeros((room, 3 + metric.shape[1])), np.zeros(room), np.zeros(room, np.uint8),
        np.zeros(room, np.uint8), np.full(room, -1, np.int32),
        make_simplices(cells, tag, np.zeros(len(cells), np.bool_), room,
                       int(SPARE * len(cells)) + 64),
        make_simplices(triangles, patch, held, room, int(SPARE * len(triangles)) + 64),
        make_simplices(segments, line, np.zeros(len(segments), np.bool_), room,
                       int(SPARE * len(segments)) + 64),
        np.array([n], dtype=np.int64),
    )
    body.points[:n, :3], body.points[:n, 3:] = points, metric
    body.kind[:n], body.hold[:n] = kind, hold
    volume = np.zeros((len(labels), 3))
    whole = np.bincount(tag, signed_volumes(points, cells))
    volume[:, 1] = VOLUME * whole
    ground = make_surface(own, ground_rows)
    area: FloatArray = np.bincount(patch, signed_volumes(points, triangles)).astype(np.float64)
    curves = make_boxes(points, segments[:, [0, 1, 1]], line)
    first, following = _lists(ground_rows, len(own), len(body.triangles.rows))
    on_line, next_on_line = _lists(segments, n, len(body.segments.rows))
    guard = Guard(
        ground, make_boxes(own, ground_rows, patch), curves, first, following, on_line,
        next_on_line, reach[triangles].min(axis=1),
        np.array([envelope, TURN, NEW_TURN]),
        least._replace(quality=FLOOR), volume,
        np.ascontiguousarray(sides[:, :2]), area,
    )
    scratch = Scratch(
        np.empty(STAR, np.int32), np.empty(STAR, np.int32), np.empty(STAR, np.int32),
        np.zeros(room, np.int64), np.zeros(1, np.int64), make_exchange(),
        np.full(room, -1, np.int32), np.empty(STAR, np.int32),
    )
    return body, guard, scratch, (names, sides[:, 2])


def _lists(rows: IntArray, n: int, room: int) -> tuple[IntArray, IntArray]:
    """Lists of the vertices of simplices: each is in that of one that holds it."""
    owner = np.full(n, -1, dtype=np.int32)
    owner[rows[::-1]] = np.arange(len(rows), dtype=np.int32)[::-1, None]
    first, following = np.full(room, -1, np.int32), np.full(n, -1, np.int32)
    vertices = np.flatnonzero(owner >= 0)
    vertices = vertices[np.argsort(owner[vertices], kind="stable")].astype(np.int32)
    own = owner[vertices]
    again = own[1:] == own[:-1]
    following[vertices[:-1][again]] = vertices[1:][again]
    start = np.append(True, ~again)[: len(own)]
    first[own[start]] = vertices[start]
    return first, following


def edges_beyond(
    body: Body, limit: float, *, longer: bool, near: BoolArray | None = None
) -> IntArray:
    """Edges (e, 2) longer, or shorter, than so many times their size; the furthest off first.

    If vertices ``near`` (n,) are marked, only those with one of them.
    """
    n = int(body.used[0])
    if near is None:
        near = around = np.ones(n, dtype=np.bool_)
    else:
        around, rows = near.copy(), body.tets.rows
        around[rows[near[rows].any(axis=1)]] = True
    room = EDGES * n
    while True:
        edges, ratios = np.empty((room, 2), dtype=np.int32), np.empty(room)
        mark = np.full(n, -1, dtype=np.int32)
        found = int(_edges_beyond(
            body, limit * limit, longer, near, around, mark, edges, ratios))
        if found <= room:
            break
        room = found
    key = ratios[:found]
    return edges[:found][np.argsort(-key if longer else key, kind="stable")]


@kernel
def _edges_beyond(
    body: Body, limit: float, longer: bool, near: BoolArray, around: BoolArray, mark: IntArray,
    edges: IntArray, ratios: FloatArray,
) -> int:
    """Count such edges of vertices ``around`` those, and write them as long as there is room."""
    tets = body.tets
    count = 0
    for v in range(mark.shape[0]):
        if not around[v]:
            continue
        at = tets.head[v]
        for _ in range(tets.next.size):
            if at < 0:
                break
            c = at // 4
            for i in range(4):
                w = tets.rows[c, i]
                if w > v and mark[w] != v:
                    mark[w] = v
                    if not (near[v] or near[w]):
                        continue
                    r = ratio(body, v, w)
                    if (r > limit) if longer else (r < limit):
                        if count < edges.shape[0]:
                            edges[count, 0], edges[count, 1], ratios[count] = v, w, r
                        count += 1
            at = tets.next[c, at % 4]
    return count

