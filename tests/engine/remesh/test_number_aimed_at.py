"""Numbers of cells: aimed at by resizing alone, before a mesh is finished and judged."""

import time
from dataclasses import replace

import boxes
import numpy as np
import pytest
from tet_meshes import ball

import odt_plugins
from odt_plugins.compare.start import stored
from odt_plugins.engine.remesh import run
from odt_plugins.engine.remesh.distance import Broken
from odt_plugins.engine.remesh.number import NEAR, Goal, factor_towards, goal_of
from odt_plugins.engine.remesh.sizes import wanted_sizes
from odt_plugins.engine.remesh.wish import Wish
from odt_plugins.engine.run import plan, retreat
from odt_plugins.engine.run.outcome import unchanged
from odt_plugins.engine.run.within import Within
from odt_plugins.mesh.simplex import freeze, simplex_mesh
from odt_plugins.options import Options


def by_power(goal, power, stays=0.0):
    """Counts that fall by a power of the factor, but for a part that stays."""
    return lambda factor: round(1.6 * goal * (stays + (1.0 - stays) * factor**-power))


@pytest.mark.parametrize("power", [1.5, 2.0, 3.0])
@pytest.mark.parametrize("stays", [0.0, 0.3])
def test_a_factor_for_a_number_is_found(power, stays):
    count = by_power(10_000, power, stays)
    factor = factor_towards(Goal(10_000, "cells", 3), count, lambda: NEAR, 1.0)
    assert count(factor) == pytest.approx(10_000, rel=NEAR)


def test_where_the_first_factor_fails_the_sizes_as_they_are_asked_for_are_tried():
    asked = []

    def count(factor):
        asked.append(factor)
        return 1100 if factor <= 1.0 else None

    assert factor_towards(Goal(1000, "cells", 3), count, lambda: 0.2, 1.5) == 1.0
    assert asked == [1.5, 1.0]


def test_where_all_fail_no_further_sizes_are_tried():
    asked = []
    assert factor_towards(Goal(1000, "cells", 3), asked.append, lambda: NEAR, 1.5) == 1.0
    assert asked == [1.5, 1.0]


def test_numbers_in_proportion_to_those_sought_spare_a_correction():
    resized, asked = by_power(10_000, 2.0, 0.3), []

    def count(factor):
        asked.append(factor)
        return round(0.9 * resized(factor))

    alike = {factor: resized(factor) for factor in (1.0, 1.3, 1.5)}
    factor = factor_towards(Goal(10_000, "cells", 3), count, lambda: NEAR, 1.5, lambda: alike)
    assert 0.9 * resized(factor) == pytest.approx(10_000, rel=NEAR)
    assert len(asked) == 2
    asked.clear()
    factor_towards(Goal(10_000, "cells", 3), count, lambda: NEAR, 1.5)
    assert len(asked) > 2


@pytest.mark.parametrize(("goal", "tried"), [(300, 4), (3_000_000, 2)])
def test_where_other_sizes_change_little_no_further_ones_are_tried(goal, tried):
    counts = {}

    def count(factor):
        counts[factor] = round(30_000 * factor**-0.1)
        return counts[factor]

    factor = factor_towards(Goal(goal, "cells", 3), count, lambda: NEAR, 1.0)
    assert len(counts) == tried
    assert factor == min(counts, key=lambda one: abs(counts[one] - goal))


def test_where_no_sizes_make_as_few_those_about_as_long_as_what_is_made_are_tried():
    def count(factor):
        allowed = 0.4
        return round(20_000 * (max(factor, allowed) / allowed)**0.1
                     * (min(factor, allowed) / allowed)**-3.0)

    factor = factor_towards(Goal(500, "cells", 3), count, lambda: NEAR, 1.0)
    assert count(factor) < 0.95 * min(count(1.0), count(2.0))


@pytest.mark.parametrize(("boundary", "advice"), [
    ("slide", "try a larger envelope="), ("fixed", "try boundary='slide'")])
def test_what_allows_a_number_out_of_reach_is_told(boundary, advice):
    few, many = (odt_plugins.remesh_with_report(ball(150, 1), cells=goal, boundary=boundary)[1]
                 for goal in (5, 1250))
    assert any(note.endswith(advice) for note in few.notes)
    assert advice not in str(many)


@pytest.mark.parametrize(("held", "way"), [
    ("selection", "a larger selection"), ("fixed", "fewer vertices in fixed")])
