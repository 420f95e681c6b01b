"""Triangles through the front: remesh on hosts, and rims in the plane that slide."""

from __future__ import annotations

import numpy as np
import pytest
import pyvista
from scipy.spatial import Delaunay
from surface_meshes import bowl, cube, sphere

import odt_plugins
import odt_plugins.engine.retile.grading as grading
import odt_plugins.engine.retile.run as retile_run
import odt_plugins.engine.retile.surface as retile_surface
from odt_plugins.errors import InvalidOptionError
from odt_plugins.generate import clouds


def shaken_square():
    """A square with uneven vertices on its straight rims, too."""
    k = 13
    points, cells = bowl(k, 0.4)
    rng = np.random.default_rng(0)
    i, j = np.divmod(np.arange(k * k), k)
    for rim, along in (((i == 0) | (i == k - 1), 1), ((j == 0) | (j == k - 1), 0)):
        inner = (i, j)[along]
        moves = rim & (inner > 0) & (inner < k - 1)
        points[moves, along] += rng.uniform(-0.03, 0.03, moves.sum())
    return points[:, :2].copy(), cells


def area(points, cells):
    u, v = (points[cells[:, i]] - points[cells[:, 0]] for i in (1, 2))
    return (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum() / 2


def test_rims_in_the_plane_slide_along_themselves():
    mesh = shaken_square()
    points, cells = odt_plugins.optimize(mesh, boundary="slide")
    rim = np.abs(mesh[0]).max(axis=1) == 1.0
    assert (np.abs(points[rim]).max(axis=1) == 1.0).all()
    assert (points[rim] != mesh[0][rim]).any()
    corners = (np.abs(mesh[0]) == 1.0).all(axis=1)
    assert np.array_equal(points[corners], mesh[0][corners])
    assert area(points, cells) == pytest.approx(4.0, rel=1e-12)
    fixed = odt_plugins.quality(odt_plugins.optimize(mesh))
    assert odt_plugins.quality((points, cells)).min_quality > fixed.min_quality


def test_methods_that_rims_do_not_know_are_refused_by_what_they_are_for():
    expected = r"got method='cvt' with boundary='slide' in the plane; .* or boundary='fixed'"
    with pytest.raises(InvalidOptionError, match=expected):
        odt_plugins.optimize(shaken_square(), boundary="slide", method="cvt")


@pytest.mark.parametrize("part", [0.1, 0.2])
def test_inside_a_rim_that_stays_edges_are_as_short_as_asked_for(part):
    points, cells = shaken_square()
    size = part * 2 / 12
    new, rows = odt_plugins.remesh((points, cells), size, boundary="fixed")
    rim = np.abs(points).max(axis=1) == 1.0
    assert {tuple(x) for x in new[np.abs(new).max(axis=1) == 1.0]} == {
        tuple(x) for x in points[rim]}
    edges = np.unique(np.sort(np.concatenate(
        [rows[:, [0, 1]], rows[:, [1, 2]], rows[:, [2, 0]]]), axis=1), axis=0)
    length = np.linalg.norm(new[edges[:, 0]] - new[edges[:, 1]], axis=1)
    far = 1.0 - np.abs(new[edges]).max(axis=(1, 2)) > 0.25
    assert ((length[far] > size / 2**0.5) & (length[far] < size * 2**0.5)).mean() > 0.97
    assert odt_plugins.quality((new, rows)).min_quality > 0.6


@pytest.mark.parametrize("planar", [True, False])
def test_fields_and_labels_come_back(planar):
    points, cells = bowl(25, 0.3)
    points[:, 2] *= 0.0 if planar else 1.0
    grid = pyvista.PolyData.from_regular_faces(points, cells)
    grid["linear"] = 1.0 + points[:, 0] - 2.0 * points[:, 1]
    grid.cell_data["part"] = (points[cells].mean(axis=1)[:, 0] > 0).astype(int)
    result, report = odt_plugins.remesh_with_report(grid, 0.12, envelope=1e-2, regions="part")
    assert type(result) is pyvista.PolyData
    x = result.points
    slack = 1e-6 if planar else 2e-3
    assert np.abs(result["linear"] - (1.0 + x[:, 0] - 2.0 * x[:, 1])).max() < slack
    middle = x[result.regular_faces].mean(axis=1)
    assert ((middle[:, 0] > 0) == (result.cell_data["part"] == 1)).mean() > 0.97
    assert result.n_points < grid.n_points
    assert report.fallback is None


def test_about_as_many_cells_as_asked_for():
    points, cells = sphere(3, 0.1)
    _, fewer = odt_plugins.remesh((points, cells), cells=700, envelope=1e-2)
    assert len(fewer) == pytest.approx(700, rel=0.06)


def test_as_coarse_as_the_topology_allows():
    points, cells = sphere(2)
    few, _ = odt_plugins.remesh((points, cells), 5.0, envelope=0.2, keep=())
    assert 4 <= len(few) < 40


@pytest.mark.parametrize("relenting", [False, True])
def test_sizes_that_figures_forbid_are_the_nearest_that_hold(relenting, monkeypatch):
    if not relenting:
        monkeypatch.setattr(retile_surface, "relent_along", lambda *_: None)
    mesh = clouds.plate(200)
    (points, cells), report = odt_plugins.remesh_with_report(mesh, 1.0)
    assert report.fallback is None
    nearer = "nearer to those of the input than asked for, since"
    assert any(nearer in note for note in report.notes) is not relenting
    assert len(points) < (0.65 if relenting else 0.6) * len(mesh[0])
    assert report.after.mean_quality > report.before.mean_quality
    assert report.after.min_quality >= report.before.min_quality
    sides = np.linalg.det(points[cells][:, 1:] - points[cells][:, :1])
    assert sides.min() > 0.0


def test_a_count_that_is_missed_is_told():
    _, report = odt_plugins.remesh_with_report(clouds.plate(200), cells=3)
    assert any("cells are the nearest to 3 that kept" in note for note in report.notes)


def test_what_keeps_a_curved_surface_from_a_count_is_named():
    ball = sphere(2)
    for boundary in ("slide", "fixed"):
        _, report = odt_plugins.remesh_with_report(ball, vertices=30, boundary=boundary)
        assert any("vertices are the nearest to 30 that kept the promise, try a larger envelope="
                   in note for note in report.notes)


@pytest.mark.parametrize("limited", [False, True])
def test_a_plate_far_thinner_than_the_sizes_does_not_fill_the_memory(limited, monkeypatch):
    points, cells = cube(2)
    resize, room = retile_run.resize, []

    def resized(*how, **more):
        net, marks = resize(*how, **more)
        room.append(len(net.triangles))
        return net, marks

    monkeypatch.setattr(retile_run, "resize", resized)
    if not limited:
        monkeypatch.setattr(grading, "MOST_GIVEN", np.inf)
    odt_plugins.remesh((points * [0.5, 0.4, 7e-6], cells), 0.5, envelope=2e-3, keep=())
    assert limited is (max(room) < 100 * len(cells))
    assert max(room) < 1000 * len(cells)


@pytest.mark.parametrize("guarded", [False, True])
@pytest.mark.parametrize("radius", [0.1, 0.2])
def test_a_small_round_region_leaves_the_rest_to_be_resized(radius, guarded, monkeypatch):
    if not guarded:
        monkeypatch.setattr(retile_surface, "heights", lambda *lines: np.full(lines[-1], np.inf))
    turns = 2 * np.pi * np.arange(16) / 16
    ring = radius * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 31)] * 2), axis=-1).reshape(-1, 2)
    away = np.linalg.norm(grid, axis=1)
    points = np.concatenate([ring, 0.5 * ring, [[0.0, 0.0]], grid[away > 1.2 * radius]])
    cells = Delaunay(points).simplices
    disk = np.linalg.norm(points[cells].mean(axis=1), axis=1) < radius
    corners = np.sort(cells[disk], axis=1)
    assert (corners[:, 2] < 33).all()
    (new, rows, labels), report = odt_plugins.remesh_with_report(
        (points, cells, disk.astype(int)), scale=1.5, envelope=2e-3)
    assert len(rows) < 0.6 * len(cells)
    for label in (0, 1):
        was, now = (abs(area(x, c)) for x, c in (
            (points, cells[disk == label]), (new, rows[labels == label])))
        assert now == pytest.approx(was, rel=3e-3)
    if guarded:
        assert report.fallback is None
    else:
        assert "the area of region 1" in report.fallback


