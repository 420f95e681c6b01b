"""Gmsh's files and what becomes of them in other formats; files that only their own tool reads."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import contract
import meshio
import numpy as np
import pytest
from click.testing import CliRunner
from format_table import SUFFIXES, mesh_of_everything, table

import odt_plugins
from odt_plugins.adapters import files, gmsh_files, netgen_files
from odt_plugins.cli.main import cli
from odt_plugins.errors import DataNotKeptWarning, InvalidOptionError, MeshFileError

PAGE = Path(odt_plugins.__file__).parent / "adapters" / "README.md"
START, END = "<!-- formats: start -->\n", "\n<!-- formats: end -->"


def test_the_table_of_formats_is_what_they_keep(tmp_path):
    page = PAGE.read_text(encoding="utf-8")
    assert page.partition(START)[2].partition(END)[0] == table(tmp_path)


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """Three boxes with named groups, meshed by Gmsh: a folder of files by their names."""
    gmsh = pytest.importorskip("gmsh")
    folder = tmp_path_factory.mktemp("gmsh")
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        occ = gmsh.model.occ
        boxes = [occ.addBox(*corner, 1, 1, 1) for corner in ((0, 0, 0), (1, 0, 0), (0, 1, 0))]
        occ.fragment([(3, boxes[0])], [(3, box) for box in boxes[1:]])
        occ.synchronize()
        gmsh.model.addPhysicalGroup(3, [1], 7, "steel")
        gmsh.model.addPhysicalGroup(3, [2, 3], 9, "rubber")
        gmsh.model.addPhysicalGroup(2, [1], 3, "bottom")
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
        gmsh.model.mesh.generate(3)

        def store(name, version=4.1, binary=0, everything=0):
            for option, value in (("MshFileVersion", version), ("Binary", binary),
                                  ("SaveAll", everything)):
                gmsh.option.setNumber(f"Mesh.{option}", value)
            gmsh.write(str(folder / name))

        store("22.msh", 2.2)
        # Version 2.2 has the cells of two groups twice.
        gmsh.model.addPhysicalGroup(3, [1, 2, 3], 11, "all")
        store("41.msh")
        store("41binary.msh", binary=1)
        store("40.msh", 4.0)
        store("all.msh", everything=1)
        store("mesh.bdf")
        view = gmsh.view.add("stress")
        tags = gmsh.model.mesh.getElementsByType(4)[0]
        gmsh.view.addModelData(view, 0, gmsh.model.getCurrent(), "ElementData", tags[:10],
                               [[float(k)] for k in range(10)])
        for version in (22, 41):
            store(f"data{version}.msh", version / 10)
            gmsh.option.setNumber("PostProcessing.SaveMesh", 0)
            gmsh.view.write(view, str(folder / f"data{version}.msh"), append=True)
        gmsh.model.mesh.partition(3)
        store("parts.msh")
    finally:
        gmsh.finalize()
    return folder


def _groups(path):
    """Physical groups with their names and numbers of tetrahedra, as Gmsh itself reads them."""
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(path))
        mesh = gmsh.model.mesh
        return {
            (dim, tag, gmsh.model.getPhysicalName(dim, tag)): sum(
                len(part) for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag)
                for part in mesh.getElements(dim, entity)[1])
            for dim, tag in gmsh.model.getPhysicalGroups()}
    finally:
        gmsh.finalize()


@pytest.mark.parametrize("name", ["41.msh", "41binary.msh", "all.msh", "parts.msh"])
@pytest.mark.parametrize("changed", [False, True], ids=["as read", "optimised"])
def test_files_of_several_volumes_keep_their_groups(name, changed, model, tmp_path):
    target = tmp_path / "out.msh"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if changed:
            odt_plugins.optimize(model / name, target=target, finish=False,
                                 smoothing={"rounds": 1, "connectivity": "none"})
        else:
            files.write_file(target, files.read_file(model / name))
    assert _groups(target) == _groups(model / name)
    before, after = (files.read_file(path) for path in (model / name, target))
    assert set(before.cell_data) == set(after.cell_data)
    head = [path.read_bytes().split(b"\n")[1] for path in (model / name, target)]
    assert head[0] == head[1]


def test_parts_of_a_partition_are_joined(model):
    mesh, whole = (files.read_file(model / name) for name in ("parts.msh", "41.msh"))
    tets = [block for block in mesh.cells if block.type == "tetra"]
    assert len(tets) == 3
    assert sum(len(b.data) for b in tets) == sum(
        len(b.data) for b in whole.cells if b.type == "tetra")
    parts = np.concatenate(mesh.cell_data["gmsh:partition"])
    assert set(parts.tolist()) == {1, 2, 3}


def test_a_partition_that_is_no_longer_told_by_entities_is_named(model, tmp_path):
    mesh = files.read_file(model / "parts.msh")
    with pytest.warns(DataNotKeptWarning, match="the section PartitionedEntities, of which cells"):
        files.write_file(tmp_path / "parts.vtu", mesh)
    assert "gmsh:partition" in meshio.read(tmp_path / "parts.vtu").cell_data


def test_the_version_and_the_kind_of_a_file_can_be_asked_for(model, tmp_path):
    quick = ["--smoothing", "rounds=1", "--no-finish", "--quiet"]
    for flags, line in (([], b"4.1 0 8"), (["--binary"], b"4.1 1 8"),
                        (["--file-format", "gmsh22"], b"2.2 0 8"),
                        (["--file-format", "gmsh22", "--binary"], b"2.2 1 8")):
        target = tmp_path / "out.msh"
        done = CliRunner().invoke(cli, ["optimize", str(model / "41.msh"), str(target), *quick,
                                        *flags])
        assert done.exit_code == 0, done.output
        assert target.read_bytes().split(b"\n")[1] == line
    odt_plugins.optimize(model / "22.msh", target=tmp_path / "out.msh", smoothing={"rounds": 1},
                              finish=False,
                              file_format="gmsh41", binary=True)
    assert (tmp_path / "out.msh").read_bytes().split(b"\n")[1] == b"4.1 1 8"
    assert {key for key in _groups(tmp_path / "out.msh") if key[0] == 2} == {(2, 3, "bottom")}
    odt_plugins.optimize(model / "22.msh", target=tmp_path / "out.vtu", smoothing={"rounds": 1},
                              finish=False,
                              binary=False)
    assert b'format="ascii"' in (tmp_path / "out.vtu").read_bytes()
    for name, given, message in (
            ("out.vtu", {"file_format": "gmsh22"}, r"got file_format='gmsh22' for out\.vtu"),
            ("out.msh", {"file_format": "gmsh"}, r"one of gmsh22, gmsh41"),
            ("out.mesh", {"binary": True}, r"got binary files for out\.mesh; expected no choice")):
        with pytest.raises(InvalidOptionError, match=message):
            odt_plugins.optimize(model / "22.msh", target=tmp_path / name, **given)


@pytest.mark.parametrize("suffix", [*SUFFIXES, ".ugrid"])
def test_groups_go_into_every_format_and_one_warning_says_what_is_lost(suffix, tmp_path):
    mesh = mesh_of_everything()
    old = mesh.copy()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        files.write_file(tmp_path / f"out{suffix}", mesh)
    said = [str(w.message) for w in caught]
    assert len(said) <= 1
    assert not [text for text in said if "gmsh:dim_tags" in text or "bounding" in text]
    back = files.read_file(tmp_path / f"out{suffix}")
    tets = np.concatenate([b.data for b in back.cells if b.type == "tetra"])
    assert len(tets) == sum(len(b.data) for b in old.cells if b.type == "tetra")
    assert not [name for name in back.cell_data if "-" in name]
    for kind in ("point_data", "cell_data", "field_data", "cell_sets"):
        assert sorted(getattr(mesh, kind)) == sorted(getattr(old, kind))


@pytest.mark.parametrize("suffix", [".vtu", ".vtk"])
def test_named_groups_stay_in_files_of_vtk(suffix, tmp_path):
    pytest.importorskip("vtkmodules")
    mesh = mesh_of_everything()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        files.write_file(tmp_path / f"out{suffix}", mesh)
    back = files.read_file(tmp_path / f"out{suffix}")
    assert sorted(back.cell_data) == ["gmsh:geometrical", "gmsh:physical", "stress"]
    for name, value in mesh.field_data.items():
        assert np.array_equal(back.field_data[name], value)
    files.write_file(tmp_path / "again.msh", back)
    again = files.read_file(tmp_path / "again.msh")
    assert sorted(again.field_data) == sorted(mesh.field_data)


@pytest.mark.parametrize("name", ["data22.msh", "data41.msh"])
def test_data_of_some_elements_are_read(name, model):
    mesh = files.read_file(model / name)
    stress = np.concatenate([values for block, values in
                             zip(mesh.cells, mesh.cell_data["stress"], strict=True)
                             if block.type == "tetra"])
    assert np.array_equal(np.sort(stress[~np.isnan(stress)]), np.arange(10.0))
    assert len(stress) > 10


@pytest.mark.parametrize("name", ["40.msh", "mesh.bdf"])
def test_files_that_meshio_does_not_know_are_read(name, model, monkeypatch):
    mesh, whole = files.read_file(model / name), files.read_file(model / "41.msh")
    assert np.array_equal(np.unique(np.round(mesh.points, 6), axis=0),
                          np.unique(np.round(whole.points, 6), axis=0))
    label = "nastran:ref" if name == "mesh.bdf" else "gmsh:physical"
    assert len(np.unique(np.concatenate(mesh.cell_data[label]))) > 1
    monkeypatch.setattr("odt_plugins.adapters.reading.MORE", {})
    monkeypatch.setattr(gmsh_files, "translate", lambda *_: pytest.fail("it was read by Gmsh"))
    if name == "mesh.bdf":
        assert len(files.read_file(model / name).points) == len(mesh.points)


def test_files_of_netgen_are_read_by_netgen(tmp_path):
    pytest.importorskip("netgen")
    from netgen.csg import CSGeometry, OrthoBrick, Pnt

    geometry = CSGeometry()
    one = OrthoBrick(Pnt(0, 0, 0), Pnt(1, 1, 1)).bc("wall").mat("steel")
    two = OrthoBrick(Pnt(1, 0, 0), Pnt(2, 1, 1)).mat("rubber")
    geometry.Add(one)
    geometry.Add(two - one)
    mesh = geometry.GenerateMesh(maxh=0.5, optsteps3d=0)
    mesh.Save(str(tmp_path / "in.vol"))
    here = Path.cwd()
    read = files.read_file(tmp_path / "in.vol")
    assert Path.cwd() == here
    sizes = [len(block.data) for block in read.cells]
    assert [*sizes[:2], sum(sizes[2:])] == [
        len(mesh.Elements2D()), mesh.ne, len(mesh.Elements1D())]
    assert set(read.cell_data["netgen:index"][1].tolist()) == {1, 2}
    assert read.field_data["rubber"].tolist() == [2, 3]
    volume = np.abs(contract.volumes(read.points, read.cells[1].data)).sum() / 6
    assert volume == pytest.approx(2.0)
    odt_plugins.optimize(tmp_path / "in.vol", target=tmp_path / "out.vol")
    assert netgen_files.installed()


def test_plain_arrays_are_written_for_gmsh_without_a_word(tmp_path):
    points, cells, _ = contract.grid(3, 2)
    for number, file_format in enumerate((None, "gmsh22", "gmsh41")):
        path = tmp_path / f"{number}.msh"
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            files.write_file(path, meshio.Mesh(points, [("tetra", cells)]), file_format)
        mesh = files.read_file(path)
        assert np.array_equal(mesh.points, points)
        assert np.array_equal(mesh.cells[0].data, cells)


@pytest.mark.parametrize("suffix", [".ele", ".f3grid"])
def test_formats_of_tetrahedra_refuse_triangles_in_words(suffix, tmp_path):
    points, cells, _ = contract.grid(2, 2)
    with pytest.raises(MeshFileError, match=r": it holds no cells of type triangle; try another"):
        files.write_arrays(tmp_path / f"out{suffix}", points, cells)
    assert not list(tmp_path.iterdir())


def test_planar_arrays_are_written_for_su2(tmp_path):
    points, cells, _ = contract.grid(2, 2)
    files.write_arrays(tmp_path / "out.su2", points, cells)
    mesh = files.read_file(tmp_path / "out.su2")
    assert np.array_equal(mesh.points, points)
    assert np.array_equal(mesh.cells[0].data, cells)


def test_cells_that_a_format_does_not_hold_are_counted(tmp_path):
    mesh = mesh_of_everything()
    count = sum(len(block.data) for block in mesh.cells if block.type == "triangle")
    message = rf"does not keep {count} cells of type triangle, .*the names of the groups 'inside'"
    with pytest.warns(DataNotKeptWarning, match=message):
        files.write_file(tmp_path / "out.xml", mesh)


@pytest.mark.parametrize("text", [True, False])
def test_damaged_files_of_version_41_are_refused(text, model, tmp_path):
    whole = (model / ("41.msh" if text else "41binary.msh")).read_bytes()
    path = tmp_path / "in.msh"
    refused = 0
    for end in np.linspace(20, len(whole) - 30, 25).astype(int):
        path.write_bytes(whole[:end])
        with pytest.raises(MeshFileError) as caught:
            files.read_file(path)
        refused += "\n" not in str(caught.value)
    assert refused == 25
    if text:
        path.write_bytes(re.sub(rb"(\$Elements\n.*\n.*\n\d+ )\d+", rb"\g<1>99999", whole, count=1))
        with pytest.raises(MeshFileError, match="it refers to node 99999, which is not there"):
            files.read_file(path)


def test_labels_of_cells_of_several_types_are_read_by_meshio_and_gmsh(tmp_path):
    gmsh = pytest.importorskip("gmsh")
    points, cells, labels = contract.grid(3, 3)
    below = points[:, 2] == points[:, 2].min()
    sides = np.concatenate([np.delete(cells, k, axis=1) for k in range(4)])
    sides = sides[below[sides].all(axis=1)]
    meshio.write(tmp_path / "a.mesh", meshio.Mesh(
        points, [("triangle", sides), ("tetra", cells)],
        cell_data={"medit:ref": [np.full(len(sides), 7), labels + 3]}))
    odt_plugins.optimize(tmp_path / "a.mesh", target=tmp_path / "b.msh")
    told = meshio.read(tmp_path / "b.msh")
    for kind, one in (("triangle", np.full(len(sides), 7)), ("tetra", labels + 3)):
        values = [part for block, part in zip(told.cells, told.cell_data["medit:ref"], strict=True)
                  if block.type == kind]
        assert np.array_equal(np.unique(np.concatenate(values)), np.unique(one))
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(tmp_path / "b.msh"))
        views = [gmsh.view.getModelData(view, 0) for view in gmsh.view.getTags()]
        (tags, values), = ((view[1], view[2]) for view in views if view[0] == "ElementData")
        _, own, _ = gmsh.model.mesh.getElements(2)
        flat = [value[0] for tag, value in zip(tags, values, strict=True) if tag in {*own[0]}]
        assert flat == [7] * len(sides)
    finally:
        gmsh.finalize()
    files.write_file(tmp_path / "c.msh", files.read_file(tmp_path / "a.mesh"), "gmsh22")
    assert (tmp_path / "c.msh").read_bytes().startswith(b"$MeshFormat\n2.2")


@pytest.mark.parametrize("binary", [True, False])
def test_values_at_nodes_written_anew_are_right_for_readers_that_go_by_the_order(binary, tmp_path):
    """meshio gave them to other nodes, since those of one entity stand together in the file."""
    points, cells, labels = contract.grid(3, 3)
    sides = np.concatenate([np.delete(cells, k, axis=1) for k in range(4)])
    sides = sides[(points[sides][:, :, 2] == points[:, 2].max()).all(axis=1)]
    pairs = np.array([[len(points) - 1, 0], [len(points) - 2, 1]])
    mesh = meshio.Mesh(points, [("tetra", cells), ("triangle", sides)],
                       point_data={"height": points @ [1.0, 2.0, 3.0]},
                       cell_data={"gmsh:physical": [labels + 1, np.full(len(sides), 9)],
                                  "x": [points[c].mean(axis=1)[:, 0] for c in (cells, sides)]},
                       gmsh_periodic=[[2, (1, 1), None, pairs]])
    files.write_file(tmp_path / "a.msh", mesh, binary=binary)
    told = meshio.read(tmp_path / "a.msh")
    assert np.allclose(told.point_data["height"].ravel(), told.points @ [1.0, 2.0, 3.0])
    for block, values in zip(told.cells, told.cell_data["x"], strict=True):
        assert np.allclose(values.ravel(), told.points[block.data].mean(axis=1)[:, 0])
    assert np.array_equal(told.points[told.gmsh_periodic[0][3]], points[pairs])
