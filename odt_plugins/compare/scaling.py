"""How time and memory grow with the number of cells, and local against global methods."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from odt_plugins.compare.charts import power_laws
from odt_plugins.compare.contestants import Contestant
from odt_plugins.compare.machine import describe
from odt_plugins.compare.output import fill_template
from odt_plugins.compare.runner import Limits, run_contestant
from odt_plugins.compare.start import SEED, ball, refine
from odt_plugins.errors import MeshFileError
from odt_plugins.mesh import FloatArray, IntArray

FILES = ("scaling.json", "scaling.html")

CELLS_PER_VERTEX = 6.2
"""Of a Delaunay mesh of random points in a ball, boundary included; to ask for so many cells."""

LIMIT = 3600.0
"""Seconds for one run."""

ENOUGH = 1e-3
"""Part of the starting gap to the least energy at which a method has arrived."""

PATIENCE, MOST_STEPS = 20.0, 3000
"""Seconds and steps after which a method that has not arrived is given up."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class Stage:
    """One stage over the sizes: seconds ~ constant * cells^exponent, fitted by least squares."""

    name: str
    cells: list[int]
    seconds: list[float]
    exponent: float | None


@dataclass(frozen=True)
class Race:
    """One method on one refined mesh (Figs 7 and 8).

    Attributes
    ----------
    method : str
    points : int
    gaps : list of float         energy above that of the regular mesh, by step, start first
    qualities : list of float    least radius ratio by step
    seconds : float              until it arrived or was given up
    arrived : bool               the gap fell below ENOUGH of its start
    """

    method: str
    points: int
    gaps: list[float]
    qualities: list[float]
    seconds: float
    arrived: bool


def run_scaling(
    out: Path, largest: int, threads: int, say: Say, *, levels: Sequence[int] = (3, 4, 5, 6)
) -> str:
    """Measure, write FILES into `out`, and give a summary in words.

    Parameters
    ----------
    out : Path           is made
    largest : int        cells of the largest mesh; the others are 1e4, 3e4, 1e5, ... below it
    threads : int
    say : callable       is told, line by line, what is measured
    levels : ints        refinements of the mesh on which local and global methods are compared

    Raises
    ------
    MeshFileError        `out` cannot be written to
    """
    sizes = [round(10 ** (p / 2)) for p in range(8, 19) if 10 ** (p / 2) < 0.9 * largest]
    stages, memory = measure_stages([*sizes, largest], threads, say)
    races = [race for level in levels for race in run_races(level, say)]
    facts = describe(threads, SEED)
    values = {"machine": facts, "stages": [asdict(s) for s in stages], "memory": asdict(memory),
              "races": [asdict(r) for r in races]}
    try:
        out.mkdir(parents=True, exist_ok=True)
        (out / FILES[0]).write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
        (out / FILES[1]).write_text(_page(stages, memory, races, facts), encoding="utf-8")
    except OSError as exc:
        if isinstance(exc, MeshFileError):
            raise
        msg = f"cannot write into {out}: {exc.strerror or exc}; try another --out"
        raise MeshFileError(msg) from exc
    return summary(stages, memory, races)


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


def moved_triangle(level: int, seed: int = SEED) -> tuple[FloatArray, FloatArray, IntArray]:
    """Equilateral triangle cut into 16, its three inner vertices moved, refined (Section 5.2).

    Returns
    -------
    points (n, 2), the regular points (n, 2), cells (m, 3)
    """
    grid = [(i, j) for j in range(5) for i in range(5 - j)]
    number = {ij: k for k, ij in enumerate(grid)}
    points = np.array([((i + 0.5 * j) / 4.0, j * math.sqrt(0.75) / 4.0) for i, j in grid])
    rows = [(number[i, j], number[i + 1, j], number[i, j + 1])
            for i, j in grid if i + j < 4]
    rows += [(number[i + 1, j], number[i + 1, j + 1], number[i, j + 1])
             for i, j in grid if i + j < 3]
    cells: IntArray = np.array(rows, dtype=np.int32)
    inner = [k for k, (i, j) in enumerate(grid) if i and j and i + j < 4]
    moved = points.copy()
    moved[inner] += np.random.default_rng(seed).uniform(-0.09, 0.09, (len(inner), 2))
    fine = cells
    for _ in range(level):
        moved, fine = refine(moved, cells)
        points, _ = refine(points, cells)
        cells = fine
    return moved, points, cells


