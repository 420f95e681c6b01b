"""odt_plugins itself, called as every user calls it."""

from __future__ import annotations

from typing import Any

from odt_plugins.compare.baselines.task import Settings, Task
from odt_plugins.compare.start import StartMesh


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Take the arrays as they are. Settings: `options` of :func:`odt_plugins.optimize`."""
    from odt_plugins.api import optimize

    options = {**settings["options"], "threads": settings["threads"]}

    mesh = (start.points, start.cells, *(() if start.regions is None else (start.regions,)))

    def call() -> Any:
        return optimize(mesh, **options)

    return Task(call, tuple)


def warm_up(start: StartMesh, settings: Settings) -> None:
    """Compile the kernels, or load them from numba's cache, on a mesh of a few cells."""
    from odt_plugins.compare.start import ball, pebble, plate

    small = {"tets": ball, "planar": plate, "surface": pebble}[start.kind](60)
    prepare(small, settings).call()
