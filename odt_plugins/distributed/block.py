"""One block of a mesh: cut out with its rim fixed, optimised by the engine, handed back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.distributed.versions import expect_versions
from odt_plugins.engine.odt.density import NodalDensity
from odt_plugins.engine.run.plan import run
from odt_plugins.engine.run.within import Within
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.numbering import in_old_numbers, old_numbers
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.options import Options

AROUND = 0.1
"""A block that slides sees the surface as far around it, as a part of its longest side."""


@dataclass(frozen=True)
class Block:
    """What a worker needs to know of one block.

    Attributes
    ----------
    mesh : SimplexMesh           in a numbering of its own; vertices of the rim are fixed
    density : (n,) or None       values of a :class:`NodalDensity` at its vertices
    options : Options            those of the whole run; their density counts when there are no
                                 values, else it says whether those are the sizes of the input;
                                 their arrays over vertices or cells are not in use
    power : float                of those values
    versions : dict              of the packages that compute, as they are where the block was cut
    within : Within              how it lies in the whole; a block that is not told figures of that
                                 is held to the promise by itself
    """

    mesh: SimplexMesh
    density: FloatArray | None
    options: Options
    power: float
    versions: dict[str, str]
    within: Within

    @property
    def nbytes(self) -> int:
        """Bytes of its arrays."""
        mesh, ground = self.mesh, self.mesh.ground
        arrays: list[NDArray[Any]] = [mesh.points, mesh.cells, mesh.regions, mesh.fixed,
                                      mesh.stays, mesh.lines, mesh.body, mesh.metric]
        arrays += [a for a in (self.within.cut, self.within.fresh) if a is not None]
        if ground is not None:
            arrays += [ground.points, ground.cells, ground.lines, ground.metric]
        return sum(a.nbytes for a in arrays) + (0 if self.density is None else self.density.nbytes)


@dataclass(frozen=True)
class Improved:
    """What a worker hands back: the same vertices, moved, new ones behind them, and other cells.

    Attributes
    ----------
    points : (n', d) float64     a vertex that was removed is where it was
    cells : (m', d + 1) int32    in the numbering of the block
    regions : (m',) int32
    density : (n',) or None      values at the vertices, where these are now
    metric : (n', k) float64     of the metric there, see :class:`SimplexMesh`
    counts : dict                what the engine counted
    fallback : str or None       why the engine went back to an earlier state
    """

    points: FloatArray
    cells: IntArray
    regions: IntArray
    density: FloatArray | None
    metric: FloatArray
    counts: dict[str, int]
    fallback: str | None

    @property
    def nbytes(self) -> int:
        """Bytes of its arrays."""
        arrays = (self.points, self.cells, self.regions, self.metric)
        return sum(a.nbytes for a in arrays) + (0 if self.density is None else self.density.nbytes)


def cut_out(
    mesh: SimplexMesh, members: NDArray[Any], rim: BoolArray
) -> tuple[SimplexMesh, NDArray[Any]]:
    """Take some cells of a mesh as a mesh of its own.

    Parameters
    ----------
    mesh : SimplexMesh
    members : (k,) int          cells, increasing
    rim : (n,) bool             vertices that belong to other cells as well

    Returns
    -------
    SimplexMesh, and its vertices (v,) int in the numbering of the whole
    """
    cells = mesh.cells[members]
    inside = np.zeros(len(mesh.points), dtype=np.bool_)
    inside[cells] = True
    vertices = np.flatnonzero(inside)
    number = np.empty(len(inside), dtype=np.int32)
    number[vertices] = np.arange(len(vertices), dtype=np.int32)
    block = SimplexMesh(
        points=np.ascontiguousarray(mesh.points[vertices]),
        cells=number[cells],
        regions=np.ascontiguousarray(mesh.regions[members]),
        fixed=mesh.fixed[vertices] | rim[vertices],
        stays=_inner(mesh.stays, number, inside),
        lines=_inner(mesh.lines, number, inside),
        anchored=mesh.anchored[vertices],
        body=mesh.body,
        metric=mesh.metric[vertices] if len(mesh.metric) else mesh.metric,
        ground=mesh.ground and _under(mesh.ground, mesh.points[vertices]),
    )
    return block, vertices


def _under(ground: SimplexMesh, points: FloatArray) -> SimplexMesh:
    """The part of a surface in the bounding box of a block that has slid on it, and some more."""
    low, high = points.min(axis=0), points.max(axis=0)
    more = AROUND * (high - low).max()
    near = ((ground.points >= low - more) & (ground.points <= high + more)).all(axis=1)
    members = np.flatnonzero(near[ground.cells].any(axis=1))
    if not members.size:
        return ground
    return cut_out(ground, members, np.zeros(len(near), dtype=np.bool_))[0]


def _inner(edges: IntArray, number: IntArray, inside: BoolArray) -> IntArray:
    """Edges (k, 2) with both ends in the block, in its numbering."""
    return number[edges[inside[edges].all(axis=1)]]


def improve(block: Block) -> Improved:
    """Optimise a block: a pure function, to be run anywhere.

    Raises
    ------
    InvalidOptionError      the packages here are not those of the process that cut the block
    """
    expect_versions(block.versions)
    mesh, options = block.mesh, block.options
    if block.density is not None:
        density = NodalDensity(block.density, block.power, keeps=options.density == "keep")
        lab = replace(options.smoothing, exponent=None)
        options = replace(options, density=density, smoothing=lab)
    if mesh.is_surface:
        return _improved_surface(block, options)
    outcome = run(mesh, options, within=block.within)
    points, cells, sizes = outcome.points, outcome.cells, outcome.sizes
    if outcome.origin is not None:
        n = len(mesh.points)
        number = old_numbers(outcome.origin, n)
        points, cells = in_old_numbers(mesh.points, points, outcome.origin), number[cells]
        if sizes is not None:
            values = np.ones(len(points))
            values[number] = sizes
            sizes = values
    return Improved(points, cells, outcome.regions, block.density if sizes is None else sizes,
                    outcome.metric, outcome.counts, outcome.fallback)


def _improved_surface(block: Block, options: Options) -> Improved:
    """The result of a curved block; the values of its density are those at the feet."""
    from odt_plugins.engine.surface.driver import run_surface
    from odt_plugins.engine.surface.judge import values_on

    mesh, values = block.mesh, block.density
    outcome = run_surface(mesh, options, without=block.within.without)
    moved = np.flatnonzero((outcome.points != mesh.points).any(axis=1))
    if values is not None and moved.size:
        values = values.copy()
        values[moved] = values_on(
            mesh.points, mesh.cells, np.asarray(block.density), outcome.points[moved])
    return Improved(outcome.points, outcome.cells, outcome.regions, values, outcome.metric,
                    outcome.counts, outcome.fallback)
