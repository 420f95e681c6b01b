"""Soups: which meshes are some, and which of its vertices a new cell gets."""

from __future__ import annotations

import contract
import numpy as np
import pytest
import surface_meshes as sm

from odt_plugins.mesh.soup import at_copies, same_places


def apart(points, cells):
    """The same cells, each with vertices of its own."""
    return points[cells].reshape(-1, points.shape[1]), np.arange(cells.size).reshape(cells.shape)


def first_at_place(points):
    """Index of the first vertex with the coordinates of every vertex, by a dictionary."""
    known = {}
    return [known.setdefault(tuple(point), i) for i, point in enumerate(points.tolist())]


def test_cells_that_share_no_vertices_are_a_soup(d):
    points, cells, _ = contract.grid(d, 3)
    assert same_places(points, cells) is None
    torn = apart(points, cells)
    assert same_places(*torn).tolist() == first_at_place(torn[0])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_zero_has_no_sign_and_other_bits_count(dtype):
    points, cells = apart(*sm.cube(4))
    points = points.astype(dtype)
    points[::2][points[::2] == 0.0] = -0.0
    assert same_places(points, cells).tolist() == first_at_place(points)
    other = points.copy()
    other[5] = np.nextafter(other[5], dtype(2.0))
    assert same_places(other, cells)[5] == 5


def test_pairs_that_share_an_edge_are_still_a_soup():
    points, cells = sm.cube(4)
    corners = cells.reshape(-1, 6)
    pieces, rows = [], []
    for pair in corners:
        used, number = np.unique(pair, return_inverse=True)
        rows.append(number.reshape(2, 3) + sum(map(len, pieces)))
        pieces.append(points[used])
    torn = np.vstack(pieces), np.vstack(rows)
    assert len(torn[0]) == 4 * len(cells) // 2
    assert same_places(*torn).tolist() == first_at_place(torn[0])


def test_cracks_and_seams_are_no_soup():
    points, cells = sm.sheet(8, lambda x, y: x * y)
    slit = np.flatnonzero((points[:, 0] == 0.5) & (points[:, 1] > 0.2))
    right = points[cells].mean(axis=1)[:, 0] > 0.5
    copies = np.arange(len(points))
    copies[slit] = len(points) + np.arange(len(slit))
    torn = np.where(right[:, None], copies[cells], cells)
    assert same_places(np.vstack([points, points[slit]]), torn) is None
    charts = [sm.sheet(3, lambda x, y: x * y) for _ in range(4)]
    patches = np.vstack([p + np.array([i, 0, 0]) for i, (p, _) in enumerate(charts)])
    rows = np.vstack([t + i * len(charts[0][0]) for i, (_, t) in enumerate(charts)])
    assert same_places(patches, rows) is None


def test_cells_that_do_not_meet_are_no_soup():
    points, cells = apart(*sm.sphere(1))
    far = points + np.repeat(np.arange(len(cells)), 3)[:, None]
    assert same_places(far, cells) is None


def test_new_cells_take_the_vertices_of_their_source_and_then_those_that_are_free():
    # two triangles 0 1 2 and 3 4 5 with 1 = 4 and 2 = 3, whose edge is flipped
    old = np.array([[0, 1, 2], [3, 4, 5]])
    same = np.array([0, 1, 2, 2, 1, 5])
    new = np.array([[0, 1, 5], [5, 2, 0]])
    assert at_copies(new, np.array([0, 1]), old, same).tolist() == [[0, 1, 5], [5, 3, 0]]
    more = np.array([[0, 1, 2], [3, 4, 5], [6, 7, 8], [9, 10, 11]])
    same = np.array([0, 1, 2, 2, 1, 5, 5, 7, 8, 0, 10, 11])
    assert at_copies(new, np.array([0, 1]), more, same).tolist() == [[0, 1, 6], [5, 3, 9]]


def test_new_cells_take_vertices_of_the_label_of_their_source():
    old = np.array([[0, 1, 2], [3, 4, 5], [6, 7, 8], [9, 10, 11]])
    same = np.array([0, 1, 2, 2, 1, 5, 5, 7, 8, 5, 10, 11])
    for labels, vertex in (([0, 1, 0, 0], 6), ([0, 1, 2, 0], 9), ([1, 0, 0, 1], 9)):
        out = at_copies(np.array([[0, 1, 5]]), np.array([0]), old, same, np.array(labels))
        assert out.tolist() == [[0, 1, vertex]]
    nowhere = at_copies(np.array([[0, 1, 5]]), np.array([0]), old, same, np.array([0, 1, 1, 1]))
    assert nowhere.tolist() == [[0, 1, 5]]
