"""The first results after installation: fresh processes, with and without kernels kept on disk."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from tempfile import TemporaryDirectory

from measure.part import Part
from odt_plugins.compare.table import Say, Table, Value
from odt_plugins.generate.clouds import SEED

OPTIMIZE = """
from odt_plugins import optimize
from odt_plugins.compare.start import plate, stored
start = {start}
optimize((start.points, start.cells){options})
"""

KERNEL = """
import numpy as np
from odt_plugins.engine.topology.star import vertex_stars
vertex_stars(np.array([[0, 1, 2]], dtype=np.int32), 3)
"""

INSTALLED, NONE, KEPT = "of the installation", "none", "of the runs before"
"""Kernels that there are when a process begins."""

SLIDING = ', boundary="slide", insert=True'
JOBS: tuple[tuple[str, str, str], ...] = (
    ("bunny, defaults", OPTIMIZE.format(start='stored("bunny")', options=""), INSTALLED),
    ("bunny, slide and insert",
     OPTIMIZE.format(start='stored("bunny")', options=SLIDING), INSTALLED),
    ("a plate in the plane", OPTIMIZE.format(start=f"plate(400, {SEED})", options=""), INSTALLED),
    ("the surface of a bunny",
     OPTIMIZE.format(start='stored("bunny-surface")', options=""), INSTALLED),
    ("first kernel", KERNEL, INSTALLED),
    ("bunny, defaults", OPTIMIZE.format(start='stored("bunny")', options=""), NONE),
    ("the same again", OPTIMIZE.format(start='stored("bunny")', options=""), KEPT),
    ("then slide and insert",
     OPTIMIZE.format(start='stored("bunny")', options=SLIDING), KEPT),
    ("the same again",
     OPTIMIZE.format(start='stored("bunny")', options=SLIDING), KEPT),
    ("first kernel", KERNEL, KEPT),
    ("a plate in the plane", OPTIMIZE.format(start=f"plate(400, {SEED})", options=""), NONE),
    ("the same again", OPTIMIZE.format(start=f"plate(400, {SEED})", options=""), KEPT),
    ("the surface of a bunny", OPTIMIZE.format(start='stored("bunny-surface")', options=""), NONE),
    ("the same again", OPTIMIZE.format(start='stored("bunny-surface")', options=""), KEPT),
)
"""What is run: its name, the program, and where its kernels come from."""


def cold_part(sizes: Sequence[int], threads: int, say: Say) -> Part:
    """Measure whole processes, start and imports included.

    Parameters
    ----------
    sizes, threads    stay unused: a first result is one of small meshes on one thread
    say : callable    is told what is measured
    """
    rows: list[tuple[Value, ...]] = []
    with TemporaryDirectory() as folder:
        kept = folder
        for number, (name, program, kernels) in enumerate(JOBS):
            if kernels != KEPT:
                kept = os.path.join(folder, str(number))
            # The library stays closed where something is chosen of numba, here what it does anyway.
            work = {} if kernels == INSTALLED else {"NUMBA_OPT": "3"}
            wall, busy = _seconds(program, {**work, "NUMBA_CACHE_DIR": kept})
            rows.append((name, kernels, wall, busy))
            say(f"{name}, kernels {kernels}: {wall:.2f} s, {busy:.2f} s of processors")
    heads = ("process", "kernels", "wall [s]", "processors [s]")
    return Part([Table("cold", "The first result", heads, rows)])


def _seconds(program: str, work: dict[str, str]) -> tuple[float, float]:
    """Wall and processor seconds of a process in this environment, with those that it starts."""
    before, begin = os.times(), time.perf_counter()
    subprocess.run([sys.executable, "-c", program], check=True, env=os.environ | work)
    after = os.times()
    spent = (after.children_user + after.children_system
             - before.children_user - before.children_system)
    return time.perf_counter() - begin, spent
