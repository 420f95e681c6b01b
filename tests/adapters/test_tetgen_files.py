"""TetGen's files where vertices come and go, of second order, and made of other formats."""

from __future__ import annotations

import shutil
import subprocess
import warnings

import meshio
import numpy as np
import pytest
from boxes import box, rim

from odt_plugins import remesh
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file
from odt_plugins.errors import DataNotKeptWarning, MeshFileError

TETGEN = [[2, 3], [0, 3], [0, 1], [1, 2], [1, 3], [0, 2]]
"""Edges with a node of each row of second order, behind its corners."""

TRIANGLE = [[1, 2], [2, 0], [0, 1]]

MIDDLES = [[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]]


def raised(points, rows, edges):
    """Points, and rows with a node for each of some edges of each row."""
    known = {tuple(row): i for i, row in enumerate(points.tolist())}
    points = points.tolist()
    more = []
    for row in rows.tolist():
        for pair in edges:
            middle = tuple(np.mean([points[row[k]] for k in pair], axis=0).tolist())
            if middle not in known:
                known[middle] = len(points)
                points.append(list(middle))
            more.append(known[middle])
    return np.array(points), np.c_[rows, np.reshape(more, (len(rows), -1))]


def store(path, first=1, second=False, dim=3):
    """Write a box of two regions with markers of faces, edges and points and two attributes."""
    points, cells = box(dim, 4)
    points[abs(points[:, 0] - 0.5) < 0.12, 0] = 0.5
    free = (points > 0.0) & (points < 1.0) & (points != 0.5) & ~((points > 0) & (points < 1)).all(
        axis=1)[:, None]
    points[free] += np.random.default_rng(1).uniform(-0.1, 0.1, free.sum())
    skin = rim(cells)
    side = np.where((points[skin][:, :, 0] == 0).all(axis=1), 4, 9)
    label = np.where(points[cells].mean(axis=1)[:, 0] < 0.5, 1.0, 2.0)
    if second:
        points, cells = raised(points, cells, TETGEN if dim == 3 else TRIANGLE)
        points, skin = raised(points, skin, [[0, 1], [1, 2], [0, 2]][: 2 * dim - 3])
    mark = (np.isclose(points, 0.0) | np.isclose(points, 1.0)).any(axis=1) * 5
    tables = {
        "node": ([dim, 2, 1], [points, points[:, :1] * 2.0, points[:, 1:2] + 1.0, mark[:, None]]),
        "ele": ([cells.shape[1], 1], [cells + first, label[:, None]]),
        "face" if dim == 3 else "edge": ([1], [skin + first, side[:, None]])}
    for suffix, (counts, columns) in tables.items():
        lines = ["# by hand", " ".join(map(str, [len(columns[0]), *counts]))]
        lines += [" ".join([str(i + first), *(str(x) for part in columns for x in part[i])])
                  for i in range(len(columns[0]))]
        path.with_suffix(f".{suffix}").write_text("\n".join([*lines, "# the end"]) + "\n")
    return points, cells


def measures(points, rows):
    """Volumes, areas or lengths of simplices."""
    edges = points[rows[:, 1:]] - points[rows[:, :1]]
    gram = np.linalg.det(edges @ edges.transpose(0, 2, 1))
    return np.sqrt(np.maximum(gram, 0.0)) / (1, 1, 2, 6)[edges.shape[1]]


def check(path, dim):
    """See whether regions, sides, attributes and markers of a file are those of :func:`store`."""
    back = read_file(path)
    main, side = back.cells
    corners = (main.data[:, : dim + 1], side.data[:, :dim])
    values, marks = back.cell_data["tetgen:ref"]
    for label in (1, 2):
        assert measures(back.points, corners[0][values == label]).sum() == pytest.approx(0.5)
    for label, size in ((4, 1.0), (9, 2.0 * dim - 1.0)):
        assert measures(back.points, corners[1][marks == label]).sum() == pytest.approx(size)
    np.testing.assert_allclose(back.point_data["tetgen:attr1"], 2 * back.points[:, 0], atol=1e-12)
    np.testing.assert_allclose(back.point_data["tetgen:attr2"], back.points[:, 1] + 1, atol=1e-12)
    wall = (np.isclose(back.points, 0.0) | np.isclose(back.points, 1.0)).any(axis=1)
    assert np.array_equal(back.point_data["tetgen:ref"], 5 * wall)
    return back


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("second", [False, True])
@pytest.mark.parametrize("scale", [0.7, 1.4])
def test_other_sizes_keep_faces_edges_attributes_and_markers(dim, second, scale, tmp_path):
    first = int(scale < 1.0)
    points, cells = store(tmp_path / "a.ele", first, second, dim)
    check(tmp_path / "a.ele", dim)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataNotKeptWarning)
        write_file(tmp_path / "b.ele", remesh(read_file(tmp_path / "a.ele"), scale=scale))
    back = check(tmp_path / "b.ele", dim)
    assert (len(back.points) > len(points)) == (scale < 1.0)
    assert len(back.cells[0].data) != len(cells)
    lines = (tmp_path / "b.node").read_text().splitlines()
    assert [lines[0], lines[-1]] == ["# by hand", "# the end"]
    assert lines[2].split()[0] == str(first)
    if second:
        p, pairs = back.points[back.cells[0].data], MIDDLES[: 3 * dim - 3]
        np.testing.assert_allclose(p[:, dim + 1:], p[:, pairs].mean(axis=2), atol=1e-12)
    if dim == 3 and not second and shutil.which("tetgen"):
        told = subprocess.run(["tetgen", "-rN", str(tmp_path / "b.ele")], capture_output=True,
                              text=True, timeout=60, check=True).stdout
        assert f"Mesh tetrahedra: {len(back.cells[0].data)}" in told


