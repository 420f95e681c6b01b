"""One block of a mesh: cut out with its rim fixed, optimised by the engine, handed back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.distributed.versions import expect_versions
from odt_plugins.engine.odt.density import NodalDensity
from odt_plugins.engine.record.figures import Figures
from odt_plugins.engine.run.driver import run
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.options import Options


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
    waiting : (n,) bool          vertices of the rim that wait for a later round
    versions : dict              of the packages that compute, as they are where the block was cut
    whole : Figures or None      those of the whole mesh, when its worst cell and its extreme angles
                                 are the bounds; None holds the block to the promise by itself
    """

    mesh: SimplexMesh
    density: FloatArray | None
    options: Options
    power: float
    waiting: BoolArray
    versions: dict[str, str]
    whole: Figures | None = None

    @property
    def nbytes(self) -> int:
        """Bytes of its arrays."""
        arrays = (self.mesh.points, self.mesh.cells, self.mesh.regions, self.mesh.fixed,
                  self.waiting)
        return sum(a.nbytes for a in arrays) + (0 if self.density is None else self.density.nbytes)


@dataclass(frozen=True)
class Improved:
    """What a worker hands back: the same vertices, moved, and other cells.

    Attributes
    ----------
    points : (n, d) float64
    cells : (m', d + 1) int32    in the numbering of the block
    regions : (m',) int32
    density : (n,) or None       values at the vertices, where these are now
    counts : dict                what the engine counted
    fallback : str or None       why the engine went back to an earlier state
    """

    points: FloatArray
    cells: IntArray
    regions: IntArray
    density: FloatArray | None
    counts: dict[str, int]
    fallback: str | None

    @property
    def nbytes(self) -> int:
        """Bytes of its arrays."""
        arrays = (self.points, self.cells, self.regions)
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
    )
    return block, vertices


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
        options = replace(options, density=density, exponent=None)
    outcome = run(mesh, options, cut=block.waiting, whole=block.whole)
    return Improved(outcome.points, outcome.cells, outcome.regions,
                    block.density if outcome.sizes is None else outcome.sizes, outcome.counts,
                    outcome.fallback)
