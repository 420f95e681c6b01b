"""Between formats: what other readers do not see is in one warning, by its name, and no more."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import meshio
import numpy as np
import pytest
import trimesh
from contract import grid
from labelled_meshes import mesh_with_everything

from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.errors import DataNotKeptWarning, MeshFileError
from odt_plugins.generate import uniform_refine

SUFFIXES = (".vtu", ".vtk", ".vtp", ".msh", ".e", ".med", ".vol", ".mesh", ".obj", ".ply", ".off",
            ".stl", ".su2", ".xdmf", ".inp")
SOLID = (".vtp", ".obj", ".ply", ".off", ".stl")
"""Formats without tetrahedra."""

UNKNOWN = (".e", ".med", ".su2")
"""Formats of which meshio knows no names of groups; tests of their own read these otherwise."""


def by_name(mesh):
    """Values of all arrays, sorted, and numbers of members of all sets, by kind and name."""
    def ordered(parts):
        parts = [np.asarray(part).astype(float) for part in parts]
        whole = np.concatenate([p.reshape(len(p), -1) for p in parts if p.size])
        return np.sort(whole, axis=0)

    def size(parts):
        return np.array([sum(np.size(part) for part in parts if part is not None)])

    groups = {name for name, value in mesh.field_data.items()
              if np.shape(value) == (2,) and np.asarray(value).dtype.kind in "iu"}
    out = {("point_data", n): ordered([v]) for n, v in mesh.point_data.items()}
    out |= {("cell_data", n): ordered(v) for n, v in mesh.cell_data.items()}
    out |= {("field_data", n): ordered([np.ravel(v)]) for n, v in mesh.field_data.items()
            if n not in groups}
    out |= {("group", n): np.zeros(0) for n in groups}
    out |= {("point_sets", n): size([v]) for n, v in mesh.point_sets.items()}
    return out | {("cell_sets", n): size(v) for n, v in mesh.cell_sets.items()}


def by_pyvista(path):
    """What pyvista reads, in meshio's form without sets."""
    pyvista = pytest.importorskip("pyvista")
    grid = pyvista.read(path)
    field = {name: np.asarray(grid.field_data[name]) for name in grid.field_data.keys()}
    made = meshio.Mesh(np.asarray(grid.points), [], dict(grid.point_data.items()),
                       field_data=field)
    made.cell_data = {name: [np.asarray(v)] for name, v in grid.cell_data.items()}
    return made


def seen_by_others(path):
    """The mesh as another reader has it, if one reads such a file."""
    if path.suffix in (".vtu", ".vtk", ".vtp"):
        return by_pyvista(path)
    if path.suffix in UNKNOWN:
        return read_file(path)
    try:
        return meshio.read(path)
    except (Exception, SystemExit):
        return read_file(path)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("dim", [2, 3])
def test_each_loss_is_in_one_warning_by_its_name_and_nothing_else(dim, suffix, tmp_path):
    mesh, path = mesh_with_everything(dim), tmp_path / f"out{suffix}"
    if dim == 3 and suffix in SOLID:
        with pytest.raises(MeshFileError, match="try another format such as"):
            write_file(path, mesh)
        assert not list(tmp_path.iterdir())
        return
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        write_file(path, mesh)
    said = [str(w.message) for w in caught if w.category is DataNotKeptWarning]
    assert len(said) == 1
    for name in ("steel", "corner", "half", "density", "times", "node number"):
        assert len(re.findall(f"'{name}'", said[0])) <= 1
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        back = by_name(seen_by_others(path))
    everything = {name: values for (_, name), values in back.items()}
    for (kind, name), values in by_name(mesh).items():
        found = back.get((kind, name))
        if f"the name of {kind.replace('_', ' ')} {name!r} (there" in said[0]:
            assert found is None
            continue
        if kind == "group":
            kept = name in everything
        elif found is None and kind == "cell_data" and name == "gmsh:physical":
            kept = {"steel", "air", "skin"} <= set(everything)
        else:
            kept = found is not None and np.array_equal(found, values)
        assert kept == (f"'{name}'" not in said[0]), (kind, name, said[0])


@pytest.mark.parametrize("suffix", [".obj", ".off", ".ply", ".stl"])
def test_a_mesh_of_two_coordinates_goes_into_formats_of_surfaces(suffix, tmp_path):
    points, cells, _ = grid(2, 4, 1)
    write_file(tmp_path / f"a{suffix}", meshio.Mesh(points, [("triangle", cells)]))
    seen = trimesh.load(tmp_path / f"a{suffix}", process=False)
    assert np.array_equal(np.unique(seen.triangles, axis=0).shape, (len(cells), 3, 3))
    np.testing.assert_allclose(seen.area, 1, atol=1e-6)


