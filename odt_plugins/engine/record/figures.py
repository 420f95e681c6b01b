"""The named figures of a mesh from the engine's own kernels, to compare states quickly."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.cells.elementary import arccos, power
from odt_plugins.engine.cells.extremes import BEST, Extremes, worse
from odt_plugins.engine.cells.measures import MEAN_RATIO, cell_measures
from odt_plugins.engine.cells.rows import (
    ALTITUDE,
    CHUNK,
    LARGE,
    ROWS,
    SMALL,
    Q,
    gather_edges,
    quality_rows,
    shape_rows,
)
from odt_plugins.engine.cells.triangle import triangle_altitude, triangle_extremes
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.compiled.threads import run_pieces
from odt_plugins.engine.policy import POLICY
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.chunks import Pool
from odt_plugins.mesh.quantiles import quantile
from odt_plugins.objectives import AIMS, Objective

COS_SMALL = math.cos(math.radians(POLICY.small_angle))

EXTREMES = {"min_quality", "min_angle", "max_angle", "min_altitude"}
"""Figures of single cells."""

ROUNDING = 1e-13
"""Figures and scores that differ by no more are equal."""


@kernel
def _triangle_shapes(points: FloatArray, cells: IntArray, shapes: FloatArray) -> None:
    """Radius ratio, cosines of smallest and largest angle, altitude of every triangle."""
    for c in range(cells.shape[0]):
        i, j, k = cells[c, 0], cells[c, 1], cells[c, 2]
        q, large, small = triangle_extremes(points, i, j, k)
        shapes[c, 0], shapes[c, 1], shapes[c, 2] = q, large, small
        shapes[c, 3] = triangle_altitude(points, i, j, k)


@allocating_kernel
def _tet_shapes(points: FloatArray, cells: IntArray, shapes: FloatArray) -> None:
    """The same of every tetrahedron, with dihedral angles; several at once."""
    rows = np.empty(ROWS)
    slots = np.arange(cells.shape[0])
    for first in range(0, cells.shape[0], CHUNK):
        count = min(CHUNK, cells.shape[0] - first)
        gather_edges(points, cells, slots, first, count, rows)
        quality_rows(0.0, 0.0, 0.0, count, rows)
        shape_rows(count, rows)
        for s in range(count):
            c = first + s
            shapes[c, 0], shapes[c, 1] = rows[Q + s], rows[LARGE + s]
            shapes[c, 2], shapes[c, 3] = rows[SMALL + s], rows[ALTITUDE + s]


@allocating_kernel
def tet_extremes(
    points: FloatArray, cells: IntArray, start: int, stop: int
) -> tuple[float, float, float]:
    """Extremes of the tetrahedra in the slots start to stop, of which some may be free.

    Returned as a plain tuple: what makes a named one for Python would import numba.
    """
    rows = np.empty(ROWS)
    slots = np.arange(start, stop)
    found = BEST
    for first in range(0, stop - start, CHUNK):
        count = min(CHUNK, stop - start - first)
        gather_edges(points, cells, slots, first, count, rows)
        quality_rows(0.0, 0.0, 0.0, count, rows)
        shape_rows(count, rows)
        for s in range(count):
            if cells[start + first + s, 0] >= 0:
                found = worse(found, Extremes(rows[Q + s], rows[LARGE + s], rows[SMALL + s]))
    return found.quality, found.large, found.small


def cell_shapes(
    points: FloatArray, cells: IntArray, pool: Pool | None = None
) -> FloatArray:
    """Radius ratio (5.1), cosines of the smallest and largest angle, least altitude, (m, 4).

    ``pool`` as in ``threads.run_ranges``.
    """
    shapes = np.empty((len(cells), 4))
    measure = _tet_shapes if cells.shape[1] == 4 else _triangle_shapes

    def work(first: int, last: int) -> None:
        measure(points, cells[first:last], shapes[first:last])

    run_pieces(pool, len(cells), work)
    return shapes


@dataclass(frozen=True)
class Figures:
    """Minimum, 1 % quantile and mean of q, cosines of the smallest and the largest angle.

    ``min_altitude`` is the least altitude of a cell, in the unit of the points;
    ``small_angles`` is the share of the cells with an angle below ``POLICY.small_angle``.
    ``score`` is what the best-state memory ranks by: mean and tail of what is improved.
    """

    min_quality: float
    p1_quality: float
    mean_quality: float
    cos_min_angle: float
    cos_max_angle: float
    small_angles: float
    min_altitude: float
    score: float

    def with_extremes_of(self, other: Figures) -> Figures:
        """The same mean and quantile, with the worst cell and the extreme angles of another."""
        return replace(self, min_quality=other.min_quality, cos_min_angle=other.cos_min_angle,
                       cos_max_angle=other.cos_max_angle, min_altitude=other.min_altitude)

    def with_extremes(self, shapes: FloatArray) -> Figures:
        """The same mean and quantile, with the extremes of some :func:`cell_shapes`."""
        return replace(self, min_quality=float(shapes[:, 0].min()),
                       cos_min_angle=float(shapes[:, 1].max()),
                       cos_max_angle=float(shapes[:, 2].min()),
                       min_altitude=float(shapes[:, 3].min()))

    def or_worse(self, other: Figures) -> Figures:
        """The worse of two values of every figure, with the own score."""
        low = ("min_quality", "p1_quality", "mean_quality", "cos_max_angle")
        worse = {name: min(getattr(self, name), getattr(other, name)) for name in low}
        worse |= {name: max(getattr(self, name), getattr(other, name))
                  for name in ("cos_min_angle", "small_angles")}
        return replace(self, **worse)

    def worse_than(self, before: Figures, keep: tuple[str, ...]) -> list[str]:
        """Figures of ``keep`` that are worse than before, beyond rounding."""
        worse = {
            "min_quality": self.min_quality < before.min_quality - ROUNDING,
            "p1_quality": self.p1_quality < before.p1_quality - ROUNDING,
            "mean_quality": self.mean_quality < before.mean_quality - ROUNDING,
            "min_angle": self.cos_min_angle > before.cos_min_angle + ROUNDING,
            "max_angle": self.cos_max_angle < before.cos_max_angle - ROUNDING,
            "min_altitude": self.min_altitude < before.min_altitude * (1.0 - ROUNDING),
            "share_below_20": self.small_angles > before.small_angles + ROUNDING,
        }
        return [name for name in keep if worse.get(name, False)]

    def passed_by(self, shapes: FloatArray, keep: tuple[str, ...]) -> BoolArray:
        """Which cells, (m,), pass an extreme of ``keep``; ``shapes`` as of :func:`cell_shapes`."""
        passed: BoolArray = np.zeros(len(shapes), dtype=np.bool_)
        if "min_quality" in keep:
            passed |= shapes[:, 0] < self.min_quality
        if "min_angle" in keep:
            passed |= shapes[:, 1] > self.cos_min_angle
        if "max_angle" in keep:
            passed |= shapes[:, 2] < self.cos_max_angle
        if "min_altitude" in keep:
            passed |= shapes[:, 3] < self.min_altitude
        return passed


def figures(
    points: FloatArray, cells: IntArray, objective: Objective = "radius_ratio",
    pool: Pool | None = None,
) -> Figures:
    """Compute the named figures of a mesh.

    Parameters
    ----------
    points : (n, d) float64, cells : (m, d + 1) int32
    objective       what the score sums up: radius ratios, smallest angles or AMIPS energies, or
                    radius ratios and the logarithm of the least altitude
    pool            see ``threads.run_ranges``
    """
    shapes = cell_shapes(points, cells, pool)
    q: NDArray[np.float64] = shapes[:, 0]
    least, p1, mean = _spread(q)
    small = float((shapes[:, 1] > COS_SMALL).mean())
    counted = min(small, POLICY.counted_small_angles) if cells.shape[1] == 4 else 0.0
    score = (
        mean + POLICY.score_p1 * p1 + POLICY.score_least * least
        - POLICY.small_angle_price * counted
    )
    altitude = float(shapes[:, 3].min())
    aim = AIMS[objective]
    if aim.by_altitude and altitude > 0.0:
        score += POLICY.score_altitude * math.log(altitude)
    elif aim.by_angles:
        regular = math.acos(1.0 / (cells.shape[1] - 1))
        angles = arccos(np.clip(shapes[:, 1], -1.0, 1.0)) / regular
        smallest, few, average = _spread(angles)
        score = mean + average + few + 0.5 * smallest
    elif aim.mean is not None:
        greatest, few, average = _spread(-amips_energies(points, cells, pool))
        score = average + 0.5 * few + 0.25 * greatest
    return Figures(least, p1, mean, float(shapes[:, 1].max()), float(shapes[:, 2].min()), small,
                   altitude, score)


def _spread(values: NDArray[np.float64]) -> tuple[float, float, float]:
    """Minimum, 1 % quantile and mean."""
    return float(values.min()), quantile(values, 0.01), float(values.mean())


def amips_energies(
    points: FloatArray, cells: IntArray, pool: Pool | None = None
) -> FloatArray:
    """AMIPS energy of every cell as TetWild counts it, (m,): d for the regular one."""
    m = np.empty(len(cells))

    def work(first: int, last: int) -> None:
        cell_measures(points, cells[first:last], MEAN_RATIO, m[first:last])

    run_pieces(pool, len(cells), work)
    dim = cells.shape[1] - 1
    return dim * power(np.maximum(m, 1e-300), -1.0 / dim)
