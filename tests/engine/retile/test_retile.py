"""Triangles that are given other sizes, held against shapes of which everything is known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import igl
import numpy as np
import pytest
from surface_meshes import bowl, cube, cylinder, sphere, torus

from odt_plugins.engine.cells.extremes import FREELY
from odt_plugins.engine.retile.passes import Passes, at_thin
from odt_plugins.engine.retile.run import ATTEMPTS, retile
from odt_plugins.engine.retile.surface import Base, resize
from odt_plugins.engine.run.outcome import as_it_is
from odt_plugins.mesh.simplex import simplex_mesh
from odt_plugins.mesh.surface import surface_edges, surface_mesh
from odt_plugins.options import Options
from odt_plugins.promise.retiled import broken_by_retiling


def edge_lengths(points, cells):
    ends = points[surface_edges(cells.astype(np.int32), len(points)).vertices]
    return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)


def resized(points, cells, scale, *, envelope=1e-2, boundary="slide", **given):
    """The input, the result, and the length that was asked for."""
    planar = points.shape[1] == 2
    mesh = simplex_mesh(points, cells, **given)[0] if planar else surface_mesh(
        points, cells, **given)
    length = scale * edge_lengths(points, mesh.cells).mean()
    options = Options(envelope=envelope, boundary=boundary)
    outcome = retile(mesh, np.full(len(points), length), options, as_it_is)
    assert outcome.fallback is None
    return mesh, outcome, length


def euler(cells):
    edges = surface_edges(cells, int(cells.max()) + 1)
    return len(np.unique(cells)) - len(edges.degree) + len(cells)


def share_in(outcome, length):
    ratio = edge_lengths(outcome.points, outcome.cells) / length
    return ((ratio > 0.5**0.5) & (ratio < 2**0.5)).mean()


def furthest(points, cells, others, triangles):
    """Largest distance of many points of a surface from another one."""
    weights = np.random.default_rng(1).dirichlet(np.ones(3), 40)
    samples = np.einsum("ki,mij->mkj", weights, points[cells]).reshape(-1, 3)
    samples = np.concatenate([samples, points[np.unique(cells)]])
    return igl.point_mesh_squared_distance(samples, others, triangles.astype(np.int64))[0].max()**.5


@pytest.mark.parametrize("make", [lambda: sphere(3, 0.2), lambda: torus(noise=0.2)],
                         ids=["sphere", "torus"])
@pytest.mark.parametrize("scale", [0.6, 1.0, 1.8])
def test_a_smooth_surface_has_the_size_within_the_envelope(make, scale):
    mesh, outcome, length = resized(*make(), scale)
    limit = 1e-2 * np.linalg.norm(np.ptp(mesh.points, axis=0))
    assert euler(outcome.cells) == euler(mesh.cells)
    assert furthest(outcome.points, outcome.cells, mesh.points, mesh.cells) <= limit
    assert furthest(mesh.points, mesh.cells, outcome.points, outcome.cells) <= limit
    assert share_in(outcome, length) > 0.97
    edges = surface_edges(outcome.cells, len(outcome.points))
    assert (edges.degree == 2).all()


@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_a_box_keeps_corners_creases_and_volume(scale):
    _, outcome, length = resized(*cube(8, 0.3), scale, envelope=1e-3)
    corners = outcome.points[outcome.cells]
    volume = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6
    assert volume == pytest.approx(1.0, abs=1e-12)
    eight = {tuple(x) for x in np.ndindex(2, 2, 2)}
    assert eight <= {tuple(x) for x in outcome.points.tolist()}
    assert share_in(outcome, length) > 0.95


def test_creases_of_a_cylinder_stay_within_the_envelope():
    mesh, outcome, _ = resized(*cylinder(noise=0.2), 1.4, envelope=5e-3)
    limit = 5e-3 * np.linalg.norm(np.ptp(mesh.points, axis=0))
    for z in (0.0, 2.0):
        ring = outcome.points[np.unique(outcome.cells)]
        ring = ring[(ring[:, 2] == z) & (np.linalg.norm(ring[:, :2], axis=1) > 0.9)]
        angles = np.sort(np.arctan2(ring[:, 1], ring[:, 0]))
        gap = np.diff(np.append(angles, angles[0] + 2 * np.pi)).max()
        assert np.linalg.norm(ring[:, :2], axis=1).max() <= 1 + 1e-12
        assert np.cos(np.pi / 32) - np.cos(gap / 2) <= limit


def labelled_bowl():
    points, cells = bowl(25, 0.3)
    centre = points[cells].mean(axis=1)
    return points, cells, (centre[:, 0] > 0.1) + 2 * (centre[:, 1] > 0)


@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize("scale", [0.6, 1.5])
def test_rims_and_borders_of_labels_stay_where_they_are(planar, scale):
    points, cells, regions = labelled_bowl()
    points = points[:, :2].copy() if planar else points
    mesh, outcome, length = resized(points, cells, scale, regions=regions)
    flat = [np.abs(np.linalg.det(x[t[:, 1:], :2] - x[t[:, :1], :2])) / 2
            for x, t in ((mesh.points, mesh.cells), (outcome.points, outcome.cells))]
    assert flat[1].sum() == pytest.approx(4.0, rel=1e-12)
    for label in range(4):
        was = flat[0][mesh.regions == label].sum()
        assert flat[1][outcome.regions == label].sum() == pytest.approx(was, rel=3e-3)
    if planar:
        assert share_in(outcome, length) > 0.7
    assert euler(outcome.cells) == 1


@pytest.mark.parametrize("planar", [False, True])
def test_what_is_fixed_stays_bit_for_bit(planar):
    points, cells, regions = labelled_bowl()
    points = points[:, :2].copy() if planar else points
    inside = np.flatnonzero((points[:, :2] ** 2).sum(axis=1) < 0.05)
    frozen = points[cells].mean(axis=1)[:, 0] < -0.5
    mesh, outcome, _ = resized(points, cells, 1.6, regions=regions, fixed=inside,
                               selection=~frozen, boundary="fixed")
    new = {tuple(x) for x in outcome.points.tolist()}
    old = surface_edges(mesh.cells, len(points))
    rims = old.vertices[old.degree == 1].ravel()
    for v in np.concatenate([inside, rims, mesh.cells[mesh.frozen].ravel()]):
        assert tuple(points[v].tolist()) in new
    kept = {tuple(np.sort(outcome.origin[t])) for t in outcome.cells}
    assert all(tuple(np.sort(t)) in kept for t in mesh.cells[mesh.frozen])
    assert len(outcome.cells) < len(cells)


def test_sizes_follow_a_field():
    points, cells = sphere(3, 0.1)
    mesh = surface_mesh(points, cells)
    sizes = np.where(points[:, 2] > 0, 0.25, 0.1)
    sizes = np.clip(0.175 + 0.15 * points[:, 2], 0.1, 0.25)
    outcome = retile(mesh, sizes, Options(envelope=1e-2, boundary="slide"), as_it_is)
    ends = outcome.points[surface_edges(outcome.cells, len(outcome.points)).vertices]
    wanted = np.clip(0.175 + 0.15 * ends.mean(axis=1)[:, 2], 0.1, 0.25)
    ratio = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / wanted
    assert ((ratio > 0.5**0.5) & (ratio < 2**0.5)).mean() > 0.97


def test_three_sheets_at_one_edge_stay_three():
    points, cells = bowl(9)
    # a third sheet stands on the line x = 0 of a flat square
    points[:, 2] = 0.0
    seam = np.flatnonzero(points[:, 0] == 0.0)
    wall = np.concatenate([points, points[seam] + [0, 0, 0.5]])
    top = len(points) + np.arange(len(seam))
    more = [(a, b, c) for a, b, c in zip(seam[:-1], seam[1:], top[:-1], strict=True)]
    more += [(b, d, c) for b, c, d in zip(seam[1:], top[:-1], top[1:], strict=True)]
    _, outcome, _ = resized(wall, np.concatenate([cells, more]), 0.6)
    edges = surface_edges(outcome.cells, len(outcome.points))
    three = outcome.points[edges.vertices[edges.degree == 3]]
    assert np.abs(three[:, :, 0]).max() == 0.0
    assert np.linalg.norm(three[:, 1] - three[:, 0], axis=1).sum() == pytest.approx(2.0)


def test_of_three_sheets_at_one_edge_two_get_other_sizes():
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(0.0, 1.0, 9), np.linspace(-1.0, 1.0, 17)))
    first, rows = np.arange(0, 9 * 17, 9), []
    for i in range(16):
        for j in first[i] + np.arange(8):
            rows += [[j, j + 1, j + 10], [j, j + 10, j + 9]]
    sheets = [np.column_stack([x * np.cos(t), y, x * np.sin(t)]) for t in (0.0, 2.0, 4.0)]
    number = [np.arange(9 * 17) + 9 * 17 * i for i in range(3)]
    for own in number[1:]:
        own[first] = first
    cells = np.concatenate([own[np.array(rows)] for own in number])
    selection = np.flatnonzero((cells < 2 * 9 * 17).all(axis=1))
    mesh, outcome, _ = resized(np.concatenate(sheets), cells, 2.0, selection=selection)
    edges = surface_edges(outcome.cells, len(outcome.points))
    assert (edges.degree == 3).sum() == 16
    kept = {*map(tuple, np.sort(mesh.points[cells[len(selection):]].reshape(-1, 9)).tolist())}
    now = {*map(tuple, np.sort(outcome.points[outcome.cells].reshape(-1, 9)).tolist())}
    assert kept <= now
    assert len(outcome.cells) < 0.7 * len(cells)


def test_no_vertex_may_go_where_two_lines_would_become_one():
    # a triangle of three straight rims: one cell is the coarsest
    points = np.array([[0.0, 0], [4, 0], [2, 3.5], [2, 0], [3, 1.75], [1, 1.75]])
    cells = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
    mesh, _ = simplex_mesh(points, cells)
    outcome = retile(mesh, np.full(6, 9.0), Options(boundary="slide", keep=()), as_it_is)
    assert len(outcome.cells) == 1
    assert {tuple(x) for x in outcome.points.tolist()} == {(0, 0), (4, 0), (2, 3.5)}


@pytest.mark.parametrize(("thin", "least", "most"), [(0.0, 60, 1000), (10.0, 1, 18)])
def test_no_edge_of_a_thin_triangle_is_split(thin, least, most):
    points, cells = bowl(4, 0.2)
    n, cells = len(points), cells.astype(np.int32)
    edges = surface_edges(cells, n)
    no = np.zeros(len(edges.degree), dtype=bool)
    base = Base(points, cells, np.zeros(len(cells), dtype=np.int32), edges, np.zeros(n, dtype=bool),
                no, no, np.empty((n, 0)), thin)
    net, _ = resize(base, np.full(n, 0.2), np.full(len(cells), 0.1), FREELY, feature_angle=40.0)
    assert least <= net.count[1] <= most


def test_a_needle_is_not_split_into_triangles_that_are_flat_but_for_rounding():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1e-9, 0], [0, 1, 1]])
    cells = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    net = SimpleNamespace(points=points, triangles=cells, count=[4, 2])
    pairs = np.array([[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]])
    assert at_thin(net, pairs, 0.0).tolist() == [True, True, False, True, False]
    assert at_thin(net, pairs, 2.0).all()


def test_the_same_bits_twice():
    first, second = (resized(*sphere(2, 0.2), 0.7)[1] for _ in range(2))
    assert np.array_equal(first.points, second.points)
    assert np.array_equal(first.cells, second.cells)


@pytest.mark.parametrize(("most", "attempts"), [(np.inf, ATTEMPTS), (100.0, 1)])
def test_what_made_too_many_triangles_is_not_made_again(most, attempts):
    points, cells = sphere(2)
    mesh = surface_mesh(points, cells)
    judged = []

    def spoil(outcome):
        judged.append(len(outcome.points))
        moved = outcome.points.copy()
        moved[10 * len(judged)] *= 1.1
        return replace(outcome, points=moved)

    outcome = retile(mesh, np.full(len(points), 0.2), Options(envelope=1e-3), spoil, most)
    assert len(judged) == attempts + 1
    assert "the input is returned" in outcome.fallback


def test_edges_without_length_ask_for_no_sizes(monkeypatch):
    relent, seen = Passes.relent, []

    def with_twins(self, net, edges):
        a, b = net.triangles[0, :2]
        there = net.points[b].copy()
        net.points[b] = net.points[a]
        relent(self, net, edges)
        net.points[b] = there
        seen.append(self.sizes.min())

    monkeypatch.setattr(Passes, "relent", with_twins)
    points, cells = sphere(2)
    with np.errstate(divide="raise"):
        retile(surface_mesh(points, cells), np.full(len(points), 0.2), Options(envelope=1e-2),
               as_it_is)
    assert min(seen) > 1e-3


def broken(mesh, outcome):
    return " ".join(broken_by_retiling(
        mesh, outcome.points, outcome.cells, outcome.regions, outcome.origin, (), outcome.metric,
            outcome.faces[0]))


def test_the_judge_sees_what_is_broken():
    points, cells, regions = labelled_bowl()
    mesh, outcome, _ = resized(points[:, :2].copy(), cells, 1.0, regions=regions)
    assert not broken(mesh, outcome)
    edges = surface_edges(outcome.cells, len(outcome.points))
    rest = np.delete(np.arange(len(outcome.cells)), np.argmax((edges.neighbors >= 0).all(axis=1)))
    assert "Euler" in broken(mesh, replace(outcome, cells=outcome.cells[rest],
                                           regions=outcome.regions[rest]))
    turned = outcome.cells.copy()
    turned[0] = turned[0, ::-1]
    assert "no positive area" in broken(mesh, replace(outcome, cells=turned))
    assert "twice" in broken(mesh, replace(outcome, cells=outcome.cells[
        np.append(np.arange(len(turned) - 1), 0)]))
    labels = outcome.regions.copy()
    labels[0] = (labels[0] + 1) % 4
    assert "border" in broken(mesh, replace(outcome, regions=labels))
    moved = outcome.points.copy()
    moved[0] += 1e-9
    held = replace(mesh, fixed=np.arange(len(mesh.points)) == outcome.origin[0])
    assert "moved" in broken(held, replace(outcome, points=moved))
