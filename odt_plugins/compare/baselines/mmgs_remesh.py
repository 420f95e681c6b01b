"""mmgs through mmgpy: a surface meshed anew with edges of one length."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from odt_plugins.compare.baselines.task import Settings, Task, mean_edge
from odt_plugins.compare.hull import labels_of
from odt_plugins.compare.start import StartMesh
from odt_plugins.mesh.simplex import diagonal


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Give the start to mmgs, with the mean length of its edges as the wanted one.

    Settings: `envelope`, its `hausd` as a part of the diagonal of the bounding box.
    """
    from mmgpy import MmgMeshS, MmgSOptions

    options = MmgSOptions(hausd=settings["envelope"] * diagonal(start.points),
                          hsiz=mean_edge(start), verbose=-1).to_dict()
    mesh = MmgMeshS(start.points, start.cells)
    mesh.set_triangles(start.cells, labels_of(start))

    def call() -> None:
        mesh.remesh(**options)

    def collect(_: Any) -> tuple[NDArray[Any], ...]:
        return mesh.get_vertices(), *mesh.get_triangles_with_refs()

    return Task(call, collect)
