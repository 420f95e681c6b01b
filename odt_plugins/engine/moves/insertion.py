"""Vertices inserted and removed at the worst cells, kept only if a local descent makes it pay.

A vertex comes into the middle of an edge, a facet or a cell, with a cavity that suits it, or goes
by the collapse of an edge.  Flips and Newton steps then descend around the place.  Every operation
at a cell is tried and taken back to the bit; the one with the largest gain is done again and stays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.extremes import Bounds, Extremes
from odt_plugins.engine.cells.tetrahedron import Cost
from odt_plugins.engine.compiled.kernel import allocating_kernel, inner_kernel
from odt_plugins.engine.moves.cavity import replace_cavity
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
from odt_plugins.engine.topology.tets import Tets
from odt_plugins.mesh.arrays import BoolArray, IntArray, LongArray

GROWTHS = 3
"""How often a cavity grows and the new vertex is moved within it."""
DEEP = 4.0
HOPELESS = 100.0
"""As in ``compound``; a vertex has further to go than a flip."""


class Proposal(NamedTuple):
    """Room for an operation that is looked at; made by :func:`make_proposal`.

    Attributes
    ----------
    cavity : (k,) int32         cells that would go
    new : (k, 4) int32          vertices of the cells that would come
    rows : (k,) int32           0, 1, ...: these cells as a star
    border : (4 k, 5) int32     see ``cavity.replace_cavity``
    """

    cavity: IntArray
    new: IntArray
    rows: IntArray
    border: IntArray


@allocating_kernel
def make_proposal() -> Proposal:
    """Room for one thread."""
    return Proposal(
        np.empty(2 * LARGEST_STAR, np.int32),
        np.empty((2 * LARGEST_STAR, 4), np.int32),
        np.arange(2 * LARGEST_STAR).astype(np.int32),
        np.empty((8 * LARGEST_STAR, 5), np.int32),
    )


@inner_kernel
def propose_vertex(
    tets: Tets, c: int, place: int, p: int, cost: Cost, max_ring: int, bounds: Bounds,
    scratch: Scratch, proposal: Proposal,
) -> tuple[float, int, int]:
    """Find cavity, cells and position for a new vertex p at cell c.

    Returns
    -------
    gain : float          cost before minus cost after
    n_old, n_new : int    cells in ``cavity`` and in ``new``; n_new = 0 when p has no place there
    """
    cavity, new = proposal.cavity, proposal.new
    n_old = seed_cavity(tets, c, place, p, max_ring, scratch.ring, cavity)
    total = -np.inf
    n_new = 0
    if n_old == 0:
        return total, n_old, n_new
    # numba would compile newton_vertex once more for a literal
    start = np.int64(0)
    for _ in range(GROWTHS):
        n_old = grow_cavity(tets, p, cavity, n_old, cost)
        total, n_new = join_facets(tets, p, cavity, n_old, cost, new)
        gain = newton_vertex(
            tets.points, new, proposal.rows, start, n_new, p, cost, bounds.cells,
            scratch.derivatives,
        )
        if gain == 0.0:
            break
        total += gain
    return total, n_old, n_new


@inner_kernel
def propose_removal(
    tets: Tets, stays: BoolArray, c: int, v: int, cost: Cost, scratch: Scratch, proposal: Proposal
) -> tuple[float, int, int]:
    """Find the best collapse of an edge at vertex v of cell c; returns as above."""
    star, cavity = scratch.star, proposal.cavity
    kept = tets.locked[v] or stays[v]
    n_old = 0 if kept else gather_star(tets.cells, tets.neighbors, c, v, star)
    if n_old == 0:
        return -np.inf, 0, 0
    for m in range(n_old):
        cavity[m] = star[m]
    total, n_new = best_collapse(tets, v, star, n_old, cost, proposal.new)
    return total, n_old, n_new


@inner_kernel
def surroundings_within(tets: Tets, n_touched: int, limit: Extremes, scratch: Scratch) -> bool:
    """:func:`compound.within` for all cells around the vertices of touched cells that can move."""
    cells = tets.cells
    touched, star, seen = scratch.touched, scratch.star, scratch.seen
    n_seen = np.int64(0)
    for m in range(n_touched):
        t = touched[m]
        if cells[t, 0] < 0:
            continue
        for a in range(4):
            v = cells[t, a]
            if tets.locked[v] or n_seen == seen.shape[0] or is_in(v, seen, n_seen):
                continue
            seen[n_seen] = v
            n_seen += 1
            size = gather_star(cells, tets.neighbors, t, v, star)
            if not within(tets, star, size, limit):
                return False
    return within(tets, touched, n_touched, limit)


@allocating_kernel
def insertion_pass(
    tets: Tets, first: LongArray, stays: BoolArray, order: IntArray, cost: Cost, max_ring: int,
    bounds: Bounds, tried: BoolArray,
) -> int:
    """Insert and remove vertices at the cells of ``order``; other arguments as in compound_pass.

    Parameters
    ----------
    tets : Tets         its last points are free slots for new vertices; ``locked`` is kept up to
                        date, and set for a free slot and a removed vertex
    first : (1,) int64  first free slot, kept up to date
    stays : (n,) bool   vertices that must not be removed

    Returns
    -------
    int                 number of operations that stayed
    """
    scratch = make_scratch(np.int64(1 << 15))
    proposal = make_proposal()
    locked, journal = tets.locked, scratch.journal
    operations = PLACES + 4
    taken = 0
    for o in range(order.shape[0]):
        c = order[o]
        if tets.cells[c, 0] < 0 or tried[c]:
            continue
        tried[c] = True
        own, limit = stakes(tets, c, cost, bounds)
        best = 0.0
        chosen = -1
        for trial in range(operations + 1):
            last = trial == operations
            op = chosen if last else trial
            inserts = op < PLACES
            if op < 0 or (inserts and first[0] == tets.points.shape[0]):
                continue
            journal.length[0] = 0
            if inserts:
                v = np.int32(first[0])
                locked[v] = False
                total, n_old, n_new = propose_vertex(
                    tets, c, op, v, cost, max_ring, bounds, scratch, proposal
                )
            else:
                v = tets.cells[c, op - PLACES]
                total, n_old, n_new = propose_removal(
                    tets, stays, c, v, cost, scratch, proposal
                )
            final = False
            if total > -HOPELESS * own and replace_cavity(
                tets, proposal.cavity, n_old, proposal.new, n_new, proposal.border, journal
            ):
                total, n_touched, n_moved = descend_around(
                    tets, cost, max_ring, bounds, proposal.cavity, n_new, total, -DEEP * own,
                    scratch,
                )
                good = total > GAIN * own and (last or total > best) and surroundings_within(
                    tets, n_touched, limit, scratch
                )
                final = good and last
                settle(tets, final, n_touched, n_moved, scratch, tried)
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
