"""Names of sets with letters that files have no place for: others stand there, and it is said."""

from __future__ import annotations

import warnings

import meshio
import numpy as np
import pytest
from contract import grid
from gmsh_sessions import session

from odt_plugins.adapters.files import read_file, write_file

NAMES = ('the "in" side', "two\nlines\r", "my wall", "my_wall", "two_lines_")


def five_sets(kind="tetra"):
    points, cells, _ = grid(3, 4, 1)
    rows = cells if kind == "tetra" else np.unique(np.sort(cells[:, :3], axis=1), axis=0)
    parts = np.array_split(np.arange(len(rows)), len(NAMES))
    return meshio.Mesh(points, [(kind, rows)], {'a "p"\n': points[:, 0]}, cell_sets={
        name: [part] for name, part in zip(NAMES, parts, strict=True)})


def written(mesh, path, *rest):
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        write_file(path, mesh, *rest)
    return " ".join(str(one.message) for one in heard)


def sizes(mesh):
    return sorted(sum(map(len, rows)) for rows in mesh.cell_sets.values())


@pytest.mark.parametrize("version", ["gmsh22", "gmsh41"])
def test_gmsh_and_meshio_read_all_groups(version, tmp_path):
    mesh, path = five_sets(), tmp_path / "a.msh"
    said = written(mesh, path, version)
    assert all(repr(name) in said for name in NAMES[:2])
    found = {"the _in_ side", "two_lines__2", *NAMES[2:]}
    assert set(read_file(path).field_data) == set(meshio.read(path).field_data) == found
    assert next(iter(meshio.read(path).point_data)) == "a _p__"
    with session() as gmsh:
        gmsh.open(str(path))
        groups = gmsh.model.getPhysicalGroups()
        assert {gmsh.model.getPhysicalName(*group) for group in groups} == found
        assert len(gmsh.model.mesh.getElements(3)[1][0]) == len(mesh.cells[0].data)


@pytest.mark.parametrize(("suffix", "kind"), [(".f3grid", "tetra"), (".stl", "triangle")])
def test_all_sets_come_back(suffix, kind, tmp_path):
    mesh, path = five_sets(kind), tmp_path / f"a{suffix}"
    said = written(mesh, path, None, False)
    assert repr(NAMES[1]) in said
    back = read_file(path)
    assert set(back.cell_sets) >= {"my wall", "my_wall", "two_lines__2", "two_lines_"}
    assert sizes(back) == sizes(mesh)


def test_names_of_netgen_are_lines(tmp_path):
    mesh, path = five_sets(), tmp_path / "a.vol"
    assert repr(NAMES[1]) in written(mesh, path)
    assert set(read_file(path).field_data) == {
        'the "in" side', "two_lines__2", "my wall", "my_wall", "two_lines_"}
    assert len(meshio.read(path).cells[0].data) == len(mesh.cells[0].data)


def test_markers_of_su2_whose_names_would_be_the_same_are_two(tmp_path):
    points, cells, _ = grid(3, 4, 1)
    mesh = meshio.Mesh(points, [("tetra", cells), ("triangle", cells[:5, :3])], cell_sets={
        name: [[], [i]] for i, name in enumerate(NAMES)})
    said = written(mesh, tmp_path / "a.su2")
    assert "'my wall'" in said
    back = read_file(tmp_path / "a.su2")
    assert set(back.cell_sets) == {'the_"in"_side', "two_lines__2", "my_wall_2", "my_wall",
                                   "two_lines_"}
    assert sizes(back) == [1] * 5
