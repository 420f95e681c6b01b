"""Meshes of a size, and meshes as the engine works on them: along a curve, all but the rim free."""

from __future__ import annotations

from itertools import permutations
from typing import TYPE_CHECKING

import numpy as np

from odt_plugins.compare.start import StartMesh, ball, pebble
from odt_plugins.figures import volumes
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.simplex import reverse

if TYPE_CHECKING:
    from odt_plugins.engine.topology.stencil import Topology


CELLS_PER_VERTEX = 6.2
"""Of a Delaunay mesh of random points in a ball, boundary included."""


def ball_of(cells: int) -> StartMesh:
    """Give a :func:`ball` of about so many tetrahedra."""
    return ball(max(round(cells / CELLS_PER_VERTEX), 50))


def pebble_of(cells: int) -> StartMesh:
    """Give a :func:`pebble` of about so many triangles: twice its vertices less four (Euler)."""
    return pebble(max(cells // 2 + 2, 50))


def kuhn_lattice(side: int) -> tuple[FloatArray, IntArray]:
    """Lattice of side^3 unit cubes, each cut into six tetrahedra along its diagonal.

    Returns
    -------
    points ((side + 1)^3, 3), cells (6 side^3, 4), positive
    """
    axis = np.arange(side + 1)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    stride = np.array([(side + 1) ** 2, side + 1, 1])
    corner = grid[(grid < side).all(axis=1)] @ stride
    steps = [np.concatenate([[0], np.cumsum(stride[list(order)])])
             for order in permutations(range(3))]
    cells = np.concatenate([corner[:, None] + step for step in steps]).astype(np.int32)
    points = grid.astype(np.float64)
    turned: IntArray = reverse(cells, volumes(points, cells) < 0)
    return points, np.ascontiguousarray(turned)


def along_curve(points: FloatArray, cells: IntArray) -> tuple[IntArray, IntArray]:
    """Number the vertices and the cells so that neighbours in space are neighbours in memory.

    Parameters
    ----------
    points : (n, d) float64, cells : (m, d + 1) int32

    Returns
    -------
    vertices : (n,) int32          old number of every new vertex
    cells : (m, d + 1) int32       in their new order, of new vertices
    """
    from odt_plugins.engine.topology.order import curve_order

    vertices, order = curve_order(points, cells)
    rank = np.argsort(vertices).astype(np.int32)
    return vertices, np.ascontiguousarray(rank[cells[order]])


def inside_free(cells: IntArray, n_points: int) -> Topology:
    """Connectivity with every vertex free that is not on the boundary."""
    from odt_plugins.engine.cells.geometry import boundary_vertices
    from odt_plugins.engine.topology.stencil import make_topology

    rim = boundary_vertices(cells, n_points)
    return make_topology(cells, ~rim, rim)
