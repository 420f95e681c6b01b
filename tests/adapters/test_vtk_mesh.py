"""Objects of VTK itself."""

from __future__ import annotations

import functools
import subprocess
import sys

import contract
import numpy as np
import pytest

import odt_plugins
from odt_plugins.errors import InvalidMeshError, UnsupportedMeshError

pytest.importorskip("vtkmodules")

ALONE = """
import sys
sys.modules["pyvista"] = None
import numpy as np
import contract
from vtkmodules.util.numpy_support import numpy_to_vtk, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData, vtkUnstructuredGrid
import odt_plugins

class Grid(vtkUnstructuredGrid):
    pass

def filled(mesh, points, cells):
    places = vtkPoints()
    places.SetData(numpy_to_vtk(contract.in_space(points), deep=True))
    mesh.SetPoints(places)
    rows = vtkCellArray()
    for cell in cells.tolist():
        rows.InsertNextCell(len(cell), cell)
    mesh.SetPolys(rows) if isinstance(mesh, vtkPolyData) else mesh.SetCells(10, rows)
    return mesh

for mesh, dim in ((Grid(), 3), (vtkPolyData(), 2)):
    points, cells, _ = contract.grid(dim, 4)
    mesh = filled(mesh, points, cells)
    out, report = odt_plugins.optimize_with_report(mesh)
    assert type(out) is type(mesh)
    assert report.after == odt_plugins.quality(out)
    assert report.after.mean_quality > odt_plugins.quality((points, cells)).mean_quality
    arrays = odt_plugins.optimize((points, cells))
    places = vtk_to_numpy(out.GetPoints().GetData())
    assert np.allclose(places[:, :dim], arrays[0], rtol=0, atol=1e-15)
print("done")
"""


def test_vtk_objects_need_no_pyvista():
    done = subprocess.run([sys.executable, "-W", "error", "-c", ALONE], capture_output=True,
                          text=True, check=False,
                          env={"PYTHONPATH": ":".join(sys.path), "PATH": "/usr/bin:/bin"})
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["done"]


def test_quadratic_cells_and_others_come_back_as_from_pyvista():
    pyvista = pytest.importorskip("pyvista")
    from vtkmodules.vtkCommonDataModel import vtkPolyData, vtkUnstructuredGrid

    mesh = contract.HOSTS["pyvista-quadratic-tet"].make()
    plain = vtkUnstructuredGrid()
    plain.DeepCopy(mesh)
    assert pyvista.wrap(odt_plugins.optimize(plain)) == odt_plugins.optimize(mesh)
    x, y = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9))
    bowl = pyvista.StructuredGrid(x, y, x * x + y * y).extract_surface(algorithm=None)
    bowl = bowl.triangulate().merge(pyvista.Line((-1, -1, 2), (1, 1, 2)), merge_points=True)
    bowl = bowl.compute_normals(split_vertices=False)
    plain = vtkPolyData()
    plain.DeepCopy(bowl)
    out = pyvista.wrap(odt_plugins.optimize(plain))
    assert out == odt_plugins.optimize(bowl)
    assert not np.array_equal(out.points, bowl.points)


def test_other_objects_of_vtk_are_refused():
    from vtkmodules.vtkCommonDataModel import vtkImageData, vtkUnstructuredGrid

    with pytest.raises(UnsupportedMeshError, match=r"vtkImageData; .*try pyvista\.wrap"):
        odt_plugins.optimize(vtkImageData())
    pyvista = pytest.importorskip("pyvista")
    grid = vtkUnstructuredGrid()
    grid.DeepCopy(pyvista.UnstructuredGrid({10: np.arange(4)[None], 26: np.arange(15)[None]},
                                           np.eye(15)[:, :3]))
    with pytest.raises(UnsupportedMeshError, match="type QUADRATIC_WEDGE"):
        odt_plugins.optimize(grid)


def with_two_texts(points, cells):
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkPoints, vtkStringArray
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkUnstructuredGrid

    mesh, places, rows = vtkUnstructuredGrid(), vtkPoints(), vtkCellArray()
    places.SetData(numpy_to_vtk(points, deep=True))
    mesh.SetPoints(places)
    for cell in cells.tolist():
        rows.InsertNextCell(4, cell)
    mesh.SetCells(10, rows)
    for data, count in ((mesh.GetPointData(), len(points)), (mesh.GetCellData(), len(cells))):
        texts = vtkStringArray()
        texts.SetName("two")
        texts.SetNumberOfComponents(2)
        for i in range(count):
            texts.InsertNextValue(f"a{i}")
            texts.InsertNextValue(f"b{i}")
        data.AddArray(texts)
    return mesh


