"""What a caller gives as numbers, as floats."""

from __future__ import annotations

from typing import Any

import numpy as np

from odt_plugins.errors import InvalidOptionError
from odt_plugins.mesh.arrays import FloatArray


def real_numbers(raw: Any, what: str, expected: str) -> FloatArray:
    """Give an array of real numbers as float64; one sentence with these words refuses all else.

    Raises
    ------
    InvalidOptionError    truth values, complex numbers, times, texts or ragged rows
    """
    try:
        found = np.asarray(raw)
        if found.dtype.kind in "bcmMSU":
            msg = f"they are of type {found.dtype}"
            raise TypeError(msg)
        return found.astype(np.float64)
    except (TypeError, ValueError) as exc:
        msg = f"got {what}: {exc}; expected {expected}"
        raise InvalidOptionError(msg) from exc
