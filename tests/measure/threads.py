"""One thread against several: sweeps, the whole run and its stages, and whether bits are the same.

The serial share s is that of Amdahl's law: n threads take s + (1 - s) / n of the time of one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from measure.meshes import along_curve, ball_of, inside_free
from measure.part import Part
from odt_plugins.compare.start import StartMesh
from odt_plugins.compare.table import Say, Table, Value
from odt_plugins.mesh.chunks import Pool

SWEEPS, RUNS = 15, 3
"""Repeats of which the quickest counts, one thread and several in turns; runs as many as come to
``RUNNING`` cells, where these are more."""

RUNNING = 3_000_000

MANY = 16
"""Threads of which the time is foretold."""


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
    stages: list[tuple[Value, ...]] = []
    for size in sizes:
        start = ball_of(size)
        row, ran = _row(start, count)
        rows.append(row)
        stages += ran
        say(f"{row[0]} tets, {count} threads: sweeps {row[3]:.2f} times as fast, "
            f"the whole run {row[6]:.2f} times, the bits are {row[-1]}")
    heads = ("tets", "sweep, 1 [s]", f"sweep, {count} [s]", "ratio", "run, 1 [s]",
             f"run, {count} [s]", "ratio", "serial share", "by processor time",
             f"{MANY} threads would take [s]", "ratio", "bits")
    parts = ("tets", "stage", "1 [s]", f"{count} [s]", "ratio", "serial share")
    return Part([Table("threads", f"One thread against {count}", heads, rows),
                 Table("threads-stages", f"One thread against {count}, by stage", parts, stages)])


def serial_share(one: float, several: float, count: int) -> float:
    """The share s at which Amdahl's law gives the seconds of one and of ``count`` threads."""
    return (count * several / one - 1.0) / (count - 1.0)


def forecast(one: float, share: float, count: int) -> float:
    """Seconds of so many threads by Amdahl's law; a share below 0 counts as 0."""
    share = max(share, 0.0)
    return one * (share + (1.0 - share) / count)


def _row(start: StartMesh, count: int) -> tuple[tuple[Value, ...], list[tuple[Value, ...]]]:
    """One mesh: its row of the first table, and those of the table of stages."""
    from odt_plugins.api import optimize, optimize_with_report
    from odt_plugins.engine.compiled.threads import thread_pool

    mesh = start.points, start.cells
    with thread_pool(count) as pool:
        sweep, same_sweep = _race(_sweep_of(start, pool), count, SWEEPS)
    runs = min(max(RUNNING // len(start.cells), RUNS), SWEEPS)
    run, same_run = _race(lambda threads: optimize(mesh, threads=threads), count, runs)
    share = serial_share(*run, count)
    by_processor = _share_alone(lambda: optimize(mesh, threads=count), count)
    many = forecast(run[0], share, MANY)
    bits = "the same" if same_sweep and same_run else "DIFFERENT"
    m = len(start.cells)
    one, several = (optimize_with_report(mesh, threads=threads)[1].times
                    for threads in (1, count))
    stages: list[tuple[Value, ...]] = [
        (m, name, one[name], several[name], one[name] / several[name],
         serial_share(one[name], several[name], count))
        for name in one if min(one[name], several[name]) > 0.0
    ]
    return (m, *sweep, sweep[0] / sweep[1], *run, run[0] / run[1], share, by_processor, many,
            run[0] / many, bits), stages


def _share_alone(work: Callable[[], Any], count: int) -> float:
    """Share of the processor time in which the caller works alone.

    The other threads do all of theirs in what is shared, and the caller does as much there as each.
    """
    caller, process = time.thread_time(), time.process_time()
    work()
    whole = time.process_time() - process
    others = whole - (time.thread_time() - caller)
    return 1.0 - others * count / (count - 1) / whole


def _sweep_of(start: StartMesh, pool: Pool | None) -> Callable[[int], Any]:
    """A Gauss-Seidel sweep from the start as a run does it: its numbering, a pool made before."""
    from odt_plugins.engine.odt.sweeps import gauss_seidel_sweep

    vertices, cells = along_curve(start.points, start.cells)
    points, topology = start.points[vertices], inside_free(cells, len(vertices))
    shared = replace(topology, pool=pool)
    return lambda threads: gauss_seidel_sweep(
        points, topology if threads == 1 else shared, threads=threads)[:1]


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
