"""Cells across every facet."""

from __future__ import annotations

from typing import Any

import numpy as np

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.compiled.threads import pieces
from odt_plugins.engine.topology.star import PARTS, OffsetArray, Stars, vertex_stars
from odt_plugins.errors import InvalidMeshError
from odt_plugins.mesh.arrays import IntArray
from odt_plugins.mesh.chunks import Pool


@kernel
def _match_facets(
    cells: IntArray,
    indptr: OffsetArray,
    indices: IntArray,
    head: OffsetArray,
    chain: OffsetArray,
    used: OffsetArray,
    neighbors: IntArray,
    first: int,
    last: int,
) -> Any:
    """Pair facets of the same smallest vertex; first facet with three cells or -1.

    Only those with a smallest vertex from first to last; others can be paired at the same time.

    head[i] starts the chain of facets seen around the current vertex whose other vertices add up
    to i, modulo its length; ``used`` lists these i. A facet is numbered 4 * cell + local index of
    the opposite vertex.
    """
    n = head.shape[0]
    k = cells.shape[1]
    for v in range(first, last):
        count = 0
        for s in range(indptr[v], indptr[v + 1]):
            c = indices[s]
            below = 0
            for a in range(k):
                below += cells[c, a] < v
            if below > 1:
                continue
            for opposite in range(k):
                if cells[c, opposite] == v or (below == 1 and cells[c, opposite] > v):
                    continue
                mid = top = -1
                for a in range(k):
                    u = cells[c, a]
                    if a == opposite or u == v:
                        continue
                    if mid == -1:
                        mid = u
                    elif u < mid:
                        top = mid
                        mid = u
                    else:
                        top = u
                facet = (c << 2) + opposite
                place = mid + top
                if place >= n:
                    place -= n
                other = head[place]
                for _ in range(count):
                    if other == -1:
                        break
                    oc = other >> 2
                    shared = 0
                    for a in range(k):
                        u = cells[oc, a]
                        shared += a != other & 3 and (u == mid or u == top)
                    if shared == k - 2:
                        break
                    other = chain[other]
                if other == -1:
                    chain[facet] = head[place]
                    head[place] = facet
                    used[count] = place
                    count += 1
                else:
                    oc = other >> 2
                    if neighbors[oc, other & 3] != -1:
                        return facet
                    neighbors[oc, other & 3] = c
                    neighbors[c, opposite] = oc
        for i in range(count):
            head[used[i]] = -1
    return -1


def cell_neighbors(
    cells: IntArray, stars: Stars | None = None, pool: Pool | None = None
) -> IntArray:
    """Find the cell across every facet.

    Parameters
    ----------
    cells : (m, d + 1) int32     each of different vertices, d at least 2
    stars : Stars, optional      of these cells, when already known
    pool : Pool, optional
        shares the work; the result does not depend on it

    Returns
    -------
    (m, d + 1) int32             cell that shares the facet opposite to local vertex i, -1 outside

    Raises
    ------
    InvalidMeshError             three cells share a facet
    """
    cells = np.ascontiguousarray(cells, dtype=np.int32)
    neighbors = np.full(cells.shape, -1, dtype=np.int32)
    if cells.size == 0:
        return neighbors
    if stars is None:
        stars = vertex_stars(cells, int(cells.max()) + 1, pool)
    n = stars.indptr.size - 1
    chain = np.empty(4 * len(cells), dtype=np.int64)
    largest = stars.largest()

    def match(first: int, last: int) -> int:
        head = np.full(n, -1, dtype=np.int64)
        used = np.empty(cells.shape[1] * largest, dtype=np.int64)
        for start, stop in pieces(first, last):
            bad = int(_match_facets(cells, *stars, head, chain, used, neighbors, start, stop))
            if bad >= 0:
                return bad
        return -1

    parts = 1 if pool is None else PARTS
    cuts = [n * part // parts for part in range(parts + 1)]
    run = map if pool is None else pool.map
    for bad in run(match, cuts[:-1], cuts[1:]):
        if bad < 0:
            continue
        cell, opposite = divmod(bad, 4)
        facet = np.delete(cells[cell], opposite).tolist()
        msg = (
            f"got a third cell on the facet {facet} at index {cell}, expected at most two cells "
            "on a facet, try removing doubled or overlapping cells"
        )
        raise InvalidMeshError(msg)
    return neighbors
