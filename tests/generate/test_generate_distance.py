"""Signed distance functions against brute force, their gradients and their rules; refinement."""

from __future__ import annotations

import numpy as np
import planar_meshes as planar
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from odt_plugins import InvalidOptionError
from odt_plugins.generate import (
    dblock,
    dblock0,
    dcircle,
    ddiff,
    dintersect,
    dpoly,
    drectangle,
    drectangle0,
    dsphere,
    dunion,
    hgraded,
    hmin,
    huniform,
    protate,
    pshift,
    refine_triangles,
)

POLYGON = np.array([[-1.0, -0.5], [0.2, -1.1], [0.9, 0.3], [0.1, -0.2], [-0.3, 0.8]])


def sides(corners, step=1e-3):
    """Points along a closed polygon."""
    out = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        t = np.linspace(0, 1, 2 + int(np.linalg.norm(b - a) / step))[:, None]
        out.append(a + t * (b - a))
    return np.concatenate(out)


def box_surface(low, high, n=80):
    """Points on the sides of a block."""
    grids = [np.linspace(a, b, n) for a, b in zip(low, high, strict=True)]
    out = []
    for axis in range(3):
        for value in (low[axis], high[axis]):
            axes = [np.array([value]) if k == axis else grids[k] for k in range(3)]
            out.append(np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3))
    return np.concatenate(out)


CIRCLE = np.column_stack([f(np.linspace(0, 2 * np.pi, 20_001)) for f in (np.cos, np.sin)])
RECTANGLE = np.array([[-0.5, -1.0], [0.75, -1.0], [0.75, 0.25], [-0.5, 0.25]])


def even_odd(x, corners):
    """Points inside a polygon, by the sum of the angles its sides are seen under."""
    a = corners[None] - x[:, None]
    b = np.roll(a, -1, axis=1)
    turn = np.arctan2(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0], (a * b).sum(axis=2))
    return np.abs(turn.sum(axis=1)) > np.pi


EXACT = {
    "circle": (lambda p: dcircle(p, 0.2, -0.1, 0.7), 0.7 * CIRCLE + (0.2, -0.1),
               lambda p: np.hypot(p[:, 0] - 0.2, p[:, 1] + 0.1) < 0.7),
    "rectangle": (lambda p: drectangle0(p, -0.5, 0.75, -1.0, 0.25), sides(RECTANGLE),
                  lambda p: even_odd(p, RECTANGLE)),
    "polygon": (lambda p: dpoly(p, POLYGON), sides(POLYGON), lambda p: even_odd(p, POLYGON)),
    "closed polygon": (lambda p: dpoly(p, [*POLYGON[::-1], POLYGON[-1]]), sides(POLYGON),
                       lambda p: even_odd(p, POLYGON)),
    "block": (lambda p: dblock0(p, -0.5, 0.75, -1.0, 0.25, -0.2, 0.9),
              box_surface((-0.5, -1.0, -0.2), (0.75, 0.25, 0.9)),
              lambda p: ((p > (-0.5, -1.0, -0.2)) & (p < (0.75, 0.25, 0.9))).all(axis=1)),
    "sphere": (lambda p: dsphere(p, 0.1, 0.2, 0.3, 0.8), None,
               lambda p: ((p - (0.1, 0.2, 0.3)) ** 2).sum(axis=1) < 0.64),
}


@pytest.mark.parametrize("name", EXACT)
def test_exact_distances_are_those_to_the_nearest_sample(name):
    fd, boundary, inside = EXACT[name]
    dim = 3 if name in ("block", "sphere") else 2
    x = np.random.default_rng(11).uniform(-1.5, 1.5, (400, dim))
    d = fd(x)
    assert ((d < 0) == inside(x)).all()
    if boundary is not None:
        tolerance = 0.02 if dim == 3 else 2e-4
        far = np.abs(d) > 3 * tolerance
        assert np.allclose(np.abs(d)[far], cKDTree(boundary).query(x[far])[0], atol=tolerance)
    # |grad d| = 1 almost everywhere; kinks have measure zero
    eps = 1e-6
    slope = np.stack([(fd(x + eps * e) - fd(x - eps * e)) / (2 * eps) for e in np.eye(dim)])
    assert np.median(np.abs(np.linalg.norm(slope, axis=0) - 1.0)) < 1e-8
    assert (np.abs(np.linalg.norm(slope, axis=0) - 1.0) < 1e-4).mean() > 0.98


