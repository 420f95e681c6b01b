"""The mesh while it is being changed: connectivity with adjacency kept up to date by the flips."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.compiled.threads import run_ranges
from odt_plugins.engine.topology.adjacency import cell_neighbors
from odt_plugins.engine.topology.order import by_lowest_vertex, make_slabs
from odt_plugins.engine.topology.star import Stars, vertex_stars
from odt_plugins.engine.topology.tets import FREE, FULL, USED, Tets
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.chunks import Pool


class Cells(NamedTuple):
    """What is known of every cell: its vertices and neighbours, (room, d + 1), and its label."""

    cells: IntArray
    neighbors: IntArray
    regions: IntArray


@dataclass
class Complex:
    """Cells with adjacency, in slots of which some may be free.

    Attributes
    ----------
    points : (n, d) float64           moved in place by the kernels; more columns as in
                                      ``cells.metric``
    locked : (n,) bool                vertices that may not move
    boundary : (n,) bool                   vertices on the boundary or an interface
    cells : (room, d + 1) int32       -1 in column 0 of a free slot
    neighbors : (room, d + 1) int32   cell opposite to local vertex i, -1 outside
    regions : (room,) int32
    status : (room,) uint8            1 where a flip is to be tried
    slots : (3,) int64                see ``tets.USED``, ``tets.FREE`` and ``tets.FULL``
    free : (room,) int32              stack of free slots
    skin : Skin or None               the boundary, when it may slide
    shares : (2, n) uint8 or None     see :meth:`slabs`
    """

    points: FloatArray
    locked: BoolArray
    boundary: BoolArray
    cells: IntArray
    neighbors: IntArray
    regions: IntArray
    status: NDArray[np.uint8]
    slots: NDArray[np.int64]
    free: IntArray
    skin: Any = None
    shares: NDArray[np.uint8] | None = None

    @property
    def dim(self) -> int:
        """Dimension d of the space."""
        return int(self.cells.shape[1]) - 1

    def slabs(self) -> NDArray[np.uint8]:
        """Slabs of the vertices, see ``order.make_slabs``, by where they were at the first call."""
        if self.shares is None or self.shares.shape[1] != len(self.points):
            self.shares = make_slabs(self.points[:, : self.dim])
        return self.shares

    @property
    def tets(self) -> Tets:
        """The arrays as kernels take them (d = 3)."""
        return Tets(self.points, self.cells, self.neighbors, self.regions, self.locked,
                    self.status, self.slots, self.free)

    @property
    def used(self) -> int:
        """Number of slots in use, free ones among them."""
        return int(self.slots[USED])

    @property
    def full(self) -> bool:
        """Whether a kernel found no room."""
        return bool(self.slots[FULL])

    def count(self) -> int:
        """Number of cells."""
        return self.used - int(self.slots[FREE])

    def live(self) -> NDArray[np.intp]:
        """Slots that hold a cell."""
        return np.flatnonzero(self.cells[: self.used, 0] >= 0)

    def mesh_arrays(self) -> tuple[IntArray, IntArray]:
        """Cells and regions without the free slots."""
        live = self.live()
        return np.take(self.cells, live, axis=0), self.regions[live]


def make_complex(
    points: FloatArray, cells: IntArray, regions: IntArray, locked: BoolArray, boundary: BoolArray,
    skin: Any = None, neighbors: IntArray | None = None,
) -> Complex:
    """Build the adjacency of a valid mesh, with room for flips that add cells.

    Parameters
    ----------
    points : (n, d) float64          kept by reference
    cells : (m, d + 1) int32, regions : (m,) int32
    locked, boundary : (n,) bool
    skin : Skin, optional            kept by reference
    neighbors : (m, d + 1) int32, optional    of the cells, when already known
    """
    if neighbors is None:
        neighbors = cell_neighbors(cells, vertex_stars(cells, len(points)))
    mesh = _with_room(len(cells), cells.shape[1], points, locked, boundary, skin)
    mesh.cells[: mesh.used] = cells
    mesh.neighbors[: mesh.used] = neighbors
    mesh.regions[: mesh.used] = regions
    return mesh


def _with_room(
    m: int, k: int, points: FloatArray, locked: BoolArray, boundary: BoolArray, skin: Any
) -> Complex:
    """Slots for m cells of k vertices, which are to be filled in, an eighth more in space."""
    room = m if k == 3 else m + m // 8 + 64
    cells, neighbors = np.empty((2, room, k), dtype=np.int32)
    cells[m:] = neighbors[m:] = -1
    return Complex(
        points,
        locked,
        boundary,
        cells,
        neighbors,
        np.zeros(room, dtype=np.int32),
        np.zeros(room, dtype=np.uint8),
        np.array([m, 0, 0], dtype=np.int64),
        np.empty(room, dtype=np.int32),
        skin,
    )


@kernel
def _copy_cells(
    old: Cells, order: IntArray, rank: IntArray, new: Cells, start: int, stop: int
) -> None:
    """Copy the cells order[start:stop] to these places; ``rank`` is the new number of every one."""
    for i in range(start, stop):
        c = order[i]
        new.regions[i] = old.regions[c]
        for a in range(old.cells.shape[1]):
            new.cells[i, a] = old.cells[c, a]
            across = old.neighbors[c, a]
            new.neighbors[i, a] = rank[across] if across >= 0 else -1


def renumbered(mesh: Complex, pool: Pool | None = None) -> Complex:
    """Return the same mesh without free slots, its cells by their smallest vertex, nothing pending.

    Flips scatter the cells around a vertex over the memory; this brings them together again.
    ``pool`` as in ``threads.run_ranges``.
    """
    order = by_lowest_vertex(mesh.cells[: mesh.used], len(mesh.points))
    rank = np.empty(mesh.used, dtype=np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    fresh = _with_room(
        len(order), mesh.dim + 1, mesh.points, mesh.locked, mesh.boundary, mesh.skin
    )
    old, new = (Cells(each.cells, each.neighbors, each.regions) for each in (mesh, fresh))
    run_ranges(pool, len(order), partial(_copy_cells, old, order, rank, new))
    fresh.shares = mesh.shares
    return fresh


def slot_stars(mesh: Complex, pool: Pool | None = None) -> Stars:
    """List the slots of the cells around every vertex; free slots belong to none."""
    return vertex_stars(mesh.cells[: mesh.used], len(mesh.points), pool)
