"""Formats with one number for each cell get labels, not the ids or colours that come before."""

from __future__ import annotations

import warnings

import meshio
import netCDF4
import numpy as np
import pytest
from contract import grid
from gmsh_sessions import session

from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.errors import DataNotKeptWarning

LABELS = {".mesh": "medit:ref", ".bdf": "nastran:ref", ".vol": "netgen:index", ".ele": "tetgen:ref",
          ".avs": "avsucd:material", ".med": "cell_tags", ".e": "exodus:block"}


def labelled(labels, name):
    points, cells, _ = grid(3, 4, 1)
    m = len(cells)
    return meshio.Mesh(points, [("tetra", cells)], cell_data={
        "vtkOriginalCellIds": [np.arange(m)], "colour": [np.full(m, 7, dtype=np.uint8)],
        name: [np.where(points[cells].mean(axis=1)[:, 0] > 0.5, *labels)]})


@pytest.mark.parametrize("name", ["material", "where"])
@pytest.mark.parametrize("suffix", sorted(LABELS))
def test_labels_are_written_before_ids(suffix, name, tmp_path):
    mesh = labelled((5, 9), name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataNotKeptWarning)
        write_file(tmp_path / f"a{suffix}", mesh)
    back = read_file(tmp_path / f"a{suffix}")
    found = np.abs(np.concatenate(back.cell_data[LABELS[suffix]]))
    places = np.concatenate([back.points[b.data].mean(axis=1)[:, 0] for b in back.cells])
    assert np.array_equal(found, np.where(places > 0.5, 5, 9))


def test_zeros_are_no_groups_of_gmsh(tmp_path):
    """Where some cells have a group Gmsh saves those alone."""
    mesh = labelled((1, 0), "material")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataNotKeptWarning)
        write_file(tmp_path / "a.msh", mesh)
    with session() as gmsh:
        gmsh.open(str(tmp_path / "a.msh"))
        gmsh.write(str(tmp_path / "b.msh"))
    back = read_file(tmp_path / "b.msh")
    assert sum(len(block.data) for block in back.cells) == len(mesh.cells[0].data)


@pytest.mark.parametrize(("suffix", "kind"), [
    (suffix, kind) for suffix in (".msh", ".inp", *sorted(LABELS))
    for kind in ("float", "truth", "column") if (suffix, kind) != (".msh", "truth")])
def test_labels_may_be_of_any_type(suffix, kind, tmp_path):
    mesh = labelled((2, 1) if suffix == ".msh" else (1, 0), "material")
    values = mesh.cell_data["material"][0]
    made = {"float": values.astype(float), "truth": values > 0, "column": values.reshape(-1, 1)}
    mesh.cell_data["material"] = [made[kind]]
    path, name = tmp_path / f"a{suffix}", LABELS.get(suffix, "gmsh:physical")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataNotKeptWarning)
        write_file(path, mesh)
    back = read_file(path)
    if suffix == ".inp":
        assert {key: sum(map(len, rows)) for key, rows in back.cell_sets.items()} == {
            "Volume0": np.sum(values == 0), "Volume1": np.sum(values)}
        return
    found = np.abs(np.concatenate(back.cell_data[name]))
    places = np.concatenate([back.points[b.data].mean(axis=1)[:, 0] for b in back.cells])
    assert len(np.unique(found[places > 0.5])) == len(np.unique(found[places < 0.5])) == 1
    assert len(np.unique(found)) == 2


@pytest.mark.parametrize("name", ["gmsh:physical", "gmsh:geometrical"])
@pytest.mark.parametrize("suffix", [".msh", *sorted(LABELS)])
def test_labels_of_more_than_32_bits_are_other_numbers_as_a_warning_says(suffix, name, tmp_path):
    """Two of them that are equal in their lower 32 bits stay two, and tools find no others."""
    labels = 2**31 + 5, 2**32 + 2**31 + 5
    mesh = labelled(labels, name)
    del mesh.cell_data["colour"], mesh.cell_data["vtkOriginalCellIds"]
    mesh.field_data = {"far": np.array([labels[0], 3])} if name == "gmsh:physical" else {}
    label = LABELS.get(suffix, name)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        write_file(tmp_path / f"a{suffix}", mesh)
    # MED has a group of this name, Exodus and AVS the array beside their blocks and materials.
    held = suffix in (".e", ".med") or (suffix, name) == (".avs", "gmsh:geometrical")
    assert held or f"cell data {name!r}" in str([w.message for w in said])
    back = read_file(tmp_path / f"a{suffix}")
    found = np.concatenate(back.cell_data[label])
    places = np.concatenate([back.points[b.data].mean(axis=1)[:, 0] for b in back.cells])
    assert {np.unique(np.abs(found[side])).tolist()[0]
            for side in (places > 0.5, places < 0.5)} == {1, 2}
    assert len(np.unique(found)) == 2
    if suffix == ".msh" and name == "gmsh:physical":
        assert back.field_data["far"][0] in np.unique(found[places > 0.5])
    if suffix == ".e":
        with netCDF4.Dataset(tmp_path / "a.e") as file:
            assert sorted(file["eb_prop1"][:].tolist()) == [1, 2]