def pairs_of(array):
    assert array.GetNumberOfComponents() == 2
    texts = [array.GetValue(i) for i in range(array.GetNumberOfValues())]
    return list(zip(texts[::2], texts[1::2], strict=True))


@pytest.mark.parametrize("resize", [False, True])
def test_texts_of_any_letters_come_back_in_pyvista(resize):
    pyvista = pytest.importorskip("pyvista")
    points, cells, _ = contract.grid(3, 4)
    mesh = pyvista.UnstructuredGrid(with_two_texts(points, cells))
    for data in (mesh.GetPointData(), mesh.GetCellData()):
        array = data.GetAbstractArray("two")
        for i in range(array.GetNumberOfValues()):
            array.SetValue(i, array.GetValue(i).replace("a", "Öl ").replace("b", "水"))
    out, report = odt_plugins.remesh_with_report(mesh, scale=0.8) if resize else (
        odt_plugins.optimize_with_report(mesh))
    assert pairs_of(out.GetCellData().GetAbstractArray("two")) == [
        (f"Öl {i}", f"水{i}") for i in report.cell_origin.tolist()]
    named = pairs_of(out.GetPointData().GetAbstractArray("two"))
    assert len(named) == out.n_points
    assert named[0] == ("Öl 0", "水0")


@pytest.mark.parametrize("resize", [False, True])
def test_several_texts_for_each_come_back(resize):
    points, cells, _ = contract.grid(3, 4)
    mesh = with_two_texts(points, cells)
    out, report = odt_plugins.remesh_with_report(mesh, scale=0.8) if resize else (
        odt_plugins.optimize_with_report(mesh))
    origin = report.cell_origin.tolist()
    assert len(origin) == out.GetNumberOfCells()
    assert pairs_of(out.GetCellData().GetAbstractArray("two")) == [
        (f"a{i}", f"b{i}") for i in origin]
    named = pairs_of(out.GetPointData().GetAbstractArray("two"))
    assert len(named) == out.GetNumberOfPoints()
    assert all(one[1:] == other[1:] for one, other in named)


def test_several_texts_for_each_come_back_in_files(tmp_path):
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader, vtkXMLUnstructuredGridWriter

    points, cells, _ = contract.grid(3, 4)
    writer, reader = vtkXMLUnstructuredGridWriter(), vtkXMLUnstructuredGridReader()
    writer.SetFileName(str(tmp_path / "in.vtu"))
    writer.SetInputData(with_two_texts(points, cells))
    writer.Write()
    _, report = odt_plugins.optimize_with_report(tmp_path / "in.vtu", target=tmp_path / "out.vtu")
    reader.SetFileName(str(tmp_path / "out.vtu"))
    reader.Update()
    out = reader.GetOutput()
    assert pairs_of(out.GetCellData().GetAbstractArray("two")) == [
        (f"a{i}", f"b{i}") for i in report.cell_origin.tolist()]
    assert pairs_of(out.GetPointData().GetAbstractArray("two")) == [
        (f"a{i}", f"b{i}") for i in range(len(points))]


@pytest.mark.parametrize("suffix", ["", ".vtu", ".vtk"])
def test_several_bits_for_each_come_back(suffix, tmp_path):
    from vtkmodules import vtkIOLegacy, vtkIOXML
    from vtkmodules.vtkCommonCore import vtkBitArray

    points, cells, _ = contract.grid(3, 4)
    mesh = with_two_texts(points, cells)
    bits = vtkBitArray()
    bits.SetName("bits")
    bits.SetNumberOfComponents(2)
    for i in range(len(cells)):
        bits.InsertNextTuple((i % 2, i % 3 == 0))
    mesh.GetCellData().AddArray(bits)
    if suffix:
        kinds = {".vtu": (vtkIOXML, "vtkXMLUnstructuredGrid"),
                 ".vtk": (vtkIOLegacy, "vtkUnstructuredGrid")}
        home, kind = kinds[suffix]
        source, target = tmp_path / f"in{suffix}", tmp_path / f"out{suffix}"
        writer, reader = getattr(home, f"{kind}Writer")(), getattr(home, f"{kind}Reader")()
        writer.SetFileName(str(source))
        writer.SetInputData(mesh)
        writer.Write()
        _, report = odt_plugins.optimize_with_report(source, target=target)
        reader.SetFileName(str(target))
        reader.Update()
        out = reader.GetOutput()
    else:
        out, report = odt_plugins.optimize_with_report(mesh)
    found = out.GetCellData().GetAbstractArray("bits")
    assert found.IsA("vtkBitArray")
    assert [found.GetTuple2(i) for i in range(found.GetNumberOfTuples())] == [
        (i % 2, i % 3 == 0) for i in report.cell_origin.tolist()]


