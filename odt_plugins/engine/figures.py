"""The named figures of a mesh from the engine's own kernels, to compare states quickly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.kernel import kernel
from odt_plugins.engine.tetrahedron import tet_cosines, tet_quality
from odt_plugins.engine.triangle import triangle_in_space, triangle_shape
from odt_plugins.mesh import FloatArray, IntArray


@kernel
def _cell_shapes(points: FloatArray, cells: IntArray, shapes: FloatArray) -> None:
    """Radius ratio, cosine of the smallest and of the largest (dihedral) angle of every cell."""
    for c in range(cells.shape[0]):
        if cells.shape[1] == 3 and points.shape[1] == 3:
            i, j, k = cells[c, 0], cells[c, 1], cells[c, 2]
            q, large, small, _, _, _ = triangle_in_space(points, i, j, k)
        elif cells.shape[1] == 3:
            q, large, small = triangle_shape(points, cells[c, 0], cells[c, 1], cells[c, 2])
        else:
            q = tet_quality(points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3])
            large, small = tet_cosines(points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3])
        shapes[c, 0] = q
        shapes[c, 1] = large
        shapes[c, 2] = small


def cell_shapes(points: FloatArray, cells: IntArray) -> FloatArray:
    """Radius ratio (5.1), cosine of the smallest and of the largest angle, (m, 3)."""
    shapes = np.empty((len(cells), 3))
    _cell_shapes(points, cells, shapes)
    return shapes


@dataclass(frozen=True)
class Figures:
    """Minimum, 1 % quantile and mean of q, cosines of the smallest and the largest angle."""

    min_quality: float
    p1_quality: float
    mean_quality: float
    cos_min_angle: float
    cos_max_angle: float

    @property
    def score(self) -> float:
        """What the best-state memory ranks by: mean and tail of the quality together."""
        return self.mean_quality + 0.5 * self.p1_quality + 0.25 * self.min_quality

    def worse_than(self, before: Figures, keep: tuple[str, ...]) -> list[str]:
        """Figures of ``keep`` that are worse than before, beyond rounding."""
        slack = 1e-13
        worse = {
            "min_quality": self.min_quality < before.min_quality - slack,
            "p1_quality": self.p1_quality < before.p1_quality - slack,
            "mean_quality": self.mean_quality < before.mean_quality - slack,
            "min_angle": self.cos_min_angle > before.cos_min_angle + slack,
            "max_angle": self.cos_max_angle < before.cos_max_angle - slack,
        }
        return [name for name in keep if worse.get(name, False)]


def figures(points: FloatArray, cells: IntArray) -> Figures:
    """Compute the named figures of a mesh.

    Parameters
    ----------
    points : (n, d) float64, cells : (m, d + 1) int32
    """
    shapes = cell_shapes(points, cells)
    q: NDArray[np.float64] = shapes[:, 0]
    return Figures(
        float(q.min()),
        float(np.quantile(q, 0.01)),
        float(q.mean()),
        float(shapes[:, 1].max()),
        float(shapes[:, 2].min()),
    )
