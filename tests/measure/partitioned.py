"""odt_plugins in blocks, with the memory and the processor time of its worker processes."""

from __future__ import annotations

import resource
import time
from typing import Any

from odt_plugins.compare.baselines import ours
from odt_plugins.compare.baselines.task import Settings, Task
from odt_plugins.compare.start import StartMesh

UNIT = 1024
"""Bytes in which Linux counts the memory of children that ended."""


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Take the arrays as they are. Settings: `blocks` and `workers`; blocks 0 is one piece."""
    from odt_plugins import optimize_with_report

    mesh, blocks = (start.points, start.cells), settings["blocks"]
    threads = settings["threads"]

    def call() -> Any:
        report: Any
        clock, busy = time.perf_counter(), time.process_time()
        how = {"blocks": blocks, "workers": settings["workers"]} if blocks else {}
        result, report = optimize_with_report(mesh, threads=threads, **how)
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        facts = {name: float(value) for name, value in report.counts.items()
                 if name.startswith("round ")}
        facts |= {"seconds": time.perf_counter() - clock, "cpu": time.process_time() - busy,
                  "workers cpu": children.ru_utime + children.ru_stime,
                  "workers peak": float(children.ru_maxrss * UNIT)}
        return result, facts

    return Task(call, lambda result: result[0], lambda result: result[1])


def warm_up(start: StartMesh, settings: Settings) -> None:
    """Compile the kernels, or load them from disk, on a mesh of a few cells."""
    ours.warm_up(start, {**settings, "options": {}})
