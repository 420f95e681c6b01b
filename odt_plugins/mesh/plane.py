"""Triangles in space that lie in a plane: coordinates in that plane and back again."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import InvalidMeshError, counted, place_within
from odt_plugins.mesh.arrays import FloatArray
from odt_plugins.mesh.simplex import vertices_of

FLATNESS = 1e-6
"""Largest distance from the plane, relative to the bounding-box diagonal of the used vertices."""

PLACE = re.compile(r"\b(near|around|at) \(([-+.e\d]+), ([-+.e\d]+)\)")
"""A place in a plane as sentences tell it."""


@dataclass(frozen=True)
class PlaneFrame:
    """A plane in space with an orthonormal frame.

    Attributes
    ----------
    origin : (3,) float64    a point of the plane
    axes : (2, 3) float64    orthonormal directions; unit vectors for an axis-aligned plane
    """

    origin: FloatArray
    axes: FloatArray

    def to_plane(self, points: FloatArray) -> FloatArray:
        """Coordinates (n, 2) of points (n, 3); a mere choice of columns when axis-aligned."""
        kept = _unit_axes(self.axes)
        if kept is not None:
            return np.ascontiguousarray(points[:, kept])
        offset = points - self.origin
        return np.stack([_dot(offset, axis) for axis in self.axes], axis=1)

    def to_space(self, coordinates: FloatArray) -> FloatArray:
        """Points (n, 3) of coordinates (n, 2); the inverse of :meth:`to_plane`."""
        kept = _unit_axes(self.axes)
        if kept is not None:
            out = np.repeat(self.origin[None], len(coordinates), axis=0)
            out[:, kept] = coordinates
            return out
        u, v = coordinates[:, :1], coordinates[:, 1:]
        return np.asarray(self.origin + u * self.axes[0] + v * self.axes[1])


def places_in_space(text: str, frame: PlaneFrame | None, extent: float) -> str:
    """Tell places in a plane as places in space; ``extent`` is that of the mesh."""
    if frame is None:
        return text

    def told(found: re.Match[str]) -> str:
        place = frame.to_space(np.array([[float(found[2]), float(found[3])]]))[0]
        return f"{found[1]} ({place_within(extent, place, 6)})"

    return PLACE.sub(told, text)


def plane_frame(points: FloatArray, cells: NDArray[np.integer]) -> PlaneFrame | None:
    """Find the plane of a triangle mesh whose points are given in space.

    Parameters
    ----------
    points : (n, 3) float64    finite
    cells : (m, 3) int         indices in range

    Returns
    -------
    PlaneFrame or None         a plane x = c, y = c or z = c gives exactly the other two
                               coordinates; any other plane an orthonormal frame in which
                               the areas of most triangles are positive; None when a used vertex
                               is further than FLATNESS times the bounding-box diagonal from the
                               plane: a curved surface

    Raises
    ------
    InvalidMeshError           all triangles have zero area

    Notes
    -----
    The normal is the sum of the area vectors of the triangles, each turned to the side of
    the largest one, so it does not depend on their orientation.
    """
    used = vertices_of(cells)
    p = points[used]
    low, high = p.min(axis=0), p.max(axis=0)
    flat = np.flatnonzero(high == low)
    if flat.size == 1:
        kept = np.delete(np.arange(3), flat[0])
        return PlaneFrame(origin=np.where(high == low, low, 0.0), axes=np.eye(3)[kept])

    corner = points[cells]
    area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.sqrt(_dot(area, area))
    largest = area[int(np.argmax(length))]
    side = np.where(_dot(area, largest) < 0.0, -1.0, 1.0)
    total = (side[:, None] * area).sum(axis=0)
    size = np.sqrt((total * total).sum())
    if size == 0.0:
        msg = (f"got {counted(len(cells), 'cell')} (first: cell 0) with zero area: all triangles "
               "are degenerate; expected triangles in a plane, try removing such cells")
        raise InvalidMeshError(msg)
    normal = total / size
    origin = 0.5 * (low + high)
    distance = np.abs(_dot(p - origin, normal) - _dot(p - origin, normal).mean())
    diagonal = float(np.sqrt(((high - low) ** 2).sum()))
    if (distance > FLATNESS * diagonal).any():
        return None
    origin = origin + _dot(p - origin, normal).mean() * normal
    if 2 * (side < 0).sum() > len(cells):
        normal = -normal
    across = np.eye(3)[int(np.argmin(np.abs(normal)))]
    first = np.cross(across, normal)
    first /= np.sqrt((first * first).sum())
    return PlaneFrame(origin=origin, axes=np.stack([first, np.cross(normal, first)]))


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Row-wise product written out, so that no BLAS decides about the last bit."""
    return np.asarray((a * b).sum(axis=-1))


def _unit_axes(axes: FloatArray) -> list[int] | None:
    kept = np.argmax(axes, axis=1)
    return kept.tolist() if np.array_equal(axes, np.eye(3)[kept]) else None
