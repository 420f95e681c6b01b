"""Figures of all cells of a mesh are measured once, whoever asks for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import odt_plugins
from odt_plugins import figures
from odt_plugins.engine.run.outcome import unchanged
from odt_plugins.generate.clouds import ball
from odt_plugins.mesh.simplex import simplex_mesh


def named(points, cells):
    return np.ascontiguousarray(points).tobytes(), len(cells)


@pytest.fixture
def measured(monkeypatch):
    """The meshes that were measured, every time."""
    meshes, real = [], figures.CellGeometry

    def noted(axes, cells):
        meshes.append(named(axes.T, cells))
        return real(axes, cells)

    monkeypatch.setattr(figures, "CellGeometry", noted)
    return meshes


@pytest.mark.parametrize(("run", "options"), [
    (odt_plugins.optimize_with_report, {"insert": True}),
    (odt_plugins.remesh_with_report, {"scale": 1.2}),
])
def test_inputs_and_results_are_measured_once(run, options, measured):
    points, cells = ball(400)
    after, _ = run((points, cells), **options)
    assert measured.count(named(points, cells)) == measured.count(named(*after)) == 1
    assert len({*measured}) == len(measured)


def test_other_arrays_are_measured_anew():
    mesh, _ = simplex_mesh(*ball(100))
    outcome = unchanged(mesh, "")
    found = outcome.figures()
    assert replace(outcome, stop_reason="again").figures() is found
    wider = replace(outcome, points=2.0 * mesh.points).figures()
    assert wider.volume == pytest.approx(8.0 * found.volume)
    fewer = replace(outcome, cells=mesh.cells[:5], regions=mesh.regions[:5]).figures()
    assert np.array_equal(fewer.volume, found.volume[:5])
    assert figures.measured(mesh) is figures.measured(mesh)
    assert np.array_equal(figures.measured(mesh).quality, found.quality)
