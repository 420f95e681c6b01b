"""Labels out of sets, and positive ones, where a format has numbers alone for its cells."""

from __future__ import annotations

import itertools
import sys
import warnings

import boxes
import meshio
import numpy as np
import pytest

import odt_plugins
from odt_plugins.adapters import meshio_mesh
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.adapters.fitting import named_groups
from odt_plugins.adapters.formats import exodus, exodus_write
from odt_plugins.adapters.formats.decks import alike


def two_bodies(labels=None):
    """Two bodies and a boundary of two sides, with sets and the labels that are given."""
    points, cells = boxes.box(3, 2, plane=0.5)
    faces = boxes.rim(cells)
    left = points[cells].mean(axis=1)[:, 0] < 0.5
    inlet = (points[faces][:, :, 0] == 0).all(axis=1)
    none = np.zeros(0, dtype=np.int64)
    sets = {"oil": [np.flatnonzero(left), none], "steel": [np.flatnonzero(~left), none],
            "inlet": [none, np.flatnonzero(inlet)], "wall": [none, np.flatnonzero(~inlet)]}
    data = {name: [np.where(left, *pair[0]), np.where(inlet, *pair[1])]
            for name, pair in (labels or {}).items()}
    return meshio.Mesh(points, [("tetra", cells), ("triangle", faces)], cell_data=data,
                       cell_sets=sets), left, inlet


@pytest.mark.parametrize("labels", [
    None, {"cell_tags": [(-7, -8), (-9, -10)]},
    {"exodus:block": [(7, 8), (0, 0)], "exodus:side_set": [(0, 0), (9, 10)]},
    {"abaqus:elset": [(2, 1), (0, 0)]}])
def test_sets_are_materials_and_conditions_of_netgen(labels, tmp_path):
    """A file of sets, such as one of Salome, had negative numbers, which Netgen does not load."""
    ng = pytest.importorskip("netgen.meshing")
    mesh, left, inlet = two_bodies(labels)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore" if labels else "error")
        write_file(tmp_path / "a.vol", mesh)
    there = ng.Mesh()
    there.Load(str(tmp_path / "a.vol"))
    materials = [there.GetMaterial(e.index) for e in there.Elements3D()]
    sides = [there.FaceDescriptor(e.index).bcname for e in there.Elements2D()]
    assert [materials.count("oil"), materials.count("steel")] == [left.sum(), (~left).sum()]
    assert [sides.count("inlet"), sides.count("wall")] == [inlet.sum(), (~inlet).sum()]


@pytest.mark.parametrize("suffix", [".mesh", ".bdf", ".ele", ".b8.ugrid", ".su2"])
def test_sets_of_the_boundary_are_its_labels(suffix, tmp_path):
    mesh, _, inlet = two_bodies({"abaqus:elset": [(2, 1), (0, 0)]})
    with pytest.warns(match="cell sets"):
        write_file(tmp_path / f"a{suffix}", mesh)
    back = read_file(tmp_path / f"a{suffix}")
    (label,) = (np.concatenate([part for block, part in zip(back.cells, parts, strict=True)
                                if block.type == "triangle"])
                for name, parts in back.cell_data.items() if name != "nastran:part")
    assert sorted(np.unique(label, return_counts=True)[1]) == sorted([inlet.sum(), (~inlet).sum()])
    assert label.min() > 0


@pytest.mark.parametrize("suffix", [".bdf", ".vol"])
@pytest.mark.parametrize("pairs", [[(0, 1), (0, 3)], [(-1, 1), (-2, 5)], [(0, 0), (0, 0)]])
def test_labels_that_are_not_positive_get_free_numbers(suffix, pairs, tmp_path):
    """Nastran's property 0 was left out, so that meshio and Gmsh took a node for it."""
    mesh, left, inlet = two_bodies({"medit:ref": pairs})
    mesh.cell_sets = {}
    said = r"the numbers of cell data 'medit:ref' \(others in" if any(pairs[0]) else "medit:ref"
    with pytest.warns(match=said):
        write_file(tmp_path / f"a{suffix}", mesh)
    back = meshio.read(tmp_path / f"a{suffix}")
    for kind, mask, pair in (("tetra", left, pairs[0]), ("triangle", inlet, pairs[1])):
        (found,) = (values[kind] for values in back.cell_data_dict.values())
        assert found.min() > 0
        assert len(np.unique(found[mask])) == len(np.unique(found[~mask])) == 1
        assert (found[mask][0] == found[~mask][0]) == (pair[0] == pair[1])


