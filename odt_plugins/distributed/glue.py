"""One round of blocks: cut, have them optimised, put the results in the place of what was cut."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.distributed.block import Block, Improved, cut_out, improve
from odt_plugins.distributed.partition import (
    RINGS,
    WORST_RINGS,
    bricks,
    clusters,
    groups,
    grown,
    seams,
)
from odt_plugins.distributed.versions import versions_here
from odt_plugins.engine.run.within import WHOLE, Within
from odt_plugins.engine.topology.part import rings
from odt_plugins.errors import InvalidMeshError
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.simplex import SimplexMesh, diagonal
from odt_plugins.options import Options

Map = Callable[[Callable[[Block], Improved], Iterable[Block]], Iterator[Improved]]
"""Applies a pure function to blocks anywhere and gives the results in the order of the blocks."""

LARGEST = 0.9
"""No envelope is a larger part of the diagonal of a block."""


@dataclass(frozen=True)
class Whole:
    """The whole mesh between two rounds.

    Attributes
    ----------
    mesh : SimplexMesh
    density : (n,) or None      values of the density at the vertices, carried with them
    waiting : (n,) bool         vertices that have not been inside a block in any round yet
    patch : (n,) int32          equal for those of them between the same two blocks of the last
                                round, -1 for all others

    A vertex that was removed is one that no cell has; new ones stand at the end.
    """

    mesh: SimplexMesh
    density: FloatArray | None
    waiting: BoolArray
    patch: IntArray


class Traffic(NamedTuple):
    """What a round did: its blocks, their cells, bytes sent and received, engine counts."""

    blocks: int
    cells: int
    sent: int
    received: int
    counts: dict[str, int]
    fallbacks: list[str]


class Task(NamedTuple):
    """What the blocks of a round are told besides their cells.

    Attributes
    ----------
    options : Options
    power : float                 of the values of the density
    within : Within               but for cut and fresh; part where phases are left out
    length : float                of the envelope in this round
    room : int                    vertices that may be added in this round
    """

    options: Options
    power: float = 1.0
    within: Within = WHOLE
    length: float = 0.0
    room: int = 0

    def of(self, block: SimplexMesh, part: float) -> Options:
        """Options of a block that holds such a part of the cells of the round."""
        options = self.options
        if options.insert:
            insert = self.room * part / len(block.points)
            options = replace(options, insert=insert if insert > 0.0 else False)
        if self.length:
            envelope = min(self.length / diagonal(block.points), LARGEST)
            options = replace(options, envelope=envelope)
        return options


def labels(
    whole: Whole, count: int, index: int, rounds: int, worst: BoolArray | None = None
) -> IntArray:
    """Block of every cell in one round, -1 for cells that rest.

    First round: all cells that may change, in bricks. Later rounds: one block for each patch of the
    seam between two former blocks, of the cells around vertices that have been on rims only. Last
    round: connected clusters around all such vertices, so that nothing is cut again, and around
    the vertices ``worst`` (n,).
    """
    mesh = whole.mesh
    label = np.full(len(mesh.cells), -1, dtype=np.int32)
    active = np.flatnonzero(~mesh.frozen)
    cells = mesh.cells[active]
    if index == 0:
        label[active] = bricks(mesh.points, cells, min(count, len(active)))
    elif index < rounds - 1:
        label[active] = grown(whole.patch, cells, RINGS)
    else:
        near = near_cuts(whole)[active]
        if worst is not None:
            near |= rings(worst, cells, WORST_RINGS)
        zone = active[near]
        if len(zone):
            parts = -(-len(zone) * count // len(active))
            label[zone] = clusters(mesh.cells[zone], parts)
    return label


def near_cuts(whole: Whole) -> BoolArray:
    """Say which cells may change and lie around vertices that have been on rims only, (m,)."""
    mesh = whole.mesh
    near = ~mesh.frozen
    near[near] = rings(whole.waiting, mesh.cells[near], RINGS)
    return near


def one_round(whole: Whole, label: IntArray, task: Task, apply: Map) -> tuple[Whole, Traffic]:
    """Cut along the labels, improve every block, glue.

    Raises
    ------
    InvalidMeshError      a result does not fit the block that was cut
    """
    mesh = whole.mesh
    rim, patch, held = _rims(mesh, label)
    members = groups(label)
    waiting = whole.waiting & rim
    inside = int((label >= 0).sum())
    part = inside / int((~mesh.frozen).sum())
    versions = versions_here()
    sent: list[int] = []
    vertices_of: list[NDArray[np.intp]] = []

    def cut() -> Iterator[Block]:
        for cells in members:
            block, vertices = cut_out(mesh, cells, held)
            density = None if whole.density is None else whole.density[vertices]
            vertices_of.append(vertices)
            options = task.of(block, len(cells) / inside)
            fresh = whole.waiting[vertices]
            within = task.within._replace(cut=waiting[vertices])
            if not fresh.all():
                within = within._replace(fresh=fresh)
            if not within.without:
                within = within._replace(part=part)
            work = Block(block, density, options, task.power, versions, within)
            sent.append(work.nbytes)
            yield work

    points, metric = [mesh.points.copy()], mesh.metric.copy()
    density = None if whole.density is None else [whole.density.copy()]
    total = len(mesh.points)
    rest = label < 0
    new_cells, new_regions = [mesh.cells[rest]], [mesh.regions[rest]]
    received, counts, fallbacks = 0, dict[str, int](), list[str]()
    for k, result in enumerate(apply(improve, cut())):
        vertices = vertices_of[k]
        n = len(vertices)
        _expect_fit(result, mesh.points[vertices], held[vertices], k)
        points[0][vertices] = result.points[:n]
        points.append(result.points[n:])
        if len(metric):
            metric[vertices] = result.metric
        if density is not None and result.density is not None:
            density[0][vertices] = result.density[:n]
            density.append(result.density[n:])
        number = np.concatenate([vertices, np.arange(total, total + len(result.points) - n)])
        total += len(result.points) - n
        new_cells.append(number[result.cells].astype(np.int32, copy=False))
        new_regions.append(result.regions)
        received += result.nbytes
        for name, value in result.counts.items():
            counts[name] = counts.get(name, 0) + value
        fallbacks += [result.fallback] if result.fallback else []
    frozen = np.zeros(sum(map(len, new_cells)), dtype=np.bool_)
    frozen[: int(rest.sum())] = mesh.frozen[rest]
    added = np.zeros(total - len(mesh.points), dtype=np.bool_)
    waiting = np.concatenate([waiting, added])
    glued = replace(mesh, points=np.concatenate(points), cells=np.concatenate(new_cells),
                    regions=np.concatenate(new_regions), frozen=frozen,
                    fixed=np.concatenate([mesh.fixed, added]),
                    anchored=np.concatenate([mesh.anchored, added]), metric=metric)
    patch = np.concatenate([patch, np.full(len(added), -1, dtype=np.int32)])
    traffic = Traffic(len(members), inside, sum(sent), received, counts, fallbacks)
    values = None if density is None else np.concatenate(density)
    return Whole(glued, values, waiting, np.where(waiting, patch, np.int32(-1))), traffic


def _rims(mesh: SimplexMesh, label: IntArray) -> tuple[BoolArray, IntArray, BoolArray]:
    """The :func:`seams` between cells that may change, and vertices of cells of several labels."""
    n = len(mesh.points)
    touched = np.zeros(n, dtype=np.bool_)
    touched[mesh.cells[label >= 0]] = True
    near = np.flatnonzero(rings(touched, mesh.cells, 1))
    cells, label, frozen = mesh.cells[near], label[near], mesh.frozen[near]
    held, patch = seams(cells, label, n)
    if not frozen.any():
        return held, patch, held
    rim, patch = seams(cells[~frozen], label[~frozen], n)
    return rim, patch, held


def _expect_fit(result: Improved, before: FloatArray, held: BoolArray, index: int) -> None:
    """Refuse a result without some of the vertices, or with a rim that moved."""
    n, now = len(before), len(result.points)
    good = now >= n and len(result.cells) == len(result.regions)
    good = good and 0 <= result.cells.min() and result.cells.max() < now
    if not good or not np.array_equal(result.points[:n][held], before[held]):
        msg = (f"the result of block {index} does not fit the mesh it was cut from; expected "
               f"{n} vertices with an unchanged rim, try the run again")
        raise InvalidMeshError(msg)
