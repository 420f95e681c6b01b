"""Files of Gmsh with groups that overlap, or have the same name, as Gmsh reads them."""

from __future__ import annotations

import warnings

import meshio
import numpy as np
import pytest
from gmsh_sessions import session

from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.adapters.fitting import named_groups
from odt_plugins.api import optimize_file
from odt_plugins.cli.main import main
from odt_plugins.errors import DataNotKeptWarning, MeshFileError


@pytest.fixture
def gmsh():
    with session() as module:
        module.model.add("groups")
        yield module


def model(gmsh, path, *, named, binary, version=2.2):
    """Two boxes; both are in one group, each in one of its own, a face in two."""
    occ = gmsh.model.occ
    occ.fragment([(3, occ.addBox(0, 0, 0, 1, 1, 1))], [(3, occ.addBox(1, 0, 0, 1, 1, 1))])
    occ.synchronize()
    for dim, entities, tag, name in ((3, [1, 2], 7, "all"), (3, [1], 2, "one"), (3, [2], 3, "two"),
                                     (2, [1, 2], 7, "skin"), (2, [2], 9, "part")):
        gmsh.model.addPhysicalGroup(dim, entities, tag, name if named else "")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.35)
    gmsh.option.setNumber("Mesh.Optimize", 0)
    gmsh.model.mesh.generate(3)
    gmsh.option.setNumber("Mesh.MshFileVersion", version)
    gmsh.option.setNumber("Mesh.Binary", binary)
    gmsh.write(str(path))


def volumes(gmsh, path):
    """Size of every group: area or volume of its elements."""
    gmsh.clear()
    gmsh.open(str(path))
    out = {}
    for dim, tag in gmsh.model.getPhysicalGroups():
        kind = {2: 2, 3: 4}[dim]
        sizes = [gmsh.model.mesh.getElementQualities(
            gmsh.model.mesh.getElementsByType(kind, entity)[0], "volume").sum()
            for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag)]
        out[dim, tag, gmsh.model.getPhysicalName(dim, tag)] = round(float(sum(sizes)), 9)
    return out


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("named", [True, False])
def test_elements_of_several_groups_are_there_once(gmsh, named, binary, tmp_path):
    source, target = tmp_path / "a.msh", tmp_path / "b.msh"
    model(gmsh, source, named=named, binary=binary)
    mesh = read_file(source)
    cells = np.concatenate([block.data for block in mesh.cells if block.type == "tetra"])
    assert len(np.unique(np.sort(cells, axis=1), axis=0)) == len(cells)
    optimize_file(source, target)
    assert target.read_bytes()[:20].split()[1:3] == [b"2.2", str(binary).encode()]
    found = volumes(gmsh, target)
    assert found == volumes(gmsh, source)
    assert len(found) == 5


def test_groups_that_overlap_go_to_version_4(gmsh, tmp_path):
    model(gmsh, tmp_path / "a.msh", named=True, binary=0)
    write_file(tmp_path / "b.msh", read_file(tmp_path / "a.msh"), file_format="gmsh41")
    assert volumes(gmsh, tmp_path / "b.msh") == {
        (3, 7, "all"): 2, (3, 2, "one"): 1, (3, 3, "two"): 1, (2, 7, "skin"): 2, (2, 9, "part"): 1}


@pytest.mark.parametrize("binary", [0, 1])
def test_groups_without_names_that_overlap_are_sets(gmsh, binary, tmp_path):
    source, target = tmp_path / "a.msh", tmp_path / "b.msh"
    model(gmsh, source, named=False, binary=binary, version=4.1)
    expected = volumes(gmsh, source)
    mesh = read_file(source)
    sizes = {name: sum(map(len, rows)) for name, rows in mesh.cell_sets.items()}
    per_type = {kind: sum(len(b.data) for b in mesh.cells if b.type == kind)
                for kind in ("triangle", "tetra")}
    assert sizes["physical 2"] + sizes["physical 3"] == per_type["tetra"]
    assert 2 * sizes["physical 9"] == per_type["triangle"]
    write_file(target, mesh, file_format="gmsh41")
    assert volumes(gmsh, target) == expected
    optimize_file(source, target)
    assert volumes(gmsh, target) == expected
    with pytest.warns(DataNotKeptWarning, match="cell sets 'physical 2', 'physical 3', 'physical"):
        write_file(tmp_path / "b.mesh", mesh)
    with pytest.warns(DataNotKeptWarning):
        write_file(tmp_path / "b.inp", mesh)
    assert {"physical 2", "physical 3", "physical 9"} <= {*read_file(tmp_path / "b.inp").cell_sets}


@pytest.mark.parametrize("version", [2.2, 4.1])
@pytest.mark.parametrize("binary", [0, 1])
def test_groups_of_the_same_name_stay_apart(gmsh, binary, version, tmp_path):
    source, target = tmp_path / "a.msh", tmp_path / "b.msh"
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()
    for dim, entity, tag in ((3, 1, 1), (2, 1, 5)):
        gmsh.model.addPhysicalGroup(dim, [entity], tag, "wall")
    for name, value in (("MeshSizeMax", 0.5), ("MshFileVersion", version), ("Binary", binary)):
        gmsh.option.setNumber(f"Mesh.{name}", value)
    gmsh.model.mesh.generate(3)
    gmsh.write(str(source))
    expected = volumes(gmsh, source)
    assert {name for _, _, name in expected} == {"wall"}
    mesh = read_file(source)
    assert {name: value.tolist() for name, value in mesh.field_data.items()} == {
        "wall": [5, 2], "wall (3D)": [1, 3]}
    for form in ("gmsh22", "gmsh41"):
        write_file(target, mesh, file_format=form)
        assert volumes(gmsh, target) == expected
    write_file(tmp_path / "b.inp", mesh)
    assert {"wall", "wall (3D)"} <= {*read_file(tmp_path / "b.inp").cell_sets}


