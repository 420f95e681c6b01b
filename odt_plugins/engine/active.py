"""Which vertices and cells are worth a visit: those whose surroundings changed."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(nogil=True, cache=True)
def vertices_of_pending(cells, status, active):
    """Mark the vertices of all pending cells."""
    for c in range(cells.shape[0]):
        if status[c] == 1 and cells[c, 0] >= 0:
            for a in range(cells.shape[1]):
                active[cells[c, a]] = True


@njit(nogil=True, cache=True)
def spread(cells, indptr, indices, moved, tolerance, active, status):
    """Start the next round from the vertices whose move paid off.

    Every vertex that shares a cell with a vertex of ``moved > tolerance`` becomes active, all
    others passive; the cells around such a vertex become pending.  Returns the number of them.
    """
    n = moved.shape[0]
    for v in range(n):
        active[v] = False
    count = 0
    for v in range(n):
        if moved[v] > tolerance:
            count += 1
            for s in range(indptr[v], indptr[v + 1]):
                c = indices[s]
                status[c] = 1
                for a in range(cells.shape[1]):
                    active[cells[c, a]] = True
    return count


@njit(nogil=True, cache=True)
def color_vertices(cells, indptr, indices, wanted, color, mark):
    """Greedy colouring: wanted vertices that share a cell differ; others get -1.

    ``mark`` is a work array longer than the number of colours ever needed; returns that number.
    """
    n = indptr.shape[0] - 1
    colors = 0
    for v in range(n):
        color[v] = -1
    for v in range(n):
        if not wanted[v]:
            continue
        for s in range(indptr[v], indptr[v + 1]):
            c = indices[s]
            for a in range(cells.shape[1]):
                k = color[cells[c, a]]
                if k >= 0:
                    mark[k] = v
        k = 0
        while mark[k] == v:
            k += 1
        color[v] = k
        colors = max(colors, k + 1)
    return colors


def vertex_order(cells, stars, wanted):
    """Wanted vertices, colour after colour, and where each colour starts.

    Parameters
    ----------
    cells : (m, d + 1) int32, stars : Stars
    wanted : (n,) bool

    Returns
    -------
    (k,) int32           vertices; those of one colour share no cell
    (c + 1,) int64       offsets of the colours
    """
    n = len(wanted)
    longest = int(np.diff(stars.indptr).max(initial=0)) * cells.shape[1] + 2
    color = np.empty(n, dtype=np.int32)
    mark = np.full(longest, -1, dtype=np.int32)
    colors = color_vertices(cells, stars.indptr, stars.indices, wanted, color, mark)
    order = np.argsort(color, kind="stable").astype(np.int32)
    counts = np.bincount(color + 1, minlength=colors + 1)
    return order[counts[0] :].copy(), np.concatenate(([0], np.cumsum(counts[1:])))
