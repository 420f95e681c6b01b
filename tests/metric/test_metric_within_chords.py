"""Metrics ask for no lengths along surfaces that the envelope does not allow."""

from __future__ import annotations

import boxes
import numpy as np
import pytest
from scipy.spatial import Delaunay
from surface_meshes import sphere
from tet_meshes import ball, oriented, signed_volumes

import odt_plugins
from odt_plugins.engine.cells.geometry import boundary_vertices
from odt_plugins.engine.remesh.chords import chord_metric
from odt_plugins.mesh.simplex import simplex_mesh
from odt_plugins.mesh.surface import surface_mesh

NOTE = "the envelope allows no longer edges"


def cylinder(rings=5, layers=13):
    """A cylinder of radius 1 and height 3: rings of 6, 12, ... vertices, three cells a prism."""
    angle = [2 * np.pi * np.arange(6 * k) / (6 * k) for k in range(1, rings + 1)]
    flat = np.concatenate([[[0.0, 0.0]], *(
        (k + 1) / rings * np.column_stack([np.cos(a), np.sin(a)]) for k, a in enumerate(angle))])
    prisms, n = np.sort(Delaunay(flat).simplices, axis=1), len(flat)
    points = np.concatenate([np.column_stack([flat, np.full(n, z)])
                             for z in np.linspace(0.0, 3.0, layers)])
    cells = []
    for k in range(layers - 1):
        low, high = prisms + k * n, prisms + (k + 1) * n
        cells += [np.column_stack([low, high[:, 2]]), np.column_stack([low[:, :2], high[:, 1:]]),
                  np.column_stack([low[:, :1], high])]
    return points, oriented(points, np.concatenate(cells))


@pytest.mark.parametrize("radius", [1.0, 20.0])
def test_chords_of_a_sphere_are_as_long_in_all_directions_along_it(radius):
    points, cells = ball(1500, 2)
    rim = boundary_vertices(cells, len(points))
    points = points * np.where(rim, 1.0 / np.linalg.norm(points, axis=1), 1.0)[:, None] * radius
    metric = chord_metric(simplex_mesh(points, cells)[0], 0.01, 40.0)
    values = np.linalg.eigvalsh(metric[rim])
    assert np.median(values[:, 1:]) == pytest.approx(1.0 / (8 * 0.5 * 0.01 * radius), rel=0.1)
    assert np.quantile(values[:, 1:], 0.05) > 0.7 * np.median(values[:, 1:])
    assert np.median(values[:, 0]) < 0.1 * np.median(values[:, 2])
    normal = points[rim] / radius
    along = np.einsum("ni,nij,nj->n", normal, metric[rim], normal)
    assert np.quantile(np.abs(along), 0.9) < 0.1 * np.median(values[:, 2])
    assert not metric[~rim].any()


def test_chords_of_a_cylinder_are_short_across_its_axis_alone():
    points, cells = cylinder()
    mesh = simplex_mesh(points, cells)[0]
    side = (np.linalg.norm(points[:, :2], axis=1) > 0.99) & (np.abs(points[:, 2] - 1.5) < 1.0)
    metric = chord_metric(mesh, 0.02, 40.0)[side]
    around = np.column_stack([-points[side, 1], points[side, 0], 0.0 * points[side, 0]])
    across = np.einsum("ni,nij,nj->n", around, metric, around)
    assert np.median(across) == pytest.approx(1.0 / (8 * 0.5 * 0.02), rel=0.2)
    assert np.median(np.abs(metric[:, 2, 2])) < 0.1 * np.median(across)


def test_a_field_of_one_direction_is_followed_on_a_ball():
    points, cells = ball(100, 1)
    metric = odt_plugins.metric_from_field((points, cells), points[:, 2] ** 2, 600, ratio=20)
    (x, t), report = odt_plugins.remesh_with_report((points, cells), metric=metric, cells=600)
    assert report.fallback is None
    assert any(NOTE in note for note in report.notes)
    assert signed_volumes(x, t).min() > 0.0
    height = np.ptp(x[t][:, :, 2], axis=1).mean() / np.ptp(x[t][:, :, :2], axis=1).mean()
    was = np.ptp(points[cells][:, :, 2], axis=1).mean() / np.ptp(
        points[cells][:, :, :2], axis=1).mean()
    assert height < 0.5 * was


@pytest.mark.parametrize("radius", [1.0, 20.0])
def test_chords_of_triangles_of_a_sphere_are_as_long_in_all_directions_along_it(radius):
    points, triangles = sphere(3)
    unit = points / np.linalg.norm(points, axis=1)[:, None]
    metric = chord_metric(surface_mesh(radius * unit, triangles), 0.01, 40.0)
    normal, *along = np.moveaxis(np.linalg.eigvalsh(metric), 1, 0)
    for values in along:
        assert values == pytest.approx(1.0 / (8 * 0.5 * 0.01 * radius), rel=0.2)
    assert np.abs(normal).max() < 0.1 * along[1].min()


def test_triangles_of_a_sphere_are_stretched_as_far_as_the_envelope_allows():
    points, triangles = sphere(2)
    metric = np.tile(np.diag([15.0, 0.5, 0.5]) ** 2, (len(points), 1, 1))
    (x, t), report = odt_plugins.remesh_with_report(
        (points, triangles), metric=metric, cells=2 * len(triangles), envelope=0.01)
    assert any(NOTE in note for note in report.notes)
    assert len(t) == pytest.approx(2 * len(triangles), rel=0.05)
    assert report.after.mean_quality > 0.9
    assert np.ptp(x[t][:, :, 0], axis=1).mean() < 0.6 * np.ptp(x[t][:, :, 1], axis=1).mean()


def test_metrics_of_flat_bodies_and_of_boundaries_that_stay_are_taken_as_they_are():
    metric = np.diag([4.0, 4.0, 100.0])
    for mesh, options in ((boxes.box(3, 3), {}), (ball(60, 1), {"boundary": "fixed"})):
        _, report = odt_plugins.remesh_with_report(
            mesh, metric=np.tile(metric, (len(mesh[0]), 1, 1)), **options)
        assert not any(NOTE in note for note in report.notes)
