"""Planar edge flips in place: to Delaunay (Section 3.1), or to a better worst shape.

One queue of edges drives both.  An edge keeps its number when it is flipped, so that the cell
arrays are the only thing to update and a later pass can start from what changed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.cost import ENERGY, Cost, is_energy
from odt_plugins.engine.cells.extremes import FREELY, Extremes, keeps, worse
from odt_plugins.engine.cells.measures import triangle_state
from odt_plugins.engine.cells.metric import has_metric, tet_root, through
from odt_plugins.engine.cells.triangle import triangle_extremes
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.compiled.threads import PIECE
from odt_plugins.engine.topology.lookup import place_in
from odt_plugins.engine.topology.triangles import EdgeNumbers, Triangles
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray, LongArray

FLAT = 1e-12
"""A triangle is flat when twice its area is below this times its longest squared edge."""
IN_CIRCLE = 1e-12
"""The in-circle determinant counts as positive above this times the sum of its terms."""
GAIN = 1e-9
"""Least relative fall of the sum of m^-p for which an edge is flipped."""
FLIPS = 100
"""Most flips an edge, on average, before a queue is left as it is: exact sums fall with every flip,
rounded ones of flat triangles may go round in a circle."""

def lawson_flips(
    points: FloatArray,
    cells: IntArray,
    neighbors: IntArray,
    regions: IntArray,
    *,
    one_sweep: bool = False,
    active: BoolArray | None = None,
    fixed: BoolArray | None = None,
    fixed_floor: float = 0.3,
) -> int:
    """Flip edges that are not locally Delaunay, in place, until none is left (Section 3.1).

    The ODT energy with uniform density falls by a sixth of the in-circle determinant at every
    flip, so the loop ends.  Boundary edges and edges between two regions stay.

    Parameters
    ----------
    points : (n, 2) float64
    cells : (m, 3) int32        counterclockwise; changed in place
    neighbors : (m, 3) int32    cell across the edge opposite each vertex, -1 at the boundary;
                                changed in place
    regions : (m,) int32        region labels; a cell's label does not change
    one_sweep : bool            visit every edge once, as the loop of Section 5 does
    active : (m,) bool          an edge is flipped only between two such cells; None means all
    fixed : (n,) bool           vertices that never move: a triangle of three of them must be no
                                worse than the worst such triangle it replaces, or, where there
                                was none, than the worse of the pair and ``fixed_floor``
    fixed_floor : float         radius ratio

    Returns
    -------
    int                         number of flips

    References
    ----------
    L. Chen, M. Holst, CMAME 200 (2011) 967-984, Sections 3.1 and 5.
    """
    mesh = Triangles(points, cells, neighbors, regions)
    guard = np.zeros(len(points), dtype=np.bool_) if fixed is None else fixed
    limit = FREELY._replace(quality=fixed_floor)
    rule = Rule(Cost(ENERGY, 1.0), limit, _or_all(active, cells), guard, not one_sweep)
    return _run(mesh, rule, None, np.zeros(len(cells), dtype=np.bool_))


def quality_flips(
    mesh: Triangles,
    cost: Cost,
    bounds: Extremes = FREELY,
    *,
    movable_cells: BoolArray | None = None,
    seeds: BoolArray | None = None,
    changed: BoolArray | None = None,
) -> int:
    """Flip edges, in place, while the sum of m^-p over the two triangles falls.

    Parameters
    ----------
    mesh : Triangles            changed
    cost : Cost                 measure m, see ``measures.triangle_measure``, and p > 0
    bounds : Extremes           a flip that passes one of them and is worse there than the pair it
                                replaces is refused
    movable_cells : (m,) bool   an edge is flipped only between two such cells; None means all
    seeds : (m,) bool           the first edges looked at are those of these cells; None means all
    changed : (m,) bool         set, in place, where a cell was replaced

    Returns
    -------
    int                         number of flips
    """
    if changed is None:
        changed = np.zeros(len(mesh.cells), dtype=np.bool_)
    guard = np.zeros(len(mesh.points), dtype=np.bool_)
    rule = Rule(cost, bounds, _or_all(movable_cells, mesh.cells), guard, True)
    return _run(mesh, rule, seeds, changed)


def _or_all(chosen: BoolArray | None, cells: IntArray) -> BoolArray:
    return np.ones(len(cells), dtype=np.bool_) if chosen is None else chosen


class Rule(NamedTuple):
    """Which edges are flipped.

    Attributes
    ----------
    cost : Cost           the energy of ODT, or a measure and p of the sum of m^-p that must fall
    limit : Extremes      that no new triangle passes; for the energy its quality is the least of
                          one of guarded vertices
    active : (m,) bool    both cells of an edge must be such
    guarded : (n,) bool   vertices that never move
    repeat : bool         look again at the edges around one that was flipped
    """

    cost: Cost
    limit: Extremes
    active: BoolArray
    guarded: BoolArray
    repeat: bool


class Queue(NamedTuple):
    """EdgeNumbers that wait to be looked at.

    Attributes
    ----------
    ring : (e,) int32       a ring of numbers of edges
    waits : (e,) bool       edges that wait, or never shall
    ends : (2,) int64       place in the ring of the first edge that waits, and how many do
    """

    ring: IntArray
    waits: BoolArray
    ends: LongArray


def make_queue(waits: BoolArray) -> Queue:
    """Let some of the edges, (e,) bool, wait in order of their numbers."""
    first = np.flatnonzero(waits).astype(np.int32)
    ring = np.zeros(len(waits), dtype=np.int32)
    ring[: len(first)] = first
    return Queue(ring, waits, np.array([0, len(first)], dtype=np.int64))


def _run(mesh: Triangles, rule: Rule, seeds: BoolArray | None, changed: BoolArray) -> int:
    """Number the edges, queue those of the seed cells and flip."""
    if len(mesh.cells) == 0:
        return 0
    edges = number_edges(mesh.neighbors)
    waits = np.zeros(len(edges.cell), dtype=np.bool_)
    waits[edges.of_cell if seeds is None else edges.of_cell[seeds]] = True
    queue = make_queue(waits)
    return work_off(queue, lambda: _flip_edges(mesh, edges, queue, PIECE, rule, changed))


def work_off(queue: Queue, flip_some: Callable[[], int]) -> int:
    """Flip until no edge waits, or FLIPS an edge were made.

    Parameters
    ----------
    queue : Queue
    flip_some : callable     visits some of the edges that wait; returns its flips

    Returns
    -------
    int                      number of flips
    """
    flips = 0
    while queue.ends[1] > 0 and flips < FLIPS * len(queue.ring):
        flips += int(flip_some())
    return flips


def number_edges(neighbors: IntArray) -> EdgeNumbers:
    """Give every edge a number."""
    cell_edges = np.empty(neighbors.shape, dtype=np.int32)
    edge_cell = np.empty(neighbors.size, dtype=np.int32)
    count = _number_edges(neighbors, cell_edges, edge_cell)
    return EdgeNumbers(cell_edges, edge_cell[:count])


@kernel
def _number_edges(neighbors: IntArray, cell_edges: IntArray, edge_cell: IntArray) -> int:
    """Give every edge a number, the same from both sides; return how many there are."""
    count = 0
    for t in range(neighbors.shape[0]):
        for i in range(3):
            s = neighbors[t, i]
            if s < 0 or s > t:
                cell_edges[t, i] = count
                edge_cell[count] = t
                count += 1
            else:
                for j in range(3):
                    if neighbors[s, j] == t:
                        cell_edges[t, i] = cell_edges[s, j]
    return count


@kernel
def _flip_edges(
    mesh: Triangles, edges: EdgeNumbers, queue: Queue, most: int, rule: Rule, changed: BoolArray
) -> int:
    """Visit at most ``most`` edges; after a flip the four edges around it are looked at again."""
    points, cells, neighbors, regions = mesh
    active = rule.active
    flips = 0
    for _ in range(min(queue.ends[1], most)):
        e = first_waiting(queue)
        t = edges.cell[e]
        i = place_in(edges.of_cell, t, e)
        s = neighbors[t, i]
        if s < 0 or regions[s] != regions[t] or not (active[t] and active[s]):
            continue
        j = place_in(edges.of_cell, s, e)
        a = cells[t, i]
        b = cells[t, (i + 1) % 3]
        c = cells[t, (i + 2) % 3]
        d = cells[s, j]
        if not (is_wide(points, a, b, d) and is_wide(points, a, d, c)):
            continue
        if not is_energy(rule.cost.objective):
            if not shapes_improve(points, a, b, c, d, rule.cost, rule.limit):
                continue
        elif not _in_circle(points, a, b, c, d) or not _guard_agrees(
            points, rule.guarded, a, b, c, d, rule.limit.quality
        ):
            continue
        flip(cells, neighbors, edges, t, i, s, j)
        changed[t] = True
        changed[s] = True
        flips += 1
        if rule.repeat:
            queue_around(edges, t, s, queue)
    return flips


@kernel
def first_waiting(queue: Queue) -> int:
    """Take the edge out of the queue that has waited longest; there must be one."""
    ends = queue.ends
    e = queue.ring[ends[0]]
    ends[0] = (ends[0] + 1) % len(queue.ring)
    ends[1] -= 1
    queue.waits[e] = False
    return e


@kernel
def queue_around(edges: EdgeNumbers, t: int, s: int, queue: Queue) -> None:
    """Queue the four edges around the one that was just flipped between triangles t and s."""
    ring, waits, ends = queue
    for cell in (t, s):
        for k in range(3):
            near = edges.of_cell[cell, k]
            if near != edges.of_cell[t, 1] and not waits[near]:
                waits[near] = True
                ring[(ends[0] + ends[1]) % len(ring)] = near
                ends[1] += 1


@kernel
def _tell_across(
    neighbors: IntArray, cell_edges: IntArray, across: int, edge: int, t: int
) -> None:
    """Make t the neighbor of the triangle across an edge; nothing beyond the boundary."""
    if across >= 0:
        for k in range(3):
            if cell_edges[across, k] == edge:
                neighbors[across, k] = t


@kernel
def flip(
    cells: IntArray, neighbors: IntArray, edges: EdgeNumbers, t: int, i: int, s: int, j: int
) -> None:
    """Replace (a, b, c) in slot t and (d, c, b) in slot s by (a, b, d) and (a, d, c)."""
    cell_edges, edge_cell = edges
    i1 = (i + 1) % 3
    i2 = (i + 2) % 3
    j1 = (j + 1) % 3
    j2 = (j + 2) % 3
    a = cells[t, i]
    b = cells[t, i1]
    c = cells[t, i2]
    d = cells[s, j]
    shared = cell_edges[t, i]
    # (d, c, b) is counterclockwise: j1 is c, j2 is b
    across_ca = neighbors[t, i1]
    across_ab = neighbors[t, i2]
    across_bd = neighbors[s, j1]
    across_dc = neighbors[s, j2]
    edge_ca = cell_edges[t, i1]
    edge_ab = cell_edges[t, i2]
    edge_bd = cell_edges[s, j1]
    edge_dc = cell_edges[s, j2]
    cells[t, 0] = a
    cells[t, 1] = b
    cells[t, 2] = d
    cells[s, 0] = a
    cells[s, 1] = d
    cells[s, 2] = c
    neighbors[t, 0] = across_bd
    neighbors[t, 1] = s
    neighbors[t, 2] = across_ab
    neighbors[s, 0] = across_dc
    neighbors[s, 1] = across_ca
    neighbors[s, 2] = t
    cell_edges[t, 0] = edge_bd
    cell_edges[t, 1] = shared
    cell_edges[t, 2] = edge_ab
    cell_edges[s, 0] = edge_dc
    cell_edges[s, 1] = edge_ca
    cell_edges[s, 2] = shared
    edge_cell[shared] = t
    edge_cell[edge_bd] = t
    edge_cell[edge_ca] = s
    _tell_across(neighbors, cell_edges, across_bd, edge_bd, t)
    _tell_across(neighbors, cell_edges, across_ca, edge_ca, s)


@kernel
def take_back_flip(
    cells: IntArray, neighbors: IntArray, edges: EdgeNumbers, t: int, i: int, s: int, j: int
) -> None:
    """Undo the :func:`flip` with the same arguments, which must have been the last around it."""
    cell_edges, edge_cell = edges
    i1 = (i + 1) % 3
    i2 = (i + 2) % 3
    j1 = (j + 1) % 3
    j2 = (j + 2) % 3
    a, b, d = cells[t, 0], cells[t, 1], cells[t, 2]
    c = cells[s, 2]
    across_bd, across_ab = neighbors[t, 0], neighbors[t, 2]
    across_dc, across_ca = neighbors[s, 0], neighbors[s, 1]
    edge_bd, shared, edge_ab = cell_edges[t, 0], cell_edges[t, 1], cell_edges[t, 2]
    edge_dc, edge_ca = cell_edges[s, 0], cell_edges[s, 1]
    cells[t, i], cells[t, i1], cells[t, i2] = a, b, c
    cells[s, j], cells[s, j1], cells[s, j2] = d, c, b
    neighbors[t, i], neighbors[t, i1], neighbors[t, i2] = s, across_ca, across_ab
    neighbors[s, j], neighbors[s, j1], neighbors[s, j2] = t, across_bd, across_dc
    cell_edges[t, i], cell_edges[t, i1], cell_edges[t, i2] = shared, edge_ca, edge_ab
    cell_edges[s, j], cell_edges[s, j1], cell_edges[s, j2] = shared, edge_bd, edge_dc
    edge_cell[edge_bd] = s
    edge_cell[edge_ca] = t
    _tell_across(neighbors, cell_edges, across_bd, edge_bd, s)
    _tell_across(neighbors, cell_edges, across_ca, edge_ca, t)


@kernel
def is_wide(points: FloatArray, a: int, b: int, c: int) -> bool:
    """Whether (a, b, c) is counterclockwise and not flat."""
    ux = points[b, 0] - points[a, 0]
    uy = points[b, 1] - points[a, 1]
    vx = points[c, 0] - points[a, 0]
    vy = points[c, 1] - points[a, 1]
    wx = vx - ux
    wy = vy - uy
    longest = max(ux * ux + uy * uy, vx * vx + vy * vy, wx * wx + wy * wy)
    return bool(ux * vy - uy * vx > FLAT * longest)


@kernel
def _in_circle(points: FloatArray, a: int, b: int, c: int, d: int) -> bool:
    """Whether d lies in the circumcircle of the counterclockwise (a, b, c), beyond rounding.

    In a metric all four are seen through their mean.
    """
    ax = points[a, 0] - points[d, 0]
    ay = points[a, 1] - points[d, 1]
    bx = points[b, 0] - points[d, 0]
    by = points[b, 1] - points[d, 1]
    cx = points[c, 0] - points[d, 0]
    cy = points[c, 1] - points[d, 1]
    if has_metric(points):
        root = tet_root(points, a, b, c, d)
        ax, ay, _ = through(root, ax, ay, 0.0)
        bx, by, _ = through(root, bx, by, 0.0)
        cx, cy, _ = through(root, cx, cy, 0.0)
    aa = ax * ax + ay * ay
    bb = bx * bx + by * by
    cc = cx * cx + cy * cy
    value = aa * (bx * cy - by * cx) + bb * (cx * ay - cy * ax) + cc * (ax * by - ay * bx)
    size = (
        aa * (abs(bx * cy) + abs(by * cx))
        + bb * (abs(cx * ay) + abs(cy * ax))
        + cc * (abs(ax * by) + abs(ay * bx))
    )
    return bool(value > IN_CIRCLE * size)


@kernel
def _guard_agrees(
    points: FloatArray, fixed: BoolArray, a: int, b: int, c: int, d: int, floor: float
) -> bool:
    """Whether no new triangle of fixed vertices is worse than what it replaces."""
    if not (fixed[a] and fixed[d] and (fixed[b] or fixed[c])):
        return True
    new = 2.0
    if fixed[b]:
        new = min(new, triangle_extremes(points, a, b, d).quality)
    if fixed[c]:
        new = min(new, triangle_extremes(points, a, d, c).quality)
    old = min(
        triangle_extremes(points, a, b, c).quality, triangle_extremes(points, d, c, b).quality
    )
    return new >= (old if fixed[b] and fixed[c] else max(floor, old))


@kernel
def shapes_improve(
    points: FloatArray, a: int, b: int, c: int, d: int, cost: Cost, limit: Extremes
) -> bool:
    """Whether the flip lowers the sum of m^-p and respects the bounds."""
    m = cost.objective
    m1, first = triangle_state(points, a, b, c, m)
    m2, second = triangle_state(points, d, c, b, m)
    m3, third = triangle_state(points, a, b, d, m)
    m4, fourth = triangle_state(points, a, d, c, m)
    before, after = worse(first, second), worse(third, fourth)
    if not after.quality > 0.0 or not keeps(after, worse(limit, before)):
        return False
    if not before.quality > 0.0:
        return True
    p = cost.power
    return bool(m3**-p + m4**-p < (1.0 - GAIN) * (m1**-p + m2**-p))
