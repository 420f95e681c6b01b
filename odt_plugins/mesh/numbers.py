"""What a caller gives as numbers: floats, masks, indices."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from odt_plugins.errors import InvalidOptionError
from odt_plugins.mesh.arrays import BoolArray, FloatArray


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
    except (TypeError, ValueError, OverflowError) as exc:
        msg = f"got {what}: {exc}; expected {expected}"
        raise InvalidOptionError(msg) from exc


def even_rows(name: str, values: Any) -> NDArray[Any]:
    """Give the value of an option as an array.

    Raises
    ------
    InvalidOptionError    it has rows of several lengths
    """
    try:
        return np.asarray(values)
    except ValueError as exc:
        msg = (f"got {name} with rows of several lengths; expected one value each, or rows of one "
               f"length")
        raise InvalidOptionError(msg) from exc


def vertex_mask(value: ArrayLike | None, count: int, name: str, what: str) -> BoolArray:
    """Bring a mask or a list of indices into a mask (count,).

    Raises
    ------
    InvalidOptionError    it is neither, or may be meant as a mask and has no truth values
    """
    mask = np.zeros(count, dtype=np.bool_)
    if value is None:
        return mask
    if isinstance(value, str):
        msg = (f"got {name}={value!r}; expected a boolean mask of the {what} ({count},) or a list "
               f"of their indices, try the array of that name itself")
        raise InvalidOptionError(msg)
    raw = even_rows(name, value)
    if raw.dtype.kind == "b":
        if raw.shape != (count,):
            msg = f"{name} is a mask of shape {raw.shape}; expected ({count},), as many as {what}"
            raise InvalidOptionError(msg)
        return raw.copy()
    if raw.size == 0:
        return mask
    if raw.ndim != 1 or raw.dtype.kind not in "iu":
        msg = (f"{name} has dtype {raw.dtype} and shape {raw.shape}; expected a boolean mask of "
               f"the {what} ({count},) or a list of their indices")
        raise InvalidOptionError(msg)
    bad = np.flatnonzero((raw < 0) | (raw >= count))
    if bad.size:
        msg = (f"{name}[{bad[0]}] is {raw[bad[0]]} ({bad.size} out of range); expected indices of "
               f"{what} from 0 to {count - 1}")
        raise InvalidOptionError(msg)
    most = max(1, raw.max())
    if raw.size > 2 and (most == 1 or raw.size == count) and np.isin(raw, (0, most)).all():
        msg = (f"got {name} with {raw.size} numbers that all are 0 or {most}, as of a mask; "
               f"expected a boolean mask of the {what} ({count},) or a list of their indices, each "
               f"once, try {name}.astype(bool)")
        raise InvalidOptionError(msg)
    mask[raw] = True
    return mask
