"""Bodies whose cells are too flat to be cut."""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay

import odt_plugins


def test_cells_that_are_too_flat_to_be_cut_vanish_in_a_coarse_mesh_first() -> None:
    thread = np.random.default_rng(0).uniform(-1.0, 1.0, (500, 3)) * (1.0, 1e-6, 1e-6)
    corners = np.stack(np.meshgrid(*3 * [[-2.0, 2.0]], indexing="ij"), axis=-1).reshape(-1, 3)
    points = np.concatenate([corners, thread])
    cells = Delaunay(points).simplices
    volumes = np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]])
    cells[volumes < 0.0] = cells[volumes < 0.0][:, [1, 0, 2, 3]]
    _, report = odt_plugins.remesh_with_report((points, cells), 0.4)
    assert report.before.p1_quality < 1e-6
    assert report.after.min_quality > 0.6
    assert report.after.p1_quality > 0.77