@given(st.integers(0, 2**20))
@settings(max_examples=25, deadline=None)
def test_inexact_boxes_agree_inside_and_bound_from_below(seed):
    rng = np.random.default_rng(seed)
    low, high = np.sort(rng.uniform(-1, 1, (2, 3)), axis=0)
    x = rng.uniform(-1.5, 1.5, (60, 3))
    for near, exact, corners, p in (
        (dblock, dblock0, np.stack([low, high], axis=1).ravel(), x),
        (drectangle, drectangle0, np.stack([low, high], axis=1)[:2].ravel(), x[:, :2]),
    ):
        a, b = near(p, *corners), exact(p, *corners)
        assert np.array_equal(np.sign(a), np.sign(b))
        assert np.allclose(a[b < 0], b[b < 0], atol=1e-15)
        assert (a <= b + 1e-12).all()


@given(st.integers(0, 2**20))
@settings(max_examples=25, deadline=None)
def test_set_operations_are_those_of_the_sets(seed):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, (200, 2))
    a, b, c = (dcircle(x, *rng.uniform(-0.5, 0.5, 2), rng.uniform(0.2, 0.8)) for _ in range(3))
    assert np.array_equal(dunion(a, b, c) < 0, (a < 0) | (b < 0) | (c < 0))
    assert np.array_equal(dintersect(a, b, c) < 0, (a < 0) & (b < 0) & (c < 0))
    assert np.array_equal(ddiff(a, b, c) < 0, (a < 0) & (b > 0) & (c > 0))


def test_rotation_and_translation_move_the_shape_as_in_distmesh():
    x = np.random.default_rng(5).uniform(-1, 1, (50, 2))
    angle = 0.4
    turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    assert np.allclose(protate(x, angle), x @ turned)
    centre = turned @ (0.5, 0.0)
    assert np.allclose(dcircle(protate(x, angle), 0.5, 0, 0.2), dcircle(x, *centre, 0.2))
    assert np.allclose(dcircle(pshift(x, 0.3, -0.2), 0.3, -0.2, 1), dcircle(x, 0, 0, 1))
    solid = np.random.default_rng(6).uniform(-1, 1, (50, 3))
    assert np.allclose(dsphere(pshift(solid, 1, 2, 3), 1, 2, 3, 1), dsphere(solid, 0, 0, 0, 1))


def test_distances_say_what_is_wrong_with_their_input():
    with pytest.raises(InvalidOptionError, match=r"shape \(3, 3\); expected \(n, 2\)"):
        dcircle(np.zeros((3, 3)), 0, 0, 1)
    with pytest.raises(InvalidOptionError, match=r"shape \(3,\); expected \(n, 3\)"):
        dsphere(np.zeros(3), 0, 0, 0, 1)
    with pytest.raises(InvalidOptionError, match="got 2 corners"):
        dpoly(np.zeros((1, 2)), [[0, 0], [1, 0], [0, 0]])


def test_sizes():
    x = np.array([[0.0, 0.0], [0.5, 0.0], [2.0, 0.0]])
    assert huniform(x).tolist() == [1, 1, 1]
    graded = hgraded(lambda p: dcircle(p, 0, 0, 1), 0.1, 0.5, 0.45)
    assert np.allclose(graded(x), [0.45, 0.35, 0.45])
    assert np.allclose(hmin(graded, lambda p: 0.4 * huniform(p))(x), [0.4, 0.35, 0.4])
    with pytest.raises(InvalidOptionError, match=r"least=0\.0"):
        hgraded(dcircle, 0.0, 0.1)


def test_refined_triangles_tile_the_old_ones():
    points, cells = planar.jittered_grid(9, 7, np.random.default_rng(3))[:2]
    fine, children, ends = refine_triangles(points, cells)
    assert np.array_equal(fine[:len(points)], points)
    assert np.allclose(fine[len(points):], points[ends].mean(axis=1), atol=0)
    area = planar.areas(points, cells)
    assert np.allclose(planar.areas(fine, children).reshape(-1, 4), area[:, None] / 4)
    q = planar.shape(points, cells)[0]
    assert np.allclose(planar.shape(fine, children)[0].reshape(-1, 4), q[:, None])
    edges = np.sort(cells[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert len(ends) == len(np.unique(edges, axis=0))
    assert len(np.unique(np.sort(ends, axis=1), axis=0)) == len(ends)
    inner = np.sort(children[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, count = np.unique(inner, axis=0, return_counts=True)
    assert count.max() == 2
