"""Flips of edges on the surface of a tetrahedral mesh, with the tetrahedra beside them.

The cells around an edge ab of the surface form an open ring r0, ..., rn.  Filling the polygon
r0 ... rn anew, as for a ring inside, removes the edge and puts r0 rn in its place on the surface.
With one cell only, that cell is flat against the surface and goes.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.corner import corner_edges, six_volumes
from odt_plugins.engine.cells.tetrahedron import tet_cost
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.ground.closest import Ground
from odt_plugins.engine.ground.pair import edge_is_free, flip_back, keeps_normals
from odt_plugins.engine.ground.sheet import Limits, Sheet, Work, claim, cover, joined
from odt_plugins.engine.moves.cavity import (
    MAX_RING,
    local_edge,
    make_work,
    replace_cavity,
    triangulate_ring,
    write_ring,
)
from odt_plugins.engine.moves.flips2d import flip
from odt_plugins.engine.moves.flips3d import REAL, admissible
from odt_plugins.engine.sliding.newton import affordable, spend
from odt_plugins.engine.topology.active import IDLE, PENDING
from odt_plugins.engine.topology.lookup import place_in
from odt_plugins.mesh.arrays import BoolArray, ByteArray, FloatArray, IntArray, LongArray


@kernel
def walk_open_ring(
    cells: IntArray, neighbors: IntArray, regions: IntArray, c: int, a: int, b: int, first: int,
    head: int, ring: IntArray, around: IntArray,
) -> int:
    """Collect the cells from c = (a, b, first, head), whose facet (a, b, first) is outside.

    Returns
    -------
    int      cells around the edge, one less than vertices of the ring; 0 when the edge must stay
    """
    ring[0] = first
    behind = first
    current = c
    n = 0
    while True:
        around[n] = current
        n += 1
        if n == MAX_RING:
            return 0
        ring[n] = head
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
        while c >= 0:
            i = place_in(t, c, a)
            if t[c, (i + 1) % 3] == b:
                return c, (i + 2) % 3
            c = neighbors[c, (i + way) % 3]
            if c == start:
                break
    return -1, -1


@kernel
def _signed_volume(p: FloatArray, i: int, j: int, k: int, l: int) -> float:
    """Volume of the tetrahedron (i, j, k, l)."""
    return six_volumes(*corner_edges(p, i, j, k, l)) / 6.0


@kernel
def _ends_a_region(neighbors: IntArray, regions: IntArray, c: int) -> bool:
    """Whether what is behind cell c belongs to another region: the interface would go with c."""
    for f in range(4):
        across = neighbors[c, f]
        if across >= 0 and regions[across] != regions[c]:
            return True
    return False


@kernel
def _remove_cell(
    cells: IntArray, neighbors: IntArray, status: ByteArray, c: int, slots: LongArray,
    free: IntArray,
) -> None:
    """Take a cell out of the mesh; what was behind it is outside now."""
    for f in range(4):
        across = neighbors[c, f]
        if across >= 0:
            status[across] = PENDING
            for g in range(4):
                if neighbors[across, g] == c:
                    neighbors[across, g] = -1
    cells[c, 0] = -1
    status[c] = IDLE
    free[slots[1]] = c
    slots[1] += 1


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
def _flip_sheet(
    sheet: Sheet, ground: Ground, limits: Limits, stays: BoolArray, volume: FloatArray,
    fan: IntArray, a: int, b: int, room: Work,
) -> bool:
    """Flip the edge ab of the sheet if every guard agrees."""
    t, f = sheet_triangle(sheet, fan[a], a, b)
    if t < 0:
        return False
    edge = sheet.cell_edges[t, f]
    s = sheet.neighbors[t, f]
    if s < 0 or sheet.locked[edge] or stays[edge]:
        return False
    g = place_in(sheet.cell_edges, s, edge)
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
    flip(sheet.triangles, sheet.neighbors, sheet.cell_edges, sheet.edge_cell, t, f, s, g)
    room.cells[0] = t
    room.cells[1] = s
    number = claim(sheet, ground, 2, limits.distance, room)
    if number < 0:
        flip_back(sheet, t, s, edge)
        return False
    cover(sheet, 2, number, room)
    for v in (a, b, x, y):
        spend(volume, 0.25 * change, v)
    for m in range(3):
        fan[sheet.triangles[t, m]] = t
        fan[sheet.triangles[s, m]] = s
    return True


@allocating_kernel
def flip_boundary(
    cells: IntArray, neighbors: IntArray, regions: IntArray, locked: BoolArray,
    status: ByteArray, order: IntArray, slots: LongArray, free: IntArray, objective: int,
    power: float, bounds: FloatArray, sheet: Sheet, ground: Ground, limits: Limits,
    stays: BoolArray, volume: FloatArray, fan: IntArray, room: Work,
) -> int:
    """Flip the edges of the surface around which the sum of the cell costs falls, in place.

    Parameters
    ----------
    cells, neighbors, regions, locked, status, slots, free      as in ``flips3d.flip_pass``
    order : (k,) int32           cells whose edges are looked at
    objective, power, bounds     as there
    sheet : Sheet                the boundary; its points are those of the tetrahedra
    ground : Ground, limits : Limits
    stays : (e,) bool            edges of the sheet that must stay edges
    volume : (n + 1, 2) float64  see ``slide.affordable``
    fan : (n,) int32             a triangle of the sheet around every vertex, kept up to date
    room : Work                  room for a pair of triangles

    Returns
    -------
    int                          number of flips
    """
    points = sheet.points
    ring, around, new, best, split, stack, rim, _ = make_work(np.empty(0))
    journal = np.full((1, 4), -1, np.int64)
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
            if sheet.pinched[a]:
                continue
            n = walk_open_ring(cells, neighbors, regions, c, a, b, first, head, ring, around)
            if n == 0:
                continue
            n_new = 0
            if n > 1:
                before = 0.0
                for m in range(n):
                    t = around[m]
                    before += tet_cost(points, cells[t, 0], cells[t, 1], cells[t, 2],
                                       cells[t, 3], objective, power)
                limit = before * REAL
                after = triangulate_ring(
                    points, a, b, ring, n + 1, objective, power, limit, best, split
                )
                if not after < limit:
                    continue
                n_new = write_ring(a, b, ring, n + 1, split, new, stack)
                if n_new - n > slots[1] + cells.shape[0] - slots[0]:
                    slots[2] = 1
                    continue
                if not admissible(
                    points, cells, locked, around, n, new, n_new, objective, bounds
                ):
                    continue
            elif _ends_a_region(neighbors, regions, c):
                continue
            if not _flip_sheet(sheet, ground, limits, stays, volume, fan, a, b, room):
                continue
            if n > 1:
                replace_cavity(cells, neighbors, regions, status, around, n, new, n_new, slots,
                               free, rim, journal)
            else:
                _remove_cell(cells, neighbors, status, c, slots, free)
            flips += 1
    return flips