def test_labels_without_entities_are_groups_as_gmsh_sees_them(tmp_path):
    gmsh = pytest.importorskip("gmsh")
    mesh = mesh_with_everything(3)
    mesh.cell_sets, mesh.point_sets = {}, {}
    with pytest.warns(DataNotKeptWarning, match="'times'"):
        write_file(tmp_path / "a.msh", mesh)
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.open(str(tmp_path / "a.msh"))
        sizes = {gmsh.model.getPhysicalName(*group): sum(
            len(rows) for entity in gmsh.model.getEntitiesForPhysicalGroup(*group)
            for rows in gmsh.model.mesh.getElements(group[0], entity)[1])
            for group in gmsh.model.getPhysicalGroups()}
    finally:
        gmsh.finalize()
    assert sizes == {"steel": 192, "air": 192, "skin": 32}


def lost(path, mesh):
    """What the one warning says that a file does not keep."""
    with pytest.warns(DataNotKeptWarning, match="does not keep") as caught:
        write_file(path, mesh)
    assert len(caught) == 1
    return str(caught[0].message).partition("does not keep ")[2]


@pytest.mark.parametrize("suffix", [".mesh", ".su2", ".inp"])
def test_vertices_as_cells_are_left_out_by_name(suffix, tmp_path):
    points, cells, _ = grid(3, 2, 1)
    mesh = meshio.Mesh(points, [("vertex", [[0], [1]]), ("tetra", cells)])
    assert lost(tmp_path / f"a{suffix}", mesh).startswith("2 cells of type vertex; try")
    assert [b.type for b in read_file(tmp_path / f"a{suffix}").cells] == ["tetra"]


def test_arrays_that_gmsh_does_not_know_are_left_out_by_name(tmp_path):
    points, cells, _ = grid(2, 2, 1)
    mesh = meshio.Mesh(points, [("triangle", cells)], {"pair": points, "flow": points[:, :1]},
                       {"texcoord": [np.zeros((len(cells), 6))]})
    assert lost(tmp_path / "a.msh", mesh).startswith(
        "point data 'pair', cell data 'texcoord'; try")
    assert np.array_equal(read_file(tmp_path / "a.msh").point_data["flow"], points[:, 0])


