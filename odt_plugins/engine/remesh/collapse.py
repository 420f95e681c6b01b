"""Collapse: a vertex of a short edge goes to the other end, and all that hold both vanish.

A vertex inside may go to any neighbour, one of a patch along the patch, one of a line along the
line. Links decide that the topology stays: what hangs together with both ends hangs together with
the edge, in the mesh, on its surface and on its lines.

T. K. Dey et al., Topology preserving edge contraction, Publ. Inst. Math. 66 (1999), Theorem 3.
"""

from __future__ import annotations

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.remesh.body import (
    CORNER,
    FREELY,
    INSIDE,
    LINE,
    PATCH,
    Body,
    Guard,
    Scratch,
    ratio,
)
from odt_plugins.engine.remesh.guard import carry, fits, move, normal_of_star
from odt_plugins.engine.remesh.simplices import (
    Simplices,
    around,
    holds,
    remove,
    replace_corner,
    star,
)
from odt_plugins.mesh.arrays import IntArray


@kernel
def collapse_edges(
    body: Body, guard: Guard, edges: IntArray, lengths: tuple[float, float], scratch: Scratch
) -> int:
    """Collapse edges (e, 2), one after the other, that are shorter than so many times their size.

    Parameters
    ----------
    lengths : two of float    largest length of an edge that vanishes, and of one that comes

    Returns
    -------
    int                       how many vanished
    """
    done = 0
    shortest, longest = lengths[0] * lengths[0], lengths[1] * lengths[1]
    for e in range(edges.shape[0]):
        a, b = edges[e, 0], edges[e, 1]
        if body.tets.head[a] < 0 or body.tets.head[b] < 0 or not ratio(body, a, b) < shortest:
            continue
        if around(body.tets, a, b, scratch.first) <= 0:
            continue
        if body.kind[a] > body.kind[b]:
            a, b = b, a
        if _collapse(body, guard, a, b, longest, scratch):
            done += 1
        elif body.kind[a] == body.kind[b] and _collapse(body, guard, b, a, longest, scratch):
            done += 1
    return done


