"""Planar edge flips in place: to Delaunay (Section 3.1), or to a better worst shape.

One queue of edges drives both.  An edge keeps its number when it is flipped, so that the cell
arrays are the only thing to update and a later pass can start from what changed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from odt_plugins.engine.cells.bounds import relaxed
from odt_plugins.engine.cells.tetrahedron import QUALITY
from odt_plugins.engine.cells.triangle import triangle_measure, triangle_shape
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.compiled.threads import PIECE
from odt_plugins.engine.topology.lookup import place_in
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
    guard = np.zeros(len(points), dtype=np.bool_) if fixed is None else fixed
    changed = np.zeros(len(cells), dtype=np.bool_)
    return _run(points, cells, neighbors, regions, active, None, guard, QUALITY, 0.0,
                np.array([fixed_floor, 1.0, -1.0]), not one_sweep, changed)


def quality_flips(
    points: FloatArray,
    cells: IntArray,
    neighbors: IntArray,
    regions: IntArray,
    movable_cells: BoolArray | None = None,
    power: float = 2.0,
    bounds: FloatArray | None = None,
    *,
    seeds: BoolArray | None = None,
    changed: BoolArray | None = None,
    objective: int = QUALITY,
) -> int:
    """Flip edges, in place, while the sum of m^-p over the two triangles falls.

    Parameters
    ----------
    points, cells, neighbors, regions    as for :func:`lawson_flips`
    movable_cells : (m,) bool   an edge is flipped only between two such cells; None means all
    power : float               p > 0
    bounds : (3,) float64       least radius ratio, largest and smallest cosine of an angle; a flip
                                that passes one of them and is worse there than the pair it
                                replaces is refused; None means no bounds
    seeds : (m,) bool           the first edges looked at are those of these cells; None means all
    changed : (m,) bool         set, in place, where a cell was replaced
    objective : int             measure m, see ``triangle_measure``; q of (5.1) unless given

    Returns
    -------
    int                         number of flips
    """
    if bounds is None:
        bounds = np.array([0.0, 1.0, -1.0])
    if changed is None:
        changed = np.zeros(len(cells), dtype=np.bool_)
    nothing = np.zeros(len(points), dtype=np.bool_)
    return _run(points, cells, neighbors, regions, movable_cells, seeds, nothing, objective, power,
                bounds, True, changed)


def _run(
    points: FloatArray, cells: IntArray, neighbors: IntArray, regions: IntArray,
    active: BoolArray | None, seeds: BoolArray | None, fixed: BoolArray,
    objective: int, power: float, bounds: FloatArray, repeat: bool, changed: BoolArray,
) -> int:
    """Number the edges, queue those of the seed cells and flip."""
    if len(cells) == 0:
        return 0
    if active is None:
        active = np.ones(len(cells), dtype=np.bool_)
    cell_edges, edge_cell = number_edges(neighbors)
    queued = np.zeros(len(edge_cell), dtype=np.bool_)
    queued[cell_edges if seeds is None else cell_edges[seeds]] = True
    queue = np.zeros(len(edge_cell), dtype=np.int32)
    first = np.flatnonzero(queued).astype(np.int32)
    queue[: len(first)] = first
    return work_off(len(first), len(queue), lambda waiting: _flip_edges(
        points, cells, neighbors, regions, active, fixed, cell_edges, edge_cell, queue, queued,
        waiting, PIECE, objective, power, bounds, repeat, changed,
    ))


def work_off(count: int, edges: int, flip_some: Callable[[LongArray], int]) -> int:
    """Flip until no edge waits, or FLIPS an edge were made.

    Parameters
    ----------
    count : int              edges that wait at first, from the start of the queue on
    edges : int              length of the queue, a ring
    flip_some : callable     visits some of them, and keeps ``waiting`` (2,) up to date: the place
                             of the first edge that waits, and how many do; returns its flips

    Returns
    -------
    int                      number of flips
    """
    waiting = np.array([0, count], dtype=np.int64)
    flips = 0
    while waiting[1] > 0 and flips < FLIPS * edges:
        flips += int(flip_some(waiting))
    return flips


def number_edges(neighbors: IntArray) -> tuple[IntArray, IntArray]:
    """Number of the edge opposite each vertex of every cell, (m, 3), and a cell of each, (e,)."""
    cell_edges = np.empty(neighbors.shape, dtype=np.int32)
    edge_cell = np.empty(neighbors.size, dtype=np.int32)
    count = _number_edges(neighbors, cell_edges, edge_cell)
    return cell_edges, edge_cell[:count]


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
    points: FloatArray, cells: IntArray, neighbors: IntArray, regions: IntArray,
    active: BoolArray, fixed: BoolArray, cell_edges: IntArray, edge_cell: IntArray,
    queue: IntArray, queued: BoolArray, waiting: LongArray, most: int, objective: int,
    power: float, bounds: FloatArray, repeat: bool, changed: BoolArray,
) -> int:
    """Visit at most ``most`` edges; after a flip the four edges around it are looked at again.

    power = 0 flips to Delaunay with the guard for fixed vertices, power > 0 for the sum of m^-p.
    ``waiting`` as in :func:`work_off`.
    """
    head, size = waiting[0], waiting[1]
    flips = 0
    for _ in range(min(size, most)):
        e = queue[head]
        head = (head + 1) % len(queue)
        size -= 1
        queued[e] = False
        t = edge_cell[e]
        i = place_in(cell_edges, t, e)
        s = neighbors[t, i]
        if s < 0 or regions[s] != regions[t] or not (active[t] and active[s]):
            continue
        j = place_in(cell_edges, s, e)
        a = cells[t, i]
        b = cells[t, (i + 1) % 3]
        c = cells[t, (i + 2) % 3]
        d = cells[s, j]
        if not (_is_wide(points, a, b, d) and _is_wide(points, a, d, c)):
            continue
        if power > 0.0:
            if not _shapes_improve(points, a, b, c, d, objective, power, bounds):
                continue
        elif not _in_circle(points, a, b, c, d) or not _guard_agrees(
            points, fixed, a, b, c, d, bounds[0]
        ):
            continue
        flip(cells, neighbors, cell_edges, edge_cell, t, i, s, j)
        changed[t] = True
        changed[s] = True
        flips += 1
        if repeat:
            size = queue_around(cell_edges, t, s, queue, queued, head, size)
    waiting[0], waiting[1] = head, size
    return flips


@kernel
def queue_around(
    cell_edges: IntArray, t: int, s: int, queue: IntArray, queued: BoolArray, head: int, size: int
) -> int:
    """Queue the four edges around the one that was just flipped between triangles t and s.

    Parameters
    ----------
    queue : (e,) int32     ring of edges; from ``head`` on, ``size`` of them wait
    queued : (e,) bool     edges that wait, or never shall; kept up to date

    Returns
    -------
    int                    how many wait then
    """
    for cell in (t, s):
        for k in range(3):
            near = cell_edges[cell, k]
            if near != cell_edges[t, 1] and not queued[near]:
                queued[near] = True
                queue[(head + size) % len(queue)] = near
                size += 1
    return size


@kernel
def flip(
    cells: IntArray, neighbors: IntArray, cell_edges: IntArray, edge_cell: IntArray,
    t: int, i: int, s: int, j: int,
) -> None:
    """Replace (a, b, c) in slot t and (d, c, b) in slot s by (a, b, d) and (a, d, c)."""
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
    if across_bd >= 0:
        for k in range(3):
            if cell_edges[across_bd, k] == edge_bd:
                neighbors[across_bd, k] = t
    if across_ca >= 0:
        for k in range(3):
            if cell_edges[across_ca, k] == edge_ca:
                neighbors[across_ca, k] = s


@kernel
def _is_wide(points: FloatArray, a: int, b: int, c: int) -> bool:
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
    """Whether d lies in the circumcircle of the counterclockwise (a, b, c), beyond rounding."""
    ax = points[a, 0] - points[d, 0]
    ay = points[a, 1] - points[d, 1]
    bx = points[b, 0] - points[d, 0]
    by = points[b, 1] - points[d, 1]
    cx = points[c, 0] - points[d, 0]
    cy = points[c, 1] - points[d, 1]
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
        new = min(new, triangle_shape(points, a, b, d)[0])
    if fixed[c]:
        new = min(new, triangle_shape(points, a, d, c)[0])
    if fixed[b] and fixed[c]:
        old = min(triangle_shape(points, a, b, c)[0], triangle_shape(points, d, c, b)[0])
    else:
        old = max(
            floor,
            min(triangle_shape(points, a, b, c)[0], triangle_shape(points, d, c, b)[0]),
        )
    return new >= old


@kernel
def _shapes_improve(
    points: FloatArray, a: int, b: int, c: int, d: int, objective: int, power: float,
    bounds: FloatArray,
) -> bool:
    """Whether the flip lowers the sum of m^-p and respects the bounds."""
    q1, large1, small1 = triangle_shape(points, a, b, c)
    q2, large2, small2 = triangle_shape(points, d, c, b)
    q3, large3, small3 = triangle_shape(points, a, b, d)
    q4, large4, small4 = triangle_shape(points, a, d, c)
    worst = min(q3, q4)
    if not worst > 0.0:
        return False
    least, most, fewest = relaxed(
        bounds, min(q1, q2), max(large1, large2), min(small1, small2)
    )
    if worst < least or max(large3, large4) > most or min(small3, small4) < fewest:
        return False
    if not min(q1, q2) > 0.0:
        return True
    if objective != QUALITY:
        q1 = triangle_measure(points, a, b, c, objective)
        q2 = triangle_measure(points, d, c, b, objective)
        q3 = triangle_measure(points, a, b, d, objective)
        q4 = triangle_measure(points, a, d, c, objective)
    return bool(q3**-power + q4**-power < (1.0 - GAIN) * (q1**-power + q2**-power))
