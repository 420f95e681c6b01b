"""Newton smoothing of sum q^-p in the plane, and the planar finish."""

from __future__ import annotations

import numpy as np
import planar_meshes as planar
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planar_meshes import MEASURES

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.cells.measures import (
    DIHEDRAL,
    MEAN_RATIO,
    QUALITY,
    STEP,
    star_terms_2d,
    triangle_measure,
)
from odt_plugins.engine.finish.plane import finish2d
from odt_plugins.engine.moves.newton2d import smooth_vertices_2d
from odt_plugins.engine.topology.adjacency import cell_neighbors
from odt_plugins.engine.topology.star import vertex_stars
from odt_plugins.engine.topology.triangles import Triangles
from odt_plugins.mesh.chunks import Pool

FREE = Extremes(0.0, 1.0, -1.0)


@pytest.fixture(scope="module")
def airfoil():
    points, cells, boundary = planar.airfoil()
    return points, cells, boundary, planar.perturbed(points, cells, boundary)


def cost_and_derivatives(points, cells, vertex, power, objective=QUALITY):
    star = np.flatnonzero((cells == vertex).any(axis=1)).astype(np.int32)
    out = np.empty(5)
    cost = star_terms_2d(points, cells, star, vertex, Cost(objective, power), np.eye(2), out)
    return cost, out[:2].copy(), np.array([[out[2], out[3]], [out[3], out[4]]])


def smooth(points, cells, order, power=2.0, bounds=FREE, objective=QUALITY):
    points = points.copy()
    stars = vertex_stars(cells, len(points))
    moved = np.zeros(len(points))
    order = np.asarray(order, dtype=np.int32)
    count = 0
    for k in range(len(order)):
        count += smooth_vertices_2d(points, cells, stars, order, k, k + 1,
                                    Cost(objective, power), bounds, moved)
    return points, moved, count


def jittered(seed, n=5, holes=frozenset({(2, 2)})):
    rng = np.random.default_rng(seed)
    points, cells, boundary = planar.jittered_grid(n, n, rng, 0.24, holes)
    turn = rng.uniform(0.0, 6.0)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return points @ rotation.T, cells, np.flatnonzero(~boundary), boundary


def finished(points, cells, regions, movable, **settings):
    """Points and cells of a copy that `finish2d` worked on, whose neighbours fit."""
    points, cells = points.copy(), cells.copy()
    neighbors = cell_neighbors(cells)
    finish2d(Triangles(points, cells, neighbors, regions), movable, **settings)
    np.testing.assert_array_equal(neighbors, cell_neighbors(cells))
    return points, cells


EVERY = pytest.mark.parametrize("objective", MEASURES,
                                ids=["radius ratio", "mean ratio", "angle", "step"])


@pytest.mark.usefixtures("kernels_in_python")
@EVERY
def test_measure_of_a_triangle(objective):
    regular = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, np.sqrt(0.75)]])
    best = 0.25**0.125 if objective == STEP else 1.0
    assert triangle_measure(regular, 0, 1, 2, objective) == pytest.approx(best, abs=1e-14)
    assert triangle_measure(regular, 1, 0, 2, objective) < 0
    assert triangle_measure(np.zeros((3, 2)), 0, 1, 2, objective) <= 0
    right = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    closed = {QUALITY: 2 * np.sqrt(2) - 2, MEAN_RATIO: 0.75,
              DIHEDRAL: 4 / 3 * ((1 + 2 * 2**4) / 3) ** -0.25, STEP: 0.25**0.125}
    assert triangle_measure(right, 0, 1, 2, objective) == pytest.approx(closed[objective])
    for seed in range(200):
        rng = np.random.default_rng(seed)
        points = regular + (0.01 if seed % 2 else 0.25) * rng.normal(size=(3, 2))
        m = triangle_measure(points, 0, 1, 2, objective)
        assert m < 1.0
        assert triangle_measure(points, 1, 2, 0, objective) == pytest.approx(m, rel=1e-12)
        turned = 7.0 * points @ np.array([[0.6, 0.8], [-0.8, 0.6]]) - 3.0
        m *= 7.0**0.25 if objective == STEP and m > 0.0 else 1.0
        assert triangle_measure(turned, 0, 1, 2, objective) == pytest.approx(m, rel=1e-9)


@pytest.mark.usefixtures("kernels_in_python")
@EVERY
@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), power=st.sampled_from([0.5, 1.0, 2.0, 4.0, 8.0]))
def test_cost_gradient_and_hessian(objective, seed, power):
    points, cells, inner, _ = jittered(seed)
    vertex = int(inner[seed % len(inner)])
    star = cells[(cells == vertex).any(axis=1)]
    cost, gradient, hessian = cost_and_derivatives(points, cells, vertex, power, objective)
    assert cost == pytest.approx((MEASURES[objective](points, star) ** -power).sum(), rel=1e-9)
    step = 1e-5
    numeric, numeric_hessian = np.empty(2), np.empty((2, 2))
    for k in range(2):
        sides = []
        for sign in (1.0, -1.0):
            moved = points.copy()
            moved[vertex, k] += sign * step
            sides.append(cost_and_derivatives(moved, cells, vertex, power, objective))
        numeric[k] = (sides[0][0] - sides[1][0]) / (2 * step)
        numeric_hessian[k] = (sides[0][1] - sides[1][1]) / (2 * step)
    scale = np.abs(hessian).max()
    np.testing.assert_allclose(gradient, numeric, atol=1e-4 * scale)
    np.testing.assert_allclose(hessian, numeric_hessian, atol=1e-3 * scale)


