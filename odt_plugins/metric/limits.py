"""Bounds of a metric field: how fast it changes over the mesh, how far cells are stretched."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.cells.elementary import exp, log
from odt_plugins.engine.cells.tensors import (
    intersection,
    of_eigenvalues,
    positive_eigenvalues,
    squared_lengths,
)
from odt_plugins.engine.remesh.sizes import unique_edges
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray

GROWTH = 3.0
"""Largest ratio of lengths at the ends of an edge of length 1 unless another is given. Less of it
takes cells away from where the metric is fine; more of it makes the worst cells worse."""

SWEEPS = 40
"""Most sweeps over the edges; a sweep takes a bound as far as neighbours of neighbours."""

SLACK = 0.02
"""Part by which squared lengths may fall short of the bound."""


def grown_metric(
    points: FloatArray, cells: IntArray, metric: FloatArray, growth: float
) -> FloatArray:
    """Make lengths in a metric longer until they change by no more than a factor along edges.

    Parameters
    ----------
    points : (n, d) float64
    cells : (m, k + 1) int32
    metric : (n, d, d) float64
    growth : float               largest ratio of lengths at the ends of an edge of length 1

    Returns
    -------
    (n, d, d) float64            sizes below those of `metric`: M_q is at least
                                 M_p / (1 + (growth - 1) l_p)^2 for every edge p q of length l_p in
                                 M_p, but for SLACK. Of metrics h^-2 I the sizes are about those of
                                 :func:`odt_plugins.engine.remesh.sizes.grown`

    References
    ----------
    F. Alauzet, Size gradation control of anisotropic meshes, Finite Elem. Anal. Des. 46 (2010)
    181-202: metrics spanned along edges in their own unit of length, and intersected.
    """
    if (metric == metric[:1]).all():
        return metric
    edges = unique_edges(cells)
    start = np.concatenate([edges[:, 0], edges[:, 1]])
    end = np.concatenate([edges[:, 1], edges[:, 0]])
    out = metric.copy()
    moved = np.ones(len(points), dtype=np.bool_)
    for _ in range(SWEEPS):
        rows = np.flatnonzero(moved[start])
        if not rows.size:
            break
        moved[:] = False
        for turn in _turns(end[rows]):
            p, q = start[rows[turn]], end[rows[turn]]
            length = np.sqrt(squared_lengths(points[q] - points[p], out[p]))
            spanned = out[p] / ((1.0 + (growth - 1.0) * length) ** 2)[:, None, None]
            short = ~_covers((1.0 + SLACK) * out[q], spanned)
            out[q[short]] = intersection(out[q[short]], spanned[short])
            moved[q[short]] = True
    return out


def _turns(ends: IntArray) -> list[NDArray[np.intp]]:
    """Rows so that none of a list has the same end as another."""
    order = np.argsort(ends, kind="stable")
    sorted_ends = ends[order]
    first = np.flatnonzero(np.diff(sorted_ends, prepend=-1))
    count = np.diff(first, append=len(ends))
    rank = np.empty(len(ends), dtype=np.int64)
    rank[order] = np.arange(len(ends)) - np.repeat(first, count)
    by_rank = np.argsort(rank, kind="stable")
    return np.split(by_rank, np.cumsum(np.bincount(rank))[:-1])


def _covers(larger: FloatArray, smaller: FloatArray) -> BoolArray:
    """Where all lengths in one metric are at least those in another: Sylvester's criterion."""
    a = larger - smaller
    good = (a[:, 0, 0] >= 0.0) & (a[:, 1, 1] >= 0.0)
    minor = a[:, 0, 0] * a[:, 1, 1] - a[:, 0, 1] ** 2
    good &= minor >= 0.0
    if a.shape[1] == 3:
        good &= (
            a[:, 2, 2] * minor - a[:, 0, 0] * a[:, 1, 2] ** 2 - a[:, 1, 1] * a[:, 0, 2] ** 2
            + 2.0 * a[:, 0, 1] * a[:, 1, 2] * a[:, 0, 2]) >= 0.0
    return np.asarray(good)


def bounded_metric(
    metric: FloatArray, ratio: float, least: float = 0.0, most: float = np.inf,
    norm: float = np.inf,
) -> FloatArray:
    """Bring lengths into a range, then shorten the long ones to a ratio of the short ones.

    Parameters
    ----------
    metric : (n, d, d) float64
    ratio : float                largest ratio of the lengths in two directions
    least, most : float          range of the lengths
    norm : float                 p of the L^p norm for which `metric` is best without bounds, with
                                 a finite `most`; inf: lengths at `most` change no others
    """
    values, axes = positive_eigenvalues(metric)
    low = 0.0 if most == np.inf else most**-2.0
    high = np.inf if least == 0.0 else least**-2.0
    if norm < np.inf:
        values = _best_above(values, low, norm)
    values = np.minimum(np.maximum(values, low), high)
    values = np.maximum(values, values.max(axis=1, keepdims=True) / ratio**2)
    return of_eigenvalues(values, axes)


def _best_above(values: FloatArray, low: float, norm: float) -> FloatArray:
    """The metric that is best for a norm among those without eigenvalues below a bound.

    A length at its bound is shorter than would be best, which costs cells, so that others are to
    be longer.  M = c det(H)^(-1 / (2 p + d)) H, with H_i = s low for an M_i at the bound and
    s = H_j / M_j of the k others; so that c^-(2 p + d) = s^(2 p + k) / (low^(d - k) prod H_j).

    Parameters
    ----------
    values : (n, d) float64    eigenvalues of the best metric without a bound
    low : float                the bound, above 0
    norm : float               p of the L^p norm

    Returns
    -------
    (n, d) float64             eigenvalues, below the bound where the best ones are at it
    """
    out = values
    for _ in range(values.shape[1]):
        short = out < low
        added = np.where(short, log(low / values), 0.0).sum(axis=1)
        fewer = exp(-added / (2.0 * norm + (~short).sum(axis=1)))
        out = np.where(short, out, values * fewer[:, None])
    return out