def run_races(level: int, say: Say) -> list[Race]:
    """Let Jacobi, Gauss-Seidel and the global step, direct and AMG, start from one mesh."""
    from odt_plugins.engine.graph_laplacian import global_step
    from odt_plugins.engine.sweeps import gauss_seidel_sweep, jacobi_sweep

    methods: list[tuple[str, Callable[[FloatArray, Any], FloatArray]]] = [
        ("Jacobi", lambda x, top: jacobi_sweep(x, top, omega=0.8)[0]),
        ("Gauss-Seidel", lambda x, top: gauss_seidel_sweep(x, top)[0]),
        ("global, direct", lambda x, top: global_step(x, top, linear_solver="direct")[0]),
        ("global, AMG", lambda x, top: global_step(x, top, linear_solver="amg")[0]),
    ]
    races = []
    for name, step in methods:
        races.append(_race(name, step, level))
        race = races[-1]
        end = "arrived" if race.arrived else "given up"
        say(f"{race.points} points, {name}: {end} after {len(race.gaps) - 1} steps, "
            f"{race.seconds:.2f} s")
    return races


def _race(name: str, step: Callable[[FloatArray, Any], FloatArray], level: int) -> Race:
    from odt_plugins.engine.energy import energy
    from odt_plugins.engine.geometry import boundary_vertices
    from odt_plugins.engine.topology import make_topology
    from odt_plugins.quality import radius_ratio

    x, regular, cells = moved_triangle(level)
    rim = boundary_vertices(cells, len(x))
    topology = make_topology(cells, ~rim, rim)
    least = energy(regular, cells)
    step(x, topology)
    gaps = [energy(x, cells) - least]
    qualities = [float(radius_ratio(x, cells).min())]
    seconds = 0.0
    while gaps[-1] > ENOUGH * gaps[0] and seconds < PATIENCE and len(gaps) <= MOST_STEPS:
        clock = time.perf_counter()
        x = step(x, topology)
        seconds += time.perf_counter() - clock
        gaps.append(energy(x, cells) - least)
        qualities.append(float(radius_ratio(x, cells).min()))
    return Race(name, len(x), gaps, qualities, seconds, gaps[-1] <= ENOUGH * gaps[0])


def summary(stages: Sequence[Stage], memory: Stage, races: Sequence[Race]) -> str:
    """Give exponents and the end of every race as lines of text."""
    lines = ["", "stage                        exponent   seconds at the largest size"]
    for stage in [*stages, memory]:
        exponent = "" if stage.exponent is None else f"{stage.exponent:.2f}"
        last = f"{stage.seconds[-1]:.2f}" if stage.seconds else ""
        unit = " MB" if stage is memory else ""
        lines.append(f"{stage.name:<28} {exponent:>8}   {last}{unit}")
    lines += ["", f"steps until the energy gap is {ENOUGH:g} of its start"]
    for race in races:
        steps = f"{len(race.gaps) - 1}" if race.arrived else f"more than {len(race.gaps) - 1}"
        lines.append(f"{race.points:>8} points  {race.method:<16} {steps:>14} steps  "
                     f"{race.seconds:.3f} s, least q {race.qualities[-1]:.4f}")
    return "\n".join(lines)


def _page(
    stages: Sequence[Stage], memory: Stage, races: Sequence[Race], facts: dict[str, str | int]
) -> str:
    charts = [power_laws("Seconds of every stage", [(s.name, s.cells, s.seconds) for s in stages],
                         "cells", "seconds"),
              power_laws("Memory of the process, MB", [("peak", memory.cells, memory.seconds)],
                         "cells", "MB")]
    smallest = min((r.points for r in races), default=0)
    first = [r for r in races if r.points == smallest]
    for title, values, log in (("Energy above the least (Fig 8)", "gaps", True),
                               ("Least radius ratio (Fig 7)", "qualities", False)):
        series = [(r.method, list(range(len(getattr(r, values)))), getattr(r, values))
                  for r in first]
        charts.append(power_laws(f"{title}, {smallest} points", series, "steps", values,
                                 log_x=False, log_y=log))
    methods = dict.fromkeys(r.method for r in races)
    for title, figure in (("Seconds until arrived", lambda r: r.seconds),
                          ("Steps until arrived", lambda r: len(r.gaps) - 1)):
        lines = [(m, [r.points for r in races if r.method == m and r.arrived],
                  [figure(r) for r in races if r.method == m and r.arrived]) for m in methods]
        charts.append(power_laws(title, lines, "points", title.split()[0].lower()))
    return fill_template("scaling.html", facts=facts, charts=charts,
                         stages=[*stages, memory], races=races, enough=ENOUGH)
