"""Quality figures of a whole mesh from those of its parts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.quality import cell_figures

BINS = 1 << 12
"""Bins of the radius ratio, from which the 1 % quantile of the whole is read: to 2.5e-4."""

VOLUME = 1e-12
"""Largest relative change of the volume by rounding."""


class Figures(NamedTuple):
    """What has to be known of a part.

    Attributes
    ----------
    cells : int
    quality : float                sum of the radius ratios (5.1)
    volume : float
    min_quality, min_angle, max_angle : float
    histogram : (BINS,) int64      of the radius ratios in [0, 1]
    """

    cells: int
    quality: float
    volume: float
    min_quality: float
    min_angle: float
    max_angle: float
    histogram: NDArray[np.int64]

    @property
    def mean_quality(self) -> float:
        """Mean radius ratio."""
        return self.quality / self.cells

    @property
    def p1_quality(self) -> float:
        """1 % quantile of the radius ratio, rounded down to a bin."""
        return float(np.searchsorted(np.cumsum(self.histogram), 0.01 * self.cells)) / BINS


def figures_of(points: FloatArray, cells: IntArray) -> Figures:
    """Measure a part."""
    f = cell_figures(points, cells)
    place = np.clip((f.quality * BINS).astype(np.int64), 0, BINS - 1)
    return Figures(len(cells), float(f.quality.sum()), float(f.volume.sum()),
                   float(f.quality.min()), float(f.min_angle.min()), float(f.max_angle.max()),
                   np.bincount(place, minlength=BINS))


def total(parts: Sequence[Figures]) -> Figures:
    """Figures of all parts together."""
    columns = list(zip(*parts, strict=True))
    cells, quality, volume, histogram = (sum(columns[i]) for i in (0, 1, 2, 6))
    return Figures(cells, quality, volume, min(columns[3]), min(columns[4]), max(columns[5]),
                   np.asarray(histogram))


def worse(before: Figures, after: Figures, keep: Sequence[str]) -> list[str]:
    """Say which figures of the whole got worse, one sentence each; the volume is always kept."""
    found = []
    for name in keep:
        old, new = getattr(before, name), getattr(after, name)
        slack = 1e-12 * abs(old)
        if (new > old + slack) if name == "max_angle" else (new < old - slack):
            found.append(f"{name} went from {old:.6g} to {new:.6g}")
    if abs(after.volume - before.volume) > VOLUME * before.volume:
        found.append(f"the volume went from {before.volume:.15g} to {after.volume:.15g}")
    return found
