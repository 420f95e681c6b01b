"""Colours for Gauss-Seidel: blocks of neighbouring vertices that can be swept at the same time.

A block is a run of consecutive vertex numbers, which along a space-filling curve lie together in
space and in memory.  No cell has vertices in two blocks of one colour; within a block the vertices
move one after another.  The blocks depend on the mesh alone, not on the number of threads.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.compiled.threads import PIECE, pieces, run_ranges
from odt_plugins.engine.topology.star import OffsetArray
from odt_plugins.mesh.arrays import BoolArray, IntArray, LongArray
from odt_plugins.mesh.chunks import Pool

SMALLEST_BITS = 6
"""A block has at least 2^SMALLEST_BITS vertex numbers."""

ONE_BLOCK = 1 << 12
"""So many vertices of tetrahedra are one block, which takes less time than colours: about six cells
come to a vertex, and one thread does meshes of so few."""

MOST_BLOCKS = 1024
"""Larger meshes have larger blocks, since which of them touch is a table of all pairs."""

SMALLEST = 256
"""Fewer vertices than this are not worth a chunk of their own."""

TURNS = 4
"""Most chunks of a colour for each thread, unless they get longer than a piece."""

T = TypeVar("T")


class Coloring(NamedTuple):
    """Vertices in blocks, blocks in colours.

    Block b is ``order[blocks[b]:blocks[b + 1]]``, ascending; colour c has the blocks
    ``offsets[c]:offsets[c + 1]``.

    Attributes
    ----------
    order : (v,) int32
    blocks : (number of blocks + 1,) int64
    offsets : (number of colours + 1,) int64
    links : (l, 2) int32        blocks with vertices in one cell, the one that comes first first
    """

    order: IntArray
    blocks: OffsetArray
    offsets: OffsetArray
    links: IntArray

    def of_one_colour(self) -> Coloring:
        """The same blocks as if none touched another."""
        return self._replace(offsets=self.offsets[[0, -1]], links=self.links[:0])


@kernel
def _touching(
    cells: IntArray, block: IntArray, touch: BoolArray, start: int, stop: int
) -> None:
    """Mark the pairs of blocks in the cells start to stop, the larger number first."""
    for c in range(start, stop):
        if cells[c, 0] < 0:
            continue
        first = block[cells[c, 0]]
        apart = 0
        for a in range(1, cells.shape[1]):
            apart |= first ^ block[cells[c, a]]
        if apart == 0:
            continue
        for a in range(1, cells.shape[1]):
            u = block[cells[c, a]]
            for b in range(a):
                w = block[cells[c, b]]
                touch[max(u, w), min(u, w)] = True


@kernel
def _arrange(
    movable: BoolArray, bits: int, touch: BoolArray, room: LongArray, order: IntArray,
    blocks: OffsetArray, offsets: OffsetArray, links: IntArray,
) -> tuple[int, int, int, int]:
    """Colour the blocks and fill the arrays of a :class:`Coloring`; how much of each is in use.

    Every block gets the lowest colour free among its neighbours. ``room`` is (4, blocks + 1).
    """
    color, taken, place, number = room[0], room[1], room[2], room[3]
    count = touch.shape[0] - 1
    colors = 0
    found = 0
    for b in range(count):
        for other in range(b):
            if touch[b, other]:
                taken[color[other]] = b + 1
                links[found, 0], links[found, 1] = other, b
                found += 1
        for low in range(b + 1):
            if taken[low] != b + 1:
                color[b] = low
                colors = max(colors, low + 1)
                break
    for v in range(movable.shape[0]):
        if movable[v]:
            place[v >> bits] += 1
    total = 0
    n_blocks = 0
    n_colors = 0
    blocks[0] = 0
    offsets[0] = 0
    for low in range(colors):
        for b in range(count):
            size = place[b]
            if color[b] == low and size > 0:
                place[b] = total
                number[b] = n_blocks
                total += size
                n_blocks += 1
                blocks[n_blocks] = total
        if n_blocks > offsets[n_colors]:
            n_colors += 1
            offsets[n_colors] = n_blocks
    for v in range(movable.shape[0]):
        if movable[v]:
            order[place[v >> bits]] = v
            place[v >> bits] += 1
    n_links = 0
    for link in range(found):
        a, b = number[links[link, 0]], number[links[link, 1]]
        if a >= 0 and b >= 0:
            links[n_links, 0], links[n_links, 1] = min(a, b), max(a, b)
            n_links += 1
    return total, n_blocks, n_colors, n_links


def _block_bits(cells: IntArray, n: int) -> int:
    if cells.shape[1] == 4 and n <= ONE_BLOCK:
        return n.bit_length()
    bits = SMALLEST_BITS
    while n >> bits >= MOST_BLOCKS:
        bits += 1
    return bits


def touching_blocks(
    cells: IntArray, movable: BoolArray, pool: Pool | None = None
) -> BoolArray:
    """Find out which blocks have movable vertices in one cell.

    Parameters
    ----------
    cells : (m, d + 1) int32    a row that starts with -1 is a free slot
    movable : (n,) bool
    pool                        see ``threads.run_ranges``

    Returns
    -------
    (blocks + 1, blocks + 1) bool
        [a, b] for a > b; the rest means nothing, nor does the last row, of the vertices that stay
    """
    bits = _block_bits(cells, len(movable))
    count = (len(movable) >> bits) + 1
    touch = np.zeros((count + 1, count + 1), dtype=np.bool_)
    if count == 1:
        return touch
    block = np.arange(len(movable), dtype=np.int32) >> bits
    block[~movable] = count
    run_ranges(pool, len(cells), partial(_touching, cells, block, touch))
    return touch


def vertex_coloring(
    cells: IntArray, movable: BoolArray, touch: BoolArray | None = None
) -> Coloring:
    """Put the movable vertices into blocks and colour these.

    Parameters
    ----------
    cells : (m, d + 1) int32     a row that starts with -1 is a free slot
    movable : (n,) bool          vertices to colour; the others do not take part
    touch : array, optional      from :func:`touching_blocks` of these or more vertices

    Returns
    -------
    Coloring                     greedy in order of index: the same for the same mesh
    """
    if touch is None:
        touch = touching_blocks(cells, movable)
    count = len(touch)
    # a single block needs no colour
    if count == 2:
        order = np.flatnonzero(movable).astype(np.int32)
        ends = np.arange(1 + (len(order) > 0))
        return Coloring(order, len(order) * ends, ends, np.empty((0, 2), dtype=np.int32))
    order = np.empty(len(movable), dtype=np.int32)
    blocks, offsets = np.empty((2, count), dtype=np.int64)
    links = np.empty((np.count_nonzero(touch), 2), dtype=np.int32)
    room = np.zeros((4, count), dtype=np.int64)
    room[3] = -1
    total, n_blocks, n_colors, n_links = _arrange(
        movable, _block_bits(cells, len(movable)), touch, room, order, blocks, offsets, links
    )
    return Coloring(
        order[:total], blocks[: n_blocks + 1], offsets[: n_colors + 1], links[:n_links]
    )


def run_chunks(
    pool: Pool | None,
    threads: int,
    coloring: Coloring,
    work: Callable[[int, int], T],
) -> list[T]:
    """Call ``work(start, stop)`` over chunks of the vertices in order; returns what it returned.

    A chunk begins when all chunks that it touches and that come before it have ended.

    Parameters
    ----------
    pool : Pool or None    None runs everything here, in pieces
    threads : int                        least number of chunks a colour is cut into, between blocks
    coloring : Coloring
    work : callable                      releases the GIL; works on coloring.order[start:stop]
    """
    blocks = coloring.blocks.tolist()
    if pool is None or blocks[-1] < threads * SMALLEST:
        return [work(first, last) for first, last in pieces(0, blocks[-1])]
    starts: list[int] = []
    for first, last in pairwise(coloring.offsets.tolist()):
        start, size = blocks[first], blocks[last] - blocks[first]
        count = max(1, min(TURNS * threads, size // SMALLEST), -(-size // PIECE))
        starts += {blocks[bisect_left(blocks, start + size * t // count, first, last)]: None
                   for t in range(count)}
    chunk = np.searchsorted(starts, coloring.blocks[:-1], side="right") - 1
    touch = np.zeros((len(starts), len(starts)), dtype=np.bool_)
    touch[chunk[coloring.links[:, 0]], chunk[coloring.links[:, 1]]] = True
    return pool.run(work, list(pairwise([*starts, blocks[-1]])), np.argwhere(touch).tolist())
