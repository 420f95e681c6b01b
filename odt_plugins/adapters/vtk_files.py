"""Files of VTK, `.vtk`, `.vtu` and `.vtp`, through VTK's own readers and writers.

meshio reads no legacy file with integers of one or two bytes and writes some that VTK cannot read.
VTK's readers are C++: they run in a process of their own (:mod:`odt_plugins.adapters.apart`).
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.vtk_cells import Dataset, blocks_of, dataset_of, names
from odt_plugins.errors import MeshFileError, UnsupportedMeshError

FORMATS = {"vtk": "legacy", "vtu": "UnstructuredGrid", "vtp": "PolyData"}
"""Formats that VTK reads and writes, by their name in meshio, which knows no .vtp."""

POLYDATA: tuple[tuple[str, dict[int, int], int], ...] = (
    ("Verts", {1: 1}, 2), ("Lines", {2: 3}, 4), ("Polys", {3: 5, 4: 9}, 7), ("Strips", {}, 6))
"""Parts of PolyData in the order of their cell data: cell types by number of nodes, and of
other numbers."""

SECOND_NAMES = {"char": "int8", "signed_char": "int8", "unsigned_char": "uint8", "short": "int16",
                "unsigned_short": "uint16", "int": "int32", "unsigned_int": "uint32",
                "long": "int64", "unsigned_long": "uint64"}
"""Words of legacy files that meshio does not know, or takes for another type."""


def installed() -> bool:
    """Say whether VTK is there; it comes with pyvista."""
    return find_spec("vtkmodules") is not None


def read(path: Path, name: str) -> tuple[Any, list[str]]:
    """Read a file by VTK: one block for each type of cells, all arrays in the types of the file.

    Parameters
    ----------
    path : path
    name : str    one of FORMATS

    Returns
    -------
    mesh : meshio.Mesh
    remarks : list of str    cells that come as others

    Raises
    ------
    MeshFileError           VTK says that the file is broken, or it has no cells
    InvalidMeshError        it has cells of other numbers of nodes than their type has
    UnsupportedMeshError    it holds no grid of cells that meshio has a name for
    """
    source = _reader(name)
    source.SetFileName(str(path))
    said = _run(source)
    if said:
        raise MeshFileError(said)
    dataset = source.GetOutput()
    if dataset is None or not dataset.IsA("vtkPointSet"):
        kind = "nothing" if dataset is None else dataset.GetClassName()
        msg = f"it holds {kind}, expected vtkUnstructuredGrid or vtkPolyData"
        raise UnsupportedMeshError(msg)
    if not dataset.GetNumberOfCells():
        msg = "it has no cells"
        raise MeshFileError(msg)
    return blocks_of(_dataset(dataset))


def write_and_read(path: Path, mesh: Any, name: str, binary: bool = True) -> tuple[Any, str]:
    """Write a mesh by VTK, and read the file again: by VTK, and by meshio.

    Parameters
    ----------
    path : path
    mesh : meshio.Mesh    point and cell sets are written as arrays of 0 and 1
    name : str            one of FORMATS
    binary : bool         or as text

    Returns
    -------
    back : meshio.Mesh    what VTK reads
    said : str            how that differs from what meshio reads; empty when it does not, or
                          when meshio does not know something in the file

    Raises
    ------
    MeshFileError           VTK could not write
    UnsupportedMeshError    the format does not hold such cells
    """
    if not any(len(block.data) for block in mesh.cells):
        msg = "the mesh has no cells"
        raise UnsupportedMeshError(msg)
    sink = _writer(name, binary)
    sink.SetFileName(str(path))
    sink.SetInputData(_polydata(mesh) if name == "vtp" else _grid(mesh))
    said = _run(sink)
    if said or not path.is_file():
        raise MeshFileError(said or "VTK wrote nothing")
    back, _ = read(path, name)
    return back, "" if name == "vtp" else second_look(path, name, back)


def _reader(name: str) -> Any:
    if name == "vtk":
        from vtkmodules.vtkIOLegacy import vtkDataSetReader

        reader = vtkDataSetReader()
        for kind in ("Scalars", "Vectors", "Normals", "Tensors", "ColorScalars", "TCoords",
                     "Fields"):
            getattr(reader, f"ReadAll{kind}On")()
        return reader
    from vtkmodules import vtkIOXML

    return getattr(vtkIOXML, f"vtkXML{FORMATS[name]}Reader")()


def _writer(name: str, binary: bool) -> Any:
    if name == "vtk":
        from vtkmodules.vtkIOLegacy import vtkDataSetWriter

        writer = vtkDataSetWriter()
        (writer.SetFileTypeToBinary if binary else writer.SetFileTypeToASCII)()
        return writer
    from vtkmodules import vtkIOXML

    writer = getattr(vtkIOXML, f"vtkXML{FORMATS[name]}Writer")()
    (writer.SetDataModeToBinary if binary else writer.SetDataModeToAscii)()
    return writer


def _run(algorithm: Any) -> str:
    """Run a reader or writer, and give the first error that VTK tells, in one line."""
    from vtkmodules.vtkCommonCore import vtkOutputWindow, vtkStringOutputWindow

    window, before = vtkStringOutputWindow(), vtkOutputWindow.GetInstance()
    vtkOutputWindow.SetInstance(window)
    try:
        algorithm.Update() if hasattr(algorithm, "GetOutput") else algorithm.Write()
    finally:
        vtkOutputWindow.SetInstance(before)
    errors = [part.partition("\n\n")[0].partition("): ")[2] or part
              for part in window.GetOutput().split("ERROR:")[1:]]
    if not errors and algorithm.GetErrorCode():
        from vtkmodules.vtkCommonMisc import vtkErrorCode

        errors = [vtkErrorCode.GetStringFromErrorCode(algorithm.GetErrorCode())]
    return " ".join(errors[0].split()) if errors else ""


def _dataset(grid: Any) -> Dataset:
    """The arrays of a grid or PolyData."""
    return Dataset(as_numpy(grid.GetPoints().GetData()), *_cells(grid),
                   _arrays(grid.GetPointData()), _arrays(grid.GetCellData()),
                   _arrays(grid.GetFieldData()))


def _cells(dataset: Any) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Types (m,) of the cells, and their nodes: offsets (m + 1,) into the last array."""
    if dataset.IsA("vtkUnstructuredGrid"):
        cells = dataset.GetCells()
        return (as_numpy(dataset.GetCellTypes()), as_numpy(cells.GetOffsetsArray()),
                as_numpy(cells.GetConnectivityArray()))
    if not dataset.IsA("vtkPolyData"):
        msg = f"it holds {dataset.GetClassName()}, expected vtkUnstructuredGrid or vtkPolyData"
        raise UnsupportedMeshError(msg)
    types, sizes, flat = [], [], []
    for part, kinds, other in POLYDATA:
        cells = getattr(dataset, f"Get{part}")()
        size = np.diff(as_numpy(cells.GetOffsetsArray()))
        types.append(np.array([kinds.get(k, other) for k in size.tolist()], dtype=np.int64))
        sizes.append(size)
        flat.append(as_numpy(cells.GetConnectivityArray()))
    offset = np.concatenate([[0], np.cumsum(np.concatenate(sizes))])
    return np.concatenate(types), offset, np.concatenate(flat)


