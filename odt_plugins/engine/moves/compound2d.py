"""Compound moves of triangles: a forced flip, a local descent, and back if it did not pay.

Single flips stop in local minima of F_p.  Here one flip at a bad triangle is taken whatever it
costs, if it brings no degree further from what the angle around the vertex has room for; Newton
steps then descend around it, ring after ring.  A Newton step divides a sum of m^-p by about e
whatever p, so a descent for a large p starts with a smaller one.  Of a surface in space the
vertices move in the tangent planes of their stars.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Extremes, keeps, worse
from odt_plugins.engine.cells.measures import triangle_measure
from odt_plugins.engine.cells.metric import has_metric, in_space, through, triangle_root
from odt_plugins.engine.cells.triangle import triangle_extremes
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.compiled.threads import pieces
from odt_plugins.engine.moves.flips2d import (
    Rule,
    flip,
    is_wide,
    take_back_flip,
)
from odt_plugins.engine.moves.newton2d import newton_vertex_2d
from odt_plugins.engine.topology.lookup import is_in, place_in
from odt_plugins.engine.topology.triangles import EdgeNumbers, Triangles
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray, LongArray

MOST_TOUCHED = 64
"""Cells that a descent may touch."""
DEEP = (3.0, 1.0, 0.35, 0.25, 0.1, 0.0)
"""After sweep k a descent is abandoned if its loss exceeds DEEP[k] x the cost of the bad triangle,
with p as in that sweep; every other sweep reaches one ring of cells further."""
START = 4.0
"""Largest p of the first two sweeps of a descent, which doubles every other sweep up to its own."""
LARGEST_STAR = 32
"""Cells around a vertex; one with more is left alone."""
HOPELESS = 200.0
"""A forced flip may raise F_p by this many times the bad triangle's own cost, p as at the start."""
LEVEL = 0.01
"""By how little, halved, the sum of the squares of the excess degrees may grow: rounding of angles
does not decide."""
ROUNDED = 1e-14
"""Rounding of extremes that decides nothing."""
GAIN = 0.03
"""Least gain, as part of the bad triangle's own cost, for which a compound move stays."""


class Scratch(NamedTuple):
    """Room in which to descend and go back; made by :func:`make_scratch`.

    Attributes
    ----------
    derivatives : (5,) float64                 of F_p in the place of a vertex
    axes : (2, d) float64                      orthonormal directions of a plane
    star : (LARGEST_STAR,) int32               cells around a vertex
    touched : (MOST_TOUCHED,) int32            cells that a descent changed
    before : (MOST_TOUCHED,) float64           their measures before it
    seen : (MOST_TOUCHED,) int32               vertices that were visited in a sweep
    moved : (6 MOST_TOUCHED,) int32            vertices, in the order of their moves
    origin : (6 MOST_TOUCHED, d) float64       where they were before
    feet : (6 MOST_TOUCHED,) int32             on a surface, triangles of the ground under them then
    counts : (2,) int64                        of touched cells and of moves
    """

    derivatives: FloatArray
    axes: FloatArray
    star: IntArray
    touched: IntArray
    before: FloatArray
    seen: IntArray
    moved: IntArray
    origin: FloatArray
    feet: IntArray
    counts: LongArray


TOUCHED, MOVED = 0, 1
"""Places in ``Scratch.counts``."""


@allocating_kernel
def make_scratch(dim: int) -> Scratch:
    """Room for one thread."""
    return Scratch(
        np.empty(5), np.eye(2, dim), np.empty(LARGEST_STAR, np.int32),
        np.empty(MOST_TOUCHED, np.int32), np.empty(MOST_TOUCHED), np.empty(MOST_TOUCHED, np.int32),
        np.empty(len(DEEP) * MOST_TOUCHED, np.int32),
        np.empty((len(DEEP) * MOST_TOUCHED, dim)),
        np.empty(len(DEEP) * MOST_TOUCHED, np.int32), np.zeros(2, np.int64),
    )


