"""The arrays of a tetrahedral mesh that travel together through the kernels."""

from __future__ import annotations

from typing import NamedTuple

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.mesh.arrays import BoolArray, ByteArray, FloatArray, IntArray, LongArray

USED, FREE, FULL = 0, 1, 2
"""Entries of ``Tets.slots``: slots in use, free slots among them, 1 when there was no room."""


class Tets(NamedTuple):
    """A tetrahedral mesh, or what one thread may use of it; see ``complex.Complex``.

    Attributes
    ----------
    points : (n, 3) float64
    cells : (room, 4) int32        -1 in column 0 of a free slot
    neighbors : (room, 4) int32    cell opposite to local vertex i; negative where there is none
    regions : (room,) int32
    locked : (n,) bool             vertices that may not move
    status : (room,) uint8         IDLE, PENDING or DONE
    slots : (3,) int64             see :data:`USED`, :data:`FREE`, :data:`FULL`
    free : (room,) int32           stack of free slots
    """

    points: FloatArray
    cells: IntArray
    neighbors: IntArray
    regions: IntArray
    locked: BoolArray
    status: ByteArray
    slots: LongArray
    free: IntArray


@kernel
def has_room(tets: Tets, more: int) -> bool:
    """Whether there are so many slots for further cells; what is missing is written down."""
    slots = tets.slots
    if more > slots[FREE] + tets.cells.shape[0] - slots[USED]:
        slots[FULL] = 1
        return False
    return True


@kernel
def take_slot(tets: Tets) -> int:
    """Slot for a further cell."""
    slots = tets.slots
    if slots[FREE] > 0:
        slots[FREE] -= 1
        return tets.free[slots[FREE]]
    slots[USED] += 1
    return slots[USED] - 1


@kernel
def give_slot(tets: Tets, c: int) -> None:
    """Free the slot of cell c."""
    tets.cells[c, 0] = -1
    tets.free[tets.slots[FREE]] = c
    tets.slots[FREE] += 1


@kernel
def all_locked(tets: Tets, a: int, b: int, c: int, d: int) -> bool:
    """Whether no vertex of cell (a, b, c, d) may move."""
    locked = tets.locked
    return locked[a] and locked[b] and locked[c] and locked[d]
