"""Quality figures: the radius ratio, and how alike cells are."""

from __future__ import annotations

import numpy as np
import pytest
import reference as ref
from hypothesis import given
from strategies import SCALES, SEEDS, lattice, meshes, rotation

from odt_plugins.figures import radius_ratio, uniformity


def regular(d):
    if d == 2:
        return np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 3**0.5 / 2]])
    return np.array([[1.0, 1, 1], [-1, -1, 1], [-1, 1, -1], [1, -1, -1]])


def one(d):
    return np.arange(d + 1)[None]


def inradius(x):
    d = x.shape[1]
    total = 0.0
    for k in range(d + 1):
        facet = np.delete(x, k, axis=0)
        edges = facet[1:] - facet[0]
        total += np.sqrt(np.linalg.det(edges @ edges.T)) / (1 if d == 2 else 2)
    return d * abs(ref.volume(x)) / total


def test_regular_simplex_is_one(d):
    assert radius_ratio(regular(d), one(d)) == pytest.approx([1.0], rel=1e-14)


def test_right_simplex_by_hand(d):
    x = np.concatenate([np.zeros((1, d)), np.eye(d)])
    by_hand = {2: 2 * (2**0.5 - 1), 3: 3 * (1 / (3 + 3**0.5)) / (3**0.5 / 2)}[d]
    assert radius_ratio(x, one(d)) == pytest.approx([by_hand], rel=1e-14)


def test_triangle_three_four_five():
    x = np.array([[0.0, 0.0], [3.0, 0.0], [0.0, 4.0]])
    assert radius_ratio(x, one(2)) == pytest.approx([2 * 1.0 / 2.5], rel=1e-14)


def test_side_length_formula_of_the_paper():
    x = np.array([[0.0, 0.0], [2.0, 0.3], [0.7, 1.9]])
    a, b, c = (np.linalg.norm(x[i] - x[j]) for i, j in ((1, 2), (2, 0), (0, 1)))
    by_sides = (b + c - a) * (c + a - b) * (a + b - c) / (a * b * c)
    assert radius_ratio(x, one(2)) == pytest.approx([by_sides], rel=1e-13)


@given(meshes())
def test_radius_ratio_from_both_radii(mesh):
    points, cells = mesh
    d = points.shape[1]
    q = radius_ratio(points, cells)
    for c in range(0, len(cells), 11):
        x = points[cells[c]]
        radius = np.linalg.norm(ref.exact_circumcenter(x) - x[0])
        assert q[c] == pytest.approx(d * inradius(x) / radius, rel=1e-6)
    assert q.min() > 0.0
    assert q.max() <= 1.0 + 1e-14


@given(meshes(), SEEDS, SCALES)
def test_radius_ratio_has_no_scale_and_no_direction(mesh, seed, scale):
    points, cells = mesh
    turned = points @ rotation(points.shape[1], seed).T * scale
    assert radius_ratio(turned, cells) == pytest.approx(radius_ratio(points, cells), abs=1e-9)


def test_equal_simplices_are_uniform(d):
    points, cells = lattice(d, 3)
    if d == 2:
        points = points @ np.array([[1.0, 0.0], [-0.5, 3**0.5 / 2]])
    assert uniformity(points, cells) == pytest.approx(0.0, abs=1e-12)


def test_two_sizes_by_hand(d):
    """Radii R and 2R: mean 1.5 R, sample deviation R / sqrt(2)."""
    x = regular(d)
    points = np.concatenate([x, 2.0 * x + 10.0])
    cells = np.concatenate([one(d), one(d) + d + 1])
    assert uniformity(points, cells) == pytest.approx(0.5**0.5 / 1.5, rel=1e-13)
    assert uniformity(points, cells, np.array([1.0, 2.0])) == pytest.approx(0.0, abs=1e-13)


@given(meshes())
def test_uniformity_from_the_radii(mesh):
    points, cells = mesh
    radius = np.array([
        np.linalg.norm(ref.exact_circumcenter(points[cell]) - points[cell[0]]) for cell in cells
    ])
    expected = radius.std(ddof=1) / radius.mean()
    assert uniformity(points, cells) == pytest.approx(expected, rel=1e-6)
