"""How the kernels that call each other by the million are compiled."""

from __future__ import annotations

from typing import Any

from numba import njit
from numba.core.cpu import CPUTargetOptions

UNCOUNTED: dict[str, Any] = {"_nrt": False} if hasattr(CPUTargetOptions, "_nrt") else {}
"""numba counts the references to every array that a call hands on, by atomic operations that
take longer than most of our calls.  Code that allocates nothing does not need it."""

kernel = njit(nogil=True, cache=True, error_model="numpy", **UNCOUNTED)
"""Decorator of a scalar kernel that allocates no array; its caller keeps the arrays alive."""
