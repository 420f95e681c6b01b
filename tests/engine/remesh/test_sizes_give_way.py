"""What remesh does, one after the other, where figures would fall."""

from __future__ import annotations

from dataclasses import replace

import boxes
import numpy as np
import pytest
from tet_meshes import ball, signed_volumes

import odt_plugins
from odt_plugins.compare.start import stored
from odt_plugins.engine.remesh import places as places_module
from odt_plugins.engine.remesh import remedies, run
from odt_plugins.engine.remesh.distance import Broken, Kind, astray
from odt_plugins.engine.remesh.wish import Wish
from odt_plugins.engine.run.outcome import as_it_is, unchanged
from odt_plugins.mesh.simplex import simplex_mesh
from odt_plugins.options import Options


def test_sizes_give_way_everywhere_before_less_of_the_envelope_is_tried(monkeypatch):
    tries = []
    real = run._once

    def once(attempt, asked, options, leaving, room, made):
        outcome, broken = real(attempt, asked, options, leaving, room, made)
        tries.append((attempt.share, attempt.sizes.values))
        return outcome, Broken("p1_quality fell") if tries[-1][0] == tries[0][0] else broken

    monkeypatch.setattr(run, "_once", once)
    monkeypatch.setattr(remedies, "_fallen", lambda *_, **__: True)
    points, cells = ball(60, 3)
    few = np.arange(len(cells)) < len(cells) // 50
    monkeypatch.setattr(remedies, "spoiled_cells", lambda *_: few)
    x, t = odt_plugins.remesh((points, cells), scale=1.8)
    (first, wanted), (last, smaller) = tries[0], tries[-1]
    assert first > last > 0.0
    assert (smaller < 0.9 * wanted).mean() > 0.9
    assert (smaller > 0.4 * wanted).all()
    assert signed_volumes(x, t).min() > 0.0
    assert len(t) < len(cells)
    assert np.isfinite(x).all()


def test_growth_makes_fewer_cells_below_a_surface_that_stays_fine_as_the_note_says():
    bone = stored("bone")
    made = [odt_plugins.remesh_with_report((bone.points, bone.cells), scale=2, **growth)
            for growth in ({}, {"growth": 3.0})]
    (_, many), (_, few) = (mesh for mesh, _ in made)
    report, poorer = (report for _, report in made)
    assert len(few) < 0.9 * len(many)
    assert poorer.after.mean_quality < report.after.mean_quality
    assert any("growth=, more of which makes fewer, poorer cells" in note for note in report.notes)


def test_less_of_the_envelope_is_used_where_the_surface_came_too_far_alone(monkeypatch):
    tries, real, measured = [], run._once, run.furthest
    points, cells = ball(800, 3)
    moved = points.copy()
    moved[points[:, 0].argmax()] *= 1.3

    def once(attempt, asked, options, leaving, room, made):
        outcome, broken = real(attempt, asked, options, leaving, room, made)
        tries.append((attempt.share * attempt.parts, attempt.mesh.frozen.any(), broken))
        return outcome, broken

    def far(old, outcome, envelope):
        found = measured(old, outcome, envelope)
        return found if tries else (found[0], 1.0)

    def places(mesh, outcome, envelope):
        return astray(mesh, replace(outcome, points=moved, cells=mesh.cells, faces=mesh.faces,
                                    regions=mesh.regions), envelope)

    monkeypatch.setattr(run, "_once", once)
    monkeypatch.setattr(run, "furthest", far)
    monkeypatch.setattr(places_module, "astray", places)
    _, report = odt_plugins.remesh_with_report((points, cells), scale=1.2)
    (first, *_, broken), (second, held, _) = tries[:2]
    assert broken.kind is Kind.BEYOND
    assert not held
    assert (first == first[0]).all()
    less = second < first
    assert np.flatnonzero(less).size < 0.1 * len(points)
    assert less[points[:, 0].argmax()]
    assert report.fallback is None


def test_what_is_astray_is_near_what_moved():
    points, cells = ball(800, 3)
    mesh, _ = simplex_mesh(points, cells)
    top = int(points[:, 2].argmax())
    moved = points.copy()
    moved[top] *= 1.1
    outcome = unchanged(mesh, "")
    assert not len(astray(mesh, outcome, 1e-9))
    places = astray(mesh, replace(outcome, points=moved), 0.05)
    assert len(places)
    assert np.linalg.norm(places - moved[top], axis=1).max() < 0.6
    assert not len(astray(mesh, replace(outcome, points=moved), 0.11))


@pytest.mark.parametrize("metric", [None, np.diag([1.0, 1.0, 900.0])])
def test_a_metric_that_cannot_be_followed_is_to_be_stretched_less(monkeypatch, metric):
    points, cells = ball(60, 3)
    monkeypatch.setattr(run, "_once", lambda attempt, *_: (
        unchanged(attempt.mesh, ""), Broken("min_quality fell")))
    tensors = {} if metric is None else {"metric": np.tile(metric, (len(points), 1, 1))}
    (x, t), report = odt_plugins.remesh_with_report((points, cells), **(tensors or {"scale": 1.2}))
    assert np.array_equal(x, points)
    assert np.array_equal(t, cells)
    assert "min_quality fell" in report.fallback
    assert ("try a metric that is stretched less" in report.fallback) is (metric is not None)
    assert ("keep mean_quality and p1_quality alone" in report.fallback) is (metric is not None)


@pytest.mark.parametrize(("more", "tries"), [(1.5, 3), (1.05, 2)])
def test_sizes_corrected_for_a_number_begin_with_what_kept_the_promise(monkeypatch, more, tries):
    mesh, _ = simplex_mesh(*ball(300, 3))
    goal, attempts = 1000, []

    def once(attempt, asked, *_):
        attempts.append(attempt)
        count = round(more * goal * (attempts[0].sizes.asked[0] / attempt.sizes.asked[0]) ** 3)
        found = replace(unchanged(attempt.mesh, ""), origin=np.arange(len(mesh.points)),
                        cells=np.resize(mesh.cells, (count, 4)),
                        regions=np.zeros(count, dtype=np.int32))
        return found, None if attempt.mesh.frozen.any() else Broken("min_quality fell")

    few = np.arange(len(mesh.cells)) < len(mesh.cells) // 50
    monkeypatch.setattr(run, "_once", once)
    monkeypatch.setattr(remedies, "_fallen", lambda *_, **__: False)
    monkeypatch.setattr(remedies, "spoiled_cells", lambda *_: few)
    outcome = run.remesh(mesh, Options(boundary="slide"), as_it_is, Wish(cells=goal))
    assert [attempt.mesh.frozen.any() for attempt in attempts] == [False, True, True][:tries]
    assert len(outcome.cells) == pytest.approx(goal, rel=0.1)


def test_no_attempt_repeats_another(monkeypatch):
    made, tried, real, once = [], [], run.with_sizes, run._once

    def resized(*given):
        found = real(*given)
        made.append(found[0].outcome.cells)
        return found

    def noted(attempt, *more):
        tried.append(attempt)
        return once(attempt, *more)

    monkeypatch.setattr(run, "with_sizes", resized)
    monkeypatch.setattr(run, "_once", noted)
    points, cells = boxes.box(3, 6)
    odt_plugins.remesh((points * [1.0, 1.0, 0.03], cells), scale=2)
    assert len(made) > 1
    assert not any(map(np.array_equal, made, made[1:]))
    anew = [attempt for attempt in tried if attempt.full]
    assert anew
    assert len(made) == len(tried) - len(anew)
