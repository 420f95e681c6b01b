"""Gmsh on triangles from elsewhere: it parametrises them and meshes them anew."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.compare.baselines.task import Settings, Task, in_space, wanted_size
from odt_plugins.compare.start import StartMesh

TRIANGLE = 2
"""Gmsh's number of the element type."""


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Give the triangles to Gmsh. Settings: `angle` in degrees of its feature edges; `size`."""
    import gmsh

    gmsh.initialize(["-nopopup"], readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    mesh = gmsh.model.mesh
    gmsh.model.addDiscreteEntity(2, 1)
    count = len(start.points)
    mesh.addNodes(2, 1, np.arange(1, count + 1), in_space(start.points).ravel())
    mesh.addElementsByType(1, TRIANGLE, [], (start.cells.astype(np.uint64) + 1).ravel())
    for option in ("Min", "Max"):
        gmsh.option.setNumber(f"Mesh.MeshSize{option}", wanted_size(start, settings))

    def call() -> None:
        mesh.classifySurfaces(math.radians(settings["angle"]), True, True)
        mesh.createGeometry()
        mesh.generate(2)

    def collect(_: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        tags, flat, _ = mesh.getNodes()
        place = np.zeros(int(tags.max()) + 1, dtype=np.int64)
        place[tags] = np.arange(len(tags))
        rows = np.concatenate([mesh.getElementsByType(TRIANGLE, tag)[1]
                               for _, tag in gmsh.model.getEntities(2)])
        gmsh.finalize()
        return flat.reshape(-1, 3)[:, : start.points.shape[1]], place[rows.reshape(-1, 3)]

    return Task(call, collect)