@kernel
def _collapse(
    body: Body, guard: Guard, u: int, v: int, longest: float, scratch: Scratch
) -> bool:
    """Let vertex u go to v if that may be; says whether.

    On a patch v then goes along the normal such that the volume is as before, if that may be.
    """
    kind = body.kind[u]
    if body.hold[u] != FREELY or kind == CORNER:
        return False
    if kind != INSIDE and around(body.triangles, u, v, scratch.second) <= 0:
        return False
    if kind == LINE and around(body.segments, u, v, scratch.third) != 1:
        return False
    if not _no_longer(body, u, v, longest, scratch):
        return False
    if not _links_meet(body.tets, u, v, scratch):
        return False
    if kind != INSIDE and not _surface_links_meet(body.triangles, u, v, scratch):
        return False
    if kind == LINE and not _line_stays(body.segments, u, v, scratch):
        return False
    region = 0
    if kind == PATCH:
        region = guard.sides[body.triangles.tag[body.triangles.head[u] // 3], 0]
    change = guard.volume[region, 0]
    if not fits(body, guard, u, v, scratch):
        return False
    carry(body, guard, u, v, scratch)
    _take_out(body.tets, u, v, scratch.first)
    if kind != INSIDE:
        _take_out(body.triangles, u, v, scratch.first)
    if kind == LINE:
        _take_out(body.segments, u, v, scratch.first)
    change -= guard.volume[region, 0]
    if kind == PATCH and body.kind[v] == PATCH and body.hold[v] == FREELY:
        x, y, z, size = normal_of_star(body, v, scratch)
        if size > 0.0:
            out = 6.0 * change / size
            x, y, z = (body.points[v, 0] + out * x, body.points[v, 1] + out * y,
                       body.points[v, 2] + out * z)
            move(body, guard, v, (x, y, z), scratch)
    return True


@kernel
def _take_out(simplices: Simplices, u: int, v: int, out: IntArray) -> None:
    """Remove the simplices of u and v, and give those of u alone to v."""
    count = star(simplices, u, out)
    for s in range(count):
        if holds(simplices, out[s], v):
            remove(simplices, out[s])
        else:
            replace_corner(simplices, out[s], u, v)


@kernel
def _no_longer(body: Body, u: int, v: int, longest: float, scratch: Scratch) -> bool:
    """Whether no edge comes that is too long, or longer than those that went."""
    cells = star(body.tets, u, scratch.first)
    if cells < 0:
        return False
    mark = scratch.mark
    scratch.clock[0] += 1
    mark[u] = mark[v] = scratch.clock[0]
    for s in range(cells):
        for i in range(4):
            w = body.tets.rows[scratch.first[s], i]
            if mark[w] != scratch.clock[0]:
                mark[w] = scratch.clock[0]
                new = ratio(body, v, w)
                if new > longest and new > ratio(body, u, w):
                    return False
    return True


@kernel
def _links_meet(tets: Simplices, u: int, v: int, scratch: Scratch) -> bool:
    """Whether the links of u and v meet in that of the edge uv alone: vertices and edges of them.

    Triangles in both links give tetrahedra of negative volume.
    """
    cells, others = _vertices_meet(tets, 4, u, v, scratch)
    mark, both = scratch.mark, scratch.clock[0]
    for s in range(cells):
        c = scratch.first[s]
        if holds(tets, c, v):
            continue
        for i in range(4):
            for j in range(i):
                w, x = tets.rows[c, i], tets.rows[c, j]
                if w == u or x == u or mark[w] != both or mark[x] != both:
                    continue
                if _held_with(tets, w, x, scratch.second, others) and not _with_edge(
                        tets, v, w, x, scratch.first, cells):
                    return False
    return cells > 0


@kernel
def _vertices_meet(
    simplices: Simplices, corners: int, u: int, v: int, scratch: Scratch
) -> tuple[int, int]:
    """How many simplices of so many corners are around u and v, listed in ``first`` and ``second``.

    0 and 0 where a vertex beside both is in no simplex with both; those that are in one have the
    last stamp.
    """
    mark, rows = scratch.mark, simplices.rows
    scratch.clock[0] += 2
    both = scratch.clock[0]
    cells = star(simplices, u, scratch.first)
    others = star(simplices, v, scratch.second)
    if cells < 0 or others < 0:
        return 0, 0
    for s in range(cells):
        for i in range(corners):
            mark[rows[scratch.first[s], i]] = both - 1
    for s in range(cells):
        c = scratch.first[s]
        if holds(simplices, c, v):
            for i in range(corners):
                mark[rows[c, i]] = both
    for s in range(others):
        for i in range(corners):
            if mark[rows[scratch.second[s], i]] == both - 1:
                return 0, 0
    return cells, others


@kernel
def _held_with(s: Simplices, w: int, x: int, slots: IntArray, count: int) -> bool:
    """Whether one of some simplices holds w and x."""
    for i in range(count):
        if holds(s, slots[i], w) and holds(s, slots[i], x):
            return True
    return False


@kernel
def _with_edge(s: Simplices, v: int, w: int, x: int, slots: IntArray, count: int) -> bool:
    """Whether one of some simplices holds v, w and x."""
    for i in range(count):
        c = slots[i]
        if holds(s, c, v) and holds(s, c, w) and holds(s, c, x):
            return True
    return False


@kernel
def _surface_links_meet(triangles: Simplices, u: int, v: int, scratch: Scratch) -> bool:
    """The same on the surface, of which no triangle may come to lie on another one."""
    cells, others = _vertices_meet(triangles, 3, u, v, scratch)
    for s in range(cells):
        c = scratch.first[s]
        if holds(triangles, c, v):
            continue
        w, x = triangles.rows[c, 0], triangles.rows[c, 1]
        if w == u:
            w = triangles.rows[c, 2]
        elif x == u:
            x = triangles.rows[c, 2]
        if _held_with(triangles, w, x, scratch.second, others):
            return False
    return cells > 0


@kernel
def _line_stays(segments: Simplices, u: int, v: int, scratch: Scratch) -> bool:
    """Whether u has two segments and no other joins its neighbours."""
    count = star(segments, u, scratch.first)
    if count != 2:
        return False
    for s in range(2):
        c = scratch.first[s]
        if holds(segments, c, v):
            continue
        x = segments.rows[c, 0]
        x = segments.rows[c, 1] if x == u else x
        return around(segments, v, x, scratch.third) == 0
    return False