@pytest.mark.parametrize(("suffix", "pair", "other"), [
    (".bdf", (-1, 0), 2), (".vol", (-1, 0), 2), (".bdf", (2**31 - 1, 0), 1),
    (".vol", (99_999, 10**6), 1)])
def test_labels_keep_their_number_where_others_get_one(suffix, pair, other, tmp_path):
    mesh, left, _ = two_bodies({"medit:ref": [pair, (1, 1)]})
    mesh.cell_sets = {}
    with pytest.warns(match="medit:ref"):
        write_file(tmp_path / f"a{suffix}", mesh)
    back = read_file(tmp_path / f"a{suffix}")
    (found,) = (np.concatenate([part for block, part in zip(back.cells, parts, strict=True)
                                if block.type == "tetra"]) for parts in back.cell_data.values())
    assert np.array_equal(found, np.where(left, abs(pair[0]), other))


def test_a_set_of_all_cells_leaves_smaller_ones_their_labels(tmp_path):
    mesh, left, _ = two_bodies()
    none = np.zeros(0, dtype=np.int64)
    mesh.cell_sets = {"all": [np.arange(len(left)), none], **mesh.cell_sets}
    with pytest.warns(match="all"):
        write_file(tmp_path / "a.mesh", mesh)
    back = read_file(tmp_path / "a.mesh")
    found = back.cell_data_dict["medit:ref"]["tetra"]
    assert len(np.unique(found[left])) == len(np.unique(found[~left])) == 1
    assert found[left][0] != found[~left][0]


def test_labels_of_blocks_with_other_types_of_integers_are_written(tmp_path):
    """Joined, signed and unsigned ones became real numbers, which MEDIT's files do not hold."""
    mesh, _, _ = two_bodies({"medit:ref": [(1, 2), (3, 4)]})
    labels = mesh.cell_data["medit:ref"]
    mesh = meshio.Mesh(mesh.points, [*mesh.cells, ("quad", np.array([[0, 1, 4, 3]]))], cell_data={
        "medit:ref": [labels[0], labels[1].astype(np.uint64), np.array([7])]})
    write_file(tmp_path / "a.mesh", mesh)
    back = read_file(tmp_path / "a.mesh").cell_data["medit:ref"]
    assert sorted(np.unique(np.concatenate(back)).tolist()) == [1, 2, 3, 4, 7]


def test_large_numbers_of_named_groups_are_small_ones_of_netgen(tmp_path):
    """Names of all numbers up to the largest were written, which took the memory of the machine."""
    ng = pytest.importorskip("netgen.meshing")
    mesh, left, _ = two_bodies({"gmsh:physical": [(10 ** 6, 12), (3, 4)]})
    mesh.cell_sets = {}
    mesh.field_data = {"oil": np.array([10 ** 6, 3]), "steel": np.array([12, 3])}
    with pytest.warns(match="gmsh:physical"):
        write_file(tmp_path / "a.vol", mesh)
    assert (tmp_path / "a.vol").stat().st_size < 10 ** 5
    there = ng.Mesh()
    there.Load(str(tmp_path / "a.vol"))
    names = np.array([there.GetMaterial(e.index) for e in there.Elements3D()])
    assert np.array_equal(names == "oil", left)
    assert {*names} == {"oil", "steel"}


