"""TetGen on tetrahedra from elsewhere: it refines and optimises them."""

from __future__ import annotations

import subprocess
from typing import Any

from numpy.typing import NDArray

from odt_plugins.compare.baselines.stellar import read_rows, write_rows
from odt_plugins.compare.baselines.task import Settings, Task, wanted_size
from odt_plugins.compare.start import StartMesh

PROGRAM = "tetgen"

REGULAR = 1.0 / (6.0 * 2.0**0.5)
"""Volume of a regular tetrahedron of edge 1."""


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Write the start for TetGen.

    Settings: `flags`; where there is a `size`, no tetrahedron may be larger than a regular one of
    that edge.
    """
    flags = f"-{settings['flags']}"
    if "size" in settings:
        flags += f"a{REGULAR * wanted_size(start, settings) ** 3:.17g}"
    write_rows("start.node", (3, 0, 0), start.points, "%.17g")
    write_rows("start.ele", (4, 0), start.cells + 1, "%d")

    def call() -> None:
        subprocess.run([PROGRAM, flags, "start"], stdin=subprocess.DEVNULL,
                       stdout=subprocess.DEVNULL, check=True)

    def collect(_: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        points, cells = read_rows("start.1.node"), read_rows("start.1.ele").astype(int)
        return points[:, 1:4], cells[:, 1:5] - int(points[0, 0])

    return Task(call, collect)
