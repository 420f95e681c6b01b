"""What applies a function to the items of a job, wherever the work is done."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from odt_plugins.options import Progress

Apply = Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[Any]]
"""Applies a function to items and gives the results in the order of the items."""


def told(apply: Apply, report: Progress, stage: str, count: int) -> Apply:
    """Give `apply` again, telling `report` the stage and the share of `count` items that is done.

    An item is done when its result has been used, for the next one is then asked for.
    """
    def telling(function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
        report(stage, 0.0)
        for done, result in enumerate(apply(function, items), 1):
            yield result
            report(stage, done / count)

    return telling
