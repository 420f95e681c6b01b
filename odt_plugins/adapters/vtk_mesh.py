"""vtkUnstructuredGrid and vtkPolyData of VTK itself; pyvista need not be there.

They are read and written as pyvista's are, see :mod:`odt_plugins.adapters.pyvista_mesh`, and the
same survives: class, dtype of the points, all arrays with their types, components and tables of
colours, and which of them are active.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters import pyvista_mesh
from odt_plugins.adapters.host import HostMesh, Result, is_instance
from odt_plugins.adapters.polydata_cells import are_vertices
from odt_plugins.adapters.vtk_files import as_numpy

ACTIVE = {"active_scalars_name": "Scalars", "active_vectors_name": "Vectors",
          "active_normals_name": "Normals", "active_texture_coordinates_name": "TCoords"}
"""What pyvista calls the active arrays, and VTK."""


def matches(mesh: object) -> bool:
    """Say whether this is a vtkUnstructuredGrid or vtkPolyData."""
    return is_instance(mesh, "vtkmodules", "vtkUnstructuredGrid") or is_instance(
        mesh, "vtkmodules", "vtkPolyData")


def read(mesh: Any, regions: str | Sequence[str] | None = None) -> HostMesh:
    """Take the arrays out; parameters and errors are those of pyvista's meshes."""
    host = pyvista_mesh.read(Dataset(mesh), regions)
    return replace(host, words=lambda text: text.replace(
        "merging vertices at the same place", "vtkCleanPolyData or vtkStaticCleanUnstructuredGrid"))


def write(result: Result, host: HostMesh) -> Any:
    """Copy the caller's object and exchange its points, cells and cell data."""
    return pyvista_mesh.write(result, host).data


class Dataset:
    """A dataset of VTK with the names that pyvista gives to its parts."""

    def __init__(self, data: Any, source: Any = None) -> None:
        self.data = data
        like = data if source is None else source
        self.point_data = Arrays(data.GetPointData(), like.GetPointData())
        self.cell_data = Arrays(data.GetCellData(), like.GetCellData())
        self.n_points, self.n_cells = data.GetNumberOfPoints(), data.GetNumberOfCells()

    def copy(self, deep: bool) -> Dataset:
        """An independent copy."""
        out = type(self.data)()
        out.DeepCopy(self.data)
        return Dataset(out, self.data)

    def __getattr__(self, name: str) -> Any:
        """Methods of VTK, such as SetCells; and `n_verts`, `n_lines` and `n_strips`."""
        if name.startswith("n_"):
            return getattr(self.data, f"GetNumberOf{name[2:].title()}")()
        return getattr(self.data, name)

    @property
    def points(self) -> NDArray[Any]:
        """Places (n, 3) of the vertices."""
        points = self.data.GetPoints()
        return np.zeros((0, 3)) if points is None else as_numpy(points.GetData())

    @points.setter
    def points(self, values: NDArray[Any]) -> None:
        from vtkmodules.util.numpy_support import numpy_to_vtk
        from vtkmodules.vtkCommonCore import vtkPoints

        points = vtkPoints()
        points.SetData(numpy_to_vtk(np.ascontiguousarray(values), deep=True))
        self.data.SetPoints(points)

    @property
    def celltypes(self) -> NDArray[Any]:
        """Types (m,) of the cells of a grid."""
        return as_numpy(self.data.GetCellTypes()) if self.n_cells else np.zeros(0, dtype=np.uint8)

    @property
    def cell_offsets(self) -> NDArray[Any]:
        """Where the nodes of every cell of a grid begin."""
        return as_numpy(self.data.GetCells().GetOffsetsArray())

    @property
    def cell_connectivity(self) -> NDArray[Any]:
        """Nodes of all cells of a grid, one after another."""
        return as_numpy(self.data.GetCells().GetConnectivityArray())

    @property
    def verts(self) -> NDArray[Any]:
        """Vertex cells of PolyData as count, nodes, count, nodes, ..."""
        return _counted(self.data.GetVerts())

    @verts.setter
    def verts(self, values: NDArray[Any]) -> None:
        self.data.SetVerts(_cell_array(values))

    @property
    def lines(self) -> NDArray[Any]:
        """Poly-lines of PolyData in the same way."""
        return _counted(self.data.GetLines())

    @lines.setter
    def lines(self, values: NDArray[Any]) -> None:
        self.data.SetLines(_cell_array(values))

    @property
    def faces(self) -> NDArray[Any]:
        """Polygons of PolyData in the same way."""
        return _counted(self.data.GetPolys())

    @faces.setter
    def faces(self, values: NDArray[Any]) -> None:
        self.data.SetPolys(_cell_array(values))


class Arrays:
    """Arrays of the points or cells of a dataset, as numpy's; new ones are like those of before."""

    def __init__(self, data: Any, like: Any) -> None:
        self.VTKObject, self.like = data, like

    def keys(self) -> list[str]:
        """Names of the arrays; those without one cannot be kept."""
        names = (self.VTKObject.GetAbstractArray(i).GetName()
                 for i in range(self.VTKObject.GetNumberOfArrays()))
        return [name for name in names if name]

    def __getitem__(self, name: str) -> NDArray[Any]:
        return as_numpy(self.VTKObject.GetAbstractArray(name))

    def __setitem__(self, name: str, values: NDArray[Any]) -> None:
        self.set_array(values, name)

    def __getattr__(self, name: str) -> Any:
        array = getattr(self.VTKObject, f"Get{ACTIVE[name]}")()
        return None if array is None else array.GetName()

    def clear(self) -> None:
        """Remove all arrays."""
        self.VTKObject.Initialize()

    def set_array(self, values: NDArray[Any], name: str) -> None:
        """Add an array of numbers of the type that this one had, or replace it."""
        from vtkmodules.util.numpy_support import numpy_to_vtk

        old = self.like.GetAbstractArray(name)
        new = old.NewInstance()
        flat = np.ascontiguousarray(values).reshape(len(values), old.GetNumberOfComponents())
        new.DeepCopy(numpy_to_vtk(flat, deep=True))
        new.SetName(name)
        self.VTKObject.AddArray(new)


def _cell_array(values: NDArray[Any]) -> Any:
    inside = are_vertices(values)
    return pyvista_mesh.cell_array(values[~inside], values[inside])


def _counted(cells: Any) -> NDArray[Any]:
    offset = as_numpy(cells.GetOffsetsArray())
    return np.insert(as_numpy(cells.GetConnectivityArray()), offset[:-1], np.diff(offset))
