"""Filters of MeshLab on triangles in the plane and on surfaces."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from odt_plugins.compare.baselines.task import Settings, Task, in_space, wanted_size
from odt_plugins.compare.hull import held_vertices
from odt_plugins.compare.start import StartMesh
from odt_plugins.mesh.simplex import diagonal


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Give the start to a MeshSet, with the vertex quality 0 where a vertex must stay, 1 elsewhere.

    Settings: `filters`, a list of (name, parameters); a parameter `targetlen` that is None
    becomes the `size` or the mean edge length of the start, a `maxsurfdist` the `envelope`.
    `regions`, whether the filters keep the cells and what must stay.
    """
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    free = 1.0 - held_vertices(start)
    meshes.add_mesh(pymeshlab.Mesh(in_space(start.points), start.cells, v_scalar_array=free))
    filters = []
    for name, parameters in settings["filters"]:
        given = dict(parameters)
        if given.get("targetlen", 0) is None:
            given["targetlen"] = pymeshlab.PureValue(wanted_size(start, settings))
        if given.get("maxsurfdist", 0) is None:
            length = settings["envelope"] * diagonal(start.points)
            given["maxsurfdist"] = pymeshlab.PureValue(length)
        filters.append((name, given))

    def call() -> None:
        for name, given in filters:
            meshes.apply_filter(name, **given)

    def collect(_: Any) -> tuple[NDArray[Any] | None, ...]:
        mesh = meshes.current_mesh()
        mesh.compact()
        regions = start.regions if settings.get("regions") else None
        return mesh.vertex_matrix()[:, : start.points.shape[1]], mesh.face_matrix(), regions

    return Task(call, collect)
