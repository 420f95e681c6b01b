"""What the promise of triangles with other vertices says of those without area."""

import numpy as np
import pytest

from odt_plugins.mesh.surface import surface_mesh
from odt_plugins.promise.retiled import broken_by_retiling

POINTS = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 4]])
CELLS = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], dtype=np.int32)


@pytest.mark.parametrize("off", [0.0, 1e-16, 1e-3])
def test_a_new_triangle_without_area_is_broken(off):
    """The edge 01 of one triangle is cut at its middle; a triangle fills the gap to the other."""
    points = np.vstack([POINTS, [2.0, -off, -off]])
    cells = np.vstack([CELLS[[0, 2, 3]], [[0, 4, 3], [4, 1, 3], [0, 1, 4]]]).astype(np.int32)
    before, origin = surface_mesh(POINTS, CELLS), np.array([0, 1, 2, 3, -1])
    said = broken_by_retiling(before, points, cells, np.zeros(6, np.int32), origin, (),
                              np.empty((0, 6)), before.faces[0])
    assert said == ([] if off == 1e-3 else ["triangle 5 has no area, 1 in all"])
