"""Long arrays in chunks: what numpy makes on the way stays in cache, and threads share the work."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from threading import Condition
from typing import Any, TypeVar

T = TypeVar("T")
R = TypeVar("R")

CHUNK = 1 << 15
"""Items of a chunk: its work arrays stay in cache, and threads seldom wait for the interpreter
between two calls of numpy."""


class Pool(ThreadPoolExecutor):
    """Threads of which the caller is one: it wakes the others and works with them.

    Each thread takes the next call when it is done with one.

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
        """Call ``fn`` as :func:`map` does, but wait, see :meth:`run`.

        ``timeout`` and ``chunksize`` mean nothing.
        """
        return iter(self.run(fn, list(zip(*iterables, strict=False))))

    def run(
        self, fn: Callable[..., R], calls: Sequence[tuple[Any, ...]],
        after: Iterable[Sequence[int]] = (),
    ) -> list[R]:
        """Call ``fn`` with what is in ``calls`` and wait; of several errors the first is raised.

        Parameters
        ----------
        fn : callable
        calls : sequence of tuples
        after : pairs (a, b) of indices, a < b    call b begins when call a has ended
        """
        results: list[Any] = [None] * len(calls)
        failed: dict[int, Exception] = {}
        missing = [0] * len(calls)
        followers: list[list[int]] = [[] for _ in calls]
        for a, b in after:
            missing[b] += 1
            followers[a].append(b)
        ready = deque(i for i, count in enumerate(missing) if count == 0)
        held = set(range(len(calls))).difference(ready)
        turn = Condition()

        def stop() -> None:
            with turn:
                ready.clear()
                held.clear()
                turn.notify_all()

        def work() -> None:
            while True:
                with turn:
                    turn.wait_for(lambda: ready or not held)
                    if not ready:
                        return
                    i = ready.popleft()
                try:
                    results[i] = fn(*calls[i])
                except Exception as exc:
                    failed[i] = exc
                    stop()
                with turn:
                    for j in followers[i]:
                        missing[j] -= 1
                        if missing[j] == 0 and j in held:
                            held.remove(j)
                            ready.append(j)
                    turn.notify_all()

        helpers = [self.submit(work) for _ in range(min(self.others, len(calls) - 1))]
        try:
            work()
            for helper in helpers:
                if not helper.cancel():
                    helper.result()
        finally:
            stop()
        if failed:
            raise failed[min(failed)]
        return results


def chunks(m: int) -> Iterator[slice]:
    """Cut range(m) into parts, the same for any number of threads."""
    return (slice(i, min(i + CHUNK, m)) for i in range(0, m, CHUNK))


def spread(work: Callable[[T], R], items: Iterable[T], threads: int) -> list[R]:
    """Call ``work`` on every item, by several threads at a time; what it returned, in order."""
    items = list(items)
    if threads == 1 or len(items) < 2:
        return [work(item) for item in items]
    with Pool(threads) as pool:
        return pool.run(work, [(item,) for item in items])
