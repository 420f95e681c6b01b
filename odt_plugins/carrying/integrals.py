"""By how much the integrals of arrays changed, since a new mesh samples what the old one holds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.figures import volumes
from odt_plugins.mesh.arrays import FloatArray, IntArray

SAME = 1e-9
"""Relative change of an integral from which on it is told, unless the type is coarser."""

Pairs = Mapping[str, tuple[NDArray[Any], NDArray[Any]]]
Mesh = tuple[FloatArray, IntArray]


def changed_integrals(arrays: Pairs, before: Mesh, after: Mesh) -> dict[str, float]:
    """Relative changes of the sums of value by volume of cell that are larger than SAME, and than
    what the type of the values tells apart.

    Parameters
    ----------
    arrays : dict of (m, ...), (m', ...)    floating-point numbers, one or several for every cell
                                            before, and for every one after
    before, after : points, cells           (n, d) float64 and (m, k) int32, both times

    Returns
    -------
    dict of float                           by the integral of the absolute value before, and of
                                            several numbers the largest; arrays that are not finite
                                            are left out
    """
    if not arrays:
        return {}
    sizes = np.abs(volumes(*before)), np.abs(volumes(*after))
    out = {}
    for name, pair in arrays.items():
        old, new = (values.reshape(len(size), -1).astype(np.result_type(values, np.float64))
                    for values, size in zip(pair, sizes, strict=True))
        if not (np.isfinite(old).all() and np.isfinite(new).all()):
            continue
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            total = (sizes[0][:, None] * old).sum(axis=0)
            change = np.abs((sizes[1][:, None] * new).sum(axis=0) - total)
            size = (sizes[0][:, None] * np.abs(old)).sum(axis=0)
            told = change > max(SAME, float(np.finfo(pair[1].dtype).eps)) * size
            if told.any():
                out[name] = float((change[told] / size[told]).max())
    return out


def of_points(arrays: Pairs, before: Mesh, after: Mesh) -> Pairs:
    """Means over the corners of every cell of values (n, ...), (n', ...) at the vertices.

    They have the type of the values. Means that are out of range are not finite.
    """
    wide = {name: tuple(values.astype(np.result_type(values, np.float64)) for values in pair)
            for name, pair in arrays.items()}
    with np.errstate(over="ignore", invalid="ignore"):
        return {name: tuple(of.astype(values.dtype) for of, values in zip(
            (old[before[1]].mean(axis=1), new[after[1]].mean(axis=1)), arrays[name], strict=True))
                for name, (old, new) in wide.items()}
