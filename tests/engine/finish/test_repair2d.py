"""Planar meshes whose cells are all as bad as the worst: what is a little beyond goes back."""

from __future__ import annotations

import re

import numpy as np
import planar_meshes as pm
import pytest
from promises import assert_promise, mesh_of, planar

from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.finish.repair2d import within_bounds
from odt_plugins.engine.run.plan import run
from odt_plugins.engine.topology.adjacency import cell_neighbors
from odt_plugins.engine.topology.triangles import Triangles
from odt_plugins.options import Options


def structured(n, m, place):
    """A lattice of n times m vertices, every square cut along the same diagonal, put in place."""
    i, j = np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, m))
    points = np.stack(place(i.ravel(), j.ravel()), axis=1)
    a = (np.arange(n - 1) + n * np.arange(m - 1)[:, None]).ravel()
    cells = np.concatenate([np.stack([a, a + 1, a + n + 1], 1), np.stack([a, a + n + 1, a + n], 1)])
    if pm.areas(points, cells).sum() < 0:
        cells = cells[:, [0, 2, 1]]
    return points, cells


def ring(i, j):
    return (1 + i) * np.cos(j * 1.5), (1 + i) * np.sin(j * 1.5)


def limits(points, cells):
    """Extremes by independent code."""
    q, angles = pm.shape(points, cells)
    return q.min(), angles.min(), angles.max()


def rim(cells, n):
    held = np.zeros(n, dtype=bool)
    held[[v for e in pm.kept_edges(cells, np.zeros(len(cells), int)) for v in e]] = True
    return held


def bounds_of(points, cells):
    q, small, large = limits(points, cells)
    return np.array([q, np.cos(np.radians(small)), np.cos(np.radians(large))])


@pytest.mark.parametrize(("name", "place", "mean", "repairs"), [
    ("quarter of a ring", ring, 0.9, 1),
    ("rectangle", lambda i, j: (1.5 * i, j), 0.88, None),
    ("graded square", lambda i, j: (i**1.5, j**1.5), 0.9, 1),
])
def test_structured_meshes_gain_within_their_extremes(name, place, mean, repairs):
    points, cells = structured(16, 16, place)
    mesh = mesh_of(points, cells)
    outcome = run(mesh, Options())
    assert_promise(mesh, outcome)
    assert outcome.fallback is None
    assert outcome.counts.get("repairs") == repairs
    assert pm.shape(points, cells)[0].mean() < 0.83
    assert pm.shape(outcome.points, outcome.cells)[0].mean() > mean


def test_where_extremes_bind_the_report_tells_what_that_costs():
    mesh = mesh_of(*structured(12, 12, lambda i, j: (i, j)))
    outcome = run(mesh, Options())
    assert outcome.points.tobytes() == mesh.points.tobytes()
    assert re.search(r"min_angle .*worse\) at a mean quality of 0\.98", outcome.fallback)
    free = run(mesh, Options(keep=("mean_quality",)))
    assert pm.shape(free.points, free.cells)[0].mean() > 0.97
    assert free.fallback is None


def test_pressed_vertices_go_back_within_the_bounds():
    good = run(mesh_of(*planar()), Options())
    points, cells = good.points.copy(), good.cells.copy()
    bounds = bounds_of(points, cells)
    movable = ~rim(cells, len(points))
    movable[np.flatnonzero(movable)[::9]] = False
    for v in np.flatnonzero(movable)[3::17]:
        t = cells[(cells == v).any(axis=1)][0]
        points[v] = 0.3 * points[v] + 0.7 * points[t].mean(axis=0)
    assert (pm.areas(points, cells) > 0).all()
    assert limits(points, cells)[0] < bounds[0] - 0.05
    pressed = points.copy()
    regions = np.zeros(len(cells), np.int32)
    mesh = Triangles(points, cells, cell_neighbors(cells), regions)
    assert within_bounds(mesh, movable, Extremes(*bounds))
    assert (bounds_of(points, cells) * [1, -1, 1] >= bounds * [1, -1, 1] - 1e-9).all()
    assert (pm.areas(points, cells) > 0).all()
    assert points[~movable].tobytes() == pressed[~movable].tobytes()
    assert pm.areas(points, cells).sum() == pytest.approx(pm.areas(pressed, good.cells).sum())


def test_neither_boundary_nor_interfaces_are_flipped():
    points, cells = planar()
    points, cells = points.copy(), cells.astype(np.int32)
    regions = (points[cells].mean(axis=1)[:, 0] > points[:, 0].mean()).astype(np.int32)
    kept = pm.kept_edges(cells, regions)
    bounds = Extremes(0.6, np.cos(np.radians(30)), np.cos(np.radians(110)))
    movable = ~rim(cells, len(points))
    movable[[v for e in kept for v in e]] = False
    before = cells.copy()
    mesh = Triangles(points, cells, cell_neighbors(cells), regions)
    within_bounds(mesh, movable, bounds)
    assert (cells != before).any()
    assert pm.kept_edges(cells, regions) == kept
    assert np.array_equal(mesh.neighbors, cell_neighbors(cells))
    assert (pm.areas(points, cells) > 0).all()


def test_bounds_out_of_reach_are_given_up():
    points, cells = planar()
    points, cells = points.copy(), cells.astype(np.int32)
    bounds = Extremes(0.999, 0.51, 0.49)
    mesh = Triangles(points, cells, cell_neighbors(cells), np.zeros(len(cells), np.int32))
    assert not within_bounds(mesh, ~rim(cells, len(points)), bounds)
    assert (pm.areas(points, cells) > 0).all()


def test_unit_and_threads_do_not_matter(many_threads):
    points, cells = structured(10, 10, ring)
    one = run(mesh_of(points, cells), Options())
    two = run(mesh_of(1024 * points, cells), Options(threads=2))
    assert one.counts["repairs"] == 1
    assert (1024 * one.points).tobytes() == two.points.tobytes()
    assert one.cells.tobytes() == two.cells.tobytes()
