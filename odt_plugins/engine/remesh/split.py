"""Split: an edge that is too long gets a vertex in its middle, and all that hold it are cut."""

from __future__ import annotations

from odt_plugins.engine.cells.tetrahedron import tet_quality
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.remesh.body import (
    INSIDE,
    LINE,
    PATCH,
    STIFF,
    Body,
    Guard,
    Scratch,
    ratio,
)
from odt_plugins.engine.remesh.guard import FLAT, share_segment, share_triangle
from odt_plugins.engine.remesh.simplices import (
    around,
    copied,
    has_room_for,
    replace_corner,
)
from odt_plugins.mesh.arrays import FloatArray, IntArray


@kernel
def split_edges(
    body: Body, guard: Guard, edges: IntArray, longest: float, scratch: Scratch, done: IntArray
) -> int:
    """Split edges (e, 2), one after the other, that are longer than so many times their size.

    Parameters
    ----------
    done : (1,) int32    OUT: splits

    Returns
    -------
    int                  edges that were looked at: fewer where there is no room for more
    """
    for e in range(edges.shape[0]):
        a, b = edges[e, 0], edges[e, 1]
        if body.tets.head[a] < 0 or body.tets.head[b] < 0:
            continue
        if not ratio(body, a, b) > longest * longest:
            continue
        if body.hold[a] == STIFF and body.hold[b] == STIFF:
            continue
        cells = around(body.tets, a, b, scratch.first)
        triangles = around(body.triangles, a, b, scratch.second)
        segments = around(body.segments, a, b, scratch.third)
        if cells <= 0 or triangles < 0 or segments < 0 or segments > 1:
            continue
        m = body.used[0]
        if m + 1 >= body.points.shape[0] or not has_room_for(body.tets, cells) or not (
                has_room_for(body.triangles, triangles) and has_room_for(body.segments, segments)):
            return e
        for k in range(body.points.shape[1]):
            body.points[m, k] = 0.5 * (body.points[a, k] + body.points[b, k])
        if not _stays_valid(body, a, b, m, cells, triangles, segments, scratch):
            continue
        body.used[0] += 1
        body.size[m] = 0.5 * (body.size[a] + body.size[b])
        body.parent[m] = a
        body.hold[m] = 0
        body.kind[m] = INSIDE if triangles == 0 else PATCH if segments == 0 else LINE
        for s in range(cells):
            copied(body.tets, scratch.first[s], a, m)
            replace_corner(body.tets, scratch.first[s], b, m)
        for s in range(triangles):
            c = scratch.second[s]
            d = copied(body.triangles, c, a, m)
            replace_corner(body.triangles, c, b, m)
            share_triangle(body, guard, c, d)
        for s in range(segments):
            c = scratch.third[s]
            d = copied(body.segments, c, a, m)
            replace_corner(body.segments, c, b, m)
            share_segment(body, guard, c, d)
        done[0] += 1
    return edges.shape[0]


@kernel
def _stays_valid(
    body: Body, a: int, b: int, m: int, cells: int, triangles: int, segments: int, scratch: Scratch
) -> bool:
    """Whether nothing that is held is cut, and both halves of every tetrahedron are positive."""
    for s in range(triangles):
        if body.triangles.held[scratch.second[s]]:
            return False
    for s in range(segments):
        if body.segments.held[scratch.third[s]]:
            return False
    for s in range(cells):
        c = scratch.first[s]
        if not (_half(body.points, body.tets.rows, c, a, m) > 0.5 * FLAT
                and _half(body.points, body.tets.rows, c, b, m) > 0.5 * FLAT):
            return False
    return True


@kernel
def _half(points: FloatArray, rows: IntArray, c: int, old: int, new: int) -> float:
    """Radius ratio of a tetrahedron with a vertex ``new`` for an old one."""
    i, j, k, l = rows[c, 0], rows[c, 1], rows[c, 2], rows[c, 3]
    i, j = new if i == old else i, new if j == old else j
    k, l = new if k == old else k, new if l == old else l
    return tet_quality(points, i, j, k, l)
