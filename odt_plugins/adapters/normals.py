"""Normals of triangles and of their vertices, for objects that carry them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

NORMALS = "Normals"
"""Name that VTK gives to arrays of normals."""


def are_normals(values: NDArray[np.generic]) -> bool:
    """Whether values have the form of normals: three floating-point numbers each."""
    return values.dtype.kind == "f" and values.shape[1:] == (3,)


def renewed(
    old: NDArray[np.floating], points: NDArray[np.floating], cells: NDArray[np.integer], *,
    of_vertices: bool,
) -> NDArray[np.floating]:
    """Normals of vertices (n, 3) or triangles (m, 3) in the dtype and on the side of given ones.

    Parameters
    ----------
    old : (n, 3) or (m, 3)     normals before
    points : (n, 3)            vertices as they are now
    cells : (m, 3)             triangles as they are now
    of_vertices : bool         whether the normals are those of the vertices

    Returns
    -------
    same shape and dtype       unit vectors, those of vertices weighted by the areas around them;
                               as before where there is no area
    """
    corner = np.asarray(points, dtype=np.float64)[cells]
    area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    new = area
    if of_vertices:
        columns = [np.bincount(cells.ravel(), np.repeat(a, 3), minlength=len(points))
                   for a in area.T]
        new = np.stack(columns, axis=1)
    length = np.sqrt((new * new).sum(axis=1))[:, None]
    unit = np.divide(new, length, out=np.array(old, dtype=np.float64), where=length > 0.0)
    side = np.sign((unit * old).sum(axis=1)).sum()
    return np.asarray(np.where(length > 0.0, -unit if side < 0 else unit, old).astype(old.dtype))