@pytest.mark.parametrize("suffix", [".e", ".ply", ".med", ".vtu"])
def test_arrays_of_one_column_keep_their_names(suffix, tmp_path):
    points, cells, _ = grid(2, 2, 1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        write_file(tmp_path / f"a{suffix}", meshio.Mesh(
            np.c_[points, 0 * points[:, 0]], [("triangle", cells)], {"u[0]": points[:, :1]}))
    assert np.array_equal(read_file(tmp_path / f"a{suffix}").point_data["u[0]"], points[:, 0])


def test_materials_of_netgen_are_groups_of_gmsh(tmp_path):
    points, cells, labels = grid(3, 2, 1)
    mesh = meshio.Mesh(points, [("tetra", cells)],
                       cell_data={"netgen:index": [(labels > 0) + 1]},
                       field_data={"steel": np.array([1, 3]), "air": np.array([2, 3])})
    assert "the name of cell data 'netgen:index'" in lost(tmp_path / "a.msh", mesh)
    back = read_file(tmp_path / "a.msh")
    assert np.array_equal(np.sort(back.cell_data["gmsh:physical"][0]), np.sort((labels > 0) + 1))
    assert {*back.field_data} == {"steel", "air"}


def test_triangles_in_space_are_refused_by_su2_in_words(tmp_path):
    ball = trimesh.creation.icosphere(1)
    with pytest.raises(MeshFileError, match="no triangles in space, only those of the plane"):
        write_file(tmp_path / "a.su2", meshio.Mesh(ball.vertices, [("triangle", ball.faces)]))


def test_a_set_that_grew_has_lost_nothing():
    from odt_plugins.adapters.comparing import not_kept

    points, cells, _ = grid(2, 3)
    def mesh(nodes, rows, order):
        back = np.argsort(order)
        return meshio.Mesh(points[order], [("triangle", back[cells])], cell_sets={"c": [rows]},
                           point_sets={"p": nodes})

    for order in (np.arange(16), np.random.default_rng(2).permutation(16)):
        at = np.argsort(order)
        before = mesh(np.arange(5), np.arange(3), np.arange(16))
        assert not not_kept(before, mesh(at[[0, 4, 3, 2, 1, 9]], np.arange(4), order))
        lost = not_kept(before, mesh(at[[0, 4, 3, 2, 9, 8]], np.arange(1, 7), order))
        assert lost == ["5 members of point set 'p' (there 6)",
                        "3 members of cell set 'c' (there 6)"]


SAYING = {
    "a.inp": ("*NODE\n1,0.,0.\n2,1.,0.\n3,0.,1.\n4,1.,1.\n*ELEMENT,TYPE=CPE3,ELSET=E\n1,1,2,3\n"
              "2,2,4,3\n*ELEMENT,TYPE=MASS\n5,1\n*SOLID SECTION,ELSET=E\n*STEP\n*CLOAD\n4,1,1.\n"
              "*END STEP\n", ["*CLOAD", "*ELEMENT of type CPE3", "*ELEMENT of type MASS",
                              "*SOLIDSECTION", "*STEP"]),
    "a.bdf": ("SOL 101\nBEGIN BULK\nGRID,1,,0.,0.,0.\nGRID,2,,1.,0.,0.\nGRID,3,,0.,1.,0.\n"
              "CTRIA3,1,1,1,2,3\nPSHELL,1,1,.1\nFORCE,1,3,0,1.,1.\nCELAS2,9,1.,1,1\nENDDATA\n",
              ["CASE CONTROL", "CELAS2", "FORCE", "PSHELL"]),
    "a.mdpa": ("Begin Properties 1\n RHO 7.\nEnd Properties\nBegin Nodes\n1 0. 0. 0.\n2 1. 0. 0."
               "\n3 0. 1. 0.\nEnd Nodes\nBegin Elements Element2D3N\n1 1 1 2 3\nEnd Elements\n",
               ["Properties"]),
    "a.mesh": ("MeshVersionFormatted 2\nDimension 2\nVertices 3\n0 0 1\n1 0 1\n0 1 1\nTriangles 1\n"
               "1 2 3 4\nCorners 1\n2\nEnd\n", ["Corners"]),
}
"""Files, and what they say that no mesh holds."""


@pytest.mark.parametrize("name", SAYING)
def test_what_a_file_says_besides_its_mesh_is_named_where_another_is_written(name, tmp_path):
    text, said = SAYING[name]
    (tmp_path / name).write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DataNotKeptWarning)
        mesh = read_file(tmp_path / name)
    with pytest.warns(DataNotKeptWarning, match=re.escape(", ".join(said))):
        write_file(tmp_path / "b.vtu", mesh)
    del mesh.read_from
    with pytest.warns(DataNotKeptWarning, match=re.escape(", ".join(said))):
        write_file(tmp_path / f"c.{name.split('.')[1]}", mesh)


@pytest.mark.parametrize("name", SAYING)
def test_what_a_file_says_besides_its_mesh_stays_where_that_is_refined(name, tmp_path):
    text, said = SAYING[name]
    (tmp_path / name).write_text(text)
    out = tmp_path / f"b{Path(name).suffix}"
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        given = uniform_refine(uniform_refine(read_file(tmp_path / name)))
        write_file(out, given)
        back = read_file(out)
    assert not [str(told.message) for told in caught if "not keep" in str(told.message)]
    lines = text.splitlines()
    for word in said:
        key = word.removeprefix("*").partition(" of type ")[2] or word
        own = {"CASE CONTROL": "SOL 101", "*SOLIDSECTION": "*SOLID SECTION"}.get(key, key)
        assert next(line for line in out.read_text().splitlines() if own in line) in lines
    np.testing.assert_allclose(back.points[:, :2], given.points[:, :2], atol=1e-15)
    np.testing.assert_array_equal(back.cells[0].data, given.cells[0].data)


@pytest.mark.parametrize("suffix", [".med", ".vol"])
def test_cells_beside_that_a_format_does_not_hold_are_told_in_a_sentence(suffix, tmp_path):
    """The error said 'quad9' and nothing else."""
    points = np.random.default_rng(7).random((9, 3))
    mesh = meshio.Mesh(points, [("triangle6", [[0, 1, 2, 3, 4, 5]]), ("quad9", [range(9)])])
    with pytest.raises(MeshFileError, match="it holds no cells of type quad9"):
        write_file(tmp_path / f"a{suffix}", mesh)
