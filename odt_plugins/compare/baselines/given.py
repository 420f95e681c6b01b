"""A function of the caller's: points, cells and labels in, points and cells out."""

from __future__ import annotations

from importlib import import_module

from odt_plugins.compare.baselines.task import Settings, Task
from odt_plugins.compare.start import StartMesh


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
    return Task(lambda: function(*given), tuple)
