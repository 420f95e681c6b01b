"""Netgen's volume optimisation on a mesh from elsewhere."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.compare.baselines.task import Settings, Task, flipped
from odt_plugins.compare.hull import hull_facets
from odt_plugins.compare.start import StartMesh


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Give the start to Netgen, which wants negative tetrahedra.

    Settings: `optimize3d`, the string of steps (m move, s swap, t split and swap);
    `steps`; `threads`.
    """
    from netgen.meshing import FaceDescriptor, Mesh, MeshingParameters

    mesh = Mesh(3)
    mesh.AddPoints(np.ascontiguousarray(start.points))
    mesh.Add(FaceDescriptor(surfnr=1, domin=1, domout=0, bc=1))
    facets = np.ascontiguousarray(hull_facets(start), dtype=np.int32)
    mesh.AddElements(dim=2, index=1, data=facets, base=0)
    mesh.AddElements(dim=3, index=1, data=np.ascontiguousarray(flipped(start.cells)), base=0)
    threads = settings["threads"]
    parameters = MeshingParameters(
        optimize3d=settings["optimize3d"], optsteps3d=settings["steps"],
        parallel_meshing=threads > 1, nthreads=threads,
    )

    def call() -> None:
        mesh.OptimizeVolumeMesh(parameters)

    def collect(_: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        cells = np.array(mesh.Elements3D().NumPy()["nodes"][:, :4]).astype(np.int32) - 1
        return np.array(mesh.Coordinates()), flipped(cells)

    return Task(call, collect)
