"""The regularised distortion against closed forms and differences."""

import numpy as np
import pytest

from odt_plugins.engine.untangle.energy import REGULAR, WEIGHT, Distortion, inverses


def star(d, seed=0):
    """One free vertex in the middle of a simplex, some of the cells inverted; any references."""
    rng = np.random.default_rng(seed)
    points = np.concatenate([np.zeros((1, d)), np.eye(d), 0.3 * np.ones((1, d))])
    points[-1] += 0.9
    points += rng.uniform(-0.1, 0.1, points.shape)
    cells = np.array([[*range(i), d + 1, *range(i + 1, d + 1)] for i in range(d + 1)], np.int32)
    reference = REGULAR[d] + rng.uniform(-0.2, 0.2, (len(cells), d, d))
    return points, cells, np.array([d + 1]), reference


def one(d, corners, eps=1e-9):
    """The distortion of one simplex against the regular one."""
    cell = np.arange(d + 1, dtype=np.int32)[None]
    found = Distortion(corners, cell, np.arange(d + 1), REGULAR[d][None])
    return found(corners, eps)[0], found.dets[0]


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("eps", [1.0, 0.05])
def test_the_gradient_is_that_of_differences(d, eps):
    points, cells, free, reference = star(d)
    distortion = Distortion(points, cells, free, reference)
    x = points[free]
    slope = distortion(x, eps)[1]
    assert distortion.dets.min() < 0.0 < distortion.dets.max()
    h = 1e-6
    for i in range(d):
        step = np.zeros_like(x)
        step[0, i] = h
        about = (distortion(x + step, eps)[0] - distortion(x - step, eps)[0]) / (2 * h)
        assert slope[0, i] == pytest.approx(about, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("d", [2, 3])
def test_the_regular_simplex_has_the_least_distortion(d):
    corners = np.concatenate([np.zeros((1, d)), REGULAR[d].T])
    assert one(d, corners) == pytest.approx((d + 2 * WEIGHT, 1.0))
    turned = corners @ np.linalg.qr(np.random.default_rng(1).normal(size=(d, d)))[0].T
    turned[:, 0] *= np.sign(np.linalg.det(turned[1:]) * np.linalg.det(corners[1:]))
    assert one(d, turned) == pytest.approx((d + 2 * WEIGHT, 1.0))
    assert one(d, turned * ([-1.0] + [1.0] * (d - 1)))[0] > 1e3
    # scaled by s: t / chi^(2/d) stays, det is s^d
    s = 1.5
    assert one(d, s * corners)[0] == pytest.approx(d + WEIGHT * (s ** (2 * d) + 1) / s**d)


@pytest.mark.parametrize("d", [2, 3])
def test_cells_without_volume_cost_the_more_the_smaller_eps_is(d):
    corners = np.concatenate([np.zeros((1, d)), REGULAR[d].T])
    corners[:, -1] = 0.0
    costs = [one(d, corners, eps)[0] for eps in (1.0, 0.1, 0.01)]
    assert costs[0] < costs[1] < costs[2] < np.inf
    corners[-1, -1] = -1e-3
    assert one(d, corners, 0.01)[0] > costs[2]


@pytest.mark.parametrize("d", [2, 3])
def test_inverses_by_cofactors(d):
    a = REGULAR[d] + np.random.default_rng(0).uniform(-0.3, 0.3, (5, d, d))
    assert np.allclose(inverses(a) @ a, np.eye(d))
