"""Objectives of finishing: descent of each measure, gain in its own figure, promise, options."""

from __future__ import annotations

import json
from copy import deepcopy
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import meshio
import numpy as np
import planar_meshes as pm
import pytest
import tet_meshes as tm
from complexes import FREELY, OPEN, assert_sound, complex_of, contents, run_pass
from measure.hard import CLOUDS, delaunay
from planar_meshes import MEASURES, grid
from promises import assert_promise, mesh_of
from tet_meshes import TWINS, interior

import odt_plugins
from odt_plugins.cli import main as cli
from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Bounds, Extremes
from odt_plugins.engine.cells.measures import DIHEDRAL, MEAN_RATIO, QUALITY, STEP
from odt_plugins.engine.cells.measures import MEASURES as CODES
from odt_plugins.engine.finish import polishing, volume
from odt_plugins.engine.finish.phases import (
    Descent,
    Phase,
    bulk,
    cautious,
    descents,
    polish,
    repair,
    tail,
)
from odt_plugins.engine.finish.plane import finish2d
from odt_plugins.engine.finish.volume import finish, guarded, held_angles
from odt_plugins.engine.moves.flips2d import quality_flips
from odt_plugins.engine.moves.newton3d import smooth_vertices
from odt_plugins.engine.moves.passes import flip_pending
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import amips_energies, figures
from odt_plugins.engine.record.memory import Memory
from odt_plugins.engine.run.plan import run
from odt_plugins.engine.topology.adjacency import cell_neighbors
from odt_plugins.engine.topology.coloring import vertex_coloring
from odt_plugins.engine.topology.star import vertex_stars
from odt_plugins.engine.topology.triangles import Triangles
from odt_plugins.errors import InvalidOptionError
from odt_plugins.figures import cell_figures, summarize
from odt_plugins.options import Options

DATA = Path(__file__).parents[2] / "data"
AIRFOIL = Path(__file__).parents[3] / "examples" / "meshes" / "airfoil.vtu"
OTHERS = ("min_dihedral", "amips", "time_step")
OTHER = pytest.mark.parametrize("measure", [MEAN_RATIO, DIHEDRAL, STEP],
                                ids=["mean ratio", "dihedral", "step"])


def total(points, cells, measure, power):
    """What finishing sums over all cells, by the tests' own code."""
    return float(((1.005 / (TWINS[measure](points, cells) + 0.005)) ** power).sum())


@OTHER
def test_flips_smoothing_and_compound_moves_lower_the_sum(measure):
    points, cells = tm.ball(300, 8)
    mesh = complex_of(points, cells)
    volume = tm.signed_volumes(points, cells).sum()
    last = total(points, cells, measure, 2.0)
    mesh.status[:] = 1
    assert flip_pending(mesh, Cost(measure, 2.0), 10, OPEN, 20) > 0
    now = total(points, mesh.mesh_arrays()[0], measure, 2.0)
    assert now < last
    last = now

    cells = np.ascontiguousarray(mesh.mesh_arrays()[0])
    stars = vertex_stars(cells, len(points))
    coloring = vertex_coloring(cells, interior(points, cells))
    moved = np.zeros(len(points))
    for _ in range(3):
        for a, b in pairwise(coloring.blocks.tolist()):
            smooth_vertices(mesh.points, cells, stars, coloring.order, a, b, Cost(measure, 2.0),
                            FREELY, moved)
        now = total(mesh.points, cells, measure, 2.0)
        assert now < last
        last = now

    before = contents(mesh)
    assert run_pass(mesh, power=2.0, measure=measure) > 0
    assert contents(mesh) != before
    assert total(mesh.points, mesh.mesh_arrays()[0], measure, 2.0) < last
    assert_sound(mesh, mesh.points, volume)


