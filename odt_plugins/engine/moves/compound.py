"""Compound moves for the worst cells: a forced flip, a local descent, and back if it did not pay.

Single flips stop in local minima of F_p.  Here one flip at a bad cell is taken whatever it costs;
flips and Newton steps then descend around it.  If the sum of all changes is a gain it stays, else
the journal takes everything back.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.cost import Cost, quality_cost
from odt_plugins.engine.cells.extremes import Bounds, Extremes, keeps, rounded, worse
from odt_plugins.engine.cells.measures import (
    Room,
    cell_extremes,
    make_room,
    tet_measure,
)
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.moves.cavity import Journal, Ring, make_journal, make_ring, take_back
from odt_plugins.engine.moves.flips3d import flip_facet, improve_cell, remove_edge
from odt_plugins.engine.moves.newton3d import newton_vertex
from odt_plugins.engine.topology.active import DONE, IDLE, PENDING
from odt_plugins.engine.topology.lookup import is_in
from odt_plugins.engine.topology.tets import Tets
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray

MOST_TOUCHED, MOST_FLIPS, ROUNDS = 192, 24, 2
"""Of one descent: cells that it may touch, flips, and rounds of flips and Newton steps."""
LARGEST_STAR = 128
"""Cells around a vertex; one with more is left alone."""
DEEP = 2.0
"""A descent that is still this many times the worst cell's own cost down is given up."""
HOPELESS = 10.0
"""A forced flip may raise the cost by this many times the worst cell's own."""
SAME = 1e-9
"""A descent is given up, too, when its flips won back all but this part of what was lost."""
GAIN = 1e-3
"""Least gain, as part of the worst cell's own cost, for which a compound move stays."""


class Scratch(NamedTuple):
    """Room in which one thread descends and goes back; made by :func:`make_scratch`.

    Attributes
    ----------
    ring : Ring, journal : Journal, derivatives : Room
    touched : (MOST_TOUCHED,) int32     cells that a descent wrote or may write
    star : (LARGEST_STAR,) int32        cells around a vertex
    seen : (MOST_TOUCHED,) int32        vertices that were visited in a round
    moved : (8 MOST_TOUCHED,) int32     vertices, in the order of their moves
    origin : (8 MOST_TOUCHED, 3) float64
        where they were before
    """

    ring: Ring
    journal: Journal
    derivatives: Room
    touched: IntArray
    star: IntArray
    seen: IntArray
    moved: IntArray
    origin: FloatArray


@kernel
def gather_star(cells: IntArray, neighbors: IntArray, c: int, v: int, star: IntArray) -> int:
    """Cells that contain vertex v, found over facets from cell c; 0 if there are too many."""
    star[0] = c
    n = np.int64(1)
    for done in range(star.shape[0]):
        if done == n:
            break
        t = star[done]
        for f in range(4):
            if cells[t, f] == v:
                continue
            across = neighbors[t, f]
            if across < 0:
                continue
            if is_in(across, star, n):
                continue
            if n == star.shape[0]:
                return 0
            star[n] = across
            n += 1
    return int(n)


@kernel
def push(touched: IntArray, n: int, around: IntArray, n_new: int) -> int:
    """Add the new cells to the touched ones, each once."""
    for m in range(n_new):
        if n < touched.shape[0] and not is_in(around[m], touched, n):
            touched[n] = around[m]
            n += 1
    return n


@allocating_kernel
def make_scratch(entries: int) -> Scratch:
    """Room for one thread, with so many entries of the journal."""
    return Scratch(
        make_ring(np.empty(0), np.bool_(False)),
        make_journal(np.bool_(True), entries),
        make_room(),
        np.empty(MOST_TOUCHED, np.int32),
        np.empty(LARGEST_STAR, np.int32),
        np.empty(MOST_TOUCHED, np.int32),
        np.empty(8 * MOST_TOUCHED, np.int32),
        np.empty((8 * MOST_TOUCHED, 3)),
    )