def as_numpy(array: Any) -> NDArray[Any]:
    """Copy an array of VTK, of texts too."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    if array.IsA("vtkStringArray"):
        return np.array([array.GetValue(i) for i in range(array.GetNumberOfValues())], dtype=str)
    return np.array(vtk_to_numpy(array))


def _arrays(data: Any) -> dict[str, NDArray[Any]]:
    """All arrays by name; those without a name are called after their number."""
    arrays = [data.GetAbstractArray(i) for i in range(data.GetNumberOfArrays())]
    return {array.GetName() or f"array {i}": as_numpy(array) for i, array in enumerate(arrays)}


def _polydata(mesh: Any) -> Any:
    """Make PolyData, whose cells are vertices, lines and polygons, in this order."""
    from meshio import Mesh
    from vtkmodules.vtkCommonDataModel import vtkPolyData

    kinds = names().meshio_to_vtk_type
    part = {kind: i for i, (_, some, other) in enumerate(POLYDATA)
            for kind in (*some.values(), other)}
    numbers = [part.get(kinds.get(block.type), -1) for block in mesh.cells]
    if -1 in numbers:
        name = mesh.cells[numbers.index(-1)].type
        msg = f"PolyData holds no cells of type {name}"
        raise UnsupportedMeshError(msg)
    order = np.argsort(numbers, kind="stable")
    ordered = Mesh(
        mesh.points, [mesh.cells[i] for i in order], mesh.point_data,
        {name: [values[i] for i in order] for name, values in mesh.cell_data.items()},
        mesh.field_data, mesh.point_sets,
        {name: [members[i] for i in order] for name, members in mesh.cell_sets.items()},
    )
    data = dataset_of(ordered)
    out, first = vtkPolyData(), 0
    for i, (name, _, _) in enumerate(POLYDATA):
        last = first + sum(len(mesh.cells[j].data) for j in order if numbers[j] == i)
        if last > first:
            ends = data.offset[first : last + 1]
            getattr(out, f"Set{name}")(_cell_array(ends - ends[0], data.nodes[ends[0] : ends[-1]]))
        first = last
    return _with_data(out, data)


def _grid(mesh: Any) -> Any:
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonDataModel import vtkUnstructuredGrid

    data = dataset_of(mesh)
    out = vtkUnstructuredGrid()
    out.SetCells(numpy_to_vtk(data.types, deep=True), _cell_array(data.offset, data.nodes))
    return _with_data(out, data)


def _cell_array(offset: NDArray[Any], nodes: NDArray[Any]) -> Any:
    from vtkmodules.util.numpy_support import numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonDataModel import vtkCellArray

    cells = vtkCellArray()
    cells.SetData(numpy_to_vtkIdTypeArray(offset, deep=True),
                  numpy_to_vtkIdTypeArray(nodes, deep=True))
    return cells


def _with_data(out: Any, data: Dataset) -> Any:
    """Give a dataset of VTK the points and all arrays."""
    from vtkmodules.vtkCommonCore import vtkPoints

    corners = vtkPoints()
    corners.SetData(_vtk(data.points))
    out.SetPoints(corners)
    for field, arrays in ((out.GetPointData(), data.point_data),
                          (out.GetCellData(), data.cell_data),
                          (out.GetFieldData(), data.field_data)):
        for name, values in arrays.items():
            array = _vtk(values)
            array.SetName(name)
            field.AddArray(array)
    return out


def _vtk(values: NDArray[Any]) -> Any:
    """Array of VTK with the same values and type."""
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkStringArray

    if values.dtype.kind in "US":
        texts = vtkStringArray()
        for text in values.ravel().tolist():
            texts.InsertNextValue(text)
        return texts
    return numpy_to_vtk(values, deep=True)


def second_look(path: Path, name: str, mesh: Any) -> str:
    """Read a file by meshio, and name what is other than VTK reads it."""
    from urllib.parse import unquote

    from meshio._helpers import reader_map
    from meshio.vtk import _vtk_42, _vtk_51

    modules: Any = (_vtk_42, _vtk_51)
    for module in modules:
        module.vtk_to_numpy_dtype_name |= SECOND_NAMES
    try:
        other = reader_map[name](str(path))
        cells, data = other.cells_dict, other.cell_data_dict
    # It knows less than VTK, such as arrays of text.
    except Exception:
        return ""
    pairs = [("the points", other.points, mesh.points)]
    pairs += [(f"cells of type {kind}", cells.get(kind), nodes)
              for kind, nodes in mesh.cells_dict.items()]
    pairs += [(f"point data {key!r}", values, mesh.point_data.get(unquote(key)))
              for key, values in other.point_data.items()]
    mine = mesh.cell_data_dict
    pairs += [(f"cell data {key!r}", values, mine.get(unquote(key), {}).get(kind))
              for key, parts in data.items() for kind, values in parts.items()]
    return ", ".join(what for what, one, two in pairs
                     if not _alike(np.ravel(one), np.ravel(two)))


def _alike(one: NDArray[Any], two: NDArray[Any]) -> bool:
    """Whether all values are the same, NaN being the same as NaN."""
    numbers = one.dtype.kind in "fc" and two.dtype.kind in "fc"
    return np.array_equal(one, two, equal_nan=numbers)
