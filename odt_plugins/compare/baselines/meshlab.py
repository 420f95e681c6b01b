"""Filters of MeshLab on triangles in the plane and on surfaces."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from odt_plugins.compare.baselines.task import Settings, Task, in_space
from odt_plugins.compare.start import StartMesh


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Give the start to a MeshSet.

    Settings: `filters`, a list of (name, parameters); a parameter `targetlen` that is None
    becomes the mean edge length of the start.
    """
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(in_space(start.points), start.cells))
    filters = []
    for name, parameters in settings["filters"]:
        given = dict(parameters)
        if given.get("targetlen", 0) is None:
            length = meshes.get_geometric_measures()["avg_edge_length"]
            given["targetlen"] = pymeshlab.PureValue(length)
        filters.append((name, given))

    def call() -> None:
        for name, given in filters:
            meshes.apply_filter(name, **given)

    def collect(_: Any) -> tuple[NDArray[Any], NDArray[Any]]:
        mesh = meshes.current_mesh()
        mesh.compact()
        return mesh.vertex_matrix()[:, : start.points.shape[1]], mesh.face_matrix()

    return Task(call, collect)
