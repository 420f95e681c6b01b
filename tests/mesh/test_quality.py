"""Quality figures against closed forms, invariances and slow twins."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odt_plugins import figures as q
from odt_plugins.errors import InvalidMeshError, InvalidOptionError
from odt_plugins.mesh import chunks

TRIANGLE = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, math.sqrt(0.75)]])
TETRAHEDRON = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])[[1, 0, 2, 3]]
REGULAR = {2: TRIANGLE, 3: TETRAHEDRON}
CORNER = {2: np.eye(3, 2, k=-1), 3: np.eye(4, 3, k=-1)}


def simplex(d: int) -> np.ndarray:
    return np.arange(d + 1)[None]


def random_simplices(d: int, m: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(m * (d + 1), d)), np.arange(m * (d + 1)).reshape(m, d + 1)


def slow_radius_ratio(x: np.ndarray) -> float:
    """d r / R by the linear system of the circumcentre and facet areas by Gram determinants."""
    d = x.shape[1]
    edges = x[1:] - x[0]
    centre = np.linalg.solve(2 * edges, (edges**2).sum(axis=1))
    volume = abs(np.linalg.det(edges)) / math.factorial(d)
    area = 0.0
    for i in range(d + 1):
        f = np.delete(x, i, axis=0)
        g = f[1:] - f[0]
        area += math.sqrt(np.linalg.det(g @ g.T)) / math.factorial(d - 1)
    return d * (d * volume / area) / float(np.linalg.norm(centre))


def slow_dihedral(x: np.ndarray, i: int, j: int) -> float:
    """Angle between the other two vertices seen along edge ij."""
    k, m = (v for v in range(4) if v not in (i, j))
    axis = (x[j] - x[i]) / np.linalg.norm(x[j] - x[i])
    a, b = (v - (v @ axis) * axis for v in (x[k] - x[i], x[m] - x[i]))
    return math.degrees(math.acos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))


@pytest.mark.parametrize("d", [2, 3])
def test_regular_simplex_has_ratio_one(d: int) -> None:
    assert q.radius_ratio(REGULAR[d], simplex(d))[0] == pytest.approx(1.0, abs=1e-15)


def test_hand_cases_of_radius_ratio() -> None:
    a, b, c = 1.0, 1.0, math.sqrt(2)
    paper = (b + c - a) * (c + a - b) * (a + b - c) / (a * b * c)
    assert q.radius_ratio(CORNER[2], simplex(2))[0] == pytest.approx(paper, rel=1e-14)
    three_r = 3 / (3 + math.sqrt(3))
    assert q.radius_ratio(CORNER[3], simplex(3))[0] == pytest.approx(
        three_r / (math.sqrt(3) / 2), rel=1e-14)


@pytest.mark.parametrize("d", [2, 3])
def test_radius_ratio_equals_slow_twin(d: int) -> None:
    points, cells = random_simplices(d, 200, 719)
    slow = [slow_radius_ratio(points[t]) for t in cells]
    assert np.abs(q.radius_ratio(points, cells)) == pytest.approx(slow, rel=1e-9)


@pytest.mark.parametrize("d", [2, 3])
def test_radius_ratio_changes_sign_with_orientation_and_is_zero_when_flat(d: int) -> None:
    points, cells = random_simplices(d, 50, 733)
    turned = cells[:, [1, 0, *range(2, d + 1)]]
    ratio = q.radius_ratio(points, cells)
    assert q.radius_ratio(points, turned) == pytest.approx(-ratio, rel=1e-12)
    assert (np.sign(ratio) == np.sign(q.volumes(points, cells))).all()
    flat = points.copy()
    flat[:, -1] = 0.0
    assert (q.radius_ratio(flat, cells) == 0).all()
    assert (q.radius_ratio(np.zeros((d + 1, d)), simplex(d)) == 0).all()


@pytest.mark.parametrize("height", [1e-3, 1e-8, 1e-14])
def test_radius_ratio_of_slivers(height: float) -> None:
    """Four points of a circle, two of them lifted: R and the four equal faces are known."""
    x = np.array([[1, 0, 0], [0, 1, height], [-1, 0, 0], [0, -1, height]], dtype=float)
    volume = 2 * height / 3
    face = math.sqrt(1 + height**2)
    inradius = 3 * volume / (4 * face)
    radius = math.hypot(1.0, height / 2)
    assert abs(q.radius_ratio(x, simplex(3))[0]) == pytest.approx(3 * inradius / radius, rel=1e-6)


@pytest.mark.parametrize("d", [2, 3])
@given(scale=st.floats(-80, 80), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_figures_do_not_depend_on_unit_place_and_order(d: int, scale: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, cells = random_simplices(d, 20, seed)
    turn = np.linalg.qr(rng.normal(size=(d, d)))[0]
    turn[0] *= np.sign(np.linalg.det(turn))
    moved = 10.0**scale * (points @ turn.T + rng.normal(size=d))
    good = np.abs(q.radius_ratio(points, cells)) > 1e-3
    a, b = q.cell_figures(points, cells), q.cell_figures(moved, cells)
    assert b.quality[good] == pytest.approx(a.quality[good], rel=1e-8)
    assert b.min_angle[good] == pytest.approx(a.min_angle[good], abs=1e-8)
    assert b.max_angle[good] == pytest.approx(a.max_angle[good], abs=1e-8)
    even = cells[:, [1, 2, 0, *range(3, d + 1)]]
    assert q.radius_ratio(points, even)[good] == pytest.approx(a.quality[good], rel=1e-8)


def test_angles_of_triangles() -> None:
    assert q.angles(TRIANGLE, simplex(2))[0] == pytest.approx([60, 60, 60], abs=1e-12)
    assert q.angles(CORNER[2], simplex(2))[0] == pytest.approx([90, 45, 45], abs=1e-12)
    points, cells = random_simplices(2, 100, 751)
    assert q.angles(points, cells).sum(axis=1) == pytest.approx(180.0, abs=1e-9)


def test_angles_of_tetrahedra_are_dihedral_and_in_the_stated_order() -> None:
    regular = math.degrees(math.acos(1 / 3))
    assert q.angles(TETRAHEDRON, simplex(3))[0] == pytest.approx([regular] * 6, abs=1e-12)
    points, cells = random_simplices(3, 100, 757)
    slow = [[slow_dihedral(points[t], i, j) for i, j in q.EDGES[4]] for t in cells]
    assert q.angles(points, cells) == pytest.approx(np.array(slow), abs=1e-5)


@pytest.mark.parametrize("degrees", [1e-9, 1e-4, 179.9999, 180 - 1e-9])
def test_angles_are_exact_near_0_and_180(degrees: float) -> None:
    t = math.radians(degrees)
    wedge = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0.5], [math.cos(t), math.sin(t), 0.5]])
    small = degrees if degrees < 90 else 180 - degrees
    got = q.angles(wedge, simplex(3))[0][0]
    got = got if degrees < 90 else 180 - got
    assert got == pytest.approx(small, rel=1e-4)


@pytest.mark.parametrize("d", [2, 3])
def test_triangles_in_space_are_measured_in_their_plane(d: int) -> None:
    points, cells = random_simplices(2, 30, 761)
    lift = np.linalg.qr(np.random.default_rng(769).normal(size=(3, 3)))[0][:, :2]
    space = points @ lift.T + d
    assert q.radius_ratio(space, cells) == pytest.approx(np.abs(q.radius_ratio(points, cells)))
    assert q.angles(space, cells) == pytest.approx(q.angles(points, cells))


@pytest.mark.parametrize("d", [2, 3])
def test_uniformity_is_zero_for_equal_cells_and_for_the_right_size(d: int) -> None:
    copies = np.concatenate([REGULAR[d] + 3 * i for i in range(4)])
    cells = np.arange(len(copies)).reshape(4, d + 1)
    assert q.uniformity(copies, cells) == pytest.approx(0.0, abs=1e-14)
    scaled = np.concatenate([(i + 1) * REGULAR[d] for i in range(4)])
    assert q.uniformity(scaled, cells) > 0.4
    assert q.uniformity(scaled, cells, [1.0, 2, 3, 4]) == pytest.approx(0.0, abs=1e-14)
    per_vertex = np.repeat([1.0, 2, 3, 4], d + 1)
    assert q.uniformity(scaled, cells, per_vertex) == pytest.approx(0.0, abs=1e-14)


@pytest.mark.parametrize("d", [2, 3])
def test_uniformity_by_its_formula_and_at_circumcentres(d: int) -> None:
    points, cells = random_simplices(d, 12, 773)
    radius, centre = [], []
    for t in cells:
        edges = points[t[1:]] - points[t[0]]
        offset = np.linalg.solve(2 * edges, (edges**2).sum(axis=1))
        radius.append(np.linalg.norm(offset))
        centre.append(points[t[0]] + offset)

    def size(x: np.ndarray) -> np.ndarray:
        return 2.0 + np.tanh(x[:, 0])

    for h, values in ((None, np.ones(12)), (7.0, np.ones(12)), (size, size(np.array(centre)))):
        ratio = np.array(radius) / values
        expected = ratio.std(ddof=1) / ratio.mean()
        assert q.uniformity(points, cells, h) == pytest.approx(expected, rel=1e-8)


def test_uniformity_refuses_sizes_that_fit_nothing() -> None:
    with pytest.raises(InvalidOptionError, match=r"shape \(5,\); expected one value, \(1,\)"):
        q.uniformity(TRIANGLE, simplex(2), np.ones(5))
    with pytest.raises(InvalidOptionError, match=r"h is 0.0 at index 1 \(2 of them\)"):
        q.uniformity(TRIANGLE, simplex(2), np.array([1.0, 0.0, -1.0]))


@pytest.mark.parametrize("corners", [
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 0, 0], [0, 0, 0], [1, 0, 0], [0, 1, 0]],
    [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]],
    [[0, 0], [1, 0], [0, 1]], [[0, 0], [1, 0], [3, 0]], [[0, 0], [0, 0], [1, 0]],
])
def test_least_and_largest_angle_are_those_of_all_flat_cells_too(corners) -> None:
    points = np.array(corners, dtype=float)
    cells = np.array(list(permutations(range(len(corners)))))
    found = q.cell_figures(points, cells)
    angles = q.angles(points, cells)
    assert found.min_angle == pytest.approx(angles.min(axis=1), abs=1e-9)
    assert found.max_angle == pytest.approx(angles.max(axis=1), abs=1e-9)


@pytest.mark.parametrize("d", [2, 3])
def test_summary_counts_and_takes_quantiles(d: int) -> None:
    points, cells = random_simplices(d, 500, 787)
    s = q.summarize(points, cells)
    ratio = q.radius_ratio(points, cells)
    least = q.angles(points, cells).min(axis=1)
    assert (s.dim, s.n_points, s.n_cells) == (d, len(points), 500)
    assert (s.min_quality, s.mean_quality) == (ratio.min(), ratio.mean())
    assert s.p1_quality == np.quantile(ratio, 0.01)
    extremes = least.min(), q.angles(points, cells).max()
    assert (s.min_angle, s.max_angle) == pytest.approx(extremes, rel=1e-12)
    assert [s.below_5, s.below_10, s.below_20] == [(least < a).sum() for a in (5, 10, 20)]
    assert s.inverted == (ratio < 0).sum() > 0
    assert s.volume == pytest.approx(q.volumes(points, cells).sum())
    assert s.uniformity == pytest.approx(q.uniformity(points, cells))


def test_chunks_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    points, cells = random_simplices(3, 100, 797)
    whole = q.cell_figures(points, cells)
    monkeypatch.setattr(chunks, "CHUNK", 7)
    for threads in (1, 3):
        for a, b in zip(whole, q.cell_figures(points, cells, threads), strict=True):
            assert np.array_equal(a, b)


def test_a_flat_cell_has_figures_and_plain_numbers() -> None:
    s = q.summarize(np.array([[0.0, 0], [1, 0], [2, 0]]), simplex(2))
    assert (s.min_quality, s.min_angle, s.max_angle, s.inverted) == (0.0, 0.0, 180.0, 1)
    assert s.to_dict()["uniformity"] is None


@pytest.mark.parametrize(("points", "cells", "message"), [
    (np.zeros((3, 4)), simplex(2), r"points of shape \(3, 4\)"),
    (TRIANGLE, simplex(3), r"cells of shape \(1, 4\)"),
    (TRIANGLE, [[0.0, 1.0, 2.0]], "dtype float64"),
    (TRIANGLE, [[0, 1, 2], [0, 1, 3]], r"\[0, 1, 3\] in cell 1 \(1 such cells\)"),
    (TRIANGLE, np.zeros((0, 3), int), "mesh of 0 cells"),
])
def test_what_is_no_mesh_is_refused(points: object, cells: object, message: str) -> None:
    with pytest.raises(InvalidMeshError, match=message):
        q.summarize(points, cells)
