"""Seconds and memory of every stage over the number of cells."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from odt_plugins.compare.charts import power_laws
from odt_plugins.compare.contestants import Contestant
from odt_plugins.compare.runner import Limits, run_contestant
from odt_plugins.compare.start import ball
from odt_plugins.compare.table import Part, Say, Table, Value

CELLS_PER_VERTEX = 6.2
"""Of a Delaunay mesh of random points in a ball, boundary included; to ask for so many cells."""

LIMIT = 3600.0
"""Seconds for one run."""


@dataclass(frozen=True)
class Stage:
    """One stage over the sizes: seconds ~ constant * cells^exponent, fitted by least squares."""

    name: str
    cells: list[int]
    seconds: list[float]
    exponent: float | None


def stages_part(sizes: Sequence[int], threads: int, say: Say) -> Part:
    """Measure the stages and put them into tables and charts."""
    stages, memory = measure_stages(sizes, threads, say)
    sizes = sorted({m for s in stages for m in s.cells})
    rows: list[tuple[Value, ...]] = []
    for s in [*stages, memory]:
        at = dict(zip(s.cells, s.seconds, strict=True))
        exponent = "" if s.exponent is None else f"{s.exponent:.2f}"
        unit = "[MB]" if s is memory else "[s]"
        rows.append((f"{s.name} {unit}", exponent, *(at.get(m, "") for m in sizes)))
    heads = ("stage", "exponent", *(f"{m} cells" for m in sizes))
    charts = [power_laws("Seconds of every stage", [(s.name, s.cells, s.seconds) for s in stages],
                         "cells", "seconds"),
              power_laws("Memory of the process, MB", [("peak", memory.cells, memory.seconds)],
                         "cells", "MB")]
    return Part([Table("stages", "Stages", heads, rows)], charts,
                {"stages": [asdict(s) for s in stages], "memory": asdict(memory)})


def measure_stages(sizes: Sequence[int], threads: int, say: Say) -> tuple[list[Stage], Stage]:
    """Optimise random balls of growing size, each in a process of its own.

    Returns
    -------
    stages : list of Stage     every stage of the engine, the whole call, and scipy's Delaunay
    memory : Stage             its `seconds` are megabytes of the process at its peak
    """
    found: dict[str, list[tuple[int, float]]] = {}
    memory = []
    whole = Contestant("stages", "odt-plugins", ("tets",), "stages", {"options": {}},
                       "odt-plugins")
    for size in sizes:
        clock = time.perf_counter()
        start = ball(max(round(size / CELLS_PER_VERTEX), 50))
        m = len(start.cells)
        found.setdefault("the start, by scipy", []).append((m, time.perf_counter() - clock))
        run = run_contestant(start, whole, Limits(LIMIT, 1, LIMIT, threads))
        if run.status != "ok":
            say(f"{m} cells: {run.status}, {run.message}")
            continue
        found.setdefault("whole call", []).append((m, run.facts["seconds"][0]))
        for name, seconds in run.facts["details"].items():
            found.setdefault(name, []).append((m, seconds))
        memory.append((m, run.facts["peak"] / 1e6))
        say(f"{m} cells: {run.facts['seconds'][0]:.1f} s, {memory[-1][1]:.0f} MB")
    stages = [fit(name, pairs) for name, pairs in found.items()]
    return stages, fit("memory", memory)


def fit(name: str, pairs: Sequence[tuple[int, float]]) -> Stage:
    """Fit the exponent over the sizes; None with fewer than two positive times."""
    good = [(m, t) for m, t in pairs if t > 0]
    exponent = None
    if len({m for m, _ in good}) > 1:
        x, y = np.log([m for m, _ in good]), np.log([t for _, t in good])
        exponent = float(np.polyfit(x, y, 1)[0])
    return Stage(name, [m for m, _ in pairs], [t for _, t in pairs], exponent)
