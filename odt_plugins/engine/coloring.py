"""Colours for Gauss-Seidel: vertices of one colour share no cell, so they can move at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from odt_plugins.engine.star import OffsetArray, Stars
from odt_plugins.mesh import BoolArray, IntArray


class Coloring(NamedTuple):
    """Vertices in groups: colour c is ``order[offsets[c]:offsets[c + 1]]``, ascending.

    Attributes
    ----------
    order : (v,) int32
    offsets : (number of colours + 1,) int64
    """

    order: IntArray
    offsets: OffsetArray


@njit(nogil=True, cache=True)
def _greedy(
    cells: IntArray,
    indptr: OffsetArray,
    indices: IntArray,
    movable: BoolArray,
    color: IntArray,
    taken: IntArray,
) -> None:
    """Give every movable vertex the lowest colour free among its neighbours; taken[c] = i marks."""
    k = cells.shape[1]
    for i in range(movable.shape[0]):
        if not movable[i]:
            continue
        for s in range(indptr[i], indptr[i + 1]):
            c = indices[s]
            for a in range(k):
                other = color[cells[c, a]]
                if other >= 0:
                    taken[other] = i
        low = 0
        while taken[low] == i:
            low += 1
        color[i] = low


def vertex_coloring(cells: IntArray, stars: Stars, movable: BoolArray) -> Coloring:
    """Colour the movable vertices so that no cell holds two of one colour.

    Parameters
    ----------
    cells : (m, d + 1) int32
    stars : Stars              of these cells
    movable : (n,) bool        vertices to colour; the others do not take part

    Returns
    -------
    Coloring                   greedy in order of index: the same for the same mesh
    """
    n = movable.size
    if not movable.any():
        return Coloring(np.empty(0, dtype=np.int32), np.zeros(1, dtype=np.int64))
    color = np.full(n, -1, dtype=np.int32)
    most = int(np.diff(stars.indptr).max(initial=0)) * cells.shape[1]
    taken = np.full(min(most, n) + 1, -1, dtype=np.int32)
    _greedy(cells, stars.indptr, stars.indices, movable, color, taken)
    vertices = np.flatnonzero(movable)
    order = vertices[np.argsort(color[vertices], kind="stable")].astype(np.int32)
    offsets = np.concatenate([[0], np.cumsum(np.bincount(color[vertices]))]).astype(np.int64)
    return Coloring(order, offsets)
