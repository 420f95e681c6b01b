"""Passes over the cells of a complex: their measures, and flips where they are pending."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from odt_plugins.engine.cells.extremes import Bounds
from odt_plugins.engine.cells.rows import (
    CHUNK,
    ROWS,
    Q,
    dihedral_rows,
    gather_edges,
    quality_rows,
)
from odt_plugins.engine.cells.tetrahedron import DIHEDRAL, ENERGY, QUALITY, Cost, tet_measure
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.compiled.threads import run_ranges
from odt_plugins.engine.moves import flips3d
from odt_plugins.engine.topology.active import pending_slots
from odt_plugins.engine.topology.complex import Complex
from odt_plugins.engine.topology.slabs import side_by_side
from odt_plugins.engine.topology.tets import FULL, Tets
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.chunks import Pool

NO_CELL = 2.0
"""Measure of a free slot, beyond that of any cell."""

BLOCK_BITS = 14
"""The worst cells come first within 2^BLOCK_BITS slots, which lie together in memory."""


@allocating_kernel
def _row_measures(
    points: FloatArray, cells: IntArray, slots: IntArray, objective: int, m: FloatArray,
    start: int, stop: int,
) -> None:
    """As :func:`_slot_measures` for the measures QUALITY and DIHEDRAL, cells side by side."""
    rows = np.empty(ROWS)
    for first in range(start, stop, CHUNK):
        count = min(CHUNK, stop - first)
        gather_edges(points, cells, slots, first, count, rows)
        if objective == QUALITY:
            quality_rows(0.0, 0.0, 0.0, count, rows)
        else:
            dihedral_rows(count, rows)
        for s in range(count):
            m[first + s] = NO_CELL if cells[slots[first + s], 0] < 0 else rows[Q + s]


@kernel
def _slot_measures(
    points: FloatArray, cells: IntArray, slots: IntArray, objective: int, m: FloatArray,
    start: int, stop: int,
) -> None:
    """Write the measures of the cells in slots[start:stop], NO_CELL for a free slot."""
    for s in range(start, stop):
        c = slots[s]
        if cells[c, 0] < 0:
            m[s] = NO_CELL
        else:
            m[s] = tet_measure(
                points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3], objective
            )


def measures(
    mesh: Complex, objective: int, pool: Pool | None = None,
    slots: IntArray | None = None,
) -> FloatArray:
    """Measures of cells, see ``tetrahedron.tet_measure``, NO_CELL for a free slot.

    Parameters
    ----------
    mesh : Complex
    objective : int
    pool                            see ``threads.run_ranges``
    slots : (k,) int32, optional    all that are in use when left out

    Returns
    -------
    (k,) float64
    """
    if slots is None:
        slots = np.arange(mesh.used, dtype=np.int32)
    m = np.empty(len(slots))
    measure = _row_measures if objective in (QUALITY, DIHEDRAL) else _slot_measures
    work = partial(measure, mesh.points, mesh.cells, slots, objective, m)
    run_ranges(pool, len(m), work)
    return m


def worst_first(
    slots: IntArray, measured: Callable[[IntArray], FloatArray], pool: Pool | None
) -> None:
    """Sort slots, which ascend, by what is measured of them within each block of 2^BLOCK_BITS."""
    blocks = int(slots[-1]) >> BLOCK_BITS if slots.size else 0
    ends = np.searchsorted(slots, np.arange(1, blocks + 1) << BLOCK_BITS)
    cuts = [0, *ends.tolist(), len(slots)]

    def sort(first: int, last: int) -> None:
        block = slots[first:last]
        block[:] = block[np.argsort(measured(block), kind="stable")]

    list((map if pool is None else pool.map)(sort, cuts[:-1], cuts[1:]))


def flip_pending(
    mesh: Complex, cost: Cost, max_ring: int, bounds: Bounds, passes: int,
    pool: Pool | None = None,
) -> int:
    """Flip at the pending cells until none is left or the passes are used up."""
    total = 0
    costs = np.zeros(len(mesh.cells))
    for _ in range(passes):
        pending = _pending(mesh, pool)
        if not pending.size:
            break
        if cost.objective != ENERGY:
            measured = partial(measures, mesh, cost.objective, None)
            worst_first(pending, measured, pool)
        flips = side_by_side(
            mesh, pending, pool, partial(_flip_part, mesh, cost, max_ring, bounds, costs)
        )
        total += flips
        if mesh.full:
            grow(mesh)
            costs = np.zeros(len(mesh.cells))
        elif flips == 0:
            break
    return total


def _pending(mesh: Complex, pool: Pool | None) -> IntArray:
    """The pending slots, which ascend."""
    found = np.empty(mesh.used, dtype=np.int32)

    def work(start: int, stop: int) -> IntArray:
        return found[start : start + pending_slots(mesh.cells, mesh.status, found, start, stop)]

    return np.concatenate([found[:0], *run_ranges(pool, mesh.used, work)])


def _flip_part(
    mesh: Complex, cost: Cost, max_ring: int, bounds: Bounds, costs: FloatArray, order: IntArray,
    tets: Tets,
) -> int:
    """Flip at the cells of one slab; no vertex moves, so those at its cuts need not be locked."""
    own = tets._replace(locked=mesh.locked)
    return int(flips3d.flip_pass(own, order, cost, max_ring, bounds, costs, True))


def grow(mesh: Complex) -> None:
    """Give a complex that ran out of room a quarter more."""
    extra = len(mesh.cells) // 4 + 64
    mesh.cells = np.concatenate([mesh.cells, np.full((extra, mesh.dim + 1), -1, dtype=np.int32)])
    mesh.neighbors = np.concatenate(
        [mesh.neighbors, np.full((extra, mesh.dim + 1), -1, dtype=np.int32)]
    )
    mesh.regions = np.concatenate([mesh.regions, np.zeros(extra, dtype=np.int32)])
    mesh.status = np.concatenate([mesh.status, np.zeros(extra, dtype=np.uint8)])
    mesh.free = np.concatenate([mesh.free, np.empty(extra, dtype=np.int32)])
    mesh.slots[FULL] = 0