@OTHER
def test_an_edge_is_flipped_when_that_lowers_the_sum(measure):
    turned = set()
    for seed in range(100):
        rng = np.random.default_rng(seed)
        points = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]]) + 0.3 * rng.uniform(-1, 1, (4, 2))
        ways = np.array([[[0, 1, 2], [0, 2, 3]], [[1, 2, 3], [1, 3, 0]]], dtype=np.int32)
        if min(pm.areas(points, way).min() for way in ways) < 1e-3:
            continue
        sums = [(MEASURES[measure](points, way) ** -2.0).sum() for way in ways]
        cells = ways[0].copy()
        mesh = Triangles(points, cells, cell_neighbors(cells), np.zeros(2, dtype=np.int32))
        done = quality_flips(mesh, Cost(measure, 2.0))
        assert done == (sums[1] < sums[0])
        turned.add(done)
    assert turned == {0, 1}


@OTHER
def test_planar_finishing_flips_by_the_measure_of_its_phase(measure):
    other = 0
    for seed in range(5):
        points, start = grid(seed, flips=60)
        regions = np.zeros(len(start), dtype=np.int32)
        found = {}
        for m in (QUALITY, measure):
            phase = Phase(16.0 if m == STEP else 2.0, 1.0, 1, 1, objective=m)
            nothing = np.zeros(len(points), dtype=bool)
            found[m] = start.copy()
            mesh = Triangles(points, found[m], cell_neighbors(start), regions)
            counts = finish2d(mesh, nothing, bounds=FREELY, phases=(phase,))
            cells = start.copy()
            mesh = Triangles(points, cells, cell_neighbors(cells), regions)
            flips = quality_flips(mesh, phase.cost)
            assert counts == (flips, 0)
            assert np.array_equal(found[m], cells)
        other += not np.array_equal(found[measure], found[QUALITY])
    assert other > 0


def angles(points, cells):
    """Smallest angle of every cell."""
    if cells.shape[1] == 3:
        return pm.shape(points, cells)[1].min(axis=1)
    return tm.dihedral_angles(points, cells).min(axis=1)


def altitudes(points, cells):
    return (pm if cells.shape[1] == 3 else tm).altitudes(points, cells)


def energies(points, cells):
    return (pm if cells.shape[1] == 3 else tm).amips(points, cells)


def stored(path):
    """A stored mesh, positive."""
    mesh = meshio.read(path)
    if "tetra" in mesh.cells_dict:
        return mesh.points, tm.oriented(mesh.points, mesh.cells_dict["tetra"])
    points = np.ascontiguousarray(mesh.points[:, :2])
    return points, pm.oriented(points, mesh.cells_dict["triangle"])


@pytest.mark.parametrize(
    ("source", "below", "more"),
    [(DATA / "bone05.vtu", 20, 0.5), (DATA / "tetwild_csg.vtu", 25, 0.0), (AIRFOIL, 40, 1.0)],
    ids=["bone", "csg", "airfoil"],
)
def test_each_objective_is_better_in_its_own_figure(source, below, more):
    """In the smallest angle of "csg", of cells that nothing can change, all are level."""
    mesh = mesh_of(*stored(source))
    found = {}
    for objective in ("radius_ratio", *OTHERS):
        outcome = run(mesh, Options(objective=objective))
        assert_promise(mesh, outcome)
        assert outcome.fallback is None
        found[objective] = outcome.points, outcome.cells
    default, angle = (angles(*found[name]) for name in ("radius_ratio", "min_dihedral"))
    assert angle.min() >= default.min() + more
    assert (angle < below).sum() <= 0.5 * (default < below).sum()
    default, amips = (energies(*found[name]) for name in ("radius_ratio", "amips"))
    assert amips.max() < default.max()
    assert amips.mean() < default.mean()
    start, default, step = (altitudes(*mesh).min() for mesh in
                            ((mesh.points, mesh.cells), found["radius_ratio"], found["time_step"]))
    assert step > 1.5 * start
    assert step > 0.95 * default


@pytest.mark.parametrize("objective", OTHERS)
@pytest.mark.parametrize("name", ["clusters", "needles", "shells", "almost a lattice"])
def test_the_promise_stands_on_hard_clouds(d, objective, name):
    points, cells = delaunay(CLOUDS[name](np.random.default_rng(1), d, 200))
    mesh = mesh_of(points, cells)
    assert_promise(mesh, run(mesh, Options(objective=objective)))


