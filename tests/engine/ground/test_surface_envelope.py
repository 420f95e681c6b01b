"""Closest points, envelopes and distances of surfaces, against closed forms and slow twins."""

from __future__ import annotations

import numpy as np
import pytest
import surface_meshes as sm
from hypothesis import given, settings
from hypothesis import strategies as st

from odt_plugins.engine.ground.closest import closest_on_triangle, walk
from odt_plugins.engine.ground.envelope import distances, uncovered, within
from odt_plugins.engine.ground.overlay import height_over, make_overlay_work
from odt_plugins.engine.ground.reference import make_reference, make_surface
from odt_plugins.errors import InvalidMeshError

ONE = np.array([[0, 1, 2]], dtype=np.int32)

coordinate = st.floats(-1, 1, allow_nan=False, width=32)
point = st.tuples(coordinate, coordinate, coordinate)


@settings(max_examples=200, deadline=None)
@given(point, point, point, point)
def test_closest_point_of_one_triangle(a, b, c, x):
    corners = np.array([a, b, c])
    square, _, *foot = closest_on_triangle.py_func(*x, corners, 0, 1, 2)
    expected = sm.distances(np.array([x]), corners, ONE)[0]
    assert np.sqrt(square) == pytest.approx(expected, abs=1e-7)
    assert np.linalg.norm(np.array(foot) - x) == pytest.approx(np.sqrt(square), abs=1e-12)
    assert sm.distances(np.array([foot]), corners, ONE)[0] < 1e-7


@pytest.mark.usefixtures("kernels_in_python")
def test_tree_and_walk_agree_with_the_slow_twin():
    points, cells = sm.sphere(3)
    rng = np.random.default_rng(11)
    x = rng.normal(size=(200, 3))
    x *= rng.uniform(0.8, 1.2, 200)[:, None] / np.linalg.norm(x, axis=1)[:, None]
    reference = make_reference(points, cells)
    distance, face, foot = reference.closest(x)
    expected = sm.distances(x, points, cells)
    np.testing.assert_allclose(distance, expected, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(foot - x, axis=1), expected, atol=1e-14)
    for i in range(200):
        start = int(rng.integers(len(cells)))
        assert np.sqrt(walk(*x[i], start, reference.surface, True)[0]) >= distance[i] - 1e-14
        near = int(np.flatnonzero((cells == cells[face[i], 0]).any(axis=1))[0])
        square, _, *there = walk(*x[i], near, reference.surface, True)
        assert np.sqrt(square) == pytest.approx(distance[i], abs=1e-14)
        np.testing.assert_allclose(there, foot[i], atol=1e-7)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), st.floats(0.002, 0.2), st.floats(0.0, 0.1))
def test_never_within_when_a_sample_is_outside(seed, envelope, noise):
    rng = np.random.default_rng(seed)
    points, cells = sm.sheet(4, lambda x, y: 0.1 * np.sin(5 * x + y))
    reference = make_reference(points + noise * rng.normal(size=points.shape), cells)
    moved, triangles = sm.sheet(int(rng.integers(2, 6)), lambda x, y: 0.1 * np.sin(5 * x + y))
    moved += 0.3 * envelope * rng.normal(size=moved.shape)
    sure = within(reference, moved, triangles, envelope)
    there = sm.samples(moved, triangles, 12)
    far = reference.closest(there)[0].reshape(len(triangles), -1).max(axis=1)
    assert not (sure & (far > envelope * (1 + 1e-12))).any()
    left = uncovered(reference, moved, triangles, envelope)
    covered = np.ones(len(cells), dtype=bool)
    covered[left.triangles] = False
    there = sm.samples(reference.points, cells, 12)
    result = make_reference(moved, triangles)
    far = result.closest(there)[0].reshape(len(cells), -1).max(axis=1)
    assert not (covered & (far > envelope * (1 + 1e-12))).any()


def test_most_of_what_is_within_is_known_to_be():
    points, cells = sm.sphere(3, 0.1)
    other, triangles = sm.sphere(3, 0.1, seed=8)
    reference = make_reference(points, cells)
    there = sm.samples(other, triangles, 12)
    far = reference.closest(there)[0].reshape(len(triangles), -1).max(axis=1)
    for envelope in (0.5 * far.max(), 0.8 * far.max(), 1.05 * far.max()):
        sure = within(reference, other, triangles, envelope)
        assert sure.sum() >= 0.9 * (far <= envelope).sum()
    assert sure.all()


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([1e-2, 1e-4]))
def test_bounds_enclose_the_sampled_distance(seed, tolerance):
    rng = np.random.default_rng(seed)
    a = sm.sheet(5, lambda x, y: 0.1 * np.sin(4 * x * y))
    b = sm.sheet(4, lambda x, y: 0.1 * np.sin(4 * x * y) + 0.05 * rng.normal(size=x.shape))
    found = distances(a, b, tolerance)
    for first, second, upper, lower in (
        (a, b, found.forward_upper, found.forward_lower),
        (b, a, found.backward_upper, found.backward_lower),
    ):
        there = sm.samples(*first, 12)
        far = make_reference(*second).closest(there)[0].max()
        assert far <= upper
        assert lower <= upper <= lower + tolerance
        assert far >= lower - 0.02


