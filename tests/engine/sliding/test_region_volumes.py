"""The volume of every region stays where a boundary slides."""

import boxes
import numpy as np
import pytest

import odt_plugins


def volume(points, cells):
    x = points[cells]
    return np.linalg.det(x[:, 1:] - x[:, :1]).sum() / 6


def test_a_small_region_keeps_its_volume_and_the_rest_slides():
    points, cells = boxes.box(3, 6)
    points = 2 * points - 1
    far, norm = np.abs(points).max(axis=1), np.linalg.norm(points, axis=1)
    points, cells = odt_plugins.untangle(
        (points * (far / np.maximum(norm, 1e-300))[:, None], cells))
    cap = (points[cells].mean(axis=1)[:, 2] > 0.5).astype(int)
    (new, rows, labels), report = odt_plugins.optimize_with_report(
        (points, cells, cap), boundary="slide")
    for label in (0, 1):
        assert volume(new, rows[labels == label]) == pytest.approx(
            volume(points, cells[cap == label]), rel=3e-3)
    assert report.fallback is None
    on = np.abs(np.linalg.norm(points, axis=1) - 1) < 1e-9
    assert (new[on] != points[on]).any(axis=1).sum() > 30
