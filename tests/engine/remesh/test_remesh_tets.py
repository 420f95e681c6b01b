"""Tetrahedra of other sizes: the shape stays, the sizes come, and what is held is held."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import boxes
import igl
import meshio
import numpy as np
import pytest
import pyvista
import skfem
from tet_meshes import ball

import odt_plugins
import odt_plugins.engine.remesh.finish as remesh_finish
import odt_plugins.engine.remesh.places as remesh_places
import odt_plugins.engine.remesh.run as remesh_run
import odt_plugins.engine.remesh.volume as remesh_volume
from odt_plugins.engine.cells.measures import QUALITY
from odt_plugins.engine.moves.passes import measures
from odt_plugins.engine.remesh import remedies
from odt_plugins.engine.remesh.distance import Broken, beyond, grounds_of
from odt_plugins.engine.run.outcome import unchanged
from odt_plugins.errors import InvalidOptionError
from odt_plugins.mesh.simplex import simplex_mesh

DATA = Path(__file__).parents[2] / "data"


def volumes(points, cells):
    x = points[cells]
    return np.linalg.det(x[:, 1:] - x[:, :1]) / 6


def facets_once(cells):
    """Facets of one cell alone, sorted; no facet may have more than two cells."""
    faces = np.sort(np.concatenate([np.delete(cells, i, axis=1) for i in range(4)]), axis=1)
    unique, count = np.unique(faces, axis=0, return_counts=True)
    assert count.max() <= 2
    return unique[count == 1]


def edge_lengths(points, cells):
    edges = np.concatenate([cells[:, pair] for pair in map(list, combinations(range(4), 2))])
    edges = np.unique(np.sort(edges, axis=1), axis=0)
    return np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)


def share_in(lengths, size):
    return ((lengths > size / 2**0.5) & (lengths < size * 2**0.5)).mean()


def furthest(points, cells, others, other_cells):
    """Largest distance of samples of one boundary from another, by libigl."""
    rows = facets_once(cells)
    weights = np.random.default_rng(0).dirichlet([1, 1, 1], 40)
    x = np.einsum("kc,mcd->mkd", np.concatenate([weights, np.eye(3)]), points[rows]).reshape(-1, 3)
    square, _, _ = igl.point_mesh_squared_distance(x, others, facets_once(other_cells))
    return np.sqrt(square.max())


@pytest.fixture(scope="module")
def csg():
    mesh = meshio.read(DATA / "tetwild_csg.vtu")
    return mesh.points, mesh.cells_dict["tetra"]


@pytest.fixture(scope="module")
def box():
    return boxes.box(3, 5)


@pytest.fixture(scope="module", params=[0.12, 0.4], ids=["finer", "coarser"])
def resized(request, box):
    return request.param, odt_plugins.remesh(box, request.param, envelope=0.01, free="periodic")


def test_a_box_with_other_sizes_is_the_same_box(box, resized):
    _, (points, cells) = resized
    assert volumes(points, cells).min() > 0
    assert volumes(points, cells).sum() == pytest.approx(1, abs=3e-3)
    assert furthest(points, cells, *box) < 0.01 * 3**0.5
    assert furthest(*box, points, cells) < 0.01 * 3**0.5
    corners = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1]), axis=-1).reshape(-1, 3)
    assert all((points == corner).all(axis=1).any() for corner in corners)


@pytest.mark.parametrize("scale", [0.8, 1.6])
def test_the_flat_ends_of_a_cylinder_stay_flat_where_volume_is_to_be_given_back(scale):
    points, cells = boxes.box(3, 8)
    u, v = 2.0 * points[:, 0] - 1.0, 2.0 * points[:, 1] - 1.0
    points = np.stack([u * np.sqrt(1.0 - 0.5 * v * v), v * np.sqrt(1.0 - 0.5 * u * u),
                       points[:, 2]], axis=1)
    new, rows = odt_plugins.remesh((points, cells), scale=scale, envelope=0.03, free="periodic")
    height = new[np.unique(facets_once(rows)), 2]
    near = np.minimum(np.abs(height), np.abs(height - 1.0))
    assert near[near < 0.03].max() < 1e-14
    assert volumes(new, rows).sum() == pytest.approx(volumes(points, cells).sum(), rel=2e-3)


def test_edges_have_the_length_that_is_asked_for(resized):
    size, (points, cells) = resized
    assert share_in(edge_lengths(points, cells), size) > 0.9


def test_a_fixed_boundary_stays_bit_for_bit(box):
    points, cells = odt_plugins.remesh(box, 0.12, boundary="fixed")
    rows, before = facets_once(cells), facets_once(box[1])
    assert {tuple(map(tuple, points[row])) for row in rows} == {
        tuple(map(tuple, box[0][row])) for row in before}
    assert volumes(points, cells).sum() == pytest.approx(1, rel=1e-12)
    assert len(points) > len(box[0])


def test_regions_keep_their_volumes_and_their_interface():
    points, cells = boxes.box(3, 4, plane=0.5)
    labels = (points[cells][:, :, 0].mean(axis=1) > 0.5).astype(int)
    new, rows, regions = odt_plugins.remesh(
        (points, cells, labels), 0.13, envelope=0.01, free="periodic")
    for label, volume in ((0, 0.5), (1, 0.5)):
        part = rows[regions == label]
        assert volumes(new, part).sum() == pytest.approx(volume, rel=3e-3)
    sides = [set(map(tuple, facets_once(rows[regions == label]))) for label in (0, 1)]
    interface = np.array(sorted(sides[0] & sides[1]))
    assert np.abs(new[interface][:, :, 0] - 0.5).max() < 0.01 * 3**0.5


@pytest.mark.parametrize("scale", [0.7, 1.4])
def test_regions_of_short_coordinates_get_other_sizes_as_those_of_long_ones_do(scale):
    points, cells = boxes.box(3, 6, plane=0.5)
    labels = (points[cells][:, :, 0].mean(axis=1) > 0.5).astype(int)
    count = []
    for kind in (np.float64, np.float32):
        (new, _, _), report = odt_plugins.remesh_with_report(
            (points.astype(kind), cells, labels), scale=scale)
        assert new.dtype == kind
        assert report.fallback is None
        count.append(len(new))
    assert count[1] == pytest.approx(count[0], rel=0.05)


def test_fixed_vertices_and_cells_outside_the_selection_stay(box):
    points, cells = box
    held = np.flatnonzero(points[:, 2] > 0.7)
    part = points[cells][:, :, 0].mean(axis=1) > 0.5
    new, rows = odt_plugins.remesh(box, 0.12, fixed=held, selection=part)
    places = set(map(tuple, new))
    assert all(tuple(points[v]) in places for v in held)
    kept = {frozenset(map(tuple, new[row])) for row in rows}
    assert all(frozenset(map(tuple, points[row])) in kept for row in cells[~part])


def test_the_result_does_not_depend_on_the_threads(box, many_threads):
    one, two = (odt_plugins.remesh(box, 0.1, threads=threads, free="periodic")
                for threads in (1, 2))
    for a, b in zip(one, two, strict=True):
        assert np.array_equal(a, b)


def test_as_many_cells_as_asked_for(box):
    _, cells = odt_plugins.remesh(box, cells=3000, envelope=0.01, free="periodic")
    assert len(cells) == pytest.approx(3000, rel=0.1)


def test_a_field_grows_no_faster_than_allowed():
    points, cells = ball(1500, 3)
    sizes = np.where(np.linalg.norm(points, axis=1) < 0.2, 0.08, 5.0)
    (new, rows), report = odt_plugins.remesh_with_report((points, cells), sizes, growth=1.5)
    lengths = edge_lengths(new, rows)
    assert lengths.min() < 0.1
    assert lengths.max() < 0.9
    assert any("grow by more than 1.5" in note for note in report.notes)


@pytest.mark.parametrize(("wish", "said"), [
    ({"size": 0.0}, "size=0.0"),
    ({"size": -1.0}, "size=-1.0"),
    ({"size": float("nan")}, "size=nan"),
    ({"size": "fine"}, "size='fine'"),
    ({"size": [0.1, 0.2]}, r"shape \(2,\)"),
    ({"size": lambda x: -np.ones(len(x))}, "index 0"),
    ({"size": 1e-8}, "below 1e-06 of the diagonal"),
    ({"size": 0.001}, "most_cells"),
    ({"scale": 0}, "scale=0"),
    ({"cells": 2.5}, "cells=2.5"),
    ({"size": 0.1, "scale": 2}, "size= and scale=; expected one of size, scale, cells"),
    ({}, "one of size, scale, cells and vertices"),
    ({"scale": 1, "growth": 1.0}, "growth=1.0"),
    ({"scale": 1, "density": "uniform"}, "density="),
])
def test_sizes_that_mean_nothing_are_refused(box, wish, said):
    with pytest.raises(InvalidOptionError, match=said):
        odt_plugins.remesh(box, **wish)


def test_a_size_larger_than_the_domain_is_said(box):
    (points, cells), report = odt_plugins.remesh_with_report(
        box, 50.0, envelope=0.01, free="periodic")
    assert volumes(points, cells).sum() == pytest.approx(1, abs=3e-3)
    assert any("larger than the domain" in note for note in report.notes)


def test_where_the_envelope_forbids_the_size_the_nearest_one_comes_and_is_told():
    points, cells = odt_plugins.optimize(ball(120, 2))
    (x, _), report = odt_plugins.remesh_with_report((points, cells), scale=2, envelope=1e-3)
    assert report.fallback is None
    assert len(x) != len(points)
    assert report.after.mean_quality > report.before.mean_quality + 0.02
    assert any("sizes are smaller than asked for" in note for note in report.notes)
    assert report.binding
    assert not any("insert" in cell.hint for cell in report.binding)


def test_vertices_that_slid_are_those_of_the_boundary():
    points, cells = boxes.box(3, 4)
    mesh = simplex_mesh(points, cells)[0]
    inside = int(np.argmin(np.abs(mesh.points - 0.5).sum(axis=1)))
    on_side = int(np.argmin(np.abs(mesh.points - [0.5, 0.5, 0.0]).sum(axis=1)))
    for moved, count in ((inside, 0), (on_side, 1)):
        there = mesh.points.copy()
        there[moved, 0] += 1e-3
        outcome = replace(unchanged(mesh, ""), points=there, origin=np.arange(len(there)))
        broken, slid = beyond(mesh, grounds_of(mesh), outcome, 0.1)
        assert (broken, slid.vertices) == (None, count)


def test_vertices_of_no_cell_are_none_whose_sizes_are_smaller():
    mesh = skfem.MeshTet().refined(2)
    points, cells = mesh.p.T, mesh.t.T
    left, low, _ = (points[cells].mean(axis=1) < 0.5).T
    told = [odt_plugins.remesh_with_report((x, cells, 2 * left + low), scale=1.5)[1].notes
            for x in (points, np.concatenate([points, np.full((600, 3), 0.5)]))]
    assert any("sizes are smaller than asked for" in note for note in told[0])
    assert told[0] == told[1]


def test_triangles_with_labels_stay_facets_and_a_linear_field_stays_itself(box):
    points, cells = box
    facets = facets_once(cells)
    low = facets[(points[facets][:, :, 0] == 0).all(axis=1)]
    sides = np.arange(len(low)) % 3
    field = points @ [1.0, 2.0, -1.0]
    mesh = meshio.Mesh(points, [("tetra", cells), ("triangle", low)], {"f": field},
                       {"side": [np.zeros(len(cells), int), sides]})
    new = odt_plugins.remesh(mesh, 0.13, envelope=0.01, free="periodic")
    rows = facets_once(new.cells_dict["tetra"])
    there = new.cells_dict["triangle"]
    assert set(map(tuple, np.sort(there, axis=1))) <= set(map(tuple, rows))
    x, y = points[low], new.points[there]
    area, finer = (np.linalg.norm(np.cross(z[:, 1] - z[:, 0], z[:, 2] - z[:, 0]), axis=1)
                   for z in (x, y))
    assert np.bincount(new.cell_data_dict["side"]["triangle"], finer) == pytest.approx(
        np.bincount(sides, area), rel=0.02)
    assert len(there) > len(low)
    assert len(new.points) > len(points)
    assert np.abs(new.point_data["f"] - new.points @ [1.0, 2.0, -1.0]).max() < 1e-9
    assert new.points[:, 0].min() > -0.01 * 3**0.5


def test_the_accessor_of_pyvista_takes_a_size(box):
    points, cells = box
    odt_plugins.register("pyvista")
    grid = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: cells}, points)
    grid.point_data["h"] = np.full(len(points), 0.15)
    assert grid.odt.remesh("h").n_cells > len(cells)


def test_a_poor_tail_gets_vertices_inside(csg, monkeypatch):
    runs, run = [], remesh_finish.run

    def counted(*how, **within):
        runs.append(remesh_finish.POOR)
        return run(*how, **within)

    monkeypatch.setattr(remesh_finish, "run", counted)
    (points, cells), report = odt_plugins.remesh_with_report(csg, scale=2)
    monkeypatch.setattr(remesh_finish, "POOR", 0.0)
    (others, other_cells), without = odt_plugins.remesh_with_report(csg, scale=2)
    assert 2 * runs.count(0.0) == len(runs)
    assert without.after.p1_quality < 0.5
    assert report.after.p1_quality > without.after.p1_quality + 0.05
    assert len(others) < len(points) <= 1.1 * len(others)
    inside = [len(x) - len(np.unique(facets_once(t))) for x, t in ((points, cells),
                                                                  (others, other_cells))]
    assert inside[0] - inside[1] == len(points) - len(others)
    assert (volumes(points, cells) > 0).all()


def test_labels_follow_where_vertices_come_and_go_inside(monkeypatch):
    seen, gone = [], []
    surface_of, run = remesh_finish.surface_of, remesh_finish.run

    def looked_at(cells, *others):
        seen.append(cells.min())
        return surface_of(cells, *others)

    def finished(mesh, *how, **within):
        found = run(mesh, *how, **within)
        gone.append(0 if found.origin is None else len(mesh.points) - (found.origin >= 0).sum())
        return found

    monkeypatch.setattr(remesh_finish, "surface_of", looked_at)
    monkeypatch.setattr(remesh_finish, "run", finished)
    for seed in range(2):
        points, cells = ball(60, seed)
        rows = facets_once(cells)
        mesh = meshio.Mesh(points, [("tetra", cells), ("triangle", rows)], cell_data={
            "side": [np.zeros(len(cells), int), np.full(len(rows), 7)]})
        after = odt_plugins.remesh(mesh, scale=0.7, envelope=1e-4, keep=())
        found = np.sort(after.cells_dict["triangle"], axis=1)
        assert {*map(tuple, found)} == {*map(tuple, facets_once(after.cells_dict["tetra"]))}
        assert (after.cell_data_dict["side"]["triangle"] == 7).all()
    assert max(gone) > 0
    assert min(seen) >= 0


def test_cells_take_their_data_from_their_region_where_lines_inside_have_labels():
    points, cells = boxes.box(3, 4, plane=0.5)
    labels = (points[cells][:, :, 0].mean(axis=1) < 0.5).astype(int)
    inner = np.setdiff1d(cells, facets_once(cells))
    edges = np.unique(np.sort(cells[:, list(combinations(range(4), 2))].reshape(-1, 2)), axis=0)
    lines = edges[(np.isin(edges, inner) & (points[edges][:, :, 0] < 0.5)).all(axis=1)][:3]
    mesh = meshio.Mesh(points, [("tetra", cells), ("line", lines)], {"f": points @ [1.0, 2.0, 3.0]},
                       {"lab": [labels, np.full(len(lines), 7)]})
    for fields in ("interpolate", "conserve"):
        new = odt_plugins.remesh(mesh, 0.2, regions="lab", fields=fields, free="periodic")
        tets, found = new.cells_dict["tetra"], new.cell_data_dict["lab"]["tetra"]
        assert len(new.cells_dict["line"]) == len(lines)
        for label in (0, 1):
            volume = volumes(new.points, tets[found == label])
            assert volume.sum() == pytest.approx(0.5, rel=3e-3)
        far = np.abs(new.point_data["f"] - new.points @ [1.0, 2.0, 3.0]).max()
        assert far < (1e-9 if fields == "interpolate" else 0.1)


@pytest.mark.parametrize("wish", [{"cells": 625}, {"vertices": 130}])
def test_vertices_that_come_make_no_more_than_asked_for(csg, wish):
    points, cells = odt_plugins.remesh(csg, **wish)
    count = len(cells) if "cells" in wish else len(points)
    assert count == pytest.approx(next(iter(wish.values())), rel=0.05)


@pytest.fixture
def told(monkeypatch):
    """What the notes on sizes of a run are made of."""
    calls = []
    tell = remesh_run.told_of_edges
    monkeypatch.setattr(
        remesh_run, "told_of_edges", lambda *how: calls.append(how) or tell(*how))
    return calls


def test_sizes_in_notes_are_those_that_were_asked_for_though_vertices_came(csg, told):
    low, high = csg[0][:, 0].min(), csg[0][:, 0].max()

    def size(points):
        return 0.2 + 0.8 * (points[:, 0] - low) / (high - low)

    odt_plugins.remesh(csg, size, growth=3)
    outcome, unit, multiple = told[-1]
    assert (outcome.origin < 0).any()
    assert unit * outcome.sizes * multiple == pytest.approx(size(outcome.points), rel=5e-3)


def test_a_vertex_that_came_has_the_multiple_of_sizes_of_one_beside_it(told, monkeypatch):
    monkeypatch.setattr(remesh_finish, "POOR", 1.0)
    odt_plugins.remesh(odt_plugins.optimize(ball(120, 2)), scale=2, envelope=1e-3)
    outcome, _, multiple = told[-1]
    assert multiple.min() > 1.05
    came = len(multiple) - np.flatnonzero(outcome.origin >= 0)[-1] - 1
    assert came > 0


def test_a_run_with_vertices_that_came_is_taken_only_if_it_is_better(csg, monkeypatch):
    run = remesh_finish.run
    monkeypatch.setattr(remesh_finish, "run", lambda mesh, options, *how, **more: (
        unchanged(mesh, "") if options.insert else run(mesh, options, *how, **more)))
    points, cells = odt_plugins.remesh(csg, scale=2)
    monkeypatch.setattr("odt_plugins.engine.remesh.finish.POOR", 0.0)
    others, other_cells = odt_plugins.remesh(csg, scale=2)
    assert (points == others).all()
    assert (cells == other_cells).all()


def test_no_vertex_comes_where_cells_may_not_change(csg, monkeypatch):
    how = {"scale": 2, "smoothing": {"connectivity": "none"}}
    points, cells = odt_plugins.remesh(csg, **how)
    monkeypatch.setattr(remesh_finish, "POOR", 0.0)
    others, other_cells = odt_plugins.remesh(csg, **how)
    assert (points == others).all()
    assert (cells == other_cells).all()


def test_slivers_go_between_rounds(monkeypatch):
    mesh = ball(400, 0)
    taken = []
    finish = remesh_volume.finish
    monkeypatch.setattr(remesh_volume, "finish", lambda mesh, phases, *how: taken.append(
        ((measures(mesh, QUALITY) < remesh_volume.SLIVER).sum(), finish(mesh, phases, *how),
         (measures(mesh, QUALITY) < remesh_volume.SLIVER).sum())))
    odt_plugins.remesh(mesh, scale=1)
    assert taken
    assert sum(after for _, _, after in taken) < 0.5 * sum(before for before, _, _ in taken)


def test_a_small_region_of_another_volume_has_less_of_the_envelope_and_then_stays(monkeypatch):
    points, cells = ball(400, 2)
    small = np.linalg.norm(points[cells].mean(axis=1), axis=1) < 0.4
    own = np.unique(cells[small])
    calls = []
    once = remesh_run._once

    def refused(attempt, asked, options, leaving, room, made):
        outcome, broken = once(attempt, asked, options, leaving, room, made)
        calls.append((attempt.mesh, attempt.share * attempt.parts))
        return outcome, Broken("the volume of region 1 is another") if len(calls) < 3 else broken

    monkeypatch.setattr(remesh_run, "_once", refused)
    monkeypatch.setattr(remesh_places, "other_sizes", lambda *_: [(1, 0.1, 0.2)])
    monkeypatch.setattr(remedies, "_fallen", lambda *_args, **_named: False)
    x, rows, labels = odt_plugins.remesh(
        (points, cells, small.astype(np.int32)), scale=0.8, envelope=0.02, keep=())
    first, second, third = calls[:3]
    assert np.ptp(first[1]) == 0
    assert np.ptp(second[1][own]) == 0
    assert second[1][own[0]] < 0.5 * first[1][0]
    assert (np.delete(second[1], own) == first[1][0]).all()
    assert not first[0].frozen.any()
    assert not second[0].frozen.any()
    assert third[0].frozen[third[0].regions == 1].all()
    assert third[0].frozen.mean() < 0.5
    place = {tuple(p): v for v, p in enumerate(x.tolist())}
    now = {tuple(sorted(row)) for row in rows[labels == 1].tolist()}
    assert {tuple(sorted(place[tuple(p)] for p in points[row].tolist()))
            for row in cells[small]} == now
