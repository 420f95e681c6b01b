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


@pytest.fixture
def measured(monkeypatch):
    """How many cells were measured at every call."""
    counts, real = [], figures.spread

    def counted(work, parts, threads):
        parts = list(parts)
        counts.append(max(part.stop for part in parts))
        return real(work, parts, threads)

    monkeypatch.setattr(figures, "spread", counted)
    return counts


@pytest.mark.parametrize(("run", "options"), [
    (odt_plugins.optimize_with_report, {"insert": True}),
    (odt_plugins.remesh_with_report, {"scale": 1.2}),
])
def test_inputs_and_results_are_measured_once(run, options, measured):
    points, cells = ball(400)
    (_, after), _ = run((points, cells), **options)
    assert measured.count(len(cells)) == measured.count(len(after)) == 1


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
