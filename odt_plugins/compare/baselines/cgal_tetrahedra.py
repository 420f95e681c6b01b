"""CGAL's tetrahedral remeshing, by a program `cgal_remeshing IN OUT LENGTH PASSES 1` around it."""

from __future__ import annotations

import subprocess
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.compare.baselines.task import Settings, Task, wanted_size
from odt_plugins.compare.hull import hull_facets, labels_of
from odt_plugins.compare.start import StartMesh

PROGRAM = "cgal_remeshing"
START, RESULT = "start.mesh", "result.mesh"


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Write the start as a MEDIT file. Settings: `iterations`, `size`."""
    parts = {"Vertices": np.column_stack([start.points, np.zeros(len(start.points))]),
             "Tetrahedra": np.column_stack([start.cells + 1, labels_of(start) + 1]),
             "Triangles": np.pad(hull_facets(start) + 1, ((0, 0), (0, 1)), constant_values=1)}
    with open(START, "w", encoding="ascii") as file:
        file.write("MeshVersionFormatted 2\nDimension 3\n")
        for name, rows in parts.items():
            file.write(f"{name}\n{len(rows)}\n")
            np.savetxt(file, rows, fmt="%d" if rows.dtype.kind == "i" else "%.17g")
        file.write("End\n")
    words = [PROGRAM, START, RESULT, repr(wanted_size(start, settings)),
             str(settings["iterations"]), "1"]

    def call() -> None:
        subprocess.run(words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, check=True)

    def collect(_: Any) -> tuple[NDArray[Any], ...]:
        from odt_plugins.adapters.files import read

        host = read(RESULT)
        return np.asarray(host.points), np.asarray(host.cells)

    return Task(call, collect)
