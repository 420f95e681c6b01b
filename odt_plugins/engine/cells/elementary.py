"""Elementary functions of arrays by the C library, value after value.

Those of numpy take the widest instructions of the processor, and their last bit with them.
"""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.mesh.arrays import FloatArray


@kernel
def _exp(x: FloatArray) -> None:
    for i in range(x.size):
        x[i] = math.exp(x[i])


@kernel
def _log(x: FloatArray) -> None:
    for i in range(x.size):
        x[i] = math.log(x[i])


@kernel
def _arccos(x: FloatArray) -> None:
    for i in range(x.size):
        x[i] = math.acos(x[i])


@kernel
def _power(x: FloatArray, exponent: float) -> None:
    for i in range(x.size):
        x[i] = x[i] ** exponent


def exp(x: FloatArray) -> FloatArray:
    """E to the power of every value, any shape."""
    out = np.array(x, dtype=np.float64, order="C")
    _exp(out.reshape(-1))
    return out


def log(x: FloatArray) -> FloatArray:
    """Natural logarithm of every value, any shape; -inf for 0."""
    out = np.array(x, dtype=np.float64, order="C")
    _log(out.reshape(-1))
    return out


def arccos(x: FloatArray) -> FloatArray:
    """Angle of every cosine between -1 and 1, any shape, in radians."""
    out = np.array(x, dtype=np.float64, order="C")
    _arccos(out.reshape(-1))
    return out


def power(x: FloatArray, exponent: float) -> FloatArray:
    """Every value, any shape, to the power of the exponent."""
    out = np.array(x, dtype=np.float64, order="C")
    _power(out.reshape(-1), float(exponent))
    return out
