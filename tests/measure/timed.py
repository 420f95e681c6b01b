"""odt_plugins with the seconds of every stage, for the scaling measurement."""

from __future__ import annotations

from typing import Any

from odt_plugins.compare.baselines.ours import warm_up
from odt_plugins.compare.baselines.task import Settings, Task
from odt_plugins.compare.start import StartMesh

__all__ = ["prepare", "warm_up"]


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Take the arrays as they are. Settings: `options` of :func:`odt_plugins.optimize`."""
    from odt_plugins.api import optimize_with_report

    options = {**settings["options"], "threads": settings["threads"]}

    def call() -> Any:
        return optimize_with_report((start.points, start.cells), **options)

    return Task(call, lambda result: result[0], lambda result: dict(result[1].times))