@pytest.mark.parametrize("objective", OTHERS)
def test_regions_fixed_vertices_and_bits(d, objective, many_blocks):
    points, cells = (
        pm.jittered_grid(12, 12, np.random.default_rng(3))[:2] if d == 2 else tm.ball(500, 5)
    )
    cells = (pm if d == 2 else tm).oriented(points, cells)
    regions = (points[cells].mean(axis=1)[:, 0] > np.median(points[:, 0])).astype(np.int32)
    fixed = np.random.default_rng(1).random(len(points)) < 0.2
    mesh = mesh_of(points, cells, regions, fixed)
    first = run(mesh, Options(objective=objective))
    assert_promise(mesh, first)
    assert (first.points != points).any()
    for other in (run(mesh, Options(objective=objective, threads=2)),
                  run(mesh_of(points * 2.0**20, cells, regions, fixed),
                      Options(objective=objective))):
        scale = 2.0**20 if other.points.max() > 1e4 else 1.0
        assert (other.points / scale).tobytes() == first.points.tobytes()
        assert other.cells.tobytes() == first.cells.tobytes()


def test_figures_rank_by_the_objective(d):
    points, cells = (
        pm.jittered_grid(6, 6, np.random.default_rng(3))[:2] if d == 2 else tm.ball(60, 5)
    )
    cells = (pm if d == 2 else tm).oriented(points, cells)
    assert amips_energies(points, cells) == pytest.approx(energies(points, cells), rel=1e-9)
    shares = {}
    q = pm.shape(points, cells)[0] if d == 2 else tm.quality(points, cells)
    shares["radius_ratio"] = q.mean() + 0.5 * np.quantile(q, 0.01) + 0.25 * q.min()
    if d == 3:
        small = (angles(points, cells) < 20.0).mean()
        assert small > 0.0
        shares["radius_ratio"] -= 3.0 * min(small, 0.1)
    e = energies(points, cells)
    shares["amips"] = -e.mean() - 0.5 * np.quantile(e, 0.99) - 0.25 * e.max()
    t = np.radians(angles(points, cells)) / np.arccos(1 / d)
    shares["min_dihedral"] = q.mean() + t.mean() + np.quantile(t, 0.01) + 0.5 * t.min()
    shares["time_step"] = shares["radius_ratio"] + 4.0 * np.log(
        altitudes(points, cells).min())
    for objective, score in shares.items():
        assert figures(points, cells, objective).score == pytest.approx(score, rel=1e-6)


def same_but_large(bounds, others):
    return all(mine._replace(large=0.0) == other._replace(large=0.0)
               for mine, other in zip(bounds, others, strict=True))


def test_held_bounds_are_the_angles_reached():
    points, cells = tm.ball(300, 8)
    mesh = complex_of(points, cells)
    bounds = Bounds(FREELY, Extremes(0.3, np.cos(np.radians(5.0)), -0.9))
    reached = tm.dihedral_angles(points, cells).min(axis=1)
    for hold in (0.0, 0.1):
        held = held_angles(mesh, bounds, hold)
        angle = np.degrees(np.arccos(held.cells.large))
        assert angle == pytest.approx(np.quantile(reached, hold), rel=1e-3)
        assert held.locked.large == min(bounds.locked.large, held.cells.large)
        assert same_but_large(held, bounds)


def test_phases_that_hold_give_up_a_part_of_the_best_extremes_at_most(monkeypatch):
    points, cells = tm.ball(300, 8)
    bounds = Bounds(Extremes(0.01, 1.0, -1.0), Extremes(0.3, np.cos(np.radians(5.0)), -0.9))
    found = [(0.2, 10.0, 150.0), (0.3, 8.0, 160.0), (0.1, 20.0, 160.0), (0.3, 19.99, 149.9)]
    steps = iter(found)

    def reached(*_):
        q, small, large = next(steps)
        return Extremes(q, np.cos(np.radians(small)), np.cos(np.radians(large)))

    limits = []
    monkeypatch.setattr(volume, "reached", reached)
    monkeypatch.setattr(volume, "descend", lambda *given: limits.append(given[2]) or (0, 0))
    phase = Phase(2.0, 0.1, 1, 1, hold=0.9)
    phases = (*[phase] * 3, replace(phase, hold=1.0), replace(phase, hold=0.0))
    finish(complex_of(points, cells), phases, bounds, None, 1)
    expected = [(0.18, 9.0, 153.0), (0.27, 8.0, 160.0), (0.1, 18.0, 160.0), (0.3, 19.99, 149.9)]
    for now, (q, small, large) in zip(limits, expected, strict=False):
        assert now.cells.quality == pytest.approx(q)
        assert np.degrees(np.arccos(now.cells.large)) == pytest.approx(small)
        assert np.degrees(np.arccos(now.cells.small)) == pytest.approx(large)
    assert limits[-1] == bounds
    assert len(limits) == len(found) + 1