@pytest.mark.parametrize("binary", [0, 1])
@pytest.mark.parametrize("suffix", [".med", ".e", ".inp", ".cgns", ".su2", ".vol", ".vtu", ".msh",
                                    ".xdmf"])
def test_groups_with_turned_entities_keep_name_and_members(gmsh, suffix, binary, tmp_path):
    gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
    gmsh.model.occ.synchronize()
    wanted = {"both": [1, -2], "plain": [3], "turned": [-4]}
    gmsh.model.addPhysicalGroup(3, [1], 1, "all")
    for tag, (name, entities) in enumerate(wanted.items(), 7):
        gmsh.model.addPhysicalGroup(2, entities, tag, name)
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.35)
    gmsh.model.mesh.generate(3)
    gmsh.option.setNumber("Mesh.Binary", binary)
    gmsh.write(str(tmp_path / "a.msh"))
    before = volumes(gmsh, tmp_path / "a.msh")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", DataNotKeptWarning)
        optimize_file(tmp_path / "a.msh", tmp_path / f"b{suffix}",
                      file_format="gmsh22" if suffix == ".msh" else None)
    assert suffix != ".msh" or volumes(gmsh, tmp_path / "b.msh") == before
    back = read_file(tmp_path / f"b{suffix}")
    if suffix == ".xdmf":
        assert not any("values of" in str(one.message) for one in caught)
        back.cell_sets = {name: [np.flatnonzero(part) for part in back.cell_data[name]]
                          for name in wanted}
    else:
        assert not any(f"{name!r}" in str(one.message) for name in wanted for one in caught)
    sets = named_groups(back) | back.cell_sets
    assert {name for name in sets if "Surface" in name} == set()
    skin = sum(len(block.data) for block in back.cells if block.type == "triangle")
    for name, entities in wanted.items():
        assert sum(map(len, sets[name])) == skin * len(entities) // 4


@pytest.mark.parametrize("suffix", [".inp", ".bdf", ".f3grid"])
def test_a_physical_point_does_not_stop_decks_and_is_a_node_set_in_abaqus(suffix, tmp_path):
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    mesh = meshio.Mesh(
        points, [("vertex", np.array([[2]])), ("triangle", np.array([[0, 1, 2]])),
                 ("tetra", np.array([[0, 1, 2, 3]]))],
        cell_data={"gmsh:physical": [np.array([7]), np.array([8]), np.array([9])]},
        field_data={"pin": np.array([7, 0]), "wall": np.array([8, 2]), "body": np.array([9, 3])})
    with pytest.warns(DataNotKeptWarning, match="1 cell of type vertex") as heard:
        write_file(tmp_path / f"out{suffix}", mesh)
    assert len(heard) == 1
    if suffix == ".inp":
        assert "groups" not in str(heard[0].message)
        back = meshio.read(tmp_path / "out.inp")
        assert back.points[back.point_sets["pin"]].tolist() == [[0.0, 1.0, 0.0]]
        assert {"wall", "body"} <= set(back.cell_sets)


POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


@pytest.mark.parametrize("suffix", [".su2", ".h5m", ".mdpa"])
def test_points_and_lines_that_a_format_lacks_are_left_out_by_number(suffix, tmp_path):
    mesh = meshio.Mesh(POINTS, [("vertex", np.array([[2]])), ("line", np.array([[0, 1]])),
                                ("triangle", np.array([[0, 1, 2]])),
                                ("tetra", np.array([[0, 1, 2, 3]]))])
    with pytest.warns(DataNotKeptWarning, match="1 cell of type vertex"):
        write_file(tmp_path / f"out{suffix}", mesh)
    there = {block.type for block in read_file(tmp_path / f"out{suffix}").cells}
    assert {"tetra", "triangle"} <= there


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".off", ".su2", ".mesh", ".avs", ".dat",
                                    ".xml", ".h5m", ".ele", ".b8.ugrid"])
def test_a_format_without_the_cells_is_refused_by_their_type(suffix, tmp_path):
    mesh = meshio.Mesh(POINTS, [("line3", np.array([[0, 1, 2]])),
                                ("triangle6", np.array([[0, 1, 2, 3, 3, 3]]))])
    with pytest.raises(MeshFileError, match=r"it holds no cells of type triangle6; try another"):
        write_file(tmp_path / f"out{suffix}", mesh)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", [["optimize"], ["remesh", "--scale", "0.8"], ["untangle"]])
def test_a_format_without_the_cells_is_refused_before_any_work(
        command, tmp_path, monkeypatch, capsys):
    write_file(tmp_path / "a.vtu", meshio.Mesh(POINTS, [("tetra", np.array([[0, 1, 2, 3]]))]))
    monkeypatch.setattr("odt_plugins.remeshing.run_engine", None)
    monkeypatch.setattr("odt_plugins.api.run_engine", None)
    code = main([command[0], str(tmp_path / "a.vtu"), str(tmp_path / "a.stl"), *command[1:]])
    assert code == 1
    said = "cannot write a.stl as stl: it holds no cells of type tetra; try"
    assert said in capsys.readouterr().err
