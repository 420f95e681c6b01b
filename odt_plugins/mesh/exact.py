"""Signs of volumes without rounding, in whole numbers: slow, for what rounding leaves open."""

from __future__ import annotations

from typing import Any

import numpy as np

from odt_plugins.mesh.arrays import FloatArray
from odt_plugins.mesh.simplex import determinant

Whole = list[int]
"""Coordinates of a point in a common unit."""


def whole_numbers(points: FloatArray) -> list[Whole]:
    """Coordinates of finite points (k, d) as multiples of a power of 2 that they share."""
    ratios = [[x.as_integer_ratio() for x in point] for point in points.tolist()]
    unit = max(bottom for point in ratios for _, bottom in point)
    return [[top * (unit // bottom) for top, bottom in point] for point in ratios]


def exact_sign(first: Whole, *others: Whole) -> int:
    """Sign, -1, 0 or 1, of the signed volume of a simplex by its corners."""
    rows = [[x - y for x, y in zip(corner, first, strict=True)] for corner in others]
    volume: Any = np.asarray(determinant(rows)).item()  # type: ignore[arg-type]
    return int(volume > 0) - int(volume < 0)