def test_guarded_phases_keep_the_other_measure():
    points, cells = tm.ball(300, 8)
    bounds = Bounds(Extremes(0.01, 1.0, -1.0), Extremes(0.3, np.cos(np.radians(5.0)), -0.9))
    phase = Phase(4.0, 0.1, 2, 3, 3)
    mesh = complex_of(points, cells)
    assert guarded(mesh, phase, bounds) == bounds
    smallest = tm.dihedral_angles(points, cells).min(axis=1)
    few = np.quantile(smallest, 0.07)
    for least, expected in ((few, few), (0.5 * smallest.min(), smallest.min()),
                            (np.quantile(smallest, 0.09), smallest.min())):
        held = guarded(mesh, replace(phase, least=least), bounds)
        assert held.cells.large == pytest.approx(np.cos(np.radians(expected)), rel=1e-9)
        assert held.locked.large == min(bounds.locked.large, held.cells.large)
        assert same_but_large(held, bounds)
    angles = replace(phase, objective=DIHEDRAL, guard=0.2)
    held = guarded(mesh, angles, bounds)
    before = tm.quality(points, cells)
    assert held.cells.quality == pytest.approx(np.quantile(before, 0.2), rel=1e-9)
    assert held.with_quality(0.01) == bounds
    assert guarded(mesh, angles, bounds.with_quality(0.99)) == bounds.with_quality(0.99)
    below = []
    for guard in (0.2, None):
        mesh = complex_of(points.copy(), cells)
        finish(mesh, (replace(angles, guard=guard),), bounds, None, 1)
        now = tm.quality(mesh.points, mesh.mesh_arrays()[0])
        smallest = tm.dihedral_angles(mesh.points, mesh.mesh_arrays()[0]).min()
        assert smallest > tm.dihedral_angles(points, cells).min()
        below.append((now < held.cells.quality - 1e-12).sum())
    assert below[0] < 0.2 * len(cells)
    assert below[0] < below[1]


def test_a_phase_makes_no_new_angle_below_its_least():
    bounds = Bounds(Extremes(0.01, 1.0, -1.0), Extremes(0.3, np.cos(np.radians(5.0)), -0.9))
    start = complex_of(*tm.ball(300, 8))
    finish(start, (Phase(2.0, 0.5, 2, 3, 3, DIHEDRAL),), bounds, None, 1)
    below = []
    for phases in ((), (Phase(0.5, 1.0, 2, 3, least=22.0),), (Phase(0.5, 1.0, 2, 3),)):
        mesh = deepcopy(start)
        finish(mesh, phases, bounds, None, 1)
        smallest = tm.dihedral_angles(mesh.points, mesh.mesh_arrays()[0]).min(axis=1)
        below.append((smallest < 22.0).sum())
    assert below[1] <= below[0] < below[2]


