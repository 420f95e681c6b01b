"""Processor time of this source tree and of another, in turns, and whether bits are the same."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from measure.meshes import ball_of, pebble_of
from odt_plugins.compare.start import StartMesh, plate
from odt_plugins.compare.table import Say, Table, Value

HERE = Path(__file__).resolve().parents[2]

TURNS = 9
"""Runs of each tree, of which the least time counts."""

MESHES = ((ball_of, 2_000), (ball_of, 15_000), (ball_of, 50_000), (plate, 30_000),
          (pebble_of, 10_000))
"""Makers of start meshes, and how large these are to be."""

WORKER = """
import hashlib, json, sys, time
import numpy as np
from odt_plugins.api import optimize
from odt_plugins.engine.compiled.kernel import Kernel

calls, run = [], Kernel.__call__

def timed(self, *args):
    clock = time.thread_time()
    out = run(self, *args)
    calls.append(time.thread_time() - clock)
    return out

for line in sys.stdin:
    path, threads = json.loads(line)
    Kernel.__call__ = timed if threads == 1 else run
    calls.clear()
    with np.load(path) as start:
        mesh = start["points"], start["cells"]
    clock = time.process_time()
    points, cells = optimize(mesh, threads=threads)
    clock = time.process_time() - clock
    bits = hashlib.sha256(points.tobytes() + cells.tobytes()).hexdigest()
    print(json.dumps([clock, bits, calls]), flush=True)
"""
"""Runs what it is told; gives seconds, a hash of the result, and with one thread the seconds of
every call of a kernel."""


def against_table(other: Path, say: Say, turns: int = TURNS,
                  meshes: Sequence[tuple[Any, int]] = MESHES) -> Table:
    """Compare two source trees, both with their kernels compiled.

    Other programs disturb a call of a kernel less than a run: the least times of every call are
    added besides.

    Parameters
    ----------
    other : path      the root of a source tree
    say : callable    is told what is measured
    turns : int
    meshes : of (maker, size)
    """
    rows: list[tuple[Value, ...]] = []
    with TemporaryDirectory() as folder:
        file = Path(folder, "start.npz")
        trees = [_worker(tree) for tree in (other.resolve(), HERE)]
        for make, size in meshes:
            start: StartMesh = make(size)
            np.savez(file, points=start.points, cells=start.cells)
            for threads in (1, 2):
                rows.append((make.__name__.removesuffix("_of"), len(start.cells), threads,
                             *_compared(trees, [str(file), threads], turns)))
                say(" ".join(map(str, rows[-1])))
        for tree in trees:
            tree.communicate()
    heads = ("start", "cells", "threads", "other [s]", "this [s]", "ratio", "kernels, other [s]",
             "kernels, this [s]", "ratio", "bits")
    return Table("against", "Least processor time of two source trees in turns", heads, rows)


def _worker(tree: Path) -> subprocess.Popen[str]:
    work = {**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.Popen([sys.executable, "-c", WORKER], cwd=tree, env=work, text=True,
                            stdin=subprocess.PIPE, stdout=subprocess.PIPE)


def _compared(trees: Sequence[subprocess.Popen[str]], job: list[Any], turns: int
              ) -> tuple[Value, ...]:
    """Seconds of both and their ratio, for runs and for kernels, and whether bits are the same."""
    runs = [[_asked(tree, job) for tree in trees] for _ in range(turns + 1)][1:]
    one, two = (min(run[k][0] for run in runs) for k in (0, 1))
    first, second = (sum(map(min, zip(*(run[k][2] for run in runs), strict=True))) for k in (0, 1))
    same = len({each[1] for run in runs for each in run}) == 1
    kernels = (first, second, f"{second / first:.3f}") if first else ("", "", "")
    return (one, two, f"{two / one:.3f}", *kernels, "the same" if same else "DIFFERENT")


def _asked(tree: subprocess.Popen[str], job: list[Any]) -> Any:
    """What a worker answers; an end instead of an answer is an error."""
    if tree.stdin is None or tree.stdout is None:
        raise ValueError(tree)
    print(json.dumps(job), file=tree.stdin, flush=True)
    return json.loads(tree.stdout.readline())
