"""Faces with labels: found in any order, ended, turned, and followed through flips."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from odt_plugins.mesh.faces import (
    Faces,
    Pieces,
    ends_of,
    followed,
    labels_at,
    no_faces,
    renumbered,
    turns_of,
)

rows = st.lists(st.sets(st.integers(0, 8), min_size=3, max_size=3).map(sorted), max_size=12)


def faces(given, labels=None):
    out = np.array(given, dtype=np.int32).reshape(-1, 3)
    return Faces(out, np.arange(len(out), dtype=np.int32) if labels is None else labels)


@given(known=rows, asked=rows, seed=st.integers(0, 9))
def test_labels_by_a_slow_twin(known, asked, seed):
    known = [list(row) for row in {tuple(row) for row in known}]
    table = {frozenset(row): i for i, row in enumerate(known)}
    random = np.random.default_rng(seed)
    mixed = [random.permutation(row).tolist() for row in asked]
    found = labels_at(faces(mixed).rows, faces(known))
    assert found.tolist() == [table.get(frozenset(row), -1) for row in asked]


def test_lines_end_branch_and_change():
    #  0 - 1 - 2 - 3 with another label from 2 on; a ring 4 5 6; a branch at 8
    lines = np.array([[0, 1], [1, 2], [2, 3], [4, 5], [5, 6], [6, 4], [7, 8], [8, 9], [8, 10]])
    labels = np.array([0, 0, 1, 0, 0, 0, 2, 2, 2])
    ends = ends_of(Faces(lines.astype(np.int32), labels.astype(np.int32)), 12)
    assert np.flatnonzero(ends).tolist() == [0, 2, 3, 7, 8, 9, 10]
    assert not ends_of(no_faces()[0], 3).any()


def test_faces_of_vertices_that_went_are_none():
    number = np.array([2, -1, 0, 1])
    out = renumbered(faces([[0, 2, 3], [0, 1, 2]]), number)
    assert out.rows.tolist() == [[2, 0, 1]]
    assert out.labels.tolist() == [0]


def test_rows_are_found_and_told_which_way_round_they_are():
    facets = np.array([[4, 2, 9], [1, 2, 3]], dtype=np.int32)
    rows = np.array([[2, 9, 4], [9, 2, 4], [1, 2, 4], [1, 3, 2]])
    found, turned = turns_of(rows, facets)
    assert found.tolist() == [True, True, False, True]
    assert turned.tolist() == [False, True, False, True]
    # Of two facets with the same vertices, which look to both sides, the first one counts.
    assert turns_of(rows[:1], np.concatenate([facets, facets[:1, ::-1]]))[1].tolist() == [False]
    assert turns_of(rows[:1], np.concatenate([facets[:1, ::-1], facets]))[1].tolist() == [True]


def square(n):
    """Two triangles in every square of a grid, its diagonal either way."""
    x, y = (v.ravel() for v in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    a = x * (n + 1) + y
    b, c, d = a + n + 1, a + n + 2, a + 1
    one = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    other = np.concatenate([np.stack([a, b, d], 1), np.stack([b, c, d], 1)])
    left = np.concatenate([x, x]) < n // 2
    return one.astype(np.int32), other.astype(np.int32), left.astype(np.int32)


def test_labels_follow_flips_between_borders():
    n = 4
    one, other, left = square(n)
    same = np.zeros(len(one), dtype=np.int32)
    out = followed(Pieces(one, same), left, Pieces(other, same), (n + 1) ** 2)
    np.testing.assert_array_equal(out, left)
    # A surface without borders has one label, found by its vertices.
    out = followed(Pieces(one, same), same + 3, Pieces(other, same), (n + 1) ** 2)
    assert set(out.tolist()) == {3}
    # Pieces have labels of their own, though they share vertices and edges.
    both, flipped = np.concatenate([one, one]), np.concatenate([one, other])
    piece = np.repeat(np.arange(2, dtype=np.int32), len(one))
    labels = np.concatenate([left + 5, left])
    out = followed(Pieces(both, piece), labels, Pieces(flipped, piece), (n + 1) ** 2)
    np.testing.assert_array_equal(out, labels)


def test_labels_that_contradict_each_other_are_not_followed():
    one, other, _ = square(4)
    # Labels that change within squares: their diagonals, which are borders, are flipped.
    labels = np.repeat(np.arange(2, dtype=np.int32), len(one) // 2)
    same = np.zeros(len(one), dtype=np.int32)
    assert followed(Pieces(one, same), labels, Pieces(other, same), 25) is None
