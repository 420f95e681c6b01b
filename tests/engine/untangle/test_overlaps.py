"""Facets that must stay and cross or overlap others, against all pairs in rational numbers."""

from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest

from odt_plugins.engine.ground.crossings import crossed_facets
from odt_plugins.engine.untangle.overlaps import overlaps
from odt_plugins.mesh.simplex import simplex_mesh


def sign(*corners):
    """Sign of the determinant of the edges at the first corner, exactly."""
    base, *others = ([Fraction(x) for x in corner] for corner in np.asarray(corners).tolist())
    rows = [[x - y for x, y in zip(other, base, strict=True)] for other in others]
    if len(rows) == 2:
        det = rows[0][0] * rows[1][1] - rows[0][1] * rows[1][0]
    else:
        det = sum(rows[0][i] * (rows[1][(i + 1) % 3] * rows[2][(i + 2) % 3]
                                - rows[1][(i + 2) % 3] * rows[2][(i + 1) % 3]) for i in range(3))
    return (det > 0) - (det < 0)


def through(points, one, other):
    """Whether an edge of a facet goes through the inside of another."""
    corners = points[other]
    for u, v in combinations(points[one], 2):
        if sign(*corners, u) * sign(*corners, v) < 0:
            if len(other) == 2:
                inside = {sign(u, v, corner) for corner in corners} == {-1, 1}
            else:
                turns = {sign(u, v, corners[i], corners[(i + 1) % 3]) for i in range(3)}
                inside = turns in ({1}, {-1})
            if inside:
                return True
    return False


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("seed", [1, 2])
def test_facets_cross_those_that_they_cross_in_rational_numbers(dim, seed):
    rng = np.random.default_rng(seed)
    points = rng.random((25, dim))
    facets = np.array([rng.choice(25, dim, replace=False) for _ in range(25)], dtype=np.int32)
    pairs = {(i, j) for i, j in combinations(range(len(facets)), 2)
             if through(points, facets[i], facets[j]) or through(points, facets[j], facets[i])}
    other = crossed_facets(points, facets)
    assert {i for i in range(len(facets)) if other[i] >= 0} == {i for pair in pairs for i in pair}
    assert all(tuple(sorted((i, int(j)))) in pairs for i, j in enumerate(other) if j >= 0)
    shared = [len(set(facets[i].tolist()) & set(facets[j].tolist())) for i, j in pairs]
    assert 0 in shared
    assert (1 in shared) == (dim == 3)


def test_the_sides_of_a_crack_overlap_where_cells_are_impossible_alone():
    """Two triangles along a crack from (0, 0) on, with the corner of each at its other end."""
    points = np.array([[0.0, 0], [1, 0], [1, 0], [1, 1], [-1, 0], [1, -1]])
    cells = np.array([[0, 1, 3], [0, 3, 4], [0, 4, 5], [0, 5, 2]])
    mesh, _ = simplex_mesh(points, cells)
    assert not len(overlaps(mesh, np.zeros(6, dtype=bool)).facets)
    found = overlaps(mesh, np.ones(6, dtype=bool))
    assert found.facets.tolist() == [[0, 1], [0, 2]]
    assert found.others.tolist() == [[0, 2], [0, 1]]
    assert found.places.tolist() == [[0.0, 0.0]] * 2
