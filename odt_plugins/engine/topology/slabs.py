"""Slabs of a tetrahedral mesh in which flips run side by side.

The cells are shared out among slabs across the longest axis, and the adjacency is cut at the
facets between two slabs, as if they were boundary facets.  Nothing that one slab changes is then
read or written in another.  Cells at a cut wait for a second set of slabs, whose cuts lie in the
middle of the first ones, or are done in one go where they are few.  The slabs depend on the mesh
alone, not on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from odt_plugins.engine.compiled import threads
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.compiled.threads import pieces, run_ranges
from odt_plugins.engine.topology.complex import Complex
from odt_plugins.engine.topology.tets import FREE, FULL, USED, Tets
from odt_plugins.mesh.arrays import BoolArray, ByteArray, IntArray, LongArray
from odt_plugins.mesh.chunks import Pool

WORTH = 0.01
"""Up to this part of all cells are worked at in one go."""

TRIES = 256
"""Cells after which it is asked again whether work pays."""

LEFT, GONE = 254, 255

Work = Callable[[IntArray, Tets], int]
"""Called with the cells to visit and what may be used of the mesh: cells as far as the slab goes,
slots and free list of its own, and the vertices at the cuts locked."""


@kernel
def _slab_of_cell(cells: IntArray, c: int, slab: ByteArray) -> int:
    return min(
        min(slab[cells[c, 0]], slab[cells[c, 1]]), min(slab[cells[c, 2]], slab[cells[c, 3]])
    )


@kernel
def cut_walls(
    cells: IntArray, neighbors: IntArray, slab: ByteArray, cut: BoolArray, start: int, stop: int
) -> int:
    """Cut the adjacency between slabs; a cell belongs to the least slab of its vertices.

    Only where the cell of the lesser slab is one of start to stop; others can be cut at the same
    time.  The k-th such facet has number w = 4 start + k: its sides get -2 - 2 w and -3 - 2 w in
    the place of the cell across; its vertices are marked in ``cut``.  Returns how many there are.
    """
    count = 0
    for c in range(start, stop):
        if cells[c, 0] < 0:
            continue
        first, second = slab[cells[c, 0]], slab[cells[c, 1]]
        third, fourth = slab[cells[c, 2]], slab[cells[c, 3]]
        if (first ^ second) | (first ^ third) | (first ^ fourth) == 0:
            continue
        mine = _slab_of_cell(cells, c, slab)
        for f in range(4):
            across = neighbors[c, f]
            if across < 0 or _slab_of_cell(cells, across, slab) <= mine:
                continue
            wall = 4 * start + count
            for g in range(4):
                if neighbors[across, g] == c:
                    neighbors[across, g] = -3 - 2 * wall
                    break
            neighbors[c, f] = -2 - 2 * wall
            count += 1
            for i in range(4):
                if i != f:
                    cut[cells[c, i]] = True
    return count


@kernel
def find_walls(
    cells: IntArray, neighbors: IntArray, first: LongArray, part: int, ends: LongArray, start: int,
    stop: int,
) -> None:
    """Write where the sides of the walls are, among the cells start to stop.

    Number w stands for the wall ``first[w // part] + w % part``. Side 0 or 1 of a wall at facet f
    of cell c is 4 c + f in its row of ``ends``.
    """
    for c in range(start, stop):
        least = min(min(neighbors[c, 0], neighbors[c, 1]), min(neighbors[c, 2], neighbors[c, 3]))
        if least >= -1 or cells[c, 0] < 0:
            continue
        for f in range(4):
            side = -2 - neighbors[c, f]
            if side >= 0:
                number = side >> 1
                ends[first[number // part] + number % part, side & 1] = 4 * c + f


@kernel
def heal_walls(neighbors: IntArray, ends: LongArray) -> None:
    """Join again at the walls what :func:`cut_walls` cut."""
    for wall in range(ends.shape[0]):
        a, b = ends[wall, 0], ends[wall, 1]
        neighbors[a >> 2, a & 3] = b >> 2
        neighbors[b >> 2, b & 3] = a >> 2


@kernel
def _sort_out(
    cells: IntArray, order: IntArray, slab: ByteArray, cut: BoolArray, home: ByteArray,
    start: int, stop: int,
) -> None:
    """Write the slab of the cells order[start:stop], LEFT at a cut, GONE for a free slot."""
    for o in range(start, stop):
        c = order[o]
        if cells[c, 0] < 0:
            home[o] = GONE
        elif (
            cut[cells[c, 0]] or cut[cells[c, 1]] or cut[cells[c, 2]] or cut[cells[c, 3]]
        ):
            home[o] = LEFT
        else:
            home[o] = _slab_of_cell(cells, c, slab)


def side_by_side(
    mesh: Complex, order: IntArray, pool: Pool | None, work: Work, *, costly: bool = False,
    rare: float = 0.0,
) -> int:
    """Work at cells, in slabs where there are many, and add up what the work returns.

    Parameters
    ----------
    mesh : Complex
    order : (k,) int32      cells to visit, in this order within a slab
    pool : Pool or None
        None runs the slabs one after another; the result is the same
    work : callable         see ``Work``
    costly : bool           see ``threads.pieces``
    rare : float            work at a slab ends where it has returned less than this a cell, after
                            a multiple of TRIES cells
    """
    # Not empty once a slab has failed.
    given_up: list[bool] = []

    def in_pieces(mine: IntArray, tets: Tets) -> int:
        total, count = 0, len(mine)
        length = TRIES if rare else max(count, 1)
        for begin in range(0, count, length):
            if total < rare * begin:
                break
            for first, last in pieces(begin, min(begin + length, count), costly=costly):
                if given_up:
                    return total
                total += work(mine[first:last], tets)
        return total

    total = 0
    few = WORTH * mesh.count()
    if len(order) > few:
        for slab in mesh.slabs():
            if slab.any() and len(order) > few:
                try:
                    done, order = _in_slabs(mesh, order, slab, pool, in_pieces)
                except BaseException:
                    given_up.append(True)
                    raise
                total += done
    return total + in_pieces(order, mesh.tets)


def _in_slabs(
    mesh: Complex, order: IntArray, slab: ByteArray, pool: Pool | None, work: Work
) -> tuple[int, IntArray]:
    """Work at the cells away from the cuts; returns what it gave, and the cells that are left."""
    used = mesh.used
    cut = np.zeros(len(mesh.points), dtype=np.bool_)
    walls = run_ranges(pool, used, partial(cut_walls, mesh.cells, mesh.neighbors, slab, cut))
    wall = np.cumsum([0, *walls])
    home = np.empty(len(order), dtype=np.uint8)
    run_ranges(pool, len(order), partial(_sort_out, mesh.cells, order, slab, cut, home))
    count = int(slab.max()) + 1
    ends, slots, free = _share_room(mesh, count)
    whole = mesh.tets._replace(locked=mesh.locked | cut)

    def run(k: int) -> int:
        own = whole._replace(cells=mesh.cells[: ends[k]], slots=slots[k], free=free[k])
        return work(order[home == k], own)

    total = sum((map if pool is None else pool.map)(run, range(count)))
    _collect_room(mesh, ends, slots, free)
    sides = np.empty((wall[-1], 2), dtype=np.int64)
    run_ranges(pool, mesh.used, partial(
        find_walls, mesh.cells, mesh.neighbors, wall, 4 * threads.PART, sides
    ))
    heal_walls(mesh.neighbors, sides)
    return total, order[home == LEFT]


def _share_room(
    mesh: Complex, count: int
) -> tuple[list[int], list[LongArray], list[IntArray]]:
    """Share the unused and the free slots out: end of the unused, slots and free list of each."""
    used, n_free = mesh.used, int(mesh.slots[FREE])
    room = len(mesh.cells) - used
    ends, slots, free = [], [], []
    for k in range(count):
        mine = mesh.free[n_free * k // count : n_free * (k + 1) // count]
        stack = np.empty(len(mine) + used, dtype=np.int32)
        stack[: len(mine)] = mine
        ends.append(used + room * (k + 1) // count)
        own = np.zeros(3, dtype=np.int64)
        own[[USED, FREE]] = used + room * k // count, len(mine)
        slots.append(own)
        free.append(stack)
    return ends, slots, free


def _collect_room(
    mesh: Complex, ends: list[int], slots: list[LongArray], free: list[IntArray]
) -> None:
    """Put the free lists together again; unused slots below the last used one are free too."""
    used = mesh.used
    starts = [used, *ends[:-1]]
    tops = [int(s[USED]) for s in slots]
    last = max([used, *(top for top, start in zip(tops, starts, strict=True) if top > start)])
    stacks = [stack[: s[FREE]] for stack, s in zip(free, slots, strict=True)]
    stacks += [np.arange(top, min(end, last), dtype=np.int32)
               for top, end in zip(tops, ends, strict=True)]
    found = np.concatenate(stacks)
    mesh.free[: len(found)] = found
    mesh.slots[[USED, FREE, FULL]] = last, len(found), max(int(s[FULL]) for s in slots)
