"""Long arrays in chunks: what numpy makes on the way stays in cache, and threads share the work."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

T = TypeVar("T")
R = TypeVar("R")

CHUNK = 1 << 14
"""Items of a chunk: its work arrays stay in cache."""


class Pool(ThreadPoolExecutor):
    """Threads of which the caller is one: a call of ``map`` wakes the others and works with them.

    Parameters
    ----------
    threads : int    at least 2
    """

    def __init__(self, threads: int) -> None:
        self.others = threads - 1
        super().__init__(self.others)

    def map(
        self, fn: Callable[..., R], *iterables: Iterable[Any], timeout: float | None = None,
        chunksize: int = 1,
    ) -> Iterator[R]:
        """Call ``fn`` as :func:`map` does, and wait; of several errors the first one is raised.

        Each thread takes the next call when it is done with one; ``timeout`` and ``chunksize``
        mean nothing.
        """
        calls = deque(enumerate(zip(*iterables, strict=False)))
        results: list[Any] = [None] * len(calls)
        failed: dict[int, Exception] = {}

        def work() -> None:
            while True:
                try:
                    i, given = calls.popleft()
                except IndexError:
                    return
                try:
                    results[i] = fn(*given)
                except Exception as exc:
                    failed[i] = exc
                    calls.clear()

        helpers = [self.submit(work) for _ in range(min(self.others, len(calls) - 1))]
        try:
            work()
            for helper in helpers:
                if not helper.cancel():
                    helper.result()
        finally:
            calls.clear()
        if failed:
            raise failed[min(failed)]
        return iter(results)


def chunks(m: int) -> Iterator[slice]:
    """Cut range(m) into parts, the same for any number of threads."""
    return (slice(i, min(i + CHUNK, m)) for i in range(0, m, CHUNK))


def spread(work: Callable[[T], R], items: Iterable[T], threads: int) -> list[R]:
    """Call ``work`` on every item, by several threads at a time; what it returned, in order."""
    if threads == 1:
        return [work(item) for item in items]
    with Pool(threads) as pool:
        return list(pool.map(work, items))
