"""Cavities that are star-shaped from a point, and the cells that join their facets to it.

A set of cells whose facets all face the point is filled exactly once by the cells that join the
facets to it.  Of all such sets the one whose worst new cell is the best is looked for, as in B. M.
Klingner, J. R. Shewchuk, Aggressive tetrahedral mesh improvement, 16th International Meshing
Roundtable (2007) 3-23, Section 3.3; there by a cut through a graph of all cells that could go.
"""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.cells.corner import corner_edges, corner_normals
from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.measures import cell_cost, tet_cost
from odt_plugins.engine.cells.tetrahedron import opposite_vertices
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.moves.cavity import Ring, walk_ring
from odt_plugins.engine.topology.lookup import is_in, place_in
from odt_plugins.engine.topology.tets import Tets
from odt_plugins.mesh.arrays import FloatArray, IntArray

LARGEST_CAVITY = 32
"""Cells at which a cavity stops growing."""
PLACES = 11
"""Where a vertex may come into a cell: on its 6 edges, on its 4 facets, in its middle."""


@kernel
def _cone_cost(
    points: FloatArray, cells: IntArray, c: int, f: int, p: int, cost: Cost
) -> float:
    """Cost of cell c with vertex p in the place of its local vertex f."""
    i = p if f == 0 else cells[c, 0]
    j = p if f == 1 else cells[c, 1]
    k = p if f == 2 else cells[c, 2]
    l = p if f == 3 else cells[c, 3]
    return tet_cost(points, i, j, k, l, cost)


@kernel
def _write_cone(cells: IntArray, c: int, f: int, p: int, out: IntArray) -> None:
    """Write cell c with vertex p in the place of its local vertex f."""
    for i in range(4):
        out[i] = cells[c, i]
    out[f] = p


HEIGHT = 0.64
"""Of a vertex above a triangle, in roots of twice its area: three quarters of a regular cell's."""


@kernel
def _rise(points: FloatArray, cells: IntArray, c: int, f: int, p: int) -> None:
    """Lift vertex p from facet f of cell c, on the side of the cell."""
    i, j, k = opposite_vertices(cells, c, cells[c, f])
    ax, ay, az, bx, by, bz, _, _, _ = corner_edges(points, i, k, j, j)
    _, _, _, _, _, _, nx, ny, nz = corner_normals(ax, ay, az, bx, by, bz, bx, by, bz)
    square = max(nx * nx + ny * ny + nz * nz, 1e-300)
    height = HEIGHT / math.sqrt(math.sqrt(square))
    points[p, 0] += height * nx
    points[p, 1] += height * ny
    points[p, 2] += height * nz


@kernel
def seed_cavity(
    tets: Tets, c: int, place: int, p: int, max_ring: int, ring: Ring, cavity: IntArray
) -> int:
    """Put vertex p in the middle of an edge, of a facet or of cell c; the cells that contain it.

    A facet of the boundary or of an interface gets it above its middle.

    Parameters
    ----------
    place : int                below PLACES: edge, facet or cell
    ring : Ring                room for the cells around an edge
    cavity : (k,) int32        the cells are written here

    Returns
    -------
    int                        number of cells; 0 for an edge on a boundary, on an interface or
                               with a ring longer than ``max_ring``
    """
    points, cells, regions = tets.points, tets.cells, tets.regions
    if place < 6:
        a, b, n = walk_ring(tets, c, place, max_ring, np.bool_(False), ring)
        if n < 3:
            return 0
        for m in range(n):
            cavity[m] = ring.cells[m]
        for x in range(3):
            points[p, x] = 0.5 * (points[a, x] + points[b, x])
        return n
    left_out = place - 6
    cavity[0] = c
    n = 1
    if left_out < 4:
        across = tets.neighbors[c, left_out]
        if across >= 0 and regions[across] == regions[c]:
            cavity[1] = across
            n = 2
    corners = 3.0 if left_out < 4 else 4.0
    for x in range(3):
        total = 0.0
        for i in range(4):
            if i != left_out:
                total += points[cells[c, i], x]
        points[p, x] = total / corners
    if left_out < 4 and n == 1:
        _rise(points, cells, c, left_out, p)
    return n


