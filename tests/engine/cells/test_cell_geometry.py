"""Edges, volumes and interfaces of cells against their closed forms."""

from __future__ import annotations

import math

import contract
import numpy as np
import pytest

from odt_plugins.engine.cells.geometry import (
    edge_vectors,
    interface_vertices,
    signed_volumes,
    squared_edge_sum,
)


def test_edges_of_random_cells_give_their_moments_and_their_volumes(d):
    """The sum of the squared edges is d + 1 times that of the squared distances from the mean."""
    points = np.random.default_rng(d).normal(size=(40, d))
    cells = np.arange(40 - 40 % (d + 1), dtype=np.int32).reshape(-1, d + 1)
    x = points[cells]
    moment = ((x - x.mean(axis=1, keepdims=True)) ** 2).sum(axis=(1, 2))
    assert squared_edge_sum(points, cells) == pytest.approx((d + 1) * moment)
    volume = np.linalg.det(edge_vectors(points, cells)) / math.factorial(d)
    assert signed_volumes(points, cells) == pytest.approx(volume)


def test_vertices_between_two_labels_are_those_of_the_plane_between_them(d):
    points, cells, labels = contract.grid(d, 4)
    found = interface_vertices(cells.astype(np.int32), len(points), labels.astype(np.int32))
    assert np.array_equal(found, points[:, 0] == 0.5)
    assert not interface_vertices(cells.astype(np.int32), len(points), 0 * labels).any()