def test_bounds_meet_where_needles_have_a_crease_at_their_ends():
    def cone(sections, rings):
        at = np.arange(1, rings + 1)[:, None] / rings
        around = 2 * np.pi * np.arange(sections) / sections
        x, y = at * np.cos(around), at * np.sin(around)
        points = np.vstack([[[0, 0, 2], [0, 0, 0]], np.stack(
            [x, y, 2 - 2 * at + 0 * x], axis=2).reshape(-1, 3)])
        k = np.arange(sections)
        after = (k + 1) % sections
        cells = [np.c_[0 * k, 2 + k, 2 + after]]
        for ring in range(rings - 1):
            low, high = 2 + sections * ring, 2 + sections * (ring + 1)
            cells += [np.c_[low + k, high + k, high + after],
                      np.c_[low + k, high + after, low + after]]
        last = 2 + sections * (rings - 1)
        cells.append(np.c_[0 * k + 1, last + after, last + k])
        return points, np.concatenate(cells).astype(np.int32)

    found = distances(cone(60, 20), cone(200, 1), 1e-4)
    assert found.forward_upper <= found.forward_lower + 1e-4
    assert found.backward_upper <= found.backward_lower + 1e-4
    assert found.backward_lower == pytest.approx(1.0 - np.cos(np.pi / 60), rel=0.2)


def test_distance_of_two_parallel_squares_and_of_a_surface_to_itself():
    points, cells = sm.sheet(3)
    raised, other = sm.sheet(7)
    raised[:, 2] += 0.25
    found = distances((points, cells), (raised, other), 1e-6)
    np.testing.assert_allclose(found, 0.25, atol=1e-12)
    np.testing.assert_allclose(distances((points, cells), (points, cells), 1e-6), 0.0, atol=1e-6)
    shifted = raised + np.array([0.5, 0, 0])
    np.testing.assert_allclose(
        distances((points, cells), (shifted, other), 1e-6), np.hypot(0.5, 0.25), atol=1e-6
    )


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_scale_and_place_do_not_matter(scale):
    points, cells = sm.sphere(2, 0.1)
    other, triangles = sm.sphere(2, 0.1, seed=8)
    expected = distances((points, cells), (other, triangles), 1e-4)
    shift = 10 * scale * np.array([1.0, -2.0, 3.0])
    found = distances(
        (scale * points + shift, cells), (scale * other + shift, triangles), 1e-4 * scale
    )
    np.testing.assert_allclose(np.array(found) / scale, expected, atol=1e-10)
    envelope = 0.6 * expected.forward_upper
    reference = make_reference(points, cells)
    there = make_reference(scale * points + shift, cells)
    np.testing.assert_array_equal(
        within(there, scale * other + shift, triangles, scale * envelope),
        within(reference, other, triangles, envelope),
    )


def test_flat_triangles_of_the_reference():
    points, cells = sm.sheet(3)
    points = np.concatenate([points, points[:1]])
    flat = np.array([[0, 0, 1], [0, 16, 5], [4, 8, 12], [3, 3, 3]], dtype=np.int32)
    reference = make_reference(points, np.concatenate([cells, flat]))
    other, triangles = sm.sheet(5)
    other[:, 2] += 0.01
    assert within(reference, other, triangles, 0.012).all()
    assert not within(reference, other, triangles, 0.0099).any()
    found = distances((other, triangles), (points, np.concatenate([cells, flat])), 1e-6)
    np.testing.assert_allclose(found, 0.01, atol=1e-6)


def test_closest_point_of_three_points_on_a_line():
    rng = np.random.default_rng(12)
    for _ in range(100):
        a, way = rng.random((2, 3))
        w = np.array([0.0, 1.0, rng.choice([-1.0, 0.0, 0.5, 1.0, 2.0, rng.uniform(-1, 2)])])
        points = a + rng.permutation([0.0, 1.0, w[2]])[:, None] * way
        x = a + rng.uniform(-2, 3, (20, 1)) * way + rng.normal(size=(20, 3)) * rng.choice([1e-3, 1])
        nearest = np.clip((x - a) @ way / (way @ way), w.min(), w.max())
        expected = np.linalg.norm(x - a - nearest[:, None] * way, axis=1)
        distance, _, foot = make_reference(points, ONE).closest(x)
        np.testing.assert_allclose(distance, expected, atol=1e-14)
        np.testing.assert_allclose(np.linalg.norm(foot - x, axis=1), expected, atol=1e-14)
        square = [closest_on_triangle.py_func(*y, points, 0, 1, 2)[0] for y in x]
        np.testing.assert_allclose(np.sqrt(square), expected, atol=1e-14)