@pytest.mark.parametrize("suffix", [".vol", ".f3grid", ".mesh", ".off"])
def test_meshes_without_points_are_written(suffix, tmp_path):
    """Files without points are read with points of no dimension."""
    write_file(tmp_path / f"a{suffix}", meshio.Mesh(np.zeros((0, 3)), []))
    assert read_file(tmp_path / f"a{suffix}").points.shape == (0, 3)


@pytest.mark.parametrize("suffix", [".mesh", ".meshb", ".bdf", ".ele", ".avs", ".vol", ".b8.ugrid"])
def test_labels_of_formats_are_physical_groups_in_gmsh(suffix, tmp_path):
    """They were views, so that nothing in Gmsh could refer to the bodies and sides."""
    gmsh = pytest.importorskip("gmsh")
    mesh, left, inlet = two_bodies({"gmsh:physical": [(7, 8), (9, 10)]})
    mesh.cell_sets = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        write_file(tmp_path / f"a{suffix}", mesh)
        labelled = read_file(tmp_path / f"a{suffix}")
        write_file(tmp_path / "b.msh", labelled)
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(tmp_path / "b.msh"))
        found = {(dim, tag): sum(len(row) for of in gmsh.model.getEntitiesForPhysicalGroup(dim, tag)
                                 for row in gmsh.model.mesh.getElements(dim, of)[1])
                 for dim, tag in gmsh.model.getPhysicalGroups()}
    finally:
        gmsh.finalize()
    sides = {(2, 9): inlet.sum(), (2, 10): (~inlet).sum()}
    bodies = {(3, 7): left.sum(), (3, 8): (~left).sum()}
    assert found == (sides if suffix == ".b8.ugrid" else sides | bodies)


def test_negative_labels_are_no_groups_of_gmsh(tmp_path):
    mesh, *_ = two_bodies({"medit:ref": [(7, -8), (9, 10)]})
    mesh.cell_sets = {}
    write_file(tmp_path / "a.msh", mesh)
    back = read_file(tmp_path / "a.msh")
    assert sorted(np.unique(np.concatenate(back.cell_data["medit:ref"]))) == [-8, 7, 9, 10]
    assert not any(np.any(part) for part in back.cell_data.get("gmsh:physical", []))


@pytest.mark.parametrize("suffix", [".off", ".vol", ".inp"])
@pytest.mark.parametrize("source", [".mesh", ".bdf"])
def test_labels_of_no_cells_are_no_labels(source, suffix, tmp_path):
    write_file(tmp_path / f"a{source}", meshio.Mesh(np.zeros((0, 3)), []))
    with pytest.warns(match=":ref"):
        write_file(tmp_path / f"b{suffix}", read_file(tmp_path / f"a{source}"))
    assert read_file(tmp_path / f"b{suffix}").points.shape == (0, 3)


@pytest.mark.parametrize("suffix", [".inp", ".cgns"])
def test_labels_beside_sets_of_their_dimension_are_told_to_be_lost(suffix, tmp_path):
    mesh, *_ = two_bodies({"medit:ref": [(7, 8), (9, 10)]})
    mesh.cell_sets = {"oil": [np.arange(2), np.zeros(0, dtype=int)]}
    with pytest.warns(match=r"cell data 'medit:ref'(?! \(sets)") as heard:
        write_file(tmp_path / f"a{suffix}", mesh)
    assert not any("the name of" in str(line.message) for line in heard)
    assert {"Surface9", "Surface10", "oil"} <= {*read_file(tmp_path / f"a{suffix}").cell_sets}


def test_a_set_called_like_that_of_a_label_stays(tmp_path):
    mesh, left, _ = two_bodies({"gmsh:physical": [(7, 8), (9, 10)]})
    mesh.cell_sets = {"Volume7": [np.arange(2), np.zeros(0, dtype=int)]}
    with pytest.warns(match="sets there"):
        write_file(tmp_path / "a.inp", mesh)
    sets = read_file(tmp_path / "a.inp").cell_sets
    assert sum(map(len, sets["Volume7"])) == 2
    assert sum(map(len, sets["Volume7_2"])) == left.sum()


