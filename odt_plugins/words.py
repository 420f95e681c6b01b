"""Values from words, as command lines and ParaView have them."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any


def smoothing_of(words: Sequence[str]) -> dict[str, Any]:
    """Values of the option `smoothing` from words such as rounds=80."""
    values: dict[str, Any] = {}
    for word in words:
        name, _, text = word.partition("=")
        values[name] = text
        for kind in (int, float):
            with suppress(ValueError):
                values[name] = kind(text)
                break
    return values
