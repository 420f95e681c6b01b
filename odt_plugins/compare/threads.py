"""One thread against several: sweeps, the whole run, and whether the bits are the same."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from odt_plugins.compare.numbered import along_curve, inside_free
from odt_plugins.compare.start import StartMesh, ball_of
from odt_plugins.compare.table import Part, Say, Table, Value

SWEEPS, RUNS = 15, 3
"""Repeats of which the quickest counts; one thread and several take turns."""


def threads_part(sizes: Sequence[int], threads: int, say: Say) -> Part:
    """Compare one thread with several.

    Parameters
    ----------
    sizes : ints      about so many tetrahedra, of random balls
    threads : int     of the second run; at least two are taken
    say : callable    is told what is measured
    """
    count = max(threads, 2)
    rows: list[tuple[Value, ...]] = []
    for size in sizes:
        start = ball_of(size)
        rows.append(_row(start, count))
        say(f"{rows[-1][0]} tets, {count} threads: sweeps {rows[-1][3]:.2f} times as fast, "
            f"the whole run {rows[-1][6]:.2f} times, the bits are {rows[-1][7]}")
    heads = ("tets", "sweep, 1 [s]", f"sweep, {count} [s]", "ratio", "run, 1 [s]",
             f"run, {count} [s]", "ratio", "bits")
    return Part([Table("threads", f"One thread against {count}", heads, rows)])


def _row(start: StartMesh, count: int) -> tuple[Value, ...]:
    from odt_plugins.api import optimize

    sweep, same_sweep = _race(_sweep_of(start), count, SWEEPS)
    run, same_run = _race(
        lambda threads: optimize((start.points, start.cells), threads=threads), count, RUNS
    )
    bits = "the same" if same_sweep and same_run else "DIFFERENT"
    return len(start.cells), *sweep, sweep[0] / sweep[1], *run, run[0] / run[1], bits


def _sweep_of(start: StartMesh) -> Callable[[int], Any]:
    """A Gauss-Seidel sweep from the start, on the numbering that the engine uses."""
    from odt_plugins.engine.odt.sweeps import gauss_seidel_sweep

    vertices, cells = along_curve(start.points, start.cells)
    points, topology = start.points[vertices], inside_free(cells, len(vertices))
    return lambda threads: gauss_seidel_sweep(points, topology, threads=threads)[:1]


def _race(
    work: Callable[[int], tuple[Any, ...]], count: int, repeats: int
) -> tuple[tuple[float, float], bool]:
    """Least seconds with one thread and with ``count``, and whether all arrays are equal."""
    results = work(1), work(count)
    same = all(np.array_equal(a, b) for a, b in zip(*results, strict=True))
    best = [np.inf, np.inf]
    for _ in range(repeats):
        for k, threads in enumerate((1, count)):
            clock = time.perf_counter()
            work(threads)
            best[k] = min(best[k], time.perf_counter() - clock)
    return (float(best[0]), float(best[1])), same
