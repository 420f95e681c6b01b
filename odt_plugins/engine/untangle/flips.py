"""Cells reconnected where no places of their vertices are valid: few, so in plain Python.

In space an edge is removed, with the best triangulation of the ring around it, or a facet is
replaced by an edge; in the plane an edge is flipped. A change is kept when the worst of the cells
it makes is better than the worst of those it takes.

References
----------
L. A. Freitag, C. Ollivier-Gooch, Tetrahedral mesh improvement using swapping and smoothing, Int. J.
Numer. Methods Eng. 40 (1997) 3979-4002.
J. R. Shewchuk, Two discrete optimization algorithms for the topological improvement of tetrahedral
meshes (2002): the triangulation of a ring by dynamic programming, after Klincsek.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np

from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray, LongArray
from odt_plugins.mesh.simplex import SimplexMesh, determinant

RING = 9
"""Most vertices of a ring around an edge that is removed."""

PASSES = 20
"""Most visits of every inverted or flat cell."""

FEW = 100
"""Most of them: more are no matter of flips."""

LEAST_GAIN = 1e-9
"""By how much the worst cell must be better after a change."""

Cell = tuple[int, ...]


class Change(NamedTuple):
    """A flip: the numbers of the cells it takes away, and the cells it makes instead."""

    taken: set[int]
    made: list[Cell]


def reconnected(
    points: FloatArray, mesh: SimplexMesh, bad: BoolArray
) -> tuple[IntArray, LongArray, int]:
    """Reconnect cells around inverted or flat ones; regions are not mixed, frozen cells stay.

    Parameters
    ----------
    points : (n, d) float64    where the vertices of the mesh are now
    mesh : SimplexMesh         of cells that agree about their orientation
    bad : (m,) bool            inverted or flat ones

    Returns
    -------
    cells : (m', d + 1) int32
    source : (m',) int64       a cell of the same region, the same one where it is still there
    flips : int                how many changes were kept, 0 where none helps
    """
    patch = _Patch(points, mesh)
    waiting = np.flatnonzero(bad).tolist()
    flips = 0
    for _ in range(PASSES if len(waiting) <= FEW else 0):
        before = flips
        made: list[int] = []
        for number in waiting:
            change = patch.best_change(number) if number in patch.cells else None
            if change is not None:
                made += patch.replace(change)
                flips += 1
        waiting = [i for i in waiting + made
                   if i in patch.cells and patch.worst([patch.cells[i]]) <= 0.0]
        if flips == before or not waiting:
            break
    rows = sorted(patch.cells)
    return (np.array([patch.cells[i] for i in rows], dtype=np.int32),
            np.array([patch.source[i] for i in rows], dtype=np.int64), flips)


def alternatives(
    points: FloatArray, mesh: SimplexMesh, bad: BoolArray
) -> Iterator[tuple[IntArray, LongArray]]:
    """Single changes around inverted cells, though they do not help where vertices are now.

    Yields
    ------
    cells, source    as for :func:`reconnected`; the best one of every cell first
    """
    patch = _Patch(points, mesh)
    rows = np.arange(len(mesh.cells))
    for number in np.flatnonzero(bad).tolist():
        found = sorted(patch.changes(number), key=lambda change: -patch.worst(change.made))
        for taken, made in found:
            kept = np.delete(rows, sorted(taken))
            source = np.concatenate([kept, np.full(len(made), min(taken))])
            yield np.concatenate([mesh.cells[kept], np.array(made, dtype=np.int32)]), source


class _Patch:
    """Cells of a mesh by their numbers, with the cells around every vertex."""

    def __init__(self, points: FloatArray, mesh: SimplexMesh) -> None:
        self.mesh = mesh
        self.places: list[list[float]] = points.tolist()
        self.volumes: dict[Cell, float] = {}
        self.cells: dict[int, Cell] = dict(enumerate(map(tuple, mesh.cells.tolist())))
        self.source = {i: i for i in self.cells}
        self.next = len(self.cells)
        self.star: dict[int, set[int]] = {}
        for i, cell in self.cells.items():
            for v in cell:
                self.star.setdefault(v, set()).add(i)

    def holding(self, *vertices: int) -> set[int]:
        """Numbers of the cells that have all of some vertices."""
        return set.intersection(*(self.star[v] for v in vertices))

    def worst(self, cells: list[Cell]) -> float:
        """Least signed volume of some cells, relative to the power of their longest edges."""
        return min(map(self.volume, cells))

    def volume(self, cell: Cell) -> float:
        """Signed volume of a cell, as :meth:`worst` has it."""
        known = self.volumes.get(cell)
        if known is None:
            x = [self.places[v] for v in cell]
            edges = [[a - b for a, b in zip(y, x[0], strict=True)] for y in x[1:]]
            longest = max(sum((a - b) * (a - b) for a, b in zip(y, z, strict=True))
                          for y, z in combinations(x, 2))
            size = longest * math.sqrt(longest) if len(edges) == 3 else longest
            known = float(determinant(edges)) / (size or 1.0)
            self.volumes[cell] = known
        return known

    def replace(self, change: Change) -> list[int]:
        """Put cells in the place of others; their numbers."""
        source = self.source[min(change.taken)]
        for i in change.taken:
            del self.source[i]
            for v in self.cells.pop(i):
                self.star[v].discard(i)
        numbers = list(range(self.next, self.next + len(change.made)))
        self.next += len(change.made)
        for i, cell in zip(numbers, change.made, strict=True):
            self.cells[i], self.source[i] = cell, source
            for v in cell:
                self.star[v].add(i)
        return numbers

    def best_change(self, number: int) -> Change | None:
        """The change around a cell with the best worst cell, None if none is better than now."""
        found = None
        best = LEAST_GAIN
        for change in self.changes(number):
            now = self.worst([self.cells[i] for i in sorted(change.taken)])
            gain = self.worst(change.made) - now
            if gain > best:
                found, best = change, gain
        return found

    def changes(self, number: int) -> Iterator[Change]:
        """Changes that take a cell, and no frozen cells nor those of several regions."""
        cell = self.cells[number]
        for change in self._in_the_plane(cell) if len(cell) == 3 else self._in_space(cell):
            old = [self.source[i] for i in sorted(change.taken)]
            if not self.mesh.frozen[old].any() and not np.ptp(self.mesh.regions[old]):
                yield change

    def _in_the_plane(self, cell: Cell) -> Iterator[Change]:
        """The flips of the three edges."""
        for a, b, c in (cell, (*cell[1:], cell[0]), (cell[2], *cell[:2])):
            taken = self.holding(a, b)
            if len(taken) != 2:
                continue
            d = next(v for i in sorted(taken) for v in self.cells[i] if v not in (a, b, c))
            if not self.holding(c, d):
                yield Change(taken, [(a, d, c), (d, b, c)])

    def _in_space(self, cell: Cell) -> Iterator[Change]:
        """The removals of the six edges, and the replacements of the four facets by edges."""
        for a, b in combinations(cell, 2):
            ring = self._ring(a, b)
            made = self._filled(ring, a, b) if ring else None
            if made:
                yield Change(self.holding(a, b), made)
        for corner in range(4):
            p, q, r = (v for i, v in enumerate(cell) if i != corner)
            e = cell[corner]
            if not _even(cell, (p, q, r, e)):
                p, q = q, p
            taken = self.holding(p, q, r)
            if len(taken) != 2:
                continue
            d = next(v for i in sorted(taken) for v in self.cells[i] if v not in cell)
            if not self.holding(d, e):
                yield Change(taken, [(d, e, p, q), (d, e, q, r), (d, e, r, p)])

    def _ring(self, a: int, b: int) -> list[int]:
        """Vertices p, q, ... around an edge of cells (a, b, p, q) and so on; none if it is open."""
        after: dict[int, int] = {}
        for i in self.holding(a, b):
            cell = self.cells[i]
            p, q = (v for v in cell if v not in (a, b))
            p, q = (p, q) if _even(cell, (a, b, p, q)) else (q, p)
            after[p] = q
        first = min(after)
        ring = [first]
        while after.get(ring[-1], first) != first:
            ring.append(after[ring[-1]])
            if len(ring) > len(after):
                return []
        closed = after.get(ring[-1]) == first and len(ring) == len(after)
        return ring if closed and 3 <= len(ring) <= RING else []

    def _filled(self, ring: list[int], a: int, b: int) -> list[Cell] | None:
        """The best cells between an edge and the triangulations of its ring, without the edge."""
        n = len(ring)
        if n == 3 and self.holding(*ring):
            return None
        best: dict[tuple[int, int], tuple[float, list[Cell]]] = {
            pair: (np.inf, []) for pair in pairwise(range(n))}
        for width in range(2, n):
            for i in range(n - width):
                k = i + width
                if width < n - 1 and self.holding(ring[i], ring[k]):
                    continue
                options = []
                for j in range(i + 1, k):
                    if (i, j) not in best or (j, k) not in best:
                        continue
                    p, q, r = ring[i], ring[j], ring[k]
                    made: list[Cell] = [(p, q, r, b), (q, p, r, a)]
                    least = min(best[i, j][0], best[j, k][0], self.worst(made))
                    options.append((least, best[i, j][1] + best[j, k][1] + made))
                if options:
                    best[i, k] = max(options, key=lambda option: option[0])
        return best[0, n - 1][1] if (0, n - 1) in best else None


def _even(cell: Cell, other: Cell) -> bool:
    """Whether two orders of the same vertices differ by an even permutation."""
    places = [cell.index(v) for v in other]
    return sum(x > y for x, y in combinations(places, 2)) % 2 == 0
