"""Triangles and lines beside the cells, inside of a region: the report tells what they hold."""

from __future__ import annotations

import re

import boxes
import contract
import meshio
import numpy as np
import pytest

import odt_plugins
from odt_plugins.adapters.host import KeptCells, each_once
from odt_plugins.errors import InvalidOptionError

FACETS = {2: ("triangle", "line"), 3: ("tetra", "triangle")}


def facets_of(cells):
    rows = [np.delete(cells, i, axis=1) for i in range(cells.shape[1])]
    return np.unique(np.sort(np.concatenate(rows), axis=1), axis=0, return_counts=True)


def beside(points, cells, rows, labels=None):
    kind, other = FACETS[points.shape[1]]
    data = {}
    if labels is not None:
        data = {"material": [labels, np.zeros(len(rows), dtype=np.int64)]}
    return meshio.Mesh(points, [(kind, cells), (other, rows)], cell_data=data)


@pytest.mark.parametrize("d", [2, 3])
def test_facets_inside_tell_what_they_hold_and_how_to_free_it(d):
    points, cells, _ = contract.grid(d, 4, 3)
    rows, count = facets_of(cells)
    inside = ((points > 0) & (points < 1)).all(axis=1)
    mesh = beside(points, cells, rows)
    _, report = odt_plugins.optimize_with_report(mesh)
    assert report.n_movable == 0
    [note] = report.notes
    words = {2: "lines beside the triangles", 3: "triangles beside the tetrahedra"}[d]
    assert note.startswith(f"{(count == 2).sum()} {words}, inside of a region")
    assert f"stay with {inside.sum()} vertices; try free='inside'" in note
    assert all('free="inside"' in cell.hint for cell in report.binding if cell.hint)
    result, freed = odt_plugins.optimize_with_report(mesh, free="inside")
    assert freed.n_movable == inside.sum()
    assert freed.after.mean_quality > freed.before.mean_quality
    assert "remain faces of cells" in freed.notes[0]
    assert set(map(tuple, np.sort(result.cells[1].data, axis=1).tolist())) == faces_of(result)
    _, bare = odt_plugins.optimize_with_report(beside(points, cells, rows[count == 1]))
    assert bare.notes == ()


@pytest.mark.parametrize("d", [2, 3])
def test_vertices_that_stay_for_another_reason_are_not_counted_with_facets_inside(d):
    """A point with a cell of its own, and one that is in no cell."""
    points, cells, _ = contract.grid(d, 5, 3)
    rows, count = facets_of(cells)
    inside = ((points > 0) & (points < 1)).all(axis=1)
    rows = rows[count == 2][inside[rows[count == 2]].all(axis=1)][:1]
    other = np.setdiff1d(np.flatnonzero(inside), rows)[:1]
    mesh = beside(np.concatenate([points, points[:1] + 5.0]), cells, rows)
    mesh = meshio.Mesh(mesh.points, [*mesh.cells, ("vertex", other[:, None])])
    _, report = odt_plugins.optimize_with_report(mesh)
    assert f"stays with {d} vertices" in " ".join(report.notes)


def test_a_surface_between_labels_holds_nothing_more():
    points, cells, _ = contract.grid(3, 4, 3)
    labels = (points[cells].mean(axis=1)[:, 2] > 0.5).astype(np.int64)
    a, b = (facets_of(cells[labels == i])[0] for i in (0, 1))
    both = np.array(sorted(set(map(tuple, a)) & set(map(tuple, b))))
    _, report = odt_plugins.optimize_with_report(beside(points, cells, both, labels))
    assert report.notes == ()
    assert report.regions_from == ("material",)


def faces_of(mesh):
    return set(map(tuple, facets_of(mesh.cells[0].data)[0].tolist()))


@pytest.mark.parametrize("where", ["middle", "across"])
@pytest.mark.parametrize("options", [{}, {"insert": True}, {"boundary": "slide"}])
@pytest.mark.parametrize("inside", [(), "inside"])
def test_a_sheet_inside_holds_its_own_vertices_alone(inside, options, where):
    points, cells, _ = contract.grid(3, 4, 3)
    rows, _ = facets_of(cells)
    layer = rows[(rows % 5 == 2).all(axis=1)]
    centre = abs(points[layer].mean(axis=1)[:, :2] - 0.5).max(axis=1)
    sheet = layer[centre < (0.25 if where == "middle" else 1.0)]
    mesh = beside(points, cells, sheet)
    result, report = odt_plugins.optimize_with_report(mesh, free=inside, **options)
    new = result.cells[1].data
    assert len(new) == len(sheet)
    assert set(map(tuple, np.sort(new, axis=1).tolist())) <= faces_of(result)
    held = np.unique(sheet)
    moved = (result.points[np.unique(new)] != points[held]).any(axis=1)
    inner = ((points > 0) & (points < 1)).all(axis=1)
    assert moved.any() == bool(inside)
    if not inside or options.get("boundary") != "slide":
        assert not moved[~inner[held]].any()
    free = inner.copy()
    if not inside:
        free[held] = False
    if not options.get("boundary"):
        assert report.n_movable == free.sum()
    assert report.after.min_quality >= report.before.min_quality


