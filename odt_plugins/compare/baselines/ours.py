"""odt_plugins itself, called as every user calls it."""

from __future__ import annotations

from typing import Any

from odt_plugins.compare.baselines.task import NotPossibleError, Settings, Task
from odt_plugins.compare.start import StartMesh
from odt_plugins.errors import UnsupportedMeshError


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Take the arrays as they are. Settings: `options` of :func:`odt_plugins.optimize`.

    Raises
    ------
    NotPossibleError    a curved surface, for as long as those are not supported
    """
    from odt_plugins.api import optimize

    options = {**settings["options"], "threads": settings["threads"]}
    mesh = (start.points, start.cells)
    if start.kind == "surface":
        try:
            optimize(mesh, rounds=0, cycles=0)
        except UnsupportedMeshError as exc:
            raise NotPossibleError(str(exc).split(":")[0]) from exc

    def call() -> Any:
        return optimize(mesh, **options)

    return Task(call, lambda result: (result[0], result[1]))


def warm_up(start: StartMesh, settings: Settings) -> None:
    """Compile the kernels, or load them from numba's cache, on a mesh of a few cells."""
    from odt_plugins.compare.start import ball, plate

    if start.kind == "surface":
        return
    small = ball(60) if start.kind == "tets" else plate(60)
    prepare(small, settings).call()
