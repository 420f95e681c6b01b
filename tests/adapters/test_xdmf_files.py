"""XDMF files: steps of time, tags and all else of the XML stay, as VTK, h5py and meshio read it."""

from __future__ import annotations

import os
import re

import h5py
import meshio
import numpy as np
import pytest
from contract import grid
from xdmf_series import HEAD, item, series

from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file
from odt_plugins.cli.main import main
from odt_plugins.errors import DataNotKeptWarning, MeshFileError


def by_vtk(path, time):
    """Points, and the arrays of points and cells, at a time as VTK reads them."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOXdmf2 import vtkXdmfReader

    reader = vtkXdmfReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    reader.UpdateTimeStep(time)
    out = reader.GetOutputDataObject(0)
    grids = {}
    for k in range(out.GetNumberOfBlocks()):
        grid, name = out.GetBlock(k), out.GetMetaData(k).Get(out.NAME())
        arrays = {}
        for data in (grid.GetPointData(), grid.GetCellData()):
            for i in range(data.GetNumberOfArrays()):
                arrays[data.GetArrayName(i)] = vtk_to_numpy(data.GetArray(i))
        grids[name] = vtk_to_numpy(grid.GetPoints().GetData()), grid.GetNumberOfCells(), arrays
    return grids


def skeleton(path):
    """Text of the XML without the numbers in it and the names of its companions."""
    text = re.sub(r">[^<]*</DataItem>", "></DataItem>", path.read_text())
    return re.sub(r'(NumberOfElements|Dimensions)="[\d ]*"', "", text)


@pytest.mark.parametrize("form", ["HDF", "XML", "Binary"])
@pytest.mark.parametrize("dim", [2, 3])
def test_steps_and_tags_come_back_and_the_rest_of_the_xml_stays(form, dim, tmp_path):
    path, points, cells, facets, _ = series(tmp_path, form, dim)
    target = tmp_path / "out" / "result.xdmf"
    target.parent.mkdir()
    optimize_file(path, target, insert=dim == 3)
    assert skeleton(target) == skeleton(path).replace("flow", "result")
    back = read_file(target)
    main, facet = ("triangle", "line") if dim == 2 else ("tetra", "triangle")
    assert set(back.point_data) == {"u[0]", "u[1]"}
    assert set(back.cell_data) == {"p[0]", "p[1]", "cell_tags", "facet_tags"}
    assert (len(back.points) != len(points)) == (dim == 3)
    assert (len(back.cells[0].data) != len(cells)) == (dim == 3)
    for k in (0, 1):
        np.testing.assert_allclose(back.point_data[f"u[{k}]"][:, 0], back.points[:, 0] * (k + 1),
                                   rtol=0, atol=1e-12)
        assert (back.cell_data_dict[f"p[{k}]"][main] == np.float32(k + 0.5)).all()
    tags = (back.points[back.cells_dict[main]].mean(axis=1)[:, 0] > 0.5) + 1
    assert np.array_equal(back.cell_data_dict["cell_tags"][main], tags)
    assert (back.points[back.cells_dict[facet]][:, :, 0] == 0.5).all()
    assert np.array_equal(back.points[back.cells_dict[facet]], points[facets])
    assert set(back.cell_data_dict["facet_tags"][facet]) == {7}
    assert all(part.name.startswith("result") for part in target.parent.iterdir())


def test_vtk_reads_the_same_grids_times_and_arrays(tmp_path):
    pytest.importorskip("vtkmodules")
    path, *_ = series(tmp_path)
    optimize_file(path, tmp_path / "out.xdmf")
    was, now = by_vtk(path, 0.125), by_vtk(tmp_path / "out.xdmf", 0.125)
    assert list(was) == list(now) == ["mesh", "cell_tags", "facet_tags", "u"]
    for name in was:
        assert was[name][1] == now[name][1]
        assert list(was[name][2]) == list(now[name][2])
        assert {k: v.dtype for k, v in was[name][2].items()} == {
            k: v.dtype for k, v in now[name][2].items()}
        assert not np.array_equal(was[name][0], now[name][0])
    np.testing.assert_allclose(now["u"][2]["u"].ravel(), 2 * now["u"][0][:, 0], atol=1e-12)


def test_data_keep_types_filters_attributes_and_what_the_xml_does_not_name(tmp_path):
    path, *_ = series(tmp_path, dim=3)
    with h5py.File(tmp_path / "flow.h5", "a") as file:
        file["left/alone"] = np.arange(4)
        was = {name: (file[name].dtype, file[name].compression) for name in file if name != "left"}
    optimize_file(path, tmp_path / "out.xdmf", insert=True)
    with h5py.File(tmp_path / "out.h5") as file:
        assert np.array_equal(file["left/alone"], np.arange(4))
        assert {n: (file[n].dtype, file[n].compression) for n in file if n != "left"} == was
        assert all(file[name].attrs["unit"] == "m" for name in was)


@pytest.mark.parametrize("form", ["HDF", "XML", "Binary"])
def test_what_did_not_change_is_the_same_byte_for_byte(form, tmp_path):
    path, *_ = series(tmp_path, form)
    (tmp_path / "out").mkdir()
    write_file(tmp_path / "out" / path.name, read_file(path))
    for part in (tmp_path / "out").iterdir():
        assert part.read_bytes() == (tmp_path / part.name).read_bytes()
    assert len(list((tmp_path / "out").iterdir())) == len(list(tmp_path.iterdir())) - 1


def test_series_that_meshio_writes(tmp_path):
    points, cells, _ = grid(3, 4, 1)
    here = os.getcwd()
    os.chdir(tmp_path)
    try:
        with meshio.xdmf.TimeSeriesWriter("a.xdmf") as writer:
            writer.write_points_cells(points, [("tetra", cells)])
            for k in range(3):
                writer.write_data(0.1 * k, point_data={"h": points[:, 1] + k})
    finally:
        os.chdir(here)
    optimize_file(tmp_path / "a.xdmf", tmp_path / "b.xdmf", insert=True)
    os.chdir(tmp_path)
    try:
        with meshio.xdmf.TimeSeriesReader("b.xdmf") as reader:
            places, blocks = reader.read_points_cells()
            assert sum(len(block.data) for block in blocks) > 0
            for k in range(reader.num_steps):
                time, data, _ = reader.read_data(k)
                assert time == pytest.approx(0.1 * k)
                np.testing.assert_allclose(data["h"], places[:, 1] + k, atol=1e-12)
    finally:
        os.chdir(here)


def test_mixed_cells_and_parts_of_arrays(tmp_path):
    points, cells, _ = grid(2, 5, 2)
    rim = np.array([[0, 1], [1, 2]])
    mixed = np.concatenate([np.c_[np.full(2, 2), np.full(2, 2), rim].ravel(),
                            np.c_[np.full(len(cells), 4), cells].ravel()])
    both = np.stack([points[:, 0], points[:, 1]])
    n = len(points)
    (tmp_path / "a.xdmf").write_text(f"""{HEAD}<Domain><Grid Name="g">