@pytest.mark.parametrize("verb", [odt_plugins.optimize, functools.partial(
    odt_plugins.remesh, scale=0.8)])
def test_names_of_components_colour_tables_and_ids_survive_in_pyvista(verb):
    pyvista = pytest.importorskip("pyvista")
    from vtkmodules.vtkCommonCore import vtkLookupTable

    points, cells, _ = contract.grid(3, 4)
    mesh = pyvista.UnstructuredGrid({10: cells}, points)
    mesh.point_data["wind"], mesh.cell_data["flux"] = points, points[cells].mean(axis=1)
    mesh.cell_data["id"] = np.arange(len(cells))
    for array in (mesh.GetPointData().GetArray("wind"), mesh.GetCellData().GetArray("flux")):
        for i, name in enumerate("uvw"):
            array.SetComponentName(i, name)
    ids = mesh.GetCellData().GetArray("id")
    ids.SetLookupTable(vtkLookupTable())
    ids.GetLookupTable().SetNumberOfTableValues(7)
    for i in range(7):
        ids.GetLookupTable().SetTableValue(i, 0.7, 0.8, 0.9)
    mesh.GetCellData().SetPedigreeIds(ids)
    out = verb(mesh)
    assert (out.n_points, out.n_cells) != (mesh.n_points, mesh.n_cells)
    for array in (out.GetPointData().GetArray("wind"), out.GetCellData().GetArray("flux")):
        assert [array.GetComponentName(i) for i in range(3)] == ["u", "v", "w"]
    table = out.GetCellData().GetArray("id").GetLookupTable()
    table.SetTableValue(0, 0.1, 0.2, 0.3)
    assert ids.GetLookupTable().GetNumberOfTableValues() == 7
    assert ids.GetLookupTable().GetTableValue(0) == table.GetTableValue(1)
    assert out.GetCellData().GetPedigreeIds().GetName() == "id"
    assert np.abs(out.point_data["wind"] - out.points).max() < 1e-12


@pytest.mark.parametrize("wrapped", [False, True])
@pytest.mark.parametrize("where", ["Point", "Cell"])
def test_arrays_that_are_too_short_or_of_variants_are_refused(where, wrapped):
    pyvista = pytest.importorskip("pyvista")
    from vtkmodules.vtkCommonCore import vtkDoubleArray, vtkVariantArray

    points, cells, _ = contract.grid(3, 3)
    for kind, error, told in ((vtkDoubleArray, InvalidMeshError, r"'wind' has 7 entries for \d+"),
                              (vtkVariantArray, UnsupportedMeshError, "'wind' in a vtkVariantAr")):
        mesh, array = with_two_texts(points, cells), kind()
        array.SetName("wind")
        array.SetNumberOfTuples(7)
        getattr(mesh, f"Get{where}Data")().AddArray(array)
        for verb in (odt_plugins.optimize, odt_plugins.quality):
            with pytest.raises(error, match=f"{where.lower()} data {told}"):
                verb(pyvista.UnstructuredGrid(mesh) if wrapped else mesh)


def test_arrays_without_a_name_are_lost_whatever_they_hold():
    from vtkmodules.vtkCommonCore import vtkVariantArray

    points, cells, _ = contract.grid(3, 3)
    mesh, array = with_two_texts(points, cells), vtkVariantArray()
    array.SetNumberOfTuples(7)
    mesh.GetCellData().AddArray(array)
    out = odt_plugins.optimize(mesh)
    assert out.GetCellData().GetNumberOfArrays() == 1
