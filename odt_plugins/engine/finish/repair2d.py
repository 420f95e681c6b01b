"""Planar repair: the few triangles that passed the extremes of the input go back within them.

Every triangle pays the sum of the squares of what it lacks to the bounds and a margin; vertices
near those beyond the bounds go where their stars pay less, by a search along compass directions,
since what is paid has kinks.
"""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.cells.triangle import triangle_extremes
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.compiled.threads import pieces
from odt_plugins.engine.moves.flips2d import GAIN, flip, number_edges
from odt_plugins.engine.topology.lookup import place_in
from odt_plugins.engine.topology.star import Stars, vertex_stars
from odt_plugins.engine.topology.triangles import EdgeNumbers, Triangles
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray

MARGINS = (1e-2, 1e-4, 1e-6, 1e-8, 1e-10)
"""Wanted beyond the bounds: a sum of squares comes close to what it is to reach only."""

RINGS, ROUNDS, SWEEPS = 2, 6, 10
"""Rings of triangles around those beyond the bounds that give way; how often they are found anew;
visits of every vertex in between."""

FIRST, TRIALS = 0.1, 60
"""First step, as a part of the longest edge of a star, and trials, at a half where none gains."""

COMPASS = ((1.0, 0.0), (0.7, 0.7), (0.0, 1.0), (-0.7, 0.7),
           (-1.0, 0.0), (-0.7, -0.7), (0.0, -1.0), (0.7, -0.7))


def within_bounds(
    mesh: Triangles, movable: BoolArray, bounds: Extremes, *, flips: bool = True
) -> bool:
    """Move vertices and flip edges, in place, until no triangle is beyond the bounds.

    Parameters
    ----------
    mesh : Triangles    changed
    movable : (n,) bool vertices that may move
    bounds : Extremes
    flips : bool        whether edges may be flipped

    Returns
    -------
    bool                whether that was reached
    """
    points, cells = mesh.points, mesh.cells
    edges = number_edges(mesh.neighbors)
    for margin in MARGINS:
        for _ in range(ROUNDS):
            lacking = _lacking(points, cells, bounds)
            if not lacking.any():
                return True
            for first, last in pieces(0, len(cells) if flips else 0):
                _flips(mesh, edges, bounds, first, last)
            stars = vertex_stars(cells, len(points))
            lacking = _lacking(points, cells, bounds)
            near = np.zeros(len(points), dtype=np.bool_)
            near[cells[lacking > 0.0]] = True
            for _ in range(RINGS):
                near[cells[near[cells].any(axis=1)]] = True
            order = np.flatnonzero(near & movable).astype(np.int32)
            for _ in range(SWEEPS):
                for first, last in pieces(0, len(order), costly=True):
                    _search(points, cells, stars, order[first:last], bounds, margin)
        lacking = _lacking(points, cells, bounds)
        if lacking.max() > margin * margin:
            break
    return not lacking.any()


@kernel
def _lack(
    points: FloatArray, a: int, b: int, c: int, bounds: Extremes, margin: float
) -> float:
    """What a triangle pays."""
    q, large, small = triangle_extremes(points, a, b, c)
    if not q > 0.0:
        return math.inf
    x = max(0.0, bounds.quality + margin - q)
    y = max(0.0, large + margin - bounds.large)
    z = max(0.0, bounds.small + margin - small)
    return x * x + y * y + z * z


def _lacking(points: FloatArray, cells: IntArray, bounds: Extremes) -> FloatArray:
    """What every triangle pays without a margin, (m,)."""
    lacking = np.empty(len(cells))
    for first, last in pieces(0, len(cells)):
        _lacks(points, cells[first:last], bounds, lacking[first:last])
    return lacking


@kernel
def _lacks(points: FloatArray, cells: IntArray, bounds: Extremes, lacking: FloatArray) -> None:
    """What every triangle pays without a margin, which may be rounded."""
    for t in range(cells.shape[0]):
        pays = _lack(points, cells[t, 0], cells[t, 1], cells[t, 2], bounds, 0.0)
        lacking[t] = 0.0 if pays < 1e-26 else pays


@kernel
def _flips(
    mesh: Triangles, edges: EdgeNumbers, bounds: Extremes, start: int, stop: int
) -> None:
    """Flip the edges of triangles beyond the bounds, once, where the two pay less then."""
    points, cells, neighbors, regions = mesh
    for t in range(start, stop):
        for i in range(3):
            s = neighbors[t, i]
            a, b, c = cells[t, i], cells[t, (i + 1) % 3], cells[t, (i + 2) % 3]
            here = _lack(points, a, b, c, bounds, 0.0)
            if s < 0 or regions[s] != regions[t] or here == 0.0:
                continue
            j = place_in(edges.of_cell, s, edges.of_cell[t, i])
            d = cells[s, j]
            old = here + _lack(points, d, c, b, bounds, 0.0)
            new = _lack(points, a, b, d, bounds, 0.0) + _lack(points, a, d, c, bounds, 0.0)
            if new < (1.0 - GAIN) * old:
                flip(cells, neighbors, edges, t, i, s, j)
                break


@kernel
def _star_lack(
    points: FloatArray, cells: IntArray, stars: Stars, vertex: int, bounds: Extremes,
    margin: float,
) -> float:
    """What the star of a vertex pays."""
    indptr, indices = stars
    total = 0.0
    for s in range(indptr[vertex], indptr[vertex + 1]):
        t = indices[s]
        total += _lack(points, cells[t, 0], cells[t, 1], cells[t, 2], bounds, margin)
    return total


@kernel
def _search(
    points: FloatArray, cells: IntArray, stars: Stars, order: IntArray, bounds: Extremes,
    margin: float,
) -> None:
    """Let every vertex of ``order`` look for a place where its star pays less, in place."""
    indptr, indices = stars
    for o in range(order.shape[0]):
        v = order[o]
        now = _star_lack(points, cells, stars, v, bounds, margin)
        if now == 0.0:
            continue
        x, y = points[v, 0], points[v, 1]
        longest = 0.0
        for s in range(indptr[v], indptr[v + 1]):
            for k in range(3):
                w = cells[indices[s], k]
                longest = max(longest, math.hypot(points[w, 0] - x, points[w, 1] - y))
        step = min(FIRST, 100.0 * margin) * longest
        least = 1e-6 * margin * longest
        for _ in range(TRIALS):
            if step < least:
                break
            best, to_x, to_y = now, x, y
            for k in range(len(COMPASS)):
                points[v, 0] = x + step * COMPASS[k][0]
                points[v, 1] = y + step * COMPASS[k][1]
                there = _star_lack(points, cells, stars, v, bounds, margin)
                if there < best:
                    best, to_x, to_y = there, points[v, 0], points[v, 1]
            if best == now:
                step *= 0.5
            now, x, y = best, to_x, to_y
            points[v, 0] = x
            points[v, 1] = y
            if now == 0.0:
                break
