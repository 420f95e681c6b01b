"""Surfaces that cut through themselves or nearly fold, and runs after one that left places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from surface_meshes import sphere

import odt_plugins
import odt_plugins.engine.remesh.triangles as remesh_triangles
import odt_plugins.engine.retile.run as retile_run
from odt_plugins.engine.retile.run import Shell, newly_crossed
from odt_plugins.engine.run.outcome import unchanged

AWAY = np.array([1.2, 0.1, 0.05])


def two_spheres(level=3):
    """Two spheres that cut through each other."""
    points, cells = sphere(level)
    cells = cells.astype(np.int32)
    return np.concatenate([points, points + AWAY]), np.concatenate([cells, cells + len(points)])


@pytest.mark.parametrize("scale", [0.6, 1.5])
def test_a_surface_that_cuts_itself_is_resized_there_too(scale):
    points, cells = two_spheres()
    (made, rows), report = odt_plugins.remesh_with_report(
        (points, cells), scale=scale, envelope=1e-2)
    assert report.fallback is None
    near = np.abs(np.linalg.norm(made, axis=1) - 1.0) < 0.1
    near &= np.abs(np.linalg.norm(made - AWAY, axis=1) - 1.0) < 0.1
    assert near[rows].any(axis=1).sum() > 20
    sides = made[rows[:, [1, 2, 0]]] - made[rows]
    length = np.linalg.norm(sides[near[rows].any(axis=1)], axis=2)
    before = np.linalg.norm(points[cells[:, [1, 2, 0]]] - points[cells], axis=2).mean()
    assert length.mean() == pytest.approx(scale * before, rel=0.15)


def test_crossings_are_new_where_there_were_none():
    before = Shell(*two_spheres(level=2))
    finer, cells = two_spheres()
    assert len(before.crossed()) < len(Shell(finer, cells).crossed())
    assert not len(newly_crossed(Shell(finer, cells), before, 0.01))
    other = finer.copy()
    other[len(finer) // 2 :] -= 2 * AWAY
    new = newly_crossed(Shell(other, cells), before, 0.01)
    assert (other[new, 0] < 0).all()
    assert len(new) == len(np.unique(Shell(other, cells).crossed()))


@pytest.mark.parametrize("much", [False, True])
def test_other_sizes_are_tried_only_where_much_of_the_input_stays(much, monkeypatch):
    whole, calls = remesh_triangles.retile, []

    def told(mesh, *how, **more):
        calls.append(mesh)
        done = leaving_it(mesh) if much else whole(mesh, *how, **more)
        return replace(done, fallback="some places stay as they were, since something broke")

    def leaving_it(mesh):
        return replace(unchanged(mesh, ""), origin=np.arange(len(mesh.points)))

    monkeypatch.setattr(remesh_triangles, "retile", told)
    odt_plugins.remesh(sphere(3, 0.1), scale=2.0, envelope=0.02)
    assert (len(calls) > 1) is much


def double_cone(turn, around=48, rings=8):
    """Two cones on one circle, at which the surface turns by some degrees; shaken."""
    height = np.tan(np.radians(90 - turn / 2))
    angle = 2 * np.pi * np.arange(around) / around
    radius = np.r_[np.arange(1, rings + 1), np.arange(rings - 1, 0, -1)] / rings
    side = np.r_[np.ones(rings), -np.ones(rings - 1)]
    points = np.concatenate([
        [[0, 0, height]],
        np.stack([np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle)),
                  np.outer(side * height * (1 - radius), np.ones(around))], axis=-1).reshape(-1, 3),
        [[0, 0, -height]]])
    j, k = np.arange(around), (np.arange(around) + 1) % around
    cells = [np.column_stack([0 * j, 1 + j, 1 + k])]
    for i in range(len(radius) - 1):
        a, b = 1 + i * around, 1 + (i + 1) * around
        cells += [np.column_stack([a + j, b + j, b + k]), np.column_stack([a + j, b + k, a + k])]
    last = 1 + (len(radius) - 1) * around
    cells.append(np.column_stack([0 * j + len(points) - 1, last + k, last + j]))
    shaken = points + 0.004 * np.random.default_rng(3).normal(size=points.shape)
    return shaken, np.concatenate(cells)


@pytest.mark.parametrize("turned", [0.0, 20.0])
def test_a_crease_that_nearly_folds_may_turn_a_little_more(turned, monkeypatch):
    monkeypatch.setattr(retile_run, "TURNED", turned)
    _, report = odt_plugins.remesh_with_report(double_cone(117), scale=1, envelope=1e-2)
    assert (report.fallback is None) is (turned > 0)
