"""How many cells of some sizes fill a mesh."""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.elementary import power
from odt_plugins.engine.cells.geometry import signed_volumes
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.simplex import corner_mean

CONTENT = {3: 0.44, 4: 0.105}
"""Area of a triangle, volume of a tetrahedron of a good mesh with edges of mean length 1."""


def cells_of_sizes(points: FloatArray, cells: IntArray, values: FloatArray) -> float:
    """About how many cells with edges of lengths ``values`` (n,) fill the mesh."""
    dense = power(values, 1.0 - cells.shape[1])
    content = np.abs(signed_volumes(points, cells))
    return float((content * corner_mean(dense, cells)).sum()) / CONTENT[cells.shape[1]]