@pytest.mark.parametrize("suffix", [".inp", ".cgns", ".f3grid"])
@pytest.mark.parametrize("name", ["gmsh:physical", "medit:ref", "material_id"])
def test_labels_are_sets_where_a_format_has_no_numbers(suffix, name, tmp_path):
    """Bodies and sides without names were lost, though such files have sets."""
    mesh, left, inlet = two_bodies({name: [(7, 8), (9, 10)]})
    mesh.cell_sets = {}
    with pytest.warns(match=f"does not keep the name of cell data '{name}' .sets there"):
        write_file(tmp_path / f"a{suffix}", mesh)
    back = read_file(tmp_path / f"a{suffix}")
    sizes = {key: sum(len(rows) for rows in members if rows is not None)
             for key, members in back.cell_sets.items()}
    assert sizes == {"Volume7": left.sum(), "Volume8": (~left).sum(),
                     "Surface9": inlet.sum(), "Surface10": (~inlet).sum()}


def test_groups_without_a_name_are_sets_beside_those_with_one(tmp_path):
    mesh, left, inlet = two_bodies({"gmsh:physical": [(7, 8), (9, 0)]})
    mesh.cell_sets = {}
    mesh.field_data = {"oil": np.array([7, 3])}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_file(tmp_path / "a.inp", mesh)
    back = read_file(tmp_path / "a.inp")
    sizes = {key: sum(map(len, members)) for key, members in back.cell_sets.items()}
    assert sizes == {"oil": left.sum(), "Volume8": (~left).sum(), "Surface9": inlet.sum()}


def test_an_array_of_a_number_a_cell_is_no_sets(tmp_path):
    mesh, *_ = two_bodies()
    mesh.cell_sets = {}
    ends = np.cumsum([0, *(len(block.data) for block in mesh.cells)])
    mesh.cell_data = {"part": [np.arange(*pair) for pair in itertools.pairwise(ends)]}
    with pytest.warns(match="cell data 'part'"):
        write_file(tmp_path / "a.inp", mesh)
    assert not read_file(tmp_path / "a.inp").cell_sets


def test_groups_without_names_that_overlap_are_sets(tmp_path):
    mesh, left, _ = two_bodies({"gmsh:physical": [(7, 8), (0, 0)]})
    mesh.cell_sets = {"physical 9": [np.arange(len(left)), np.zeros(0, dtype=np.int64)]}
    with pytest.warns(match="the name of cell data 'gmsh:physical' .sets there"):
        write_file(tmp_path / "a.inp", mesh)
    back = read_file(tmp_path / "a.inp")
    sizes = {key: sum(map(len, members)) for key, members in back.cell_sets.items()}
    assert sizes == {"Volume7": left.sum(), "Volume8": (~left).sum(), "physical 9": len(left)}


def test_sets_of_the_boundary_are_side_sets_beside_labels_of_bodies(tmp_path):
    """Sets of an Abaqus deck, whose labels tell bodies alone, were one side set without a name."""
    mesh, left, inlet = two_bodies()
    write_file(tmp_path / "a.inp", mesh)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*does not keep the name of cell data")
        write_file(tmp_path / "b.e", read_file(tmp_path / "a.inp"))
    back = read_file(tmp_path / "b.e")
    sizes = {key: sum(map(len, members)) for key, members in back.cell_sets.items()}
    assert sizes == {"oil": left.sum(), "steel": (~left).sum(), "inlet": inlet.sum(),
                     "wall": (~inlet).sum()}


