"""MED files: groups, families, numbers and fields stay, as h5py and Gmsh read them."""

from __future__ import annotations

import contract
import h5py
import meshio
import numpy as np
import pytest
from format_table import mesh_of_everything
from gmsh_sessions import session

from odt_plugins import remesh
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file
from odt_plugins.errors import DataNotKeptWarning

STEP = "-0000000000000000001-0000000000000000001"


@pytest.fixture
def gmsh():
    with session() as module:
        yield module


def groups(gmsh, path):
    """Number of elements of every physical group, and the least determinant of tetrahedra."""
    gmsh.clear()
    gmsh.open(str(path))
    out = {}
    for dim, tag in gmsh.model.getPhysicalGroups():
        entities = gmsh.model.getEntitiesForPhysicalGroup(dim, tag)
        name = gmsh.model.getPhysicalName(dim, tag).strip("\0 ")
        out[dim, name] = sum(len(numbers) for entity in entities
                             for numbers in gmsh.model.mesh.getElements(dim, entity)[1])
    tets = gmsh.model.mesh.getElementsByType(4)[0]
    return out, min(gmsh.model.mesh.getElementQualities(tets, "minDetJac"))


def cube(gmsh, *paths):
    """Tetrahedra of two boxes with groups of bodies and faces, by Gmsh."""
    occ = gmsh.model.occ
    occ.fragment([(3, occ.addBox(0, 0, 0, 1, 1, 1))], [(3, occ.addBox(1, 0, 0, 1, 1, 1))])
    occ.synchronize()
    gmsh.model.addPhysicalGroup(3, [1], 1, "steel")
    gmsh.model.addPhysicalGroup(3, [1, 2], 2, "bodies")
    gmsh.model.addPhysicalGroup(2, [1], 3, "inlet")
    gmsh.option.setNumber("Mesh.MeshSizeMax", 0.35)
    gmsh.option.setNumber("Mesh.Optimize", 0)
    gmsh.model.mesh.generate(3)
    for path in paths:
        gmsh.write(str(path))


def with_fields(path):
    """Add fields of points and cells at two times, a group of nodes, and numbers of cells."""
    mesh = meshio.read(path)
    with h5py.File(path, "a") as f:
        name = next(iter(f["ENS_MAA"]))
        step = f["ENS_MAA"][name][STEP]
        count = len(step["MAI"]["TE4"]["FAM"])
        step["MAI"]["TE4"]["NUM"][...] = np.arange(count) + 700
        step["NOE"]["FAM"][:9] = 5
        home = f["FAS"][name].create_group("NOEUD", track_order=True)
        family = home.create_group("FAM_5_probes", track_order=True)
        family.attrs["NUM"] = 5
        group = family.create_group("GRO")
        group.attrs["NBR"] = 1
        letters = np.frombuffer(b"probes".ljust(80), np.int8)
        group.create_dataset("NOM", (1,), dtype="80int8")[0] = letters
        for title, supports in (("TEMP", {"NOE": mesh.points @ [1.0, 2, 3]}),
                                ("SIGM", {"MAI.TE4": np.arange(3.0 * count)})):
            field = f.require_group("CHA").create_group(title, track_order=True)
            width = 3 if title == "SIGM" else 1
            for key, value in {"MAI": np.bytes_(name), "TYP": 6, "UNI": np.bytes_(""),
                               "UNT": np.bytes_("s"), "NCO": width,
                               "NOM": np.bytes_("X".ljust(16) * width)}.items():
                field.attrs[key] = value
            for t in (1, 2):
                at = field.create_group(f"{t:020d}{t:020d}")
                for key, value in {"NDT": t, "NOR": t, "PDT": t / 2, "RDT": -1, "ROR": -1}.items():
                    at.attrs[key] = value
                for support, values in supports.items():
                    on = at.create_group(support)
                    on.attrs["GAU"], on.attrs["PFL"] = np.bytes_(""), np.bytes_(
                        "MED_NO_PROFILE_INTERNAL")
                    own = on.create_group("MED_NO_PROFILE_INTERNAL")
                    own.attrs["NBR"], own.attrs["NGA"] = len(values) // width, 1
                    own.attrs["GAU"] = np.bytes_("")
                    own["CO"] = values * t