@kernel
def descend_around(
    tets: Tets, cost: Cost, max_ring: int, bounds: Bounds, fresh: IntArray, n_fresh: int,
    total: float, least: float, scratch: Scratch,
) -> tuple[float, int, int]:
    """Flips and Newton steps around the cells that a forced operation wrote.

    Parameters
    ----------
    fresh, n_fresh        the cells, in the first entries of fresh
    total : float         gain of the forced operation
    least : float         the descent is given up when the gain is still below after its flips,
                          or when these led back to where it was before the forced operation
    scratch : Scratch     OUT: touched cells, vertices that moved, and what takes all of it back

    Returns
    -------
    total : float         gain of everything together
    n_touched, n_moved : int
    """
    points, cells, status = tets.points, tets.cells, tets.status
    touched, star, seen = scratch.touched, scratch.star, scratch.seen
    moved, origin = scratch.moved, scratch.origin
    # numba would compile push and newton_vertex once more for a literal
    first = np.int64(0)
    n_touched = push(touched, first, fresh, n_fresh)
    forced = total
    n_moved = 0
    flips = 0
    for _ in range(ROUNDS):
        m = 0
        for _ in range((MOST_FLIPS + 1) * MOST_TOUCHED):
            if m == n_touched or flips == MOST_FLIPS:
                break
            t = touched[m]
            m += 1
            if cells[t, 0] < 0 or status[t] != PENDING:
                continue
            status[t] = DONE
            gain, n_new = improve_cell(
                tets, t, cost, max_ring, bounds, scratch.ring, scratch.journal
            )
            if n_new > 0:
                total += gain
                flips += 1
                n_touched = push(touched, n_touched, scratch.ring.cells, n_new)
                m = 0
        if total < least or abs(total) < SAME * abs(forced):
            break
        n_seen = np.int64(0)
        for m in range(n_touched):
            t = touched[m]
            if cells[t, 0] < 0:
                continue
            status[t] = PENDING
            for a in range(4):
                v = cells[t, a]
                if tets.locked[v] or n_moved == moved.shape[0] or n_seen == seen.shape[0]:
                    continue
                if is_in(v, seen, n_seen):
                    continue
                seen[n_seen] = v
                n_seen += 1
                size = gather_star(cells, tets.neighbors, t, v, star)
                x = points[v, 0]
                y = points[v, 1]
                z = points[v, 2]
                gain = newton_vertex(
                    points, cells, star, first, size, v, cost, bounds.cells, scratch.derivatives
                )
                if gain > 0.0:
                    total += gain
                    moved[n_moved] = v
                    origin[n_moved, 0] = x
                    origin[n_moved, 1] = y
                    origin[n_moved, 2] = z
                    n_moved += 1
    return total, n_touched, n_moved


@kernel
def within(tets: Tets, touched: IntArray, n_touched: int, limit: Extremes) -> bool:
    """Whether no touched cell passes the limit."""
    for m in range(n_touched):
        t = touched[m]
        if tets.cells[t, 0] >= 0 and not keeps(cell_extremes(tets.points, tets.cells, t), limit):
            return False
    return True


@kernel
def stakes(tets: Tets, c: int, cost: Cost, bounds: Bounds) -> tuple[float, Extremes]:
    """Cost of cell c, with which a gain is compared, and what all cells near it must keep then.

    Returns
    -------
    own : float          cost by the measure of the objective
    limit : Extremes     the bounds, or the extremes of the cell where it passes them
    """
    points, cells = tets.points, tets.cells
    limit = worse(bounds.cells, rounded(cell_extremes(points, cells, c)))
    m = tet_measure(
        points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3], cost.objective
    )
    return quality_cost(m, cost.power), limit


@kernel
def settle(
    tets: Tets, good: bool, n_touched: int, n_moved: int, scratch: Scratch, tried: BoolArray
) -> None:
    """Keep a descent and mark what it touched for another try, or take all of it back."""
    cells, neighbors, points = tets.cells, tets.neighbors, tets.points
    touched, moved, origin = scratch.touched, scratch.moved, scratch.origin
    for m in range(n_touched):
        t = touched[m]
        if cells[t, 0] >= 0:
            tets.status[t] = IDLE
    if good:
        for m in range(n_touched):
            t = touched[m]
            tried[t] = False
            if cells[t, 0] < 0:
                continue
            for f in range(4):
                if neighbors[t, f] >= 0:
                    tried[neighbors[t, f]] = False
        return
    for m in range(n_moved - 1, -1, -1):
        v = moved[m]
        points[v, 0] = origin[m, 0]
        points[v, 1] = origin[m, 1]
        points[v, 2] = origin[m, 2]
    take_back(tets, scratch.journal)


@allocating_kernel
def compound_pass(
    tets: Tets, order: IntArray, cost: Cost, max_ring: int, bounds: Bounds, tried: BoolArray
) -> int:
    """Try compound moves at the cells of ``order``; arguments as in ``flips3d.flip_pass``.

    A cell that is marked in ``tried`` (room,) is passed over: nothing paid there and nothing
    near it has changed since.  The marks are kept up to date.

    Returns
    -------
    int    number of compound moves that stayed
    """
    scratch = make_scratch(np.int64(1 << 14))
    ring, journal = scratch.ring, scratch.journal
    taken = 0
    for o in range(order.shape[0]):
        c = order[o]
        if tets.cells[c, 0] < 0 or tried[c]:
            continue
        tried[c] = True
        own, limit = stakes(tets, c, cost, bounds)
        for op in range(10):
            journal.length[0] = 0
            if op < 6:
                total, n_new = remove_edge(
                    tets, c, op, cost, max_ring, bounds, HOPELESS * own, ring, journal
                )
            else:
                total, n_new = flip_facet(
                    tets, c, op - 6, cost, bounds, HOPELESS * own, ring, journal
                )
            if n_new == 0:
                continue
            total, n_touched, n_moved = descend_around(
                tets, cost, max_ring, bounds, ring.cells, n_new, total, -DEEP * own, scratch
            )
            good = total > GAIN * own and within(tets, scratch.touched, n_touched, limit)
            settle(tets, good, n_touched, n_moved, scratch, tried)
            if good:
                taken += 1
                break
    return taken
