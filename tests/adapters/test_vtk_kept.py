"""Files of VTK with everything in them go through: types, roles, names and encodings stay."""

from __future__ import annotations

import re
import warnings

import contract
import meshio
import numpy as np
import pytest

from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file
from odt_plugins.errors import MeshFileError

pytest.importorskip("vtkmodules")

ROLES = ("Scalars", "Vectors", "Normals", "Tensors", "GlobalIds", "PedigreeIds")


def array(values, name, kind=None, components=()):
    """An array of VTK, of ids or bits where asked for."""
    from vtkmodules import vtkCommonCore
    from vtkmodules.util.numpy_support import numpy_to_vtk

    out = numpy_to_vtk(np.ascontiguousarray(values), deep=True)
    if kind:
        made = getattr(vtkCommonCore, kind)()
        made.DeepCopy(out)
        out = made
    out.SetName(name)
    for k, component in enumerate(components):
        out.SetComponentName(k, component)
    return out


def everything(surface):
    """A grid or PolyData with lines, arrays of many types, roles, fields, text and ghosts."""
    from vtkmodules.vtkCommonCore import vtkPoints, vtkStringArray
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData, vtkUnstructuredGrid

    points, cells, _ = contract.grid(2 if surface else 3, 6)
    points = np.column_stack([points, np.zeros((len(points), 3 - points.shape[1]))])
    points = points.astype(np.float32)
    out = (vtkPolyData if surface else vtkUnstructuredGrid)()
    corners = vtkPoints()
    corners.SetData(array(points, "Points"))
    out.SetPoints(corners)
    rows = vtkCellArray()
    for cell in cells.tolist():
        rows.InsertNextCell(len(cell), cell)
    if surface:
        lines = vtkCellArray()
        lines.InsertNextCell(2, cells[0, :2].tolist())
        out.SetLines(lines)
        out.SetPolys(rows)
    else:
        out.SetCells(10, rows)
    n, m = len(points), out.GetNumberOfCells()
    of_points, of_cells, fields = out.GetPointData(), out.GetCellData(), out.GetFieldData()
    of_points.SetScalars(array(points[:, 0] / 3, "two words"))
    of_points.SetVectors(array(points / np.float64(3), "flow", components=("u", "v", "w")))
    of_points.SetTensors(array(np.tile(np.eye(3).ravel() / 3, (n, 1)), "tensor"))
    of_points.SetGlobalIds(array(np.arange(n) + 9, "GlobalPointIds", "vtkIdTypeArray"))
    of_points.AddArray(array(np.zeros(n, np.uint8), "vtkGhostType"))
    of_cells.SetScalars(array(np.full(m, 3, np.int32), "whole"))
    of_cells.SetPedigreeIds(array(np.zeros(m, np.int64), "origin", "vtkIdTypeArray"))
    of_cells.AddArray(array(np.zeros(m, np.uint8), "vtkGhostType"))
    of_cells.AddArray(array(np.ones(m, np.uint8), "bits", "vtkBitArray"))
    for kind in ("i1", "u2", "i8", "f4"):
        of_cells.AddArray(array(np.full(m, 5, kind), f"of {kind}"))
    fields.AddArray(array(np.array([1 / 3]), "TimeValue"))
    texts = vtkStringArray()
    texts.SetName("authors")
    for text in ("one", "and two"):
        texts.InsertNextValue(text)
    fields.AddArray(texts)
    return out


def store(dataset, path, mode, compressor, wide):
    """Write a dataset by VTK."""
    from vtkmodules import vtkIOLegacy, vtkIOXML

    kind = dataset.GetClassName().removeprefix("vtk")
    if path.suffix == ".vtk":
        writer = getattr(vtkIOLegacy, f"vtk{kind}Writer")()
        writer.SetHeader("a title")
        (writer.SetFileTypeToASCII if mode == "Ascii" else writer.SetFileTypeToBinary)()
    else:
        writer = getattr(vtkIOXML, f"vtkXML{kind}Writer")()
        getattr(writer, f"SetDataModeTo{mode.removesuffix(' raw')}")()
        writer.SetEncodeAppendedData(not mode.endswith("raw"))
        if compressor:
            getattr(writer, f"SetCompressorTypeTo{compressor}")()
        else:
            writer.SetCompressor(None)
        writer.SetHeaderTypeToUInt64() if wide else writer.SetHeaderTypeToUInt32()
    writer.SetFileName(str(path))
    writer.SetInputData(dataset)
    writer.Write()


