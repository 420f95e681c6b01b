"""CGNS files as they are written: those who read CGNS find the elements and their sections."""

from __future__ import annotations

import boxes
import h5py
import meshio
import numpy as np
import pytest

from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.errors import DataNotKeptWarning

TETRA, TETRA10, TRIANGLE, TRIANGLE6 = 4, 11, 2, 9
"""Numbers of Gmsh."""


def by_gmsh(path):
    """Places of the corners of elements by types of Gmsh."""
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.merge(str(path))
        tags, places, _ = gmsh.model.mesh.getNodes()
        place = np.zeros((int(tags.max()) + 1, 3))
        place[tags.astype(np.int64)] = places.reshape(-1, 3)
        found = {}
        for kind in gmsh.model.mesh.getElementTypes():
            count = gmsh.model.mesh.getElementProperties(kind)[3]
            nodes = gmsh.model.mesh.getElementsByType(kind)[1]
            found[int(kind)] = place[nodes.astype(np.int64).reshape(-1, count)]
        return found
    finally:
        gmsh.finalize()


def in_order(places):
    return places[np.lexsort(places.mean(axis=1).T.round(9))]


@pytest.mark.parametrize(("dim", "order", "kinds"), [
    (3, 1, (TETRA, TRIANGLE)), (3, 2, (TETRA10,)), (2, 1, (TRIANGLE,)), (2, 2, (TRIANGLE6,))])
def test_gmsh_reads_what_is_written(dim, order, kinds, tmp_path):
    """It found no labels of nodes in what meshio writes."""
    points, cells = boxes.box(3, 2)
    if dim == 2:
        cells = boxes.rim(cells)
    if order == 2:
        points, cells = (boxes.quadratic(points, cells) if dim == 3 else (
            np.concatenate([points, points[cells].mean(axis=1)]), np.concatenate(
                [cells, np.repeat(len(points) + np.arange(len(cells)), 3).reshape(-1, 3)], axis=1)))
    name = {4: "tetra", 10: "tetra10", 3: "triangle", 6: "triangle6"}[cells.shape[1]]
    blocks = [(name, cells)] + [("triangle", boxes.rim(cells))] * (len(kinds) > 1)
    write_file(tmp_path / "a.cgns", meshio.Mesh(points, blocks))
    found = by_gmsh(tmp_path / "a.cgns")
    assert set(found) == {*kinds}
    for kind, (_, rows) in zip(kinds, blocks, strict=True):
        corners = {TETRA10: [*range(8), 9, 8]}.get(kind, [*range(rows.shape[1])])
        assert np.array_equal(in_order(found[kind]), in_order(points[rows[:, corners]]))


def test_sets_are_sections_of_any_names(tmp_path):
    points, cells = boxes.box(3, 2)
    faces = boxes.rim(cells)
    left = np.flatnonzero(points[cells].mean(axis=1)[:, 0] < 0.5)
    right = np.setdiff1d(np.arange(len(cells)), left)
    none = np.zeros(0, dtype=np.int64)
    names = ["oil é", "x" * 40, "in/out", "GridCoordinates"]
    sets = [[left, none], [right, none], [none, np.arange(9)], [none, np.arange(9, 20)]]
    mesh = meshio.Mesh(points, [("tetra", cells), ("triangle", faces)],
                       cell_sets=dict(zip(names, sets, strict=True)))
    with pytest.warns(DataNotKeptWarning, match="cell sets 'GridCoordinates', 'in/out', 'xx"):
        write_file(tmp_path / "a.cgns", mesh)
    back = read_file(tmp_path / "a.cgns")
    there = ["oil é", "x" * 32, "in_out", "GridCoordinates 2"]
    assert sorted(back.cell_sets) == sorted(there)
    for name, (inside, on) in zip(there, sets, strict=True):
        own = [block.data[rows] for block, rows in zip(back.cells, back.cell_sets[name],
                                                       strict=True) if len(rows)]
        assert len(own) == 1
        assert np.array_equal(own[0], cells[inside] if len(inside) else faces[on])
    assert len(by_gmsh(tmp_path / "a.cgns")[TRIANGLE]) == len(faces)


def test_cells_of_the_greatest_dimension_are_counted_and_come_first(tmp_path):
    """Older readers of VTK take sections behind as many cells as a zone has for its boundary."""
    points, cells = boxes.box(3, 2)
    blocks = [("triangle", boxes.rim(cells)), ("tetra", cells)]
    write_file(tmp_path / "a.cgns", meshio.Mesh(points, blocks))
    with h5py.File(tmp_path / "a.cgns") as file:
        zone = file["Base/Zone1"]
        assert zone[" data"][()].ravel().tolist() == [len(points), len(cells), 0]
        assert zone["GridElements/ElementRange"][" data"][()].tolist() == [1, len(cells)]


def test_cells_of_several_types_and_blocks_have_the_sets_that_they_had(tmp_path):
    points, cells = boxes.box(3, 2)
    wedges = np.array([[*cells[0], *cells[1][:2]]])
    write_file(tmp_path / "a.cgns", meshio.Mesh(points, [("tetra", cells), ("wedge", wedges)]))
    assert read_file(tmp_path / "a.cgns").cell_sets == {}
    mesh = meshio.Mesh(points, [("tetra", cells[:9]), ("tetra", cells[9:])],
                       cell_sets={"some": [np.arange(4), np.arange(3)]})
    write_file(tmp_path / "b.cgns", mesh)
    back = read_file(tmp_path / "b.cgns")
    assert [*back.cell_sets] == ["some"]
    assert sum(map(len, back.cell_sets["some"])) == 7


def test_meshio_reads_tetrahedra(tmp_path):
    points, cells = boxes.box(3, 2)
    write_file(tmp_path / "a.cgns", meshio.Mesh(points, [("tetra", cells)]))
    back = meshio.read(tmp_path / "a.cgns")
    assert np.array_equal(back.points, points)
    assert np.array_equal(back.cells_dict["tetra"], cells)


def test_small_sets_are_whole_beside_one_of_everything(tmp_path):
    """A set of all cells, if it was the first, left nothing to the others."""
    points, cells = boxes.box(3, 2)
    left = points[cells].mean(axis=1)[:, 0] < 0.5
    sets = {"all": np.arange(len(cells)), "left": np.flatnonzero(left),
            "odd": np.arange(1, len(cells) - 1), "right": np.flatnonzero(~left)}
    mesh = meshio.Mesh(points, [("tetra", cells)],
                       cell_sets={name: [rows] for name, rows in sets.items()})
    with pytest.warns(match="cell sets 'all', 'odd'"):
        write_file(tmp_path / "a.cgns", mesh)
    back = read_file(tmp_path / "a.cgns")
    sizes = {name: sum(len(rows) for rows in members) for name, members in back.cell_sets.items()}
    assert sizes == {"left": left.sum(), "right": (~left).sum()}
