"""CGAL's isotropic remeshing of surfaces, of its Polygon mesh processing."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.compare.baselines.cgal_optimize import place, polyhedron_of
from odt_plugins.compare.baselines.task import Settings, Task, wanted_size
from odt_plugins.compare.start import StartMesh


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Give the surface to CGAL, with the mean length of its edges unless there is a `size`.

    Settings: `iterations`, `size`.
    """
    from CGAL import CGAL_Polygon_mesh_processing as cgal

    polyhedron = polyhedron_of(start.points, start.cells)
    facets, length = list(polyhedron.facets()), wanted_size(start, settings)

    def call() -> None:
        cgal.isotropic_remeshing(facets, length, polyhedron, settings["iterations"])

    return Task(call, lambda _: _arrays(polyhedron))


def _arrays(polyhedron: Any) -> tuple[NDArray[Any], NDArray[Any]]:
    number = {place(vertex): i for i, vertex in enumerate(polyhedron.vertices())}
    rows = []
    for facet in polyhedron.facets():
        first = facet.halfedge()
        rows.append([number[place(h.vertex())] for h in (first, first.next(), first.prev())])
    cells = np.array(rows, dtype=np.int32)
    return np.array(list(number)), cells
