"""Compound moves for the worst cells: a forced flip, a local descent, and back if it did not pay.

Single flips stop in local minima of F_p.  Here one flip at a bad cell is taken whatever it costs;
flips and Newton steps then descend around it.  If the sum of all changes is a gain it stays, else
the journal takes everything back.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.bounds import relaxed
from odt_plugins.engine.cells.tetrahedron import quality_cost, tet_cosines, tet_measure, tet_quality
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.moves.cavity import Work, make_work, take_back
from odt_plugins.engine.moves.flips3d import flip_facet, improve_cell, remove_edge
from odt_plugins.engine.moves.newton3d import newton_vertex
from odt_plugins.engine.topology.active import DONE, IDLE, PENDING
from odt_plugins.engine.topology.lookup import is_in
from odt_plugins.mesh.arrays import BoolArray, ByteArray, FloatArray, IntArray, LongArray

Scratch = tuple[
    IntArray, IntArray, FloatArray, IntArray, IntArray, FloatArray, FloatArray
]

MOST_TOUCHED, MOST_FLIPS, ROUNDS = 192, 24, 2
"""Of one descent: cells that it may touch, flips, and rounds of flips and Newton steps."""
LARGEST_STAR = 128
"""Cells around a vertex; one with more is left alone."""
DEEP = 2.0
"""A descent that is still this many times the worst cell's own cost down is given up."""
HOPELESS = 10.0
"""A forced flip may raise the cost by this many times the worst cell's own."""
ROUNDED = 1e-14
"""A cell may come back with its vertices in another order: rounding must not decide whether it is
as it was."""

SAME = 1e-9
"""A descent is given up, too, when its flips won back all but this part of what was lost."""
GAIN = 1e-3
"""Least gain, as part of the worst cell's own cost, for which a compound move stays."""


@kernel
def gather_star(cells: IntArray, neighbors: IntArray, c: int, v: int, star: IntArray) -> int:
    """Cells that contain vertex v, found over facets from cell c; 0 if there are too many."""
    star[0] = c
    n = 1
    done = 0
    while done < n:
        t = star[done]
        done += 1
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
    return n


@kernel
def push(touched: IntArray, n: int, around: IntArray, n_new: int) -> int:
    """Add the new cells to the touched ones, each once."""
    for m in range(n_new):
        if n < touched.shape[0] and not is_in(around[m], touched, n):
            touched[n] = around[m]
            n += 1
    return n


@allocating_kernel
def make_scratch() -> Scratch:
    """Work arrays of a descent for one thread."""
    return (
        np.empty(MOST_TOUCHED, np.int32),
        np.empty(LARGEST_STAR, np.int32),
        np.empty((8 * MOST_TOUCHED, 3)),
        np.empty(8 * MOST_TOUCHED, np.int32),
        np.empty(MOST_TOUCHED, np.int32),
        np.empty(20),
        np.empty(3),
    )


@kernel
def descend_around(
    points: FloatArray, cells: IntArray, neighbors: IntArray, regions: IntArray,
    locked: BoolArray, status: ByteArray, slots: LongArray, free: IntArray, objective: int,
    power: float, max_ring: int, bounds: FloatArray, fresh: IntArray, n_fresh: int, total: float,
    floor: float, work: Work, journal: LongArray, scratch: Scratch,
) -> tuple[float, int, int]:
    """Flips and Newton steps around the cells that a forced operation wrote.

    Parameters
    ----------
    fresh, n_fresh        the cells, in the first entries of fresh
    total : float         gain of the forced operation
    floor : float         the descent is given up when the gain is still below after its flips,
                          or when these led back to where it was before the forced operation
    scratch : Scratch     touched cells, star, positions to go back to and their vertices, ...

    Returns
    -------
    total : float         gain of everything together
    n_touched, n_undo : int
    """
    touched, star, undo, undo_vertex, seen, out, step = scratch
    around = work[1]
    # numba would compile push and newton_vertex once more for a literal
    first = np.int64(0)
    n_touched = push(touched, first, fresh, n_fresh)
    forced = total
    n_undo = 0
    flips = 0
    for _ in range(ROUNDS):
        m = 0
        while m < n_touched and flips < MOST_FLIPS:
            t = touched[m]
            m += 1
            if cells[t, 0] < 0 or status[t] != PENDING:
                continue
            status[t] = DONE
            gain, n_new = improve_cell(
                points, cells, neighbors, regions, locked, status, t, slots, free,
                objective, power, max_ring, bounds, work, journal,
            )
            if n_new > 0:
                total += gain
                flips += 1
                n_touched = push(touched, n_touched, around, n_new)
                m = 0
        if total < floor or abs(total) < SAME * abs(forced):
            break
        n_seen = 0
        for m in range(n_touched):
            t = touched[m]
            if cells[t, 0] < 0:
                continue
            status[t] = PENDING
            for a in range(4):
                v = cells[t, a]
                if locked[v] or n_undo == undo.shape[0] or n_seen == seen.shape[0]:
                    continue
                if is_in(v, seen, n_seen):
                    continue
                seen[n_seen] = v
                n_seen += 1
                size = gather_star(cells, neighbors, t, v, star)
                x = points[v, 0]
                y = points[v, 1]
                z = points[v, 2]
                gain = newton_vertex(
                    points, cells, star, first, size, v, objective, power, bounds, out, step
                )
                if gain > 0.0:
                    total += gain
                    undo_vertex[n_undo] = v
                    undo[n_undo, 0] = x
                    undo[n_undo, 1] = y
                    undo[n_undo, 2] = z
                    n_undo += 1
    return total, n_touched, n_undo