@kernel
def gather_star_2d(cells: IntArray, neighbors: IntArray, t: int, v: int, star: IntArray) -> int:
    """Cells around vertex v, counterclockwise from t on; 0 at the boundary or if too many."""
    now = t
    for n in range(star.shape[0]):
        star[n] = now
        now = neighbors[now, (place_in(cells, now, v) + 1) % 3]
        if now < 0:
            return 0
        if now == t:
            return n + 1
    return 0


@kernel
def _touch(mesh: Triangles, objective: int, scratch: Scratch, t: int) -> None:
    """Add a cell that is about to change to the touched ones, once."""
    n = scratch.counts[TOUCHED]
    if n < MOST_TOUCHED and not is_in(t, scratch.touched, n):
        a, b, c = mesh.cells[t, 0], mesh.cells[t, 1], mesh.cells[t, 2]
        scratch.touched[n] = t
        scratch.before[n] = triangle_measure(mesh.points, a, b, c, objective)
        scratch.counts[TOUCHED] += 1


@kernel
def _cost(points: FloatArray, a: int, b: int, c: int, cost: Cost) -> float:
    m = triangle_measure(points, a, b, c, cost.objective)
    return m**-cost.power if m > 0.0 else np.inf


@kernel
def _at_turn(cost: Cost, turn: int) -> Cost:
    """What a sweep of a descent lowers."""
    return Cost(cost.objective, min(cost.power, START * 2.0 ** (turn // 2)))


def excess_degrees(mesh: Triangles) -> FloatArray:
    """Triangles around every vertex beyond those of 60 degrees for which there is room, (n,)."""
    excess = np.zeros(len(mesh.points))
    for first, last in pieces(0, len(mesh.cells)):
        _add_excess(mesh.points, mesh.cells[first:last], excess)
    return excess


@kernel
def _add_excess(points: FloatArray, cells: IntArray, excess: FloatArray) -> None:
    """Add 1 less the angle over 60 degrees for every corner of the cells."""
    for t in range(cells.shape[0]):
        for k in range(3):
            a, b, c = cells[t, k], cells[t, (k + 1) % 3], cells[t, (k + 2) % 3]
            excess[a] += 1.0 - 3.0 / math.pi * _angle(points, a, b, c)


@kernel
def _angle(points: FloatArray, a: int, b: int, c: int) -> float:
    """Angle at a, as it is seen; negative in the plane where (a, b, c) is not counterclockwise."""
    space = in_space(points)
    ux, uy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    vx, vy = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
    uz = points[b, 2] - points[a, 2] if space else 0.0
    vz = points[c, 2] - points[a, 2] if space else 0.0
    if has_metric(points):
        root = triangle_root(points, a, b, c)
        ux, uy, uz = through(root, ux, uy, uz)
        vx, vy, vz = through(root, vx, vy, vz)
    along, across = ux * vx + uy * vy, ux * vy - uy * vx
    if space:
        x, y = uy * vz - uz * vy, uz * vx - ux * vz
        along += uz * vz
        across = math.sqrt(x * x + y * y + across * across)
    return math.atan2(across, along)


class ForcedFlip(NamedTuple):
    """A flip that is taken although it costs something.

    Attributes
    ----------
    t, i, s, j : int    the two cells, and their corners opposite of the edge
    loss : float        growth of F_p, p as at the start; infinite where the edge must stay
    """

    t: int
    i: int
    s: int
    j: int
    loss: float


@kernel
def forced_flip(
    mesh: Triangles, edges: EdgeNumbers, bad: int, op: int, rule: Rule, excess: FloatArray
) -> ForcedFlip:
    """One of the nine flips of the edges of a bad cell and of those beside it.

    The edge stays where the sum of the squares of the excess degrees would grow, or F_p too much.
    """
    points, cells, neighbors, regions = mesh
    # sums with a number are of 64 bits, as the other places of a ForcedFlip are
    t, i = 0 + bad, op
    if op >= 3:
        k = (op - 3) // 2
        t = 0 + neighbors[bad, k]
        if t >= 0:
            i = (place_in(edges.of_cell, t, edges.of_cell[bad, k]) + 1 + op % 2) % 3
    s = 0 + neighbors[t, i] if t >= 0 else t
    j, loss = 0, np.inf
    if s >= 0 and regions[s] == regions[t] and rule.active[t] and rule.active[s]:
        j = place_in(edges.of_cell, s, edges.of_cell[t, i])
        a, b, c, d = cells[t, i], cells[t, (i + 1) % 3], cells[t, (i + 2) % 3], cells[s, j]
        if excess[a] + excess[d] - excess[b] - excess[c] + 2.0 <= LEVEL and (
            in_space(points) or (is_wide(points, a, b, d) and is_wide(points, a, d, c))
        ):
            cost = _at_turn(rule.cost, 0)
            x, y, z = cells[bad, 0], cells[bad, 1], cells[bad, 2]
            loss = (
                _cost(points, a, b, d, cost) + _cost(points, a, d, c, cost)
                - _cost(points, a, b, c, cost) - _cost(points, d, c, b, cost)
            )
            if not loss < HOPELESS * _cost(points, x, y, z, cost):
                loss = np.inf
    return ForcedFlip(t, i, s, j, loss)


@kernel
def _sweep(
    mesh: Triangles, rule: Rule, cost: Cost, known: int, scratch: Scratch
) -> float:
    """Newton steps of the vertices of the first ``known`` touched cells; returns what they gain."""
    points, cells, neighbors, _ = mesh
    total = 0.0
    n_seen = 0
    for m in range(known):
        for k in range(3):
            t = scratch.touched[m]
            v = cells[t, k]
            if rule.guarded[v] or n_seen == MOST_TOUCHED or is_in(v, scratch.seen, n_seen):
                continue
            scratch.seen[n_seen] = v
            n_seen += 1
            size = gather_star_2d(cells, neighbors, t, v, scratch.star)
            n = scratch.counts[MOVED]
            scratch.moved[n] = v
            for d in range(scratch.origin.shape[1]):
                scratch.origin[n, d] = points[v, d]
            n_touched = scratch.counts[TOUCHED]
            for s in range(size):
                _touch(mesh, cost.objective, scratch, scratch.star[s])
            before, after = newton_vertex_2d(
                points, cells, scratch.star[:size], v, cost, rule.limit, scratch.derivatives,
                scratch.axes,
            )
            if after < before:
                total += before - after
                scratch.counts[MOVED] += 1
            else:
                scratch.counts[TOUCHED] = n_touched
    return total


@kernel
def touched_shape(mesh: Triangles, cost: Cost, scratch: Scratch) -> tuple[float, Extremes]:
    """F_p of the touched cells, and their extremes."""
    total = 0.0
    found = Extremes(1.0, -1.0, 1.0)
    for m in range(scratch.counts[TOUCHED]):
        a, b, c = mesh.cells[scratch.touched[m]]
        total += _cost(mesh.points, a, b, c, cost)
        found = worse(found, triangle_extremes(mesh.points, a, b, c))
    return total, found


@kernel
def _gain(mesh: Triangles, cost: Cost, scratch: Scratch) -> float:
    """What the touched cells gain, or nothing where there may be more of them than are known."""
    count = scratch.counts[TOUCHED]
    if count == MOST_TOUCHED:
        return 0.0
    total = 0.0
    for m in range(count):
        total += scratch.before[m]**-cost.power
    return total - touched_shape(mesh, cost, scratch)[0]


@kernel
def force(
    mesh: Triangles, edges: EdgeNumbers, forced: ForcedFlip, own: float, rule: Rule,
    scratch: Scratch,
) -> float:
    """Flip, and take Newton steps around it until they pay; returns the gain of all together.

    Parameters
    ----------
    own : float          cost of the bad triangle
    scratch : Scratch    OUT: the touched cells, and what takes all back
    """
    t, i, s, j, loss = forced
    start = _at_turn(rule.cost, 0).power
    at_start = own ** (start / rule.cost.power)
    scratch.counts[:] = 0
    _touch(mesh, rule.cost.objective, scratch, t)
    _touch(mesh, rule.cost.objective, scratch, s)
    flip(mesh.cells, mesh.neighbors, edges, t, i, s, j)
    total = first = -loss
    known = 0
    for turn in range(len(DEEP)):
        if turn % 2 == 0:
            known = scratch.counts[TOUCHED]
        cost = _at_turn(rule.cost, turn)
        first += _sweep(mesh, rule, cost, known, scratch)
        # sums of a larger p are dominated by what comes and goes
        total = first if rule.cost.power == start else _gain(mesh, rule.cost, scratch)
        if total > GAIN * own:
            break
        if cost.power == start and first < -DEEP[turn] * at_start:
            break
        if cost.power == rule.cost.power and total < -DEEP[turn] * own:
            break
    return total


@kernel
def take_back(
    mesh: Triangles, edges: EdgeNumbers, forced: ForcedFlip, scratch: Scratch
) -> None:
    """Undo what :func:`force` did last."""
    for m in range(scratch.counts[MOVED] - 1, -1, -1):
        for d in range(scratch.origin.shape[1]):
            mesh.points[scratch.moved[m], d] = scratch.origin[m, d]
    t, i, s, j, _ = forced
    take_back_flip(mesh.cells, mesh.neighbors, edges, t, i, s, j)


@kernel
def standing(mesh: Triangles, bad: int, rule: Rule) -> tuple[float, Extremes]:
    """Cost of a bad cell, and what no cell may pass that comes in its place."""
    a, b, c = mesh.cells[bad, 0], mesh.cells[bad, 1], mesh.cells[bad, 2]
    q, large, small = triangle_extremes(mesh.points, a, b, c)
    limit = worse(rule.limit, Extremes(q - ROUNDED, large + ROUNDED, small - ROUNDED))
    return _cost(mesh.points, a, b, c, rule.cost), limit


@allocating_kernel
def compound_pass_2d(
    mesh: Triangles, edges: EdgeNumbers, order: IntArray, rule: Rule, tried: BoolArray,
    excess: FloatArray,
) -> int:
    """Try compound moves at the cells of ``order``, by their own edges, then those beside them.

    Parameters
    ----------
    mesh : Triangles         changed in place; no flip crosses the borders of regions
    edges : EdgeNumbers      of the mesh
    order : (k,) int32       cells
    rule : Rule              the sum of m^-p that falls; its guarded vertices, all of the boundary
                             among them, do not move
    tried : (m,) bool        cells where nothing paid and nothing near has changed since, which are
                             passed over; kept up to date
    excess : (n,) float64    see :func:`excess_degrees`; kept up to date

    Returns
    -------
    int                      number of compound moves that stayed
    """
    scratch = make_scratch(2)
    taken = 0
    for o in range(order.shape[0]):
        bad = order[o]
        if tried[bad]:
            continue
        tried[bad] = True
        own, limit = standing(mesh, bad, rule)
        for op in range(9):
            forced = forced_flip(mesh, edges, bad, op, rule, excess)
            if not forced.loss < np.inf:
                continue
            gain = force(mesh, edges, forced, own, rule, scratch)
            if gain > GAIN * own and keeps(touched_shape(mesh, rule.cost, scratch)[1], limit):
                keep_forced(mesh, forced, excess, tried, scratch)
                taken += 1
                break
            take_back(mesh, edges, forced, scratch)
    return taken


@kernel
def keep_forced(
    mesh: Triangles, forced: ForcedFlip, excess: FloatArray, tried: BoolArray, scratch: Scratch
) -> None:
    """Count the new edge; what was touched, or lies beside that, may be tried again."""
    t, s = forced.t, forced.s
    excess[mesh.cells[t, 0]] += 1.0
    excess[mesh.cells[t, 2]] += 1.0
    excess[mesh.cells[t, 1]] -= 1.0
    excess[mesh.cells[s, 2]] -= 1.0
    for m in range(scratch.counts[TOUCHED]):
        touched = scratch.touched[m]
        tried[touched] = False
        for f in range(3):
            if mesh.neighbors[touched, f] >= 0:
                tried[mesh.neighbors[touched, f]] = False
