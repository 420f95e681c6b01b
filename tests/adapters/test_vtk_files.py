"""Files of VTK: read and written by VTK, all arrays in their types, and read by another reader."""

from __future__ import annotations

import contract
import meshio
import numpy as np
import pytest
import surface_meshes
from scipy.spatial import Delaunay

import odt_plugins
from odt_plugins.adapters import apart, files, legacy, reading, vtk_files
from odt_plugins.errors import DataNotKeptWarning, MeshFileError, MissingDependencyError

pyvista = pytest.importorskip("pyvista")

TYPES = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32",
         "float64")


def _grid():
    """Tetrahedra among triangles of the boundary, with arrays of all types."""
    points, cells, labels = contract.grid(3, 4)
    skin = sorted(contract.facets(cells, np.zeros(len(cells), int)))[:30]
    rows = [[4, *cells[0]], *([3, *face] for face in skin), *([4, *cell] for cell in cells[1:])]
    types = [10] + len(skin) * [5] + (len(cells) - 1) * [10]
    mesh = pyvista.UnstructuredGrid(np.concatenate(rows), types, points)
    for name in TYPES:
        mesh.cell_data[f"cell {name}"] = np.arange(len(types)).astype(name)
        mesh.cell_data[f"three_{name}"] = np.arange(3 * len(types)).reshape(-1, 3).astype(name)
        # A constant, which is the same at the new places of the vertices.
        mesh.point_data[f"point_{name}"] = np.full(len(points), 7).astype(name)
    mesh.cell_data["name"] = np.array([f"cell {i}" for i in range(len(types))])
    mesh.cell_data["marker"] = np.array([labels[0], *len(skin) * [0], *labels[1:]], np.uint8)
    mesh.field_data["steel"] = np.array([249, 3])
    return mesh


@pytest.mark.parametrize("binary", [True, False], ids=["binary", "text"])
def test_meshio_reads_integers_of_64_bits_in_legacy_files(binary, tmp_path):
    points, cells, labels = contract.grid(3, 4)
    mesh = meshio.Mesh(points, [("tetra", cells)], {"id": np.arange(len(points))},
                       {"marker": [labels.astype(np.int64)], "u": [labels.astype(np.uint64)]})
    mesh.write(tmp_path / "in.vtk", binary=binary)
    odt_plugins.optimize(tmp_path / "in.vtk", target=tmp_path / "out.vtk")
    out = meshio.read(tmp_path / "out.vtk")
    assert np.array_equal(out.point_data["id"], np.arange(len(points)))
    for name, values in mesh.cell_data.items():
        assert out.cell_data[name][0].dtype.newbyteorder("=") == values[0].dtype
        assert np.array_equal(np.unique(out.cell_data[name][0]), np.unique(values[0]))


@pytest.mark.parametrize("binary", [True, False], ids=["binary", "text"])
@pytest.mark.parametrize("suffix", [".vtk", ".vtu"])
def test_all_arrays_of_a_grid_come_back_in_their_types(suffix, binary, tmp_path):
    mesh = _grid()
    mesh.save(tmp_path / f"in{suffix}", binary=binary)
    odt_plugins.optimize(tmp_path / f"in{suffix}", target=tmp_path / f"out{suffix}",
                              smoothing={"rounds": 1, "connectivity": "none"}, finish=False)
    out = pyvista.read(tmp_path / f"out{suffix}")
    # Cells of one type come together.
    order = np.argsort(mesh.celltypes != 10, kind="stable")
    assert np.array_equal(out.celltypes, mesh.celltypes[order])
    for name in mesh.point_data:
        assert out.point_data[name].dtype == mesh.point_data[name].dtype, name
        assert np.array_equal(out.point_data[name], mesh.point_data[name]), name
    for name in mesh.cell_data:
        assert out.cell_data[name].dtype == mesh.cell_data[name].dtype, name
        assert np.array_equal(out.cell_data[name], mesh.cell_data[name][order]), name
    assert np.array_equal(out.field_data["steel"], [249, 3])
    assert not np.array_equal(out.points, mesh.points)


def test_polydata_come_back_with_new_normals(tmp_path):
    points, cells = surface_meshes.bowl(8, 0.3)
    mesh = pyvista.PolyData.from_regular_faces(points, cells).compute_normals(
        cell_normals=True, point_normals=True, split_vertices=False, auto_orient_normals=False)
    for data in (mesh.cell_data, mesh.point_data):
        data["Normals"] = np.tile([0.0, 0.8, 0.6], (len(data["Normals"]), 1))
    mesh["part"] = (np.arange(len(cells)) % 2).astype(np.uint8)
    mesh.save(tmp_path / "in.vtp")
    odt_plugins.optimize(tmp_path / "in.vtp", target=tmp_path / "out.vtp", regions=None)
    out = pyvista.read(tmp_path / "out.vtp")
    assert type(out) is pyvista.PolyData
    assert out["part"].dtype == np.uint8
    fresh = out.compute_normals(split_vertices=False, auto_orient_normals=False,
                                consistent_normals=False)
    for data, exact in ((out.cell_data, fresh.cell_data), (out.point_data, fresh.point_data)):
        cosine = np.abs((data["Normals"] * exact["Normals"]).sum(axis=1))
        assert cosine.min() > 0.97
    assert not np.array_equal(out.points, points)


