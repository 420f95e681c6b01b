"""Size functions h(p): the wanted edge length, up to a constant factor, as in distmesh.

The mesh generator scales them so that the smallest value in the domain becomes h0.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from odt_plugins.errors import InvalidOptionError
from odt_plugins.generate.distance import Distance
from odt_plugins.mesh.arrays import FloatArray

Size = Callable[[FloatArray], ArrayLike]
"""h(p) > 0 of points (n, d), shape (n,)."""


def huniform(p: ArrayLike) -> FloatArray:
    """Size 1 everywhere, (n,) for points (n, d)."""
    return np.ones(len(np.asarray(p)))


def hgraded(distance: Distance, least: float, slope: float, most: float = np.inf) -> Size:
    """Make a size that grows with the distance from a curve, a point or a boundary.

    Parameters
    ----------
    distance : callable    d(p); its absolute value counts
    least : float          size at distance 0
    slope : float          growth of the size with the distance; 0.3 and less make good meshes
    most : float           no size is larger

    Returns
    -------
    callable               h(p) = min(least + slope |d(p)|, most)

    Raises
    ------
    InvalidOptionError     least or most is not positive, or slope is negative

    Examples
    --------
    >>> from odt_plugins.generate import dcircle
    >>> size = hgraded(lambda p: dcircle(p, 0, 0, 1), 0.1, 0.3)
    >>> size(np.array([[0.0, 0.0], [1.0, 0.0]])).tolist()
    [0.4, 0.1]
    """
    if not (least > 0.0 and most > 0.0 and slope >= 0.0):
        msg = (f"got least={least!r}, slope={slope!r}, most={most!r}; expected sizes above 0 and "
               "a slope of at least 0")
        raise InvalidOptionError(msg)

    def size(p: FloatArray) -> FloatArray:
        return np.minimum(least + slope * np.abs(np.asarray(distance(p), dtype=float)), most)

    return size


def hmin(*sizes: Size) -> Size:
    """Make the smallest of several sizes."""

    def size(p: FloatArray) -> FloatArray:
        return np.min([np.asarray(h(p), dtype=float) for h in sizes], axis=0)

    return size