def test_polishing_leaves_fewer_small_angles_and_keeps_the_least_quality():
    points, cells = tm.ball(300, 8)
    bounds = OPEN
    mesh = complex_of(points, cells)
    assert polish((tm.dihedral_angles(points, cells).min(axis=1) < POLICY.small_angle).mean()) == ()
    finish(mesh, (Phase(2.0, 0.1, 2, 3, 0),), bounds, None, 1)
    cells = mesh.mesh_arrays()[0]
    small = (tm.dihedral_angles(mesh.points, cells).min(axis=1) < POLICY.small_angle).mean()
    left, least = [small], [tm.quality(mesh.points, cells).min()]
    assert 0.01 < small < 0.1
    bounds = Bounds(FREELY, FREELY._replace(quality=least[0]))
    for phases in polish(small):
        finish(mesh, phases, bounds, None, 1)
        now = mesh.mesh_arrays()[0]
        left.append((tm.dihedral_angles(mesh.points, now).min(axis=1) < POLICY.small_angle).mean())
        least.append(tm.quality(mesh.points, now).min())
    assert all(later <= sooner for sooner, later in pairwise(left))
    assert all(later >= sooner - 1e-13 for sooner, later in pairwise(least))
    assert left[-1] < 0.5 * small


def test_small_angles_are_polished_and_the_better_state_stays(monkeypatch):
    paid = []
    for seed in range(8):
        mesh = mesh_of(*tm.ball(150, seed))
        polished = run(mesh, Options())
        with monkeypatch.context() as patch:
            patch.setattr(polishing, "polish", lambda share: ())
            plain = run(mesh, Options())
        few, many = (
            (tm.dihedral_angles(r.points, r.cells).min(axis=1) < POLICY.small_angle).sum()
            for r in (polished, plain)
        )
        now, otherwise = (figures(r.points, r.cells).score for r in (polished, plain))
        paid.append(polished.points.tobytes() != plain.points.tobytes())
        assert (few < many) == (now > otherwise) == paid[-1]
    assert 2 < sum(paid) < len(paid)


def test_schedules(d):
    (default,) = descents(d)
    general = [phase for phase in default.phases if phase.name.startswith("tail")]
    assert tuple(replace(phase, least=None, hold=0.0) for phase in general) == tail(d)
    assert all((phase.least == POLICY.small_angle) == (d == 3) for phase in general[1:])
    others = [phase for phase in default.phases if phase not in general]
    assert all(phase.hold for phase in others if phase.count or phase.name == "regain")
    assert [phase.objective for phase in others] == (d == 3) * [
        DIHEDRAL, *2 * (DIHEDRAL, QUALITY), QUALITY, QUALITY
    ]
    assert descents(d, "min_dihedral")[0] == Descent(tail(d))
    for objective in CODES:
        measures = {p.objective for step in descents(d, objective) for p in step.phases}
        assert CODES[objective] in measures
        steps = (bulk(d, objective), *(step.phases for step in descents(d, objective)))
        for step in (*steps, *polish(0.01), cautious(d, objective)):
            assert all(phase.name for phase in step)
    assert {p.objective for p in bulk(d, "amips")} == {MEAN_RATIO}


def test_small_angles_are_repaired_from_few_cells():
    for small in (0.01, 0.5):
        steps = repair(["share_below_20"], small)
        assert {first.share for first, _ in steps} == {min(small, POLICY.many_small_angles)}


def test_the_general_tail_is_the_way_back(monkeypatch, d):
    """When the descent of an objective spoils a figure the default's follows."""
    points, cells = (
        pm.jittered_grid(8, 8, np.random.default_rng(3))[:2] if d == 2 else tm.ball(200, 5)
    )
    mesh = mesh_of(points, (pm if d == 2 else tm).oriented(points, cells))
    real, seen = Memory.offer, []

    def offer(self, complex_, name):
        seen.append(name)
        return real(self, complex_, name) if len(seen) > 1 else False

    monkeypatch.setattr(Memory, "offer", offer)
    outcome = run(mesh, Options(objective="amips"))
    assert seen == ["finished", "finished"]
    assert_promise(mesh, outcome)
    assert (outcome.points != points).any()


@pytest.mark.parametrize("wrong", ["dihedral", "", None, 3, ["amips"]])
def test_unknown_objectives_are_refused(wrong):
    with pytest.raises(InvalidOptionError, match="got objective="):
        Options(objective=wrong)


def test_an_objective_without_finishing_would_have_no_effect():
    with pytest.raises(InvalidOptionError, match="without finishing"):
        Options(objective="amips", finish=False)
    points = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1], [0.9, 0.8]])
    cells = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    with pytest.raises(InvalidOptionError, match="got objective='angle'"):
        odt_plugins.optimize((points, cells), objective="angle")


