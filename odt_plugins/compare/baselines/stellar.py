"""Stellar of Klingner and Shewchuk, the program of that name, the surface left alone."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.compare.baselines.task import Settings, Task, flipped
from odt_plugins.compare.start import StartMesh

PROGRAM = "Stellar"
MESH, CONFIG = "start", "config"
"""Names of files; Stellar cuts names and paths at the first dot, so they are relative."""

FIXED = ("facetsmooth", "segmentsmooth", "insertfacet", "insertsegment", "flip22", "usequadrics")
"""What would change the surface."""


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Write the start for Stellar, with its cells turned: it stops at positive ones.

    Settings: `measure`, the number of its quality measure; 0 is the smallest sine.
    """
    options = {"verbosity": 0, "qualmeasure": settings["measure"], **dict.fromkeys(FIXED, 0)}
    Path(CONFIG).write_text(
        "".join(f"{name} {value}\n" for name, value in options.items()), encoding="ascii")
    write_rows(f"{MESH}.node", (3, 0, 0), start.points, "%.17g")
    write_rows(f"{MESH}.ele", (4, 0), flipped(start.cells) + 1, "%d")

    def call() -> None:
        done = subprocess.run([PROGRAM, "-s", CONFIG, MESH], stdin=subprocess.DEVNULL,
                              stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
        if done.returncode or not Path(f"{MESH}.1.ele").is_file():
            said = done.stdout.decode(errors="replace").strip().split("\n")[-1]
            msg = f"{PROGRAM} ended with {done.returncode} and wrote no mesh: {said}"
            raise RuntimeError(msg)

    def collect(_: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        points, cells = read_rows(f"{MESH}.1.node"), read_rows(f"{MESH}.1.ele").astype(np.int32)
        return points[:, 1:4], flipped(cells[:, 1:5] - np.int32(points[0, 0]))

    return Task(call, collect)


def write_rows(name: str, columns: tuple[int, ...], rows: NDArray[Any], number: str) -> None:
    """Write a file of Triangle's and TetGen's kind: numbered rows behind one that counts them."""
    numbers = np.arange(1, len(rows) + 1)
    np.savetxt(name, np.column_stack([numbers, rows]), fmt=["%d"] + [number] * rows.shape[1],
               header=" ".join(map(str, (len(rows), *columns))), comments="")


def read_rows(name: str) -> NDArray[Any]:
    """Rows of a file of Triangle's and TetGen's kind, without the first, which counts them."""
    return np.loadtxt(name, skiprows=1, ndmin=2)
