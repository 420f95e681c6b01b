"""mmg3d through mmgpy, the surface left alone."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from odt_plugins.compare.baselines.task import Settings, Task
from odt_plugins.compare.hull import labels_of
from odt_plugins.compare.start import StartMesh


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Give the start to mmg3d.

    Settings: `options` of mmg3d by name; `times` that it is run. Its default mode ("fem") cuts
    cells that touch the boundary too often, and slivers arise where the surface must not change,
    so `nofem` belongs among the options.
    """
    from mmgpy import Mmg3DOptions, MmgMesh3D

    options = Mmg3DOptions(verbose=-1, **settings["options"]).to_dict()

    def given(points: NDArray[Any], cells: NDArray[Any], references: NDArray[Any]) -> Any:
        mesh = MmgMesh3D(points, cells)
        mesh.set_tetrahedra(cells, references)
        return mesh

    first = given(start.points, start.cells, labels_of(start))

    def call() -> Any:
        mesh = first
        for turn in range(settings.get("times", 1)):
            if turn:
                mesh = given(mesh.get_vertices(), *mesh.get_tetrahedra_with_refs())
            mesh.remesh(**options)
        return mesh

    def collect(mesh: Any) -> tuple[NDArray[Any], ...]:
        return mesh.get_vertices(), *mesh.get_tetrahedra_with_refs()

    return Task(call, collect)
