"""Stage 2 in the plane: descent of F_p by edge flips and Newton steps.

A small p over the whole mesh serves the mean, a large p near the worst triangles the minimum.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.finish.descent import finish_phase
from odt_plugins.engine.finish.phases import Phase, bulk, tail
from odt_plugins.engine.finish.triangles import TriangleDescent
from odt_plugins.engine.moves.compound2d import compound_pass_2d
from odt_plugins.engine.moves.flips2d import Rule, number_edges, quality_flips
from odt_plugins.engine.moves.newton2d import smooth_vertices_2d
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import cell_shapes
from odt_plugins.engine.topology.coloring import run_chunks, vertex_coloring
from odt_plugins.engine.topology.star import Stars
from odt_plugins.engine.topology.triangles import Triangles
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.chunks import Pool


def finish2d(
    mesh: Triangles,
    movable: BoolArray,
    *,
    movable_cells: BoolArray | None = None,
    bounds: Extremes | None = None,
    phases: tuple[Phase, ...] | None = None,
    pool: Pool | None = None,
    threads: int = 1,
) -> tuple[int, int]:
    """Improve the shape of a planar mesh in place; its boundary and its vertices all stay.

    Parameters
    ----------
    mesh : Triangles              changed
    movable : (n,) bool           vertices that may move; none on the boundary or an interface
    movable_cells : (m,) bool     an edge is flipped only between two such cells; None means all
    bounds : Extremes             that may not appear where they were not before; None takes those
                                  of the mesh
    phases : tuple of Phase       what is done, in order; None takes the whole schedule
    pool, threads                 see :func:`run_chunks`; the result does not depend on them

    Returns
    -------
    flips, moves : int            edges that were flipped, moves of vertices
    """
    if len(mesh.cells) == 0:
        return 0, 0
    if bounds is None:
        shapes = cell_shapes(mesh.points, mesh.cells)
        bounds = Extremes(
            float(shapes[:, 0].min()), float(shapes[:, 1].max()), float(shapes[:, 2].min())
        )
    flips = moves = 0
    for phase in bulk(2) + tail(2) if phases is None else phases:
        descent = _PlaneDescent(mesh, phase, bounds, movable, movable_cells, pool, threads)
        flips += descent.compound()
        done = finish_phase(descent, phase)
        flips += done[0]
        moves += done[1]
    return flips, moves


class _PlaneDescent(TriangleDescent):
    """A planar mesh under one phase, see :class:`odt_plugins.engine.finish.descent.Descending`."""

    gain = POLICY.plane_gain

    def __init__(
        self, mesh: Triangles, phase: Phase, bounds: Extremes, movable: BoolArray,
        movable_cells: BoolArray | None, pool: Pool | None, threads: int,
    ) -> None:
        super().__init__(mesh, phase)
        self.bounds, self.movable = bounds, movable
        self.pool, self.threads = pool, threads
        every: BoolArray = np.ones(len(mesh.cells), dtype=np.bool_)
        self.movable_cells = every if movable_cells is None else movable_cells

    def flip_some(self, seeds: BoolArray, changed: BoolArray) -> int:
        """Flip from the seeds on."""
        return quality_flips(self.mesh, self.phase.cost, self.bounds,
                             movable_cells=self.movable_cells, seeds=seeds, changed=changed)

    def compound_moves(self, tried: BoolArray, excess: FloatArray) -> Callable[[IntArray], int]:
        """What tries compound moves at some cells."""
        rule = Rule(self.phase.cost, self.bounds, self.movable_cells, ~self.movable, True)
        edges = number_edges(self.mesh.neighbors)
        return lambda order: compound_pass_2d(self.mesh, edges, order, rule, tried, excess)

    def sweep(self, stars: Stars, active: BoolArray, moved: FloatArray) -> int:
        """Smooth every active vertex once, block after block; returns how many moved."""
        coloring = vertex_coloring(self.cells, active & self.movable)

        def work(start: int, stop: int) -> int:
            return int(smooth_vertices_2d(self.points, self.cells, stars, coloring.order, start,
                                          stop, self.phase.cost, self.bounds, moved))

        return sum(run_chunks(self.pool, self.threads, coloring, work))
