"""Colour after colour, each cut into chunks for a pool: the result does not depend on it."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

from odt_plugins.mesh import LongArray

SMALLEST = 256


def run_chunks(
    pool: ThreadPoolExecutor | None,
    threads: int,
    offsets: LongArray,
    work: Callable[[int, int], int],
) -> int:
    """Call ``work(start, stop)`` over every colour and add up what it returns.

    Parameters
    ----------
    pool : ThreadPoolExecutor or None    None runs everything here
    threads : int                        chunks a colour is cut into
    offsets : (c + 1,) int64             where each colour starts
    work : callable                      releases the GIL; its vertices are independent
    """
    total = 0
    for lo, hi in pairwise(offsets.tolist()):
        if pool is None or hi - lo < SMALLEST:
            total += work(lo, hi)
            continue
        cuts = [lo + (hi - lo) * t // threads for t in range(threads + 1)]
        total += sum(pool.map(work, cuts[:-1], cuts[1:]))
    return total
