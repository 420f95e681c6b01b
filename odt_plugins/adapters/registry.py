"""Which adapter reads an object: a table, asked from top to bottom."""

from __future__ import annotations

from odt_plugins.adapters import (
    arrays,
    files,
    meshio_mesh,
    open3d_mesh,
    pymeshlab_mesh,
    pyvista_mesh,
)
from odt_plugins.adapters.host import Adapter
from odt_plugins.errors import UnsupportedMeshError

ADAPTERS: tuple[Adapter, ...] = (
    arrays,
    files,
    meshio_mesh,
    pyvista_mesh,
    pymeshlab_mesh,
    open3d_mesh,
)

ACCEPTED = (
    "a (points, cells) tuple of numpy arrays, a pyvista.UnstructuredGrid or PolyData, a "
    "meshio.Mesh, a pymeshlab.MeshSet or Mesh, an open3d TriangleMesh (legacy or tensor) or "
    "TetraMesh, or the path of a mesh file"
)

HINTS = {
    "open3d": "open3d.geometry.TetraMesh.create_from_point_cloud(cloud)[0]",
    "vtkmodules": "pyvista.wrap(mesh)",
    "trimesh": "(mesh.vertices, mesh.faces) as plain arrays",
    "builtins": "numpy.asarray on the points and on the cells",
}
"""What to pass instead of an object of a package that has no adapter, by package."""


def find_adapter(mesh: object) -> Adapter:
    """Find the adapter of an object.

    Raises
    ------
    UnsupportedMeshError    no adapter knows the object
    """
    for adapter in ADAPTERS:
        if adapter.matches(mesh):
            return adapter
    kind = type(mesh)
    hints = (HINTS.get(base.__module__.partition(".")[0]) for base in kind.__mro__)
    hint = next((hint for hint in hints if hint), HINTS["builtins"])
    name = f"{kind.__module__}.{kind.__qualname__}".removeprefix("builtins.")
    msg = f"got an object of type {name}; expected {ACCEPTED}, try {hint}"
    raise UnsupportedMeshError(msg)
