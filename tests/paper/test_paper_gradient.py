"""Gradients, the diagonal of the Hessian, circumcenters."""

from __future__ import annotations

import numpy as np
import pytest
import reference as ref
from hypothesis import given
from strategies import SCALES, SEEDS, jittered, meshes, random_delaunay, rotation, simplices

from odt_plugins.engine.cells.geometry import (
    boundary_vertices,
    circumcenters,
    circumradii,
    signed_volumes,
    volume_gradients,
)
from odt_plugins.engine.odt.energy import energy
from odt_plugins.engine.odt.gradient import energy_gradient, gradient, hessian_diagonal
from odt_plugins.engine.odt.sweeps import gauss_seidel_sweep
from odt_plugins.engine.topology.stencil import make_topology
from odt_plugins.paper.energy import hat_weighted_volumes
from odt_plugins.paper.gradient import (
    gradient_by_edges,
    gradient_by_norms,
    gradient_p1,
    optimality_residual,
)


def interior(points, cells):
    return np.flatnonzero(~boundary_vertices(cells, len(points)))


@given(meshes(), SEEDS)
def test_three_forms_agree(mesh, seed):
    points, cells = mesh
    points = points + np.random.default_rng(seed).uniform(-1, 1, points.shape[1])
    inner = interior(points, cells)
    form5 = gradient(points, cells)[inner]
    scale = np.abs(form5).max()
    assert gradient_by_norms(points, cells)[inner] == pytest.approx(form5, abs=1e-11 * scale)
    assert gradient_by_edges(points, cells)[inner] == pytest.approx(form5, abs=1e-11 * scale)
    assert energy_gradient(points, cells)[inner] == pytest.approx(form5, abs=1e-11 * scale)


@given(meshes())
def test_gradient_against_differences(mesh):
    points, cells = mesh
    slope = gradient(points, cells)
    scale = np.abs(slope).max()
    for i in interior(points, cells)[::5]:
        mine = cells[ref.star(cells, i)]
        exact = ref.difference_gradient(lambda p, t=mine: energy(p, t), points, i, 1e-4)
        assert slope[i] == pytest.approx(exact, abs=1e-8 * scale)


@given(meshes(), SEEDS)
def test_exact_derivative_of_the_cellwise_sum_at_every_vertex(mesh, seed):
    points, cells = mesh
    rho = np.random.default_rng(seed).uniform(0.1, 10, len(cells))
    slope = energy_gradient(points, cells, rho)
    scale = np.abs(slope).max()
    for i in range(0, len(points), 9):
        mine = ref.star(cells, i)
        exact = ref.difference_gradient(
            lambda p, t=mine: energy(p, cells[t], rho[t]), points, i, 1e-5
        )
        assert slope[i] == pytest.approx(exact, abs=1e-6 * scale)


@given(meshes())
def test_volume_gradients_against_differences(mesh):
    points, cells = mesh
    assert signed_volumes(points, cells) == pytest.approx(ref.volumes(points, cells), rel=1e-9)
    slopes = volume_gradients(points, cells)
    for c in range(0, len(cells), 19):
        for k, i in enumerate(cells[c]):
            exact = ref.difference_gradient(lambda p, c=c: ref.volume(p[cells[c]]), points, i, 1e-3)
            assert slopes[c, k] == pytest.approx(exact, abs=1e-11)


@given(meshes(), SEEDS, SCALES)
def test_gradient_turns_and_scales_with_the_mesh(mesh, seed, scale):
    points, cells = mesh
    d = points.shape[1]
    turn = rotation(d, seed)
    inner = interior(points, cells)
    slope = gradient(points, cells)[inner]
    turned = gradient(points @ turn.T * scale, cells)[inner]
    limit = 1e-10 * np.abs(slope).max() * scale ** (d + 1)
    assert turned == pytest.approx(slope @ turn.T * scale ** (d + 1), abs=limit)


@given(meshes())
def test_circumcenters_of_meshes(mesh):
    points, cells = mesh
    exact = np.array([ref.exact_circumcenter(points[cell]) for cell in cells])
    radius = circumradii(points, cells)
    assert (np.abs(circumcenters(points, cells) - exact).max(axis=1) <= 1e-9 * radius).all()
    assert radius == pytest.approx(
        np.linalg.norm(exact - points[cells[:, 0]], axis=1), rel=1e-9)


@given(simplices())
def test_circumcenter_of_slivers(x):
    cell = np.arange(len(x), dtype=np.int32)[None]
    exact = ref.exact_circumcenter(x)
    radius = np.linalg.norm(exact - x[0])
    flatness = ref.volume(x)
    assert circumcenters(x, cell)[0] == pytest.approx(exact, abs=1e-14 * radius / flatness)


@given(simplices())
def test_circumcenter_from_the_forces(x):
    d = x.shape[1]
    cell = np.arange(d + 1, dtype=np.int32)[None]
    slopes = volume_gradients(x, cell)[0]
    norms = (x**2).sum(axis=1)
    forces = sum((norms.sum() - norms[i]) * slopes[i] for i in range(d + 1))
    volume = signed_volumes(x, cell)[0]
    center = circumcenters(x, cell)[0]
    assert 2 * volume * center == pytest.approx(-forces, abs=1e-12)


