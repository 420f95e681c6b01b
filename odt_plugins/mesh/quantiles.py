"""Quantiles as ``numpy.quantile`` computes them.

Numpy does much besides on the way to one share, and imports its masked arrays for it.
"""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.mesh.arrays import FloatArray


def quantile(values: FloatArray, share: float) -> float:
    """Value below which a share of some values lies, interpolated between the two next to it.

    Parameters
    ----------
    values : (m,) float64    m at least 1
    share : float            from 0 to 1

    Returns
    -------
    float                    NaN where a value is
    """
    last = len(values) - 1
    low = int(last * share)
    places = [low, min(low + 1, last), last]
    a, b, most = np.partition(values, places)[places].tolist()
    return between(a, b, last * share - low) if most == most else math.nan


def between(a: float, b: float, part: float) -> float:
    """The number that is this part of the way from a to b, both of which it reaches."""
    gap = b - a
    return b - gap * (1.0 - part) if part >= 0.5 else a + gap * part
