"""Surfaces of CAD whose features hold small angles: these cost nothing elsewhere."""

from pathlib import Path

import igl
import numpy as np

import odt_plugins

GEAR = Path(__file__).parents[2] / "data" / "gmsh_gear.npz"
"""A gear with a bore, 928 triangles by Gmsh with sizes from curvature alone."""


def shapes(points, cells):
    """Radius ratios and least angles in degrees, by libigl."""
    angles = igl.internal_angles(points, cells)
    ratio = 8 * np.prod(np.sin(angles / 2), axis=1)
    return ratio, np.degrees(angles.min(axis=1))


def test_triangles_with_new_small_angles_stay_as_they_were_and_others_get_better():
    stored = np.load(GEAR)
    mesh = stored["points"], stored["cells"]
    moved, report = odt_plugins.optimize_with_report(mesh)
    assert not (report.fallback or "").startswith("the input is returned")
    (q, least), (new_q, new_least) = shapes(*mesh), shapes(*moved)
    assert new_q.mean() > q.mean() + 0.003
    assert (new_least < 20).sum() <= (least < 20).sum()
    assert new_least.min() >= least.min() - 1e-6
    assert new_q.min() >= q.min() - 1e-7
    assert np.quantile(new_q, 0.01) >= np.quantile(q, 0.01) - 1e-7
