"""The nearest cell from star to star is that of all pairs."""

from __future__ import annotations

import numpy as np
import pytest
import tet_meshes as tm

from odt_plugins.engine.topology.nearest import nearest_cells
from odt_plugins.mesh.simplex import corner_mean


@pytest.mark.parametrize("threads", [1, 2])
def test_a_walk_across_the_mesh_ends_at_the_nearest_cell_of_the_region(threads, many_threads):
    points, cells = tm.grid(9, 3)
    centres = corner_mean(points, cells)
    regions = (centres[:, 1] > 4.0).astype(np.int32)
    rng = np.random.default_rng(4)
    x = rng.uniform(points.min(axis=0), points.max(axis=0), size=(500, 3))
    labels = (x[:, 1] > 4.0).astype(np.int32)
    where = np.array([rng.choice(np.flatnonzero(regions == label)) for label in labels])
    rows = cells[where]
    found = nearest_cells(cells, centres, regions, rows, x, labels, len(points), threads)
    square = ((centres - x[:, None]) ** 2).sum(axis=2)
    square[regions != labels[:, None]] = np.inf
    assert np.array_equal(found, square.argmin(axis=1))
    assert (found != where).mean() > 0.9


def test_of_cells_as_near_the_first_is_taken_and_none_of_another_region():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    cells = np.array([[1, 2, 3], [0, 1, 3]], dtype=np.int32)
    regions = np.zeros(2, dtype=np.int32)
    rows = np.array([[0, 1, 2], [0, 1, 2]], dtype=np.int32)
    x, labels = np.full((2, 2), 0.5), np.array([0, 1], dtype=np.int32)
    found = nearest_cells(cells, corner_mean(points, cells), regions, rows, x, labels, 4)
    assert found.tolist() == [0, -1]
