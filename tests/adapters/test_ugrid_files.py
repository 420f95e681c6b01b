"""AFLR's UGRID files: all digits, numbers of boundaries, and records that Fortran reads."""

from __future__ import annotations

import contract
import meshio
import numpy as np
import pytest

from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file
from odt_plugins.errors import DataNotKeptWarning, MeshFileError


def box():
    """Tetrahedra at odd places with two boundaries, beside a pyramid whose base is another."""
    points, cells, _ = contract.grid(3, 2)
    points = points / 3 + np.random.default_rng(5).uniform(-0.03, 0.03, points.shape)
    rim = np.array(sorted(contract.facets(cells, np.zeros(len(cells), dtype=int))))
    n = len(points)
    points = np.vstack([points, [[3, 0, 0], [4, 0, 0], [4, 1, 0], [3, 1, 0], [3.5, 0.5, 1 / 3]]])
    ref = np.where(points[rim][:, :, 2].mean(axis=1) < 0.1, 1, 2)
    return meshio.Mesh(
        points, [("triangle", rim), ("quad", [np.arange(4) + n]), ("tetra", cells),
                 ("pyramid", [np.arange(5) + n])],
        cell_data={"ugrid:ref": [ref, np.array([7]), np.zeros(len(cells), int), np.array([0])]})


def tables(mesh):
    return {block.type: (block.data.tolist(), mesh.cell_data["ugrid:ref"][i].tolist())
            for i, block in enumerate(mesh.cells)}


@pytest.mark.parametrize("kind", ["", ".b8", ".lb8", ".b8l", ".r8", ".lr8", ".lb4", ".r4"])
def test_all_forms_hold_the_same(kind, tmp_path):
    mesh = box()
    if kind.endswith("4"):
        mesh.points = mesh.points.astype(np.float32)
    write_file(tmp_path / f"a{kind}.ugrid", mesh)
    back = read_file(tmp_path / f"a{kind}.ugrid")
    assert np.array_equal(back.points, mesh.points)
    assert tables(back) == tables(mesh)
    if "r" not in kind:
        assert np.allclose(meshio.read(tmp_path / f"a{kind}.ugrid").points, mesh.points)
    else:
        data, order = (tmp_path / f"a{kind}.ugrid").read_bytes(), "<" if "l" in kind else ">"
        sizes, at = [], 0
        while at < len(data):
            sizes.append(np.frombuffer(data, order + "u4", 1, at)[0])
            at += sizes[-1] + 8
            assert np.frombuffer(data, order + "u4", 1, at - 4)[0] == sizes[-1]
        assert (len(sizes), sizes[0]) == (2, 28)


def test_points_that_stay_keep_all_digits_of_a_text(tmp_path):
    mesh = box()
    write_file(tmp_path / "a.ugrid", mesh)
    text = (tmp_path / "a.ugrid").read_text()
    (tmp_path / "a.ugrid").write_text(text.replace("0.0\n", "0.0D+0\r\n"))
    optimize_file(tmp_path / "a.ugrid", tmp_path / "b.ugrid")
    old, new = read_file(tmp_path / "a.ugrid"), read_file(tmp_path / "b.ugrid")
    assert np.array_equal(old.points, mesh.points)
    assert np.array_equal(new.points[np.unique(new.cells[0].data)],
                          mesh.points[np.unique(mesh.cells[0].data)])
    assert np.bincount(tables(new)["triangle"][1]).tolist() == np.bincount(
        tables(mesh)["triangle"][1]).tolist()


def test_other_cells_are_named_where_they_are_lost(tmp_path):
    mesh = box()
    mesh = meshio.Mesh(mesh.points, [*mesh.cells, ("line", [[0, 1]]), ("vertex", [[0]])])
    with pytest.warns(DataNotKeptWarning, match="1 cell of type vertex, 1 cell of type line"):
        write_file(tmp_path / "a.ugrid", mesh)


@pytest.mark.parametrize("kind", ["", ".lb8", ".r4"])
def test_cut_files_and_points_that_are_not_there_are_refused(kind, tmp_path):
    path, mesh = tmp_path / f"a{kind}.ugrid", box()
    mesh.points = mesh.points.astype(np.float32)
    write_file(path, mesh)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(MeshFileError, match="it ends too early; expected a complete file"):
        read_file(path)
    path.write_text("3 1 0 0 0 0 0\n0 0 0\n1 0 0\n0 1 0\n1 2 4\n1\n")
    if not kind:
        with pytest.raises(MeshFileError, match="a triangle refers to point 4 of 3"):
            read_file(path)
