"""Smoothing filters of open3d on surfaces."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.compare.baselines.task import Settings, Task
from odt_plugins.compare.start import StartMesh


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Give the start to a TriangleMesh. Settings: `filter` (its name) and `iterations`."""
    import open3d

    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(start.points), open3d.utility.Vector3iVector(start.cells)
    )

    def call() -> Any:
        smooth = getattr(mesh, f"filter_smooth_{settings['filter']}")
        return smooth(number_of_iterations=settings["iterations"])

    def collect(result: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        return np.asarray(result.vertices), np.asarray(result.triangles)

    return Task(call, collect)
