"""Cells near a poor one: as far as lengths reach in the metric that a mesh has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tet_meshes import ball

from odt_plugins.engine.remesh.places import spoiled_cells
from odt_plugins.engine.remesh.sizes import wanted_sizes
from odt_plugins.engine.remesh.wish import Wish
from odt_plugins.engine.run.outcome import unchanged
from odt_plugins.mesh.simplex import simplex_mesh
from odt_plugins.metric.through import halved_logarithms
from odt_plugins.options import Options

SIZE = 0.4
NO_METRIC = np.zeros((0, 0))


def spoiled(points, cells, metric, poor):
    """Cells near those of a vertex that has moved so that its cells are poor."""
    mesh = replace(simplex_mesh(points, cells)[0], metric=metric)
    moved = points.copy()
    moved[poor[0]] = 0.98 * points[poor[1]] + 0.02 * points[poor[0]]
    outcome = replace(unchanged(mesh, ""), points=moved)
    wish = Wish(scale=1.0) if len(metric) else Wish(length=SIZE)
    return spoiled_cells(mesh, outcome, wanted_sizes(mesh, wish), Options(keep=("min_quality",)))


@pytest.fixture(scope="module")
def meshes():
    points, cells = ball(900, 3)
    middle = np.argsort((points**2).sum(axis=1))[0]
    around = cells[(cells == middle).any(axis=1)].ravel()
    return points, cells, (middle, around[around != middle][0])


def test_in_a_metric_of_one_length_the_same_cells_are_near_as_without_one(meshes):
    points, cells, poor = meshes
    metric = halved_logarithms(np.tile(np.eye(3) / SIZE**2, (len(points), 1, 1)))
    without = spoiled(points, cells, NO_METRIC, poor)
    assert 0.0 < without.mean() < 0.5
    np.testing.assert_array_equal(spoiled(points, cells, metric, poor), without)


def test_the_same_cells_are_near_where_mesh_and_metric_are_stretched_alike(meshes):
    points, cells, poor = meshes
    stretch = np.array([1.0, 1.0, 1e-3])
    metric = halved_logarithms(np.tile(np.diag(1.0 / (SIZE * stretch) ** 2), (len(points), 1, 1)))
    without = spoiled(points, cells, NO_METRIC, poor)
    np.testing.assert_array_equal(
        spoiled(points * stretch, cells, metric, poor), without)
