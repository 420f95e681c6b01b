"""Quality figures of a whole mesh from those of its parts, none of which is in memory."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from odt_plugins.figures import QualitySummary, cell_figures, summarize
from odt_plugins.mesh import quantiles
from odt_plugins.mesh.arrays import FloatArray, IntArray, LongArray
from odt_plugins.promise.volume import LOWER_IS_BETTER
from odt_plugins.report.report import histogram

PIVOTS = 1 << 10
"""Values that are counted in one pass over the radius ratios of all parts."""

VOLUME = 1e-12
"""Largest relative change of the volume by rounding."""


class Figures(NamedTuple):
    """Figures of a part, and what those of the whole are made of.

    Attributes
    ----------
    summary : QualitySummary
    sums : (4,) float64          of radius ratios, AMIPS energies, circumradii, and their squares
    histogram : tuple of int     counts of the radius ratio in 50 bins
    """

    summary: QualitySummary
    sums: FloatArray
    histogram: tuple[int, ...]


def measure_part(points: FloatArray, cells: IntArray, path: str) -> Figures:
    """Measure a part, and keep its radius ratios beside ``path``, where it is kept."""
    f = cell_figures(points, cells)
    beside = f"{path}.ratios.part"
    np.sort(f.quality).tofile(beside)
    os.replace(beside, _ratios(path))
    columns = (f.quality, f.amips, f.circumradius, f.circumradius * f.circumradius)
    return Figures(summarize(points, cells, f), np.array([x.sum() for x in columns]),
                   histogram(f.quality))


def _ratios(path: str) -> str:
    return f"{path}.ratios"


def total(parts: Sequence[tuple[str, Figures]]) -> QualitySummary:
    """Figures of all parts together, each with the path where it is kept.

    Vertices of several parts count in each of them.
    """
    each = [f.summary for _, f in parts]
    cells = sum(s.n_cells for s in each)
    ratios, energies, radii, squares = np.sum([f.sums for _, f in parts], axis=0).tolist()
    spread = max(0.0, squares - radii * radii / cells) / max(1, cells - 1)
    found: dict[str, Any] = {
        name: join(getattr(s, name) for s in each) for join, names in (
            (sum, ("n_points", "n_cells", "below_5", "below_10", "below_20", "inverted", "volume")),
            (min, ("min_quality", "min_angle", "min_altitude")), (max, ("max_angle", "max_amips")))
        for name in names}
    return replace(
        each[0], **found, mean_quality=ratios / cells, mean_amips=energies / cells,
        p1_quality=quantile([_ratios(path) for path, _ in parts], cells, 0.01),
        uniformity=math.sqrt(spread) * cells / radii if math.isfinite(radii) else math.inf)


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


def worse(before: QualitySummary, after: QualitySummary, keep: Sequence[str]) -> list[str]:
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
