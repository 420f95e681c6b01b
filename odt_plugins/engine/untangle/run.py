"""From a mesh with inverted or flat cells to a valid one: places, and what places cannot mend."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import chain, islice
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.compiled.threads import thread_pool
from odt_plugins.engine.run.driver import locked_vertices
from odt_plugins.engine.topology.adjacency import cell_neighbors
from odt_plugins.engine.untangle.flips import alternatives, reconnected
from odt_plugins.engine.untangle.harmonic import harmonic
from odt_plugins.engine.untangle.places import bad_cells, untangled_places
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.simplex import SimplexMesh

ROUNDS = 5
"""Most turns of flips and of new places after them."""

TRIALS = 12
"""Changes that are tried, with new places after each, where none helps by itself."""

TRIES = 3
"""How often places are looked for that are valid as the caller's type rounds them."""


class Untangled(NamedTuple):
    """What became of a mesh with inverted or flat cells.

    Attributes
    ----------
    points : (n, d) float64      as the caller's type rounds them
    cells : (m', d + 1) int32
    regions : (m',) int32
    bad : (m',) bool             cells that are still inverted or flat
    flips : int                  how often cells were reconnected
    """

    points: FloatArray
    cells: IntArray
    regions: IntArray
    bad: BoolArray
    flips: int = 0


def untangled(
    mesh: SimplexMesh, threads: int = 1, rest: FloatArray | None = None,
    rounded: Callable[[FloatArray], FloatArray] = np.copy,
) -> Untangled:
    """Make the cells of a mesh valid, with what must stay where it is.

    Parameters
    ----------
    mesh : SimplexMesh                  of cells that agree about their orientation
    threads : int                       the result does not depend on it
    rest : (n, d) float64, optional     places at which all cells have the shapes they should have
    rounded : callable                  points as they will leave; those that stay, bit for bit
    """
    locked, _ = locked_vertices(mesh, cell_neighbors(mesh.cells))
    used = np.zeros(len(locked), dtype=np.bool_)
    used[mesh.cells] = True
    movable = used & ~locked
    flips = 0
    with thread_pool(threads) as pool:
        points = _placed(mesh, movable, rest, rounded, pool)
        bad = bad_cells(points, mesh.cells)
        for _ in range(ROUNDS):
            if not bad.any():
                break
            cells, source, made = reconnected(points, mesh, bad)
            tries = [(cells, source)] if made else []
            single = alternatives(points, mesh, bad) if bad.sum() <= TRIALS else iter(())
            for cells, source in chain(tries, islice(single, TRIALS)):
                new = replace(mesh, points=points, cells=cells, regions=mesh.regions[source],
                              frozen=mesh.frozen[source])
                moved = _placed(new, movable, None, rounded, pool)
                left = bad_cells(moved, cells)
                if left.sum() < bad.sum():
                    break
            else:
                break
            mesh, points, bad, flips = new, moved, left, flips + max(made, 1)
    return Untangled(points, mesh.cells, mesh.regions, bad, flips)


def _placed(
    mesh: SimplexMesh, movable: BoolArray, rest: FloatArray | None,
    rounded: Callable[[FloatArray], FloatArray], pool: ThreadPoolExecutor | None,
) -> FloatArray:
    """Places of the vertices of a mesh, as they leave."""
    points, cells = mesh.points, mesh.cells
    reference = moved = None
    if rest is not None:
        corners = rest[cells]
        reference = np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 2)
        free = np.flatnonzero(movable)
        moved = points.copy()
        moved[free] = rest[free] + harmonic(points - rest, cells, free)
    for _ in range(TRIES):
        points = rounded(untangled_places(points, cells, movable, reference, moved, pool))
        if not bad_cells(points, cells).any():
            break
    return points
