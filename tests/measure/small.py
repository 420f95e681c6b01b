"""What a small mesh costs: the share of its cells and the rest, and the whole command for one."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from measure.meshes import ball_of
from measure.part import Part
from odt_plugins.compare.table import Say, Table, Value

SMALL = (500, 1500, 5000, 6200)
"""Cells, about, of small meshes, each by itself; the last has 6832."""

MANY = (500, 5000, 60)
"""Cells, about, of the first and the last of so many meshes, evenly spread: they stand for a
thousand."""

REPEATS = 5
"""The least time of so many counts."""


def small_part(sizes: Sequence[int], threads: int, say: Say) -> Part:
    """Compare small balls of tetrahedra with the largest of some sizes, and time the command.

    One row is the sum over MANY of them.

    Parameters
    ----------
    sizes : ints      about so many cells; the last is that of the large mesh
    threads : int
    say : callable    is told what is measured
    """
    low, high, count = MANY
    spread = [low + (high - low) * k // (count - 1) for k in range(count)]
    found = []
    for wanted in (*([size] for size in SMALL), spread, [sizes[-1]]):
        found.append(_balls(wanted, threads))
        meshes, cells, _, cpu = found[-1]
        say(f"{meshes} x {cells // meshes} cells: processor {1e3 * cpu:.0f} ms")
    share = found[-1][3] / found[-1][1]
    rows: list[tuple[Value, ...]] = [
        (meshes, cells, 1e3 * wall, 1e3 * cpu, 1e6 * cpu / cells, f"{cpu / cells / share:.2f}")
        for meshes, cells, wall, cpu in found
    ]
    heads = ("meshes", "cells", "wall [ms]", "processor [ms]", "a cell [us]",
             "to a cell of the last")
    about = f"{count} of {low} to {high} cells stand for 1,000"
    command: list[tuple[Value, ...]] = [("optimize, .vtu to .vtu", *_command(SMALL[-1], say))]
    return Part([
        Table("small", f"Small meshes in process, kernels loaded; {about}", heads, rows),
        Table("command", "The whole command, kernels compiled", ("command", "wall [s]",
              "processor [s]"), command),
    ])


def _balls(sizes: Sequence[int], threads: int) -> tuple[int, int, float, float]:
    """Number, cells, and seconds of wall and of processor, of balls optimised one by one."""
    from odt_plugins import optimize

    cells, walls, cpus = 0, 0.0, 0.0
    for size in sizes:
        start = ball_of(size)
        mesh = start.points, start.cells
        optimize(mesh, threads=threads)
        wall, cpu = _least(lambda mesh=mesh: optimize(mesh, threads=threads), REPEATS)  # type: ignore[misc]
        cells, walls, cpus = cells + len(start.cells), walls + wall, cpus + cpu
    return len(sizes), cells, walls, cpus


def _least(work: Callable[[], object], count: int) -> tuple[float, float]:
    """Least wall time and least processor time of some calls, with those of ended children."""
    walls, cpus = [], []
    for _ in range(count):
        clock, busy = time.perf_counter(), _busy()
        work()
        walls.append(time.perf_counter() - clock)
        cpus.append(_busy() - busy)
    return min(walls), min(cpus)


def _busy() -> float:
    times = os.times()
    return time.process_time() + times.children_user + times.children_system


def _command(size: int, say: Say) -> tuple[float, float]:
    """Wall and processor seconds of the command line on one file, start and imports included."""
    from odt_plugins.adapters.files import write_arrays

    start = ball_of(size)
    with tempfile.TemporaryDirectory() as folder:
        source, target = (Path(folder) / name for name in ("in.vtu", "out.vtu"))
        write_arrays(source, start.points, start.cells)
        line = [sys.executable, "-P", "-m", "odt_plugins", "optimize", str(source), str(target),
                "--quiet"]
        paths = os.pathsep.join(map(os.path.abspath, sys.path))
        work = {**os.environ, "PYTHONPATH": paths}
        if sys.dont_write_bytecode:
            # Python's own code is compiled at the first call, as an installation does.
            work |= {"PYTHONPYCACHEPREFIX": folder, "PYTHONDONTWRITEBYTECODE": ""}
        found = _least(lambda: subprocess.run(line, check=True, env=work), REPEATS)
    say(f"the command: {found[0]:.2f} s, processor {found[1]:.2f} s")
    return found