def test_command_line(tmp_path, capsys):
    source, target, report = DATA / "tetwild_csg.vtu", tmp_path / "out.vtu", tmp_path / "r.json"
    code = cli.main(["optimize", str(source), str(target), "--objective", "amips",
                     "--report", str(report)])
    assert code == 0
    text = capsys.readouterr().out
    told = json.loads(report.read_text())
    assert told["options"]["objective"] == "amips"
    for when, path in (("before", source), ("after", target)):
        e = energies(*stored(path))
        assert told[when]["max_amips"] == pytest.approx(e.max(), rel=1e-9)
        assert told[when]["mean_amips"] == pytest.approx(e.mean(), rel=1e-9)
        assert f"{e.max():.4f}" in text
    assert told["after"]["max_amips"] < told["before"]["max_amips"]
    assert cli.main(["optimize", str(source), str(target), "--objective", "angle"]) == 2
    assert "min_dihedral" in capsys.readouterr().err
    assert cli.main(["optimize", str(source), str(target), "--objective", "amips",
                     "--no-finish"]) == 2


def test_amips_energy_of_any_cells():
    def amips_energy(points, cells):
        return cell_figures(points, cells).amips

    regular = np.array([[1, -1, -1], [1, 1, 1], [-1, 1, -1], [-1, -1, 1.0]])
    assert amips_energy(regular, [[0, 1, 2, 3]]) == pytest.approx([3.0], rel=1e-14)
    assert amips_energy(regular, [[1, 0, 2, 3]])[0] == np.inf
    assert amips_energy(regular, [[0, 1, 2]]) == pytest.approx([2.0], rel=1e-14)
    assert amips_energy(regular[:, :2] * 0, [[0, 1, 2]])[0] == np.inf
    points, cells = tm.ball(100, 3)
    e = amips_energy(points, cells)
    assert e == pytest.approx(tm.amips(points, cells), rel=1e-9)
    summary = summarize(points, cells)
    assert summary.max_amips == e.max()
    assert summary.mean_amips == pytest.approx(e.mean())
    assert summarize(points, cells[:, [1, 0, 2, 3]]).to_dict()["max_amips"] is None
    planar, triangles = pm.jittered_grid(5, 5, np.random.default_rng(0))[:2]
    triangles = pm.oriented(planar, triangles)
    assert amips_energy(planar, triangles) == pytest.approx(pm.amips(planar, triangles), rel=1e-9)
    lifted = np.column_stack([planar[:, 0], 0.6 * planar[:, 1], 0.8 * planar[:, 1]])
    assert amips_energy(lifted, triangles) == pytest.approx(pm.amips(planar, triangles), rel=1e-9)


def test_a_phase_that_holds_passes_no_extreme_that_was_reached():
    points, cells = tm.ball(300, 8)
    start = complex_of(points, cells)
    phase = Phase(4.0, 0.0, 2, 3, 3, count=20, hold=1.0)
    bounds = Bounds(FREELY, FREELY)
    angles = tm.dihedral_angles(points, cells)
    for own in bounds.within(volume.reached(start)):
        assert own.quality == pytest.approx(tm.quality(points, cells).min(), rel=1e-9)
        assert own.large == pytest.approx(np.cos(np.radians(angles.min())), rel=1e-9)
        assert own.small == pytest.approx(np.cos(np.radians(angles.max())), rel=1e-9)
    reached = []
    for way in (phase, replace(phase, objective=DIHEDRAL), replace(phase, hold=0.0)):
        mesh = deepcopy(start)
        finish(mesh, (way,), bounds, None, 1)
        now = mesh.mesh_arrays()[0]
        angles_now = tm.dihedral_angles(mesh.points, now)
        reached.append((tm.quality(mesh.points, now).min() > tm.quality(points, cells).min(),
                        angles_now.min() >= angles.min() - 1e-6,
                        angles_now.max() <= angles.max() + 1e-6))
    assert reached[0] == (True, True, True)
    assert all(reached[1][1:])
