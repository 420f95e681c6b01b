"""The one mesh type that the engine knows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class SimplexMesh:
    """A valid mesh of triangles in the plane or tetrahedra in space.

    Attributes
    ----------
    points : (n, d) float64, C-contiguous    coordinates in the caller's unit, d = 2 or 3
    cells : (m, d + 1) int32, C-contiguous   vertex indices, signed volume positive
    regions : (m,) int32                     label of every cell; facets between two labels stay
    fixed : (n,) bool                        vertices that must not move (boundary not included)
    """

    points: FloatArray
    cells: IntArray
    regions: IntArray
    fixed: BoolArray

    @property
    def dim(self) -> int:
        """Dimension d of the space."""
        return int(self.points.shape[1])
