"""TetWild once more, on the surface of the start mesh."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.compare.baselines.task import Settings, Task, wanted_size
from odt_plugins.compare.hull import hull_facets
from odt_plugins.compare.start import StartMesh


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Give the surface to TetWild, with the `size` or the mean edge length of the start as target.

    Settings: `stop_energy`, `size`, `envelope`. TetWild remeshes the surface within its envelope
    and does not repeat itself; it writes a file into the working directory, which the worker makes
    a temporary one.
    """
    from pytetwild.pytetwild import tetrahedralize

    facets = hull_facets(start)
    used, local = np.unique(facets, return_inverse=True)
    length = wanted_size(start, settings)
    surface = start.points[used], local.reshape(facets.shape).astype(np.int32)

    def call() -> Any:
        return tetrahedralize(
            *surface, edge_length_abs=length, stop_energy=settings["stop_energy"],
            epsilon=settings.get("envelope", 1e-3), num_threads=settings["threads"],
            vtk_ordering=True,
        )

    def collect(result: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        return np.asarray(result[0]), np.asarray(result[1])

    return Task(call, collect)