def tree(path):
    """Everything in a file: attributes, and types of tables."""
    out = {}
    with h5py.File(path) as f:
        f.visititems(lambda name, item: out.__setitem__(name, (
            {key: value.tolist() if hasattr(value, "tolist") else value
             for key, value in item.attrs.items() if key != "NBR"},
            str(item.dtype) if isinstance(item, h5py.Dataset) else "")))
    return out


def test_groups_numbers_and_fields_stay(gmsh, tmp_path):
    source, target = tmp_path / "a.med", tmp_path / "b.med"
    cube(gmsh, source)
    with_fields(source)
    optimize_file(source, target)
    assert tree(source) == tree(target)
    before, after = groups(gmsh, source), groups(gmsh, target)
    assert set(before[0]) == set(after[0]) == {(3, "steel"), (3, "bodies"), (2, "inlet")}
    assert before[0][2, "inlet"] == after[0][2, "inlet"]
    assert before[1] > 0
    assert after[1] > 0
    with h5py.File(source) as a, h5py.File(target) as b:
        name = next(iter(a["ENS_MAA"]))
        old, new = (f["ENS_MAA"][name][STEP] for f in (a, b))
        assert np.array_equal(old["NOE"]["FAM"], new["NOE"]["FAM"])
        cells = new["MAI"]["TE4"]
        numbers, family = cells["NUM"][()], cells["FAM"][()]
        assert len(set(numbers.tolist())) == len(numbers) == len(cells["NOD"]) // 4
        count = len(old["MAI"]["TE4"]["FAM"])
        assert count != len(numbers)
        of = np.flatnonzero(numbers < 700 + count)
        assert np.array_equal(family[of], old["MAI"]["TE4"]["FAM"][()][numbers[of] - 700])
        points = new["NOE"]["COO"][()].reshape((-1, 3), order="F")
        assert not np.array_equal(points, old["NOE"]["COO"][()].reshape((-1, 3), order="F"))
        assert np.array_equal(points[:9], old["NOE"]["COO"][()].reshape((-1, 3), order="F")[:9])
        for t in (1, 2):
            at = f"{t:020d}{t:020d}"
            values = b[f"CHA/TEMP/{at}/NOE/MED_NO_PROFILE_INTERNAL/CO"][()]
            assert np.allclose(values, t * points @ [1.0, 2, 3], atol=1e-12)
            own = b[f"CHA/SIGM/{at}/MAI.TE4/MED_NO_PROFILE_INTERNAL"]
            rows = own["CO"][()].reshape((-1, 3), order="F")[of]
            assert own.attrs["NBR"] == len(numbers)
            assert np.array_equal(rows[:, 0], t * (numbers[of] - 700))


def test_new_nodes_are_in_the_groups_of_the_volume_around_them(gmsh, tmp_path):
    source, target = tmp_path / "a.med", tmp_path / "b.med"
    cube(gmsh, source)
    with_fields(source)
    mesh = read_file(source)
    with h5py.File(source, "a") as f:
        name = next(iter(f["ENS_MAA"]))
        f["ENS_MAA"][name][STEP]["NOE"]["FAM"][...] = np.where(mesh.points[:, 0] <= 1, 5, 0)
    write_file(target, remesh(read_file(source), scale=0.6, free="periodic"))
    with h5py.File(target) as f:
        nodes = f["ENS_MAA"][name][STEP]["NOE"]
        points = nodes["COO"][()].reshape((3, -1)).T
        assert len(points) > len(mesh.points)
        assert np.array_equal(nodes["FAM"][()] == 5, points[:, 0] <= 1 + 1e-12)


