"""Derivative-free smoothing for the few vertices around the very worst cells, d = 3."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from odt_plugins.engine.smooth3d import star_extremes
from odt_plugins.engine.tetrahedron import tet_cost
from odt_plugins.mesh import FloatArray, IntArray, LongArray

STEPS = 24


@njit(nogil=True, cache=True)
def _cost(
    points: FloatArray, cells: IntArray, indices: IntArray, lo: int, hi: int, objective: int,
    power: float, limit: float,
) -> float:
    total = 0.0
    for s in range(lo, hi):
        c = indices[s]
        total += tet_cost(
            points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3], objective, power
        )
        if not total < limit:
            return np.inf
    return total


@njit(nogil=True, cache=True)
def compass_search(
    points: FloatArray, cells: IntArray, indptr: LongArray, indices: IntArray, order: IntArray,
    start: int, stop: int, objective: int, power: float, bounds: FloatArray, moved: FloatArray,
) -> int:
    """Move vertices order[start:stop] along the axes while the cost of their star falls.

    Parameters as in ``smooth3d.smooth_vertices``, with the objective of ``tet_cost``.  The step
    starts at a fifth of the mean edge and is halved when no direction helps.
    """
    count = 0
    for o in range(start, stop):
        v = order[o]
        lo = indptr[v]
        hi = indptr[v + 1]
        moved[v] = 0.0
        if lo == hi:
            continue
        size = 0.0
        for s in range(lo, hi):
            c = indices[s]
            for a in range(4):
                w = cells[c, a]
                for axis in range(3):
                    size += (points[w, axis] - points[v, axis]) ** 2
        size = math.sqrt(size / (3 * (hi - lo)))
        first = _cost(points, cells, indices, lo, hi, objective, power, np.inf)
        if not first < np.inf:
            continue
        worst0, large0, small0 = star_extremes(points, cells, indices, lo, hi)
        q_floor = min(bounds[0], worst0)
        ceiling = max(bounds[1], large0)
        floor = min(bounds[2], small0)
        best = first
        step = 0.2 * size
        for _ in range(STEPS):
            improved = False
            for direction in range(6):
                axis = direction >> 1
                old = points[v, axis]
                points[v, axis] = old + (step if direction & 1 else -step)
                cost = _cost(points, cells, indices, lo, hi, objective, power, best * (1.0 - 1e-6))
                if cost < best:
                    worst, large, small = star_extremes(points, cells, indices, lo, hi)
                    if worst >= q_floor and large <= ceiling and small >= floor:
                        best = cost
                        improved = True
                        continue
                points[v, axis] = old
            if not improved:
                step *= 0.5
                if step < 1e-4 * size:
                    break
        if best < first:
            moved[v] = 1.0 - best / first
            count += 1
    return count
