"""Files of VTK, `.vtk`, `.vtu` and `.vtp`, through VTK's own readers and writers.

meshio reads no legacy file with integers of one or two bytes and writes some that VTK cannot read.
VTK's readers are C++: they run in a process of their own (:mod:`odt_plugins.adapters.apart`).
"""

from __future__ import annotations

import re
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters import kinds as kinds_of
from odt_plugins.adapters.apart import VTK
from odt_plugins.adapters.legacy import write_exactly
from odt_plugins.adapters.second_look import OLD, other_in_meshio
from odt_plugins.errors import InvalidMeshError, MeshFileError, UnsupportedMeshError

SPLIT = {2: ("vertex", 1), 4: ("line", 2)}
"""Poly-vertices and poly-lines come as vertices and lines, one for each of their parts."""

TURNED = {8: ("quad", [0, 1, 3, 2]), 11: ("hexahedron", [0, 1, 3, 2, 4, 5, 7, 6])}
"""Pixels and voxels come as quadrilaterals and hexahedra."""

OTHERS = {0: "empty cell", 6: "triangle strip", 41: "convex point set", 42: "polyhedron"}
"""Names of cells that are not read."""

POLYDATA: tuple[tuple[str, dict[int, int], int], ...] = (
    ("Verts", {1: 1}, 2), ("Lines", {2: 3}, 4), ("Polys", {3: 5, 4: 9}, 7), ("Strips", {}, 6))
"""Parts of PolyData in the order of their cell data: cell types by number of nodes, and of
other numbers."""


COMPRESSORS = ("ZLib", "LZ4", "LZMA")
"""Of which XML files say that they are packed by them."""


class Like(NamedTuple):
    """What the file is, from which a mesh was read that is to be written in a format of VTK.

    Attributes
    ----------
    path : path                   None where there is no such file
    format : str                  one of apart.VTK, that of the file
    old : bool                    whether a legacy file is of an old version
    surface : bool                whether it holds PolyData
    title : str                   of a legacy file
    mode : str                    "Ascii", "Binary" or "Appended"
    encoded : bool                whether appended arrays are in base 64
    compressor : str              one of COMPRESSORS, empty for none
    wide : bool                   whether sizes have eight bytes
    big : bool                    whether the last byte of a number comes last
    """

    path: Path | None = None
    format: str = ""
    old: bool = False
    surface: bool = False
    title: str = ""
    mode: str = "Binary"
    encoded: bool = True
    compressor: str = COMPRESSORS[0]
    wide: bool = False
    big: bool = False


class Grid(NamedTuple):
    """What VTK reads; ``cells`` are types (m,), offsets (m + 1,), and the nodes these refer to."""

    points: NDArray[Any]
    cells: tuple[NDArray[Any], NDArray[Any], NDArray[Any]]
    point_data: dict[str, NDArray[Any]]
    cell_data: dict[str, NDArray[Any]]
    field_data: dict[str, NDArray[Any]]


