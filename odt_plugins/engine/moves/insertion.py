"""Vertices inserted and removed at the worst cells, kept only if a local descent makes it pay.

A vertex comes into the middle of an edge, a facet or a cell, with a cavity that suits it, or goes
by the collapse of an edge.  Flips and Newton steps then descend around the place.  Every operation
at a cell is tried and taken back to the bit; the one with the largest gain is done again and stays.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.moves.cavity import Work, make_work, replace_cavity
from odt_plugins.engine.moves.compound import (
    GAIN,
    LARGEST_STAR,
    Scratch,
    descend_around,
    gather_star,
    make_scratch,
    settle,
    stakes,
    within,
)
from odt_plugins.engine.moves.newton3d import newton_vertex
from odt_plugins.engine.moves.star_cavity import (
    PLACES,
    best_collapse,
    grow_cavity,
    join_facets,
    seed_cavity,
)
from odt_plugins.engine.topology.lookup import is_in
from odt_plugins.mesh.arrays import BoolArray, ByteArray, FloatArray, IntArray, LongArray

GROWTHS = 3
"""How often a cavity grows and the new vertex is moved within it."""
DEEP = 4.0
HOPELESS = 100.0
"""As in ``compound``; a vertex has further to go than a flip."""


@kernel
def propose_vertex(
    points: FloatArray, cells: IntArray, neighbors: IntArray, regions: IntArray,
    status: ByteArray, c: int, place: int, p: int, objective: int, power: float, max_ring: int,
    bounds: FloatArray, work: Work, scratch: Scratch, cavity: IntArray, new: IntArray,
    rows: IntArray,
) -> tuple[float, int, int]:
    """Find cavity, cells and position for a new vertex p at cell c.

    Returns
    -------
    gain : float          cost before minus cost after
    n_old, n_new : int    cells in ``cavity`` and in ``new``; n_new = 0 when p has no place there
    """
    n_old = seed_cavity(
        points, cells, neighbors, regions, status, c, place, p, max_ring, work[0], work[1], cavity
    )
    total = -np.inf
    n_new = 0
    if n_old == 0:
        return total, n_old, n_new
    # numba would compile newton_vertex once more for a literal
    start = np.int64(0)
    for _ in range(GROWTHS):
        n_old = grow_cavity(
            points, cells, neighbors, regions, p, cavity, n_old, objective, power
        )
        total, n_new = join_facets(
            points, cells, neighbors, p, cavity, n_old, objective, power, new
        )
        gain = newton_vertex(
            points, new, rows, start, n_new, p, objective, power, bounds, scratch[5], scratch[6]
        )
        if gain == 0.0:
            break
        total += gain
    return total, n_old, n_new


@kernel
def propose_removal(
    points: FloatArray, cells: IntArray, neighbors: IntArray, locked: BoolArray,
    stays: BoolArray, c: int, v: int, objective: int, power: float, scratch: Scratch,
    cavity: IntArray, new: IntArray,
) -> tuple[float, int, int]:
    """Find the best collapse of an edge at vertex v of cell c; returns as above."""
    star = scratch[1]
    n_old = 0 if locked[v] or stays[v] else gather_star(cells, neighbors, c, v, star)
    if n_old == 0:
        return -np.inf, 0, 0
    for m in range(n_old):
        cavity[m] = star[m]
    total, n_new = best_collapse(points, cells, v, star, n_old, objective, power, new)
    return total, n_old, n_new


@kernel
def surroundings_within(
    points: FloatArray, cells: IntArray, neighbors: IntArray, locked: BoolArray, n_touched: int,
    q: float, large: float, small: float, scratch: Scratch,
) -> bool:
    """:func:`compound.within` for all cells around the vertices of touched cells that can move."""
    touched, star, seen = scratch[0], scratch[1], scratch[4]
    n_seen = 0
    for m in range(n_touched):
        t = touched[m]
        if cells[t, 0] < 0:
            continue
        for a in range(4):
            v = cells[t, a]
            if locked[v] or n_seen == seen.shape[0] or is_in(v, seen, n_seen):
                continue
            seen[n_seen] = v
            n_seen += 1
            size = gather_star(cells, neighbors, t, v, star)
            if not within(points, cells, star, size, q, large, small):
                return False
    return within(points, cells, touched, n_touched, q, large, small)


@allocating_kernel
def insertion_pass(
    points: FloatArray, cells: IntArray, neighbors: IntArray, regions: IntArray,
    locked: BoolArray, status: ByteArray, order: IntArray, slots: LongArray, free: IntArray,
    first: LongArray, stays: BoolArray, objective: int, power: float, max_ring: int,
    bounds: FloatArray, tried: BoolArray,
) -> int:
    """Insert and remove vertices at the cells of ``order``; other arguments as in compound_pass.

    Parameters
    ----------
    points : (n, 3) float64           the last of them free slots for new vertices
    locked : (n,) bool                kept up to date; set for a free slot and a removed vertex
    first : (1,) int64                first free slot, kept up to date
    stays : (n,) bool                 vertices that must not be removed

    Returns
    -------
    int                               number of operations that stayed
    """
    work = make_work(np.empty(0))
    scratch = make_scratch()
    journal = np.zeros((1 << 15, 4), np.int64)
    cavity = np.empty(2 * LARGEST_STAR, np.int32)
    new = np.empty((2 * LARGEST_STAR, 4), np.int32)
    rim = np.empty((8 * LARGEST_STAR, 5), np.int32)
    rows = np.arange(2 * LARGEST_STAR).astype(np.int32)
    operations = PLACES + 4
    taken = 0
    for o in range(order.shape[0]):
        c = order[o]
        if cells[c, 0] < 0 or tried[c]:
            continue
        tried[c] = True
        own, least, most, fewest = stakes(points, cells, c, objective, power, bounds)
        best = 0.0
        chosen = -1
        for trial in range(operations + 1):
            last = trial == operations
            op = chosen if last else trial
            inserts = op < PLACES
            if op < 0 or (inserts and first[0] == points.shape[0]):
                continue
            journal[0, 0] = 0
            if inserts:
                v = np.int32(first[0])
                locked[v] = False
                total, n_old, n_new = propose_vertex(
                    points, cells, neighbors, regions, status, c, op, v, objective, power,
                    max_ring, bounds, work, scratch, cavity, new, rows,
                )
            else:
                v = cells[c, op - PLACES]
                total, n_old, n_new = propose_removal(
                    points, cells, neighbors, locked, stays, c, v, objective, power, scratch,
                    cavity, new,
                )
            final = False
            if total > -HOPELESS * own and replace_cavity(
                cells, neighbors, regions, status, cavity, n_old, new, n_new, slots, free, rim,
                journal,
            ):
                total, n_touched, n_undo = descend_around(
                    points, cells, neighbors, regions, locked, status, slots, free, objective,
                    power, max_ring, bounds, cavity, n_new, total, -DEEP * own, work, journal,
                    scratch,
                )
                good = total > GAIN * own and (last or total > best) and surroundings_within(
                    points, cells, neighbors, locked, n_touched, least, most, fewest, scratch
                )
                final = good and last
                settle(
                    points, cells, neighbors, status, slots, free, final, n_touched, n_undo,
                    journal, scratch, tried,
                )
                if good and not last:
                    best = total
                    chosen = op
            if final:
                taken += 1
            if inserts:
                locked[v] = not final
                first[0] += final
            elif final:
                locked[v] = True
    return taken
