"""Numbering and unit of a mesh inside the engine, and the way back."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.topology.order import curve_order
from odt_plugins.errors import EndlessWalkError, endless_walk
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.seen import full
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.mesh.symmetric import exponentials


@contextmanager
def callers_vertices(mesh: SimplexMesh) -> Iterator[None]:
    """Name the vertex of an error as the caller does, where vertices are numbered by a Frame."""
    try:
        yield
    except EndlessWalkError as exc:
        raise endless_walk(int(make_frame(mesh)[0].vertices[exc.vertex])) from exc


@dataclass(frozen=True)
class Frame:
    """Numbering and unit inside the engine, and the way back.

    Attributes
    ----------
    vertices : (k,) int32     caller's index of every inner vertex
    active : (m1,) int64      caller's index of every inner cell, all but the frozen ones
    centre : (d,) float64, scale : float
        inner coordinates are (x - centre) * scale, with nothing rounded: scale is a power of two,
        and along an axis where a difference from the middle would be rounded the centre is 0
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
        return points / self.scale + self.centre

    def inner_neighbors(self, neighbors: IntArray) -> IntArray:
        """Cells across the facets of inner cells from those of the caller's, (m, d + 1) int32."""
        rank = np.full(len(neighbors) + 1, -1, dtype=np.int32)
        rank[self.active] = np.arange(len(self.active), dtype=np.int32)
        return rank[np.take(neighbors, self.active, axis=0)]


def make_frame(mesh: SimplexMesh) -> tuple[Frame, IntArray]:
    """Leave out frozen cells and unused vertices, number along a curve, scale to unit size.

    Returns
    -------
    Frame, and the inner cells (m1, d + 1) int32

    Notes
    -----
    Nothing is rounded, so that cells of any size have the volumes that they have outside. The curve
    is one through the vertices as a metric sees them on average.
    """
    active = np.flatnonzero(~mesh.frozen)
    cells = mesh.cells[active]
    mask = np.zeros(len(mesh.points), dtype=np.bool_)
    mask[cells.ravel()] = True
    used = np.flatnonzero(mask).astype(np.int32)
    inner = (np.cumsum(mask, dtype=np.int32) - 1)[cells]
    points = mesh.points[used]
    places = points
    if len(mesh.metric):
        mean = mesh.metric[used].mean(axis=0, keepdims=True)
        places = (points[:, None, :] * exponentials(full(mean))).sum(axis=2)
    vertices, order = curve_order(places, inner)
    rank = np.empty(len(used), dtype=np.int32)
    rank[vertices] = np.arange(len(used), dtype=np.int32)
    span = float(np.ptp(points, axis=0).max())
    centre = np.array([_exact_centre(x) for x in points.T])
    frame = Frame(used[vertices], active[order], centre, 0.5 ** math.frexp(span)[1])
    return frame, rank[np.take(inner, order, axis=0)]


def _exact_centre(x: FloatArray) -> float:
    """The middle of some numbers, or 0 where a difference from the middle would be rounded.

    Notes
    -----
    Numbers far from 0, with x / 2 <= c <= 2 x, have exact differences from c.

    References
    ----------
    P. H. Sterbenz, Floating-Point Computation, Prentice-Hall (1974), Section 4.3.
    D. E. Knuth, The Art of Computer Programming 2, Section 4.2.2, Theorem B: the error of a sum.
    """
    middle = 0.5 * (float(x.min()) + float(x.max()))
    moved = x - middle
    back = moved - x
    error = (x - (moved - back)) - (middle + back)
    return 0.0 if error.any() else middle