def test_whole_numbers_that_doubles_round_are_named(tmp_path):
    mesh = labelled((2**53 + 1, 3), "dose")
    del mesh.cell_data["colour"], mesh.cell_data["vtkOriginalCellIds"]
    with pytest.warns(DataNotKeptWarning, match="the last digits of cell data 'dose'"):
        write_file(tmp_path / "a.msh", mesh)


def test_ids_are_no_blocks_of_exodus(tmp_path):
    mesh = labelled((5, 9), "material")
    del mesh.cell_data["material"], mesh.cell_data["colour"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_file(tmp_path / "a.e", mesh)
    back = read_file(tmp_path / "a.e")
    assert len(back.cells) == 1
    ids = back.cell_data["vtkOriginalCellIds"]
    assert np.array_equal(ids, mesh.cell_data["vtkOriginalCellIds"])


@pytest.mark.parametrize("suffix", [".su2", ".vol", ".mesh", ".bdf"])
def test_a_group_of_several_families_of_med_is_one_label(suffix, tmp_path):
    points, cells, _ = grid(2, 6, 1)
    space = np.pad(points, ((0, 0), (0, 1)))
    edges = np.concatenate([np.delete(cells, k, axis=1) for k in range(3)])
    sides = [edges[(points[edges][:, :, axis] == place).all(axis=1)]
             for axis, place in ((0, 0.0), (0, 1.0), (1, 0.0))]
    lines, sizes = np.concatenate(sides), [*map(len, sides)]
    side = np.repeat([0, 1, 2], sizes)
    none = np.zeros(0, dtype=np.int64)
    mesh = meshio.Mesh(space, [("triangle", cells), ("line", lines)], cell_data={
        "cell_tags": [np.full(len(cells), -4), -1 - side]}, cell_sets={
        "plate": [np.arange(len(cells)), none], "ends": [none, np.flatnonzero(side < 2)],
        "foot": [none, np.flatnonzero(side == 2)]})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataNotKeptWarning)
        write_file(tmp_path / f"a{suffix}", mesh)
    back = read_file(tmp_path / f"a{suffix}")
    label = next(back.cell_data[name][i] for name in ("su2:tag", *LABELS.values())
                 if name in back.cell_data for i, b in enumerate(back.cells) if b.type == "line")
    assert len(label) == len(lines)
    assert sorted(np.unique(label, return_counts=True)[1]) == [6, 12]
    if suffix == ".su2":
        assert {name: sum(map(len, rows)) for name, rows in back.cell_sets.items()} == {
            "ends": 12, "foot": 6}
    if suffix == ".vol":
        assert {"ends", "foot", "plate"} <= {*back.field_data}


