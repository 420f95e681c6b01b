"""Vertices inserted and removed at the worst cells, kept only if a local descent makes it pay.

A vertex comes into the middle of an edge, a facet or a cell, with a cavity that suits it, or goes
by the collapse of an edge.  Flips and Newton steps then descend around the place.  Every operation
at a cell is tried and taken back to the bit; the one with the largest gain is done again and stays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Bounds, Extremes, keeps
from odt_plugins.engine.cells.measures import cell_extremes
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.moves.cavity import STATUS, local_edge, replace_cavity
from odt_plugins.engine.moves.compound import (
    LARGEST_STAR,
    Scratch,
    descend_around,
    gather_star,
    make_scratch,
    settle,
    stakes,
)
from odt_plugins.engine.moves.newton3d import newton_vertex
from odt_plugins.engine.moves.star_cavity import (
    PLACES,
    best_collapse,
    grow_cavity,
    join_facets,
    seed_cavity,
)
from odt_plugins.engine.moves.worth import Weights, worth_of_cell
from odt_plugins.engine.topology.lookup import is_in
from odt_plugins.engine.topology.tets import FULL, Tets
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray, LongArray

GROWTHS = 5
"""How often a cavity grows and the new vertex is moved within it."""
DEEP = 4.0
HOPELESS = 100.0
"""As in ``compound``; a vertex has further to go than a flip."""


class Step(NamedTuple):
    """How operations are made and what they must gain.

    Attributes
    ----------
    cost : Cost        of the cells, for the descents
    max_ring : int     longest ring of an edge that is removed
    looks : int        operations at a cell that are tried, see :func:`order_operations`
    first : bool       whether the first one that pays stays, else the best one does
    price : float      worth that a new vertex must gain
    least : float      worth that the removal of a vertex must gain
    """

    cost: Cost
    max_ring: int
    looks: int
    first: bool
    price: float
    least: float


class Ledger(NamedTuple):
    """Vertices that may come and go, and what the cells are worth.

    Attributes
    ----------
    first : (1,) int64         first free slot for a new vertex
    stays : (n,) bool          vertices that must not be removed
    worth : (room,) float64    of every cell, 0 for a free slot
    marks : (room,) int64      the last zone that a cell was in
    turn : (1,) int64          zones so far
    zone : (k,) int64          cells that an operation changed
    values : (k,) float64      their worth
    """

    first: LongArray
    stays: BoolArray
    worth: FloatArray
    marks: LongArray
    turn: LongArray
    zone: LongArray
    values: FloatArray


class Room(NamedTuple):
    """Room for one thread; made by :func:`make_room`.

    Attributes
    ----------
    scratch : Scratch
    proposal : Proposal
    ops : (15,) int64          operations in their order
    lengths : (6,) float64     squared lengths of edges
    """

    scratch: Scratch
    proposal: Proposal
    ops: LongArray
    lengths: FloatArray


class Proposal(NamedTuple):
    """Room for an operation that is looked at; made by :func:`make_proposal`.

    Attributes
    ----------
    cavity : (k,) int32         cells that would go
    new : (k, 4) int32          vertices of the cells that would come
    rows : (k,) int32           0, 1, ...: these cells as a star
    border : (4 k, 5) int32     see ``cavity.replace_cavity``
    sizes : (2,) int64          number of cells that would go, and that would come
    """

    cavity: IntArray
    new: IntArray
    rows: IntArray
    border: IntArray
    sizes: LongArray


@allocating_kernel
def make_proposal() -> Proposal:
    """Room for one thread."""
    return Proposal(
        np.empty(2 * LARGEST_STAR, np.int32),
        np.empty((2 * LARGEST_STAR, 4), np.int32),
        np.arange(2 * LARGEST_STAR).astype(np.int32),
        np.empty((8 * LARGEST_STAR, 5), np.int32),
        np.zeros(2, np.int64),
    )


@allocating_kernel
def make_room() -> Room:
    """Room for one thread."""
    return Room(
        make_scratch(np.int64(1 << 15)), make_proposal(), np.empty(PLACES + 4, np.int64),
        np.empty(6),
    )


@kernel
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


@kernel
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


@kernel
def add_to_zone(c: int, ledger: Ledger, n: int) -> int:
    """Put cell c into the zone, once; the number of cells in it."""
    if ledger.marks[c] == ledger.turn[0] or n == ledger.zone.shape[0]:
        return n
    ledger.marks[c] = ledger.turn[0]
    ledger.zone[n] = c
    return n + 1


@kernel
def judge(
    tets: Tets, n_touched: int, limit: Extremes, weights: Weights, ledger: Ledger, scratch: Scratch
) -> tuple[float, int]:
    """Compare all cells that an operation and the descent after it changed with what was there.

    Returns
    -------
    gain : float    of their worth, -inf where a cell passes the limit
    n : int         cells in the zone
    """
    cells, journal = tets.cells, scratch.journal
    touched, star, seen = scratch.touched, scratch.star, scratch.seen
    ledger.turn[0] += 1
    n = 0
    for e in range(journal.length[0]):
        if journal.entries[e, 0] == STATUS:
            n = add_to_zone(journal.entries[e, 1], ledger, n)
    n_seen = np.int64(0)
    for m in range(n_touched):
        t = touched[m]
        if cells[t, 0] < 0:
            continue
        n = add_to_zone(t, ledger, n)
        for a in range(4):
            v = cells[t, a]
            if tets.locked[v] or n_seen == seen.shape[0] or is_in(v, seen, n_seen):
                continue
            seen[n_seen] = v
            n_seen += 1
            size = gather_star(cells, tets.neighbors, t, v, star)
            for s in range(size):
                n = add_to_zone(star[s], ledger, n)
    if n == ledger.zone.shape[0]:
        return -np.inf, n
    gain = 0.0
    for m in range(n):
        c = ledger.zone[m]
        now = 0.0
        if cells[c, 0] >= 0:
            found = cell_extremes(tets.points, cells, c)
            if not keeps(found, limit):
                return -np.inf, n
            now = worth_of_cell(tets.points, cells, c, found, weights)
        ledger.values[m] = now
        gain += now - ledger.worth[c]
    return gain, n


@kernel
def attempt(
    tets: Tets, c: int, op: int, step: Step, bounds: Bounds, ledger: Ledger, room: Room
) -> float:
    """Propose operation op at cell c; see :func:`propose_vertex` and :func:`propose_removal`.

    Returns
    -------
    float    gain in cost, -inf where there is nothing to do; the cells are in ``room.proposal``
    """
    scratch, proposal = room.scratch, room.proposal
    if op < PLACES:
        v = np.int32(ledger.first[0])
        if v == tets.points.shape[0]:
            return -np.inf
        tets.locked[v] = False
        total, n_old, n_new = propose_vertex(
            tets, c, op, v, step.cost, step.max_ring, bounds, scratch, proposal
        )
        tets.locked[v] = True
    else:
        v = tets.cells[c, op - PLACES]
        total, n_old, n_new = propose_removal(
            tets, ledger.stays, c, v, step.cost, scratch, proposal
        )
    proposal.sizes[0] = n_old
    proposal.sizes[1] = n_new
    return total if n_new > 0 else -np.inf


@kernel
def order_operations(tets: Tets, c: int, room: Room) -> None:
    """Write the operations at cell c in the order in which they are tried.

    The longest edge, the middle, the second edge, the facets, the other edges, the removals.
    """
    points, cells = tets.points, tets.cells
    ops, lengths = room.ops, room.lengths
    for e in range(6):
        a, b, _, _ = local_edge(e)
        total = 0.0
        for x in range(3):
            side = points[cells[c, a], x] - points[cells[c, b], x]
            total += side * side
        lengths[e] = total
    for e in range(6):
        longer = 0
        for f in range(6):
            longer += lengths[f] > lengths[e] or (lengths[f] == lengths[e] and f < e)
        ops[2 * longer if longer < 2 else longer + 5] = e
    ops[1] = PLACES - 1
    for m in range(4):
        ops[3 + m] = 6 + m
        ops[11 + m] = PLACES + m


@allocating_kernel
def insertion_pass(
    tets: Tets, order: IntArray, step: Step, bounds: Bounds, weights: Weights, ledger: Ledger,
    tried: BoolArray,
) -> tuple[int, int]:
    """Insert and remove vertices at the cells of ``order``; other arguments as in compound_pass.

    It stops before a cell at which an operation or its descent found no room for a further cell.

    Parameters
    ----------
    tets : Tets         its last points are free slots for new vertices; ``locked`` is kept up to
                        date, and set for a free slot and a removed vertex
    step : Step
    weights : Weights
    ledger : Ledger     kept up to date

    Returns
    -------
    taken, seen : int   number of operations that stayed, and of the cells before it stopped
    """
    room = make_room()
    scratch, proposal = room.scratch, room.proposal
    locked, journal = tets.locked, scratch.journal
    taken = 0
    for o in range(order.shape[0]):
        c = order[o]
        if tets.cells[c, 0] < 0 or tried[c]:
            continue
        tried[c] = True
        own, limit = stakes(tets, c, step.cost, bounds)
        order_operations(tets, c, room)
        best = 0.0
        chosen = -1
        for k in range(step.looks + 1):
            last = k == step.looks
            op = chosen if last else room.ops[k]
            if op < 0:
                break
            inserts = op < PLACES
            v = np.int32(ledger.first[0]) if inserts else tets.cells[c, op - PLACES]
            total = attempt(tets, c, op, step, bounds, ledger, room)
            journal.length[0] = 0
            if not total > -HOPELESS * own or not replace_cavity(
                tets, proposal.cavity, proposal.sizes[0], proposal.new, proposal.sizes[1],
                proposal.border, journal
            ):
                if tets.slots[FULL] > 0:
                    tried[c] = False
                    return taken, o
                continue
            locked[v] = not inserts
            total, n_touched, n_moved = descend_around(
                tets, step.cost, step.max_ring, bounds, proposal.cavity, proposal.sizes[1], total,
                -DEEP * own, scratch,
            )
            gain, n_zone = judge(tets, n_touched, limit, weights, ledger, scratch)
            gain -= step.price if inserts else step.least
            full = tets.slots[FULL] > 0
            final = not full and (last or (gain > 0.0 and step.first))
            settle(tets, final, n_touched, n_moved, scratch, tried)
            locked[v] = inserts != final
            if full:
                tried[c] = False
                return taken, o
            if final:
                taken += 1
                ledger.first[0] += inserts
                for m in range(n_zone):
                    ledger.worth[ledger.zone[m]] = ledger.values[m]
                break
            if gain > best:
                best = gain
                chosen = op
    return taken, order.shape[0]
