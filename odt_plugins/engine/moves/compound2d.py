"""Compound moves in the plane: a forced flip, a local descent, and back if it did not pay.

Single flips stop in local minima of F_p.  Here one flip at a bad triangle is taken whatever it
costs, if it brings no degree further from what the angle around the vertex has room for; Newton
steps then descend around it, ring after ring.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.extremes import Extremes, keeps, worse
from odt_plugins.engine.cells.tetrahedron import Cost
from odt_plugins.engine.cells.triangle import triangle_extremes, triangle_measure
from odt_plugins.engine.compiled.kernel import allocating_kernel, inner_kernel, kernel
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
"""A descent is given up that is still so many times the bad triangle's own cost down after its
first, its second and every further sweep; every other sweep reaches one ring of cells further."""
LARGEST_STAR = 32
"""Cells around a vertex; one with more is left alone."""
HOPELESS = 200.0
"""A forced flip may raise the cost by this many times the bad triangle's own."""
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
    star : (LARGEST_STAR,) int32               cells around a vertex
    touched : (MOST_TOUCHED,) int32            cells that a descent changed
    seen : (MOST_TOUCHED,) int32               vertices that were visited in a sweep
    moved : (6 MOST_TOUCHED,) int32            vertices, in the order of their moves
    origin : (6 MOST_TOUCHED, 2) float64       where they were before
    counts : (2,) int64                        of touched cells and of moves
    """

    derivatives: FloatArray
    star: IntArray
    touched: IntArray
    seen: IntArray
    moved: IntArray
    origin: FloatArray
    counts: LongArray


TOUCHED, MOVED = 0, 1
"""Places in ``Scratch.counts``."""


@allocating_kernel
def make_scratch() -> Scratch:
    """Room for one thread."""
    return Scratch(
        np.empty(5), np.empty(LARGEST_STAR, np.int32), np.empty(MOST_TOUCHED, np.int32),
        np.empty(MOST_TOUCHED, np.int32), np.empty(len(DEEP) * MOST_TOUCHED, np.int32),
        np.empty((len(DEEP) * MOST_TOUCHED, 2)), np.zeros(2, np.int64),
    )


@inner_kernel
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


@inner_kernel
def _touch(scratch: Scratch, t: int) -> None:
    """Add a cell to the touched ones, once."""
    n = scratch.counts[TOUCHED]
    if n < MOST_TOUCHED and not is_in(t, scratch.touched, n):
        scratch.touched[n] = t
        scratch.counts[TOUCHED] += 1


@inner_kernel
def _cost(points: FloatArray, a: int, b: int, c: int, cost: Cost) -> float:
    m = triangle_measure(points, a, b, c, cost.objective)
    return m**-cost.power if m > 0.0 else np.inf


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
            ux, uy = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
            vx, vy = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
            angle = math.atan2(ux * vy - uy * vx, ux * vx + uy * vy)
            excess[a] += 1.0 - 3.0 / math.pi * angle


@inner_kernel
def _loss(
    mesh: Triangles, edges: EdgeNumbers, t: int, i: int, rule: Rule, excess: FloatArray
) -> tuple[float, int, int]:
    """What it costs to flip the edge of cell t opposite its corner i; infinite where it stays.

    It stays where the sum of the squares of the excess degrees would grow.

    Returns
    -------
    loss : float, s, j : int    the cell across the edge, and its corner opposite of it
    """
    points, cells, neighbors, regions = mesh
    s = neighbors[t, i]
    if s < 0 or regions[s] != regions[t] or not (rule.active[t] and rule.active[s]):
        return np.inf, 0, 0
    j = place_in(edges.of_cell, s, edges.of_cell[t, i])
    a, b, c, d = cells[t, i], cells[t, (i + 1) % 3], cells[t, (i + 2) % 3], cells[s, j]
    if excess[a] + excess[d] - excess[b] - excess[c] + 2.0 > LEVEL:
        return np.inf, 0, 0
    if not (is_wide(points, a, b, d) and is_wide(points, a, d, c)):
        return np.inf, 0, 0
    loss = (
        _cost(points, a, b, d, rule.cost) + _cost(points, a, d, c, rule.cost)
        - _cost(points, a, b, c, rule.cost) - _cost(points, d, c, b, rule.cost)
    )
    return loss, s, j


@kernel
def _sweep(
    mesh: Triangles, rule: Rule, known: int, scratch: Scratch
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
            scratch.origin[n, 0] = points[v, 0]
            scratch.origin[n, 1] = points[v, 1]
            before, after = newton_vertex_2d(
                points, cells, scratch.star[:size], v, rule.cost, rule.limit, scratch.derivatives
            )
            if after < before:
                total += before - after
                scratch.counts[MOVED] += 1
                for s in range(size):
                    _touch(scratch, scratch.star[s])
    return total


@inner_kernel
def _descend(mesh: Triangles, rule: Rule, loss: float, own: float, scratch: Scratch) -> float:
    """Newton steps around a forced flip until they pay; returns the gain of everything together.

    Parameters
    ----------
    loss : float         of the forced flip
    own : float          cost of the bad triangle
    scratch : Scratch    its touched cells are the two that were flipped; what takes all back
    """
    total = -loss
    known = 0
    for turn in range(len(DEEP)):
        if turn % 2 == 0:
            known = scratch.counts[TOUCHED]
        total += _sweep(mesh, rule, known, scratch)
        if total < -DEEP[turn] * own or total > GAIN * own:
            break
    return total


@kernel
def _within(mesh: Triangles, limit: Extremes, scratch: Scratch) -> bool:
    """Whether no touched cell passes the limit."""
    for m in range(scratch.counts[TOUCHED]):
        a, b, c = mesh.cells[scratch.touched[m]]
        if not keeps(triangle_extremes(mesh.points, a, b, c), limit):
            return False
    return True


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
    points, cells, neighbors, _ = mesh
    scratch = make_scratch()
    counts = scratch.counts
    taken = 0
    for o in range(order.shape[0]):
        bad = order[o]
        if tried[bad]:
            continue
        tried[bad] = True
        a, b, c = cells[bad, 0], cells[bad, 1], cells[bad, 2]
        own = _cost(points, a, b, c, rule.cost)
        q, large, small = triangle_extremes(points, a, b, c)
        limit = worse(rule.limit, Extremes(q - ROUNDED, large + ROUNDED, small - ROUNDED))
        for op in range(9):
            t, i = bad, op
            if op >= 3:
                k = (op - 3) // 2
                t = neighbors[bad, k]
                if t < 0:
                    continue
                i = (place_in(edges.of_cell, t, edges.of_cell[bad, k]) + 1 + op % 2) % 3
            loss, s, j = _loss(mesh, edges, t, i, rule, excess)
            if not loss < HOPELESS * own:
                continue
            flip(cells, neighbors, edges, t, i, s, j)
            counts[:] = 0
            _touch(scratch, t)
            _touch(scratch, s)
            gain = _descend(mesh, rule, loss, own, scratch)
            if gain > GAIN * own and _within(mesh, limit, scratch):
                _settle(mesh, t, s, excess, tried, scratch)
                taken += 1
                break
            for m in range(counts[MOVED] - 1, -1, -1):
                v = scratch.moved[m]
                points[v, 0] = scratch.origin[m, 0]
                points[v, 1] = scratch.origin[m, 1]
            take_back_flip(cells, neighbors, edges, t, i, s, j)
    return taken


@kernel
def _settle(
    mesh: Triangles, t: int, s: int, excess: FloatArray, tried: BoolArray, scratch: Scratch
) -> None:
    """Count the edge between t and s; what was touched, or lies beside that, may be tried again."""
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
