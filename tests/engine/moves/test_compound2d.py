"""Compound moves in the plane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import planar_meshes as planar
import pytest
from planar_meshes import MEASURES

from odt_plugins.compare.start import plate
from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import FREELY, Extremes
from odt_plugins.engine.cells.measures import QUALITY
from odt_plugins.engine.finish.phases import bulk, tail
from odt_plugins.engine.finish.plane import finish2d
from odt_plugins.engine.moves.compound2d import compound_pass_2d, excess_degrees
from odt_plugins.engine.moves.flips2d import Rule, flip, number_edges, take_back_flip
from odt_plugins.engine.topology.adjacency import cell_neighbors
from odt_plugins.engine.topology.lookup import place_in
from odt_plugins.engine.topology.triangles import Triangles
from odt_plugins.metric.through import halved_logarithms

pytestmark = pytest.mark.usefixtures("nothing_compiled")


def mesh_of(points, cells, regions=None):
    regions = np.zeros(len(cells), dtype=np.int32) if regions is None else regions
    return Triangles(points.copy(), cells.copy(), cell_neighbors(cells), regions)


def boundary_of(mesh):
    return planar.kept_vertices(mesh.cells, mesh.regions, len(mesh.points))


@pytest.fixture(scope="module")
def settled():
    """A graded mesh at which no single flip or move pays any more."""
    start = plate(250, 7)
    mesh = mesh_of(start.points, start.cells)
    finish2d(mesh, ~boundary_of(mesh), phases=single(bulk(2) + tail(2)))
    return mesh


def single(phases):
    return tuple(replace(phase, compound=0) for phase in phases)


def compound(mesh, cost, active=None, guarded=None, limit=FREELY, count=60):
    """One pass at the worst cells; how many moves stayed."""
    q, _ = planar.shape(mesh.points, mesh.cells)
    active = np.ones(len(mesh.cells), dtype=bool) if active is None else active
    guarded = boundary_of(mesh) if guarded is None else guarded
    edges, excess = number_edges(mesh.neighbors), excess_degrees(mesh)
    order = np.argsort(q)[:count].astype(np.int32)
    tried = np.zeros(len(mesh.cells), dtype=bool)
    taken = compound_pass_2d(mesh, edges, order, Rule(cost, limit, active, guarded, True), tried,
                             excess)
    np.testing.assert_allclose(excess.sum(), excess_degrees(mesh).sum(), atol=1e-9)
    return taken


def copy_of(mesh):
    return Triangles(*(a.copy() for a in mesh))


def test_a_flip_that_is_taken_back_leaves_no_trace():
    points, cells = planar.grid(3, n=4, holes=set())
    mesh = mesh_of(points, planar.oriented(points, cells))
    edges = number_edges(mesh.neighbors)
    before = [a.copy() for a in (mesh.cells, mesh.neighbors, edges.of_cell)]
    done = 0
    for t in range(len(mesh.cells)):
        for i in range(3):
            s = mesh.neighbors[t, i]
            if s < 0:
                continue
            j = place_in(edges.of_cell, s, edges.of_cell[t, i])
            flip(mesh.cells, mesh.neighbors, edges, t, i, s, j)
            assert (mesh.cells != before[0]).any()
            take_back_flip(mesh.cells, mesh.neighbors, edges, t, i, s, j)
            for now, then in zip((mesh.cells, mesh.neighbors, edges.of_cell), before, strict=True):
                np.testing.assert_array_equal(now, then)
            for e, cell in enumerate(edges.cell):
                assert e in edges.of_cell[cell]
            done += 1
    assert done > 50


def test_excess_degrees_are_those_of_the_angles():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.5, 0.5]])
    mesh = mesh_of(points, np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], dtype=np.int32))
    np.testing.assert_allclose(excess_degrees(mesh), [0.5, 0.5, 0.5, 0.5, -2.0], atol=1e-12)


@pytest.mark.parametrize("objective", MEASURES, ids=["radius ratio", "mean ratio", "angle", "step"])
def test_compound_moves_lower_the_sum_where_single_moves_are_stuck(settled, objective):
    mesh = copy_of(settled)
    measure = MEASURES[objective]
    taken = compound(mesh, Cost(objective, 4.0))
    assert taken > 5
    was, now = (measure(m.points, m.cells) for m in (settled, mesh))
    assert (now**-4.0).sum() < (was**-4.0).sum() - 0.03 * taken
    assert planar.areas(mesh.points, mesh.cells).min() > 0
    np.testing.assert_array_equal(mesh.neighbors, cell_neighbors(mesh.cells))
    edge = boundary_of(settled)
    np.testing.assert_array_equal(mesh.points[edge], settled.points[edge])
    assert planar.kept_edges(mesh.cells, mesh.regions) == planar.kept_edges(
        settled.cells, settled.regions)


@pytest.mark.parametrize("power", [16.0, 32.0, 64.0])
def test_compound_moves_pay_for_a_large_power_too(settled, power):
    mesh = copy_of(settled)
    taken = compound(mesh, Cost(QUALITY, power), count=10)
    was, now = (planar.shape(m.points, m.cells)[0] for m in (settled, mesh))
    assert taken > 2
    assert (now**-power).sum() < (was**-power).sum() - was.min() ** -power


def test_compound_moves_heed_regions_active_cells_guarded_vertices_and_bounds(settled):
    left = settled.points[settled.cells].mean(axis=1)[:, 0] < 0.0
    parted = copy_of(settled._replace(regions=left.astype(np.int32)))
    assert compound(parted, Cost(QUALITY, 4.0)) > 0
    assert planar.kept_edges(parted.cells, parted.regions) == planar.kept_edges(
        settled.cells, left)
    half = copy_of(settled)
    guarded = boundary_of(settled)
    guarded[settled.cells[left]] = True
    assert compound(half, Cost(QUALITY, 4.0), active=~left, guarded=guarded) > 0
    np.testing.assert_array_equal(half.cells[left], settled.cells[left])
    np.testing.assert_array_equal(half.points[guarded], settled.points[guarded])
    held = copy_of(settled)
    q, angles = planar.shape(settled.points, settled.cells)
    cosines = np.cos(np.radians([angles.min(), angles.max()]))
    assert compound(held, Cost(QUALITY, 4.0), limit=Extremes(q.min(), *cosines)) > 0
    new_q, new_angles = planar.shape(held.points, held.cells)
    assert new_q.min() >= q.min() - 1e-12
    assert new_angles.min() >= angles.min() - 1e-9
    assert new_angles.max() <= angles.max() + 1e-9


def test_the_schedule_of_the_plane_leaves_local_minima(settled):
    start = plate(250, 7)
    mesh = mesh_of(start.points, start.cells)
    finish2d(mesh, ~boundary_of(mesh))
    was, now = (planar.shape(m.points, m.cells)[0] for m in (settled, mesh))
    assert now.min() > was.min() + 0.05
    assert now.mean() > was.mean() + 0.01
    assert np.quantile(now, 0.01) > np.quantile(was, 0.01) + 0.03


def test_in_a_metric_degrees_are_those_of_the_image_and_the_metric_stays():
    start = plate(250, 7)
    root = np.array([[4.0, 1.5], [1.5, 1.0]])
    rows = np.tile(halved_logarithms((root @ root)[None]), (len(start.points), 1))
    mesh = mesh_of(np.column_stack([start.points @ np.linalg.inv(root), rows]), start.cells)
    image = mesh_of(start.points, start.cells)
    np.testing.assert_allclose(excess_degrees(mesh), excess_degrees(image), atol=1e-9)
    for one in (mesh, image):
        finish2d(one, ~boundary_of(one), phases=bulk(2) + tail(2))
    assert (mesh.points[:, 2:] == rows).all()
    seen, there = (planar.shape(np.ascontiguousarray(p), c)[0] for p, c in (
        (mesh.points[:, :2] @ root, mesh.cells), (image.points, image.cells)))
    assert seen.mean() == pytest.approx(there.mean(), abs=0.01)
