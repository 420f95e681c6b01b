"""From a mesh with inverted or flat cells to a valid one: places, and what places cannot mend."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.compiled.threads import thread_pool, worth
from odt_plugins.engine.run.work import locked_vertices
from odt_plugins.engine.topology.adjacency import cell_neighbors
from odt_plugins.engine.untangle.flips import alternatives, reconnected
from odt_plugins.engine.untangle.harmonic import harmonic
from odt_plugins.engine.untangle.places import bad_cells, untangled_places
from odt_plugins.engine.untangle.vertices import inserted
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray, LongArray
from odt_plugins.mesh.chunks import Pool
from odt_plugins.mesh.simplex import SimplexMesh, with_vertices
from odt_plugins.options import Progress
from odt_plugins.progress import silent

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
    points : (n', d) float64     as the caller's type rounds them; inserted ones last
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


class Wishes(NamedTuple):
    """What is asked of a mesh besides valid cells.

    Attributes
    ----------
    rest : (n, d) float64, optional     places at which all cells have the shapes they should have
    insert : int                        most vertices that may be inserted
    rounded : callable                  points as they will leave; those that stay, bit for bit
    progress : callable                 is told the share of the inverted cells that is done
    flips : bool                        whether cells may be reconnected, and vertices inserted
    """

    rest: FloatArray | None = None
    insert: int = 0
    rounded: Callable[[FloatArray], FloatArray] = np.copy
    progress: Progress = silent
    flips: bool = True


PLAIN = Wishes()
"""No rest, no vertices more, double precision."""


def untangled(mesh: SimplexMesh, threads: int = 1, wishes: Wishes = PLAIN) -> Untangled:
    """Make the cells of a mesh valid, with what must stay where it is.

    Parameters
    ----------
    mesh : SimplexMesh                  of cells that agree about their orientation
    threads : int                       the result does not depend on it
    wishes : Wishes
    """
    locked, _ = locked_vertices(mesh, cell_neighbors(mesh.cells))
    used = np.zeros(len(locked), dtype=np.bool_)
    used[mesh.cells] = True
    movable = used & ~locked
    most = len(movable) + wishes.insert
    flips = 0
    with thread_pool(worth(threads, len(mesh.cells))) as pool:
        points = _placed(mesh, movable, wishes, pool, wishes.rest)
        bad = bad_cells(points, mesh.cells)
        for _ in range(ROUNDS if wishes.flips else 0):
            if not bad.any():
                break
            for new, made in _changes(replace(mesh, points=points), bad, most - len(points)):
                more = np.pad(movable, (0, len(new.points) - len(movable)), constant_values=True)
                moved = _placed(new, more, wishes, pool)
                left = bad_cells(moved, new.cells)
                if left.sum() < bad.sum():
                    mesh, points, movable, bad, flips = new, moved, more, left, flips + made
                    break
            else:
                break
    return Untangled(points, mesh.cells, mesh.regions, bad, flips)


def _changes(mesh: SimplexMesh, bad: BoolArray, most: int) -> Iterator[tuple[SimplexMesh, int]]:
    """What may be mended by new places after it: flips that help, vertices more, other flips.

    Yields
    ------
    mesh, flips    changed, and how often it was flipped
    """
    points = mesh.points
    cells, source, made = reconnected(points, mesh, bad)
    if made:
        yield _changed(mesh, points, cells, source), made
    more = inserted(points, mesh, bad, most) if most > 0 else None
    if more is not None:
        yield _changed(mesh, *more), 0
    if bad.sum() <= TRIALS:
        for cells, source in islice(alternatives(points, mesh, bad), TRIALS):
            yield _changed(mesh, points, cells, source), 1


def _changed(
    mesh: SimplexMesh, points: FloatArray, cells: IntArray, source: LongArray
) -> SimplexMesh:
    """Exchange the cells of a mesh; each new one has the label of its source."""
    return replace(with_vertices(mesh, points), cells=cells, regions=mesh.regions[source],
                   frozen=mesh.frozen[source])


def _placed(
    mesh: SimplexMesh, movable: BoolArray, wishes: Wishes, pool: Pool | None,
    rest: FloatArray | None = None,
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
    first = max(int(bad_cells(points, cells).sum()), 1)

    def tell(left: int) -> None:
        wishes.progress("untangling", 1.0 - left / first)

    tell(first)
    for _ in range(TRIES):
        points = wishes.rounded(
            untangled_places(points, cells, movable, reference, moved, pool, tell))
        if not bad_cells(points, cells).any():
            break
    return points
