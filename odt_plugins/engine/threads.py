"""Work cut into chunks for a pool: the result does not depend on it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from itertools import pairwise
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:
    from odt_plugins.engine.coloring import Coloring

T = TypeVar("T")

SMALLEST = 256
"""Fewer vertices of one colour than this are not worth a second thread."""


PART = 1 << 15
"""Length of a part of a range."""


def thread_pool(threads: int) -> AbstractContextManager[ThreadPoolExecutor | None]:
    """A pool of so many threads, None for one, which does everything by itself."""
    return ThreadPoolExecutor(threads) if threads > 1 else nullcontext()


def run_chunks(
    pool: ThreadPoolExecutor | None,
    threads: int,
    coloring: Coloring,
    work: Callable[[int, int], T],
) -> list[T]:
    """Call ``work(start, stop)`` over the vertices of every colour; returns what it returned.

    Parameters
    ----------
    pool : ThreadPoolExecutor or None    None runs everything here, in one call
    threads : int                        chunks a colour is cut into, between blocks
    coloring : Coloring
    work : callable                      releases the GIL; works on coloring.order[start:stop]
    """
    blocks = coloring.blocks
    if pool is None:
        return [work(0, int(blocks[-1]))]
    results = []
    for first, last in pairwise(coloring.offsets.tolist()):
        if blocks[last] - blocks[first] < SMALLEST:
            results.append(work(int(blocks[first]), int(blocks[last])))
            continue
        cuts = [int(blocks[first + (last - first) * t // threads]) for t in range(threads + 1)]
        results += pool.map(work, cuts[:-1], cuts[1:])
    return results


def run_ranges(
    pool: ThreadPoolExecutor | None, size: int, work: Callable[[int, int], T]
) -> list[T]:
    """Call ``work(start, stop)`` over parts of range(size); returns what it returned.

    The parts are the same for any number of threads, so that sums over them are too.

    Parameters
    ----------
    pool : ThreadPoolExecutor or None    None runs everything here
    size : int
    work : callable                      releases the GIL; the parts are independent
    """
    starts = range(0, size, PART)
    stops = [min(start + PART, size) for start in starts]
    return list(map(work, starts, stops) if pool is None else pool.map(work, starts, stops))
