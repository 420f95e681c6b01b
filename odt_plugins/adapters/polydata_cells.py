"""Cells of PolyData, stored one after another as a count and so many indices of points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

IndexArray = NDArray[np.int64]


def sizes_and_starts(cells: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Numbers of vertices of cells stored as count, indices, ..., and where these begin."""
    heads = np.flatnonzero(~are_vertices(cells))
    return cells[heads].astype(np.int64), heads + 1


def segments_of(lines: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Segments (q, 2) of poly-lines stored as count, indices, ..., and how many each has."""
    rows, at = [], 0
    while at < len(lines):
        chain = lines[at + 1 : at + 1 + lines[at]]
        rows.append(np.stack([chain[:-1], chain[1:]], axis=1))
        at += 1 + int(lines[at])
    return np.concatenate(rows), np.array([len(part) for part in rows])


def with_middles(
    lines: IndexArray, split: Callable[[IndexArray], NDArray[np.int64]]
) -> NDArray[np.int64]:
    """Poly-lines, each segment of which is split into two: one vertex more on every one."""
    size, start = sizes_and_starts(lines)
    rows, parts = segments_of(lines)
    chains = np.insert(split(rows)[:, 0], 2 * np.cumsum(parts), lines[start + size - 1])
    size += parts
    return np.insert(chains, np.cumsum(size) - size, size)


def with_numbers(cells: IndexArray, number: NDArray[np.int64]) -> IndexArray:
    """Cells as count, indices, count, indices, ... of vertices with other numbers."""
    out, inside = cells.copy(), are_vertices(cells)
    out[inside] = number[cells[inside]]
    return out


def are_vertices(cells: IndexArray) -> NDArray[np.bool_]:
    """Which of count, indices, count, indices, ... are indices."""
    out, at = np.ones(len(cells), dtype=np.bool_), 0
    if len(cells):
        every = int(cells[0]) + 1
        if len(cells) % every == 0 and (cells[::every] == every - 1).all():
            out[::every] = False
            return out
    while at < len(cells):
        out[at] = False
        at += 1 + int(cells[at])
    return out
