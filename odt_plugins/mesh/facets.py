"""Facets of cells: one number for each, and those that do not have one cell on each side."""

from __future__ import annotations

from functools import partial
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.mesh.chunks import chunks, spread

WORDS = 1 << 64
"""Number of different keys that 64 bits can hold."""

SHARE = 1 << 16
"""Fewer keys than so many for each thread are sorted by one."""


class UnevenFacets(NamedTuple):
    """Facets that do not have just one cell on each side, by their vertices in increasing order.

    Attributes
    ----------
    open : (r, d) int64       no cell on one side, or crowded; of a valid mesh, its boundary
    crowded : (s, d) int64    a second, third, ... cell on one side; of a valid mesh, none
    """

    open: NDArray[np.int64]
    crowded: NDArray[np.int64]


def sorted_columns(rows: NDArray[Any]) -> tuple[list[NDArray[Any]], NDArray[np.bool_]]:
    """Sort every row (k,) of rows (m, k): the new columns, and which rows took an odd permutation.

    Vertices in an odd permutation are a cell or a facet the other way round.
    """
    columns = list(rows.T.copy())
    odd = np.zeros(len(rows), dtype=np.bool_)
    for i, j in combinations(range(len(columns)), 2):
        low, high = np.minimum(columns[i], columns[j]), np.maximum(columns[i], columns[j])
        odd ^= low != columns[i]
        columns[i], columns[j] = low, high
    return columns, odd


def row_keys(rows: NDArray[np.integer], n: int) -> NDArray[np.int64]:
    """Give one number for every row of indices below n: equal numbers are equal rows.

    Parameters
    ----------
    rows : (m, k) int    indices in [0, n)
    n : int

    Returns
    -------
    (m,) int64           in [0, 2^62); comparable within one call only
    """
    key = rows[:, 0].astype(np.int64)
    span = max(n, 1)
    for column in rows.T[1:]:
        if span > (WORDS >> 2) // max(n, 1):
            distinct, key = np.unique(key, return_inverse=True)
            span = len(distinct)
        key = key * n + column
        span *= n
    return key


def facets_within(
    cells: NDArray[np.integer], corners: NDArray[np.int64], owner: NDArray[np.integer]
) -> NDArray[np.int64]:
    """Facets (f, k - 1) of cells (m, k) whose vertices are all corners of one other cell.

    Parameters
    ----------
    cells : (m, k) int      simplices
    corners : (q,) int64    corners of other cells, of any number each
    owner : (q,) int        of which of these each is
    """
    k = cells.shape[1]
    near = np.sort(cells[np.isin(cells, corners).sum(axis=1) >= k - 1], axis=1).astype(np.int64)
    facets = np.concatenate([np.delete(near, i, axis=1) for i in range(k)])
    facets = np.unique(facets[np.isin(facets, corners).all(axis=1)], axis=0)
    order = np.argsort(corners, kind="stable")
    start, stop = (np.searchsorted(corners[order], facets[:, 0], end) for end in ("left", "right"))
    which = np.repeat(np.arange(len(facets)), stop - start)
    place = np.arange(len(which)) - np.repeat((stop - start).cumsum() - stop, stop - start)
    width = int(owner.max(initial=0)) + 1
    keys = facets[which] * width + owner[order][place][:, None]
    within = np.isin(keys, corners * width + owner).all(axis=1)
    return facets[np.unique(which[within])]


def directed_facets(
    cells: NDArray[np.int32], n: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Key and side of every facet of positively oriented cells.

    Returns
    -------
    key : (m, d + 1) int64     equal for facets of the same vertices
    side : (m, d + 1) int64    0 or 1: on which side of the facet its cell lies

    Notes
    -----
    Column i leaves out the i-th smallest vertex of the cell. With the vertices sorted by a
    permutation of parity s the induced orientation of that facet is (-1)^(s + i).
    """
    m, k = cells.shape
    columns, odd = sorted_columns(cells)
    facets = [np.stack(columns[:i] + columns[i + 1 :], axis=1) for i in range(k)]
    key = row_keys(np.concatenate(facets), n).reshape(k, m).T
    return key, odd[:, None] ^ (np.arange(k) & 1)


def _sort(values: NDArray[Any], threads: int) -> None:
    """Sort in place, by shares of equal length, one a thread, with larger and larger values."""
    size = len(values)
    shares = threads if size >= threads * SHARE else 1
    parts = [slice(size * k // shares, size * (k + 1) // shares) for k in range(shares)]
    if shares > 1:
        values.partition([part.start for part in parts[1:]])
    spread(lambda part: values[part].sort(), parts, threads)


def uneven_facets(cells: NDArray[np.integer], n: int, threads: int = 1) -> UnevenFacets:
    """Find the facets that do not have just one cell on each side.

    Parameters
    ----------
    cells : (m, d + 1) int    in [0, n)
    n : int
    threads : int             how many share the work

    Notes
    -----
    A facet is one number of 64 bits, its vertices and then its side, see :func:`directed_facets`,
    so that sorting brings both sides together; in several goes, by the smallest vertex, where
    those bits do not suffice.
    """
    d = cells.shape[1] - 1
    step = max(1, min(n, WORDS // (2 * max(n, 1) ** (d - 1))))
    single, double = [], []
    for first in range(0, n, step):
        keys = partial(_facet_keys, cells, n, first, step)
        key = np.concatenate(spread(keys, chunks(len(cells)), threads))
        _sort(key, threads)
        for lone, again in spread(partial(_uneven_keys, key), chunks(len(key)), threads):
            single.append(_vertices(lone, first, n, d))
            double.append(_vertices(again, first, n, d))
    return UnevenFacets(np.concatenate(single), np.concatenate(double))


def _facet_keys(
    cells: NDArray[np.integer], n: int, first: int, step: int, part: slice
) -> NDArray[np.uint64]:
    """Numbers of the facets of some cells whose smallest vertex is from ``first`` on."""
    ordered, odd = sorted_columns(cells[part])
    columns = [column.astype(np.uint64) for column in ordered]
    keys = []
    for i in range(len(columns)):
        lowest, *others = columns[:i] + columns[i + 1 :]
        here = slice(None) if step == n else (lowest >= first) & (lowest < first + step)
        key = lowest[here] - np.uint64(first)
        for column in others:
            key = key * np.uint64(n) + column[here]
        keys.append(2 * key + (odd[here] ^ (i % 2 == 1)))
    return np.concatenate(keys)


def _uneven_keys(
    key: NDArray[np.uint64], part: slice
) -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
    """Find the keys in a part of the sorted ones that lack the other side, and repeated keys."""
    low = max(part.start - 1, 0)
    near = key[low : part.stop + 1]
    own = slice(part.start - low, part.stop - low)
    paired = np.zeros(len(near) + 1, dtype=np.bool_)
    paired[1:-1] = near[:-1] ^ np.uint64(1) == near[1:]
    again = np.zeros(len(near), dtype=np.bool_)
    again[1:] = near[1:] == near[:-1]
    lone = ~(paired[1:] | paired[:-1])
    return near[own][lone[own]], near[own][again[own]]


def _vertices(key: NDArray[np.uint64], first: int, n: int, d: int) -> NDArray[np.int64]:
    """The vertices (r, d) of facets by their keys in :func:`uneven_facets`."""
    rest = key >> np.uint64(1)
    out = np.empty((len(key), d), dtype=np.int64)
    for column in range(d - 1, 0, -1):
        rest, out[:, column] = np.divmod(rest, np.uint64(n))
    out[:, 0] = rest + np.uint64(first)
    return out
