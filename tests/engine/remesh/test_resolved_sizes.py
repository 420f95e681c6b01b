"""Edges along which sizes are not linear: needles, and sides without vertices inside."""

from __future__ import annotations

from itertools import combinations, permutations, product

import meshio
import numpy as np
import pytest

import odt_plugins
from odt_plugins.engine.remesh import triangles as of_triangles
from odt_plugins.engine.remesh.resolve import resolved
from odt_plugins.engine.remesh.sizes import wanted_sizes
from odt_plugins.engine.remesh.wish import Wish
from odt_plugins.engine.run.outcome import unchanged
from odt_plugins.errors import InvalidOptionError
from odt_plugins.mesh.surface import surface_edges, surface_mesh


def _washer(n, inner, outer):
    """Needles between two circles."""
    ring = _ring(n)
    i, j = np.arange(n), np.roll(np.arange(n), -1)
    return np.concatenate([inner * ring, outer * ring]), np.concatenate(
        [np.c_[i, n + j, j], np.c_[i, n + i, n + j]])


def _ring(n):
    around = 2 * np.pi * np.arange(n) / n
    return np.c_[np.cos(around), np.sin(around), np.zeros(n)]


def _punched(n, radius):
    """A square with a hole, of needles without vertices inside, and the side of the hole."""
    rim = radius * _ring(n)
    corners = np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]])
    quarter = np.arange(n) * 4 // n
    i, j = np.arange(n), np.roll(np.arange(n), -1)
    four = np.arange(4)
    top = np.concatenate([np.c_[i, n + quarter, j],
                          np.c_[n * four // 4, n + (four - 1) % 4, n + four]])
    side = np.concatenate([np.c_[i, j, n + 4 + j], np.c_[i, n + 4 + j, n + 4 + i]])
    return np.concatenate([rim, corners, rim - [0.0, 0.0, radius]]), np.concatenate([top, side])


def _box():
    points = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return points, np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))])


def _area(points, cells):
    x = points[cells]
    return 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)


@pytest.mark.parametrize("growth", [1.15, 1.3])
def test_triangles_of_a_plane_side_grow_away_from_a_small_hole(growth):
    points, cells = _punched(32, 0.05)
    (x, t), report = odt_plugins.remesh_with_report(
        (points, cells), 0.2, growth=growth, envelope=1e-4)
    away, edges = np.hypot(*x[:, :2].T), np.concatenate([t, np.roll(t, -1, axis=1)])
    ends = edges[(np.abs(away[edges[:, :2]] - 0.05) < 1e-3).all(axis=1), :2]
    rim = np.linalg.norm(x[ends[:, 0]] - x[ends[:, 1]], axis=1).mean()
    at = np.random.default_rng(0).uniform(-1.0, 1.0, (100_000, 2))
    far = np.hypot(*at.T) - 0.05
    size = np.minimum(rim + (growth - 1.0) * far[far > 0], 0.2)
    triangles = 4.0 * (1.0 / (np.sqrt(3) / 4 * size**2)).sum() / len(at)
    top = (x[t][:, :, 2] > -1e-3).all(axis=1).sum()
    assert top == pytest.approx(triangles, rel=0.35)
    assert report.after.min_quality > 0.4
    assert report.fallback is None


def test_a_function_is_asked_between_the_vertices_of_the_input():
    def size(at):
        return 0.01 + 0.25 * np.linalg.norm(at - [0.3, 0.3, 1.0], axis=1)

    (x, t), report = odt_plugins.remesh_with_report(_box(), size)
    length = np.linalg.norm(x[t] - x[np.roll(t, -1, axis=1)], axis=2)
    ratio = length / size(0.5 * (x[t] + x[np.roll(t, -1, axis=1)]).reshape(-1, 3)).reshape(-1, 3)
    assert length.min() < 0.015
    assert ((ratio > 0.71) & (ratio < 1.41)).mean() > 0.9
    assert report.after.min_quality > 0.5


def _cube(d):
    """The unit cube of d! simplices."""
    points = np.array(list(product((0.0, 1.0), repeat=d)))
    rows = []
    for order in permutations(range(d)):
        path = np.cumsum(np.eye(d, dtype=int)[list(order)], axis=0)
        rows.append([0, *(path @ 2 ** np.arange(d)[::-1])])
    cells = np.array(rows)
    step = points[cells[:, 1:]] - points[cells[:, :1]]
    turned = np.linalg.det(step) < 0.0
    cells[turned, -2:] = cells[turned, :-3:-1]
    return points, cells


