"""Which vertices and cells are worth a visit: those whose surroundings changed."""

from __future__ import annotations

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.mesh.arrays import BoolArray, ByteArray, FloatArray, IntArray, LongArray

IDLE, PENDING, DONE = 0, 1, 2
"""Status of a cell: nothing to do, to be visited, visited in this pass."""


@kernel
def vertices_of_pending(cells: IntArray, status: ByteArray, active: BoolArray) -> None:
    """Mark the vertices of all pending cells."""
    for c in range(cells.shape[0]):
        if status[c] == PENDING and cells[c, 0] >= 0:
            for a in range(cells.shape[1]):
                active[cells[c, a]] = True


@kernel
def pending_slots(
    cells: IntArray, status: ByteArray, found: IntArray, start: int, stop: int
) -> int:
    """Write the pending slots from start to stop into ``found`` from start on; their number."""
    count = 0
    for c in range(start, stop):
        if status[c] == PENDING and cells[c, 0] >= 0:
            found[start + count] = c
            count += 1
    return count


@kernel
def around_vertices(cells: IntArray, touched: BoolArray, status: ByteArray) -> None:
    """Make the cells pending that have a touched vertex."""
    for c in range(cells.shape[0]):
        if cells[c, 0] < 0:
            continue
        for a in range(cells.shape[1]):
            if touched[cells[c, a]]:
                status[c] = PENDING
                break


@kernel
def spread(
    cells: IntArray, indptr: LongArray, indices: IntArray, moved: FloatArray, tolerance: float,
    active: BoolArray, status: ByteArray,
) -> int:
    """Start the next round from the vertices whose move paid off.

    Every vertex that shares a cell with a vertex of ``moved > tolerance`` becomes active, all
    others passive; the cells around such a vertex become pending.  Returns the number of them.
    """
    n = moved.shape[0]
    for v in range(n):
        active[v] = False
    count = 0
    for v in range(n):
        if moved[v] > tolerance:
            count += 1
            for s in range(indptr[v], indptr[v + 1]):
                c = indices[s]
                status[c] = PENDING
                for a in range(cells.shape[1]):
                    active[cells[c, a]] = True
    return count
