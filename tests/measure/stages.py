"""Seconds and memory of every stage over the number of cells."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from measure.meshes import ball_of, pebble_of
from measure.part import Part, power_laws
from odt_plugins.compare.contestants import Contestant
from odt_plugins.compare.runner import Limits, run_contestant
from odt_plugins.compare.start import StartMesh
from odt_plugins.compare.table import Say, Table, Value

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
    """Measure the stages on random balls of tetrahedra, and put them into tables and charts."""
    return _part("stages", "Stages", "cells", measure_stages(sizes, threads, say, ball_of))


def surface_part(sizes: Sequence[int], threads: int, say: Say) -> Part:
    """The same for curved surfaces of triangles."""
    return _part("surface", "Stages on a curved surface", "triangles",
                 measure_stages(sizes, threads, say, pebble_of))


def _part(key: str, title: str, unit: str, measured: tuple[list[Stage], Stage]) -> Part:
    stages, memory = measured
    sizes = sorted({m for s in stages for m in s.cells})
    rows: list[tuple[Value, ...]] = []
    for s in [*stages, memory]:
        at = dict(zip(s.cells, s.seconds, strict=True))
        exponent = "" if s.exponent is None else f"{s.exponent:.2f}"
        form = "[MB]" if s is memory else "[s]"
        rows.append((f"{s.name} {form}", exponent, *(at.get(m, "") for m in sizes)))
    heads = ("stage", "exponent", *(f"{m} {unit}" for m in sizes))
    charts = [power_laws(f"{title}: seconds", [(s.name, s.cells, s.seconds) for s in stages],
                         unit, "seconds"),
              power_laws(f"{title}: memory of the process, MB",
                         [("peak", memory.cells, memory.seconds)], unit, "MB")]
    values = {"stages": [asdict(s) for s in stages], "memory": asdict(memory)}
    return Part([Table(key, title, heads, rows)], charts,
                values if key == "stages" else {key: values})


def measure_stages(
    sizes: Sequence[int], threads: int, say: Say, make: Callable[[int], StartMesh]
) -> tuple[list[Stage], Stage]:
    """Optimise meshes of growing size, each in a process of its own.

    Parameters
    ----------
    sizes : ints
    threads : int
    say : callable             is told what is measured
    make : callable            gives a mesh of about so many cells

    Returns
    -------
    stages : list of Stage     every stage of the engine, the whole call, and making the start
    memory : Stage             its `seconds` are megabytes of the process at its peak
    """
    found: dict[str, list[tuple[int, float]]] = {}
    memory = []
    whole = Contestant("stages", "odt-plugins", ("tets", "surface"), "measure.timed",
                       {"options": {}},
                       package="odt-plugins")
    for size in sizes:
        clock = time.perf_counter()
        start = make(size)
        m = len(start.cells)
        found.setdefault("the start, by scipy", []).append((m, time.perf_counter() - clock))
        run = run_contestant(start, whole, Limits(LIMIT, 1, LIMIT, threads))
        if run.status != "ok":
            say(f"{m} cells: {run.status}, {run.message}")
            continue
        found.setdefault("whole call", []).append((m, run.facts["seconds"][0]))
        found.setdefault("whole call, processor time", []).append((m, run.facts["cpu"][0]))
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