def test_a_function_is_asked_inside_few_large_cells(d):
    points, cells = _cube(d)
    centre = np.array([0.3, 0.4, 0.5])[:d]

    def size(at):
        return 0.07 + 0.25 * np.linalg.norm(at - centre, axis=1)

    sides = [facet for cell in cells for facet in combinations(cell.tolist(), d)]
    outer = [f for f in sides if any(np.ptp(points[list(f), k]) == 0.0 for k in range(d))]
    kind = {2: "line", 3: "triangle"}[d]
    label = [int(points[list(f), 0].max() == 0.0) for f in outer]
    mesh = meshio.Mesh(points, [({2: "triangle", 3: "tetra"}[d], cells), (kind, np.array(outer))],
                       cell_data={"gmsh:physical": [np.ones(len(cells), dtype=int),
                                                    2 + np.array(label)]})
    result, report = odt_plugins.remesh_with_report(mesh, size)
    x, t = result.points[:, :d], result.cells[0].data
    edges = np.unique(np.sort(np.concatenate(
        [t[:, list(pair)] for pair in combinations(range(d + 1), 2)]), axis=1), axis=0)
    length = np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1)
    ratio = length / size(x[edges].mean(axis=1))
    assert ((ratio > 0.71) & (ratio < 1.41)).mean() > 0.85
    assert report.after.min_quality > 0.3
    assert report.fallback is None
    rows, labels = result.cells[1].data, result.cell_data["gmsh:physical"][1]
    assert np.array_equal(labels == 3, (x[rows][:, :, 0] == 0.0).all(axis=1))
    assert len(rows) > len(outer)


def test_more_cells_than_are_wished_are_refused_where_a_function_asks_for_them_inside():
    def size(at):
        return 1e-4 + np.abs(at - 0.5).max(axis=1)

    with pytest.raises(InvalidOptionError, match=r"about .* cells; .* most_cells=500"):
        odt_plugins.remesh(_cube(3), size, most_cells=500, growth=2.0)


def test_halves_of_edges_are_the_surface_and_lie_where_they_did():
    points, cells = _washer(12, 0.1, 1.0)
    label = np.arange(len(cells)) % 3
    mesh = surface_mesh(points, cells, regions=label, selection=np.arange(len(cells)) != 7)
    most = np.where(np.arange(24) < 12, 0.01, np.inf)
    sizes = wanted_sizes(mesh, Wish(length=0.05, growth=1.3)).below(mesh, most)
    base, found = resolved(mesh, sizes, most)
    assert len(base.points) > 24
    assert base.points[:24].tobytes() == mesh.points.tobytes()
    assert np.array_equal(base.cells[base.frozen], mesh.cells[mesh.frozen])
    edges = surface_edges(base.cells, len(base.points))
    assert set(edges.degree.tolist()) == {1, 2}
    area = _area(base.points, base.cells)
    assert area.min() > 0.0
    for k in range(3):
        assert area[base.regions == k].sum() == pytest.approx(
            _area(points, cells)[label == k].sum(), rel=1e-12)
    step = np.linalg.norm(base.points[edges.vertices[:, 0]] - base.points[edges.vertices[:, 1]],
                          axis=1)
    ends = found.values[edges.vertices]
    assert (np.abs(ends[:, 0] - ends[:, 1]) <= 0.3 * step * (1.0 + 1e-9)).all()
    assert found.values.max() == pytest.approx(0.05)


def test_strips_around_a_cylinder_are_no_plane_sides():
    around = 2 * np.pi * np.arange(64) / 64
    ring = np.c_[np.cos(around), np.sin(around)]
    i, j = np.arange(64), np.roll(np.arange(64), -1)
    mesh = surface_mesh(
        np.concatenate([np.c_[ring, np.zeros(64)], np.c_[ring, np.full(64, 3.0)]]),
        np.concatenate([np.c_[i, j, 64 + j], np.c_[i, 64 + j, 64 + i]]))
    sizes = wanted_sizes(mesh, Wish(length=0.5))
    base, _ = resolved(mesh, sizes.below(mesh, np.full(128, 0.2)), np.full(128, 0.2))
    assert base is mesh


def test_where_the_promise_forbids_more_vertices_the_mesh_is_resized_without(monkeypatch):
    tried = []
    resized = of_triangles.retile

    def once(mesh, *rest, **more):
        tried.append(len(rest) > 4)
        if tried[-1]:
            return unchanged(mesh, "it does not hold")
        return resized(mesh, *rest, **more)

    monkeypatch.setattr(of_triangles, "retile", once)
    points, cells = _punched(32, 0.05)
    (x, t), report = odt_plugins.remesh_with_report((points, cells), 0.2, envelope=1e-4)
    assert tried == [True, False]
    assert report.fallback is None
    assert len(x) != len(points)
    assert _area(x, t).sum() == pytest.approx(_area(points, cells).sum(), rel=1e-2)


@pytest.mark.parametrize(("size", "match"), [
    (lambda x: np.where(x[:, 0] == 0.5, np.nan, 0.1), r"nan at .*, at \(0\.5, .*\(3 of them\)"),
    (lambda x: np.full(4, 0.1), r"shape \(4,\) at 5 points; expected \(5,\)"),
])
def test_what_a_function_gives_between_vertices_is_named_by_its_place(size, match):
    with pytest.raises(InvalidOptionError, match=match):
        odt_plugins.remesh(_cube(2), size)
