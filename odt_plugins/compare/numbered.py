"""Meshes as the engine works on them: numbered along a curve, all but the boundary free."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odt_plugins.mesh.arrays import FloatArray, IntArray

if TYPE_CHECKING:
    from odt_plugins.engine.topology.stencil import Topology


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