def test_points_of_no_triangle_do_not_count_wherever_they_are():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1e300, 0, 0]])
    reference = make_reference(points, ONE)
    assert within(reference, points, ONE, 0.0).all()
    assert not uncovered(reference, points, ONE, 1e-9).triangles.size
    assert distances((points, ONE), (points, ONE), 1e-9).forward_upper <= 1e-9


def test_one_triangle_and_none():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    cells = ONE
    reference = make_reference(points, cells)
    assert within(reference, points, cells, 0.0).all()
    assert not uncovered(reference, points, cells, 1e-9).triangles.size
    half = points * 0.5
    assert within(reference, half, cells, 1e-9).all()
    left = uncovered(reference, half, cells, 1e-3)
    assert left.triangles.tolist() == [0]
    assert left.near.indices.tolist() == [0]
    found = distances((points, cells), (half, cells), 1e-6)
    np.testing.assert_allclose(found, [0.5, 0.5, 0, 0], atol=1e-6)
    assert within(reference, points, cells[:0], 0.1).shape == (0,)
    assert [len(part) for part in reference.closest(points[:0])] == [0, 0, 0]
    with pytest.raises(InvalidMeshError, match="without triangles"):
        make_reference(points, cells[:0])


@settings(max_examples=100, deadline=None)
@given(st.lists(st.permutations(range(5)), min_size=1, max_size=8))
def test_neighbors_are_the_only_ones_and_run_the_other_way(rows):
    cells = np.array([row[:3] for row in rows], dtype=np.int32)
    neighbors = make_surface(np.zeros((5, 3)), cells).neighbors
    for c, triangle in enumerate(cells.tolist()):
        for i in range(3):
            j, k = triangle[(i + 1) % 3], triangle[(i + 2) % 3]
            there = [o for o, other in enumerate(cells.tolist()) if o != c and {j, k} <= set(other)]
            ways = [cells[o].tolist() for o in there]
            turned = [w[(w.index(k) + 1) % 3] == j for w in ways]
            expected = there[0] if len(there) == 1 and turned[0] else -1
            assert neighbors[c, i] == expected


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32), st.booleans(), st.sampled_from([0.01, 0.03, 0.2]))
def test_never_within_beyond_a_rim(seed, closed, envelope):
    rng = np.random.default_rng(seed)
    reference = make_reference(*(sm.plate(*sm.ring(), 0.01) if closed else sm.ring()))
    corners = rng.uniform(0.0, 1.0 + 2 * envelope, (60, 3, 3))
    corners[:, :, 2] = rng.uniform(-0.5, 1.0, (60, 1)) * envelope
    corners[rng.random((60, 3)) < 0.3, :2] = 1.0
    points, cells = corners.reshape(-1, 3), np.arange(180, dtype=np.int32).reshape(-1, 3)
    there = sm.samples(points, cells, 16)
    far = reference.closest(there)[0].reshape(60, -1).max(axis=1)
    sure = within(reference, points, cells, envelope)
    assert not (sure & (far > envelope * (1 + 1e-12))).any()
    work = make_overlay_work()
    feet = reference.closest(corners.mean(axis=1))[1]
    for t in range(60):
        for shrink in (0.0, 0.5 * envelope):
            bound = height_over(
                points, *cells[t].tolist(), feet[t], reference.surface, shrink, 1.0, work
            )
            assert bound >= far[t] - 1e-12


def test_closed_plate_is_closed():
    points, cells = sm.plate(*sm.sheet(3), 0.1)
    surface = make_surface(points, cells)
    assert (surface.neighbors >= 0).all()
    a, b, c = (points[cells[:, i]] for i in range(3))
    assert (np.cross(a, b) * c).sum() / 6 == pytest.approx(0.1)


def test_long_and_short_edges_on_one_line_are_no_distance_apart():
    """Halves of lines double their number, quarters would do so twice and use up the parts."""
    def line(x):
        rows = np.arange(len(x) - 1, dtype=np.int32)
        return np.stack([x, 0 * x, 0 * x], axis=1), np.stack([rows, rows + 1, rows + 1], axis=1)

    fine = np.concatenate([[0.0], np.sort(np.random.default_rng(4).random(400)), [1.0]])
    both = distances(line(np.array([0.0, 0.7, 1.0])), line(fine), 2e-6)
    assert max(both.forward_upper, both.backward_upper) < 2.1e-6
