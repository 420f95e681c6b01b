"""The loops of Section 5 as printed: so many steps, each of positions, then of connectivity."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from odt_plugins.engine.cells.geometry import boundary_vertices
from odt_plugins.engine.moves.flips2d import lawson_flips
from odt_plugins.engine.odt.delaunay import delaunay_exchange
from odt_plugins.engine.odt.sweeps import StepStats
from odt_plugins.engine.topology.adjacency import cell_neighbors
from odt_plugins.engine.topology.stencil import Topology, make_topology
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray

PositionStep = Callable[[FloatArray, Topology], tuple[FloatArray, StepStats]]
Reconnect = Callable[[FloatArray, IntArray], IntArray]


def iterate(
    points: FloatArray,
    cells: IntArray,
    step: PositionStep,
    reconnect: Reconnect | None,
    steps: int,
    *,
    every: int = 1,
    fixed: BoolArray | None = None,
) -> Iterator[tuple[FloatArray, IntArray]]:
    """Run the loop of Section 5 (local) or of Section 5.2 (global) and give out every mesh.

    Parameters
    ----------
    points : (n, d) float64       not changed
    cells : (m, d + 1) int32      positive; not changed
    step : callable               points, topology -> points, stats: ``gauss_seidel_sweep``,
                                  ``jacobi_sweep``, ``global_step``, ``cvt_step``
    reconnect : callable          points, cells -> cells: :func:`flip_once`,
                                  :func:`delaunay_cells`; None keeps the connectivity
    steps : int
    every : int                   steps of positions before one of connectivity (Section 5.4: 2)
    fixed : (n,) bool, optional   vertices that stay, besides those of the boundary

    Yields
    ------
    points (n, d) float64, cells (m', d + 1) int32     the start, then the mesh after every step

    Notes
    -----
    Nothing is finished or guarded beyond what ``step`` itself does: these are the paper's own
    methods, to be compared with :func:`odt_plugins.optimize`.

    References
    ----------
    CMAME 200 (2011) 967-984, Section 5, Section 5.2, Section 5.4.
    """
    points = np.array(points, dtype=np.float64, order="C")
    cells = np.array(cells, dtype=np.int32, order="C")
    rim = boundary_vertices(cells, len(points))
    movable = ~rim if fixed is None else ~(rim | fixed)
    topology = make_topology(cells, movable, rim)
    yield points, cells
    for k in range(1, steps + 1):
        points, _ = step(points, topology)
        if reconnect is not None and k % every == 0:
            cells = reconnect(points, cells)
            topology = make_topology(cells, movable, rim)
        yield points, cells


def flip_once(points: FloatArray, cells: IntArray) -> IntArray:
    """Visit every edge of a planar mesh once and flip it if it is not locally Delaunay.

    References
    ----------
    CMAME 200 (2011) 967-984, Section 3.1; "we do not repeat edge flipping", Section 5.
    """
    flipped = np.array(cells, dtype=np.int32, order="C")
    regions = np.zeros(len(cells), dtype=np.int32)
    lawson_flips(points, flipped, cell_neighbors(flipped), regions, one_sweep=True)
    return flipped


def delaunay_cells(points: FloatArray, cells: IntArray) -> IntArray:
    """Delaunay connectivity of the vertices wherever the boundary allows it.

    References
    ----------
    CMAME 200 (2011) 967-984, Section 3.2; ``delaunay(p)`` of Sections 5.2 and 5.4.
    """
    regions = np.zeros(len(cells), dtype=np.int32)
    exchanged, _, _ = delaunay_exchange(points, cells, regions)
    return exchanged