def test_polydata_keep_the_order_of_their_parts(tmp_path):
    points, cells = surface_meshes.bowl(4, 0.3)
    mesh = pyvista.PolyData(points, faces=np.column_stack([np.full(len(cells), 3), cells]).ravel(),
                            lines=[3, 0, 1, 2], verts=[1, 5])
    mesh["row"] = np.arange(mesh.n_cells)
    mesh.save(tmp_path / "in.vtp")
    with pytest.warns(DataNotKeptWarning, match="poly-line cells come as line cells"):
        read = files.read_file(tmp_path / "in.vtp")
    files.write_file(tmp_path / "out.vtp", read)
    out = pyvista.read(tmp_path / "out.vtp")
    assert (out.n_verts, out.n_lines) == (1, 2)
    assert out["row"].tolist() == [0, 1, 1, *range(2, mesh.n_cells)]
    with pytest.raises(MeshFileError, match=r"it holds no cells of type tetra"):
        files.write_file(tmp_path / "bad.vtp", contract.file_mesh(".vtu", 3))


def test_vtk_reads_what_is_written_without_it(tmp_path, monkeypatch):
    mesh = contract.file_mesh(".vtk", 3)
    mesh.cell_data["byte"] = [np.arange(len(mesh.cells[0].data)).astype(np.uint8)]
    monkeypatch.setattr(apart, "vtk_installed", lambda: False)
    message = r"the type of cell data 'byte' \(uint8, there int64\), the type of cell data 'marker'"
    with pytest.warns(DataNotKeptWarning, match=message):
        files.write_file(tmp_path / "out.vtk", mesh)
    out = pyvista.read(tmp_path / "out.vtk")
    assert np.array_equal(out.cell_data["byte"], mesh.cell_data["byte"][0])
    with pytest.raises(MissingDependencyError, match="pip install pyvista"):
        files.read_file(tmp_path / "in.vtp")


def test_files_that_only_meshio_reads_are_read_with_a_word(tmp_path):
    mesh = contract.file_mesh(".vtk", 3)
    meshio.write(tmp_path / "old.vtk", mesh)
    message = r"VTK cannot read it, meshio can \(Unsupported data type: vtktypeint32"
    with pytest.warns(DataNotKeptWarning, match=message):
        back = files.read_file(tmp_path / "old.vtk")
    assert np.array_equal(back.cell_data["marker"][0], mesh.cell_data["marker"][0])


@pytest.mark.parametrize("what", ["points", "cells", "point_data", "cell_data"])
@pytest.mark.parametrize("suffix", ["vtk", "vtu"])
def test_a_second_reader_that_sees_something_else_is_heard(suffix, what, tmp_path, monkeypatch):
    mesh = contract.file_mesh(f".{suffix}", 3)
    path = tmp_path / f"out.{suffix}"
    assert vtk_files.write_and_read(path, mesh, suffix)[1] == ""
    right = vtk_files.as_mesh

    def wrong(grid):
        back, said = right(grid)
        part = {"points": back.points, "cells": back.cells[0].data,
                "point_data": back.point_data["temperature"],
                "cell_data": back.cell_data["marker"][0]}[what]
        part[-1] += 1
        return back, said

    monkeypatch.setattr(vtk_files, "as_mesh", wrong)
    monkeypatch.setattr(apart, "call", lambda function, *given, **_: function(*given))
    with pytest.raises(MeshFileError, match=r"meshio and VTK read .* of the file differently"):
        files.write_file(path, mesh)


@pytest.mark.parametrize("binary", [True, False], ids=["binary", "text"])
def test_legacy_files_that_end_within_an_array_are_refused(binary, tmp_path):
    path = tmp_path / "in.vtk"
    mesh = contract.file_mesh(".vtk", 3)
    vtk_files.write_and_read(path, mesh, "vtk", binary)
    whole = path.read_bytes()
    last = whole.rindex(b"velocity")
    for end in np.linspace(last + 30, len(whole) - 20, 9).astype(int):
        path.write_bytes(whole[:end])
        with pytest.raises(MeshFileError, match="it ends within what 'velocity 3 125 float'"):
            legacy.expect_whole(path)
    with pytest.raises(MeshFileError, match="it ends within what 'velocity 3 125 float'"):
        files.read_file(path)


