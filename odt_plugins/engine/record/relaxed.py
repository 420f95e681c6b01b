"""Figures of the input down to which a mesh with other sizes may fall."""

from __future__ import annotations

import math
from dataclasses import replace

from odt_plugins.engine.record.figures import COS_SMALL, Figures
from odt_plugins.mesh.arrays import BoolArray, FloatArray
from odt_plugins.promise.good import good_enough


def relaxed(before: Figures, keep: tuple[str, ...], corners: int) -> Figures:
    """The figures of the input, or those that are good enough where these are worse."""
    good = good_enough(keep, corners)
    if not good:
        return before
    small, large = (math.cos(math.radians(good[name])) for name in ("min_angle", "max_angle"))
    return before.or_worse(replace(
        before, min_quality=good["min_quality"], p1_quality=good["p1_quality"],
        mean_quality=good["mean_quality"], small_angles=good["share_below_20"],
        cos_min_angle=small, cos_max_angle=large))


def spoiling(
    bounds: Figures, after: Figures, shapes: FloatArray, keep: tuple[str, ...]
) -> BoolArray:
    """Which cells (m,) of a mesh make its figures worse than bounds.

    They pass an extreme, or are of a tail that became worse. ``after`` are the figures of the mesh,
    ``shapes`` its ``figures.cell_shapes``.
    """
    spoiled, worse = bounds.passed_by(shapes, keep), after.worse_than(bounds, keep)
    if "p1_quality" in worse:
        spoiled |= shapes[:, 0] < bounds.p1_quality
    if "share_below_20" in worse:
        spoiled |= shapes[:, 1] > COS_SMALL
    return spoiled
