"""trimesh.Scene: every geometry that is a Trimesh by itself.

Everything survives: class, graph with its nodes and transforms, names and order of the geometries,
camera, lights and metadata, in each geometry what :mod:`odt_plugins.adapters.trimesh_mesh` keeps.
Primitives, paths, point clouds and geometries without faces come back as copies.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters import trimesh_mesh
from odt_plugins.adapters.host import HostMesh, Result, is_instance
from odt_plugins.errors import UnsupportedMeshError, counted

PART, PARTS = "geometry", "geometries"
"""What a part is called, and several of them."""

TOGETHER = "mesh.to_mesh()"
"""What makes one mesh of a scene."""

LOADED = "trimesh.load_scene(path), or trimesh.load_mesh(path) for one mesh"
"""What reads a scene, or one mesh, from a file."""


def matches(mesh: object) -> bool:
    """Say whether this is a Scene of trimesh."""
    return is_instance(mesh, "trimesh", "Scene")


def read(
    mesh: Any, regions: str | Sequence[str] | None = None, remedy: str = TOGETHER
) -> NoReturn:
    """Refuse what needs a single mesh, and say what to try."""
    found = counted(len(mesh.geometry), "geometry", "geometries")
    msg = f"got a trimesh Scene of {found} where a single mesh is needed, try {remedy}"
    raise UnsupportedMeshError(msg)


def write(result: Result, host: HostMesh) -> NoReturn:
    """Refuse: :func:`replaced` makes the result."""
    raise NotImplementedError


def chosen(mesh: Any) -> dict[str, str]:
    """Keys and names of the geometries to optimise.

    Raises
    ------
    UnsupportedMeshError    there are none
    """
    found = {name: str(name) for name, part in mesh.geometry.items()
             if trimesh_mesh.matches(part) and not is_instance(part, "trimesh", "Primitive")
             and len(part.faces)}
    if not found:
        count = counted(len(mesh.geometry), "geometry", "geometries")
        msg = f"got a trimesh Scene of {count} without a Trimesh that has faces; expected one"
        raise UnsupportedMeshError(msg + (f", try {TOGETHER}" if mesh.geometry else ""))
    return found


def part_at(mesh: Any, key: str) -> Any:
    """The geometry of a name."""
    return mesh.geometry[key]


def placed(mesh: Any, key: str, points: NDArray[Any]) -> list[NDArray[np.float64]]:
    """Where points (n, 3) of a geometry lie in the scene, once for every node that shows it."""
    out = []
    for node in mesh.graph.nodes_geometry:
        matrix, name = mesh.graph[node]
        if name == key:
            turn, shift = np.asarray(matrix)[:3, :3], np.asarray(matrix)[:3, 3]
            out.append((points[:, None] * turn).sum(axis=2) + shift)
    return out


def replaced(mesh: Any, results: dict[str, Any]) -> Any:
    """Copy the scene and put the results in the places of the geometries."""
    out = mesh.copy()
    out.__class__ = type(mesh)
    out.metadata = deepcopy(mesh.metadata)
    vars(out).update({name: deepcopy(value) for name, value in vars(mesh).items()
                      if name not in vars(out)})
    for name, part in results.items():
        out.geometry[name] = part
    return out
