"""The size field: lengths that edges should have at the vertices of the input."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from odt_plugins.engine.cells.content import CONTENT, cells_of_sizes
from odt_plugins.engine.cells.elementary import exp, log, power
from odt_plugins.engine.cells.geometry import signed_volumes
from odt_plugins.engine.odt.density import smooth_over_stars
from odt_plugins.engine.remesh.wish import Wish
from odt_plugins.engine.topology.growth import grown_along
from odt_plugins.engine.topology.star import star_sum
from odt_plugins.errors import InvalidOptionError, place_within
from odt_plugins.mesh.arrays import FloatArray, IntArray, LongArray
from odt_plugins.mesh.numbers import real_numbers
from odt_plugins.mesh.seen import as_seen, full, seen_through
from odt_plugins.mesh.simplex import SimplexMesh, corner_mean, diagonal
from odt_plugins.mesh.symmetric import exponentials

LEAST = 1e-6
"""Smallest size, as a part of the diagonal."""

FINER = 1.1
"""Multiple of its size that must have been asked for at a vertex which is told to be finer."""

STEEP = 3.0
"""Growth with which sizes fall from edges that stay long."""

PASSES = 2
"""Averaging passes over the logarithm of the sizes that the input has."""


@dataclass(frozen=True)
class Sizes:
    """A size field on the input.

    Attributes
    ----------
    values : (n,) float64       lengths at the vertices; 1 at those without cells
    cells : float               about how many cells they make
    notes : tuple of str        what was changed of what was asked for
    growth : float              see Wish
    asked : (n,) float64        lengths that were asked for, however they grow
    """

    values: FloatArray
    cells: float
    notes: tuple[str, ...]
    growth: float
    asked: FloatArray

    def scaled(self, factor: float) -> Sizes:
        """All lengths so many times as long."""
        return replace(self, values=factor * self.values, asked=factor * self.asked)

    def first(self, n: int) -> Sizes:
        """Those of the first vertices."""
        return replace(self, values=self.values[:n], asked=self.asked[:n])

    def before_chords(self, mesh: SimplexMesh) -> FloatArray:
        """Lengths (n,) as they were asked for and grow as they may, wherever others are shorter."""
        if len(mesh.metric):
            return self.values
        return grown(mesh.points, unique_edges(mesh.cells), self.asked, self.growth)

    def below(self, mesh: SimplexMesh, most: FloatArray) -> Sizes:
        """The largest sizes that are no longer than ``most`` (n,) and grow as they may."""
        values = np.minimum(self.values, most)
        if len(mesh.metric):
            return replace(self, values=values)
        return replace(self, values=grown(mesh.points, unique_edges(mesh.cells), values,
                                          self.growth))

    def above(self, mesh: SimplexMesh, least: FloatArray) -> Sizes:
        """The smallest sizes that are no shorter than ``least`` (n,), and fall from there."""
        values = np.maximum(self.values, least)
        if len(mesh.metric):
            return replace(self, values=values)
        most = 2.0 * values.max()
        return replace(self, values=np.maximum(values, most - grown(
            mesh.points, unique_edges(mesh.cells), most - least, STEEP)))


def wanted_sizes(mesh: SimplexMesh, wish: Wish, given: Any = None) -> Sizes:
    """Sizes at the vertices of a mesh of any kind.

    Parameters
    ----------
    mesh : SimplexMesh
    wish : Wish
    given : array (n,) or (m,), or callable    lengths, if ``wish.given`` or ``wish.curved``

    Raises
    ------
    InvalidOptionError    lengths that are not finite and positive, or of wrong number; sizes below
                          LEAST of the diagonal, unless the input has them; more cells than
                          ``wish.most_cells``
    """
    used, extent = mesh.used, mesh.extent
    notes = []
    values = np.ones(len(mesh.points))
    if len(mesh.metric):
        values[:] = wish.scale or 1.0
    elif wish.length is not None:
        values[:] = float(wish.length)
    elif wish.given or wish.curved:
        values = _as_given(mesh, given, used)
    else:
        values = local_sizes(mesh) * (wish.scale or 1.0)
    goal = wish.cells
    if wish.vertices is not None:
        goal = max(1, round(wish.vertices * len(mesh.cells) / len(used)))
    if goal is not None:
        d = mesh.dim
        values *= (expected_cells(mesh, values) / goal) ** (1.0 / d)
    elif not len(mesh.metric):
        low = used[np.argmin(values[used])]
        if values[low] < LEAST * extent and (wish.scale or 0.0) < 1.0:
            msg = (f"got size {values[low]:.3g} at vertex {low}, below {LEAST:g} of the diagonal "
                   f"of {extent:.3g}; expected lengths in the unit of the points, try scale=1 for "
                   f"those of the mesh")
            raise InvalidOptionError(msg)
        if values[used].min() > extent:
            notes.append(f"size {values[used].min():.3g} is larger than the domain of {extent:.3g}:"
                         f" the result is as coarse as its topology and the envelope allow")
    limited = values
    if not len(mesh.metric):
        values = np.minimum(values, 2.0 * extent)
        limited = grown(mesh.points, unique_edges(mesh.cells), values, wish.growth)
    share = 100 * (limited[used] < 0.99 * values[used]).mean()
    if share:
        told = f"{share:.0f} %" if share >= 1.0 else "less than 1 %"
        notes.append(f"sizes grow by more than {wish.growth:g} from vertex to vertex; they are "
                     f"smaller at {told} of the vertices, see growth=")
    count = expected_cells(mesh, limited)
    check_count(count, wish)
    return Sizes(limited, count, tuple(notes), wish.growth, values)


def check_count(count: float, wish: Wish) -> None:
    """Refuse more cells than are wished at most."""
    if count > wish.most_cells:
        msg = (f"got sizes for about {count:.3g} cells; expected at most most_cells="
               f"{wish.most_cells}, try larger sizes or a larger most_cells=")
        raise InvalidOptionError(msg)


def expected_cells(mesh: SimplexMesh, values: FloatArray) -> float:
    """About how many cells of some sizes fill the mesh.

    In a metric by the rule of the middle and the corners that is exact for quadratic polynomials.
    """
    if not len(mesh.metric):
        return cells_of_sizes(mesh.points, mesh.cells, values)
    d = mesh.dim
    dense = power(values, -float(d))
    content = np.abs(signed_volumes(*as_seen(mesh.points, mesh.cells, mesh.metric)))
    count = float((content * corner_mean(dense, mesh.cells)).sum())
    roots, corners = exponentials(full(mesh.metric)), 0.0
    for corner in mesh.cells.T:
        content = np.abs(signed_volumes(*seen_through(roots[corner], mesh.points, mesh.cells)))
        corners += float((content * dense[corner]).sum())
    count = ((d + 1) * count + corners / (d + 1)) / (d + 2)
    return count / CONTENT[d + 1]


def unique_edges(cells: IntArray) -> IntArray:
    """Edges (e, 2) of cells, each once."""
    n = int(cells.max()) + 1
    key = np.concatenate([np.minimum(one, two).astype(np.int64) * n + np.maximum(one, two)
                          for one, two in combinations(cells.T, 2)])
    key.sort()
    key = key[np.append(True, key[1:] != key[:-1])]
    return np.column_stack([key // n, key % n]).astype(np.int32)


def lengths_of(points: FloatArray, edges: IntArray, metric: FloatArray | None = None) -> FloatArray:
    """Lengths (e,) of edges, through the mean of the metric (n, k) of a metric at their ends."""
    pairs = edges
    if metric is not None and len(metric):
        points, pairs = as_seen(points, edges, metric)
    step = points[pairs[:, 1]] - points[pairs[:, 0]]
    return np.sqrt((step * step).sum(axis=1))


def local_sizes(mesh: SimplexMesh) -> FloatArray:
    """Mean length of the edges at every vertex, smoothed; 1 at those without cells."""
    edges = unique_edges(mesh.cells)
    length = lengths_of(mesh.points, edges, mesh.metric)
    n = len(mesh.points)
    count = np.bincount(edges.ravel(), minlength=n)
    total = np.bincount(edges.ravel(), np.repeat(length, 2), minlength=n)
    mean = np.divide(total, count, out=np.ones(n), where=count > 0)
    return exp(smooth_over_stars(log(mean), mesh.cells, PASSES))


def grown(points: FloatArray, edges: IntArray, values: FloatArray, growth: float) -> FloatArray:
    """The largest sizes below some that grow by less than (growth - 1) times the way.

    The size at a vertex is the least, over all vertices, of the size there and that growth along
    the edges.
    """
    if values.min() == values.max():
        return values
    return grown_along(points, edges, values, growth - 1.0)


def _as_given(mesh: SimplexMesh, given: Any, used: LongArray) -> FloatArray:
    """Lengths at the vertices from an array or a callable."""
    if callable(given):
        values = np.ones(len(mesh.points))
        values[used] = lengths_at(given, mesh.points, used)
        return values
    n, m = len(mesh.points), len(mesh.cells)
    values = _numbers(given)
    if values.shape == (m,) and m != n:
        _check_positive(values)
        count = star_sum(np.ones(m), mesh.cells, n)
        total = star_sum(values, mesh.cells, n)
        values = np.divide(total, count, out=np.ones(n), where=count > 0)
    if values.shape != (n,):
        msg = (f"got sizes of shape {values.shape}; expected ({n},), one for each vertex, or "
               f"({m},), one for each cell")
        raise InvalidOptionError(msg)
    out = np.ones(n)
    _check_positive(values[used], used)
    out[used] = values[used]
    return out


def lengths_at(given: Any, points: FloatArray, used: LongArray) -> FloatArray:
    """Lengths (k,) that a callable gives at those of the points (n, d) with the index ``used``.

    Raises
    ------
    InvalidOptionError    they are not finite and positive, or of another number
    """
    values, n = _numbers(given(points.copy())), len(points)
    if values.shape != (n,):
        msg = (f"got sizes of shape {values.shape} at {n} points; expected ({n},), one for each of "
               f"the points that the function is given")
        raise InvalidOptionError(msg)
    bad = used[_bad(values[used])]
    if bad.size:
        place = place_within(diagonal(points), points[bad[0]])
        msg = (f"got size {values[bad[0]]} at index {bad[0]}, at ({place}) ({bad.size} of them); "
               f"expected finite lengths above 0, try a number")
        raise InvalidOptionError(msg)
    return values[used]


def _numbers(raw: Any) -> FloatArray:
    return real_numbers(raw, "sizes that are no real numbers", "lengths, try a number")


def _bad(values: FloatArray) -> LongArray:
    """Indices of what is no length."""
    return np.flatnonzero(~(np.isfinite(values) & (values > 0.0)))


def _check_positive(values: FloatArray, index: LongArray | None = None) -> None:
    bad = _bad(values)
    if bad.size:
        at = bad[0] if index is None else index[bad[0]]
        msg = (f"got size {values[bad[0]]} at index {at} ({bad.size} of them); expected finite "
               f"lengths above 0, try a number")
        raise InvalidOptionError(msg)
