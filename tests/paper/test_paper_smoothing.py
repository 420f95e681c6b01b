"""Local smoothing: fixed points, guarded moves, rules at the boundary."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import reference as ref
from hypothesis import given
from hypothesis import strategies as st
from strategies import (
    SCALES,
    SEEDS,
    circular_star,
    jittered,
    lattice,
    meshes,
    positive,
    random_delaunay,
    rotation,
)

from odt_plugins.engine.cells.geometry import boundary_vertices
from odt_plugins.engine.odt.cvt import cvt_step, dual_cells
from odt_plugins.engine.odt.density import make_density, size_field
from odt_plugins.engine.odt.descent import lbfgs_step, richardson_step
from odt_plugins.engine.odt.energy import energy
from odt_plugins.engine.odt.global_step import global_step
from odt_plugins.engine.odt.sweeps import (
    HALVINGS,
    THIN,
    gauss_seidel_sweep,
    guarded_move,
    jacobi_sweep,
)
from odt_plugins.engine.topology import coloring
from odt_plugins.engine.topology.stencil import make_topology

METHODS = st.sampled_from(["odt", "cpt", "laplacian"])
STEPS = (gauss_seidel_sweep, jacobi_sweep, global_step, richardson_step, lbfgs_step, cvt_step)


def topology_of(points, cells):
    near = boundary_vertices(cells, len(points))
    return make_topology(cells, ~near, near)


def run(step, points, topology, times):
    values = [energy(points, topology.cells)]
    for _ in range(times):
        points, _ = step(points, topology)
        values.append(energy(points, topology.cells))
    return points, np.array(values)


def plain_gauss_seidel(points, topology):
    return gauss_seidel_sweep(points, topology, boundary_rule=False)


def plain_jacobi(points, topology):
    return jacobi_sweep(points, topology, boundary_rule=False)


def plain_global(points, topology):
    return global_step(points, topology, boundary_rule=False)


@pytest.mark.parametrize(
    ("step", "times"),
    [(plain_jacobi, 400), (richardson_step, 400), (plain_global, 100), (lbfgs_step, 12)],
)
def test_all_solvers_have_one_fixed_point(step, times, d):
    points, cells = jittered(d, 3 if d == 3 else 5, 3, 0.15)
    topology = topology_of(points, cells)
    best, _ = run(plain_gauss_seidel, points, topology, 300)
    other, values = run(step, points, topology, times)
    assert np.abs(best - points).max() > 1e-3
    assert other == pytest.approx(best, abs=2e-6)
    assert values[-1] == pytest.approx(energy(best, cells), rel=1e-10)


@given(meshes())
def test_energy_falls_in_every_gauss_seidel_sweep(mesh):
    points, cells = mesh
    _, values = run(plain_gauss_seidel, points, topology_of(points, cells), 6)
    assert np.all(np.diff(values) <= 1e-14 * values[0])
    assert values[1] < values[0]


@pytest.mark.parametrize("step", [richardson_step, global_step, lbfgs_step])
def test_energy_falls_in_every_whole_mesh_step(step, d):
    points, cells = random_delaunay(d, 40, 7)
    _, values = run(step, points, topology_of(points, cells), 4)
    assert np.all(np.diff(values) <= 0.0)
    assert values[1] < values[0]


@given(meshes(), METHODS, st.booleans(), st.booleans(), SEEDS)
def test_sweep_equals_the_loop(mesh, method, inverse_volume, rule, seed):
    points, cells = mesh
    topology = topology_of(points, cells)
    rho = np.random.default_rng(seed).uniform(0.5, 2.0, len(points))
    new, stats = gauss_seidel_sweep(
        points, topology, rho, method=method, inverse_volume=inverse_volume, boundary_rule=rule
    )
    slow = points.copy()
    near = topology.boundary_cells & rule
    reduced = 0
    for i in topology.coloring.order:
        goal = ref.target(slow, cells, i, rho, method, near, inverse_volume)
        slow[i], alpha = ref.move(slow, cells, i, goal, THIN, HALVINGS)
        reduced += alpha < 1.0
    assert new == pytest.approx(slow, abs=1e-7)
    assert stats.reduced == reduced
    assert stats.moved <= topology.movable.sum()


@given(meshes(), METHODS, st.booleans(), SEEDS, SCALES)
def test_nothing_ever_inverts(mesh, method, inverse_volume, seed, scale):
    points, cells = mesh
    points = points * scale
    topology = topology_of(points, cells)
    rho = np.random.default_rng(seed).uniform(0.01, 100.0, len(points))
    for step in (gauss_seidel_sweep, jacobi_sweep):
        new, _ = step(points, topology, rho, method=method, inverse_volume=inverse_volume)
        assert ref.volumes(new / scale, cells).min() > 0.0
        assert np.array_equal(new[~topology.movable], points[~topology.movable])


def test_a_star_that_needs_a_shorter_step(d):
    points, cells = random_delaunay(d, 60, 5)
    topology = topology_of(points, cells)
    wild = np.random.default_rng(6).uniform(1e-6, 1e6, len(points))
    new, stats = gauss_seidel_sweep(points, topology, wild, method="cpt", omega=4.0)
    assert stats.reduced > 0
    assert ref.volumes(new, cells).min() > 0.0


@pytest.mark.parametrize(("rest", "alpha"), [(0.1 * THIN, 0.5), (10.0 * THIN, 1.0)])
def test_no_cell_is_pressed_flat(d, rest, alpha):
    """A vertex amid +-e_k, sent towards the facet sum x = 1, of which the share rest is left."""
    facets = np.array(list(product(*[(2 * k, 2 * k + 1) for k in range(d)])))
    points = np.zeros((2 * d + 1, d))
    points[0 : 2 * d : 2], points[1 : 2 * d : 2] = np.eye(d), -np.eye(d)
    points[-1] = -0.1 / d
    cells = positive(points, np.column_stack([facets, np.full(2**d, 2 * d)]).astype(np.int32))
    movable = np.arange(2 * d + 1) == 2 * d
    topology = make_topology(cells, movable, ~movable)
    omega = 1.0 + 10.0 * (1.0 - rest)
    new, stats = gauss_seidel_sweep(points, topology, method="laplacian", omega=omega)
    assert new[-1] == pytest.approx((1.0 - alpha * omega) * points[-1], rel=1e-12)
    assert stats.reduced == (alpha < 1.0)


def test_guarded_move_keeps_every_cell(d):
    points, cells = jittered(d, 4, 17)
    topology = topology_of(points, cells)
    wild = np.random.default_rng(18).normal(size=points.shape) * 0.4
    assert ref.volumes(points + wild, cells).min() < 0.0
    new, reduced = guarded_move(points, topology, wild)
    assert 0 < reduced <= topology.movable.sum()
    assert ref.volumes(new, cells).min() > 0.0
    small = 1e-4 * wild
    new, reduced = guarded_move(points, topology, small)
    assert reduced == 0
    assert np.array_equal(new[topology.movable], (points + small)[topology.movable])


@given(meshes(), METHODS, SEEDS)
def test_sweep_turns_and_scales_with_the_mesh(mesh, method, seed):
    points, cells = mesh
    d = points.shape[1]
    turn, shift = rotation(d, seed), np.arange(1.0, d + 1.0)
    topology = topology_of(points, cells)
    new, _ = gauss_seidel_sweep(points, topology, method=method)
    turned, _ = gauss_seidel_sweep(4.0 * points @ turn.T + shift, topology, method=method)
    assert turned == pytest.approx(4.0 * new @ turn.T + shift, abs=1e-7)


def test_threads_do_not_change_a_bit(d, monkeypatch, many_blocks):
    monkeypatch.setattr(coloring, "SMALLEST_BITS", 2)
    points, cells = jittered(d, {2: 20, 3: 8}[d], 19)
    topology = topology_of(points, cells)
    assert np.diff(topology.coloring.offsets).max() > 5
    for step in (gauss_seidel_sweep, jacobi_sweep):
        one, stats = step(points, topology)
        for count in (2, 3):
            many, same = step(points, topology, threads=count)
            assert np.array_equal(one, many)
            assert same == stats


def test_callers_arrays_stay(d):
    points, cells = jittered(d, 3, 20)
    before = points.copy()
    topology = topology_of(points, cells)
    for step in STEPS:
        new, stats = step(points, topology)
        assert stats.moved > 0
        assert np.array_equal(points, before)
        assert not np.shares_memory(new, points)


def test_nothing_movable_gives_the_points_back(d):
    points, cells = jittered(d, 3, 20)
    near = boundary_vertices(cells, len(points))
    topology = make_topology(cells, np.zeros_like(near), near)
    for step in STEPS:
        new, stats = step(points, topology)
        assert np.array_equal(new, points)
        assert stats.moved == 0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_barycenters_keep_a_vertex_off_the_boundary(d, seed):
    points, cells = circular_star(d, seed)
    movable = np.zeros(len(points), dtype=bool)
    movable[-1] = True
    near = np.zeros(len(points), dtype=bool)
    near[:d] = True
    height = points[0, -1]
    topology = make_topology(cells, movable, near)
    without, with_rule = points, points
    for _ in range(30):
        without, _ = gauss_seidel_sweep(without, topology, boundary_rule=False)
        with_rule, _ = gauss_seidel_sweep(with_rule, topology)
    assert without[-1] == pytest.approx(np.zeros(d), abs=1e-6)
    assert height - with_rule[-1, -1] > 2.0 * (height - without[-1, -1])


def test_boundary_cells_hold_a_boundary_vertex(d):
    points, cells = jittered(d, 4, 23)
    topology = topology_of(points, cells)
    expected = [any(topology.is_boundary[i] for i in cell) for cell in cells]
    assert topology.boundary_cells.tolist() == expected
    assert 0 < sum(expected) < len(cells)


@given(meshes())
def test_cpt_stops_at_patch_centroids(mesh):
    points, cells = mesh
    topology = topology_of(points, cells)
    ones, none = np.ones(len(points)), np.zeros(len(cells))
    new, _ = jacobi_sweep(points, topology, method="cpt", omega=1e-3)
    for i in np.flatnonzero(topology.movable)[::7]:
        centroid = ref.target(points, cells, i, ones, "cpt", none, False)
        assert new[i] - points[i] == pytest.approx(1e-3 * (centroid - points[i]), abs=1e-15)


def test_centroidal_patches_do_not_move(d):
    points, cells = jittered(d, 4, 24, 0.2)
    topology = topology_of(points, cells)
    for _ in range(300):
        points, stats = gauss_seidel_sweep(points, topology, method="cpt")
    assert stats.max_move < 1e-12
    ones, none = np.ones(len(points)), np.zeros(len(cells))
    for i in np.flatnonzero(topology.movable):
        centroid = ref.target(points, cells, i, ones, "cpt", none, False)
        assert points[i] == pytest.approx(centroid, abs=1e-12)


@given(st.sampled_from([2, 3]), SEEDS)
def test_barycenters_need_no_shorter_step_in_convex_stars(d, seed):
    points, cells = jittered(d, 4, seed, 0.15)
    _, stats = gauss_seidel_sweep(points, topology_of(points, cells), method="cpt")
    assert stats.reduced == 0


def test_laplacian_is_over_relaxed_cpt_in_the_plane_only(d):
    points, cells = jittered(d, 4, 25, 0.1)
    topology = topology_of(points, cells)
    laplace, one = jacobi_sweep(points, topology, method="laplacian", omega=1.0)
    cpt, two = jacobi_sweep(points, topology, method="cpt", inverse_volume=True, omega=1.5)
    assert one.reduced == two.reduced == 0
    if d == 2:
        assert laplace == pytest.approx(cpt, abs=1e-14)
    else:
        assert np.abs(laplace - cpt).max() > 1e-4


def graded(d):
    """Lattice pressed towards one side: cell widths grow by a factor of 8 or so."""
    points, cells = lattice(d, 12 if d == 2 else 8)
    points[:, 0] = (np.exp(2.2 * points[:, 0]) - 1) / (np.exp(2.2) - 1)
    return points, cells


@pytest.mark.parametrize("method", ["odt", "cpt"])
def test_density_keeping_keeps_sizes(d, method):
    points, cells = graded(d)
    topology = topology_of(points, cells)
    start = np.log(size_field(points, cells))
    keep = make_density("keep", None, points, cells)
    change = {}
    for name in ("uniform", "inverse-volume", "keep"):
        new = points
        for _ in range(20):
            rho = keep.at(new) if name == "keep" else None
            new, _ = gauss_seidel_sweep(
                new, topology, rho, method=method, inverse_volume=name == "inverse-volume"
            )
        ratio = (np.log(size_field(new, cells)) - start)[topology.movable]
        change[name] = np.std(ratio)
    assert change["uniform"] > 0.05
    assert change["inverse-volume"] < 0.75 * change["uniform"]
    assert change["keep"] < 0.6 * change["uniform"]


def test_every_cell_counts_the_same(d):
    points, cells = jittered(d, 3, 27)
    topology = topology_of(points, cells)
    a, _ = gauss_seidel_sweep(points, topology, inverse_volume=True)
    rho = np.random.default_rng(28).uniform(0.1, 10, len(points))
    b, _ = gauss_seidel_sweep(points, topology, rho, inverse_volume=True)
    assert np.array_equal(a, b)


def test_remark48_dual_cells_are_voronoi_regions(d):
    """Monte Carlo: share of the points that are nearest to an interior vertex, and their mean."""
    points, cells = random_delaunay(d, 60, 29)
    mass, offset = dual_cells(points, cells, np.ones(len(cells)))
    i = int(np.argmin(np.linalg.norm(points, axis=1)))
    near = points[np.unique(cells[ref.star(cells, i)])]
    low, high = near.min(axis=0), near.max(axis=0)
    sample = np.random.default_rng(30).uniform(low, high, (60_000, d))
    nearest = np.argmin(((sample[:, None] - near) ** 2).sum(axis=2), axis=1)
    mine = sample[nearest == np.flatnonzero((near == points[i]).all(axis=1))[0]]
    volume = np.prod(high - low) * len(mine) / len(sample)
    assert mass[i] == pytest.approx(volume, rel=0.05)
    size = volume ** (1 / d)
    assert points[i] + offset[i] / mass[i] == pytest.approx(mine.mean(axis=0), abs=0.03 * size)


def test_remark48_dual_cells_fill_the_mesh(d):
    points, cells = jittered(d, 3, 31)
    mass, _ = dual_cells(points, cells, np.ones(len(cells)))
    assert mass.sum() == pytest.approx(1.0, rel=1e-12)
    new, stats = cvt_step(points, topology_of(points, cells))
    assert stats.moved > 0
    assert ref.volumes(new, cells).min() > 0.0
