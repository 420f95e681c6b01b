"""Flips of edges on the surface of a tetrahedral mesh, with the tetrahedra beside them.

The cells around an edge ab of the surface form an open ring r0, ..., rn.  Filling the polygon
r0 ... rn anew, as for a ring inside, removes the edge and puts r0 rn in its place on the surface.
With one cell only, that cell is flat against the surface and goes.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.corner import corner_edges, six_volumes
from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Bounds
from odt_plugins.engine.cells.measures import cell_cost
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.ground.budget import affordable, spend
from odt_plugins.engine.ground.pair import edge_is_free, flip_back, keeps_normals
from odt_plugins.engine.ground.sheet import Sheet, Work, claim, cover, joined
from odt_plugins.engine.moves.cavity import (
    MAX_RING,
    Ring,
    local_edge,
    make_journal,
    make_ring,
    replace_cavity,
    triangulate_ring,
    write_ring,
)
from odt_plugins.engine.moves.flips2d import flip
from odt_plugins.engine.moves.flips3d import REAL, admissible
from odt_plugins.engine.sliding.boundary import Skin
from odt_plugins.engine.topology.active import IDLE, PENDING
from odt_plugins.engine.topology.lookup import place_in
from odt_plugins.engine.topology.tets import Tets, give_slot, has_room
from odt_plugins.mesh.arrays import FloatArray, IntArray


@kernel
def walk_open_ring(
    tets: Tets, c: int, a: int, b: int, first: int, head: int, ring: Ring
) -> int:
    """Collect the cells from c = (a, b, first, head), whose facet (a, b, first) is outside.

    Returns
    -------
    int      cells around the edge, one less than vertices of the ring; 0 when the edge must stay
    """
    cells, neighbors, regions = tets.cells, tets.neighbors, tets.regions
    ring.vertices[0] = first
    behind = first
    current = c
    for n in range(1, MAX_RING):
        ring.cells[n - 1] = current
        ring.vertices[n] = head
        across = neighbors[current, place_in(cells, current, behind)]
        if across < 0:
            return n
        if regions[across] != regions[c]:
            return 0
        behind = head
        for m in range(4):
            v = cells[across, m]
            if v != a and v != b and v != behind:
                head = v
        current = across
    return 0


@kernel
def sheet_triangle(sheet: Sheet, start: int, a: int, b: int) -> tuple[int, int]:
    """Find the triangle of the fan of a, from ``start`` on, in which b follows a.

    Returns
    -------
    triangle, corner : int      the corner is opposite to ab; -1, -1 when there is none
    """
    t, neighbors = sheet.triangles, sheet.neighbors
    for way in (1, 2):
        c = start
        for _ in range(len(t)):
            i = place_in(t, c, a)
            if t[c, (i + 1) % 3] == b:
                return c, (i + 2) % 3
            c = neighbors[c, (i + way) % 3]
            if c == start:
                return -1, -1
            if c < 0:
                break
        if c >= 0:
            sheet.lost[0] = a
    return -1, -1


@kernel
def _signed_volume(p: FloatArray, i: int, j: int, k: int, l: int) -> float:
    """Volume of the tetrahedron (i, j, k, l)."""
    return six_volumes(*corner_edges(p, i, j, k, l)) / 6.0


@kernel
def _ends_a_region(tets: Tets, c: int) -> bool:
    """Whether what is behind cell c belongs to another region: the interface would go with c."""
    neighbors, regions = tets.neighbors, tets.regions
    for f in range(4):
        across = neighbors[c, f]
        if across >= 0 and regions[across] != regions[c]:
            return True
    return False


@kernel
def _remove_cell(tets: Tets, c: int) -> None:
    """Take a cell out of the mesh; what was behind it is outside now."""
    neighbors, status = tets.neighbors, tets.status
    for f in range(4):
        across = neighbors[c, f]
        if across >= 0:
            status[across] = PENDING
            for g in range(4):
                if neighbors[across, g] == c:
                    neighbors[across, g] = -1
    status[c] = IDLE
    give_slot(tets, np.int64(c))


@kernel
def _all_afford(volume: FloatArray, change: float, a: int, b: int, x: int, y: int) -> bool:
    """Whether the mesh may change its volume so, and each of four vertices a quarter of that."""
    after = abs(volume[0, 0] + change)
    if after > volume[0, 1] and after > abs(volume[0, 0]):
        return False
    for v in (a, b, x, y):
        if not affordable(volume, 0.25 * change, v):
            return False
    return True


@kernel
def _flip_sheet(skin: Skin, a: int, b: int, room: Work) -> bool:
    """Flip the edge ab of the sheet if every guard agrees."""
    sheet, ground, limits = skin.sheet, skin.ground, skin.limits
    volume, fan = skin.volume, skin.fan
    t, f = sheet_triangle(sheet, fan[a], a, b)
    if t < 0:
        return False
    edge = sheet.edges.of_cell[t, f]
    s = sheet.neighbors[t, f]
    if s < 0 or sheet.locked[edge] or skin.stays[edge]:
        return False
    g = place_in(sheet.edges.of_cell, s, edge)
    x, y = sheet.triangles[t, f], sheet.triangles[s, g]
    change = _signed_volume(
        sheet.points, x, sheet.triangles[t, (f + 1) % 3], sheet.triangles[t, (f + 2) % 3], y
    )
    if (
        not _all_afford(volume, change, a, b, x, y)
        or not edge_is_free(sheet, t, x, s, y)
        or not keeps_normals(
            sheet, ground, x, sheet.triangles[t, (f + 1) % 3], sheet.triangles[t, (f + 2) % 3], y,
            limits.cosine,
        )
        or not joined(sheet, ground, x, y, limits.distance)
    ):
        return False
    flip(sheet.triangles, sheet.neighbors, sheet.edges, t, f, s, g)
    room.cells[0] = t
    room.cells[1] = s
    # numba would compile claim and cover once more for a literal
    pair = np.int64(2)
    number = claim(sheet, ground, pair, limits.distance, room)
    if number < 0:
        flip_back(sheet, t, s, edge)
    else:
        cover(sheet, pair, number, room)
        for v in (np.int64(a), np.int64(b), np.int64(x), np.int64(y)):
            spend(volume, 0.25 * change, v)
    for m in range(3):
        fan[sheet.triangles[t, m]] = t
        fan[sheet.triangles[s, m]] = s
    return number >= 0


@allocating_kernel
def flip_boundary(
    tets: Tets, order: IntArray, cost: Cost, bounds: Bounds, skin: Skin, room: Work
) -> int:
    """Flip the edges of the surface around which the sum of the cell costs falls, in place.

    Parameters
    ----------
    tets : Tets                  changed in place
    order : (k,) int32           cells whose edges are looked at
    cost : Cost, bounds : Bounds
    skin : Skin                  the boundary; its points are those of the tetrahedra
    room : Work                  room for a pair of triangles

    Returns
    -------
    int                          number of flips
    """
    points, cells, neighbors = tets.points, tets.cells, tets.neighbors
    pinched = skin.sheet.pinched
    ring = make_ring(np.empty(0), np.bool_(False))
    journal = make_journal(np.bool_(False), np.int64(0))
    flips = 0
    for o in range(order.shape[0]):
        c = order[o]
        for e in range(6):
            if cells[c, 0] < 0:
                break
            i, j, k, l = local_edge(e)
            if neighbors[c, l] < 0:
                a, b, first, head = cells[c, i], cells[c, j], cells[c, k], cells[c, l]
            elif neighbors[c, k] < 0:
                a, b, first, head = cells[c, j], cells[c, i], cells[c, l], cells[c, k]
            else:
                continue
            if pinched[a]:
                continue
            n = walk_open_ring(tets, c, a, b, first, head, ring)
            if n == 0:
                continue
            n_new = 0
            if n > 1:
                before = 0.0
                for m in range(n):
                    before += cell_cost(points, cells, ring.cells[m], cost)
                limit = before * REAL
                after = triangulate_ring(points, a, b, n + 1, cost, limit, ring)
                if not after < limit:
                    continue
                n_new = write_ring(a, b, n + 1, ring)
                if not has_room(tets, n_new - n):
                    continue
                if not admissible(tets, ring.cells, n, ring.new, n_new, cost.objective, bounds):
                    continue
            elif _ends_a_region(tets, c):
                continue
            if not _flip_sheet(skin, a, b, room):
                continue
            if n > 1:
                replace_cavity(tets, ring.cells, n, ring.new, n_new, ring.border, journal)
            else:
                _remove_cell(tets, c)
            flips += 1
    return flips
