"""How much volume a boundary that slides may lose, since it can be given back."""

from __future__ import annotations

import numpy as np
import pytest
from tet_meshes import ball

from odt_plugins.engine.run.volumes import volume_share
from odt_plugins.mesh.simplex import diagonal, simplex_mesh
from odt_plugins.options import Options


def share(points, cells, labels, length):
    mesh, _ = simplex_mesh(points, cells, regions=labels)
    options = Options(boundary="slide", envelope=length / diagonal(mesh.points))
    return volume_share(mesh, options, np.zeros(len(points), dtype=np.bool_), 0.1)


def test_what_one_of_two_regions_cannot_give_back_is_not_lost():
    points, cells = ball(300, 5)
    both = np.concatenate([points, points + 5.0]), np.concatenate([cells, cells + len(points)])
    label = np.repeat([0, 1], len(cells))
    one = share(points, cells, None, 0.003)
    assert 0.2 < one < 4.0
    assert share(*both, label, 0.003) == pytest.approx(one / 2)
    assert share(*both, None, 0.003) == pytest.approx(one)