def seen(path):
    """What VTK sees in a file, of what a run does not change."""
    from vtkmodules import vtkIOLegacy, vtkIOXML

    if path.suffix == ".vtk":
        reader = vtkIOLegacy.vtkDataSetReader()
    else:
        kind = {".vtu": "UnstructuredGrid", ".vtp": "PolyData"}[path.suffix]
        reader = getattr(vtkIOXML, f"vtkXML{kind}Reader")()
    reader.SetFileName(str(path))
    reader.Update()
    found = reader.GetOutput()
    out = {"class": found.GetClassName(), "points": found.GetPoints().GetData().GetClassName()}
    for home in ("Point", "Cell", "Field"):
        data = getattr(found, f"Get{home}Data")()
        for i in range(data.GetNumberOfArrays()):
            one = data.GetAbstractArray(i)
            out[home, one.GetName()] = (
                one.GetClassName(), one.GetNumberOfComponents(), one.GetNumberOfTuples()
                if home == "Field" else 0, [one.GetComponentName(k) for k in range(
                    one.GetNumberOfComponents())] if one.HasAComponentName() else [])
        for role in ROLES if home != "Field" else ():
            active = getattr(data, f"Get{role}")()
            out[home, "role", role] = active and active.GetName()
    data = path.read_bytes()
    out["file"] = (data.split(b"\n")[:3] if path.suffix == ".vtk" else
                   [re.search(rb'<VTKFile type="\w+" version="[^"]+"|$', data)[0],
                    *re.findall(rb' (?:byte_order|header_type|compressor)="\w+"', data[:400]),
                    sorted(set(re.findall(rb'format="\w+"', data))),
                    re.findall(rb"<AppendedData encoding=..", data)])
    return out


@pytest.mark.parametrize(("suffix", "mode", "compressor", "wide"), [
    (".vtk", "Ascii", "", 0), (".vtk", "Binary", "", 0), (".xml", "Ascii", "", 1),
    (".xml", "Binary", "", 0), (".xml", "Binary", "LZ4", 1), (".xml", "Appended", "LZMA", 0),
    (".xml", "Appended raw", "ZLib", 1), (".xml", "Appended raw", "", 0)])
@pytest.mark.parametrize("surface", [False, True])
def test_everything_goes_through(surface, suffix, mode, compressor, wide, tmp_path):
    suffix = suffix.replace("xml", "vtp" if surface else "vtu")
    source, target = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    store(everything(surface), source, mode, compressor, wide)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        optimize_file(source, target)
    assert read_file(source).points.tobytes() != read_file(target).points.tobytes()
    before, after = seen(source), seen(target)
    assert after == before


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("surface", [False, True])
def test_everything_goes_from_one_format_of_vtk_into_another(surface, legacy, tmp_path):
    names = ["a.vtk", "b.vtp" if surface else "b.vtu"]
    source, target = (tmp_path / name for name in (names if legacy else names[::-1]))
    store(everything(surface), source, "Binary", "", 0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        optimize_file(source, target)
    before, after = ({key: found[3] if type(found) is tuple else found for key, found in
                      seen(path).items() if key not in ("file", "points")}
                     for path in (source, target))
    assert after == before


def test_cells_that_are_not_read_are_named(tmp_path):
    import pyvista

    strips = pyvista.Sphere(theta_resolution=8, phi_resolution=8).strip()
    for name in ("a.vtp", "a.vtk"):
        strips.save(tmp_path / name)
        with pytest.raises(MeshFileError, match=r"type triangle strip .*try a file without"):
            read_file(tmp_path / name)


@pytest.mark.parametrize("surface", [False, True])
def test_legacy_files_of_text_have_all_digits(surface, tmp_path):
    store(everything(surface), tmp_path / "a.vtk", "Binary", "", 0)
    mesh = read_file(tmp_path / "a.vtk")
    write_file(tmp_path / "b.vtk", mesh, binary=False)
    back = read_file(tmp_path / "b.vtk")
    assert (tmp_path / "b.vtk").read_bytes().split(b"\n")[2] == b"ASCII"
    assert np.array_equal(back.points, mesh.points)
    for kind in ("point_data", "field_data", "cell_data"):
        for name, values in getattr(mesh, kind).items():
            found = getattr(back, kind)[name]
            if kind == "cell_data":
                values, found = np.concatenate(values), np.concatenate(found)
            assert np.array_equal(found, values), name


@pytest.mark.parametrize("name", ["", "\x01ctl"])
@pytest.mark.parametrize("kind", ["point_sets", "cell_sets", "point_data"])
def test_names_that_xml_does_not_take_are_others(kind, name, tmp_path):
    """A file with such a name was written, could not be read again, and so was refused."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    values = {"point_sets": [0, 1], "cell_sets": [[0]], "point_data": np.arange(4)}[kind]
    mesh = meshio.Mesh(points, [("tetra", [[0, 1, 2, 3]])], **{kind: {name: values}})
    with pytest.warns(match="does not keep"):
        write_file(tmp_path / "a.vtu", mesh)
    back = read_file(tmp_path / "a.vtu")
    assert [*back.point_data, *back.cell_data] == ["_ctl" if name else "unnamed"]


@pytest.mark.parametrize("role", ["GlobalIds", "PedigreeIds"])
def test_large_ids_are_whole_in_legacy_files(role, tmp_path):
    import pyvista
    from vtkmodules.util.numpy_support import numpy_to_vtkIdTypeArray

    surface = pyvista.Sphere(theta_resolution=8, phi_resolution=8)
    ids = np.arange(surface.n_cells) + 2**40
    array = numpy_to_vtkIdTypeArray(ids, deep=True)
    array.SetName("ids")
    getattr(surface.GetCellData(), f"Set{role}")(array)
    surface.save(tmp_path / "a.vtp")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        optimize_file(tmp_path / "a.vtp", tmp_path / "b.vtk")
    back = pyvista.read(tmp_path / "b.vtk").cell_data["ids"]
    assert np.isin(back, ids).all()