<Geometry GeometryType="XY">{item("XML", points, "x", "a", tmp_path)}</Geometry>
<Topology TopologyType="Mixed" NumberOfElements="{len(cells) + 2}">
{item("XML", mixed, "c", "a", tmp_path)}</Topology>
<Attribute Name="y" Center="Node"><DataItem ItemType="HyperSlab" Dimensions="{n}">
<DataItem Dimensions="3 2" NumberType="Int" Format="XML">1 0 1 1 1 {n}</DataItem>
{item("HDF", both, "both", "a", tmp_path)}</DataItem></Attribute></Grid></Domain></Xdmf>""")
    optimize_file(tmp_path / "a.xdmf", tmp_path / "b.xdmf")
    back = read_file(tmp_path / "b.xdmf")
    assert [(b.type, len(b.data)) for b in back.cells] == [("line", 2), ("triangle", len(cells))]
    np.testing.assert_allclose(back.point_data["y"], back.points[:, 1], atol=1e-12)
    assert not np.array_equal(back.points, points)
    with h5py.File(tmp_path / "b.h5") as file:
        assert np.array_equal(file["both"][0], points[:, 0])
        assert not np.array_equal(file["both"][1], points[:, 1])


def test_grids_of_other_meshes_are_refused_by_name(tmp_path):
    path, points, cells, *_ = series(tmp_path, "XML")
    text = path.read_text()
    moved = item("XML", points + 1, "x", "a", tmp_path)
    for old, new, said in (
        ('<xi:include xpointer="xpointer(/Xdmf/Domain/Grid/Geometry)" />',
         f'<Geometry GeometryType="XY">{moved}</Geometry>',
         r"grids 'mesh' and 'cell_tags' have different points.*try a file for each"),
        (item("XML", cells, "c", "a", tmp_path), item("XML", cells[:-1], "c", "a", tmp_path),
         r"grids 'mesh' and 'cell_tags' have different cells.*try a file for each"),
    ):
        (tmp_path / "b.xdmf").write_text(text.replace(old, new, 1))
        with pytest.raises(MeshFileError, match=said):
            read_file(tmp_path / "b.xdmf")


def test_parts_that_are_missing_or_short_are_named(tmp_path):
    path, *_ = series(tmp_path)
    with h5py.File(tmp_path / "flow.h5", "a") as file:
        del file["u1"]
    with pytest.raises(MeshFileError, match=r"flow\.h5 has no data at /u1"):
        read_file(path)
    data = (tmp_path / "flow.h5").read_bytes()
    (tmp_path / "flow.h5").write_bytes(data[: len(data) // 2])
    with pytest.raises(MeshFileError, match=r"flow\.h5 is incomplete.*expected a complete file"):
        read_file(path)
    (tmp_path / "flow.h5").unlink()
    with pytest.raises(MeshFileError, match=r"flow\.h5, which is missing; expected that file, too"):
        read_file(path)
    path.write_text(path.read_text()[:-40])
    with pytest.raises(MeshFileError, match=r"its XML ends or breaks.*expected a complete file"):
        read_file(path)


@pytest.mark.parametrize("suffix", [".xdmf", ".h5"])
def test_an_xdmf_file_or_its_data_that_are_cut_write_nothing(suffix, tmp_path, capsys):
    path, *_ = series(tmp_path)
    part = path.with_suffix(suffix)
    data = part.read_bytes()
    part.write_bytes(data[: len(data) // 2])
    assert main(["optimize", str(path), str(tmp_path / "out.xdmf")]) == 1
    said = capsys.readouterr().err
    assert said.rstrip().endswith("expected a complete file")
    assert len(said.splitlines()) == 1
    assert sorted(part.name for part in tmp_path.iterdir()) == ["flow.h5", "flow.xdmf"]


def with_sets(folder, form, dim):
    """A series whose mesh has a set of points, one of cells, and what else is asked for."""
    path, points, cells, *_ = series(folder, form, dim)
    middle = np.flatnonzero(points[:, 0] == 0.5)[::-1].copy()
    right = np.flatnonzero(points[cells].mean(axis=1)[:, 0] > 0.5)[::-1].copy()
    sets = [f'<Set Name="{name}" SetType="{kind}">\n{item(form, rows, name, "flow", folder)}</Set>'
            for name, kind, rows in (("middle", "Node", middle), ("right", "Cell", right))]
    path.write_text(path.read_text().replace('<Information Name="unit"', "\n".join(
        [*sets, '<Information Name="unit"']), 1))
    return path, points, middle, right


@pytest.mark.parametrize(("form", "dim"), [("HDF", 3), ("XML", 2), ("XML", 3)])
def test_sets_of_points_and_cells_come_along(form, dim, tmp_path):
    path, points, middle, right = with_sets(tmp_path, form, dim)
    mesh = read_file(path)
    assert np.array_equal(mesh.point_sets["middle"], middle)
    assert np.array_equal(mesh.cell_sets["right"][0], np.sort(right))
    target = tmp_path / "out" / "result.xdmf"
    target.parent.mkdir()
    optimize_file(path, target, insert=dim == 3)
    assert skeleton(target) == skeleton(path).replace("flow", "result")
    back = read_file(target)
    rows = back.cells[0].data
    assert (len(rows) != len(mesh.cells[0].data)) == (dim == 3)
    there = np.flatnonzero(back.points[rows].mean(axis=1)[:, 0] > 0.5)
    assert np.array_equal(back.cell_sets["right"][0], there)
    assert np.array_equal(back.points[back.point_sets["middle"]], points[middle])
    with pytest.warns(DataNotKeptWarning, match=r"the information unit, the times of its steps"):
        write_file(tmp_path / "b.inp", mesh)
    assert {"right"} <= {*read_file(tmp_path / "b.inp").cell_sets}


def test_other_sets_and_data_without_a_place_in_the_xml_are_named(tmp_path):
    path, *_ = series(tmp_path)
    pair = "".join(item("XML", np.array([0, 3]), "", "", tmp_path) for _ in range(2))
    path.write_text(path.read_text().replace(
        '<Information Name="unit"', f'<Set Name="rim" SetType="Face">{pair}</Set>\n'
        '<Information Name="unit"', 1))
    with h5py.File(tmp_path / "flow.h5", "a") as file:
        file["left/alone"] = np.arange(4)
    with pytest.warns(DataNotKeptWarning, match="'rim', set of each face, is not read"):
        mesh = read_file(path)
    with pytest.warns(DataNotKeptWarning, match="the data left/alone of flow.h5, which its XML"):
        write_file(tmp_path / "a.vtu", mesh)
    path.write_text(path.read_text().replace("Face", "Cell").replace(pair, pair[: len(pair) // 2]))
    text = path.read_text()
    path.write_text(text.replace("\n0\n3\n", "\n0\n999\n"))
    with pytest.raises(MeshFileError, match="its set 'rim' refers to cell 999 of"):
        read_file(path)
