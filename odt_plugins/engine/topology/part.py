"""A part of a mesh that is worked on alone: the cells away from some vertices, or around them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.topology.complex import Complex, make_complex
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray

RINGS = 2
"""Cells within so many rings of some vertices are around them, unless said otherwise."""


@dataclass(frozen=True)
class Part:
    """Some cells of a mesh as a complex with all its vertices, and the others, which rest.

    Attributes
    ----------
    inside : Complex              vertices of cells that rest are locked
    cells : (k, d + 1) int32      that rest
    regions : (k,) int32
    locked : (n,) bool            vertices that are locked in the whole mesh
    """

    inside: Complex
    cells: IntArray
    regions: IntArray
    locked: BoolArray

    @property
    def points(self) -> FloatArray:
        """Coordinates (n, d), as they are now."""
        return self.inside.points

    def mesh_arrays(self) -> tuple[IntArray, IntArray]:
        """All cells and their labels, as they are now; copies."""
        cells, regions = self.inside.mesh_arrays()
        return np.concatenate([self.cells, cells]), np.concatenate([self.regions, regions])


def inside(mesh: Complex | Part) -> Complex:
    """What is worked on."""
    return mesh.inside if isinstance(mesh, Part) else mesh


def away_from(mesh: Complex | Part, vertices: BoolArray) -> Part | None:
    """Take the cells of a mesh without a sliding boundary that have none of some vertices, if any.

    Parameters
    ----------
    mesh : Complex or Part    its points are shared, all else is copied
    vertices : (n,) bool
    """
    cells, regions = mesh.mesh_arrays()
    return _part(mesh, cells, regions, ~rings(vertices, cells, 1))


def around(mesh: Complex | Part, vertices: BoolArray, count: int = RINGS) -> Part | None:
    """Take the cells within some rings of some vertices, if any, as :func:`away_from` does."""
    cells, regions = mesh.mesh_arrays()
    return _part(mesh, cells, regions, rings(vertices, cells, count))


def rings(vertices: BoolArray, cells: IntArray, count: int) -> BoolArray:
    """Say which cells lie within so many rings of some vertices, (m,) bool."""
    marked = vertices.copy()
    near: BoolArray = np.zeros(len(cells), dtype=np.bool_)
    for turn in range(count):
        _mark_cells(marked, cells, near)
        if turn < count - 1:
            marked[cells[near]] = True
    return near


@kernel
def _mark_cells(marked: BoolArray, cells: IntArray, near: BoolArray) -> None:
    """Cells with a marked vertex."""
    for c in range(cells.shape[0]):
        found = False
        for a in range(cells.shape[1]):
            found |= marked[cells[c, a]]
        near[c] = found


def joined(mesh: Complex | Part) -> Complex:
    """Put the parts together again."""
    if not isinstance(mesh, Part):
        return mesh
    return make_complex(mesh.points, *mesh.mesh_arrays(), mesh.locked, mesh.inside.boundary)


def _part(
    mesh: Complex | Part, cells: IntArray, regions: IntArray, chosen: BoolArray
) -> Part | None:
    if not chosen.any():
        return None
    locked = mesh.locked.copy()
    locked[cells[~chosen]] = True
    some = make_complex(mesh.points, cells[chosen], regions[chosen], locked, inside(mesh).boundary)
    return Part(some, cells[~chosen], regions[~chosen], mesh.locked)
