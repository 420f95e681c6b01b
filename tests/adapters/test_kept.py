"""Triangles and lines beside the cells, inside of a region: the report tells what they hold."""

from __future__ import annotations

import contract
import meshio
import numpy as np
import pytest

import odt_plugins

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
    _, report = odt_plugins.optimize_with_report(beside(points, cells, rows))
    assert report.n_movable == 0
    [note] = report.notes
    words = {2: "lines beside the triangles", 3: "triangles beside the tetrahedra"}[d]
    assert note.startswith(f"{(count == 2).sum()} {words}, inside of a region")
    assert f" {inside.sum()} vertices stay" in note
    assert "try removing those that are no" in note
    _, freed = odt_plugins.optimize_with_report(beside(points, cells, rows[count == 1]))
    assert freed.n_movable == inside.sum()
    assert freed.notes == ()


def test_a_surface_between_labels_holds_nothing_more():
    points, cells, _ = contract.grid(3, 4, 3)
    labels = (points[cells].mean(axis=1)[:, 2] > 0.5).astype(np.int64)
    a, b = (facets_of(cells[labels == i])[0] for i in (0, 1))
    both = np.array(sorted(set(map(tuple, a)) & set(map(tuple, b))))
    _, report = odt_plugins.optimize_with_report(beside(points, cells, both, labels))
    assert report.notes == ()
    assert report.regions_from == ("material",)


def test_one_triangle_inside_holds_its_cell():
    points, cells, _ = contract.grid(3, 4, 3)
    rows, count = facets_of(cells)
    inside = ((points > 0) & (points < 1)).all(axis=1)
    row = next(row for row in rows[count == 2] if inside[row].all())
    result, report = odt_plugins.optimize_with_report(beside(points, cells, row[None]))
    assert [note.partition(",")[0] for note in report.notes] == ["1 triangle beside the tetrahedra"]
    held = inside & (result.points == points).all(axis=1)
    assert f" {inside.sum() - report.n_movable} vertices stay" in report.notes[0]
    assert held[row].all()
