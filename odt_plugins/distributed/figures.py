"""Quality figures of a whole mesh from those of its parts, none of which is in memory."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from odt_plugins.figures import cell_figures
from odt_plugins.mesh import quantiles
from odt_plugins.mesh.arrays import FloatArray, IntArray, LongArray
from odt_plugins.promise.volume import LOWER_IS_BETTER

PIVOTS = 1 << 10
"""Values that are counted in one pass over the radius ratios of all parts."""

VOLUME = 1e-12
"""Largest relative change of the volume by rounding."""


class Figures(NamedTuple):
    """What has to be known of a part, or of the whole.

    Attributes
    ----------
    cells : int
    quality : float                sum of the radius ratios (5.1)
    volume : float
    min_quality, p1_quality, min_angle, max_angle : float
    below_20 : int                 cells with an angle below 20 degrees
    min_altitude : float
    """

    cells: int
    quality: float
    volume: float
    min_quality: float
    p1_quality: float
    min_angle: float
    max_angle: float
    below_20: int
    min_altitude: float

    @property
    def mean_quality(self) -> float:
        """Mean radius ratio."""
        return self.quality / self.cells

    @property
    def share_below_20(self) -> float:
        """Part of the cells with an angle below 20 degrees."""
        return self.below_20 / self.cells


def measure_part(points: FloatArray, cells: IntArray, path: str) -> Figures:
    """Measure a part, and keep its radius ratios beside ``path``, where it is kept."""
    f = cell_figures(points, cells)
    beside = f"{path}.ratios.part"
    np.sort(f.quality).tofile(beside)
    os.replace(beside, _ratios(path))
    return Figures(len(cells), float(f.quality.sum()), float(f.volume.sum()),
                   float(f.quality.min()), quantiles.quantile(f.quality, 0.01),
                   float(f.min_angle.min()), float(f.max_angle.max()),
                   int(np.count_nonzero(f.min_angle < 20.0)), float(f.altitude.min()))


def _ratios(path: str) -> str:
    return f"{path}.ratios"


def total(parts: Sequence[tuple[str, Figures]]) -> Figures:
    """Figures of all parts together, each with the path where it is kept."""
    figures = [f for _, f in parts]
    cells = sum(f.cells for f in figures)
    return Figures(
        cells,
        sum(f.quality for f in figures),
        sum(f.volume for f in figures),
        min(f.min_quality for f in figures),
        quantile([_ratios(path) for path, _ in parts], cells, 0.01),
        min(f.min_angle for f in figures),
        max(f.max_angle for f in figures),
        sum(f.below_20 for f in figures),
        min(f.min_altitude for f in figures),
    )


def quantile(files: Sequence[str], count: int, share: float) -> float:
    """Quantile of ``count`` values in files, each ascending, as ``numpy.quantile`` computes it."""
    place = (count - 1) * share
    rank = int(place)
    low, high = (_of_rank(files, k) for k in (rank, min(rank + 1, count - 1)))
    return quantiles.between(low, high, place - rank)


def _of_rank(files: Sequence[str], rank: int) -> float:
    """The value of that rank, from 0, among those from 0 to 1 in some files.

    Numbers from 0 are in the order of their bits, read as integers. The bits that are sought are
    above ``low`` and at most ``high``.
    """
    low, high = -1, int(np.float64(2.0).view(np.int64))
    while high - low > 1:
        step = max(1, (high - low) // PIVOTS)
        pivots = np.arange(low + step, high, step)
        first = int(np.searchsorted(_counts(files, pivots), rank, side="right"))
        bounds = [low, *pivots.tolist(), high]
        low, high = bounds[first], bounds[first + 1]
    return float(np.int64(high).view(np.float64))


def _counts(files: Sequence[str], pivots: LongArray) -> LongArray:
    """How many values of all files are at most as large as each of the pivots, given as bits."""
    counts = np.zeros(len(pivots), dtype=np.int64)
    for path in files:
        values = np.memmap(path, np.float64, "r")
        counts += np.searchsorted(values, pivots.view(np.float64), side="right")
    return counts


def worse(before: Figures, after: Figures, keep: Sequence[str]) -> list[str]:
    """Say which figures of the whole got worse, one sentence each; the volume is always kept."""
    found = []
    for name in keep:
        old, new = getattr(before, name), getattr(after, name)
        slack = 1e-12 * abs(old)
        if (new > old + slack) if name in LOWER_IS_BETTER else (new < old - slack):
            found.append(f"{name} went from {old:.6g} to {new:.6g}")
    if abs(after.volume - before.volume) > VOLUME * before.volume:
        found.append(f"the volume went from {before.volume:.15g} to {after.volume:.15g}")
    return found
