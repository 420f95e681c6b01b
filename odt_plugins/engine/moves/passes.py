"""Passes over the cells of a complex: their measures, and flips where they are pending."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from odt_plugins.engine.cells.cost import Cost, is_energy, quality_cost
from odt_plugins.engine.cells.extremes import Bounds
from odt_plugins.engine.cells.measures import QUALITY, slot_measures
from odt_plugins.engine.compiled.threads import run_ranges
from odt_plugins.engine.moves import flips3d
from odt_plugins.engine.topology.active import pending_slots
from odt_plugins.engine.topology.complex import Complex
from odt_plugins.engine.topology.slabs import side_by_side
from odt_plugins.engine.topology.tets import FULL, Tets
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.chunks import Pool

BLOCK_BITS = 14
"""The worst cells come first within 2^BLOCK_BITS slots, which lie together in memory."""

FILLING = (0.75, 0.7, 0.65, 0.6, 0.55, 0.5, 0.45, 0.4, 0.3, 0.2)
"""Radius ratios, about, of the three cells that a flip for more cells leaves, in turn."""

PASSES = 8
"""Most passes of such flips for each of them."""


def measures(
    mesh: Complex, objective: int, pool: Pool | None = None,
    slots: IntArray | None = None,
) -> FloatArray:
    """Measures of cells, see ``measures.tet_measure``, NO_CELL for a free slot.

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
    work = partial(slot_measures, mesh.points, mesh.cells, slots, objective, m)
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
        if not is_energy.py_func(cost.objective):
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


def more_cells(mesh: Complex, count: int, bounds: Bounds) -> int:
    """Make about so many cells more by 2-3 flips, those first that leave the best cells.

    Returns
    -------
    int    how many came
    """
    total, cost = 0, Cost(QUALITY, 1.0)
    for quality in FILLING:
        limit = 3.0 * float(quality_cost.py_func(quality, cost.power))
        for _ in range(PASSES):
            order = mesh.live().astype(np.int32)
            flips = flips3d.facet_pass(
                mesh.tets, order, count - total, limit, cost, bounds, np.zeros(len(mesh.cells)))
            total += flips
            if mesh.full:
                grow(mesh)
            elif not flips or total == count:
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