@pytest.mark.parametrize("suffix", [".inp", ".cgns"])
def test_groups_of_a_model_of_gmsh_without_names_are_sets(suffix, tmp_path):
    """Files of Gmsh's own name the entities that bound another, by tags that are no cells."""
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.occ.addRectangle(0, 0, 0, 1, 1, tag=1)
        gmsh.model.occ.addRectangle(1, 0, 0, 1, 1, tag=2)
        gmsh.model.occ.fragment([(2, 1)], [(2, 2)])
        gmsh.model.occ.synchronize()
        lines = gmsh.model.getEntities(1)
        for dim, entities, tag in ((2, [1], 5), (2, [2], 6), (1, [t for _, t in lines[-3:]], 7)):
            gmsh.model.addPhysicalGroup(dim, entities, tag)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.3)
        gmsh.model.mesh.generate(2)
        gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
        gmsh.write(str(tmp_path / "a.msh"))
    finally:
        gmsh.finalize()
    mesh = read_file(tmp_path / "a.msh")
    with pytest.warns(match="cell data 'gmsh:physical' .sets there"):
        write_file(tmp_path / f"b{suffix}", mesh)
    assert {"Surface5", "Surface6", "Line7"} <= {*read_file(tmp_path / f"b{suffix}").cell_sets}


@pytest.mark.parametrize("suffix", [".xdmf", ".dat", ".xml"])
def test_sets_are_arrays_where_a_format_has_these_alone(suffix, tmp_path):
    """The sets of CGNS and Exodus files were lost, and with them what tells bodies apart."""
    mesh, left, inlet = two_bodies()
    nodes = np.flatnonzero(mesh.points[:, 0] == 0)
    mesh.point_sets = {"grip": nodes}
    with pytest.warns(match=r"cell sets .*'steel'" + r".*arrays of 0 and 1" * (suffix == ".xdmf")):
        write_file(tmp_path / f"a{suffix}", mesh)
    back = read_file(tmp_path / f"a{suffix}")
    (k,) = (k for k, block in enumerate(back.cells) if block.type == "tetra")
    assert np.array_equal(np.asarray(back.cell_data["oil"][k]) != 0, left)
    if suffix == ".xdmf":
        (j,) = (j for j, block in enumerate(back.cells) if block.type == "triangle")
        assert np.array_equal(back.cell_data["inlet"][j] != 0, inlet)
    if suffix != ".xml":
        assert np.array_equal(np.flatnonzero(back.point_data["grip"]), nodes)


@pytest.mark.parametrize("suffix", [".dato", ".inp", ".vol"])
def test_blocks_without_cells_are_written(suffix, tmp_path):
    """PERMAS' files were read with such blocks of no width, which ended in an error."""
    mesh, *_ = two_bodies()
    bare = meshio.Mesh(mesh.points, [mesh.cells[0], *(
        (f"triangle{k}" if k > 3 else "triangle", np.zeros((0, k), dtype=np.int64))
        for k in (3, 6))])
    write_file(tmp_path / f"a{suffix}", bare)
    back = read_file(tmp_path / f"a{suffix}")
    assert [len(block.data) for block in back.cells if len(block.data)] == [len(mesh.cells[0].data)]
    assert all(block.data.ndim == 2 for block in back.cells)


def test_names_that_are_told_apart_take_none_of_another_set(tmp_path):
    mesh, *_ = two_bodies()
    none = np.zeros(0, dtype=np.int64)
    mesh.cell_sets = {name: [np.arange(k + 1), none]
                      for k, name in enumerate(["BODY", "body", "body_2"])}
    with pytest.warns(match="body"):
        write_file(tmp_path / "a.inp", mesh)
    sets = read_file(tmp_path / "a.inp").cell_sets
    assert {name: sum(map(len, rows)) for name, rows in sets.items()} == {
        "BODY": 1, "body_3": 2, "body_2": 3}


def test_ids_of_sides_of_exodus_have_32_bits(tmp_path):
    mesh, _, inlet = two_bodies({"exodus:block": [(2**31 - 1, 8), (0, 0)]})
    mesh.cell_sets = {"inlet": mesh.cell_sets["inlet"], "wall": mesh.cell_sets["wall"]}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        write_file(tmp_path / "a.e", mesh)
        back = read_file(tmp_path / "a.e")
    sides = np.concatenate(back.cell_data["exodus:side_set"])
    assert sides.min() >= 0
    assert sorted(np.bincount(np.unique(sides, return_inverse=True)[1])[1:]) == sorted(
        [inlet.sum(), (~inlet).sum()])


