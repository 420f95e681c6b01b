"""Long arrays in chunks: what numpy makes on the way stays in cache, and threads share the work."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

CHUNK = 1 << 14
"""Items of a chunk: its work arrays stay in cache."""


def chunks(m: int) -> Iterator[slice]:
    """Cut range(m) into parts, the same for any number of threads."""
    return (slice(i, min(i + CHUNK, m)) for i in range(0, m, CHUNK))


def spread(work: Callable[[T], R], items: Iterable[T], threads: int) -> list[R]:
    """Call ``work`` on every item, by several threads at a time; what it returned, in order."""
    if threads == 1:
        return [work(item) for item in items]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, items))
