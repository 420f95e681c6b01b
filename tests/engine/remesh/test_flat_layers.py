"""Coarser tetrahedra beside a thin layer, whose poor cells become no fewer."""

from __future__ import annotations

import numpy as np
import pytest
from boxes import box
from tet_meshes import signed_volumes

import odt_plugins

SIDES = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]


@pytest.fixture(scope="module")
def board():
    """A board of two plates and a layer between, a sixth as thick as its cells are wide."""
    points, cells = box(3, 8)
    heights = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 4.16, 5.16, 6.16, 7.16]) / 8
    grid = np.round(points * 8).astype(int)
    row = grid[:, 2]
    shaken = np.where(((row == 4) | (row == 5))[:, None], 0.0, points - grid / 8)
    points = np.column_stack([grid[:, :2] / 8, heights[row]]) + shaken
    level = row[cells].min(axis=1)
    return points, cells, np.where(level < 4, 0, np.where(level == 4, 1, 2))


def least_angles(points, cells):
    """Least dihedral angle of every tetrahedron in degrees, by the heights of its sides."""
    found = []
    for i, j in SIDES:
        k, other = sorted({0, 1, 2, 3} - {i, j})
        along = points[cells[:, j]] - points[cells[:, i]]
        a, b = (np.cross(along, points[cells[:, v]] - points[cells[:, i]]) for v in (k, other))
        cos = (a * b).sum(axis=1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
        found.append(np.degrees(np.arccos(np.clip(cos, -1.0, 1.0))))
    return np.min(found, axis=0)


@pytest.mark.parametrize("wish", [{"scale": 2.0}, {"cells": 1000}])
def test_a_body_with_a_thin_layer_becomes_coarser(board, wish):
    points, cells, labels = board
    (new, rows, parts), report = odt_plugins.remesh_with_report(board, **wish)
    assert len(rows) < 0.82 * len(cells)
    before, after = least_angles(points, cells), least_angles(new, rows)
    assert 0 < (after < 20.0).sum() <= 1.02 * (before < 20.0).sum()
    assert after.min() >= min(before.min(), 15.0) * (1.0 - 1e-9)
    assert any("good ones fewer: " in note for note in report.notes)
    for label in range(3):
        assert signed_volumes(new, rows[parts == label]).sum() == pytest.approx(
            signed_volumes(points, cells[labels == label]).sum(), rel=3e-3)


def test_figures_that_are_named_do_not_fall_beside_a_thin_layer(board):
    _, report = odt_plugins.remesh_with_report(board, scale=2.0, keep=("p1_quality",))
    assert report.after.p1_quality >= report.before.p1_quality
