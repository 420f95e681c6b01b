"""The global scheme, Section 4.3: its matrix, its steps, its solvers."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import reference as ref
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import Delaunay
from strategies import SEEDS, jittered, lattice, meshes, positive, random_delaunay

from odt_plugins.engine.cells.geometry import boundary_vertices, signed_volumes
from odt_plugins.engine.odt.cholesky import factorize, solve_direct
from odt_plugins.engine.odt.energy import energy
from odt_plugins.engine.odt.global_step import (
    LONGEST,
    choose_solve,
    global_direction,
    global_step,
    graph_laplacian,
    interior_matrix,
    least_alpha,
    line_search,
    step_gradient,
)
from odt_plugins.engine.odt.gradient import gradient, hessian_diagonal
from odt_plugins.engine.odt.multigrid import multigrid, solve_amg, solve_columns
from odt_plugins.engine.odt.sweeps import jacobi_sweep
from odt_plugins.engine.odt.total_energy import frozen_energy
from odt_plugins.engine.topology.stencil import make_topology
from odt_plugins.errors import InvalidOptionError, NotConvergedWarning
from odt_plugins.paper.gradient import approximate_gradient


def topology_of(points, cells):
    near = boundary_vertices(cells, len(points))
    return make_topology(cells, ~near, near)


def matrices(points, cells, rho_tau):
    topology = topology_of(points, cells)
    whole = graph_laplacian(topology, rho_tau * signed_volumes(points, cells))
    return topology, whole, *interior_matrix(whole, topology.movable)


@given(meshes(), SEEDS)
def test_matrix_equals_the_sum_of_element_matrices(mesh, seed):
    points, cells = mesh
    rho_tau = np.random.default_rng(seed).uniform(0.1, 10, len(cells))
    _, whole, _, _ = matrices(points, cells, rho_tau)
    slow = ref.laplacian_matrix(points, cells, rho_tau)
    assert whole.toarray() == pytest.approx(slow, abs=1e-12 * slow.max())
    assert whole.has_sorted_indices
    assert abs(whole - whole.T).max() == pytest.approx(0.0, abs=1e-15 * slow.max())
    assert whole @ np.ones(len(points)) == pytest.approx(np.zeros(len(points)), abs=1e-12)


@given(meshes())
def test_interior_matrix_is_a_positive_definite_m_matrix(mesh):
    points, cells = mesh
    topology, whole, inner, coupling = matrices(points, cells, np.ones(len(cells)))
    dense = inner.toarray()
    assert np.all(np.diag(dense) > 0.0)
    assert np.all(dense - np.diag(np.diag(dense)) <= 0.0)
    assert np.all(coupling.toarray() <= 0.0)
    assert np.linalg.eigvalsh(dense).min() > 0.0
    assert np.linalg.inv(dense).min() > -1e-12 * np.linalg.inv(dense).max()
    diagonal = hessian_diagonal(points, cells)
    assert whole.diagonal() == pytest.approx(diagonal, rel=1e-12)
    assert inner.diagonal() == pytest.approx(diagonal[topology.movable], rel=1e-12)


def wavy(d, n):
    """Lattice with a long wave in its interior; by symmetry the lattice itself is critical."""
    exact, cells = lattice(d, n)
    bump = 0.25 * np.prod(np.sin(np.pi * exact), axis=1)
    return exact + bump[:, None] * np.array([1.0, -0.5, 0.7])[:d], cells, exact


def test_four_global_steps_beat_forty_jacobi_steps(d):
    points, cells, exact = wavy(d, {2: 16, 3: 12}[d])
    topology = topology_of(points, cells)
    best = energy(exact, cells)
    fast = points
    for _ in range(4):
        fast, stats = global_step(fast, topology, boundary_rule=False)
        assert stats.alpha > 0.0
        assert ref.volumes(fast, cells).min() > 0.0
    slow = points
    for _ in range(40):
        slow, _ = jacobi_sweep(slow, topology, boundary_rule=False)
    assert np.abs(gradient(exact, cells)[topology.movable]).max() < 1e-15
    assert energy(fast, cells) - best < 0.1 * (energy(slow, cells) - best)
    assert energy(fast, cells) - best < 1e-2 * (energy(points, cells) - best)


def test_direction_solves_the_modified_newton_system(d):
    points, cells = jittered(d, 4, 33, 0.2)
    rho_tau = np.random.default_rng(34).uniform(0.5, 2, len(cells))
    topology, _, inner, _ = matrices(points, cells, rho_tau)
    movable = topology.movable
    step = global_direction(points, topology, rho_tau, solve_direct, boundary_rule=False)
    slope = gradient(points, cells, rho_tau)
    assert inner @ step[movable] == pytest.approx(-slope[movable], abs=1e-14)
    assert np.all(step[~movable] == 0.0)
    assert (step * slope).sum() < 0.0


def test_boundary_rule_uses_barycenters_at_boundary_cells(d):
    points, cells = jittered(d, 4, 35, 0.2)
    topology, _, inner, _ = matrices(points, cells, np.ones(len(cells)))
    step = global_direction(points, topology, np.ones(len(cells)), solve_direct)
    slope = np.zeros_like(points)
    for c, cell in enumerate(cells):
        x = points[cell]
        center = x.mean(axis=0) if topology.boundary_cells[c] else ref.circumcenter(x)
        slope[cell] += 2 / (d + 1) * ref.volume(x) * (x - center)
    movable = topology.movable
    assert inner @ step[movable] == pytest.approx(-slope[movable], abs=1e-14)


@given(meshes(), SEEDS)
def test_gradient_is_the_scaled_diffusion_residual(mesh, seed):
    points, cells = mesh
    d = points.shape[1]
    rho_tau = np.random.default_rng(seed).uniform(0.1, 10, len(cells))
    topology, _, inner, coupling = matrices(points, cells, rho_tau)
    movable = topology.movable
    residual = inner @ points[movable] + coupling @ points[~movable]
    slope = approximate_gradient(points, cells, rho_tau)[movable]
    assert slope == pytest.approx(d / (d + 1) * residual, abs=1e-12 * np.abs(slope).max())


@pytest.mark.parametrize("alpha", [1.0, 0.5])
def test_damped_fixed_point_gives_the_same_iterates(d, alpha):
    points, cells = jittered(d, 4, 36, 0.2)
    ones = np.ones(len(cells))
    newton, fixed_point = points, points
    for _ in range(3):
        topology = topology_of(newton, cells)
        direction = global_direction(newton, topology, ones, solve_direct, method="cpt")
        newton = newton + alpha * direction
        _, _, inner, coupling = matrices(fixed_point, cells, ones)
        movable = topology.movable
        goal = np.linalg.solve(inner.toarray(), -(coupling @ fixed_point[~movable]))
        share = alpha * d / (d + 1)
        fixed_point = fixed_point.copy()
        fixed_point[movable] = (1 - share) * fixed_point[movable] + share * goal
    assert newton == pytest.approx(fixed_point, abs=1e-13)
    assert np.abs(newton - points).max() > 1e-3


def test_global_cpt_reaches_the_diffusion_equation(d):
    points, cells = jittered(d, 4, 37, 0.2)
    ones = np.ones(len(cells))
    for _ in range(60):
        topology = topology_of(points, cells)
        points = points + global_direction(points, topology, ones, solve_direct, method="cpt")
    assert np.abs(approximate_gradient(points, cells)[topology.movable]).max() < 1e-13


def test_multigrid_equals_the_direct_solver(d):
    points, cells = random_delaunay(d, 150, 38)
    rho_tau = np.random.default_rng(39).uniform(0.1, 10, len(cells))
    _, _, inner, _ = matrices(points, cells, rho_tau)
    right = np.random.default_rng(40).normal(size=(inner.shape[0], d))
    exact = solve_direct(inner, right)
    assert inner @ exact == pytest.approx(right, abs=1e-10)
    assert solve_amg(inner, right, 1e-13) == pytest.approx(exact, abs=1e-10 * np.abs(exact).max())
    assert np.array_equal(solve_amg(inner, right), solve_amg(inner, right))


def random_system(d, n, seed):
    """Matrix of a random Delaunay mesh of about n unknowns, its gradient, and its hierarchy."""
    points = np.random.default_rng(seed).random((n, d))
    cells = positive(points, Delaunay(points).simplices.astype(np.int32))
    topology, _, inner, _ = matrices(points, cells, np.ones(len(cells)))
    right = approximate_gradient(points, cells)[topology.movable]
    inner = inner / inner.diagonal().mean()
    return inner, right, multigrid(inner)


def test_multigrid_iterations_do_not_grow(d):
    counts = []
    for n in (1500, 6000, 24000):
        inner, right, hierarchy = random_system(d, n, 41)
        solution, taken = solve_columns(hierarchy, right, 1e-8, 100)
        residuals = np.linalg.norm(inner @ solution - right, axis=0)
        assert (residuals < 1e-7 * np.linalg.norm(right, axis=0)).all()
        assert hierarchy.operator_complexity() < 1.5
        counts.append(int(taken.max()))
    assert max(counts) <= min(counts) + 3
    assert max(counts) <= 18


def test_hierarchy_is_galerkin_and_keeps_constants_inside(d):
    points, cells = lattice(d, {2: 40, 3: 14}[d])
    _, _, inner, _ = matrices(points, cells, np.ones(len(cells)))
    hierarchy = multigrid(inner / inner.diagonal().mean())
    assert len(hierarchy.levels) == 2
    fine, prolongation, coarsest = (hierarchy.levels[0].A, hierarchy.levels[0].P,
                                    hierarchy.levels[1].A)
    assert 1 < coarsest.shape[0] < 0.3 * fine.shape[0]
    assert abs(coarsest - prolongation.T @ fine @ prolongation).max() < 1e-14
    sums = prolongation @ np.ones(prolongation.shape[1])
    inside = np.abs(fine @ np.ones(fine.shape[0])) < 1e-12
    assert inside.sum() > 0.5 * inside.size
    assert sums[inside] == pytest.approx(np.ones(inside.sum()), abs=1e-12)


def test_cycles_are_symmetric_and_positive():
    inner, _, hierarchy = random_system(2, 1500, 48)
    b = np.random.default_rng(49).normal(size=(5, inner.shape[0]))
    cycle = hierarchy.aspreconditioner()
    products = b @ np.stack([cycle @ one for one in b], axis=1)
    assert products == pytest.approx(products.T, rel=1e-9, abs=1e-9 * np.abs(products).max())
    assert np.linalg.eigvalsh(0.5 * (products + products.T)).min() > 0.0


@pytest.mark.parametrize("columns", [2, 3, 5])
def test_every_column_is_solved_as_if_it_were_alone(columns):
    inner, _, hierarchy = random_system(2, 1500, 48)
    b = np.random.default_rng(49).normal(size=(inner.shape[0], columns))
    together, counts = solve_columns(hierarchy, b, 1e-9, 100)
    direct = solve_direct(inner, b)
    assert inner @ together == pytest.approx(b, abs=1e-7)
    assert inner @ direct == pytest.approx(b, abs=1e-11)
    for c in range(columns):
        alone, count = solve_columns(hierarchy, b[:, c : c + 1], 1e-9, 100)
        assert count[0] == counts[c]
        assert alone[:, 0].tobytes() == together[:, c].tobytes()
        assert solve_direct(inner, b[:, c : c + 1])[:, 0].tobytes() == direct[:, c].tobytes()


def test_a_matrix_that_is_not_positive_definite_is_refused():
    inner, _, _ = random_system(2, 100, 51)
    with pytest.raises(RuntimeError):
        factorize(-inner)


def test_a_column_of_zeros_is_solved_by_zeros():
    inner, right, hierarchy = random_system(2, 1500, 50)
    right[:, 1] = 0.0
    solution, counts = solve_columns(hierarchy, right, 1e-9, 100)
    assert counts[1] == 0 < counts[0]
    assert not solution[:, 1].any()
    assert inner @ solution == pytest.approx(right, abs=1e-8 * np.abs(right).max())


def test_hierarchy_draws_no_random_numbers(d):
    inner, right, hierarchy = random_system(d, 3000, 46)
    state = np.random.get_state()[1].tobytes()  # noqa: NPY002
    again = multigrid(inner)
    first, second = (solve_columns(h, right, 1e-2, 100)[0] for h in (hierarchy, again))
    assert first.tobytes() == second.tobytes()
    assert np.random.get_state()[1].tobytes() == state  # noqa: NPY002


def test_too_few_iterations_are_reported(d):
    points, cells = lattice(d, {2: 40, 3: 14}[d])
    _, _, inner, _ = matrices(points, cells, np.ones(len(cells)))
    right = np.random.default_rng(42).normal(size=(inner.shape[0], 1))
    with pytest.warns(NotConvergedWarning, match="relative residual.* expected at most 1.0e-11"):
        solve_amg(inner, right, 1e-12, iterations=1)


def test_a_tenth_of_a_step_needs_no_exact_solution(d):
    points, cells, exact = wavy(d, {2: 48, 3: 14}[d])
    topology = topology_of(points, cells)
    least = energy(exact, cells)
    gaps = []
    for solver in ("direct", "amg"):
        x = points
        for _ in range(3):
            x, _ = global_step(x, topology, boundary_rule=False, linear_solver=solver)
        gaps.append(energy(x, cells) - least)
    assert gaps[1] == pytest.approx(gaps[0], rel=0.05)


def test_solver_by_name_and_size():
    assert choose_solve("auto", 10) is solve_direct
    assert choose_solve("auto", 10**6) is solve_amg
    assert choose_solve("amg", 10) is solve_amg
    assert choose_solve("direct", 10**6) is solve_direct
    with pytest.raises(InvalidOptionError, match="'cholesky'"):
        choose_solve("cholesky", 10)


def test_both_solvers_take_the_same_step(d):
    points, cells = jittered(d, 5, 43)
    topology = topology_of(points, cells)
    direct, one = global_step(points, topology, linear_solver="direct")
    amg, two = global_step(points, topology, linear_solver="amg")
    assert amg == pytest.approx(direct, abs=1e-11)
    assert one.alpha == pytest.approx(two.alpha, rel=1e-9)


def test_line_search_halves_until_the_energy_falls(d):
    points, cells = jittered(d, 4, 44, 0.2)
    topology = topology_of(points, cells)
    ones = np.ones(len(cells))
    direction = global_direction(points, topology, ones, solve_direct, boundary_rule=False)

    def value(x):
        return energy(x, cells)

    same, stats = line_search(points, topology, -direction, value)
    assert np.array_equal(same, points)
    assert stats.alpha == stats.moved == 0
    new, stats = line_search(points, topology, 32.0 * direction, value)
    assert stats.alpha <= 0.25
    assert value(new) < value(points)
    free, stats = line_search(points, topology, direction, None)
    assert stats.alpha == 1.0
    assert free[topology.movable] == pytest.approx((points + direction)[topology.movable])


@given(meshes(), SEEDS, st.sampled_from(["odt", "cpt"]), st.booleans())
def test_step_gradient_is_the_pull_of_the_centers(mesh, seed, method, rule):
    points, cells = mesh
    rho_tau = np.random.default_rng(seed).uniform(0.1, 10, len(cells))
    topology = topology_of(points, cells)
    slow = np.zeros_like(points)
    for c, cell in enumerate(cells):
        x = points[cell]
        central = method == "cpt" or (rule and topology.is_boundary[cell].any())
        center = x.mean(axis=0) if central else ref.circumcenter(x)
        slow[cell] += 2 / len(cell) * rho_tau[c] * ref.volume(x) * (x - center)
    fast = step_gradient(points, topology, rho_tau, method, rule)
    assert fast == pytest.approx(slow, abs=1e-9 * np.abs(slow).max())


@given(meshes(), SEEDS)
def test_frozen_energy_is_the_energy(mesh, seed):
    points, cells = mesh
    rho_tau = np.random.default_rng(seed).uniform(0.1, 10, len(cells))
    assert frozen_energy(points, cells, rho_tau) == pytest.approx(energy(points, cells, rho_tau))


@pytest.mark.parametrize("least", [0.3, 1.0, 1.9])
def test_first_alpha_is_where_a_parabola_is_least(d, least):
    points = np.random.default_rng(47).random((20, d))
    direction = np.ones_like(points)

    def value(x):
        return ((x - points - least) ** 2).sum()

    assert least_alpha(points, direction, value) == pytest.approx(least)
    assert least_alpha(points, direction, lambda x: -value(x)) == 1.0
    assert least_alpha(points, direction / 9, value) == LONGEST


def test_the_first_alpha_gains_most_of_what_a_step_can(d):
    points, cells, _ = wavy(d, {2: 16, 3: 10}[d])
    topology = topology_of(points, cells)
    start = energy(points, cells)
    new, stats = global_step(points, topology, boundary_rule=False)
    direction = (new - points) / stats.alpha
    gains = [start - energy(points + a * direction, cells) for a in np.linspace(0.05, 1.5, 30)]
    assert start - energy(new, cells) > 0.98 * max(gains)
    assert start - energy(points + 0.5 * stats.alpha * direction, cells) < 0.95 * max(gains)


def refine(values, d, n):
    """Values on the lattice of n^d cubes, interpolated on that of (2n)^d along Kuhn edges."""
    grid = values.reshape((n + 1,) * d + (-1,))
    fine = np.array(list(product(range(2 * n + 1), repeat=d)))
    below, above = tuple((fine // 2).T), tuple(((fine + 1) // 2).T)
    return 0.5 * (grid[below] + grid[above])


def bent(points):
    """A smooth map of the cube that spaces its boundary unevenly."""
    return points + 0.12 * np.sin(np.pi * points) * points[:, ::-1]


def converge(points, cells, steps):
    topology = topology_of(points, cells)
    for _ in range(steps):
        points, _ = global_step(points, topology, boundary_rule=False)
    return points, energy(points, cells)


def test_coarse_solve_then_a_few_fine_steps(d):
    n = {2: 6, 3: 3}[d]
    coarse, coarse_cells = lattice(d, n)
    fine, fine_cells = lattice(d, 2 * n)
    assert refine(coarse, d, n) == pytest.approx(fine, abs=1e-15)
    rng = np.random.default_rng(45)
    inside = ~boundary_vertices(coarse_cells, len(coarse))
    start = bent(coarse)
    start[inside] += rng.uniform(-0.3, 0.3, (inside.sum(), d)) / n
    solved, _ = converge(start, coarse_cells, 10)
    two_grid, reached = converge(refine(solved, d, n), fine_cells, 3)
    _, from_scratch = converge(refine(start, d, n), fine_cells, 3)
    _, best = converge(two_grid, fine_cells, 60)
    assert reached - best < 0.3 * (from_scratch - best)
    assert reached == pytest.approx(best, rel=5e-3)
