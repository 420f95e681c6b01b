"""Tetrahedra on boundary triangles that are nearly lines, and others beyond the extremes."""

from __future__ import annotations

import numpy as np
import pytest
import tet_meshes as tm
from promises import assert_promise, measure, mesh_of
from scipy.spatial import Delaunay

from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.finish.repair3d import lacking, within_bounds
from odt_plugins.engine.run.plan import run
from odt_plugins.options import Options

UP = np.array([1, -1, 1])
"""Whether a larger bound is a stricter one."""


def ragged(seed, n=1000):
    """Random points in a cube, cells in a part of it: some triangles of the boundary are flat."""
    points = np.random.default_rng(seed).random((n, 3))
    cells = Delaunay(points).simplices
    x, y, z = points[cells].mean(axis=1).T
    cells = cells[np.sin(7 * x) * np.sin(9 * y + 1) * np.cos(8 * z) < 0.25]
    used = np.unique(cells)
    points, cells = points[used], np.searchsorted(used, cells)
    return points, tm.oriented(points, cells)


def extremes(points, cells):
    """Of all cells, by independent code."""
    angles = np.cos(np.radians(tm.dihedral_angles(points, cells)))
    return np.array([tm.quality(points, cells).min(), angles.max(), angles.min()])


def test_one_flat_cell_on_the_boundary_does_not_spoil_a_run():
    repaired = 0
    for seed in (14, 15, 32):
        mesh = mesh_of(*ragged(seed))
        outcome = run(mesh, Options())
        assert_promise(mesh, outcome)
        assert outcome.fallback is None
        repaired += outcome.counts.get("repairs", 0) > 5
        before, after = measure(mesh.points, mesh.cells), measure(outcome.points, outcome.cells)
        assert before[2] < 0.49
        assert after[2] > before[2] + 0.12
        assert after[0] >= before[0]
        assert (extremes(outcome.points, outcome.cells) * UP
                >= extremes(mesh.points, mesh.cells) * UP - 1e-12).all()
    assert repaired >= 2


def test_bits_depend_neither_on_the_unit_nor_on_threads(many_blocks):
    points, cells = ragged(15)
    one = run(mesh_of(points, cells), Options())
    two = run(mesh_of(1024 * points, cells), Options(threads=2))
    assert one.counts["repairs"] == two.counts["repairs"] > 5
    assert (1024 * one.points).tobytes() == two.points.tobytes()
    assert one.cells.tobytes() == two.cells.tobytes()


@pytest.fixture(scope="module")
def good():
    outcome = run(mesh_of(*tm.grid(7, 4)), Options())
    return outcome.points, outcome.cells, tm.interior(outcome.points, outcome.cells)


def test_pressed_vertices_go_back_within_the_bounds(good):
    points, cells, free = good
    bounds, pressed = extremes(points, cells), points.copy()
    near = np.zeros(len(points), dtype=bool)
    for v in np.flatnonzero(free):
        star = cells[(cells == v).any(axis=1)]
        if not near[star].any():
            near[star] = True
            pressed[v] = 0.4 * pressed[v] + 0.6 * pressed[star[0][star[0] != v]].mean(axis=0)
    assert (pressed != points).any(axis=1).sum() > 5
    assert (tm.signed_volumes(pressed, cells) > 0).all()
    assert extremes(pressed, cells)[0] < 0.8 * bounds[0]
    was = pressed.copy()
    assert within_bounds(pressed, cells, free, Extremes(*bounds)) == 0.0
    assert (extremes(pressed, cells) * UP >= bounds * UP - 1e-12).all()
    assert (tm.signed_volumes(pressed, cells) > 0).all()
    assert pressed[~free].tobytes() == was[~free].tobytes()


def test_bounds_out_of_reach_are_given_up():
    outcome = run(mesh_of(*tm.grid(4, 4)), Options())
    points, cells = outcome.points, outcome.cells
    free = tm.interior(points, cells)
    moved, bounds = points.copy(), Extremes(0.99, 0.34, 0.32)
    left = within_bounds(moved, cells, free, bounds)
    assert 0.0 < left < lacking(points, cells, bounds).sum()
    assert (tm.signed_volumes(moved, cells) > 0).all()
    # the logarithm of the identity behind them
    seen = np.column_stack([points, np.zeros((len(points), 6))])
    assert within_bounds(seen, cells, free, bounds) == left
    assert np.array_equal(seen, np.column_stack([moved, np.zeros((len(points), 6))]))


def test_what_is_lacking_is_a_part_of_each_bound(good):
    points, cells, _ = good
    q = tm.quality(points, cells)
    angles = np.cos(np.radians(tm.dihedral_angles(points, cells)))
    large, small = angles.max(axis=1), angles.min(axis=1)
    bounds, margin = Extremes(0.9, 0.6, -0.1), 0.1
    parts = [q / 0.9, (1.0 - large) / 0.4, (1.0 + small) / 0.9]
    expected = sum(np.maximum(1.1 - part, 0.0) ** 2 for part in parts)
    assert lacking(points, cells, bounds, margin) == pytest.approx(expected, abs=1e-9)
    assert not lacking(points, cells, Extremes(0.0, 1.0, -1.0)).any()
    assert np.isinf(lacking(points, cells[:, [1, 0, 2, 3]], bounds)).all()
