"""A surface without edges that have no length but for rounding, as booleans leave them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.run.outcome import Leaving, Outcome, unchanged
from odt_plugins.engine.topology.star import vertex_stars
from odt_plugins.mesh.arrays import BoolArray, IntArray, LongArray
from odt_plugins.mesh.faces import Faces, renumbered
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.mesh.surface import Edges, surface_edges
from odt_plugins.options import Options

SAME = 64 * float(np.finfo(np.float64).eps)
"""Largest length of an edge that counts as none, as a part of the largest coordinate."""


class Welded(NamedTuple):
    """A surface with fewer vertices.

    Attributes
    ----------
    mesh : SimplexMesh
    kept : (n',) int     vertices that it has
    left : (m,) bool     triangles that it has
    """

    mesh: SimplexMesh
    kept: IntArray
    left: BoolArray

    def before(self, outcome: Outcome) -> LongArray:
        """Vertex (k,) of the mesh before of every vertex of an outcome, -1 for new ones."""
        if outcome.origin is None:
            return self.kept.astype(np.int64)
        return np.where(outcome.origin < 0, -1, self.kept[outcome.origin]).astype(np.int64)


def welded(mesh: SimplexMesh) -> Welded | None:
    """Let the ends of edges without length be one, where topology and labels stay what they are.

    None where there are no such edges, or none vanishes. Vertices that are held stay, and so do
    those on rims and on borders between labels.
    """
    n = len(mesh.points)
    edges = surface_edges(mesh.cells, n)
    step = mesh.points[edges.vertices[:, 1]] - mesh.points[edges.vertices[:, 0]]
    least = SAME * float(np.abs(mesh.points[mesh.cells]).max(initial=0.0))
    short = edges.vertices[(step * step).sum(axis=1) <= least * least]
    held = _held(mesh, edges)
    short = short[~held[short].all(axis=1)]
    if not len(short):
        return None
    star = _Stars(mesh.cells, n)
    became = np.arange(n, dtype=np.int32)
    for one, two in short.tolist():
        while became[one] != one:
            one = int(became[one])
        while became[two] != two:
            two = int(became[two])
        a, b = (two, one) if held[two] else (one, two)
        if a != b and not held[b] and star.contract(a, b):
            became[b] = a
    if star.left.all():
        return None
    kept = np.flatnonzero(became == np.arange(n)).astype(np.int32)
    return Welded(_part(mesh, star.cells, star.left, kept), kept, star.left)


def as_welded(
    mesh: SimplexMesh, small: Welded, options: Options, leaving: Leaving,
    run: Callable[[SimplexMesh, Options, Leaving], Outcome],
) -> Outcome:
    """Run as on a surface with fewer vertices: its outcome by the numbers of the mesh.

    Where the smaller surface comes back as it is the mesh does.
    """
    def own(outcome: Outcome) -> Outcome:
        left = leaving(replace(outcome, origin=small.before(outcome)))
        return replace(left, origin=outcome.origin)

    given = options.density
    if isinstance(given, np.ndarray) and given.ndim:
        rows = {len(small.left): small.left, len(mesh.points): small.kept}
        options = replace(options, density=given[rows[len(given)]])
    found = run(small.mesh, options, own)
    if found.origin is None:
        outcome = leaving(unchanged(mesh, found.stop_reason))
        return replace(outcome, fallback=found.fallback, notes=found.notes)
    return replace(found, origin=small.before(found))


class _Stars:
    """Triangles (m, 3) by their vertices, of which edges may be contracted."""

    def __init__(self, cells: IntArray, n: int) -> None:
        self.cells, self.left = cells.copy(), np.ones(len(cells), dtype=np.bool_)
        self.stars, self.known = vertex_stars(cells, n), dict[int, set[int]]()

    def of(self, vertex: int) -> set[int]:
        """The triangles at a vertex."""
        if vertex not in self.known:
            first, last = self.stars.indptr[vertex : vertex + 2]
            self.known[vertex] = set(self.stars.indices[first:last].tolist())
        return self.known[vertex]

    def around(self, vertex: int) -> set[int]:
        """The neighbours of a vertex, and itself."""
        return set(self.cells[sorted(self.of(vertex))].ravel().tolist())

    def contract(self, a: int, b: int) -> bool:
        """Let b become a where the link condition holds; whether it does."""
        both = self.of(a) & self.of(b)
        ends = {a, b}
        far = [next(iter({*self.cells[t].tolist()} - ends)) for t in sorted(both)]
        apart = self.around(a) & self.around(b) - ends
        if len(both) != 2 or apart != {*far} or len(apart) != 2 or any(
                len(self.of(v)) < 4 for v in far):
            return False
        for t, v in zip(sorted(both), far, strict=True):
            self.left[t] = False
            for vertex in (a, b, v):
                self.of(vertex).discard(t)
        for t in self.of(b):
            self.cells[t] = np.where(self.cells[t] == b, a, self.cells[t])
        self.of(a).update(self.known.pop(b))
        return True


def _held(mesh: SimplexMesh, edges: Edges) -> BoolArray:
    """Mark the vertices (n,) that stay."""
    held = mesh.fixed | mesh.anchored | mesh.coupled
    for rows in (mesh.stays, mesh.lines, mesh.faces[0].rows, mesh.cells[mesh.frozen],
                 edges.vertices[edges.degree != 2]):
        held[rows] = True
    own = np.repeat(mesh.regions, 3)
    across = edges.neighbors.ravel()
    other = (across >= 0) & (mesh.regions[across] != own)
    held[edges.vertices[edges.of_cell.ravel()[other]]] = True
    return held


def _part(mesh: SimplexMesh, cells: IntArray, left: BoolArray, kept: IntArray) -> SimplexMesh:
    """The mesh of some triangles (m, 3) and vertices."""
    number = np.full(len(mesh.points), -1, dtype=np.int32)
    number[kept] = np.arange(len(kept), dtype=np.int32)
    lines: Faces = renumbered(mesh.faces[0], number)
    return replace(
        mesh, points=mesh.points[kept], cells=number[cells[left]], regions=mesh.regions[left],
        fixed=mesh.fixed[kept], frozen=mesh.frozen[left], stays=number[mesh.stays],
        lines=number[mesh.lines], anchored=mesh.anchored[kept], coupled=mesh.coupled[kept],
        faces=(lines, mesh.faces[1]), metric=mesh.metric[kept] if len(mesh.metric) else mesh.metric)
