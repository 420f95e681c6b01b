"""Netgen's volume optimisation on a mesh from elsewhere."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.compare.baselines.task import Settings, Task, flipped
from odt_plugins.compare.hull import labels_of, patches
from odt_plugins.compare.start import StartMesh


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Give the start to Netgen, which wants negative tetrahedra.

    Settings: `optimize3d`, the string of steps (m move, s swap, t split and swap);
    `steps`; `threads`.
    """
    from netgen.meshing import FaceDescriptor, Mesh, MeshingParameters

    mesh = Mesh(3)
    mesh.AddPoints(np.ascontiguousarray(start.points))
    facets, inside, outside = patches(start)
    sides, patch = np.unique(np.column_stack([inside, outside]), axis=0, return_inverse=True)
    for k, (domain, other) in enumerate(sides.tolist(), 1):
        mesh.Add(FaceDescriptor(surfnr=k, domin=domain + 1, domout=other + 1, bc=k))
        mesh.AddElements(dim=2, index=k, data=facets[patch.ravel() == k - 1], base=0)
    cells, labels = flipped(start.cells), labels_of(start)
    for label in np.unique(labels).tolist():
        mesh.AddElements(dim=3, index=label + 1, data=cells[labels == label], base=0)
    threads = settings["threads"]
    parameters = MeshingParameters(
        optimize3d=settings["optimize3d"], optsteps3d=settings["steps"],
        parallel_meshing=threads > 1, nthreads=threads,
    )

    def call() -> None:
        mesh.OptimizeVolumeMesh(parameters)

    def collect(_: Any) -> tuple[NDArray[Any], ...]:
        elements = mesh.Elements3D().NumPy()
        cells = np.array(elements["nodes"][:, :4]).astype(np.int32) - 1
        return np.array(mesh.Coordinates()), flipped(cells), np.array(elements["index"]) - 1

    return Task(call, collect)
