"""AVS's files, .avs, as VTK and meshio read them."""

from __future__ import annotations

import warnings

import meshio
import numpy as np
import pytest

from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.errors import DataNotKeptWarning, MeshFileError

POINTS = np.random.default_rng(5).random((12, 3))

CELLS = [("tetra", [[0, 1, 2, 3], [1, 2, 3, 4]]), ("triangle", [[0, 1, 2]]),
         ("pyramid", [[4, 5, 6, 7, 8]]), ("wedge", [[0, 1, 2, 6, 7, 8]]),
         ("hexahedron", [[0, 1, 2, 3, 8, 9, 10, 11]]), ("quad", [[3, 4, 5, 6]]), ("line", [[0, 9]])]


def mesh_of(kinds):
    cells = [(kind, np.array(rows)) for kind, rows in CELLS if kind in kinds]
    sizes = [len(rows) for _, rows in cells]
    return meshio.Mesh(POINTS, cells, {"a height": np.arange(12.0)}, {
        "material": [np.full(n, i + 3) for i, n in enumerate(sizes)],
        "stress": [np.arange(n) + i / 3 for i, n in enumerate(sizes)],
        "flow": [np.arange(3.0 * n).reshape(n, 3) + i for i, n in enumerate(sizes)]})


@pytest.mark.parametrize("kinds", [["tetra"], ["tetra", "triangle"], [kind for kind, _ in CELLS]])
def test_arrays_of_cells_come_back(kinds, tmp_path):
    mesh, path = mesh_of(kinds), tmp_path / "a.avs"
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataNotKeptWarning)
        write_file(path, mesh)
    back = read_file(path)
    assert [block.type for block in back.cells] == [block.type for block in mesh.cells]
    assert np.array_equal(back.points, mesh.points)
    assert np.array_equal(back.point_data["a height"], mesh.point_data["a height"])
    for i, block in enumerate(mesh.cells):
        assert np.array_equal(back.cells[i].data, block.data)
        for name, values in mesh.cell_data.items():
            assert np.array_equal(back.cell_data[name][i], values[i])
        assert np.array_equal(back.cell_data["avsucd:material"][i], mesh.cell_data["material"][i])


def test_vtk_reads_arrays_of_cells(tmp_path):
    geometry = pytest.importorskip("vtkmodules.vtkIOGeometry")
    pyvista = pytest.importorskip("pyvista")
    mesh = mesh_of(["tetra", "triangle"])
    write_file(tmp_path / "a.avs", mesh)
    reader = geometry.vtkAVSucdReader()
    reader.SetFileName(str(tmp_path / "a.avs"))
    reader.Update()
    grid = pyvista.wrap(reader.GetOutput())
    assert np.array_equal(grid.cell_data["Material Id"], np.concatenate(mesh.cell_data["material"]))
    for name in ("stress", "flow"):
        assert np.allclose(grid.cell_data[name], np.concatenate(mesh.cell_data[name]))


@pytest.mark.parametrize("bad", [np.nan, -np.inf, 1e300])
def test_numbers_with_which_vtk_crashes_are_not_written(bad, tmp_path):
    mesh = mesh_of(["tetra"])
    mesh.point_data["bad"], mesh.cell_data["worse"] = np.full(12, bad), [np.array([1.0, bad])]
    with pytest.warns(DataNotKeptWarning, match="not keep point data 'bad', cell data 'worse'"):
        write_file(tmp_path / "a.avs", mesh)
    back = read_file(tmp_path / "a.avs")
    assert {*back.point_data} == {"a height"}
    assert {*back.cell_data} == {"avsucd:material", "material", "stress", "flow"}


def test_files_of_other_tools_are_read(tmp_path):
    (tmp_path / "a.avs").write_text(
        "# a remark\n4 2 1 1 0\n10 0 0 0\n20 1.0d0 0 0\n30 0 1 0\n40 0 0 1\n"
        "7 3 tet 10 20 40 30\n9 4 tri 10 20 30\n1 1\nheat, K\n40 4\n10 1\n20 2\n30 3\n"
        "1 1\nload, N\n9 6\n7 5\n")
    mesh = read_file(tmp_path / "a.avs")
    assert [block.data.tolist() for block in mesh.cells] == [[[0, 1, 2, 3]], [[0, 1, 2]]]
    assert mesh.point_data["heat"].tolist() == [1, 2, 3, 4]
    assert [part.tolist() for part in mesh.cell_data["load"]] == [[5], [6]]
    assert [part.tolist() for part in mesh.cell_data["avsucd:material"]] == [[3], [4]]


@pytest.mark.parametrize(("lines", "words"), [
    (4, "declares 2 lines of cells and holds 1"), (2, "a line of nodes ends"),
    (7, "a line of values of nodes ends"), (1, "declares 3 lines of nodes and holds 0")])
def test_what_is_not_whole_is_refused(lines, words, tmp_path):
    text = "3 1 1 0 0\n1 0 0 0\n2 1 0 0\n3 0 1 0\n1 1 tri 1 2 3\n1 1\nheat, K\n1 4\n2 1\n3 2\n"
    rows = text.splitlines()
    if "declares" in words:
        rows = rows[: lines if lines == 1 else 5]
        rows[0] = rows[0].replace("3 1", "3 2") if lines != 1 else rows[0]
    else:
        rows[lines] = rows[lines].split()[0]
    (tmp_path / "a.avs").write_text("\n".join(rows))
    with pytest.raises(MeshFileError, match=words):
        read_file(tmp_path / "a.avs")


def test_arrays_of_one_name_are_all_there(tmp_path):
    """Also one of the name that the materials have, and one of no cells."""
    head = "3 1 2 1 0\n1 0 0 0\n2 1 0 0\n3 0 1 0\n1 1 tri 1 2 3\n"
    (tmp_path / "a.avs").write_text(
        head + "2 1 1\nd, m\nd, m\n1 4 5\n2 1 2\n3 2 2\n1 1\navsucd:material, x\n1 7\n")
    mesh = read_file(tmp_path / "a.avs")
    assert {name: values.tolist() for name, values in mesh.point_data.items()} == {
        "d": [4, 1, 2], "d_2": [5, 2, 2]}
    assert {name: values[0].tolist() for name, values in mesh.cell_data.items()} == {
        "avsucd:material": [1], "avsucd:material_2": [7]}
    none = meshio.Mesh(POINTS, [("tetra", np.zeros((0, 4), dtype=int))], {"h": np.arange(12.0)},
                       {"dose": [np.zeros(0)]})
    with pytest.warns(DataNotKeptWarning, match="'dose'"):
        write_file(tmp_path / "b.avs", none)
    assert np.array_equal(read_file(tmp_path / "b.avs").point_data["h"], none.point_data["h"])


@pytest.mark.parametrize(("old", "new", "words"), [
    ("2 1 0 0", "1 1 0 0", "2 lines of nodes 1"), ("2 5", "3 5", "2 lines of values of nodes 3")])
def test_numbers_that_are_there_twice_are_refused(old, new, words, tmp_path):
    text = "3 1 1 0 0\n1 0 0 0\n2 1 0 0\n3 0 1 0\n1 1 tri 1 3 3\n1 1\nheat, K\n1 4\n2 5\n3 2\n"
    (tmp_path / "a.avs").write_text(text.replace(old, new, 1))
    with pytest.raises(MeshFileError, match=words):
        read_file(tmp_path / "a.avs")
