"""open3d.visualization.rendering.TriangleMeshModel: every mesh of it by itself.

Everything survives: names and order of the meshes, materials, in each mesh what
:mod:`odt_plugins.adapters.open3d_mesh` keeps. Meshes without triangles come back as copies.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.host import HostMesh, Result, is_instance
from odt_plugins.errors import UnsupportedMeshError, counted

PART, PARTS = "mesh", "meshes"
"""What a part is called, and several of them."""

TOGETHER = "sum((info.mesh for info in mesh.meshes), open3d.geometry.TriangleMesh())"
"""What makes one mesh of a model."""


def matches(mesh: object) -> bool:
    """Say whether this is a TriangleMeshModel of open3d."""
    return is_instance(mesh, "open3d", "TriangleMeshModel")


def read(mesh: Any, regions: str | Sequence[str] | None = None) -> NoReturn:
    """Refuse what needs a single mesh."""
    msg = (f"got a TriangleMeshModel of {counted(len(mesh.meshes), 'mesh', 'meshes')} where a "
           f"single mesh is needed, try {TOGETHER}")
    raise UnsupportedMeshError(msg)


def write(result: Result, host: HostMesh) -> NoReturn:
    """Refuse: :func:`replaced` makes the result."""
    raise NotImplementedError


def chosen(mesh: Any) -> dict[int, str]:
    """Places and names of the meshes to optimise.

    Raises
    ------
    UnsupportedMeshError    there are none
    """
    found = {i: info.mesh_name or f"mesh {i}" for i, info in enumerate(mesh.meshes)
             if len(info.mesh.triangles)}
    if not found:
        msg = (f"got a TriangleMeshModel of {counted(len(mesh.meshes), 'mesh', 'meshes')} without "
               f"triangles; expected at least one")
        raise UnsupportedMeshError(msg)
    return found


def part_at(mesh: Any, key: int) -> Any:
    """The mesh at a place."""
    return mesh.meshes[key].mesh


def placed(mesh: Any, key: int, points: NDArray[Any]) -> list[NDArray[np.float64]]:
    """Where points (n, 3) of a mesh lie in the model."""
    return [np.asarray(points, dtype=np.float64)]


def replaced(mesh: Any, results: dict[int, Any]) -> Any:
    """Make a model of the same class with the results in the places of the meshes."""
    out = type(mesh)()
    out.materials = mesh.materials
    out.meshes = [
        type(info)(results[i] if i in results else type(info.mesh)(info.mesh), info.mesh_name,
                   info.material_idx)
        for i, info in enumerate(mesh.meshes)]
    return out