@pytest.mark.usefixtures("nothing_compiled")
def test_cost_of_an_inverted_star_is_infinite():
    points, cells, inner, _ = jittered(1)
    points[inner[0]] += 50.0
    assert cost_and_derivatives(points, cells, int(inner[0]), 2.0)[0] == np.inf


@pytest.mark.usefixtures("nothing_compiled")
@pytest.mark.parametrize("power", [1.0, 2.0, 8.0])
def test_vertex_of_a_hexagon_goes_to_its_centre(power):
    angle = np.arange(6) * np.pi / 3.0
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.vstack([[0.35, -0.3], ring]) * 3.0 + [7.0, -2.0]
    cells = np.array([[0, k + 1, (k + 1) % 6 + 1] for k in range(6)], dtype=np.int32)
    points, _, _ = smooth(points, cells, [0] * 12, power)
    # a vertex rests once F_p would fall by less than 1e-10, that is within about 1e-5 edge lengths
    np.testing.assert_allclose(points[0], [7.0, -2.0], atol=1e-4)
    cost, gradient, hessian = cost_and_derivatives(points, cells, 0, power)
    assert cost == pytest.approx(6.0)
    np.testing.assert_allclose(gradient, 0.0, atol=1e-2)
    assert np.linalg.eigvalsh(hessian).min() > 0


@EVERY
@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), power=st.sampled_from([1.0, 2.0, 8.0]))
def test_every_move_lowers_the_sum(objective, seed, power):
    points, cells, inner, boundary = jittered(seed)
    total = (MEASURES[objective](points, cells) ** -power).sum()
    gained = 0
    for vertex in inner:
        new, moved, count = smooth(points, cells, [vertex], power, objective=objective)
        after = (MEASURES[objective](new, cells) ** -power).sum()
        assert (planar.areas(new, cells) > 0).all()
        assert (after < total) if count else (after == total)
        assert (moved[vertex] > 0) == (count == 1) == (new[vertex] != points[vertex]).any()
        np.testing.assert_array_equal(np.delete(new, vertex, 0), np.delete(points, vertex, 0))
        points, total = new, after
        gained += count
    assert gained > 0
    assert boundary.any()


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), which=st.sampled_from([0, 1, 2]))
def test_smoothing_stays_within_bounds(seed, which):
    points, cells, inner, _ = jittered(seed)
    q, angles = planar.shape(points, cells)
    tight = [q.min(), np.cos(np.radians(angles.min())), np.cos(np.radians(angles.max()))]
    bounds = FREE._replace(**{FREE._fields[which]: tight[which]})
    new, _, _ = smooth(points, cells, inner, 0.2, bounds)
    new_q, new_angles = planar.shape(new, cells)
    worse = [q.min() - new_q.min(), angles.min() - new_angles.min(),
             new_angles.max() - angles.max()]
    assert worse[which] <= 1e-7


def goodness(points, cells):
    """Three figures, each the better the larger: worst q, smallest angle, minus the largest."""
    q, angles = planar.shape(points, cells)
    return np.array([q.min(), angles.min(), -angles.max()])


@pytest.mark.parametrize("which", [0, 1, 2])
def test_bounds_stop_a_move_that_free_smoothing_makes(which):
    bounds = FREE._replace(**{FREE._fields[which]: (1.0, -1.0, 1.0)[which]})
    stopped = 0
    for seed in range(40):
        points, cells, inner, _ = jittered(seed)
        for vertex in inner:
            star = cells[(cells == vertex).any(axis=1)]
            free, _, count = smooth(points, cells, [vertex], 0.2)
            before = goodness(points, star)[which]
            if count and goodness(free, star)[which] < before - 1e-9:
                kept, _, _ = smooth(points, cells, [vertex], 0.2, bounds)
                assert goodness(kept, star)[which] >= before - 1e-9
                stopped += 1
    assert stopped > 0


def test_stuck_vertex_without_cells_and_range():
    points, cells, inner, _ = jittered(4)
    points = np.vstack([points, [[9.0, 9.0]]])
    alone = len(points) - 1
    new, moved, count = smooth(points, cells, [alone])
    assert count == 0
    np.testing.assert_array_equal(new, points)
    stars = vertex_stars(cells, len(points))
    order = inner.astype(np.int32)
    work = points.copy()
    smooth_vertices_2d(work, cells, stars, order, 1, 2, Cost(QUALITY, 2.0), FREE, moved)
    np.testing.assert_array_equal(np.delete(work, order[1], 0), np.delete(points, order[1], 0))


