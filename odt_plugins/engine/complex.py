"""The mesh while it is being changed: connectivity with adjacency kept up to date by the flips."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.adjacency import cell_neighbors
from odt_plugins.engine.skin import Skin
from odt_plugins.engine.star import Stars, vertex_stars
from odt_plugins.mesh import BoolArray, FloatArray, IntArray

PENDING = np.uint8(1)


@dataclass
class Complex:
    """Cells with adjacency, in slots of which some may be free.

    Attributes
    ----------
    points : (n, d) float64           moved in place by the kernels
    locked : (n,) bool                vertices that may not move
    rim : (n,) bool                   vertices on the boundary or an interface
    cells : (room, d + 1) int32       -1 in column 0 of a free slot
    neighbors : (room, d + 1) int32   cell opposite to local vertex i, -1 outside
    regions : (room,) int32
    status : (room,) uint8            1 where a flip is to be tried
    slots : (3,) int64                slots in use, free slots among them, out of room
    free : (room,) int32              stack of free slots
    skin : Skin or None               the boundary, when it may slide
    """

    points: FloatArray
    locked: BoolArray
    rim: BoolArray
    cells: IntArray
    neighbors: IntArray
    regions: IntArray
    status: NDArray[np.uint8]
    slots: NDArray[np.int64]
    free: IntArray
    skin: Skin | None = None

    @property
    def dim(self) -> int:
        """Dimension d of the space."""
        return int(self.points.shape[1])

    def live(self) -> NDArray[np.intp]:
        """Slots that hold a cell."""
        return np.flatnonzero(self.cells[: self.slots[0], 0] >= 0)

    def mesh_arrays(self) -> tuple[IntArray, IntArray]:
        """Cells and regions without the free slots."""
        live = self.live()
        return np.ascontiguousarray(self.cells[live]), self.regions[live].copy()


def make_complex(
    points: FloatArray, cells: IntArray, regions: IntArray, locked: BoolArray, rim: BoolArray,
    skin: Skin | None = None,
) -> Complex:
    """Build the adjacency of a valid mesh, with room for flips that add cells.

    Parameters
    ----------
    points : (n, d) float64          kept by reference
    cells : (m, d + 1) int32, regions : (m,) int32
    locked, rim : (n,) bool
    skin : Skin, optional            kept by reference
    """
    m = len(cells)
    room = m if cells.shape[1] == 3 else m + m // 8 + 64
    stars = vertex_stars(cells, len(points))
    slots = np.full((room, cells.shape[1]), -1, dtype=np.int32)
    slots[:m] = cells
    neighbors = np.full_like(slots, -1)
    neighbors[:m] = cell_neighbors(cells, stars)
    labels = np.zeros(room, dtype=np.int32)
    labels[:m] = regions
    return Complex(
        points,
        locked,
        rim,
        slots,
        neighbors,
        labels,
        np.zeros(room, dtype=np.uint8),
        np.array([m, 0, 0], dtype=np.int64),
        np.empty(room, dtype=np.int32),
        skin,
    )


def compacted(mesh: Complex) -> Complex:
    """Return the same mesh without free slots, with fresh room."""
    cells, regions = mesh.mesh_arrays()
    status = mesh.status[mesh.live()]
    fresh = make_complex(mesh.points, cells, regions, mesh.locked, mesh.rim, mesh.skin)
    fresh.status[: len(cells)] = status
    return fresh


def slot_stars(mesh: Complex) -> Stars:
    """List the slots of the cells around every vertex; free slots belong to none."""
    return vertex_stars(mesh.cells[: mesh.slots[0]], len(mesh.points))
