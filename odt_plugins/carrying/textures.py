"""Where the triangles of a result lie on those of the input, for their texture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.host import Feet, HostMesh
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.simplex import SimplexMesh


def feet_of(
    host: HostMesh, mesh: SimplexMesh, points: FloatArray, cells: IntArray,
    origin: NDArray[np.int64] | None, *, follow: bool,
    same: NDArray[np.int64] | None = None,
) -> Feet | None:
    """Feet of the vertices that moved along a textured surface or in its plane, or came.

    Where triangles on both sides of a seam have vertices of their own, at the same places, those
    lie on their side.

    Parameters
    ----------
    host, mesh : HostMesh, SimplexMesh    the input as it came and as the engine reads it
    points : (n', d) float64, cells : (m', 3) int
    origin : (n',) int or None            input vertex of every vertex where some came or went
    follow : bool                         whether those in a plane follow where none came or went
    same : (n,) int or None               of a soup, the first vertex at the place of every vertex

    Returns
    -------
    Feet                                  None where no texture coordinates are others
    """
    stay = not (mesh.is_surface or follow or origin is not None)
    if not host.textured or host.cells.shape[1] != 3 or stay:
        return None
    from odt_plugins.engine.surface.in_plane import in_space
    from odt_plugins.engine.surface.judge import barycentric, feet_on
    from odt_plugins.engine.surface.sides import on_own_side

    old, points = in_space(mesh.points), in_space(points)
    known = old if origin is None else old[origin]
    mask = (points != known).any(axis=1)
    moved = np.flatnonzero(mask if origin is None else mask | (origin < 0))
    if not moved.size and origin is None:
        return None
    rows = host.cells.astype(np.int32)
    face, weights = feet_on(old, rows, np.concatenate([points[moved], points[cells].mean(axis=1)]))
    k = len(moved)
    feet = face[:k], weights[:k]
    if same is not None:
        rows = same[rows].astype(np.int32)
    one = cells if same is None or origin is not None else same[cells]
    feet = on_own_side(old, rows, feet, points, one, moved)
    under = rows[face[k:]]
    corners = [barycentric(old, under, points[cells[:, i]]) for i in range(3)]
    return Feet(moved, *feet, face[k:], np.stack(corners, axis=1), origin)
