"""The first results after installation: fresh processes, with and without kernels kept on disk."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from tempfile import TemporaryDirectory

from odt_plugins.compare.start import SEED
from odt_plugins.compare.table import Part, Say, Table, Value

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

JOBS: tuple[tuple[str, str, bool], ...] = (
    ("bunny, defaults", OPTIMIZE.format(start='stored("bunny")', options=""), True),
    ("the same again", OPTIMIZE.format(start='stored("bunny")', options=""), False),
    ("then slide and insert",
     OPTIMIZE.format(start='stored("bunny")', options=', boundary="slide", insert=True'), False),
    ("the same again",
     OPTIMIZE.format(start='stored("bunny")', options=', boundary="slide", insert=True'), False),
    ("first kernel of a later process", KERNEL, False),
    ("a plate in the plane", OPTIMIZE.format(start=f"plate(400, {SEED})", options=""), True),
    ("the same again", OPTIMIZE.format(start=f"plate(400, {SEED})", options=""), False),
    ("the surface of a bunny", OPTIMIZE.format(start='stored("bunny-surface")', options=""), True),
    ("the same again", OPTIMIZE.format(start='stored("bunny-surface")', options=""), False),
)
"""What is run: its name, the program, and whether no kernels are kept before."""


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
        for number, (name, program, empty) in enumerate(JOBS):
            if empty:
                kept = os.path.join(folder, str(number))
            rows.append((name, "empty" if empty else "kept", *_seconds(program, kept)))
            say(f"{name}: {rows[-1][2]:.2f} s, {rows[-1][3]:.2f} s of processors")
    heads = ("process", "kernels", "wall [s]", "processors [s]")
    return Part([Table("cold", "The first result", heads, rows)])


def _seconds(program: str, kept: str) -> tuple[float, float]:
    """Wall and processor seconds of a process, with those that it starts, and its kernels there."""
    before, begin = os.times(), time.perf_counter()
    subprocess.run([sys.executable, "-c", program], check=True,
                   env=os.environ | {"NUMBA_CACHE_DIR": kept})
    after = os.times()
    spent = (after.children_user + after.children_system
             - before.children_user - before.children_system)
    return time.perf_counter() - begin, spent
