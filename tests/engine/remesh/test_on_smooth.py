"""Vertices of a resized body go onto its geometry as far as no cell folds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tet_meshes import grid

from odt_plugins.engine.remesh.onto import on_smooth
from odt_plugins.engine.run.outcome import unchanged
from odt_plugins.mesh.simplex import Smooth, simplex_mesh


@pytest.mark.parametrize(("factor", "off"), [(1.1, False), (0.05, True)])
def test_cells_stay_positive_and_what_is_off_the_geometry_is_told(factor, off):
    mesh, _ = simplex_mesh(*grid(3, 5, jitter=0.0)[:2])
    top = mesh.points[:, 2] == mesh.points[:, 2].max()
    lifted = mesh.points.copy()
    lifted[top, 2] *= factor
    outcome, notes = on_smooth(unchanged(mesh, ""), Smooth(1.0, lambda _: lifted))
    x = outcome.points[mesh.cells]
    assert (np.linalg.det(x[:, 1:] - x[:, :1]) > 0).all()
    assert np.array_equal(outcome.points[~top], mesh.points[~top])
    assert np.array_equal(outcome.points, lifted) != off
    assert (["not on the geometry, since cells would fold" in note for note in notes]
            == [True] * off)


def test_what_stays_is_the_same_bit_for_bit():
    mesh, _ = simplex_mesh(*grid(3, 5, jitter=0.0)[:2])
    points = np.where(mesh.points == 0.0, -0.0, mesh.points)
    lifted = points.copy()
    lifted[points[:, 2] == points[:, 2].max(), 2] *= 1.1
    given = replace(unchanged(mesh, ""), points=points)
    outcome, _ = on_smooth(given, Smooth(1.0, lambda _: lifted))
    assert outcome.points.tobytes() == lifted.tobytes()
