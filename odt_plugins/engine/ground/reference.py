"""The input surface: closest points on it, in double precision, and its triangles for the kernels.

The tree is libigl's ``AABB``. Measured on a surface of 10 000 triangles, per 1e6 points near it, in
seconds of processor time, and the largest error relative to the diagonal against the slow twin of
the tests: libigl 1.2 and 3e-17; point-cloud-utils 1.2 and 3e-17, but it builds its tree again for
every call; open3d's scene 0.9 and 3e-8, in float32; pymeshlab 0.9 and 1e-10; VTK's cell locator 3
to 5 and 2e-17, point by point; CGAL 3.4 and 7e-17, point by point; trimesh 15 and 1e-5.
libigl has wheels for Python 3.11 and later on Linux, macOS and Windows, needs numpy and scipy, is
under MPL 2.0 (its GPL parts are modules of their own, not imported here), works on all cores
(the variable IGL_NUM_THREADS limits them) and keeps the interpreter locked; the result does not
depend on either.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.compiled.threads import pieces
from odt_plugins.engine.ground.closest import Ground
from odt_plugins.engine.topology.star import OffsetArray, vertex_stars
from odt_plugins.errors import InvalidMeshError
from odt_plugins.mesh.arrays import FloatArray, IntArray

FLAT = 1e-10
"""Height over longest edge below which a triangle is its longest edge for the tree, which finds
the closest point of an edge, but not that of three points on a line."""


@kernel
def _across(
    triangles: IntArray, indptr: OffsetArray, indices: IntArray, start: int, stop: int,
    neighbors: IntArray,
) -> None:
    for c in range(start, stop):
        for i in range(3):
            j, k = triangles[c, (i + 1) % 3], triangles[c, (i + 2) % 3]
            found = -1
            end = k if indptr[k + 1] - indptr[k] < indptr[j + 1] - indptr[j] else j
            for s in range(indptr[end], indptr[end + 1]):
                near = indices[s]
                if near == c:
                    continue
                for a in range(3):
                    if triangles[near, a] != j:
                        continue
                    if triangles[near, (a + 2) % 3] == k:
                        found = near if found == -1 else -2
                    elif triangles[near, (a + 1) % 3] == k:
                        found = -2
            neighbors[c, i] = max(found, -1)


def make_surface(points: FloatArray, triangles: IntArray) -> Ground:
    """Lay a triangulated surface out for the kernels.

    Parameters
    ----------
    points : (n, 3) float64
    triangles : (m, 3) int32    any, also degenerate, doubled or unoriented ones

    Returns
    -------
    Ground                      a neighbour is the only other triangle at an edge, and runs through
                                it the other way; the normal of a flat triangle is 0
    """
    points = np.array(points, dtype=np.float64, order="C")
    triangles = np.array(triangles, dtype=np.int32, order="C")
    stars = vertex_stars(triangles, len(points))
    neighbors = np.full(triangles.shape, -1, dtype=np.int32)
    for first, last in pieces(0, len(triangles)):
        _across(triangles, stars.indptr, stars.indices, first, last, neighbors)
    a, b, c = (points[triangles[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    length = np.sqrt((normals * normals).sum(axis=1))
    np.divide(normals, length[:, None], out=normals, where=length[:, None] > 0.0)
    return Ground(points, triangles, neighbors, stars.indptr, stars.indices, normals)


def _without_flat(points: FloatArray, triangles: IntArray) -> IntArray:
    """Triangles, those that are flat replaced by their longest edge, its end twice."""
    sides = points[triangles[:, [2, 0, 1]]] - points[triangles[:, [1, 2, 0]]]
    square = (sides * sides).sum(axis=2)
    area = np.sqrt((np.cross(sides[:, 0], sides[:, 1]) ** 2).sum(axis=1))
    flat = np.flatnonzero(area <= FLAT * square.max(axis=1))
    longest = square[flat].argmax(axis=1)
    start, end = triangles[flat, (longest + 1) % 3], triangles[flat, (longest + 2) % 3]
    replaced = triangles.copy()
    replaced[flat] = np.stack([start, end, end], axis=1)
    return replaced


@dataclass(frozen=True)
class Reference:
    """A surface that distances are measured from; made by :func:`make_reference`.

    Attributes
    ----------
    points : (n, 3) float64
    triangles : (m, 3) int32
    normals : (m, 3) float64    unit normals, 0 on flat triangles
    diagonal : float            of the bounding box of the triangles
    surface : Ground            the same for the kernels
    tree : igl.AABB             of the coordinates relative to ``origin``
    origin : (3,) float64       centre of the bounding box
    """

    points: FloatArray
    triangles: IntArray
    normals: FloatArray
    diagonal: float
    surface: Ground
    tree: Any
    origin: FloatArray
    _local: FloatArray
    _faces: Any

    def closest(self, x: FloatArray) -> tuple[FloatArray, IntArray, FloatArray]:
        """Find the closest point of the surface.

        Parameters
        ----------
        x : (k, 3) float64

        Returns
        -------
        distance : (k,) float64
        face : (k,) int32         triangle with that point; the lowest of several is not promised
        foot : (k, 3) float64     the closest point itself
        """
        if not len(x):
            return np.empty(0), np.empty(0, dtype=np.int32), np.empty((0, 3))
        query = np.ascontiguousarray(np.asarray(x, dtype=np.float64) - self.origin)
        _, face, foot = self.tree.squared_distance(self._local, self._faces, query)
        distance = np.sqrt(((query - foot) ** 2).sum(axis=1))
        return distance, face.astype(np.int32), foot + self.origin


def make_reference(points: FloatArray, triangles: IntArray) -> Reference:
    """Build the tree of a surface.

    Parameters
    ----------
    points : (n, 3) float64     finite; points of no triangle do not count
    triangles : (m, 3) int32    degenerate ones are allowed

    Raises
    ------
    InvalidMeshError            no triangle
    """
    from igl import AABB

    if not len(triangles):
        msg = "got a surface without triangles, expected at least one, try another mesh"
        raise InvalidMeshError(msg)
    surface = make_surface(points, triangles)
    used = surface.points[surface.triangles].reshape(-1, 3)
    low, high = used.min(axis=0), used.max(axis=0)
    origin = 0.5 * (low + high)
    local = surface.points - origin
    faces = _without_flat(local, surface.triangles).astype(np.int64)
    tree = AABB()
    tree.init(local, faces)
    return Reference(
        surface.points, surface.triangles, surface.normals, math.dist(low, high),
        surface, tree, origin, local, faces,
    )
