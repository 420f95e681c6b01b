"""Connected pieces of a graph."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.compiled.kernel import inner_kernel, kernel
from odt_plugins.mesh.arrays import LongArray


@inner_kernel
def _first(up: LongArray, v: int) -> int:
    """The node that stands for the piece of node v, and a shorter way to it."""
    for _ in range(up.shape[0]):
        if up[v] == v:
            break
        up[v] = up[up[v]]
        v = up[v]
    return v


@kernel
def _join(start: LongArray, end: LongArray, up: LongArray) -> None:
    """Join the pieces at the ends of every link, and number them by their first nodes in ``up``."""
    for k in range(start.shape[0]):
        a, b = _first(up, start[k]), _first(up, end[k])
        up[max(a, b)] = min(a, b)
    count = 0
    for v in range(up.shape[0]):
        # numbers that are known by now are negative
        if up[v] == v:
            count += 1
            up[v] = -count
        else:
            up[v] = up[up[v]]
    for v in range(up.shape[0]):
        up[v] = -1 - up[v]


def pieces_of(start: NDArray[Any], end: NDArray[Any], n: int) -> LongArray:
    """Number the connected pieces of n nodes that are linked in pairs, by their first nodes.

    Parameters
    ----------
    start, end : (k,) int     nodes of every link
    n : int

    Returns
    -------
    (n,) int64                piece of every node
    """
    piece = np.arange(n)
    _join(*(np.ascontiguousarray(ends, dtype=np.int64) for ends in (start, end)), piece)
    return piece
