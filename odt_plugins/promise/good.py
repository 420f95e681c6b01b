"""Figures of a mesh with other sizes: those that are named never fall, others not below GOOD.

Cells of other sizes have other shapes: of a mesh that is nearly perfect no coarser one is as good.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from odt_plugins.figures import CellFigures, QualitySummary, cell_figures, measured, summarize
from odt_plugins.mesh.seen import as_seen
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.options import KEPT
from odt_plugins.promise.volume import LOWER_IS_BETTER, worse_figures

GOOD = {
    3: {"min_quality": 0.3, "p1_quality": 0.5, "mean_quality": 0.8, "min_angle": 20.0,
        "max_angle": 130.0, "share_below_20": 0.02},
    4: {"min_quality": 0.3, "p1_quality": 0.5, "mean_quality": 0.8, "min_angle": 15.0,
        "max_angle": 150.0, "share_below_20": 0.02},
}
"""Figures of triangles, of 3 corners, and of tetrahedra that are good enough for other sizes, also
where those of the input are better; angles in degrees."""

SMALL = 20.0
"""Degrees below which an angle makes a cell a poor one."""

REGULAR = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 0.75**0.5, 0.0],
                    [0.5, 0.75**0.5 / 3.0, (2.0 / 3.0) ** 0.5]])
"""Corners of a tetrahedron all of whose edges have the length 1."""


def good_enough(keep: Sequence[str], corners: int) -> dict[str, float]:
    """Figures down to which those of ``keep`` may fall: none where others than KEPT are named."""
    return GOOD[corners] if tuple(keep) == KEPT else {}


def fallen_figures(
    old: QualitySummary, new: QualitySummary, keep: Sequence[str], corners: int
) -> list[str]:
    """Say which of the figures ``keep`` got worse, and are not good enough for other sizes."""
    good = good_enough(keep, corners)
    poor = []
    for name in keep:
        value = float(getattr(new, name))
        enough = name in good and (
            value <= good[name] if name in LOWER_IS_BETTER else value >= good[name])
        if not enough:
            poor.append(name)
    return worse_figures(old, new, poor)


def filled_up(
    points: NDArray[np.float64], cells: NDArray[np.int32], count: int
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Triangles or tetrahedra with as many regular ones beside them as are missing from a count.

    The 1 % quantile and the share below 20 degrees of these are worse than those of as many other
    cells only where more cells, or worse ones, are poor, and not where good ones are gone.
    """
    n, corners = len(points), cells.shape[1]
    missing = max(count - len(cells), 0)
    regular = REGULAR[:corners, : points.shape[1]]
    rows = np.broadcast_to(np.arange(n, n + corners, dtype=cells.dtype), (missing, corners))
    return np.concatenate([points, regular]), np.concatenate([cells, rows])


def fallen_since(
    before: SimplexMesh, points: NDArray[np.float64], cells: NDArray[np.int32],
    metric: NDArray[np.float64], keep: Sequence[str], figures: CellFigures | None = None,
    full: int = 0,
) -> list[str]:
    """Say as :func:`fallen_figures` which figures of a remeshed mesh got worse, as metrics see it.

    ``figures`` are those of the mesh without a metric, when they are at hand; cells are filled up
    to ``full``, see :func:`filled_up`, and the mean is that of the cells that are not poor.
    """
    if not keep:
        return []
    seen = as_seen(points, cells, metric)
    old = measured(before).summary
    if full:
        was = as_seen(before.points, before.cells, before.metric)
        old = replace(old, mean_quality=mean_but_poor(*was))
        new = replace(summarize(*filled_up(*seen, full)), mean_quality=mean_but_poor(*seen))
    else:
        new = summarize(*seen, None if len(metric) else figures)
    return fallen_figures(old, new, keep, cells.shape[1])


def mean_but_poor(points: NDArray[np.float64], cells: NDArray[np.int32]) -> float:
    """Mean radius ratio of the cells without an angle below 20 degrees, 1 where there are none."""
    found = cell_figures(points, cells)
    good = found.quality[found.min_angle >= SMALL]
    return float(good.mean()) if len(good) else 1.0
