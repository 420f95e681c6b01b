"""A part of a mesh that is worked on alone: the cells away from some vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from odt_plugins.engine.complex import Complex, make_complex
from odt_plugins.mesh import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Part:
    """Some cells of a mesh as a complex with all its vertices, and the others, which rest.

    Attributes
    ----------
    inside : Complex              vertices of cells that rest are locked
    cells : (k, d + 1) int32      that rest
    regions : (k,) int32
    """

    inside: Complex
    cells: IntArray
    regions: IntArray

    @property
    def points(self) -> FloatArray:
        """Coordinates (n, d), as they are now."""
        return self.inside.points

    def mesh_arrays(self) -> tuple[IntArray, IntArray]:
        """All cells and their labels, as they are now; copies."""
        cells, regions = self.inside.mesh_arrays()
        return np.concatenate([self.cells, cells]), np.concatenate([self.regions, regions])


def away_from(mesh: Complex, vertices: BoolArray) -> Part | None:
    """Take the cells of a mesh without a sliding boundary that have none of some vertices, if any.

    Parameters
    ----------
    mesh : Complex            its points are shared, all else is copied
    vertices : (n,) bool
    """
    cells, regions = mesh.mesh_arrays()
    rest = vertices[cells].any(axis=1)
    if rest.all():
        return None
    locked = mesh.locked.copy()
    locked[cells[rest]] = True
    inside = make_complex(mesh.points, cells[~rest], regions[~rest], locked, mesh.rim)
    return Part(inside, cells[rest], regions[rest])


def joined(part: Part, locked: BoolArray) -> Complex:
    """Put the parts together again, with these vertices (n,) bool locked."""
    return make_complex(part.points, *part.mesh_arrays(), locked, part.inside.rim)