@pytest.mark.parametrize("boundary", ["fixed", "slide"])
def test_lines_inside_of_tetrahedra_stay_where_triangles_inside_are_free(boundary):
    points, cells, _ = contract.grid(3, 4, 3)
    rows, _ = facets_of(cells)
    mesh = beside(points, cells, rows[(rows % 5 == 2).all(axis=1)])
    inner = ((points > 0.0) & (points < 1.0)).all(axis=1)
    edges = np.sort(cells[:, :2], axis=1)
    wire = edges[inner[edges].all(axis=1) & (edges % 5 != 2).all(axis=1)][:4]
    mesh = meshio.Mesh(points, [*mesh.cells, ("line", wire)])
    result = odt_plugins.optimize(mesh, free="inside", boundary=boundary)
    held = np.unique(wire)
    assert np.array_equal(result.points[held], points[held])
    assert (result.points != points)[inner].any()


def test_values_of_a_field_come_across_triangles_that_moved():
    points, cells, _ = contract.grid(3, 4, 3)
    mesh = beside(points, cells, facets_of(cells)[0])
    mesh.point_data["u"] = points @ [1.0, -2.0, 0.5]
    result = odt_plugins.optimize(mesh, free="inside")
    assert (result.points != points).any()
    assert np.allclose(result.point_data["u"], result.points @ [1.0, -2.0, 0.5], atol=1e-12)


def test_a_mesh_of_cells_untangled_with_a_sheet_keeps_its_triangles():
    points, cells, _ = contract.grid(3, 4, 3)
    rows, _ = facets_of(cells)
    inner = ((points > 0.0) & (points < 1.0)).all(axis=1)
    sheet = rows[(rows % 5 == 2).all(axis=1)]
    free = np.setdiff1d(np.flatnonzero(inner), sheet)
    points[free[0]] = points[free[1]]
    result, report = odt_plugins.optimize_with_report(beside(points, cells, sheet))
    assert report.untangled["left"] == 0
    held = np.unique(sheet)
    assert np.array_equal(result.points[held], points[held])
    assert set(map(tuple, np.sort(result.cells[1].data, axis=1).tolist())) <= faces_of(result)


def test_remeshing_keeps_the_triangles_of_a_sheet_inside():
    points, cells, _ = contract.grid(3, 4, 3)
    rows, _ = facets_of(cells)
    layer = rows[(rows % 5 == 2).all(axis=1)]
    centre = abs(points[layer].mean(axis=1)[:, :2] - 0.5).max(axis=1)
    mesh = beside(points, cells, layer[centre < 0.25])
    result = odt_plugins.remesh(mesh, 0.15)
    assert len(result.points) > 3 * len(points)
    new = np.sort(result.cells[1].data, axis=1)
    assert len(new) == len(mesh.cells[1].data)
    assert set(map(tuple, new.tolist())) <= faces_of(result)
    with pytest.raises(InvalidOptionError, match=r"free='inside' for remeshing.*\['periodic', 'la"):
        odt_plugins.remesh(mesh, 0.15, free="inside")
    for given, advice in (({"inside": True}, ", and free='inside' is for optimize alone"),
                          ({"layer": True}, ", try free='layers'"),
                          ({"sise": 0.1}, ", did you mean 'size'?"), ({"insrt": True}, "]")):
        with pytest.raises(InvalidOptionError, match=f"'progress'\\]?{re.escape(advice)}$"):
            odt_plugins.remesh(mesh, 0.15, **given)


def test_rows_that_are_there_twice_are_parted_into_groups_that_follow_their_classes():
    rows = np.array([[0, 1], [1, 2], [1, 0], [3, 4], [2, 1], [0, 1]])
    classes = np.array([5, 9, 7, 5, 4, 6])
    groups = each_once(KeptCells("line", rows, classes))
    assert [own.tolist() for _, own in groups] == [[0, 3, 4], [1, 5], [2]]
    for cells, own in groups:
        assert np.array_equal(cells.rows, rows[own])
        assert np.array_equal(cells.classes, classes[own])
    assert each_once(KeptCells("line", rows[:0], classes[:0])) == []


def test_a_triangle_inside_leaves_the_interface_between_labels_to_be_resized():
    points, cells = boxes.box(3, 8, plane=0.5)
    centres = points[cells].mean(axis=1)
    labels = (centres[:, 0] > 0.5).astype(int)
    one = cells[[np.linalg.norm(centres - [0.8, 0.5, 0.5], axis=1).argmin()], :3]
    counts = []
    for rows in (cells[:0, :3], one):
        result = odt_plugins.remesh(beside(points, cells, rows, labels), scale=2, free="periodic")
        sides = [result.cells[0].data[result.cell_data["material"][0] == label] for label in (0, 1)]
        counts.append(len(np.intersect1d(*sides)))
    assert counts[0] < 50
    assert abs(counts[1] - counts[0]) < 5
