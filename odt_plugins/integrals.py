"""By how much the integrals of cell arrays changed, since new cells take the data of old ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.figures import volumes
from odt_plugins.mesh.arrays import FloatArray, IntArray

SAME = 1e-9
"""Relative change of an integral from which on it is told."""


def changed_integrals(
    arrays: Mapping[str, NDArray[Any]],
    before: tuple[FloatArray, IntArray],
    after: tuple[FloatArray, IntArray],
    source: IntArray,
) -> dict[str, float]:
    """Relative changes of the sums of value by volume of cell that are larger than SAME.

    Parameters
    ----------
    arrays : dict of (m, ...)         floating-point numbers, one or several for every cell before
    before, after : points, cells     (n, d) float64 and (m, k) int32, both times
    source : (m',) int                cell before from which each one has its values

    Returns
    -------
    dict of float                     by the integral of the absolute value before, and of several
                                      numbers the largest; arrays that are not finite are left out
    """
    if not arrays:
        return {}
    old, new = np.abs(volumes(*before)), np.abs(volumes(*after))
    gained = np.bincount(source, new, len(old)) - old
    out = {}
    for name, values in arrays.items():
        rows = values.reshape(len(old), -1).astype(np.result_type(values, np.float64))
        if not np.isfinite(rows).all():
            continue
        change = np.abs((gained[:, None] * rows).sum(axis=0))
        size = (old[:, None] * np.abs(rows)).sum(axis=0)
        told = change > SAME * size
        if told.any():
            out[name] = float((change[told] / size[told]).max())
    return out