def test_new_elements_of_all_kinds_have_numbers_that_nobody_else_has(gmsh, tmp_path):
    source, target = tmp_path / "a.med", tmp_path / "b.med"
    cube(gmsh, source)
    write_file(target, remesh(read_file(source), 0.2))
    gmsh.clear()
    gmsh.open(str(target))
    tags = np.concatenate(gmsh.model.mesh.getElements()[1])
    assert len(tags) > 500
    assert len(set(tags.tolist())) == len(tags)


def test_groups_go_to_gmsh_and_back(gmsh, tmp_path):
    cube(gmsh, tmp_path / "a.med", tmp_path / "a.msh")
    own = groups(gmsh, tmp_path / "a.med")
    for source, target in (("a.med", "b.msh"), ("a.msh", "b.med")):
        write_file(tmp_path / target, read_file(tmp_path / source))
        found = groups(gmsh, tmp_path / target)
        assert found[0] == own[0]
        assert found[1] == pytest.approx(own[1])


def test_names_of_single_letters_are_read(gmsh, tmp_path):
    cube(gmsh, tmp_path / "a.med")
    with h5py.File(tmp_path / "a.med", "a") as f:
        tables = []
        f.visititems(lambda name, item: tables.append(name) if name.endswith("NOM") else None)
        for name in tables:
            data = f[name][()].tobytes()
            del f[name]
            f[name] = np.frombuffer(data, "S1")
    assert {"steel", "bodies", "inlet"} == set(read_file(tmp_path / "a.med").cell_sets)
    optimize_file(tmp_path / "a.med", tmp_path / "b.med")
    assert {(3, "steel"), (3, "bodies"), (2, "inlet")} == set(groups(gmsh, tmp_path / "b.med")[0])


@pytest.mark.parametrize("name", ["Körper aus Stahl", "a/b", "x" * 75, "ä" * 40])
def test_names_of_any_letters_are_those_of_groups(gmsh, tmp_path, name):
    points, cells, _ = contract.grid(3, 3)
    rows = np.arange(len(cells))
    mesh = meshio.Mesh(points, [("tetra", cells)], cell_sets={
        name: [rows[:20]], "other": [rows[10:]]}, point_sets={name: np.arange(5)})
    write_file(tmp_path / "a.med", mesh)
    assert groups(gmsh, tmp_path / "a.med")[0][3, name] == 20
    back = read_file(tmp_path / "a.med")
    assert np.array_equal(back.cell_sets[name][0], rows[:20])
    assert np.array_equal(back.point_sets[name], np.arange(5))
    with h5py.File(tmp_path / "a.med") as file:
        families = [word for home in file["FAS"].values() for kind in ("ELEME", "NOEUD")
                    for word in home[kind]]
    assert len(families) == 4
    assert max(len(word.encode()) for word in families) <= 64


def test_labels_and_sets_are_families(gmsh, tmp_path):
    mesh = mesh_of_everything()
    mesh.point_sets["few"] = np.arange(5)
    write_file(tmp_path / "a.med", mesh)
    assert {name for _, name in groups(gmsh, tmp_path / "a.med")[0]} == set(mesh.field_data)
    back = read_file(tmp_path / "a.med")
    assert np.array_equal(back.point_sets["few"], np.arange(5))
    assert sorted(-np.unique(np.concatenate(back.cell_data["cell_tags"]))) == [3, 4, 7, 9]
    labelled = meshio.Mesh(mesh.points, [("tetra", mesh.cells_dict["tetra"])], cell_data={
        "material": [np.repeat([4, 6], [10, len(mesh.cells_dict["tetra"]) - 10])]})
    with pytest.warns(DataNotKeptWarning, match="the name of cell data 'material'"):
        write_file(tmp_path / "b.med", labelled)
    assert groups(gmsh, tmp_path / "b.med")[0][3, "4"] == 10


def test_files_of_meshio_are_read_as_they_are(tmp_path):
    points, cells, _ = contract.grid(3, 3)
    meshio.write(tmp_path / "a.med", meshio.Mesh(points, [("tetra", cells)]))
    back = read_file(tmp_path / "a.med")
    assert np.array_equal(back.points, points)
    assert np.array_equal(back.cells[0].data, cells)
