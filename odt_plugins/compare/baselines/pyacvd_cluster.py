"""PyACVD: a surface made anew of clusters of its vertices of about one area."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.compare.baselines.task import Settings, Task, wanted_size
from odt_plugins.compare.start import StartMesh


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Give the surface to PyACVD, as many clusters as it has vertices of the `size`.

    Settings: `subdivide`, how often the triangles are cut into four first; `size`.
    """
    from pyacvd import Clustering
    from pyvista import PolyData

    surface = PolyData.from_regular_faces(start.points, start.cells.astype(int))
    # an equilateral triangle of that edge for half a vertex
    count = surface.area / (0.5 * 3.0**0.5 * wanted_size(start, settings) ** 2)

    def call() -> Any:
        clusters = Clustering(surface)
        clusters.subdivide(settings["subdivide"])
        clusters.cluster(max(4, round(count)))
        return clusters.create_mesh()

    def collect(mesh: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        return np.asarray(mesh.points), np.asarray(mesh.regular_faces)

    return Task(call, collect)