def test_what_the_caller_holds_is_told_where_it_allows_no_smaller_number(held, way):
    points, cells = boxes.box(3, 4)
    part = {"selection": np.arange(len(cells) // 8), "fixed": np.arange(0, len(points), 2)}[held]
    _, report = odt_plugins.remesh_with_report((points, cells), cells=40, **{held: part})
    assert any(note.endswith(f"try a larger envelope= or {way}") for note in report.notes)


@pytest.mark.parametrize("poor", [1, 3])
def test_a_number_that_resizing_cannot_reach_is_finished_once(monkeypatch, poor):
    finished, once = [], run._once

    def counted(attempt, *rest):
        finished.append(attempt)
        return once(attempt, *rest)

    monkeypatch.setattr(run, "_once", counted)
    _, cells = odt_plugins.remesh(ball(300, poor), cells=5, threads=1)
    assert len(finished) == 1
    assert len(cells) > 10


@pytest.mark.parametrize("what", ["cells", "vertices"])
def test_a_number_is_met_by_one_mesh_that_is_finished(monkeypatch, what):
    finished, once = [], run._once

    def counted(attempt, *rest):
        outcome, broken = once(attempt, *rest)
        finished.append(rest[-1] is not None)
        return outcome, broken

    monkeypatch.setattr(run, "_once", counted)
    goal = {"cells": 4000, "vertices": 900}[what]
    _, cells = odt_plugins.remesh(boxes.box(3, 6), threads=1, **{what: goal})
    count = len(cells) if what == "cells" else len(np.unique(cells))
    assert count == pytest.approx(goal, rel=NEAR)
    assert finished[0]
    assert len(finished) <= 2


@pytest.mark.parametrize("sized", [False, True])
@pytest.mark.parametrize("stretched", [False, True])
def test_a_poor_tail_counts_but_where_a_metric_gave_other_sizes(monkeypatch, sized, stretched):
    tails = []
    monkeypatch.setattr(plan, "run_sliding", lambda mesh, options, once, *, tail: tails.append(
        tail) or unchanged(mesh, ""))
    mesh = simplex_mesh(*boxes.box(3, 3))[0]
    if stretched:
        mesh = replace(mesh, metric=np.zeros((len(mesh.points), 6)))
    plan.run(mesh, Options(boundary="slide"), within=Within(sized=mesh if sized else None))
    assert tails == [not (sized and stretched)]


@pytest.mark.parametrize(("name", "told"), [
    ("with_sizes", "resizing"), ("broken_by_remeshing", "checks and other attempts")])
def test_the_time_of_finding_sizes_and_of_checks_is_told(name, told, monkeypatch):
    whole = getattr(run, name)

    def slow(*args, **options):
        time.sleep(0.1)
        return whole(*args, **options)

    monkeypatch.setattr(run, name, slow)
    _, report = odt_plugins.remesh_with_report(boxes.box(3, 3), cells=500, threads=1)
    assert report.times[told] >= 0.1


def test_an_input_nearer_to_the_number_does_not_stand_for_a_mesh_that_was_made():
    mesh = simplex_mesh(*boxes.box(3, 3))[0]
    goal, options = len(mesh.cells) + 5, Options(boundary="slide")
    sizes = wanted_sizes(mesh, Wish(cells=goal))
    made = replace(unchanged(mesh, ""), origin=np.arange(len(mesh.points)),
                   cells=mesh.cells[:-30], regions=mesh.regions[:-30])

    def tries(sizes, course):
        return (unchanged(mesh, "") if course.brief else made), None

    assert goal_of(Wish(cells=goal), 3).off(made) > 0.1
    found = run._towards(goal_of(Wish(cells=goal), 3), mesh, sizes, options, tries, tries)
    assert found.cells is made.cells


@pytest.mark.parametrize("tail", [False, True])
@pytest.mark.parametrize("columns", [0, 6])
def test_a_poor_tail_is_reason_for_a_fixed_boundary_where_it_counts(columns, tail):
    points, cells = ball(900, 3)
    points = points * [1.0, 1.0, 0.02]
    mesh = simplex_mesh(points, cells)[0]
    outcome = replace(unchanged(mesh, ""), metric=np.zeros((len(points) if columns else 0,
                                                            columns)))
    assert len(cells) > 3000
    assert retreat._may_be_beaten(outcome, Options(), tail=tail) is tail


def test_a_surface_that_stays_fine_does_not_make_more_cells_than_a_body_had():
    """A mesh of TetWild whose surface the envelope keeps as fine as it is, nearly all over."""
    bone = stored("bone")
    (_, cells), report = odt_plugins.remesh_with_report(
        (bone.points, bone.cells), cells=2400)
    before, after = report.before, report.after
    assert len(cells) < 0.9 * len(bone.cells)
    assert after.min_angle >= before.min_angle
    assert after.max_angle <= before.max_angle
    for figure in ("min_quality", "p1_quality", "mean_quality"):
        assert getattr(after, figure) >= getattr(before, figure)


def test_cells_that_spoil_the_worst_figures_alone_stay_before_more_cells_are_made(monkeypatch):
    """Sizes that do not fall, with which a single cell breaks the promise at first."""
    points, cells = ball(600, 3)
    once, remedy = run._once, run.remedy

    def broken_at_first(attempt, *rest):
        outcome, broken = once(attempt, *rest)
        alone = attempt.stuck == run.ALL and not attempt.mesh.frozen.any()
        return outcome, Broken("a cell is poorer") if alone else broken

    def holds_one(mesh, attempt, outcome, broken, options):
        if attempt.stuck != run.ALL:
            return remedy(mesh, attempt, outcome, broken, options)
        return attempt._replace(mesh=freeze(mesh, np.arange(len(mesh.cells)) == 0)), False

    made = odt_plugins.remesh((points, cells), cells=1489, envelope=1e-6, threads=1)
    monkeypatch.setattr(run, "_once", broken_at_first)
    monkeypatch.setattr(run, "remedy", holds_one)
    held, report = odt_plugins.remesh_with_report(
        (points, cells), cells=1489, envelope=1e-6, threads=1)
    assert len(held[1]) == pytest.approx(len(made[1]), rel=0.05)
    assert len(held[1]) < 1600
    assert "1 cell of the input stays as it is, since a cell is poorer" in report.notes