@pytest.mark.parametrize("middle", [".vtu", ".vtk", ".xdmf"])
@pytest.mark.parametrize("suffix", [".inp", ".cgns", ".f3grid", ".med"])
def test_sets_that_were_arrays_of_0_and_1_are_sets_again(suffix, middle, tmp_path):
    mesh, left, inlet = two_bodies()
    mesh.point_sets = {"low": np.flatnonzero(mesh.points[:, 1] == 0)}
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        write_file(tmp_path / f"a{middle}", mesh)
        between = read_file(tmp_path / f"a{middle}")
        between.cell_data["material"] = [np.where(left, 1, 0), np.where(inlet, 0, 0)]
        between.cell_data["vtkGhostType"] = [part.astype(np.uint8) for part in
                                             between.cell_data["material"]]
        write_file(tmp_path / f"b{suffix}", between)
    assert {*mesh.cell_sets} <= set(between.cell_data)
    assert "cell data 'oil', 'steel', 'inlet', 'wall' (sets there)" in str(heard[-1].message)
    back = read_file(tmp_path / f"b{suffix}")
    found = {name: sum(len(np.asarray(part)) for part in rows)
             for name, rows in back.cell_sets.items()}
    assert found == {name: sum(map(len, rows)) for name, rows in mesh.cell_sets.items()}
    if suffix in (".inp", ".med"):
        assert len(back.point_sets["low"]) == len(mesh.point_sets["low"])


@pytest.mark.parametrize("values", [[[0, 1, 2], [1]], [[0, 0, 0], [0]], [[1, 1, 1], [1]],
                                    [[0.0, 1.0, 0.0], [0.0]]])
def test_other_arrays_are_no_sets(values, tmp_path):
    points = np.random.default_rng(0).random((6, 3))
    mesh = meshio.Mesh(points, [("tetra", np.array([[0, 1, 2, 3], [1, 2, 3, 4], [2, 3, 4, 5]])),
                                ("triangle", np.array([[0, 1, 2]]))],
                       cell_data={"count": [np.array(part) for part in values]})
    with pytest.warns(match="does not keep cell data 'count'"):
        write_file(tmp_path / "a.inp", mesh)
    assert not read_file(tmp_path / "a.inp").cell_sets


@pytest.mark.parametrize("suffix", [".inp", ".cgns", ".f3grid"])
def test_labels_are_sets_beside_an_array_of_0_and_1_that_does_not_tell_them(suffix, tmp_path):
    mesh, left, inlet = two_bodies()
    flag = np.arange(len(left)) % 3 == 0
    mesh.cell_sets = {}
    mesh.cell_data = {"region": [np.where(left, 7, 9), np.zeros(len(inlet), dtype=int)],
                      "done": [flag.astype(np.uint8), np.zeros(len(inlet), dtype=np.uint8)],
                      "exodus:side_set": [np.zeros(len(left), dtype=int), inlet.astype(int)]}
    mesh.point_data = {"medit:ref": np.arange(len(mesh.points)) % 2}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        write_file(tmp_path / f"a{suffix}", mesh)
    back = read_file(tmp_path / f"a{suffix}")
    overlapping = {} if suffix == ".cgns" else {"done": flag.sum()}
    assert {name: sum(map(len, rows)) for name, rows in back.cell_sets.items()
            if name != "triangle"} == {
        "Volume7": left.sum(), "Volume9": (~left).sum(), **overlapping}
    assert not back.point_sets