@pytest.mark.parametrize("label", ["netgen:index", "gmsh:physical"])
@pytest.mark.parametrize("suffix", [".inp", ".e", ".med", ".su2", ".f3grid", ".vtu"])
def test_groups_of_one_name_are_one_set(suffix, label, tmp_path):
    points, cells, _ = grid(3, 3, 1)
    faces = np.concatenate([np.delete(cells, k, axis=1) for k in range(4)])
    sides = [faces[(points[faces][:, :, axis] == place).all(axis=1)]
             for axis, place in ((0, 0.0), (0, 1.0), (1, 0.0), (1, 1.0))]
    index = np.repeat([1, 2, 3, 4], [*map(len, sides)])
    mesh = meshio.Mesh(points, [("tetra", cells), ("triangle", np.concatenate(sides))], cell_data={
        label: [np.full(len(cells), 1), index]}, field_data={
        "wall": np.array([1, 2]), "inlet": np.array([2, 2]), "wall (2D)": np.array([3, 2]),
        "wall (2D, 4)": np.array([4, 2]), "steel": np.array([1, 3])})
    if "physical" in label:
        write_file(tmp_path / "a.msh", mesh, file_format="gmsh41")
        mesh = read_file(tmp_path / "a.msh")
        assert len(mesh.cell_sets) >= 5
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        write_file(tmp_path / f"a{suffix}", mesh)
    assert not any("'wall" in str(one.message) for one in told)
    back = read_file(tmp_path / f"a{suffix}")
    if suffix == ".vtu":
        assert {*back.cell_data} <= {label, "gmsh:geometrical"}
        return
    found = {name: sum(map(len, rows)) for name, rows in back.cell_sets.items()}
    sizes = {"wall": len(index) - len(sides[1]), "inlet": len(sides[1])}
    assert found == (sizes if suffix == ".su2" else sizes | {"steel": len(cells)})


def test_zeros_alone_are_no_array_that_came_back(tmp_path):
    mesh = labelled((5, 9), "material")
    m, none = len(mesh.cells[0].data), np.zeros(1, dtype=np.int64)
    mesh.cells.append(meshio.CellBlock("triangle", mesh.cells[0].data[:1, :3]))
    mesh.cell_data = {"material": [mesh.cell_data["material"][0], none],
                      "chosen": [np.arange(m) % 3 // 2, none], "nothing": [np.zeros(m, int), none]}
    with pytest.warns(DataNotKeptWarning) as told:
        write_file(tmp_path / "a.mesh", mesh)
    assert "cell data 'chosen', 'nothing', the name of cell data 'material'" in str(told[0].message)


def test_groups_of_med_are_several_whose_names_are_one_at_their_start(tmp_path):
    mesh = labelled((5, 9), "cell_tags")
    first, second = np.flatnonzero(mesh.cell_data["cell_tags"][0] == 5), np.arange(7)
    mesh.cell_sets = {90 * "a" + "1": [first], 90 * "a" + "2": [second]}
    with pytest.warns(DataNotKeptWarning):
        write_file(tmp_path / "a.med", mesh)
    back = read_file(tmp_path / "a.med").cell_sets
    assert {name: len(rows[0]) for name, rows in back.items() if name[0] == "a"} == {
        80 * "a": len(first), 78 * "a" + "_2": len(second)}
    mesh.cell_sets = {"9": [first]}
    with pytest.warns(DataNotKeptWarning):
        write_file(tmp_path / "a.med", mesh)
    back = read_file(tmp_path / "a.med").cell_sets
    assert {name: len(rows[0]) for name, rows in back.items()} == {
        "9": len(first), "9_2": len(mesh.cells[0].data) - len(first)}


@pytest.mark.parametrize("other", ["where", "region"])
@pytest.mark.parametrize("suffix", [".msh", ".inp", *sorted(LABELS)])
def test_one_number_for_all_cells_comes_after_labels(suffix, other, tmp_path):
    mesh = labelled((5, 9), other)
    mesh.cell_data = {"material": [np.full(len(mesh.cells[0].data), 3)]} | mesh.cell_data
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataNotKeptWarning)
        write_file(tmp_path / f"a{suffix}", mesh)
    back = read_file(tmp_path / f"a{suffix}")
    if suffix == ".inp":
        assert {*back.cell_sets} == ({"Volume5", "Volume9"} if other == "region" else {"Volume3"})
        return
    found = np.abs(np.concatenate(back.cell_data[LABELS.get(suffix, "gmsh:physical")]))
    assert {*found.tolist()} == ({3} if (suffix, other) == (".msh", "where") else {5, 9})


@pytest.mark.parametrize("suffix", [".msh", ".inp", ".mesh", ".vol", ".e"])
def test_numbers_that_are_too_large_are_no_labels(suffix, tmp_path):
    mesh = labelled((1e20, 1.0), "material")
    mesh.cell_data = {"material": mesh.cell_data["material"]}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", DataNotKeptWarning)
        write_file(tmp_path / f"a{suffix}", mesh)
    back = read_file(tmp_path / f"a{suffix}")
    assert not back.cell_sets
    labels = back.cell_data.get(LABELS.get(suffix, "gmsh:physical"), [np.zeros(0)])
    assert len(np.unique(np.concatenate(labels))) <= 1