@pytest.mark.parametrize("planar", [True, False])
def test_the_report_of_triangles_says_how_many_edges_have_their_size(planar):
    points, cells = shaken_square() if planar else sphere(3)
    (new, rows), report = odt_plugins.remesh_with_report((points, cells), 0.25)
    edges = np.unique(np.sort(np.concatenate(
        [rows[:, [0, 1]], rows[:, [1, 2]], rows[:, [2, 0]]]), axis=1), axis=0)
    length = np.linalg.norm(new[edges[:, 0]] - new[edges[:, 1]], axis=1) / 0.25
    share = ((length > 0.5**0.5) & (length < 2**0.5)).mean()
    [note] = [note for note in report.notes if "as long as asked for" in note]
    assert note.startswith(f"{share:.1%} of the edges are 0.71 to 1.41 times as long")
    assert f"{length.mean():.2f} on average" in note


@pytest.mark.parametrize("planar", [True, False])
def test_edges_outside_the_selection_do_not_count_where_their_lengths_are_told(planar):
    points, cells = shaken_square() if planar else sphere(3)
    chosen = points[cells].mean(axis=1)[:, 0] > np.median(points[:, 0])
    (new, rows), report = odt_plugins.remesh_with_report((points, cells), 0.08, selection=chosen)

    def edges(x, rows):
        return {frozenset(map(tuple, x[pair].tolist()))
                for row in rows for pair in (row[:2], row[1:], row[::2])}

    length = np.array([np.linalg.norm(np.subtract(*edge)) / 0.08
                       for edge in edges(new, rows) - edges(points, cells[~chosen])])
    share = ((length > 0.5**0.5) & (length < 2**0.5)).mean()
    [note] = [note for note in report.notes if "as long as asked for" in note]
    assert note.startswith(f"{share:.1%} of the edges that may change are 0.71 to 1.41 times")


def test_edges_are_compared_with_those_of_the_number_asked_for_where_it_is_out_of_reach():
    points, cells = sphere(3)
    (_, rows), report = odt_plugins.remesh_with_report((points, cells), cells=100, envelope=2e-3)
    assert len(rows) > 400
    [note] = [note for note in report.notes if "as long as asked for" in note]
    mean = float(note.partition(" times as long as asked for, ")[2].split()[0])
    assert mean == pytest.approx((100 / len(rows)) ** 0.5, rel=0.1)
