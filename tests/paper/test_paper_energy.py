"""Energies of the paper: formulas, lower bounds, densities."""

from __future__ import annotations

import numpy as np
import pytest
import reference as ref
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import Delaunay
from strategies import SCALES, SEEDS, jittered, lattice, meshes, positive, random_delaunay, rotation

from odt_plugins.engine.cells.geometry import boundary_vertices, signed_volumes
from odt_plugins.engine.odt.energy import cell_energies, energy
from odt_plugins.engine.odt.sweeps import gauss_seidel_sweep
from odt_plugins.engine.topology.stencil import make_topology
from odt_plugins.paper.energy import (
    energy_by_patches,
    energy_by_stars,
    energy_constant,
    energy_p1,
    energy_tilde_p1,
    hat_weighted_volumes,
    lower_bounds,
)
from odt_plugins.paper.gradient import approximate_gradient


def right_simplex(d):
    return np.concatenate([np.zeros((1, d)), np.eye(d)]), np.arange(d + 1, dtype=np.int32)[None]


def regular_simplex(d):
    if d == 2:
        points = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 3**0.5 / 2]])
    else:
        points = np.array([[1.0, 1, 1], [-1, -1, 1], [-1, 1, -1], [1, -1, -1]])
    return points, positive(points, np.arange(d + 1, dtype=np.int32)[None])


@given(meshes(), SEEDS)
def test_energy_by_all_formulas(mesh, seed):
    points, cells = mesh
    shift = np.random.default_rng(seed).uniform(-3, 3, points.shape[1])
    value = energy(points, cells)
    assert energy_by_stars(points + shift, cells) == pytest.approx(value, rel=1e-12)
    assert energy_by_patches(points + shift, cells) == pytest.approx(value, rel=1e-12)
    assert energy(points + shift, cells) == pytest.approx(value, rel=1e-12)
    assert ref.unsplit_energy(points, cells) == pytest.approx(value, rel=1e-12)


def test_energy_is_the_weighted_interpolation_error(d):
    points, cells = jittered(d, 3, 11)
    assert energy(points, cells) == pytest.approx(ref.energy(points, cells), rel=1e-12)


@given(meshes(), SEEDS, SCALES)
def test_energy_under_rotation_scale_and_relabelling(mesh, seed, scale):
    points, cells = mesh
    d = points.shape[1]
    value = energy(points, cells)
    turned = points @ rotation(d, seed).T * scale
    assert energy(turned, cells) == pytest.approx(value * scale ** (d + 2), rel=1e-10)
    rng = np.random.default_rng(seed)
    names = rng.permutation(len(points)).astype(np.int32)
    renamed = np.empty_like(points)
    renamed[names] = points
    shuffled = names[np.roll(cells, 1 if d == 2 else 0, axis=1)][rng.permutation(len(cells))]
    assert energy(renamed, shuffled) == pytest.approx(value, rel=1e-12)


def test_right_simplex_by_hand(d):
    points, cells = right_simplex(d)
    assert energy(points, cells) == pytest.approx({2: 1 / 6, 3: 3 / 40}[d], rel=1e-15)


@given(meshes())
def test_cell_formula_against_quadrature(mesh):
    points, cells = mesh
    for c in range(0, len(cells), 17):
        one = cells[c : c + 1]
        exact = ref.energy(points, one)
        assert cell_energies(points, one)[0] == pytest.approx(exact, rel=1e-9)


@given(meshes())
def test_lower_bounds_hold(mesh):
    shape, size = lower_bounds(*mesh)
    assert energy(*mesh) >= shape >= size > 0.0


def test_equality_for_the_equilateral_simplex(d):
    points, cells = regular_simplex(d)
    shape, size = lower_bounds(points, cells)
    value = energy(points, cells)
    assert shape == pytest.approx(value, rel=1e-14)
    assert size == pytest.approx(value, rel=1e-14)
    assert energy_constant(d) * ref.volume(points[cells[0]]) ** (1 + 2 / d) == pytest.approx(value)


def test_equality_for_an_equilateral_triangulation():
    points, cells = lattice(2, 6)
    sheared = points @ np.array([[1.0, 0.0], [-0.5, 3**0.5 / 2]])
    shape, size = lower_bounds(sheared, cells)
    assert shape == pytest.approx(energy(sheared, cells), rel=1e-13)
    assert size == pytest.approx(shape, rel=1e-13)


def test_second_bound_is_tight_for_equal_volumes_only(d):
    points, cells = lattice(d, 3)
    shape, size = lower_bounds(points, cells)
    assert size == pytest.approx(shape, rel=1e-13)
    assert energy(points, cells) > 1.05 * shape
    moved, _ = jittered(d, 3, 2)
    shape, size = lower_bounds(moved, cells)
    assert shape > 1.001 * size


@given(meshes(), SEEDS)
def test_weighted_bounds_hold(mesh, seed):
    rho = np.random.default_rng(seed).uniform(0.1, 10, len(mesh[1]))
    shape, size = lower_bounds(*mesh, rho)
    assert energy(*mesh, rho) >= shape >= size > 0.0


def test_weighted_bounds_are_tight_for_equidistributed_equilateral_cells(d):
    points, cells = regular_simplex(d)
    two = np.concatenate([cells, cells + d + 1])
    both = np.concatenate([points, 3.0 * points])
    rho = np.array([1.0, 3.0 ** -(d + 2)])
    shape, size = lower_bounds(both, two, rho)
    assert shape == pytest.approx(energy(both, two, rho), rel=1e-13)
    assert size == pytest.approx(shape, rel=1e-13)