def test_a_file_is_written_onto_itself_with_what_lies_beside(tmp_path):
    store(tmp_path / "a.ele")
    (tmp_path / "a.edge").write_text("1 1\n1 1 2 0\n")
    with pytest.warns(DataNotKeptWarning, match="1 cell of type line without a marker in .edge"):
        write_file(tmp_path / "a.ele", remesh(read_file(tmp_path / "a.ele"), scale=0.7))
    check(tmp_path / "a.ele", 3)
    assert (tmp_path / "a.edge").read_text() == "0 1\n"


def test_faces_that_changed_alone_are_written(tmp_path):
    store(tmp_path / "a.ele")
    mesh = read_file(tmp_path / "a.ele")
    mesh.cells[1].data[3] = mesh.cells[1].data[3, ::-1]
    write_file(tmp_path / "b.ele", mesh)
    assert np.array_equal(check(tmp_path / "b.ele", 3).cells[1].data, mesh.cells[1].data)
    assert (tmp_path / "b.node").read_bytes() == (tmp_path / "a.node").read_bytes()


def test_meshes_of_other_formats_have_their_faces_beside_and_nothing_of_before(tmp_path):
    points, cells = box(3, 4)
    skin = rim(cells)
    label = np.where(points[skin].mean(axis=1)[:, 2] == 0, 3, 8)
    mesh = meshio.Mesh(points, [("tetra", cells), ("triangle", skin), ("line", skin[:2, :2])],
                       cell_data={"marker": [np.ones(len(cells), int), label, np.array([6, 7])]})
    write_file(tmp_path / "a.vtu", mesh)
    with pytest.warns(DataNotKeptWarning, match="the name of cell data 'marker'"):
        optimize_file(tmp_path / "a.vtu", tmp_path / "b.ele")
    back = read_file(tmp_path / "b.ele")
    assert [len(b.data) for b in back.cells[1:]] == [len(skin), 2]
    for part, values in zip(back.cell_data["tetgen:ref"][1:], (label, [6, 7]), strict=True):
        assert np.array_equal(part, values)
    write_file(tmp_path / "b.ele", meshio.Mesh(points, [("tetra", cells)]))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.vtu", "b.ele", "b.node"]


def test_faces_without_a_label_get_a_marker_and_a_word(tmp_path):
    points, cells = box(3, 2)
    skin = rim(cells)
    plain = meshio.Mesh(points, [("tetra", cells), ("triangle", skin)])
    write_file(tmp_path / "a.ele", plain)
    assert set(read_file(tmp_path / "a.ele").cell_data["tetgen:ref"][1]) == {1}
    plain.cell_data["tetgen:ref"] = [np.ones(len(cells), int), np.arange(len(skin)) % 2]
    with pytest.warns(DataNotKeptWarning, match="values of cell data 'tetgen:ref' of triangle"):
        write_file(tmp_path / "a.ele", plain)
    assert set(read_file(tmp_path / "a.ele").cell_data["tetgen:ref"][1]) == {-1, 1}


@pytest.mark.parametrize("suffix", [".inp", ".bdf", ".mdpa", ".vol"])
def test_lines_of_second_order_are_written_or_counted(suffix, tmp_path):
    store(tmp_path / "a.ele", second=True, dim=2)
    with pytest.warns(DataNotKeptWarning) as told:
        write_file(tmp_path / f"b{suffix}", read_file(tmp_path / "a.ele"))
    back = read_file(tmp_path / f"b{suffix}")
    assert len(back.cells_dict["triangle6"]) == 32
    counted = "16 cells of type line3" in str(told[0].message)
    assert counted == ("line3" not in back.cells_dict) == (suffix != ".vol")


def test_a_file_without_its_points_is_told_which_are_missing(tmp_path):
    (tmp_path / "a.ele").write_text("1 4 0\n1 1 2 3 4\n")
    with pytest.raises(MeshFileError, match=(
            r"a\.ele as tetgen: it goes with a\.node, which is not there; expected that file")):
        read_file(tmp_path / "a.ele")