@kernel
def within(
    points: FloatArray, cells: IntArray, touched: IntArray, n_touched: int, q: float,
    large: float, small: float,
) -> bool:
    """Whether no touched cell is worse than q or has a cosine outside [small, large]."""
    for m in range(n_touched):
        t = touched[m]
        if cells[t, 0] < 0:
            continue
        if tet_quality(points, cells[t, 0], cells[t, 1], cells[t, 2], cells[t, 3]) < q:
            return False
        hi, lo = tet_cosines(points, cells[t, 0], cells[t, 1], cells[t, 2], cells[t, 3])
        if hi > large or lo < small:
            return False
    return True


@kernel
def stakes(
    points: FloatArray, cells: IntArray, c: int, objective: int, power: float, bounds: FloatArray
) -> tuple[float, float, float, float]:
    """Cost of cell c, with which a gain is compared, and what all cells near it must keep then.

    Returns
    -------
    own : float                       cost by the measure of the objective
    least, most, fewest : float       see ``bounds.relaxed``
    """
    i, j, k, l = cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3]
    q = tet_quality(points, i, j, k, l)
    large, small = tet_cosines(points, i, j, k, l)
    least, most, fewest = relaxed(
        bounds, q - ROUNDED * abs(q), large + ROUNDED, small - ROUNDED
    )
    own = quality_cost(tet_measure(points, i, j, k, l, objective), power)
    return own, least, most, fewest


@kernel
def settle(
    points: FloatArray, cells: IntArray, neighbors: IntArray, status: ByteArray,
    slots: LongArray, free: IntArray, good: bool, n_touched: int, n_undo: int,
    journal: LongArray, scratch: Scratch, tried: BoolArray,
) -> None:
    """Keep a descent and mark what it touched for another try, or take all of it back."""
    touched, _, undo, undo_vertex, _, _, _ = scratch
    for m in range(n_touched):
        t = touched[m]
        if cells[t, 0] >= 0:
            status[t] = IDLE
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
    for m in range(n_undo - 1, -1, -1):
        v = undo_vertex[m]
        points[v, 0] = undo[m, 0]
        points[v, 1] = undo[m, 1]
        points[v, 2] = undo[m, 2]
    take_back(cells, neighbors, status, slots, free, journal)


@allocating_kernel
def compound_pass(
    points: FloatArray, cells: IntArray, neighbors: IntArray, regions: IntArray,
    locked: BoolArray, status: ByteArray, order: IntArray, slots: LongArray, free: IntArray,
    objective: int, power: float, max_ring: int, bounds: FloatArray, tried: BoolArray,
) -> int:
    """Try compound moves at the cells of ``order``; arguments as in ``flips3d.flip_pass``.

    A cell that is marked in ``tried`` (room,) is passed over: nothing paid there and nothing
    near it has changed since.  The marks are kept up to date.

    Returns
    -------
    int    number of compound moves that stayed
    """
    work = make_work(np.empty(0))
    journal = np.zeros((1 << 14, 4), np.int64)
    scratch = make_scratch()
    taken = 0
    for o in range(order.shape[0]):
        c = order[o]
        if cells[c, 0] < 0 or tried[c]:
            continue
        tried[c] = True
        own, least, most, fewest = stakes(points, cells, c, objective, power, bounds)
        for op in range(10):
            journal[0, 0] = 0
            if op < 6:
                total, n_new = remove_edge(
                    points, cells, neighbors, regions, locked, status, c, op, slots, free,
                    objective, power, max_ring, bounds, HOPELESS * own, work, journal,
                )
            else:
                total, n_new = flip_facet(
                    points, cells, neighbors, regions, locked, status, c, op - 6, slots, free,
                    objective, power, bounds, HOPELESS * own, work, journal,
                )
            if n_new == 0:
                continue
            total, n_touched, n_undo = descend_around(
                points, cells, neighbors, regions, locked, status, slots, free, objective, power,
                max_ring, bounds, work[1], n_new, total, -DEEP * own, work, journal, scratch,
            )
            good = total > GAIN * own and within(
                points, cells, scratch[0], n_touched, least, most, fewest
            )
            settle(
                points, cells, neighbors, status, slots, free, good, n_touched, n_undo, journal,
                scratch, tried,
            )
            if good:
                taken += 1
                break
    return taken