def equidistribution_run(d, rounds):
    """Disc or ball with rho = h^-(d + 2), h growing outwards: spread of volumes in every round."""

    def density(x):
        return (0.5 + np.linalg.norm(x, axis=1)) ** -(d + 2.0)

    points, cells = random_delaunay(d, 50 if d == 2 else 150, 4)
    history = []
    for _ in range(rounds):
        near = boundary_vertices(cells, len(points))
        inner = ~near[cells].any(axis=1)
        rho_tau = density(points)[cells].mean(axis=1)
        volumes = signed_volumes(points, cells)
        weighted = volumes * rho_tau ** (d / (d + 2))
        history.append([v[inner].std() / v[inner].mean() for v in (weighted, volumes)])
        topology = make_topology(cells, ~near, near)
        for _ in range(2):
            points, _ = gauss_seidel_sweep(points, topology, density(points))
        cells = positive(points, Delaunay(points).simplices.astype(np.int32))
    return np.array(history)


@pytest.mark.parametrize(("dimension", "spread"), [(2, 0.25), (3, 0.5)])
def test_weighted_volumes_become_equal(dimension, spread):
    history = equidistribution_run(dimension, 25)
    weighted, plain = history[-1]
    assert weighted < spread
    assert weighted < 0.7 * plain
    assert weighted < 0.6 * history[0, 0]


@given(meshes())
def test_star_formula(mesh):
    points, cells = mesh
    d = points.shape[1]
    nodal = sum(
        (points[i] ** 2).sum() * ref.volumes(points, cells[ref.star(cells, i)]).sum()
        for i in range(len(points))
    ) / (d + 1)
    norm = ref.integral(points, cells, lambda x, nodes, cell: (x**2).sum(axis=1))
    scale = abs(nodal)
    assert nodal - norm == pytest.approx(energy_by_stars(points, cells), abs=1e-12 * scale)


def test_density_reduces_to_the_plain_energy(d):
    points, cells = jittered(d, 3, 5)
    value = energy(points, cells)
    ones = np.ones(len(points))
    assert energy_p1(points, cells, ones) == pytest.approx(value, rel=1e-13)
    assert energy_tilde_p1(points, cells, ones) == pytest.approx(value, rel=1e-13)
    assert energy(points, cells, 2.5) == pytest.approx(2.5 * value, rel=1e-15)
    assert energy_by_stars(points, cells, np.full(len(cells), 2.5)) == pytest.approx(2.5 * value)


def test_linear_density_is_integrated_exactly(d):
    points, cells = jittered(d, 3, 6)
    slope = np.array([0.7, -0.4, 0.3])[:d]

    def linear(x):
        return 2.0 + x @ slope

    rho = linear(points)
    exact = ref.energy(points, cells, linear)
    assert energy_p1(points, cells, rho) == pytest.approx(exact, rel=1e-12)
    exact = ref.energy_tilde(points, cells, linear, 1 / (d + 3))
    assert energy_tilde_p1(points, cells, rho) == pytest.approx(exact, rel=1e-12)
    hats = hat_weighted_volumes(points, cells, rho)
    for c in range(0, len(cells), 7):
        for k in range(d + 1):
            exact = ref.integral(
                points, cells[c : c + 1], lambda x, nodes, _, k=k: nodes[:, k] * linear(x)
            )
            assert hats[c, k] == pytest.approx(exact, rel=1e-12)


@given(meshes())
def test_second_form_needs_the_factor_of_its_own_integrals(mesh):
    points, cells = mesh
    d = points.shape[1]
    moments = ref.energy_tilde(points, cells, lambda x: np.ones(len(x)), 1.0)
    assert moments / (d + 3) == pytest.approx(energy(points, cells), rel=1e-9)
    assert energy_by_patches(points, cells) == pytest.approx(moments / (d + 3), rel=1e-9)


@given(meshes(), SEEDS)
def test_both_energies_agree_for_cellwise_density(mesh, seed):
    rho = np.random.default_rng(seed).uniform(0.1, 10, len(mesh[1]))
    value = energy(*mesh, rho)
    assert energy_by_patches(*mesh, rho) == pytest.approx(value, rel=1e-12)
    assert energy_by_stars(*mesh, rho) == pytest.approx(value, rel=1e-11)


@given(SEEDS, st.sampled_from([2, 3]))
def test_patch_centroid_minimises_the_patch_energy(seed, d):
    points, cells = jittered(d, 3, seed)
    inner = np.flatnonzero(~boundary_vertices(cells, len(points)))
    i = inner[seed % len(inner)]
    patch = cells[ref.star(cells, i)]
    mass = ref.volumes(points, patch)
    centroid = mass @ points[patch].mean(axis=1) / mass.sum()

    def patch_energy(x):
        moment = ref.integral(points, patch, lambda y, nodes, cell: ((y - x) ** 2).sum(axis=1))
        return moment / (d + 1)

    least = patch_energy(centroid)
    for step in 0.05 * np.vstack([np.eye(d), -np.eye(d)]):
        assert patch_energy(centroid + step) == pytest.approx(
            least + mass.sum() * 0.05**2 / (d + 1), rel=1e-10
        )
    slope = approximate_gradient(points, cells)[i]
    assert slope == pytest.approx(2 / (d + 1) * mass.sum() * (points[i] - centroid), abs=1e-14)
