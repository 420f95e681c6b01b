"""Vertices of a surface that are laid out in rows, and lines of like edges."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial import Delaunay, cKDTree
from scipy.spatial.distance import pdist
from surface_meshes import cube, cylinder, sphere, torus

import odt_plugins
from odt_plugins.engine.ground.build import make_ground
from odt_plugins.engine.retile import rows
from odt_plugins.engine.retile import surface as resizing
from odt_plugins.engine.retile.areas import PART, heights
from odt_plugins.engine.retile.front import APART, Field, make_front, place_rows
from odt_plugins.engine.retile.rows import lay_in_rows
from odt_plugins.engine.topology.star import vertex_stars
from odt_plugins.mesh.surface import surface_edges


def square(n, seed=0):
    """Points at random in the unit square, n to an edge of its rim, and their triangles."""
    rng = np.random.default_rng(seed)
    along = np.linspace(0, 1, n + 1)[1:-1]
    along = along + rng.uniform(-0.35, 0.35, n - 1) / n
    zero, one = np.zeros(n - 1), np.ones(n - 1)
    rim = [np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])]
    rim += [np.column_stack(xy) for xy in (
        (along, zero), (along, one), (zero, along), (one, along))]
    inner = rng.uniform(0.5 / n, 1 - 0.5 / n, (n * n, 2))
    points = np.concatenate([*rim, inner])
    cells = Delaunay(points).simplices
    u, v = points[cells[:, 1]] - points[cells[:, 0]], points[cells[:, 2]] - points[cells[:, 0]]
    area = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    return points, cells[area > 1e-12].astype(np.int32)


def qualities(points, cells):
    """Ratio of twice the inner to the outer radius: 4 |sin A sin B sin C| / (sin A + ...)."""
    sides = points[cells[:, [1, 2, 0]]] - points[cells[:, [2, 0, 1]]]
    a, b, c = np.linalg.norm(sides, axis=2).T
    return (b + c - a) * (c + a - b) * (a + b - c) / (a * b * c)


def on_rim(points):
    return ((points == 0) | (points == 1)).any(axis=1)


@pytest.mark.parametrize("length", [0.04, 0.0625])
def test_most_vertices_of_a_plane_get_six_neighbours(length):
    made, cells = odt_plugins.remesh(square(14), length, envelope=1e-3)
    q = qualities(made, cells)
    assert q.mean() > 0.99
    assert np.quantile(q, 0.01) > 0.9
    degree = np.bincount(cells.ravel())[~on_rim(made)]
    assert (degree == 6).mean() > 0.8


def test_lines_get_as_many_like_edges_as_their_length_asks_for():
    made, _ = odt_plugins.remesh(square(14), 0.05, envelope=1e-3)
    for axis in range(2):
        for side in (0.0, 1.0):
            at = np.sort(made[made[:, axis] == side, 1 - axis])
            assert len(at) == 21
            np.testing.assert_allclose(np.diff(at), 0.05, rtol=0.2)


def test_rows_keep_to_regions_lines_and_what_is_frozen():
    points, cells = square(16)
    middle = points[cells].mean(axis=1)
    regions = (middle[:, 0] > 0.5).astype(np.int32)
    frozen = np.linalg.norm(middle - 0.25, axis=1) < 0.12
    (made, new, _), report = odt_plugins.remesh_with_report(
        (points, cells), 0.05, envelope=1e-3, regions=regions, selection=~frozen)
    assert report.fallback is None
    assert {tuple(np.sort(points[c], axis=0).ravel()) for c in cells[frozen]} <= {
        tuple(np.sort(made[c], axis=0).ravel()) for c in new}
    assert qualities(made, new).mean() > 0.95


def placed(points, cells, patches, row, corner, length, bend=1e-8):
    """Places of a front that starts at the edges opposite to corners of triangles."""
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    found, stars = surface_edges(cells, len(points)), vertex_stars(cells, len(points))
    ground = make_ground(points, cells, found, stars, np.zeros(len(found.degree), dtype=np.bool_))
    edges = np.column_stack([cells[row, (corner + 1) % 3], cells[row, (corner + 2) % 3]])
    outer, at, number = np.unique(edges, return_index=True, return_inverse=True)
    n = len(outer)
    front = make_front(points[outer], np.repeat(row, 2)[at].astype(np.int32), np.full(n, length),
                       number.reshape(-1, 2).astype(np.int32), 30 * math.ceil(length**-2))
    sizes = np.full(len(points), length)
    assert place_rows(front, Field(ground, sizes, patches, length, bend))
    return front.points[n : front.count[0]], front.points[:n]


def test_places_are_apart_and_leave_no_gap():
    points, cells = square(20)
    ends = surface_edges(cells, len(points))
    rim = np.flatnonzero(ends.degree == 1)
    length = 0.05
    places, outer = placed(points, cells, np.zeros(len(cells), np.int32),
                           *np.nonzero(np.isin(ends.of_cell, rim)), length)
    places, outer = places[:, :2], outer[:, :2]
    assert ((places > 0) & (places < 1)).all()
    assert pdist(places).min() >= APART * length
    assert len(places) == pytest.approx(2 / 3**0.5 / length**2, rel=0.15)
    every = np.concatenate([places, outer])
    corners = every[Delaunay(every).simplices]
    inside = ((corners > 2 * length) & (corners < 1 - 2 * length)).all(axis=(1, 2))
    longest = np.linalg.norm(corners - corners[:, [1, 2, 0]], axis=2).max(axis=1)
    assert longest[inside].max() < 1.8 * length


def test_places_stay_on_their_side_of_a_border():
    points, cells = square(20)
    patches = (points[cells].mean(axis=1)[:, 0] > 0.5).astype(np.int32)
    ends = surface_edges(cells, len(points))
    left = np.flatnonzero(patches == 0)
    row, corner = np.nonzero(ends.degree[ends.of_cell[left]] == 1)
    places, _ = placed(points, cells, patches, left[row], corner, 0.05)
    held = Delaunay(points).find_simplex(places[:, :2])
    middle = points[Delaunay(points).simplices].mean(axis=1)[held]
    assert len(places) > 100
    assert (middle[:, 0] <= 0.5).all()


def test_places_cover_a_sphere_from_one_triangle_on():
    points, cells = sphere(4)
    length = 0.15
    cells = cells.astype(np.int32)
    beside = surface_edges(cells, len(points)).neighbors[0]
    corner = (~np.isin(cells[beside], cells[0])).argmax(axis=1)
    places, _ = placed(points, cells, np.zeros(len(cells), np.int32), beside, corner, length, 0.25)
    assert np.linalg.norm(places, axis=1) == pytest.approx(1.0, abs=5e-3)
    assert pdist(places).min() >= APART * length
    assert len(places) == pytest.approx(4 * np.pi * 2 / 3**0.5 / length**2, rel=0.15)
    gaps = cKDTree(places).query(points)[0]
    assert gaps.max() < length


def test_sides_of_a_thin_plate_do_not_see_each_other():
    points, cells = cube(8)
    (made, new), report = odt_plugins.remesh_with_report(
        (points * [1.0, 1.0, 0.02], cells), 0.08, envelope=1e-3)
    assert report.fallback is None
    for z in (points[:, 2].min(), points[:, 2].max()):
        side = new[(made[new, 2] == 0.02 * z).all(axis=1)]
        inner = np.setdiff1d(side, new[(made[new, 2] != 0.02 * z).any(axis=1)])
        assert len(inner) > 60
        degree = np.bincount(side.ravel())[inner]
        assert (degree == 6).mean() > 0.8
        assert qualities(made, side).mean() > 0.97


@pytest.mark.parametrize("shape", ["torus", "cylinder"])
def test_most_vertices_of_a_curved_surface_get_six_neighbours(shape):
    points, cells = torus(80, 32) if shape == "torus" else cylinder(64, 24, 10)
    made, new = odt_plugins.remesh((points, cells), 0.1, envelope=1e-2)
    assert (np.bincount(new.ravel()) == 6).mean() > 0.85
    assert qualities(made, new).mean() > 0.985
    assert np.quantile(qualities(made, new), 0.01) > 0.9


@pytest.mark.parametrize("most", [-1.0, 0.06])
def test_a_net_in_which_old_vertices_are_left_is_as_it_was(most, monkeypatch):
    seen = []

    def watched(net, passes, patches):
        before = passes.kept(net)
        found = lay_in_rows(net, passes, patches)
        assert (passes.last == before[1]) is (most < 0)
        seen.append(all(map(np.array_equal, before[0], found)))
        return found

    monkeypatch.setattr(resizing, "lay_in_rows", watched)
    monkeypatch.setattr(rows, "MOST_LEFT", most)
    odt_plugins.remesh(sphere(3, 0.1), scale=1.5, envelope=1e-2)
    assert seen == [most < 0]


def disc(n):
    """A fine mesh of the unit disc, and the area of its polygon."""
    rings = [np.zeros((1, 2))]
    for k in range(1, n + 1):
        angle = 2 * np.pi * (np.arange(6 * k) + 0.5 * (k % 2)) / (6 * k)
        rings.append(k / n * np.column_stack([np.cos(angle), np.sin(angle)]))
    points = np.concatenate(rings)
    return points, Delaunay(points).simplices.astype(np.int32)


def area(points, cells):
    u, v = points[cells[:, 1]] - points[cells[:, 0]], points[cells[:, 2]] - points[cells[:, 0]]
    return float(np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).sum() / 2)


@pytest.mark.parametrize("length", [0.15, 0.5])
def test_a_coarse_rim_keeps_the_area_and_sizes_grow_from_it(length):
    points, cells = disc(30)
    (made, new), report = odt_plugins.remesh_with_report((points, cells), length, envelope=0.02)
    assert report.fallback is None
    assert area(made, new) == pytest.approx(area(points, cells), rel=3e-3)
    assert len(made) < 0.1 * len(points)
    assert qualities(made, new).min() > 0.6


def test_heights_of_a_circle_and_of_straight_lines():
    points, cells = disc(30)
    edges = surface_edges(cells, len(points))
    rim = np.flatnonzero(edges.degree == 1)
    order = rim[np.argsort(np.arctan2(*points[edges.vertices[rim]].mean(axis=1).T))]
    chain = np.zeros(len(order), dtype=np.int32)
    labels = np.zeros(len(cells), dtype=np.int32)
    ends = edges.vertices[order].astype(np.int64)
    turned = [set(a) & set(b) for a, b in zip(ends, np.roll(ends, -1, axis=0), strict=True)]
    assert all(len(shared) == 1 for shared in turned)
    for k in range(len(ends)):
        if {ends[k, 0]} == turned[k]:
            ends[k] = ends[k, ::-1]
    found = heights(points, cells, labels, edges, order, ends, chain, 1)
    perimeter = 2 * len(order) * np.sin(np.pi / len(order))
    assert found[0] == pytest.approx(1.5 * PART * area(points, cells) / perimeter, rel=1e-12)
    square_points, square_cells = square(8)
    edges = surface_edges(square_cells, len(square_points))
    bottom = np.flatnonzero((square_points[edges.vertices, 1] == 0).all(axis=1))
    bottom = bottom[np.argsort(square_points[edges.vertices[bottom], 0].min(axis=1))]
    ends = edges.vertices[bottom].astype(np.int64)
    ends = np.take_along_axis(ends, np.argsort(square_points[ends, 0], axis=1), axis=1)
    straight = heights(square_points, square_cells, np.zeros(len(square_cells), np.int32), edges,
                       bottom, ends, np.zeros(len(bottom), np.int32), 1)
    assert straight[0] == np.inf
