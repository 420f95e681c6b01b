"""A function of the caller's: points, cells and labels in, points and cells out."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from odt_plugins.compare.baselines.task import Settings, Task
from odt_plugins.compare.start import StartMesh
from odt_plugins.errors import UnsupportedMeshError


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Hand over copies of the arrays.

    Parameters
    ----------
    start : StartMesh
    settings : dict      `function`: "module:name" of a callable that takes points (n, d) float64,
                         cells (m, k) int32 and labels (m,) int32, None where there is one region,
                         and returns (points, cells), or (points, cells, labels) where it respects
                         them
    """
    place, _, name = str(settings["function"]).partition(":")
    function = getattr(import_module(place), name)
    regions = None if start.regions is None else start.regions.copy()
    given = start.points.copy(), start.cells.copy(), regions
    return Task(lambda: function(*given), _collected)


def _collected(returned: Any) -> tuple[Any, ...]:
    """Take what the callable returned, two or three arrays or lists."""
    if not isinstance(returned, tuple | list) or len(returned) not in (2, 3):
        count = f" of {len(returned)}" if isinstance(returned, tuple | list) else ""
        msg = (f"the function returned a {type(returned).__name__}{count}; expected (points, "
               "cells), or (points, cells, labels) where it keeps labels")
        raise UnsupportedMeshError(msg)
    return tuple(returned)
