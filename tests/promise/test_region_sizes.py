"""Sizes of regions may change by what is between a boundary and the geometry that it is made of."""

from __future__ import annotations

import boxes
import numpy as np
import pytest

from odt_plugins.mesh.simplex import Smooth, simplex_mesh
from odt_plugins.promise.region_sizes import broken_sizes


@pytest.mark.parametrize(("dim", "outside"), [(2, 4.0), (3, 6.0)])
def test_the_size_may_change_by_the_boundary_times_the_sag(dim, outside):
    points, cells = boxes.box(dim, 2)
    mesh, _ = simplex_mesh(points, cells)
    wider = 1.02 ** (1.0 / dim) * mesh.points
    word = {2: "area", 3: "volume"}[dim]
    assert broken_sizes(mesh, wider, mesh.cells, mesh.regions) == [
        f"the {word} of region 0 went from 1 to 1.02"]
    for sag, kept in ((0.0171 / outside, True), (0.0169 / outside, False)):
        near = type(mesh)(mesh.points, mesh.cells, mesh.regions, mesh.fixed,
                          smooth=Smooth(sag, np.asarray))
        assert (not broken_sizes(near, wider, mesh.cells, mesh.regions)) == kept
