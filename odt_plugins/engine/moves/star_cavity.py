"""Cavities that are star-shaped from a point, and the cells that join their facets to it.

A set of cells whose facets all face the point is filled exactly once by the cells that join the
facets to it.  It is grown cell by cell as long as the sum of all costs falls, a descent in the
place of the search for the largest worst quality in B. M. Klingner, J. R. Shewchuk, Aggressive
tetrahedral mesh improvement, 16th International Meshing Roundtable (2007) 3-23, Section 3.3.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.tetrahedron import Cost, cell_cost, tet_cost
from odt_plugins.engine.compiled.kernel import inner_kernel
from odt_plugins.engine.moves.cavity import Ring, walk_ring
from odt_plugins.engine.topology.lookup import is_in, place_in
from odt_plugins.engine.topology.tets import Tets
from odt_plugins.mesh.arrays import FloatArray, IntArray

LARGEST_CAVITY = 32
"""Cells at which a cavity stops growing."""
PLACES = 11
"""Where a vertex may come into a cell: on its 6 edges, on its 4 facets, in its middle."""


@inner_kernel
def _cone_cost(
    points: FloatArray, cells: IntArray, c: int, f: int, p: int, cost: Cost
) -> float:
    """Cost of cell c with vertex p in the place of its local vertex f."""
    i = p if f == 0 else cells[c, 0]
    j = p if f == 1 else cells[c, 1]
    k = p if f == 2 else cells[c, 2]
    l = p if f == 3 else cells[c, 3]
    return tet_cost(points, i, j, k, l, cost)


@inner_kernel
def _write_cone(cells: IntArray, c: int, f: int, p: int, out: IntArray) -> None:
    """Write cell c with vertex p in the place of its local vertex f."""
    for i in range(4):
        out[i] = cells[c, i]
    out[f] = p


@inner_kernel
def seed_cavity(
    tets: Tets, c: int, place: int, p: int, max_ring: int, ring: Ring, cavity: IntArray
) -> int:
    """Put vertex p in the middle of an edge, of a facet or of cell c; the cells that contain it.

    Parameters
    ----------
    place : int                below PLACES: edge, facet or cell
    ring : Ring                room for the cells around an edge
    cavity : (k,) int32        the cells are written here

    Returns
    -------
    int                        number of cells; 0 on a boundary, on an interface or when the ring
                               of the edge is longer than ``max_ring``
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
        if across < 0 or regions[across] != regions[c]:
            return 0
        cavity[1] = across
        n = 2
    corners = 3.0 if left_out < 4 else 4.0
    for x in range(3):
        total = 0.0
        for i in range(4):
            if i != left_out:
                total += points[cells[c, i], x]
        points[p, x] = total / corners
    return n


@inner_kernel
def grow_cavity(tets: Tets, p: int, cavity: IntArray, n: int, cost: Cost) -> int:
    """Take in the cell across a facet that lowers the sum of the costs most, while there is one.

    A cell with three facets on the cavity stays outside: a vertex would be lost with it.

    Returns
    -------
    int    number of cells in the cavity, at most LARGEST_CAVITY
    """
    points, cells, neighbors, regions = tets.points, tets.cells, tets.neighbors, tets.regions
    label = regions[cavity[0]]
    for _ in range(n, LARGEST_CAVITY):
        best = 0.0
        chosen = -1
        for m in range(n):
            for f in range(4):
                t = neighbors[cavity[m], f]
                if t < 0 or regions[t] != label or is_in(t, cavity, n):
                    continue
                shared = 0
                gain = cell_cost(points, cells, t, cost)
                for g in range(4):
                    across = neighbors[t, g]
                    if across < 0 or not is_in(across, cavity, n):
                        gain -= _cone_cost(points, cells, t, g, p, cost)
                        continue
                    shared += 1
                    for h in range(4):
                        if neighbors[across, h] == t:
                            gain += _cone_cost(points, cells, across, h, p, cost)
                if shared < 3 and gain > best and gain < np.inf:
                    best = gain
                    chosen = t
        if chosen < 0:
            break
        cavity[n] = chosen
        n += 1
    return n


@inner_kernel
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


@inner_kernel
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


@inner_kernel
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
