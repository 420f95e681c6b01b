"""The arrays of triangles that travel together through the kernels."""

from __future__ import annotations

from typing import NamedTuple

from odt_plugins.mesh.arrays import FloatArray, IntArray


class Triangles(NamedTuple):
    """A mesh of triangles, planar or in space, that is changed in place.

    Attributes
    ----------
    points : (n, d) float64
    cells : (m, 3) int32        counterclockwise, or oriented alike in space
    neighbors : (m, 3) int32    cell across the edge opposite each vertex, -1 at the boundary
    regions : (m,) int32        region labels; the label of a row does not change
    """

    points: FloatArray
    cells: IntArray
    neighbors: IntArray
    regions: IntArray


class EdgeNumbers(NamedTuple):
    """Numbers of the edges of triangles; an edge keeps its number when it is flipped.

    Attributes
    ----------
    of_cell : (m, 3) int32    number of the edge opposite each vertex
    cell : (e,) int32         a cell of each
    """

    of_cell: IntArray
    cell: IntArray
