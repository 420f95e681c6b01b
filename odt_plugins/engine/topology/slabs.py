"""Slabs of a tetrahedral mesh in which flips run side by side.

The cells are shared out among slabs across the longest axis, and the adjacency is cut at the
facets between two slabs, as if they were boundary facets.  Nothing that one slab changes is then
read or written in another.  Cells at a cut wait for a second set of slabs, whose cuts lie in the
middle of the first ones.  The slabs depend on the mesh alone, not on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Event

import numpy as np

from odt_plugins.engine.compiled.kernel import inner_kernel, kernel
from odt_plugins.engine.compiled.threads import pieces
from odt_plugins.engine.topology.complex import Complex
from odt_plugins.engine.topology.tets import FREE, FULL, USED, Tets
from odt_plugins.mesh.arrays import BoolArray, ByteArray, IntArray, LongArray

WORTH = 0.02
"""Flips at fewer cells than this part of all are done in one go."""

LEFT, GONE = 254, 255

Work = Callable[[IntArray, Tets], int]
"""Called with the cells to visit and what may be used of the mesh: cells as far as the slab goes,
slots and free list of its own, and the vertices at the cuts locked."""


@inner_kernel
def _slab_of_cell(cells: IntArray, c: int, slab: ByteArray) -> int:
    return min(
        min(slab[cells[c, 0]], slab[cells[c, 1]]), min(slab[cells[c, 2]], slab[cells[c, 3]])
    )


@kernel
def cut_walls(cells: IntArray, neighbors: IntArray, slab: ByteArray, cut: BoolArray) -> int:
    """Cut the adjacency between slabs; a cell belongs to the least slab of its vertices.

    The k-th such facet gets -2 - k in the place of the cell across, on both sides, and its
    vertices are marked in ``cut``.  Returns the number of facets.
    """
    count = 0
    for c in range(cells.shape[0]):
        if cells[c, 0] < 0:
            continue
        first, second = slab[np.uint32(cells[c, 0])], slab[np.uint32(cells[c, 1])]
        third, fourth = slab[np.uint32(cells[c, 2])], slab[np.uint32(cells[c, 3])]
        if (first ^ second) | (first ^ third) | (first ^ fourth) == 0:
            continue
        mine = _slab_of_cell(cells, c, slab)
        for f in range(4):
            across = neighbors[c, f]
            if across < 0 or _slab_of_cell(cells, across, slab) <= mine:
                continue
            for g in range(4):
                if neighbors[across, g] == c:
                    neighbors[across, g] = -2 - count
                    break
            neighbors[c, f] = -2 - count
            count += 1
            for i in range(4):
                if i != f:
                    cut[cells[c, i]] = True
    return count


@kernel
def heal_walls(cells: IntArray, neighbors: IntArray, ends: LongArray) -> None:
    """Join again what :func:`cut_walls` cut; ``ends`` (number of facets,) is filled with -1."""
    for c in range(cells.shape[0]):
        least = min(min(neighbors[c, 0], neighbors[c, 1]), min(neighbors[c, 2], neighbors[c, 3]))
        if least >= -1 or cells[c, 0] < 0:
            continue
        for f in range(4):
            wall = -2 - neighbors[c, f]
            if wall < 0:
                continue
            if ends[wall] < 0:
                ends[wall] = 4 * c + f
            else:
                across = ends[wall] >> 2
                neighbors[c, f] = across
                neighbors[across, ends[wall] & 3] = c


@kernel
def _sort_out(
    cells: IntArray, order: IntArray, slab: ByteArray, cut: BoolArray, home: ByteArray
) -> None:
    """Write the slab of every cell of ``order``, LEFT at a cut, GONE for a free slot."""
    for o in range(order.shape[0]):
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
    mesh: Complex, order: IntArray, pool: ThreadPoolExecutor | None, work: Work,
    worth: float = WORTH, costly: bool = False,
) -> int:
    """Work at cells, in slabs where there are many, and add up what the work returns.

    Parameters
    ----------
    mesh : Complex
    order : (k,) int32      cells to visit, in this order within a slab
    pool : ThreadPoolExecutor or None
        None runs the slabs one after another; the result is the same
    work : callable         see ``Work``
    worth : float           part of all cells that is worth cutting the mesh into slabs
    costly : bool           see ``threads.pieces``
    """
    total = 0
    if len(order) > worth * mesh.count():
        for slab in mesh.slabs():
            if slab.any():
                done, order = _in_slabs(mesh, order, slab, pool, work, costly)
                total += done
    return total + sum(
        work(order[first:last], mesh.tets)
        for first, last in pieces(0, len(order), costly=costly)
    )


def _in_slabs(
    mesh: Complex, order: IntArray, slab: ByteArray, pool: ThreadPoolExecutor | None, work: Work,
    costly: bool,
) -> tuple[int, IntArray]:
    """Work at the cells away from the cuts; returns what it gave, and the cells that are left."""
    used = mesh.used
    cut = np.zeros(len(mesh.points), dtype=np.bool_)
    walls = cut_walls(mesh.cells[:used], mesh.neighbors, slab, cut)
    home = np.empty(len(order), dtype=np.uint8)
    _sort_out(mesh.cells, order, slab, cut, home)
    parts = [order[home == k] for k in range(int(slab.max()) + 1)]
    ends, slots, free = _share_room(mesh, len(parts))
    whole = mesh.tets._replace(locked=mesh.locked | cut)
    given_up = Event()

    def run(k: int) -> int:
        own = whole._replace(cells=mesh.cells[: ends[k]], slots=slots[k], free=free[k])
        total = 0
        for first, last in pieces(0, len(parts[k]), costly=costly):
            if given_up.is_set():
                break
            total += work(parts[k][first:last], own)
        return total

    try:
        total = sum((map if pool is None else pool.map)(run, range(len(parts))))
    except BaseException:
        given_up.set()
        raise
    _collect_room(mesh, ends, slots, free)
    used = mesh.used
    heal_walls(mesh.cells[:used], mesh.neighbors, np.full(walls, -1, dtype=np.int64))
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