def test_flat_cells_give_their_barycenter(d):
    x = np.concatenate([np.eye(d), np.full((1, d), 1.0 / d)])
    x[:, -1] = 0.0
    cell = np.arange(d + 1, dtype=np.int32)[None]
    assert circumcenters(x, cell)[0] == pytest.approx(x.mean(axis=0))


def test_residual_goes_to_zero(d):
    points, cells = jittered(d, 4, 8, 0.15)
    near = boundary_vertices(cells, len(points))
    topology = make_topology(cells, ~near, near)
    start = optimality_residual(points, cells, ~near)
    for _ in range(200):
        points, _ = gauss_seidel_sweep(points, topology, boundary_rule=False)
    assert start > 0.05
    assert optimality_residual(points, cells, ~near) < 1e-12
    assert np.abs(gradient(points, cells)[~near]).max() < 1e-14


def test_residual_by_hand(d):
    points, cells = jittered(d, 3, 9)
    near = boundary_vertices(cells, len(points))
    worst = 0.0
    for i in np.flatnonzero(~near):
        mine = ref.star(cells, i)
        ones, none = np.ones(len(points)), np.zeros(len(cells))
        goal = ref.target(points, cells, i, ones, "odt", none, False)
        size = (ref.volumes(points, cells[mine]) ** (1 / d)).mean()
        worst = max(worst, np.linalg.norm(goal - points[i]) / size)
    assert optimality_residual(points, cells, ~near) == pytest.approx(worst, rel=1e-10)
    assert optimality_residual(points, cells, np.zeros(len(points), dtype=bool)) == 0.0


@given(meshes())
def test_diagonal_of_the_hessian(mesh):
    points, cells = mesh
    d = points.shape[1]
    diagonal = hessian_diagonal(points, cells)
    step = 1e-3
    for i in interior(points, cells)[::5]:
        mine = cells[ref.star(cells, i)]
        middle = energy(points, mine)
        for axis in range(d):
            ahead, behind = points.copy(), points.copy()
            ahead[i, axis] += step
            behind[i, axis] -= step
            second = (energy(ahead, mine) - 2 * middle + energy(behind, mine)) / step**2
            assert diagonal[i] == pytest.approx(second, rel=1e-6)


def true_gradient(points, cells, vertices, rho, step):
    """Differences of the energy (1.1) with the density fixed in space."""
    rows = []
    for i in vertices:
        mine = cells[ref.star(cells, i)]
        rows.append(
            ref.difference_gradient(lambda p, t=mine: ref.energy(p, t, rho), points, i, step)
        )
    return np.array(rows)


def gradient_errors(d, n):
    """Relative error of the one-point and the P1 gradient of the true weighted energy."""
    points, cells = jittered(d, n, 21, 0.25)
    wave = np.array([1.0, -0.8, 0.6])[:d]

    def rho(x):
        return np.exp(x @ wave)

    inner = interior(points, cells)
    inner = inner[:: max(1, len(inner) // 12)]
    exact = true_gradient(points, cells, inner, rho, 1e-4 / n)
    one_point = gradient(points, cells, rho(points)[cells].mean(axis=1))[inner]
    linear = gradient_p1(points, cells, rho(points))[inner]
    scale = np.linalg.norm(exact)
    return np.linalg.norm(one_point - exact) / scale, np.linalg.norm(linear - exact) / scale


def test_density_gradient_is_first_order(d):
    coarse, fine = gradient_errors(d, 3)[0], gradient_errors(d, 6)[0]
    assert coarse < 0.12
    assert fine < 0.65 * coarse


def test_factor_is_that_of_the_uniform_gradient(d):
    points, cells = jittered(d, 3, 12)
    ones = np.ones(len(cells))
    assert np.array_equal(gradient(points, cells, ones), gradient(points, cells))
    inner = interior(points, cells)
    form4 = gradient_by_edges(points, cells)[inner]
    assert gradient(points, cells, 3.0 * ones)[inner] == pytest.approx(3.0 * form4, abs=1e-15)


def test_linear_density_gives_the_better_gradient(d):
    one_point, linear = gradient_errors(d, 4)
    assert linear < 0.35 * one_point


def test_gradient_is_exact_for_linear_density(d):
    points, cells = jittered(d, 3, 13)
    slope = np.array([0.7, -0.4, 0.3])[:d]
    inner = interior(points, cells)
    exact = true_gradient(points, cells, inner, lambda x: 2.0 + x @ slope, 1e-4)
    result = gradient_p1(points, cells, 2.0 + points @ slope)[inner]
    assert result == pytest.approx(exact, abs=1e-8 * np.abs(exact).max())


def test_uniform_density_gives_the_plain_gradient(d):
    points, cells = jittered(d, 3, 13)
    inner = interior(points, cells)
    linear = gradient_p1(points, cells, np.ones(len(points)))[inner]
    assert linear == pytest.approx(gradient(points, cells)[inner], abs=1e-15)


def test_quadrature_of_the_hat_functions(d):
    points, cells = random_delaunay(d, 12, 3)
    rho = np.random.default_rng(14).uniform(1, 5, len(points))
    hats = hat_weighted_volumes(points, cells, rho)
    total = (rho[cells].mean(axis=1) * signed_volumes(points, cells)).sum()
    assert hats.sum() == pytest.approx(total, rel=1e-13)
    if d == 2:
        i, j, k = cells.T
        area = ref.volumes(points, cells)
        assert hats[:, 0] == pytest.approx(area / 12 * (2 * rho[i] + rho[j] + rho[k]), rel=1e-9)