def test_a_crash_or_a_hang_of_vtk_is_a_sentence(tmp_path, monkeypatch):
    path = tmp_path / "in.vtp"
    pyvista.Sphere(theta_resolution=5, phi_resolution=5).save(path)
    (tmp_path / "away").mkdir()
    package = tmp_path / "away" / "vtkmodules"
    package.mkdir()
    monkeypatch.syspath_prepend(tmp_path / "away")
    apart._staying.cache_clear()
    (package / "__init__.py").write_text("import os\nos.kill(os.getpid(), 11)\n")
    with pytest.raises(MeshFileError, match=r"in\.vtp as vtp: its process was ended by SIGSEGV"):
        files.read_file(path)
    (package / "__init__.py").write_text("import time\ntime.sleep(60)\n")
    monkeypatch.setattr(reading, "LEAST", 1.0)
    with pytest.raises(MeshFileError, match="it takes longer than"):
        files.read_file(path)


def test_cells_with_other_numbers_of_nodes_than_their_type_has_are_refused(tmp_path):
    rows = np.array([4, 0, 1, 2, 3, 4, 1, 2, 3, 4])
    path = tmp_path / "in.vtu"
    pyvista.UnstructuredGrid(rows, [10, 10], np.eye(5, 3)).save(path, binary=False)
    text = path.read_text()
    start = text.index('Name="offsets"')
    path.write_text(text[:start] + text[start:].replace("4 8", "3 8", 1))
    with pytest.raises(MeshFileError, match="its cell 0 is of type tetra and has 3 nodes"):
        files.read_file(path)


@pytest.mark.parametrize("word", ["NumberOfPoints", "NumberOfPolys"])
def test_counts_of_xml_files_beyond_their_size_are_refused(word, tmp_path, monkeypatch):
    path = tmp_path / "in.vtp"
    pyvista.Sphere(theta_resolution=5, phi_resolution=5).save(path)
    whole = path.read_text(errors="replace")
    start = whole.index(f'{word}="') + len(word) + 2
    path.write_text(whole[:start] + "1000000000000" + whole[whole.index('"', start):])
    monkeypatch.setattr(apart, "call", lambda *_, **__: pytest.fail("it was read"))
    with pytest.raises(MeshFileError, match=f"{word}=\"1000000000000"):
        files.read_file(path)


@pytest.mark.parametrize("suffix", [".vtk", ".vtu"])
def test_values_that_are_no_numbers_are_written(tmp_path, suffix):
    points, cells, _ = contract.grid(3, 1)
    heat = np.where(np.arange(len(cells)) % 2, np.nan, 1.5)
    mesh = meshio.Mesh(points, [("tetra", cells)], cell_data={"heat": [heat]})
    files.write_file(tmp_path / f"a{suffix}", mesh)
    back = files.read_file(tmp_path / f"a{suffix}").cell_data_dict["heat"]["tetra"]
    assert np.array_equal(back, heat, equal_nan=True)


@pytest.mark.parametrize("binary", [True, False])
def test_legacy_files_stay_polydata_and_of_their_version(binary, tmp_path):
    from odt_plugins.api import optimize_file

    ball = pyvista.Sphere(theta_resolution=14, phi_resolution=14)
    points = ball.points + np.random.default_rng(3).normal(0, 0.004, ball.points.shape)
    surface = pyvista.PolyData.from_regular_faces(points, ball.regular_faces)
    surface.cell_data["part"] = np.zeros(surface.n_cells, dtype=np.int32)
    surface.save(tmp_path / "a.vtk", binary=binary)
    optimize_file(tmp_path / "a.vtk", tmp_path / "b.vtk")
    back = pyvista.read(tmp_path / "b.vtk")
    assert isinstance(back, pyvista.PolyData)
    assert back.array_names == ["part"]
    old = tmp_path / "old.vtk"
    cells = Delaunay(np.random.default_rng(5).random((60, 3))).simplices
    mesh = meshio.Mesh(np.random.default_rng(5).random((60, 3)), [("tetra", cells)])
    meshio.write(old, mesh, file_format="vtk42", binary=binary)
    optimize_file(old, tmp_path / "new.vtk")
    assert (tmp_path / "new.vtk").read_bytes().startswith(b"# vtk DataFile Version 4.2")
    assert len(meshio.read(tmp_path / "new.vtk").points) == 60


@pytest.mark.parametrize("suffix", [".vtm", ".pvtu", ".vtkhdf"])
def test_files_that_pyvista_alone_reads_are_refused_with_what_to_try(suffix, tmp_path):
    pyvista.MultiBlock([pyvista.Sphere()]).save(tmp_path / "a.vtm")
    (tmp_path / "a.vtm").rename(tmp_path / f"a{suffix}")
    with pytest.raises(MeshFileError, match=rf"{suffix} has no suffix .*, try pyvista.read and"):
        files.read_file(tmp_path / f"a{suffix}")


def test_pieces_are_to_share_their_vertices_and_outputs_are_not_to_be_read(tmp_path):
    (tmp_path / "a.pvtu").write_text("<VTKFile/>")
    with pytest.raises(MeshFileError, match=r"its clean\(\) gives, or optimize with an OUTPUT"):
        files.read_file(tmp_path / "a.pvtu")
    with pytest.raises(MeshFileError, match=r"\.xml$"):
        files.check_output(tmp_path / "new.pvtu")
