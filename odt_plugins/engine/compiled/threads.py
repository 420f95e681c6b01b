"""Work cut into chunks for a pool, and into pieces for signals: the result depends on neither."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import TypeVar

from odt_plugins.mesh.chunks import Pool

T = TypeVar("T")

PART = 1 << 15
"""Length of a part of a range."""

PIECE = 1 << 12
"""Most vertices, cells or edges that one call of a kernel visits: Python handles a signal, such as
Ctrl-C, only between two calls."""

COSTLY = 1 << 8
"""The same where one of them may take a millisecond."""

THREADED_CELLS = 40_000
"""Smaller meshes are done by one thread: others would wait, and be waited for, more than work."""


def pieces(start: int, stop: int, *, costly: bool = False) -> Iterator[tuple[int, int]]:
    """Cut range(start, stop) into pieces of at most PIECE, or COSTLY, in order."""
    most = COSTLY if costly else PIECE
    return ((first, min(first + most, stop)) for first in range(start, stop, most))


def worth(threads: int, cells: int) -> int:
    """How many of some threads a mesh of so many cells is worth."""
    return threads if cells >= THREADED_CELLS else 1


def thread_pool(threads: int) -> AbstractContextManager[Pool | None]:
    """A pool of so many threads, None for one, which does everything by itself."""
    return Pool(threads) if threads > 1 else nullcontext()


def run_ranges(pool: Pool | None, size: int, work: Callable[[int, int], T]) -> list[T]:
    """Call ``work(start, stop)`` over parts of range(size); returns what it returned.

    The parts are the same for any number of threads, so that sums over them are too.

    Parameters
    ----------
    pool : Pool or None    None runs everything here
    size : int
    work : callable                      releases the GIL; the parts are independent
    """
    if 0 < size <= PART:
        return [work(0, size)]
    starts = range(0, size, PART)
    stops = [min(start + PART, size) for start in starts]
    return list(map(work, starts, stops) if pool is None else pool.map(work, starts, stops))


def run_pieces(pool: Pool | None, size: int, work: Callable[[int, int], object]) -> None:
    """Call ``work(start, stop)`` over pieces of the parts of range(size), as :func:`run_ranges`."""
    def part(start: int, stop: int) -> None:
        for first, last in pieces(start, stop):
            work(first, last)

    run_ranges(pool, size, part)
