"""Sizes near edges that are never cut: those of cells and boundaries that stay."""

from dataclasses import replace

import boxes
import numpy as np
import pytest
from tet_meshes import dihedral_angles, oriented, signed_volumes

import odt_plugins
from odt_plugins.engine.remesh import run
from odt_plugins.engine.remesh.number import factor_for
from odt_plugins.engine.remesh.sizes import STEEP, local_sizes, wanted_sizes
from odt_plugins.engine.remesh.whole import beside_whole
from odt_plugins.engine.remesh.wish import Wish
from odt_plugins.engine.run.outcome import unchanged
from odt_plugins.errors import InvalidMeshError
from odt_plugins.mesh.simplex import freeze, simplex_mesh


def wedge(length=2.0, n=16, layers=4):
    """A body between two planes that meet at .05 / length, n by layers, three cells a prism."""
    x = np.linspace(0.0, length, n + 1)[:-1]
    flat = np.concatenate([np.column_stack([x, 0 * x]),
                           np.column_stack([x, 0.05 * (1.0 - x / length)]), [[length, 0.0]]])
    i = np.arange(n - 1)
    prisms = np.sort(np.concatenate([
        np.column_stack([i, i + 1, i + n + 1]), np.column_stack([i, i + n + 1, i + n]),
        [[n - 1, 2 * n, 2 * n - 1]]]), axis=1)
    points = np.concatenate([np.column_stack([flat, np.full(len(flat), z)])
                             for z in np.linspace(0.0, 1.0, layers + 1)])
    cells = []
    for k in range(layers):
        low, high = prisms + k * len(flat), prisms + (k + 1) * len(flat)
        cells += [np.column_stack([low, high[:, 2]]), np.column_stack([low[:, :2], high[:, 1:]]),
                  np.column_stack([low[:, :1], high])]
    return points, oriented(points, np.concatenate(cells))


def facets(points, cells):
    """Facets of one cell alone, as the places of their corners."""
    rows = np.sort(np.concatenate([np.delete(cells, i, axis=1) for i in range(4)]), axis=1)
    unique, count = np.unique(rows, axis=0, return_counts=True)
    return {frozenset(map(tuple, points[row])) for row in unique[count == 1]}


def test_a_sharp_wedge_gets_finer_where_its_tip_allows_no_good_cells():
    points, cells = wedge(2.0, 6, 2)
    (new, rows), report = odt_plugins.remesh_with_report((points, cells), 0.07, free="periodic")
    assert report.fallback is None
    assert any("of the input stay as they are" in note for note in report.notes)
    assert len(new) > 10 * len(points)
    assert signed_volumes(new, rows).min() > 0
    assert signed_volumes(new, rows).sum() == pytest.approx(
        signed_volumes(points, cells).sum(), rel=3e-3)
    before, after = (dihedral_angles(*mesh) for mesh in ((points, cells), (new, rows)))
    assert after.min() >= before.min() * (1 - 1e-7)
    assert after.max() < 150


def test_sizes_fall_from_a_boundary_that_stays():
    points, cells = boxes.box(3, 2)
    (new, rows), report = odt_plugins.remesh_with_report((points, cells), 0.2, boundary="fixed")
    assert report.fallback is None
    assert len(new) > len(points)
    assert facets(new, rows) == facets(points, cells)


def test_sizes_are_those_of_the_input_at_cells_that_stay_and_fall_from_there():
    points, cells = boxes.box(3, 5)
    near = points[cells].mean(axis=1)[:, 0] < 0.2
    mesh = freeze(simplex_mesh(points, cells)[0], near)
    sizes = wanted_sizes(mesh, Wish(length=0.05))
    found = beside_whole(mesh, sizes, near, slides=True)
    own, held = local_sizes(mesh), np.unique(mesh.cells[near])
    assert found.values[held] == pytest.approx(own[held], rel=0.3)
    assert (found.values[held] >= own[held]).all()
    away = np.linalg.norm(points[:, None] - points[held], axis=2)
    assert (found.values >= 0.05).all()
    assert (found.values >= (own[held] - 2 * (STEEP - 1) * away).max(axis=1)).all()
    assert found.values[points[:, 0] > 0.6] == pytest.approx(0.05)
    assert beside_whole(mesh, sizes.scaled(10.0), near, slides=True) is None


def test_sizes_for_a_number_of_cells_that_cannot_come_are_not_ever_finer(monkeypatch):
    asked = []

    def tetrahedra(mesh, base, sizes, options, leaving, course):
        asked.append(sizes.values.max())
        return replace(unchanged(mesh, ""), origin=np.arange(len(mesh.points))), course.known

    def overlapping(*_):
        raise InvalidMeshError("cells overlap")

    monkeypatch.setattr(run, "_tetrahedra", tetrahedra)
    monkeypatch.setattr(run, "with_sizes", overlapping)
    odt_plugins.remesh(boxes.box(3, 3), cells=5000)
    assert len(asked) == 2
    assert asked[1] == pytest.approx(asked[0] * 3 ** (-1 / 3))


@pytest.mark.parametrize("stays", [0.0, 0.2, 0.4])
def test_a_number_of_cells_is_met_in_few_tries_though_some_do_not_get_fewer(stays):
    goal, counts, factor = 10_000, {}, 1.0
    for _ in range(4):
        counts[factor] = round(1.6 * goal * (stays + (1.0 - stays) * factor ** -3.0))
        factor = factor_for(counts, goal, 3)
    nearest = min(counts.values(), key=lambda count: abs(count - goal))
    assert nearest == pytest.approx(goal, rel=0.01)
