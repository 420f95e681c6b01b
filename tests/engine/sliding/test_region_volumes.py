"""The volume of every region stays where a boundary slides."""

import boxes
import numpy as np
import pytest

import odt_plugins


def volume(points, cells):
    x = points[cells]
    return np.linalg.det(x[:, 1:] - x[:, :1]).sum() / 6


def ball():
    points, cells = boxes.box(3, 6)
    points = 2 * points - 1
    far, norm = np.abs(points).max(axis=1), np.linalg.norm(points, axis=1)
    return odt_plugins.untangle((points * (far / np.maximum(norm, 1e-300))[:, None], cells))


def test_a_small_region_keeps_its_volume_and_the_rest_slides():
    points, cells = ball()
    cap = (points[cells].mean(axis=1)[:, 2] > 0.5).astype(int)
    (new, rows, labels), report = odt_plugins.optimize_with_report(
        (points, cells, cap), boundary="slide")
    for label in (0, 1):
        assert volume(new, rows[labels == label]) == pytest.approx(
            volume(points, cells[cap == label]), rel=3e-3)
    assert report.fallback is None
    on = np.abs(np.linalg.norm(points, axis=1) - 1) < 1e-9
    assert (new[on] != points[on]).any(axis=1).sum() > 30


def test_volumes_come_back_and_a_flat_face_stays_flat():
    """Half a ball: what it loses where it slides comes back from the round side alone."""
    points, cells = ball()
    half = cells[points[cells].mean(axis=1)[:, 2] > 0]
    used = np.unique(half)
    points, half = points[used], np.searchsorted(used, half)
    (new, rows), report = odt_plugins.optimize_with_report(
        (points, half), boundary="slide", envelope=0.02)
    assert volume(new, rows) == pytest.approx(volume(points, half), rel=1e-5)
    assert report.slid["vertices"] > 100
    flat = points[:, 2] == 0
    assert flat.sum() == 24
    assert np.abs(new[flat, 2]).max() < 1e-12
    assert report.after.mean_quality > report.before.mean_quality + 0.05


def test_each_region_has_its_own_volume_back():
    points, cells = ball()
    side = (points[cells].mean(axis=1)[:, 2] > 0).astype(int)
    (new, rows, labels), report = odt_plugins.optimize_with_report(
        (points, cells, side), boundary="slide", envelope=0.03)
    for label in (0, 1):
        assert volume(new, rows[labels == label]) == pytest.approx(
            volume(points, cells[side == label]), rel=2e-4)
    assert report.slid["vertices"] > 100


def test_a_surface_that_is_resized_keeps_the_volume():
    points, cells = ball()
    (new, rows), report = odt_plugins.remesh_with_report(
        (points, cells), scale=1.0, envelope=0.02)
    assert report.slid["vertices"] > 50
    assert volume(new, rows) == pytest.approx(volume(points, cells), rel=1e-6)
