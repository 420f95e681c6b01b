"""What the report says of a curved surface that was given other sizes."""

from __future__ import annotations

import numpy as np
import pytest
from surface_meshes import cube, sphere, two_sided

import odt_plugins


@pytest.mark.parametrize("doubled", [False, True])
def test_distances_are_told_both_ways(doubled):
    points, cells = sphere(2)
    given = (points, cells)
    if doubled:
        upper = (points[cells].mean(axis=1)[:, 2] > 0.0)
        copies = cells[upper] + len(points)
        given = (np.concatenate([points, points]), np.concatenate([cells[~upper], copies]))
    found, report = odt_plugins.remesh_with_report(given, scale=1.5, envelope=0.01)
    facts = report.surface
    length = 0.01 * np.sqrt((np.ptp(points, axis=0) ** 2).sum())
    assert facts["envelope"] == pytest.approx(length)
    forward, backward = two_sided(*given, *found)
    assert 0.0 < forward <= facts["forward"] <= length
    assert 0.0 < backward <= facts["backward"] <= length
    assert f"distance {facts['forward']:.4g} to the input" in str(report)


def test_features_are_counted_and_what_comes_back_is_no_distance_away():
    points, cells = cube(4)
    _, report = odt_plugins.remesh_with_report((points, cells), scale=2.0)
    facts = report.surface
    assert (facts["feature_edges"], facts["corners"], facts["held"]) == (48, 8, 8)
    assert facts["on_lines"] == 36
    still = odt_plugins.remesh_with_report((points, cells), scale=0.5, boundary="fixed")[1].surface
    assert (still["held"], still["on_lines"]) == (44, 0)
    square = points[:, :2], cells[(points[cells][:, :, 2] == 1.0).all(axis=1)]
    assert odt_plugins.remesh_with_report(square, scale=2.0)[1].surface is None