@kernel
def grow_cavity(tets: Tets, p: int, cavity: IntArray, n: int, cost: Cost) -> int:
    """Take cells in until the worst of the new cells is as good as in any cavity around this one.

    A better cavity holds the cell across the facet whose new cell is the worst, so that one is
    taken in, again and again, and the best of these cavities stays.  A cell with three facets on
    the cavity ends it: a vertex would be lost with it.

    Returns
    -------
    int    number of cells in the cavity
    """
    points, cells, neighbors, regions = tets.points, tets.cells, tets.neighbors, tets.regions
    label = regions[cavity[0]]
    least = np.inf
    size = n
    for _ in range(n, LARGEST_CAVITY + 1):
        worst = -1.0
        chosen = -1
        for m in range(n):
            c = cavity[m]
            for f in range(4):
                across = neighbors[c, f]
                if across >= 0 and is_in(across, cavity, n):
                    continue
                price = _cone_cost(points, cells, c, f, p, cost)
                if price > worst:
                    worst = price
                    chosen = across
        if worst < least:
            least = worst
            size = n
        if chosen < 0 or regions[chosen] != label or n == LARGEST_CAVITY:
            break
        shared = 0
        for g in range(4):
            across = neighbors[chosen, g]
            shared += across >= 0 and is_in(across, cavity, n)
        if shared > 2:
            break
        cavity[n] = chosen
        n += 1
    return size


@kernel
def join_facets(
    tets: Tets, p: int, cavity: IntArray, n: int, cost: Cost, new: IntArray
) -> tuple[float, int]:
    """Write the cells that join the facets of a cavity to vertex p inside it.

    Returns
    -------
    gain : float     cost before minus cost after, -inf when a facet does not face p
    n_new : int      number of cells in ``new``
    """
    points, cells, neighbors = tets.points, tets.cells, tets.neighbors
    gain = 0.0
    n_new = 0
    for m in range(n):
        c = cavity[m]
        gain += cell_cost(points, cells, c, cost)
        for f in range(4):
            across = neighbors[c, f]
            if across >= 0 and is_in(across, cavity, n):
                continue
            gain -= _cone_cost(points, cells, c, f, p, cost)
            _write_cone(cells, c, f, p, new[n_new])
            n_new += 1
    return gain, n_new


@kernel
def collapse_edge(
    tets: Tets, v: int, w: int, star: IntArray, n: int, cost: Cost, new: IntArray
) -> tuple[float, int]:
    """Write the cells that are left when vertex v is moved into its neighbour w.

    Parameters
    ----------
    star, n          cells around v

    Returns
    -------
    gain, n_new      as :func:`join_facets`
    """
    points, cells = tets.points, tets.cells
    gain = 0.0
    n_new = 0
    for m in range(n):
        c = star[m]
        gain += cell_cost(points, cells, c, cost)
        if is_in(w, cells[c], np.int64(4)):
            continue
        local = place_in(cells, c, v)
        gain -= _cone_cost(points, cells, c, local, w, cost)
        _write_cone(cells, c, local, w, new[n_new])
        n_new += 1
    return gain, n_new


@kernel
def best_collapse(
    tets: Tets, v: int, star: IntArray, n: int, cost: Cost, new: IntArray
) -> tuple[float, int]:
    """:func:`collapse_edge` for the neighbour of v that costs least; no cell when all fold."""
    best = -np.inf
    into = np.int32(-1)
    for m in range(n):
        for i in range(4):
            w = tets.cells[star[m], i]
            if w == v or w == into:
                continue
            gain, _ = collapse_edge(tets, v, w, star, n, cost, new)
            if gain > best:
                best = gain
                into = w
    if into < 0:
        return -np.inf, 0
    return collapse_edge(tets, v, into, star, n, cost, new)
