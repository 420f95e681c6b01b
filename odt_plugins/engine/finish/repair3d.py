"""Repair in space: the few cells that passed the extremes of the input go back within them.

The costs of the phases level off at flat cells (``tetrahedron.SHIFT``), and a cell on a triangle of
the boundary that is nearly a line stays flat wherever its fourth vertex goes, only by less or by
more. So every cell pays the square of the part of a bound that it lacks, and vertices go where
their stars pay less, by a search in ever other directions, since what is paid has kinks.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.record.figures import cell_shapes
from odt_plugins.engine.topology.star import vertex_stars
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray

MARGINS = (0.1, 1e-3)
"""Parts of a bound wanted beyond it: a sum of squares comes close to what it is to reach only."""

FIRST, LEAST = 0.3, 1e-9
"""First step of a search and the least, as parts of the longest edge of a star."""

TRIALS, PLACES = 200, 24
"""Trials of a search, at half of the step where none gains, and places in each."""

ROOTS = np.array([0.8191725133961645, 0.6710436067037893, 0.5497004779019703])
"""1/x, 1/x^2 and 1/x^3 with x^4 = x + 1. The Kronecker sequence k x ROOTS mod 1 is equidistributed
in the unit cube."""


def within_bounds(
    points: FloatArray, cells: IntArray, movable: BoolArray, bounds: Extremes
) -> float:
    """Move vertices of cells beyond the bounds, in place, such that less is lacking.

    Parameters
    ----------
    points : (n, 3) float64    changed; or (n, 9), with the metric of every vertex, which stays
    cells : (m, 4) int32
    movable : (n,) bool        vertices that may move
    bounds : Extremes

    Returns
    -------
    float                      sum over the cells of what is still :func:`lacking`
    """
    stars = vertex_stars(cells, len(points))
    for margin in MARGINS:
        for v in np.unique(cells[lacking(points, cells, bounds) > 0.0]):
            if movable[v]:
                star = cells[stars.indices[stars.indptr[v] : stars.indptr[v + 1]]]
                _search(points, star, v, bounds, margin)
    return float(lacking(points, cells, bounds).sum())


def lacking(
    points: FloatArray, cells: IntArray, bounds: Extremes, margin: float = 0.0
) -> FloatArray:
    """Sum of the squares of the parts of a bound and a margin that every cell lacks, (m,)."""
    quality, large, small, _ = cell_shapes(points, cells).T
    total = np.zeros(len(cells))
    for has, bound in ((quality, bounds.quality), (1.0 - large, 1.0 - bounds.large),
                       (1.0 + small, 1.0 + bounds.small)):
        if bound > 0.0:
            total += np.maximum(1.0 + margin - has / bound, 0.0) ** 2
    total[~(quality > 0.0)] = np.inf
    return total


def _search(points: FloatArray, star: IntArray, v: int, bounds: Extremes, margin: float) -> None:
    """Let a vertex look for a place where its star pays less, in place.

    A trial looks at places around, and twice as far the way that the last one went.
    """
    own, here = np.unique(star, return_inverse=True)
    here = here.reshape(star.shape)
    added = np.arange(len(own), len(own) + PLACES)[:, None, None]
    there: IntArray = np.where(own[here] == v, added, here).reshape(-1, 4).astype(np.int32)
    x = points[v].copy()
    longest = float(np.abs(points[own, :3] - x[:3]).max())
    step, way = FIRST * longest, np.zeros(len(x))
    now = float(lacking(points, star, bounds, margin).sum())
    for trial in range(TRIALS):
        if now == 0.0 or step < LEAST * longest:
            break
        turn = np.arange(trial * PLACES, (trial + 1) * PLACES)[:, None] * ROOTS
        places = np.tile(x, (PLACES, 1))
        places[:, :3] += step * (2.0 * (turn % 1.0) - 1.0)
        places[0] = x + 2.0 * way
        paid = lacking(np.concatenate([points[own], places]), there, bounds, margin)
        paid = paid.reshape(PLACES, -1).sum(axis=1)
        best = int(paid.argmin())
        better = bool(paid[best] < now)
        step, way = (step, places[best] - x) if better else (0.5 * step, np.zeros(len(x)))
        x, now = (places[best], float(paid[best])) if better else (x, now)
    points[v] = x