def test_finish_reaches_the_target_on_the_perturbed_airfoil(airfoil):
    good, cells, boundary, points = airfoil
    regions = np.zeros(len(cells), dtype=np.int32)
    q, angles = planar.shape(points, cells)
    assert 4000 < len(cells) < 8000
    assert 0.24 < q.min() < 0.3
    assert 0.885 < q.mean() < 0.905
    new, connectivity = finished(points, cells, regions, ~boundary)
    new_q, new_angles = planar.shape(new, connectivity)
    assert new_q.min() >= 0.75
    assert new_q.mean() >= 0.965
    assert new_angles.min() > angles.min() + 10.0
    assert new_angles.max() < angles.max() - 30.0
    assert (planar.areas(new, connectivity) > 0).all()
    np.testing.assert_array_equal(new[boundary], points[boundary])
    assert planar.kept_edges(connectivity, regions) == planar.kept_edges(cells, regions)
    np.testing.assert_array_equal(np.unique(connectivity), np.unique(cells))
    assert planar.areas(new, connectivity).sum() == pytest.approx(planar.areas(good, cells).sum())
    sizes = []
    for x, c in ((good, cells), (new, connectivity)):
        star = np.bincount(c.ravel(), np.repeat(planar.areas(x, c), 3), len(x))
        sizes.append(np.sqrt(star / np.bincount(c.ravel(), minlength=len(x))))
    ratio = sizes[1] / sizes[0]
    assert sizes[0].max() / sizes[0].min() > 10.0
    assert 0.98 < np.median(ratio) < 1.02
    assert np.quantile(ratio, 0.01) > 0.8
    assert np.quantile(ratio, 0.99) < 1.18


def test_finish_does_not_depend_on_threads(airfoil):
    _, cells, boundary, points = airfoil
    regions = np.zeros(len(cells), dtype=np.int32)
    alone = finished(points, cells, regions, ~boundary)
    with Pool(3) as pool:
        shared = finished(points, cells, regions, ~boundary, pool=pool, threads=3)
    for a, b in zip(alone, shared, strict=True):
        np.testing.assert_array_equal(a, b)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), two=st.booleans())
def test_finish_keeps_regions_fixed_vertices_and_extremes(seed, two):
    points, cells, _, _ = jittered(seed, n=6, holes=frozenset({(2, 2), (4, 1), (5, 5)}))
    rng = np.random.default_rng(seed)
    regions = (points[cells].mean(axis=1)[:, 0] > np.median(points[:, 0])).astype(np.int32) * two
    movable = ~planar.kept_vertices(cells, regions, len(points)) & (rng.random(len(points)) < 0.8)
    new, connectivity = finished(points, cells, regions, movable)
    np.testing.assert_array_equal(new[~movable], points[~movable])
    assert planar.kept_edges(connectivity, regions) == planar.kept_edges(cells, regions)
    for label in np.unique(regions):
        here = planar.areas(points, cells[regions == label])
        there = planar.areas(new, connectivity[regions == label])
        assert (there > 0).all()
        assert there.sum() == pytest.approx(here.sum(), rel=1e-12)
    (q, angles), (new_q, new_angles) = (
        planar.shape(x, c) for x, c in ((points, cells), (new, connectivity)))
    assert new_q.min() >= q.min() - 1e-12
    assert new_q.mean() > q.mean()
    assert new_angles.min() >= angles.min() - 1e-6
    assert new_angles.max() <= angles.max() + 1e-6


def test_finish_touches_only_movable_cells(airfoil):
    _, cells, boundary, points = airfoil
    regions = np.zeros(len(cells), dtype=np.int32)
    chosen = np.linalg.norm(points[cells].mean(axis=1), axis=1) < 0.8
    movable = ~boundary
    movable[cells[~chosen]] = False
    new, connectivity = finished(points, cells, regions, movable, movable_cells=chosen)
    np.testing.assert_array_equal(connectivity[~chosen], cells[~chosen])
    np.testing.assert_array_equal(new[~movable], points[~movable])
    assert (connectivity[chosen] != cells[chosen]).any()
    assert planar.shape(new, connectivity[chosen])[0].min() > planar.shape(
        points, cells[chosen])[0].min()


def test_finish_of_nothing_and_of_a_perfect_mesh():
    nothing = np.empty((0, 3), dtype=np.int32)
    empty = Triangles(np.zeros((0, 2)), nothing, nothing.copy(), np.empty(0, dtype=np.int32))
    assert finish2d(empty, np.empty(0, dtype=bool)) == (0, 0)
    i, j = np.mgrid[:6, :6]
    points = np.stack([i.ravel() + 0.5 * j.ravel(), j.ravel() * np.sqrt(0.75)], axis=1)
    index = np.arange(36).reshape(6, 6)
    lower = np.stack([index[:-1, :-1], index[1:, :-1], index[:-1, 1:]], axis=-1).reshape(-1, 3)
    upper = np.stack([index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 3)
    cells = np.vstack([lower, upper]).astype(np.int32)
    regions = np.zeros(len(cells), dtype=np.int32)
    movable = ~planar.kept_vertices(cells, regions, len(points))
    new, connectivity = finished(points, cells, regions, movable)
    np.testing.assert_allclose(new, points, atol=1e-7)
    np.testing.assert_array_equal(connectivity, cells)
