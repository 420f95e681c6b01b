"""Bounds of Jacobians: dense samples lie between them, and Gmsh finds the same."""

from __future__ import annotations

import numpy as np
import pytest
from curved_meshes import qualities

from odt_plugins.adapters.higher_order import lattice
from odt_plugins.mesh.bernstein import jacobian_bounds


def _cells(dim, order, off, count=60):
    """Unit cells whose nodes were moved at random."""
    shape = lattice(dim, order, "gmsh")
    straight = shape[:, 1:] / order
    noise = np.random.default_rng(order).normal(size=(count, *straight.shape))
    return straight + off / order**2 * noise, shape


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_all_values_lie_between_the_bounds(order, d):
    x, shape = _cells(d, order, 0.3)
    bounds = jacobian_bounds(x, shape)
    at = np.random.default_rng(1).dirichlet(np.full(d + 1, 0.5), 400)
    at = np.concatenate([at, np.eye(d + 1)])[:, 1:]
    # The shape functions are found by solving for monomials, their slopes by differences.
    powers = np.array([p for p in np.ndindex(*[order + 1] * d) if sum(p) <= order])
    weights = np.linalg.solve(((shape[:, None, 1:] / order) ** powers).prod(axis=2),
                              np.eye(len(shape)))
    slopes = []
    for k in range(d):
        lower = np.maximum(powers - (np.arange(d) == k), 0)
        slopes.append(powers[:, k] * (at[:, None] ** lower).prod(axis=2) @ weights)
    det = np.linalg.det(np.einsum("dqk,mkx->mqdx", np.array(slopes), x))
    det *= np.sign(np.linalg.det(x[:, 1 : d + 1] - x[:, :1]))[:, None]
    size = np.abs(det).max(axis=1)
    undecided = bounds.lower <= 0.0
    assert (bounds.lower <= det.min(axis=1) + 1e-12 * size).all()
    assert (bounds.upper >= det.max(axis=1) - 1e-12 * size).all()
    assert (bounds.least <= det.min(axis=1) + 2e-2 * size)[~undecided].all()
    assert (bounds.lower >= bounds.least - 1e-3 * size)[~undecided].all()
    assert (0 < bounds.valid.sum() < len(x)) == (order > 1)
    assert (bounds.least[~bounds.valid] <= 0.0).all()


@pytest.mark.parametrize("order", [2, 3, 4])
def test_gmsh_finds_the_same_cells_valid(order, d):
    pytest.importorskip("gmsh")
    x, shape = _cells(d, order, 0.3)
    bounds = jacobian_bounds(x, shape)
    rows = np.arange(x.shape[0] * x.shape[1]).reshape(x.shape[:2])
    least, most, _ = qualities(x.reshape(-1, d), rows, d, order)
    kept = np.linalg.det(x[:, 1 : d + 1] - x[:, :1]) > 0
    assert kept.sum() > 20
    clear = kept & (np.abs(least) > 1e-3 * np.abs(most))
    assert np.array_equal(bounds.valid[clear], least[clear] > 0)
    good = clear & bounds.valid
    assert bounds.scaled[good] == pytest.approx((least / most)[good], abs=0.02)
