"""The engine as a whole: the promise, its figures, the same bits, options, and giving up."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest
import tet_meshes as tm
from hypothesis import given
from hypothesis import strategies as st
from measure.meshes import kuhn_lattice
from policies import set_policy
from promises import assert_promise, measure, mesh_of, planar, volumes
from scipy.spatial import Delaunay

from odt_plugins.engine.compiled import threads
from odt_plugins.engine.finish.phases import Descent, worst_cells
from odt_plugins.engine.odt.density import NodalDensity, cell_density
from odt_plugins.engine.odt.energy import energy
from odt_plugins.engine.odt.rounds import Log
from odt_plugins.engine.odt.total_energy import total_energy
from odt_plugins.engine.record.figures import figures
from odt_plugins.engine.record.memory import Memory
from odt_plugins.engine.run import plan, stages, work
from odt_plugins.engine.run.plan import run
from odt_plugins.engine.run.within import Within
from odt_plugins.engine.run.work import make_start
from odt_plugins.engine.topology import order
from odt_plugins.engine.topology.frame import Frame
from odt_plugins.mesh.simplex import simplex_mesh
from odt_plugins.options import FIGURES, Options

DATA = Path(__file__).parents[2] / "data"


def start(d, seed=5):
    return mesh_of(*(planar(seed) if d == 2 else tm.ball(500, seed)))


def test_default_is_much_better(d):
    mesh = start(d)
    outcome = run(mesh, Options())
    assert_promise(mesh, outcome)
    before, after = measure(mesh.points, mesh.cells), measure(outcome.points, outcome.cells)
    assert after[2] > before[2] + 0.1
    assert after[1] > 1.2 * before[1]
    assert outcome.fallback is None
    assert outcome.stop_reason
    assert set(outcome.times) >= {"prepare", "smoothing", "finishing", "check"}


@pytest.mark.parametrize("method", ["odt", "cpt", "laplacian", "cvt"])
@pytest.mark.parametrize("finish", [True, False])
def test_methods(d, method, finish):
    mesh = start(d)
    outcome = run(mesh, Options(method=method, finish=finish, smoothing={"rounds": 4}))
    assert_promise(mesh, outcome)
    assert finish == (measure(outcome.points, outcome.cells)[2] >
                      measure(mesh.points, mesh.cells)[2] + 0.1) or not finish


@pytest.mark.parametrize(
    ("solver", "linear_solver"),
    [("jacobi", "auto"), ("richardson", "auto"), ("lbfgs", "auto"), ("global", "direct"),
     ("global", "amg")],
)
def test_solvers(d, solver, linear_solver):
    mesh = start(d)
    outcome = run(mesh, Options(smoothing={"solver": solver, "linear_solver": linear_solver,
                                           "rounds": 3, "cycles": 1}))
    assert_promise(mesh, outcome)
    assert outcome.fallback is None


@pytest.mark.parametrize("connectivity", ["delaunay", "flips", "none", "auto"])
def test_connectivity(d, connectivity):
    mesh = start(d)
    outcome = run(mesh, Options(finish=False, smoothing={"rounds": 5, "connectivity": connectivity},
                                keep=()))
    assert_promise(mesh, outcome, keep=False)
    same = {frozenset(c) for c in outcome.cells.tolist()} == {
        frozenset(c) for c in mesh.cells.tolist()
    }
    assert same == (connectivity == "none")
    assert ("delaunay calls" in outcome.counts) == (connectivity in ("delaunay", "auto"))


def test_the_energy_falls_in_every_round_where_cells_stay(d):
    outcome = run(start(d), Options(finish=False, smoothing={"rounds": 5, "connectivity": "none"},
                                    keep=()))
    energies = [value for _, value in outcome.energy]
    assert len(energies) == 5
    assert energies == sorted(energies, reverse=True)


@pytest.mark.parametrize("objective", ["radius_ratio", "min_dihedral", "time_step"])
@pytest.mark.parametrize(("d", "boundary"), [(2, "fixed"), (3, "fixed"), (3, "slide")])
def test_without_connectivity_finishing_moves_vertices_alone(d, boundary, objective):
    mesh = start(d)
    outcome = run(mesh, Options(smoothing={"connectivity": "none"}, boundary=boundary,
                                objective=objective))
    assert {frozenset(c) for c in outcome.cells.tolist()} == {
        frozenset(c) for c in mesh.cells.tolist()}
    assert (outcome.points != mesh.points).any()
    assert not outcome.counts.get("quality flips", 0)
    assert outcome.counts["vertex moves"] > 0


def test_scipy_early_and_flips_late(d):
    mesh = start(d)
    outcome = run(mesh, Options(finish=False, smoothing={"rounds": 8, "connectivity": "auto"},
                                keep=()))
    assert outcome.counts["delaunay calls"] == 1
    assert outcome.counts["energy flips"] > 0


def test_scipy_is_asked_where_cells_are_poor():
    points, cells = kuhn_lattice(11)
    inner = ((points > 0) & (points < 11)).all(axis=1)
    points = points + 0.15 * inner[:, None] * np.sin(7.0 * points + np.arange(3) * points[:, :1])
    options = Options(finish=False, smoothing={"rounds": 1}, keep=())
    for height, asked in ((1.0, False), (0.4, True)):
        mesh = simplex_mesh(points * [1.0, 1.0, height], cells)[0]
        assert ("delaunay calls" in run(mesh, options).counts) == asked


@pytest.mark.parametrize(
    "density", ["keep", "uniform", "inverse-volume", "vertices", "cells", "function"]
)
def test_densities(d, density):
    mesh = start(d)
    spec = {
        "vertices": 1.0 + mesh.points[:, 0] ** 2,
        "cells": 1.0 + mesh.points[mesh.cells].mean(axis=1)[:, 0] ** 2,
        "function": lambda x: 1.0 + x[:, 0] ** 2,
    }.get(density, density)
    outcome = run(mesh, Options(density=spec, smoothing={"rounds": 5}))
    assert_promise(mesh, outcome)
    assert outcome.fallback is None


def test_a_density_function_sees_the_callers_coordinates(d):
    mesh = start(d)
    shifted = replace(mesh, points=mesh.points * 1000.0 + 5000.0)
    seen = []

    def density(x):
        seen.append((x.min(axis=0), x.max(axis=0)))
        return np.ones(len(x))

    run(shifted, Options(density=density, smoothing={"rounds": 2, "cycles": 1}))
    low = np.min([a for a, _ in seen], axis=0)
    high = np.max([b for _, b in seen], axis=0)
    assert low == pytest.approx(shifted.points.min(axis=0), rel=1e-12)
    assert high == pytest.approx(shifted.points.max(axis=0), rel=1e-12)


def test_regions_fixed_vertices_and_frozen_cells_stay(d):
    base = start(d)
    center = base.points[base.cells].mean(axis=1)
    middle = np.median(center, axis=0)
    rng = np.random.default_rng(2)
    fixed = rng.random(len(base.points)) < 0.1
    frozen = np.linalg.norm(center - middle, axis=1) < 0.2 * np.ptp(base.points)
    labels = (center[:, 0] > middle[0]).astype(np.int32)
    mesh = replace(base, regions=labels, fixed=fixed, frozen=frozen)
    outcome = run(mesh, Options())
    assert_promise(mesh, outcome)
    kept = {tuple(sorted(c)) for c in outcome.cells.tolist()}
    assert {tuple(sorted(c)) for c in mesh.cells[frozen].tolist()} <= kept
    held = np.unique(mesh.cells[frozen])
    assert outcome.points[held].tobytes() == mesh.points[held].tobytes()
    assert measure(outcome.points, outcome.cells)[2] > measure(mesh.points, mesh.cells)[2]


def test_everything_frozen_or_fixed_comes_back_byte_identical(d):
    base = start(d)
    for mesh in (
        replace(base, frozen=np.ones(len(base.cells), dtype=bool)),
        replace(base, fixed=np.ones(len(base.points), dtype=bool)),
    ):
        outcome = run(mesh, Options(smoothing={"connectivity": "none"}, finish=False))
        assert outcome.points.tobytes() == mesh.points.tobytes()
        assert_promise(mesh, outcome)


def test_same_bits_for_any_number_of_threads(d, monkeypatch, many_blocks):
    monkeypatch.setattr(threads, "PART", 100)
    monkeypatch.setattr(order, "LAYERS", 3)
    points, cells = planar(6, 40) if d == 2 else tm.ball(500, 6)
    mesh = mesh_of(points, cells)
    first = run(mesh, Options(smoothing={"rounds": 3, "cycles": 1}))
    for count in (2, 3):
        other = run(mesh, Options(smoothing={"rounds": 3, "cycles": 1}, threads=count))
        assert other.points.tobytes() == first.points.tobytes()
        assert other.cells.tobytes() == first.cells.tobytes()


@pytest.mark.parametrize("scale", [2.0**-30, 2.0**30])
def test_scale_by_a_power_of_two_changes_no_bit(d, scale):
    mesh = start(d)
    options = Options(smoothing={"rounds": 3, "cycles": 1})
    first = run(mesh, options)
    second = run(replace(mesh, points=mesh.points * scale), options)
    assert (second.points / scale).tobytes() == first.points.tobytes()
    assert second.cells.tobytes() == first.cells.tobytes()


@pytest.mark.parametrize(("scale", "shift"), [(1e-9, 0.0), (1e9, 0.0), (1.0, 1e6), (1e-9, 1e-3)])
def test_scaled_and_shifted_meshes_keep_the_promise(d, scale, shift):
    mesh = start(d)
    moved = replace(mesh, points=mesh.points * scale + shift)
    if (volumes(moved.points, moved.cells) <= 0).any():
        pytest.fail("the shift destroyed the start mesh")
    outcome = run(moved, Options(smoothing={"rounds": 5}))
    assert_promise(moved, outcome)
    assert outcome.fallback is None
    gain = measure(outcome.points, outcome.cells)[2] - measure(moved.points, moved.cells)[2]
    assert gain > 0.1


def test_an_optimum_comes_back_unchanged(d):
    mesh = start(d)
    points = mesh.points
    cells = mesh.cells
    for _ in range(12):
        outcome = run(mesh_of(points, cells), Options())
        done = outcome.points.tobytes() == points.tobytes()
        points, cells = outcome.points, outcome.cells
        if done:
            break
    equilateral = equilateral_patch() if d == 2 else None
    if equilateral is not None:
        best = mesh_of(*equilateral)
        outcome = run(best, Options())
        assert outcome.points.tobytes() == best.points.tobytes()
        assert np.array_equal(outcome.cells, best.cells)
    single = mesh_of(points[cells[0]], np.arange(d + 1)[None])
    outcome = run(single, Options())
    assert outcome.points.tobytes() == single.points.tobytes()
    assert np.array_equal(outcome.cells, single.cells)
    assert outcome.fallback is None
    assert outcome.stop_reason.startswith("nothing could be improved (")


def test_energy_in_one_pass_equals_the_formula(d):
    mesh = start(d)
    rho = 1.0 + mesh.points[:, 0] ** 2
    expected = energy(mesh.points, mesh.cells, cell_density(mesh.cells, rho))
    assert total_energy(mesh.points, mesh.cells, rho) == pytest.approx(expected, rel=1e-12)


def equilateral_patch(n=6):
    points = np.array([(i + 0.5 * j, j * np.sqrt(0.75)) for j in range(n) for i in range(n)])
    cells = []
    for j in range(n - 1):
        for i in range(n - 1):
            a = j * n + i
            cells += [(a, a + 1, a + n), (a + 1, a + n + 1, a + n)]
    return points, np.array(cells)


def test_cycles_go_on_while_the_mean_gains():
    assert stages.settled([0.8]) == ""
    assert stages.settled([0.8, 0.8006]) == ""
    assert "after 2 cycles" in stages.settled([0.8, 0.8004])
    assert "after 3 cycles" in stages.settled([0.8, 0.81, 0.8104])
    assert stages.settled([0.8, 0.79, 0.8006]) == ""


def test_sizes_come_back_for_the_places_where_the_vertices_are_now(d):
    mesh = start(d, 7)
    points = 1000.0 + 37.0 * np.concatenate([mesh.points[:1], mesh.points])
    frozen = np.arange(len(mesh.cells)) % 50 == 0
    mesh = replace(mesh, points=points, cells=mesh.cells + np.int32(1), frozen=frozen,
                   fixed=np.concatenate([[False], mesh.fixed]))
    values = points @ np.arange(1.0, d + 1.0)
    outcome = run(mesh, Options(density=NodalDensity(values, -1.0)))
    moved = (outcome.points != points).any(axis=1)
    assert moved.sum() > 3
    wrong = np.abs(outcome.sizes / (outcome.points @ np.arange(1.0, d + 1.0)) - 1.0) > 1e-13
    # The search for a vertex can end at a hollow of the boundary that lies between.
    assert wrong[moved].mean() < 0.01
    assert np.array_equal(outcome.sizes[~moved], values[~moved])
    assert run(mesh, Options()).sizes is None


def test_a_run_that_gains_nothing_says_so_when_finishing_alone_gains(monkeypatch):
    monkeypatch.setattr(plan, "in_cycles", lambda mesh, _: (mesh, "left out"))
    monkeypatch.setattr(plan, "worst_cells", lambda *_: None)
    outcome = run(start(3), Options())
    assert outcome.fallback == "a later state was given up (no better than the input)"


def test_a_state_that_breaks_the_promise_is_never_returned(d, monkeypatch):
    mesh = start(d)

    def wreck(complex_, phases, bounds, pool, threads):
        free = np.flatnonzero(~complex_.locked)
        complex_.points[free] = complex_.points[free].mean(axis=0)
        return 0, 0

    monkeypatch.setattr(work, "finish", wreck)
    outcome = run(mesh, Options())
    assert outcome.points.tobytes() == mesh.points.tobytes()
    assert np.array_equal(outcome.cells, mesh.cells)
    assert outcome.fallback is not None
    assert "input is returned" in outcome.fallback


def test_a_fault_that_the_kernels_do_not_see_is_caught_by_the_judge(d, monkeypatch):
    mesh = start(d)
    real = Frame.outside

    def shaken(self, points):
        moved = real(self, points)
        moved[len(moved) // 2] += 10.0 * np.ptp(mesh.points)
        return moved

    monkeypatch.setattr(Frame, "outside", shaken)
    outcome = run(mesh, Options())
    assert outcome.points.tobytes() == mesh.points.tobytes()
    assert "input is returned" in outcome.fallback


@pytest.mark.parametrize(("which", "repairs"), [(0, 1), (0, 0), (1, 0)])
def test_a_few_cells_beyond_the_extremes_are_repaired(which, repairs, monkeypatch):
    """TetWild meshes with a size field whose angles are good: sweeps make some of them smaller.

    They are regained by the phases for the worst cells, and repaired without these.
    """
    if repairs:
        monkeypatch.setattr(stages, "descents", lambda dim, objective: (Descent(()),))
    with np.load(DATA / "graded.npz") as data:
        points, cells = data[f"points{which}"], data[f"cells{which}"]
    mesh = mesh_of(points, cells)
    outcome = run(mesh, Options())
    assert outcome.fallback is None
    assert outcome.counts.get("repairs", 0) >= repairs
    assert tm.quality(outcome.points, outcome.cells).mean() > 0.85
    old, new = tm.dihedral_angles(points, cells), tm.dihedral_angles(outcome.points, outcome.cells)
    assert new.min() >= old.min()
    assert new.max() <= old.max()


def test_literal_method_falls_back_when_it_spoils_the_mesh(d):
    good = run(start(d), Options())
    mesh = mesh_of(good.points, good.cells)
    outcome = run(mesh, Options(finish=False, smoothing={"rounds": 6}, density="uniform"))
    assert_promise(mesh, outcome)


@pytest.mark.parametrize("method", ["odt", "cpt", "laplacian"])
def test_smoothing_alone_moves_what_it_may(d, method):
    mesh = start(d)
    options = Options(method=method, finish=False, smoothing={"rounds": 3, "connectivity": "none"},
                      keep=("min_quality", "min_angle", "max_angle"))
    outcome = run(mesh, options)
    before, after = measure(mesh.points, mesh.cells), measure(outcome.points, outcome.cells)
    assert outcome.fallback is None
    assert (outcome.points != mesh.points).any(axis=1).sum() > 20
    assert (after[[0, 3, 4]] >= before[[0, 3, 4]] - 1e-7 * np.abs(before[[0, 3, 4]])).all()


def test_the_input_is_not_touched(d):
    mesh = start(d)
    copies = mesh.points.copy(), mesh.cells.copy()
    run(mesh, Options(smoothing={"rounds": 3, "cycles": 1}))
    assert np.array_equal(mesh.points, copies[0])
    assert np.array_equal(mesh.cells, copies[1])


def test_progress_runs_from_zero_to_one(d):
    seen = []
    run(start(d), Options(smoothing={"rounds": 4}, progress=lambda stage,
                          share: seen.append((stage, share))))
    shares = [share for _, share in seen]
    assert shares == sorted(shares)
    assert 0 <= shares[0]
    assert shares[-1] == 1.0
    assert {"smoothing", "finishing"} <= {stage for stage, _ in seen}


@pytest.mark.parametrize("dim", [2, 3])
@given(seed=st.integers(0, 10**6), squeeze=st.floats(0.05, 1.0), labels=st.integers(1, 3))
def test_promise_on_random_meshes(dim, seed, squeeze, labels):
    points, cells = planar(seed, 7) if dim == 2 else tm.ball(60, seed)
    points = points * np.array([1.0] * (dim - 1) + [squeeze])
    regions = (seed + np.floor(3 * points[cells].mean(axis=1)[:, 0])).astype(np.int32) % labels
    mesh = mesh_of(points, cells, regions)
    if not (volumes(points, cells) > 0).all():
        return
    assert_promise(mesh, run(mesh, Options(smoothing={"rounds": 6, "cycles": 2})))


def score(points, cells):
    least, few, mean = measure(points, cells)[:3]
    return mean + 0.5 * few + 0.25 * least


def held_ball():
    """No vertex moves, all that is left are flips."""
    points, cells = tm.ball(500, 3)
    return mesh_of(points, cells, fixed=np.ones(len(points), dtype=bool))


def ragged_ball():
    """Cells at the surface that nothing can improve are many."""
    points = np.random.default_rng(7).random((400, 3))
    return mesh_of(points, tm.oriented(points, Delaunay(points).simplices))


@pytest.mark.parametrize(("make", "gain"), [(held_ball, 0.002), (ragged_ball, 0.0)])
def test_finishing_alone_is_tried_too_where_it_may_do_better(make, gain, monkeypatch):
    mesh = make()
    result = run(mesh, Options())
    assert result.counts["runs of finishing alone"] == 1
    set_policy(monkeypatch, plan, few_movable=0.0, poor_quality=0.0)
    plain = run(mesh, Options())
    assert plain.fallback is None
    assert "runs of finishing alone" not in plain.counts
    more = score(result.points, result.cells) - score(plain.points, plain.cells)
    assert more >= gain
    assert result.fallback is None
    assert (more > 0.0) == result.stop_reason.endswith(
        "finishing without smoothing before it gave more"
    )


def test_a_density_that_no_state_could_follow_is_told():
    """All cells at one corner is more than this mesh can do: what tries it is worse than before."""
    stored = meshio.read(DATA / "tetwild_cube.vtu")
    mesh = mesh_of(stored.points, tm.oriented(stored.points, stored.cells[0].data))
    corner = stored.points.min(axis=0)

    def steep(x):
        return np.exp(-40.0 * np.linalg.norm(x - corner, axis=1) / np.ptp(stored.points)) + 1e-9

    told = run(mesh, Options(density=steep))
    assert measure(told.points, told.cells)[2] > measure(mesh.points, mesh.cells)[2] + 0.02
    assert told.stop_reason.endswith("kept the promise, they stay as they were")
    assert "as they were" not in run(mesh, Options(density="uniform")).stop_reason


def test_finishing_alone_is_not_tried_where_sizes_or_nothing_poor_ask_for_it():
    for mesh, options in (
        (ragged_ball(), Options(density="uniform")), (mesh_of(*tm.ball(800, 3)), Options()),
    ):
        assert "runs of finishing alone" not in run(mesh, options).counts


def test_vertices_move_alone_where_any_other_cell_breaks_the_promise(d, monkeypatch):
    mesh = start(d)
    ways = {frozenset(cell) for cell in mesh.cells.tolist()}
    offer = Memory.offer

    def of_the_same_cells(memory, changing, name):
        told = frame.vertices[changing.mesh_arrays()[0]]
        if ways != {frozenset(cell) for cell in told.tolist()}:
            memory.worse = ["mean_quality"]
            return False
        return offer(memory, changing, name)

    frame = make_start(mesh).frame
    monkeypatch.setattr(Memory, "offer", of_the_same_cells)
    outcome = run(mesh, Options())
    assert_promise(mesh, outcome)
    assert "given up (mean_quality would be worse)" in outcome.fallback
    assert outcome.counts["runs of finishing alone"] == 2
    before, after = measure(mesh.points, mesh.cells), measure(outcome.points, outcome.cells)
    assert after[2] > before[2] + 0.01
    assert len(outcome.cells) == len(mesh.cells)
    locked = replace(mesh, fixed=np.ones(len(mesh.points), dtype=bool))
    assert run(locked, Options()).counts["runs of finishing alone"] == 1


def test_bounds_of_a_larger_mesh_take_the_place_of_those_of_its_part():
    points, cells = tm.ball(300, 4)
    mesh = mesh_of(points, cells)
    own = figures(mesh.points, mesh.cells)
    better = replace(own, min_quality=0.2, cos_min_angle=np.cos(np.radians(12.0)),
                     cos_max_angle=np.cos(np.radians(160.0)))
    refused = run(mesh, Options(smoothing={"rounds": 1}, finish=False), within=Within(whole=better))
    assert refused.fallback
    assert np.array_equal(refused.points, mesh.points)
    worse = replace(own, min_quality=0.0, cos_min_angle=1.0, cos_max_angle=-1.0)
    taken = run(mesh, Options(smoothing={"rounds": 8}, finish=False), within=Within(whole=worse))
    assert taken.fallback is None
    assert tm.quality(taken.points, taken.cells).mean() > own.mean_quality + 0.1


def test_stage_1_works_again_only_around_vertices_that_could_not_move():
    mesh = mesh_of(*tm.ball(900, 4))
    fresh = mesh.points[:, 0] > 0.7
    reached = fresh.copy()
    for _ in range(2):
        reached[mesh.cells[reached[mesh.cells].any(axis=1)]] = True
    names = {"bulk", "polish", "after polish", "cautious", "worst"}
    names |= {phase.name for phase in worst_cells()}
    assert not reached.all()
    for new in (fresh, np.zeros_like(fresh)):
        outcome = run(mesh, Options(keep=()), within=Within(without=names, fresh=new))
        moved = (outcome.points != mesh.points).any(axis=1)
        assert moved.any() == new.any()
        assert not moved[~reached].any()


def test_guards_of_a_part_are_shares_of_the_cells_of_the_larger_mesh(monkeypatch):
    seen = []
    monkeypatch.setattr(work, "finish", lambda mesh, phases, *_: seen.extend(phases) or (0, 0))
    for part in (1.0, 0.25, 0.001):
        work.settle(None, worst_cells(), None, Log(), None, 1, part)
    guards = [phase.guard for phase in worst_cells()]
    assert set(guards) == {None, 0.01}
    assert [phase.guard for phase in seen] == [
        guard and most for most in (0.01, 0.04, 1.0) for guard in guards]


def test_cells_that_another_run_looks_after_may_pass_the_extremes_but_not_others():
    points, cells = tm.ball(60, 4)
    mesh = mesh_of(points, cells)
    worst = int(np.argmin(tm.quality(points, cells)))
    others = figures(points, np.delete(cells, worst, axis=0))
    whole = figures(points, cells)
    bound = replace(others, p1_quality=0.0, mean_quality=0.0, small_angles=1.0, score=-1.0)
    keep = FIGURES
    assert whole.worse_than(bound, keep)

    class Still:
        points = mesh.points

        def mesh_arrays(self):
            return mesh.cells, mesh.regions

    at = np.zeros(len(points), dtype=bool)
    for aside, taken in ((None, False), (~at, False), (at | np.isin(
            np.arange(len(points)), cells[worst]), True)):
        memory = Memory(bound, keep, "radius_ratio", by_score=True, aside=aside)
        assert memory.offer(Still(), "x") == taken


def test_finishing_counts_its_flips_and_moves(d):
    mesh = start(d)
    counts = run(mesh, Options(smoothing={"rounds": 0, "cycles": 1})).counts
    assert counts["quality flips"] > 0
    assert counts["vertex moves"] > 0
    assert "energy flips" not in counts


SMOOTHING = Options(finish=False, smoothing={"rounds": 4}, keep=())
"""A run that remembers two states."""


def leaving_spoilt(times, seen):
    """On its way out a mesh loses a vertex to infinity, as often as that."""

    def leave(outcome):
        seen.append(outcome)
        if len(seen) > times:
            return outcome
        points = outcome.points.copy()
        points[outcome.cells[0, 0]] = np.inf
        return replace(outcome, points=points)

    return leave


def test_the_next_best_state_is_taken_where_the_best_does_not_leave_well(d):
    mesh, seen = start(d), []
    plain = run(mesh, SMOOTHING)
    outcome = run(mesh, SMOOTHING, leaving_spoilt(1, seen))
    assert seen[0].points.tobytes() == plain.points.tobytes()
    assert outcome.points.tobytes() == seen[1].points.tobytes() != mesh.points.tobytes()
    assert outcome.fallback.startswith("a later state was given up")
    assert outcome.counts["states refused"] == 1
    assert_promise(mesh, outcome, keep=False)


def test_the_input_is_returned_where_no_state_leaves_well(d):
    mesh, seen = start(d), []
    outcome = run(mesh, SMOOTHING, leaving_spoilt(9, seen))
    assert len(seen) == 2
    assert outcome.points.tobytes() == mesh.points.tobytes()
    assert outcome.fallback.startswith("the input is returned")


def test_no_cell_at_a_cut_is_worse_than_what_was_optimised_before():
    """A cell whose vertices are all held is at the cut for good: no later round sees it."""
    outcome = run(mesh_of(*tm.ball(1500, 7)), Options())
    points, cells = outcome.points, outcome.cells
    cells = cells[np.linalg.norm(points[cells].mean(axis=1), axis=1) < 0.8]
    used = np.unique(cells)
    points, cells = points[used], np.searchsorted(used, cells).astype(np.int32)
    free = tm.interior(points, cells)
    fresh = free & (np.abs(points[:, 0]) < 0.15)
    points[fresh] += 0.014 * np.random.default_rng(2).standard_normal((fresh.sum(), 3))
    assert (tm.signed_volumes(points, cells) > 0).all()
    options = Options(keep=("min_quality", "min_angle", "max_angle"))
    result = run(mesh_of(points, cells), options,
                 within=Within(whole=figures(points, cells), fresh=fresh))
    old = {tuple(cell) for cell in np.sort(cells, axis=1)}
    held = [cell for cell in result.cells[~free[result.cells].any(axis=1)]
            if tuple(np.sort(cell)) not in old]
    good = tm.quality(points, cells[~fresh[cells].any(axis=1)])
    made = tm.quality(result.points, np.array(held, dtype=int).reshape(-1, 4))
    assert (made >= np.quantile(good, 0.01)).all()
    assert tm.quality(result.points, result.cells).mean() > tm.quality(points, cells).mean() + 0.01