def read(path: Path, name: str) -> Grid:
    """Read a file by VTK, all arrays in the types of the file.

    Parameters
    ----------
    path : path
    name : str    one of apart.VTK

    Raises
    ------
    MeshFileError           VTK says that the file is broken, or it has no cells
    UnsupportedMeshError    it holds no grid of cells
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
    return Grid(as_numpy(dataset.GetPoints().GetData()), _cells(dataset),
                _arrays(dataset.GetPointData()), _arrays(dataset.GetCellData()),
                _arrays(dataset.GetFieldData()))


def write_and_read(path: Path, mesh: Any, name: str, binary: bool | None = None) -> tuple[Any, str]:
    """Write a mesh by VTK, and read the file again: by VTK, and by meshio.

    A mesh that was read from a file of VTK is written as this is: arrays keep their types, names
    of components, units and roles, such as that of active scalars, PolyData where the format has
    them, and a file of the same format its encoding.

    Parameters
    ----------
    path : path
    mesh : meshio.Mesh    point and cell sets are written as arrays of 0 and 1
    name : str            one of apart.VTK
    binary : bool         or as text; None as the file is that it was read from, or else binary

    Returns
    -------
    back : meshio.Mesh    what VTK reads
    said : str            how that differs from what meshio reads, if it knows all in the file

    Raises
    ------
    MeshFileError           VTK could not write
    UnsupportedMeshError    the format does not hold such cells
    """
    if not any(len(block.data) for block in mesh.cells):
        msg = "the mesh has no cells"
        raise UnsupportedMeshError(msg)
    like = _like(mesh, name)
    if binary is not None:
        like = like._replace(mode="Binary" if binary else "Ascii")
    sink = _writer(name, like)
    sink.SetFileName(str(path))
    dataset = _polydata(mesh) if name == "vtp" or like.surface else _grid(mesh)
    if name == "vtk" and not like.old:
        _name_wide(dataset)
    if like.path is not None:
        source = _reader(like.format)
        source.SetFileName(str(like.path))
        if not _run(source):
            as_before(dataset, source.GetOutput(), narrow=name == "vtk")
    if name != "vtk":
        _escape(dataset)
    sink.SetInputData(dataset)
    said = _run(sink)
    if said or not path.is_file():
        raise MeshFileError(said or "VTK wrote nothing")
    if name == "vtk":
        write_exactly(path, partial(_values, dataset))
    back, _ = as_mesh(read(path, name))
    return back, "" if name == "vtp" else other_in_meshio(path, name, back)


def _escape(dataset: Any) -> None:
    """Write names as XML has them, which VTK does not do."""
    for home in ("Point", "Cell", "Field"):
        data = getattr(dataset, f"Get{home}Data")()
        for array in map(data.GetAbstractArray, range(data.GetNumberOfArrays())):
            array.SetName(escape(array.GetName()))


def _name_wide(dataset: Any) -> None:
    """Have integers of 64 bits written as `vtktypeint64`: meshio knows no `long` in version 5."""
    from vtkmodules import vtkCommonCore as vtk

    wide = {vtk.vtkLongArray().GetDataType(): vtk.vtkLongLongArray,
            vtk.vtkUnsignedLongArray().GetDataType(): vtk.vtkUnsignedLongLongArray}
    for data in (dataset.GetPointData(), dataset.GetCellData(), dataset.GetFieldData()):
        for array in map(data.GetAbstractArray, range(data.GetNumberOfArrays())):
            if array.GetDataType() in wide:
                made = wide[array.GetDataType()]()
                made.DeepCopy(array)
                data.AddArray(made)


def _values(dataset: Any, home: str, name: str) -> NDArray[Any] | None:
    """Points, or the array of a name, of what a legacy file tells of."""
    if home == "POINTS":
        return as_numpy(dataset.GetPoints().GetData())
    data = {"POINT_DATA": dataset.GetPointData, "CELL_DATA": dataset.GetCellData}.get(
        home, dataset.GetFieldData)()
    array = data.GetArray(name)
    return None if array is None else as_numpy(array)


def _like(mesh: Any, name: str) -> Like:
    """What the file is, from which a mesh was read that is to be one again, or another of VTK."""
    origin = getattr(mesh, "read_from", None)
    if origin is None or origin.format not in VTK or not origin.unchanged:
        return Like()
    if origin.format != name:
        return Like(origin.path, origin.format, surface=(origin.format, name) == ("vtp", "vtk"))
    if name == "vtk":
        with origin.path.open("rb") as file:
            lines = [file.readline(300) for _ in range(20)]
        head = [line.split() for line in lines]
        version = head[0][-1] if head[0] else b""
        words = [word.upper() for line in head[2:] for word in line[:2]]
        return Like(origin.path, name, version.split(b".")[0] in OLD, b"POLYDATA" in words,
                    lines[1].strip().decode("utf-8", "replace"),
                    "Ascii" if b"ASCII" in words[:2] else "Binary")
    data = origin.path.read_bytes()
    found = re.search(rb"<VTKFile\b[^>]*>", data)
    told = found[0] if found else b""
    formats = re.findall(rb"<DataArray\b[^>]*?format=\"(\w+)\"", data)
    modes = {word.title().decode() for word in formats}
    mode = next((mode for mode in ("Appended", "Binary", "Ascii") if mode in modes), "Binary")
    raw = re.search(rb"<AppendedData\s+encoding=\"raw\"", data)
    return Like(
        origin.path, name, mode=mode, encoded=raw is None,
        compressor=next((one for one in COMPRESSORS if f"vtk{one}Data".encode() in told), ""),
        wide=b"UInt64" in told, big=b"BigEndian" in told)


def as_before(out: Any, source: Any, *, narrow: bool) -> None:
    """Give arrays the types, names of components, information and roles of those of a dataset.

    Legacy files have 32 bits for ids, too `narrow` for some: these are numbers of 64 bits there.
    What was read as `vtktypeint64` VTK would write as `long`.
    """
    from vtkmodules.vtkCommonDataModel import vtkDataSetAttributes

    for data, old in ((out.GetPointData(), source.GetPointData()),
                      (out.GetCellData(), source.GetCellData()),
                      (out.GetFieldData(), source.GetFieldData())):
        for i in range(old.GetNumberOfArrays()):
            was = old.GetAbstractArray(i)
            now = data.GetAbstractArray(was.GetName() or f"array {i}")
            if now is None or now.GetNumberOfComponents() != was.GetNumberOfComponents():
                continue
            if now.GetClassName() != was.GetClassName() and _same_type(
                    now, was, narrow=narrow):
                made = was.NewInstance()
                made.DeepCopy(now)
                data.AddArray(made)
                now = made
            now.CopyInformation(was.GetInformation())
            for k in range(was.GetNumberOfComponents() if was.HasAComponentName() else 0):
                if was.GetComponentName(k):
                    now.SetComponentName(k, was.GetComponentName(k))
            table = getattr(was, "GetLookupTable", lambda: None)()
            if table is not None:
                own = table.NewInstance()
                own.DeepCopy(table)
                now.SetLookupTable(own)
        for role in range(vtkDataSetAttributes.NUM_ATTRIBUTES) if old.IsA(
                "vtkDataSetAttributes") else ():
            active = old.GetAbstractAttribute(role)
            if active is None or not data.HasArray(active.GetName() or ""):
                continue
            ids = data.GetAbstractArray(active.GetName())
            if role != vtkDataSetAttributes.GLOBALIDS or (
                    ids.IsA("vtkIdTypeArray") and ids.GetNumberOfTuples() == len(
                        np.unique(as_numpy(ids)))):
                data.SetActiveAttribute(active.GetName(), role)


def put_array(data: Any, values: NDArray[Any], name: str) -> None:
    """Add an array to data of pyvista; texts by VTK, since pyvista takes those of ASCII only."""
    if values.dtype.kind != "U":
        data.set_array(values, name)
        return
    texts = _vtk(values)
    texts.SetName(name)
    data.VTKObject.AddArray(texts)


def _same_type(now: Any, was: Any, *, narrow: bool) -> bool:
    """Whether an array may become one of the class of another: of ids, or of bits."""
    if was.IsA("vtkBitArray"):
        return not now.IsA("vtkStringArray") and set(np.unique(as_numpy(now)).tolist()) <= {0, 1}
    if narrow and was.GetClassName().startswith("vtkType"):
        return False
    values = as_numpy(now)
    if narrow and was.IsA("vtkIdTypeArray") and np.abs(values).max(initial=0) >= 2**31:
        return False
    return bool(values.dtype == as_numpy(was).dtype)


def _reader(name: str) -> Any:
    if name == "vtk":
        from vtkmodules.vtkIOLegacy import vtkDataSetReader

        reader = vtkDataSetReader()
        for kind in ("Scalars", "Vectors", "Normals", "Tensors", "ColorScalars", "TCoords",
                     "Fields"):
            getattr(reader, f"ReadAll{kind}On")()
        return reader
    from vtkmodules import vtkIOXML

    return getattr(vtkIOXML, f"vtkXML{VTK[name]}Reader")()


def _writer(name: str, like: Like) -> Any:
    if name == "vtk":
        from vtkmodules.vtkIOLegacy import vtkDataSetWriter

        writer = vtkDataSetWriter()
        (writer.SetFileTypeToASCII if like.mode == "Ascii" else writer.SetFileTypeToBinary)()
        if like.old:
            writer.SetFileVersion(writer.VTK_LEGACY_READER_VERSION_4_2)
        if like.title:
            writer.SetHeader(like.title)
        return writer
    from vtkmodules import vtkIOXML

    writer = getattr(vtkIOXML, f"vtkXML{VTK[name]}Writer")()
    getattr(writer, f"SetDataModeTo{like.mode}")()
    writer.SetEncodeAppendedData(like.encoded)
    if like.compressor:
        getattr(writer, f"SetCompressorTypeTo{like.compressor}")()
    else:
        writer.SetCompressor(None)
    writer.SetHeaderTypeToUInt64() if like.wide else writer.SetHeaderTypeToUInt32()
    writer.SetByteOrderToBigEndian() if like.big else writer.SetByteOrderToLittleEndian()
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


def as_mesh(grid: Grid) -> tuple[Any, list[str]]:
    """Make what VTK reads a mesh: one block for each type of cells.

    Returns
    -------
    mesh : meshio.Mesh
    remarks : list of str    cells that come as others

    Raises
    ------
    InvalidMeshError        it has cells of other numbers of nodes than their type has
    UnsupportedMeshError    it has cells that meshio has no name for
    """
    from meshio import Mesh

    types, offset, flat = grid.cells
    size = np.diff(offset)
    if len(types) != len(size) or (size < 0).any() or offset[0] != 0 or offset[-1] != len(flat):
        msg = "its cells do not fit together"
        raise InvalidMeshError(msg)
    blocks: list[Any] = []
    rows: list[NDArray[Any]] = []
    said: list[str] = []
    kinds = types.astype(np.int64) * (int(size.max()) + 1) + size
    _, first = np.unique(kinds, return_index=True)
    for i in np.sort(first):
        kind, width = int(types[i]), int(size[i])
        which = np.flatnonzero(kinds == kinds[i])
        nodes = flat[offset[which][:, None] + np.arange(width)]
        if kind in SPLIT:
            name, step = SPLIT[kind]
            said.append(f"poly-{name} cells come as {name} cells")
            nodes = np.stack([nodes[:, j : width - step + j + 1] for j in range(step)], axis=2)
            which = np.repeat(which, nodes.shape[1])
            nodes = nodes.reshape(-1, step)
        elif kind in TURNED:
            name, order = TURNED[kind]
            said.append(f"VTK's cells of type {kind} come as {name} cells")
            nodes = nodes[:, order]
        elif kind in kinds_of.VTK and kind not in (0, 42):
            name = kinds_of.VTK[kind]
            nodes = nodes[:, kinds_of.WEDGE] if name == "wedge" else nodes
        else:
            word = OTHERS.get(kind, f"{kind} of VTK")
            msg = f"it has cells of type {word} (first: cell {i})"
            raise UnsupportedMeshError(msg)
        if nodes.shape[1] != (kinds_of.nodes_of(name) or nodes.shape[1]):
            msg = f"its cell {i} is of type {name} and has {width} nodes"
            raise InvalidMeshError(msg)
        same = [j for j, (other, old) in enumerate(blocks)
                if other == name and old.shape[1:] == nodes.shape[1:]]
        if same:
            blocks[same[0]] = (name, np.concatenate([blocks[same[0]][1], nodes]))
            rows[same[0]] = np.concatenate([rows[same[0]], which])
        else:
            blocks.append((name, nodes))
            rows.append(which)
    cell_data = {key: [values[row] for row in rows] for key, values in grid.cell_data.items()}
    point_data: Any = grid.point_data
    mesh = Mesh(grid.points, blocks, point_data, cell_data, grid.field_data)
    return mesh, list(dict.fromkeys(said))


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
    """Copy an array of VTK."""
    from vtkmodules.util.numpy_support import vtk_to_numpy

    kind = {"vtkStringArray": str, "vtkBitArray": np.uint8}.get(array.GetClassName())
    if kind:
        own = [*map(array.GetValue, range(array.GetNumberOfValues()))]
        k = array.GetNumberOfComponents()
        return np.array(own, kind).reshape([-1, k][:k])
    return np.array(vtk_to_numpy(array))


def _arrays(data: Any) -> dict[str, NDArray[Any]]:
    """All arrays by name; those without a name are called after their number."""
    arrays = [data.GetAbstractArray(i) for i in range(data.GetNumberOfArrays())]
    return {array.GetName() or f"array {i}": as_numpy(array) for i, array in enumerate(arrays)}


def _polydata(mesh: Any) -> Any:
    """Make PolyData, whose cells are vertices, lines and polygons, in this order."""
    from meshio import Mesh
    from vtkmodules.vtkCommonDataModel import vtkPolyData

    part = {kind: i for i, (_, some, other) in enumerate(POLYDATA)
            for kind in (*some.values(), other)}
    numbers = [part.get(kinds_of.IN_VTK.get(block.type, -1), -1) for block in mesh.cells]
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
    out = vtkPolyData()
    for i, (name, _, _) in enumerate(POLYDATA):
        chosen = [mesh.cells[j].data for j in order if numbers[j] == i]
        if chosen:
            getattr(out, f"Set{name}")(_cell_array(chosen))
    return _with_data(out, ordered)


def _grid(mesh: Any) -> Any:
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonDataModel import vtkUnstructuredGrid

    unknown = [block.type for block in mesh.cells if block.type not in kinds_of.IN_VTK]
    if unknown:
        msg = f"VTK has no cells of type {unknown[0]}"
        raise UnsupportedMeshError(msg)
    nodes = [block.data[:, kinds_of.WEDGE] if block.type == "wedge" else block.data
             for block in mesh.cells]
    types = np.concatenate([np.full(len(block.data), kinds_of.IN_VTK[block.type], np.uint8)
                            for block in mesh.cells])
    out = vtkUnstructuredGrid()
    out.SetCells(numpy_to_vtk(types, deep=True), _cell_array(nodes))
    return _with_data(out, mesh)


def _cell_array(blocks: list[NDArray[Any]]) -> Any:
    from vtkmodules.util.numpy_support import numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonDataModel import vtkCellArray

    size = np.concatenate([np.full(len(nodes), nodes.shape[1]) for nodes in blocks])
    offset = np.concatenate([[0], np.cumsum(size)]).astype(np.int64)
    flat = np.concatenate([nodes.ravel() for nodes in blocks]).astype(np.int64)
    cells = vtkCellArray()
    cells.SetData(numpy_to_vtkIdTypeArray(offset, deep=True),
                  numpy_to_vtkIdTypeArray(flat, deep=True))
    return cells


def _with_data(out: Any, mesh: Any) -> Any:
    """Give a dataset the points and all arrays of a mesh; sets become arrays of 0 and 1."""
    from vtkmodules.vtkCommonCore import vtkPoints

    n, sizes = len(mesh.points), [len(block.data) for block in mesh.cells]
    points = np.zeros((n, 3), dtype=mesh.points.dtype)
    points[:, : mesh.points.shape[1]] = mesh.points
    if points.dtype not in (np.float32, np.float64):
        points = points.astype(np.float64)
    corners = vtkPoints()
    corners.SetData(_vtk(points))
    out.SetPoints(corners)
    point = {name: _members([members], [n]) for name, members in mesh.point_sets.items()}
    cell = {name: _members(members, sizes) for name, members in mesh.cell_sets.items()}
    cell |= {name: np.concatenate(values) for name, values in mesh.cell_data.items()}
    for data, arrays in ((out.GetPointData(), point | mesh.point_data), (out.GetCellData(), cell),
                         (out.GetFieldData(), mesh.field_data)):
        for name, values in arrays.items():
            array = _vtk(np.atleast_1d(np.asarray(values)))
            array.SetName(name)
            data.AddArray(array)
    return out


def _members(members: list[Any], sizes: list[int]) -> NDArray[np.uint8]:
    """Array of 0 and 1 of the members of a set, given by blocks as indices or masks."""
    parts = []
    for part, size in zip(members, sizes, strict=True):
        inside = np.zeros(size, dtype=np.uint8)
        if part is not None and len(part):
            inside[np.asarray(part)] = 1
        parts.append(inside)
    return np.concatenate(parts)


def _vtk(values: NDArray[Any]) -> Any:
    """Array of VTK with the same values and type; truth values become bytes."""
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkStringArray

    if values.dtype.kind in "US":
        texts = vtkStringArray()
        texts.SetNumberOfComponents(max(1, values.size // max(1, len(values))))
        for text in values.ravel().tolist():
            texts.InsertNextValue(text)
        return texts
    if values.dtype.kind == "b":
        values = values.astype(np.uint8)
    wide = values.astype(values.dtype.newbyteorder("="), copy=False)
    return numpy_to_vtk(np.ascontiguousarray(wide.reshape(len(wide), -1) if wide.ndim > 2
                                             else wide), deep=True)
