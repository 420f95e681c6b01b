"""Tensors of two and three dimensions against numpy.linalg."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import DIMENSIONS, SEEDS

from odt_plugins.engine.cells import tensors as ts


def turns(rng, shape, d):
    """Random orthogonal matrices."""
    return np.linalg.qr(rng.normal(size=(*shape, d, d)))[0]


def definite(rng, shape, d, decades=2.0):
    """Random positive definite tensors whose eigenvalues lie within so many decades."""
    axes = turns(rng, shape, d)
    values = 10.0 ** rng.uniform(-decades / 2, decades / 2, (*shape, d))
    out = np.einsum("...ij,...j,...kj->...ik", axes, values, axes)
    return 0.5 * (out + np.swapaxes(out, -1, -2))


def slow(function, tensors):
    values, axes = np.linalg.eigh(tensors)
    return np.einsum("...ij,...j,...kj->...ik", axes, function(values), axes)


@given(DIMENSIONS, SEEDS, st.sampled_from([0.0, 2.0, 12.0]),
       st.sampled_from([1e-200, 1e-6, 1.0, 1e200]))
def test_eigenvalues_are_those_of_lapack_at_every_magnitude(d, seed, decades, scale):
    rng = np.random.default_rng(seed)
    tensors = scale * definite(rng, (4, 5), d, decades)
    values, axes = ts.eigenvalues(tensors)
    most = np.abs(tensors).max(axis=(-1, -2))[..., None]
    assert np.allclose(np.sort(values) / most, np.linalg.eigvalsh(tensors) / most, atol=1e-14)
    again = ts.of_eigenvalues(values, axes)
    assert (np.abs(again - tensors) <= 2e-15 * most[..., None]).all()
    assert np.allclose(np.einsum("...ji,...jk->...ik", axes, axes), np.eye(d), atol=1e-14)


def test_eigenvalues_of_diagonal_tensors_are_exact(d):
    values = np.array([[1e-12, 1.0, 1e12][:d], [4.0] * d, [0.0] * d, [-3.0, 5.0, 3.0][:d]])
    found, axes = ts.eigenvalues(values[:, None, :] * np.eye(d))
    assert np.array_equal(found, values)
    assert np.array_equal(axes, np.broadcast_to(np.eye(d), axes.shape))


@given(DIMENSIONS, SEEDS)
def test_logarithm_and_exponential(d, seed):
    tensors = definite(np.random.default_rng(seed), (30,), d, 8.0)
    logs = ts.logarithm(tensors)
    assert np.allclose(logs, slow(np.log, tensors), atol=1e-6)
    assert np.allclose(ts.exponential(logs), tensors, rtol=1e-6, atol=1e-6)
    small = definite(np.random.default_rng(seed), (30,), d, 1.0)
    assert np.allclose(ts.exponential(-small), slow(lambda x: np.exp(-x), small), atol=1e-14)


@given(DIMENSIONS, SEEDS)
def test_means(d, seed):
    rng = np.random.default_rng(seed)
    tensors, weights = definite(rng, (6, 4), d), rng.random((6, 4))
    logs = (weights[..., None, None] * slow(np.log, tensors)).sum(axis=1)
    expected = slow(np.exp, logs / weights.sum(axis=1)[:, None, None])
    found = ts.mean(tensors, weights)
    assert np.allclose(found, expected, atol=1e-12)
    # the inverse of a mean is the mean of the inverses, and the determinant is the geometric mean
    assert np.allclose(np.linalg.inv(found), ts.mean(np.linalg.inv(tensors), weights), atol=1e-11)
    same = np.repeat(tensors[:, :1], 3, axis=1)
    assert np.allclose(ts.mean(same), tensors[:, 0], rtol=1e-12)
    plain = ts.determinants(ts.mean(tensors))
    assert np.allclose(plain, np.linalg.det(tensors).prod(axis=1) ** 0.25)


@given(DIMENSIONS, SEEDS, st.sampled_from([1.0, 6.0, 12.0]))
def test_factors(d, seed, decades):
    tensors = definite(np.random.default_rng(seed), (20,), d, decades)
    factor = ts.cholesky(tensors)
    assert np.array_equal(factor, np.tril(factor))
    most = np.abs(tensors).max(axis=(1, 2))[:, None, None]
    assert (np.abs(ts.product(factor, ts.transposed(factor)) - tensors) <= 1e-15 * most).all()
    identity = ts.product(ts.inverse_factor(factor), factor)
    assert np.allclose(identity, np.eye(d), atol=1e-8)
    edges = np.random.default_rng(seed).normal(size=(20, d))
    seen = np.einsum("nji,nj->ni", factor, edges)
    assert np.allclose(ts.squared_lengths(edges, tensors), (seen**2).sum(axis=1), rtol=1e-3)


@given(DIMENSIONS, SEEDS, st.sampled_from([1.0, 8.0]))
def test_two_metrics_meet_in_the_largest_ellipsoid_of_their_basis(d, seed, decades):
    rng = np.random.default_rng(seed)
    a, b = definite(rng, (10,), d, decades), definite(rng, (10,), d, decades)
    basis, share = ts.reduced(a, b)
    for tensors, values in ((a, share), (b, 1.0 - share)):
        assert np.allclose(ts.of_eigenvalues(values, basis), tensors, rtol=1e-9,
                           atol=1e-12 * np.abs(a + b).max())
    both = ts.intersection(a, b)
    edges = rng.normal(size=(200, 1, d))
    lengths = [ts.squared_lengths(edges, m) for m in (a, b, both)]
    assert (lengths[2] >= np.maximum(lengths[0], lengths[1]) * (1.0 - 1e-9)).all()
    assert (lengths[2] <= (lengths[0] + lengths[1]) * (1.0 + 1e-9)).all()
    # det (a intersected b) from the generalised eigenvalues
    ratio = np.linalg.eigvals(np.linalg.solve(a, b)).real
    expected = np.linalg.det(a) * np.maximum(ratio, 1.0).prod(axis=1)
    assert np.allclose(ts.determinants(both), expected, rtol=1e-3)
    assert np.allclose(ts.intersection(b, a), both, rtol=1e-6, atol=1e-9 * np.abs(both).max())
    assert np.allclose(ts.intersection(a, a), a, atol=1e-12 * np.abs(a).max())


def test_of_two_sizes_the_smaller_one_holds(d):
    sizes = np.array([[0.1, 3.0, 1e-6, 1e6][i] for i in range(4)])
    a = sizes[:, None, None] ** -2.0 * np.eye(d)
    b = np.full(4, 0.5)[:, None, None] ** -2.0 * np.eye(d)
    expected = np.minimum(sizes, 0.5)[:, None, None] ** -2.0 * np.eye(d)
    assert np.allclose(ts.intersection(a, b), expected, rtol=1e-12, atol=0.0)


def test_long_ratios_across_do_not_disturb_each_other():
    a, b = np.diag([1e12, 1.0, 1.0]), np.diag([1.0, 1e12, 1e-12])
    assert ts.intersection(a, b) == pytest.approx(np.diag([1e12, 1e12, 1.0]), rel=1e-12)


def test_the_packed_order_is_that_of_medit(d):
    tensors = definite(np.random.default_rng(3), (7,), d)
    packed = ts.packed(tensors)
    names = {2: ["11", "12", "22"], 3: ["11", "12", "22", "13", "23", "33"]}[d]
    expected = [tensors[:, int(i) - 1, int(j) - 1] for i, j in names]
    assert np.array_equal(packed, np.stack(expected, axis=1))
    assert np.array_equal(ts.full(packed), tensors)
