"""What the position steps need to know of a connectivity, built once and used until it changes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from odt_plugins.engine.topology.coloring import Coloring, touching_blocks, vertex_coloring
from odt_plugins.engine.topology.star import Stars, vertex_neighbors, vertex_stars
from odt_plugins.mesh.arrays import BoolArray, IntArray
from odt_plugins.mesh.chunks import Pool


@dataclass(frozen=True)
class Topology:
    """Connectivity with the vertices that may move.

    Attributes
    ----------
    cells : (m, d + 1) int32      positive
    movable : (n,) bool           vertices that may move
    is_boundary : (n,) bool       vertices on the boundary or an interface: their cells are the
                                  boundary elements of Section 4.2.1
    stars : Stars                 cells around every vertex
    pool : Pool or None
        shares the work of what is made later
    """

    cells: IntArray
    movable: BoolArray
    is_boundary: BoolArray
    stars: Stars
    pool: Pool | None = None

    @cached_property
    def boundary_cells(self) -> BoolArray:
        """Cells with at least one boundary vertex (isBdElem of Section 4.2.1), (m,)."""
        return np.any(self.is_boundary[self.cells], axis=1)

    @cached_property
    def coloring(self) -> Coloring:
        """Blocks of movable vertices in colours."""
        touch = touching_blocks(self.cells, self.movable, self.pool)
        return vertex_coloring(self.cells, self.movable, touch)

    @cached_property
    def neighbors(self) -> Stars:
        """Vertices that share a cell with every vertex."""
        return vertex_neighbors(self.cells, self.stars)

    @property
    def movable_share(self) -> float:
        """Share of the vertices of the cells that may move."""
        return float(self.movable.sum() / (np.diff(self.stars.indptr) > 0).sum())

    @cached_property
    def largest_star(self) -> int:
        """Most cells around one vertex."""
        return int(np.diff(self.stars.indptr).max(initial=0))


def make_topology(
    cells: IntArray, movable: BoolArray, is_boundary: BoolArray, stars: Stars | None = None,
    pool: Pool | None = None,
) -> Topology:
    """Build a :class:`Topology`; vertices of no cell are taken out of ``movable``."""
    cells = np.ascontiguousarray(cells, dtype=np.int32)
    if stars is None:
        stars = vertex_stars(cells, movable.size, pool)
    movable = np.ascontiguousarray(movable & (np.diff(stars.indptr) > 0))
    return Topology(cells, movable, np.ascontiguousarray(is_boundary), stars, pool)
