"""Rims and borders that slide in the plane leave every region its area."""

import numpy as np
import pytest
from planar_meshes import areas, oriented
from scipy.spatial import Delaunay

import odt_plugins


def inclusion(radius, corners, count=400):
    """The unit square around a round region, random points elsewhere; points, cells, labels."""
    rng = np.random.default_rng(0)
    angle = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False)
    ring = 0.5 + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    inner = rng.random((count, 2))
    inner = inner[np.linalg.norm(inner - 0.5, axis=1) > 1.3 * radius]
    s, o = np.linspace(0.0, 1.0, 15), np.zeros(15)
    rim = np.concatenate([np.column_stack(xy) for xy in (
        (s, o), (s, o + 1.0), (o[1:-1], s[1:-1]), (o[1:-1] + 1.0, s[1:-1]))])
    points = np.concatenate([ring, [[0.5, 0.5]], rim, inner])
    cells = oriented(points, Delaunay(points).simplices)
    cells = cells[areas(points, cells) > 1e-12]
    middle = points[cells].mean(axis=1)
    return points, cells, (np.linalg.norm(middle - 0.5, axis=1) < 0.999 * radius).astype(np.int32)


@pytest.mark.parametrize(("radius", "corners", "envelope"), [
    (0.005, 16, 1e-3), (0.02, 12, 1e-2), (0.02, 24, 1e-2), (0.1, 40, 1e-2)])
def test_regions_keep_their_areas(radius, corners, envelope):
    points, cells, labels = inclusion(radius, corners)
    (new, rows, tags), report = odt_plugins.optimize_with_report(
        (points, cells, labels), boundary="slide", envelope=envelope)
    for label in (0, 1):
        before = areas(points, cells[labels == label]).sum()
        assert areas(new, rows[tags == label]).sum() == pytest.approx(before, rel=3e-3)
    assert (new != points).any(axis=1).sum() > 100
    assert not (report.fallback or "").startswith("the input")
