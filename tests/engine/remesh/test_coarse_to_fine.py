"""Bodies whose cells are too flat to be cut, and surfaces that fold over themselves."""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay

import odt_plugins
from odt_plugins.engine.remesh import resized
from odt_plugins.errors import InvalidMeshError
from odt_plugins.generate.clouds import ball


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


def test_where_a_surface_folds_over_itself_less_of_the_envelope_is_used(monkeypatch) -> None:
    resize, tried = resized.resize, []

    def folding(work, slides, *rest, **more):
        tried.append(slides)
        if len(tried) == 1:
            msg = "got a third cell on a facet"
            raise InvalidMeshError(msg)
        return resize(work, slides, *rest, **more)

    monkeypatch.setattr(resized, "resize", folding)
    _, report = odt_plugins.remesh_with_report(ball(300), scale=1.0)
    assert len(tried) > 1
    assert report.after.mean_quality > report.before.mean_quality
