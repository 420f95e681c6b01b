"""Sizes that give way do so no further than they need to."""

from __future__ import annotations

import numpy as np
import pytest
from contract import grid
from tet_meshes import signed_volumes

import odt_plugins


@pytest.mark.parametrize("good", [False, True])
def test_a_cube_whose_coarsest_meshes_are_poorer_becomes_nearly_as_coarse(good):
    points, cells, _ = grid(3, 6, 1)
    if good:
        points, cells = odt_plugins.optimize((points, cells), boundary="slide")
    (x, t), report = odt_plugins.remesh_with_report((points, cells), 0.96)
    assert len(t) < 80
    assert report.after.mean_quality >= min(report.before.mean_quality, 0.8)
    assert signed_volumes(x, t).min() > 0.0
    assert np.isclose(signed_volumes(x, t).sum(), signed_volumes(points, cells).sum())
