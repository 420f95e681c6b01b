"""Bounds on the shapes of cells: a change may pass them only where it makes nothing worse."""

from __future__ import annotations

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.mesh.arrays import FloatArray


@kernel
def relaxed(
    bounds: FloatArray, worst: float, large: float, small: float
) -> tuple[float, float, float]:
    """Bounds for what takes the place of some cells: as given, or what the cells are beyond them.

    Parameters
    ----------
    bounds : (3,) float64, or longer    least radius ratio, largest and smallest cosine of an angle
    worst, large, small : float         the same three of the cells as they are

    Returns
    -------
    least, most, fewest : float
    """
    return min(bounds[0], worst), max(bounds[1], large), min(bounds[2], small)
