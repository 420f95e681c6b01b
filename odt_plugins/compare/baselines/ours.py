"""odt_plugins itself, called as every user calls it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from odt_plugins.compare.baselines.task import Settings, Task, mean_edge
from odt_plugins.compare.start import StartMesh


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Take the arrays as they are.

    Settings: `options` of :func:`odt_plugins.optimize`; with a `size` of
    :func:`odt_plugins.remesh`, within the `envelope`.
    """
    from odt_plugins.api import optimize
    from odt_plugins.remeshing import remesh

    options = {**settings["options"], "threads": settings["threads"]}

    mesh = (start.points, start.cells, *(() if start.regions is None else (start.regions,)))

    def call() -> Any:
        if "size" in settings:
            return remesh(mesh, settings["size"], envelope=settings["envelope"], **options)
        return optimize(mesh, **options)

    return Task(call, tuple)


def warm_up(start: StartMesh, settings: Settings) -> None:
    """Compile the kernels, or load them from disk, on a mesh of a few cells.

    It has inverted cells where the start has some.
    """
    from odt_plugins.compare.start import ball, pebble, plate
    from odt_plugins.compare.tangled import tangles
    from odt_plugins.engine.untangle.places import bad_cells

    small = {"tets": ball, "planar": plate, "surface": pebble}[start.kind](60)
    if start.kind != "surface" and bad_cells(start.points, start.cells).any():
        small = replace(small, points=next(tangles(small))[1])
    if "size" in settings:
        settings = {**settings, "size": mean_edge(small)}
    prepare(small, settings).call()
