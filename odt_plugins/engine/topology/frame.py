"""Numbering and unit of a mesh inside the engine, and the way back."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.topology.order import curve_order
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.simplex import SimplexMesh


@dataclass(frozen=True)
class Frame:
    """Numbering and unit inside the engine, and the way back.

    Attributes
    ----------
    vertices : (k,) int32     caller's index of every inner vertex
    active : (m1,) int64      caller's index of every inner cell, all but the frozen ones
    centre : (d,) float64, scale : float
        inner coordinates are (x - centre) * scale, scale a power of two
    """

    vertices: IntArray
    active: NDArray[np.int64]
    centre: FloatArray
    scale: float

    def inside(self, points: FloatArray) -> FloatArray:
        """Inner coordinates of the caller's points."""
        return np.ascontiguousarray((points - self.centre) * self.scale)

    def outside(self, points: FloatArray) -> FloatArray:
        """Caller's coordinates of inner points."""
        moved: FloatArray = points / self.scale + self.centre
        return moved

    def inner_neighbors(self, neighbors: IntArray) -> IntArray:
        """Cells across the facets of inner cells from those of the caller's, (m, d + 1) int32."""
        rank = np.full(len(neighbors) + 1, -1, dtype=np.int32)
        rank[self.active] = np.arange(len(self.active), dtype=np.int32)
        inner: IntArray = rank[np.take(neighbors, self.active, axis=0)]
        return inner


def make_frame(mesh: SimplexMesh) -> tuple[Frame, IntArray]:
    """Leave out frozen cells and unused vertices, number along a curve, scale to unit size.

    Returns
    -------
    Frame, and the inner cells (m1, d + 1) int32
    """
    active = np.flatnonzero(~mesh.frozen)
    cells = mesh.cells[active]
    mask = np.zeros(len(mesh.points), dtype=np.bool_)
    mask[cells.ravel()] = True
    used = np.flatnonzero(mask).astype(np.int32)
    inner = (np.cumsum(mask, dtype=np.int32) - 1)[cells]
    points = mesh.points[used]
    vertices, order = curve_order(points, inner)
    rank = np.empty(len(used), dtype=np.int32)
    rank[vertices] = np.arange(len(used), dtype=np.int32)
    low, high = points.min(axis=0), points.max(axis=0)
    span = float((high - low).max())
    scale = 2.0 ** -round(math.log2(span)) if span > 0.0 else 1.0
    frame = Frame(used[vertices], active[order], 0.5 * (low + high), scale)
    return frame, rank[np.take(inner, order, axis=0)]
