"""Surfaces that cut through themselves, and runs after one that left places as they were."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from surface_meshes import sphere

import odt_plugins
import odt_plugins.engine.remesh.run as remesh_run
from odt_plugins.engine.retile.run import Shell, newly_crossed
from odt_plugins.engine.run.outcome import unchanged

AWAY = np.array([1.2, 0.1, 0.05])


def two_spheres(level=3):
    """Two spheres that cut through each other."""
    points, cells = sphere(level)
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
    before = Shell(*two_spheres())
    finer, cells = two_spheres(level=4)
    assert len(before.crossed()) < len(Shell(finer, cells).crossed())
    assert not len(newly_crossed(Shell(finer, cells), before, 0.01))
    other = finer.copy()
    other[len(finer) // 2 :] -= 2 * AWAY
    new = newly_crossed(Shell(other, cells), before, 0.01)
    assert (other[new, 0] < 0).all()
    assert len(new) == len(np.unique(Shell(other, cells).crossed()))


@pytest.mark.parametrize("much", [False, True])
def test_other_sizes_are_tried_only_where_much_of_the_input_stays(much, monkeypatch):
    whole, calls = remesh_run.retile, []

    def told(mesh, *how):
        calls.append(mesh)
        done = leaving_it(mesh) if much else whole(mesh, *how)
        return replace(done, fallback="some places stay as they were, since something broke")

    def leaving_it(mesh):
        return replace(unchanged(mesh, ""), origin=np.arange(len(mesh.points)))

    monkeypatch.setattr(remesh_run, "retile", told)
    odt_plugins.remesh(sphere(3, 0.1), scale=2.0, envelope=0.02)
    assert (len(calls) > 1) is much