@pytest.mark.parametrize("name", [".inp", ".cgns", ".f3grid"])
def test_labels_that_a_reader_made_of_sets_are_lost_only_where_these_do_not_tell_them(
    name, tmp_path,
):
    deck = [f"*SOLID SECTION, ELSET={body}, MATERIAL={body}\n" for body in ("oil", "steel")]
    mesh, left, _ = two_bodies()
    write_file(tmp_path / "a.inp", mesh)
    with (tmp_path / "a.inp").open("a") as file:
        file.writelines(deck)
    found = read_file(tmp_path / "a.inp")
    assert set(np.concatenate(found.cell_data["abaqus:elset"][:1])) == {1, 2}
    plain = meshio.Mesh(found.points, found.cells, cell_data=found.cell_data,
                        cell_sets=found.cell_sets)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        write_file(tmp_path / f"b{name}", plain)
    assert not [w for w in caught if "abaqus:elset" in str(w.message)]
    back = read_file(tmp_path / f"b{name}")
    assert np.array_equal(np.concatenate(back.cell_sets["oil"]), np.flatnonzero(left))
    plain.cell_data["abaqus:elset"][0][-1] = 9
    with pytest.warns(match="abaqus:elset"):
        write_file(tmp_path / f"c{name}", plain)


def test_cells_are_alike_where_all_numbers_and_sets_are():
    random = np.random.default_rng(3)
    label = random.integers(-2, 3, 500)
    sets = random.random((500, 19)) < 0.1
    for columns in ([*sets.T], [label, *sets.T], [label], [sets[:, 0]]):
        _, first, same = np.unique(np.stack(columns, axis=1).astype(np.int64), axis=0,
                                   return_index=True, return_inverse=True)
        got = alike(columns)
        assert np.array_equal(got[0], first)
        assert np.array_equal(got[1], same.ravel())


def test_many_sets_do_not_take_the_square_of_their_number(tmp_path):
    """As of a polycrystal whose grains have names."""
    calls = []
    for many in (60, 120):
        cells = np.arange(4 * 10 * many).reshape(-1, 4)
        points = np.tile([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], (len(cells), 1))
        points += np.repeat(np.arange(len(cells)), 4)[:, None]
        grains = np.arange(len(cells)).reshape(many, -1)
        mesh = meshio.Mesh(points, [("tetra", cells)],
                           cell_sets={f"grain{i}": [rows] for i, rows in enumerate(grains)})
        calls.append(0)

        def count(frame, event, argument):
            calls[-1] += event.endswith("call")

        before = sys.getprofile()
        sys.setprofile(count)
        try:
            exodus_write.write(tmp_path / "a.e", mesh, None)
        finally:
            sys.setprofile(before)
        assert len(exodus.read(tmp_path / "a.e").cell_sets) == many
    assert calls[1] < 2.5 * calls[0]


def in_blocks(many):
    """A cube whose cells are in as many blocks, each of which is a set and a group of Gmsh."""
    points, cells = boxes.box(3, 4)
    rows = np.array_split(cells, many)
    names = [f"grain{i}" for i in range(many)]
    none = np.zeros(0, dtype=np.int32)
    return meshio.Mesh(
        points, [("tetra", own) for own in rows],
        cell_sets={name: [np.arange(len(own)) if i == j else none for j, own in enumerate(rows)]
                   for i, name in enumerate(names)},
        cell_data={"gmsh:physical": [np.full(len(own), i + 1) for i, own in enumerate(rows)]},
        field_data={name: np.array([i + 1, 3]) for i, name in enumerate(names)})


def test_sets_are_looked_at_in_the_blocks_that_have_some_of_their_cells(monkeypatch):
    many, asked = 12, []
    mesh = in_blocks(many)

    def counting(call):
        def counted(*given, **options):
            asked.append(call)
            return call(*given, **options)
        return counted

    with monkeypatch.context() as patch:
        patch.setattr(np, "isin", counting(np.isin))
        groups = named_groups(mesh)
    assert len(asked) == many
    asked.clear()
    monkeypatch.setattr(meshio_mesh, "_members", counting(meshio_mesh._members))
    out = odt_plugins.remesh(mesh, scale=0.9)
    assert len(asked) == many
    for sets in (groups, out.cell_sets):
        assert [[bool(len(rows)) for rows in members] for members in sets.values()] == (
            np.eye(many, dtype=bool).tolist())
    assert [len(own.data) for own in out.cells] == [
        len(members[i]) for i, members in enumerate(out.cell_sets.values())]
