"""Where triangles cross: by whole numbers, wherever rounding would decide."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from crossings import crossing_pairs, cut
from hypothesis import given
from hypothesis import strategies as st

from odt_plugins.engine.ground.crossings import count_crossings, crossed_facets, crossing_triangles
from odt_plugins.mesh.exact import exact_sign, whole_numbers

FLAT = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]])
CELLS = np.array([[0, 1, 2], [3, 4, 5]], dtype=np.int32)


def edge_counts(points, cells):
    """Edges through triangles that share no vertex, in rational numbers."""
    count = 0
    for i in range(len(cells)):
        for j in range(len(cells)):
            if i != j and not np.isin(cells[i], cells[j]).any():
                for e in range(3):
                    u, v = cells[i, e], cells[i, e - 1]
                    count += cut(points, [u, v, v], cells[j])
    return count


@pytest.mark.parametrize("offset", [1e-9, 1e-17, 1e-30, 1e-120])
@pytest.mark.parametrize("sides", [(-1, 1, 1), (1, 1, 1), (0, 1, 1), (0, 0, 1), (0, 0, 0)])
def test_the_least_offset_decides(offset, sides):
    other = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]])
    other[:, 2] = offset * np.array(sides)
    points = np.concatenate([FLAT, other])
    crosses = sides[0] < 0
    for order in ([0, 1, 2], [1, 2, 0], [2, 1, 0]):
        cells = CELLS[:, order]
        assert crossing_triangles(points, cells).all() == crosses
        assert crossing_triangles(points, cells).any() == crosses
        assert count_crossings(points, cells) == 2 * crosses
        assert crossing_triangles(points[:, [2, 0, 1]], cells).any() == crosses


def test_a_vertex_one_unit_of_rounding_beyond_a_tilted_plane_crosses():
    points = np.array([[0.0, 0, 0], [3, 1, 1], [1, 3, 2], [1, 1, 0.75], [2, 1, 9], [1, 2, 9]])
    for shift, crosses in ((0, False), (1, False), (-1, True)):
        moved = points.copy()
        for _ in range(abs(shift)):
            moved[3, 2] = np.nextafter(moved[3, 2], shift * np.inf)
        assert exact_sign(*whole_numbers(moved[:4])) == shift
        assert crossing_triangles(moved, CELLS).any() == crosses


@pytest.mark.parametrize("offset", [0.0, 1e-17, -1e-17])
def test_edges_in_the_plane_cross_by_the_least_offset(offset):
    points = np.array([[-1.0, 0], [1, 0], [0, 1], [0, -offset]])
    edges = np.array([[0, 1], [2, 3]], dtype=np.int32)
    assert (crossed_facets(points, edges) >= 0).all() == (offset > 0)
    assert (crossed_facets(points, edges) >= 0).any() == (offset > 0)


@given(st.integers(0, 10**6), st.integers(1, 3), st.sampled_from([0.0, 1e-17, 1e-13]),
       st.booleans())
def test_counts_are_those_of_rational_numbers_where_much_is_flat(seed, side, noise, tilted):
    rng = np.random.default_rng(seed)
    points = rng.integers(-side, side + 1, (9, 3)).astype(float)
    if rng.random() < 0.5:
        points[:, 2] = 0.0
    if tilted:
        points = points @ rng.standard_normal((3, 3))
    points += noise * rng.standard_normal(points.shape)
    cells = np.array([sorted(rng.choice(9, 3, replace=False)) for _ in range(8)], dtype=np.int32)
    cells = np.unique(cells, axis=0)
    pairs = crossing_pairs(points, cells)
    expected = [[i, j] for i in range(len(cells)) for j in range(i + 1, len(cells))
                if cut(points, cells[i], cells[j]) or cut(points, cells[j], cells[i])]
    assert pairs.tolist() == expected
    marked = np.isin(np.arange(len(cells)), pairs)
    assert np.array_equal(crossing_triangles(points, cells), marked)
    other = crossed_facets(points, cells)
    assert all(sorted([i, j]) in expected for i, j in enumerate(other.tolist()) if j >= 0)
    assert count_crossings(points, cells) == edge_counts(points, cells)


@pytest.mark.parametrize("tilted", [False, True])
def test_sheets_that_touch_or_lie_in_each_other_do_not_cross(tilted):
    n = 12
    i, j = np.divmod(np.arange((n + 1) ** 2), n + 1)
    points = np.stack([i, j, np.zeros(len(i))], axis=1) / n
    if tilted:
        points = points @ np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    low = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    cells = np.concatenate([np.stack([low, low + n + 1, low + 1], axis=1),
                            np.stack([low + 1, low + n + 1, low + n + 2], axis=1)])
    twice = np.concatenate([points, points]), np.concatenate([cells, cells + len(points)])
    for x, t in ((points, cells), twice):
        t = t.astype(np.int32)
        assert not crossing_triangles(x, t).any()
        assert count_crossings(x, t) == 0


def faces_with_an_edge_in_common(rng, tilt):
    """Needles of two faces at right angles: corners along their common edge are of both or of one.

    The cut along the edge is another on either side, as between bodies that touch.
    """
    points, cells = [], []
    for side in (1, 2):
        places = np.sort(np.append(rng.random(30), [0.0, 1.0]))
        for a, b in pairwise(places):
            tip = np.zeros(3)
            tip[[0, side]] = rng.random(2)
            cells.append(len(points) + np.arange(3))
            points += [[a, 0, 0], [b, 0, 0], tip]
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    points = np.array(points)
    return points @ turn if tilt else points, np.array(cells, dtype=np.int32)


@pytest.mark.parametrize("tilt", [False, True])
def test_an_edge_in_the_plane_of_a_triangle_beside_it_needs_no_whole_numbers(tilt, monkeypatch):
    points, cells = faces_with_an_edge_in_common(np.random.default_rng(3), tilt)
    asked = []
    monkeypatch.setattr("odt_plugins.engine.ground.crossings.whole_numbers",
                        lambda corners: asked.append(corners) or whole_numbers(corners))
    first = cells[:, 0] < 90
    across = [(i, j) for i in np.flatnonzero(first) for j in np.flatnonzero(~first)]
    for i, j in across:
        assert count_crossings(points, cells[[i, j]]) == edge_counts(points, cells[[i, j]])
    assert len(asked) < 0.1 * len(across)
