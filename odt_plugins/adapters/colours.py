"""Which numbers are colours: whole ones have others between them, and no integral says anything."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

CHANNEL = re.compile(r"red|green|blue|alpha")
"""Names, in small letters and without anything but letters, of arrays of one part of a colour."""

PAINT = re.compile(r".*colou?rs?")
"""Such names of arrays of three or four floating-point numbers each that are a colour."""


def is_paint(name: str, values: NDArray[Any]) -> bool:
    """Whether these are floating-point numbers, three or four each, that are called a colour."""
    return (values.dtype.kind == "f" and values.ndim == 2 and values.shape[1] in (3, 4)
            and PAINT.fullmatch(re.sub(r"[^a-z]", "", name.lower())) is not None)


def is_colour(name: str, values: NDArray[Any]) -> bool:
    """Whether these are bytes, three or four each, or called red, green, blue or alpha.

    Numbers of two bytes are so if they are called that.
    """
    if values.ndim == 1 and values.dtype in (np.uint8, np.uint16):
        return CHANNEL.fullmatch(re.sub(r"[^a-z]", "", name.lower())) is not None
    return values.dtype == np.uint8 and values.ndim == 2 and values.shape[1] in (3, 4)


def varies(name: str, values: NDArray[Any]) -> bool:
    """Whether there are values between those of an array: of floating-point numbers, or colours."""
    return values.dtype.kind in "fc" or is_colour(name, values)


def in_kind(values: NDArray[Any], like: NDArray[Any]) -> NDArray[Any]:
    """Values as the nearest whole numbers of the type of others, if these are whole numbers."""
    if like.dtype.kind not in "iu":
        return values
    least, most = np.iinfo(like.dtype).min, np.iinfo(like.dtype).max
    return np.asarray(np.clip(np.rint(values), least, most).astype(like.dtype))
