"""Edges that are never cut, and the sizes near them."""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.remesh.body import FREELY, STAYS, STIFF
from odt_plugins.engine.remesh.lay_out import surface_of
from odt_plugins.engine.remesh.sizes import Sizes, local_sizes, unique_edges
from odt_plugins.mesh.arrays import BoolArray, ByteArray, IntArray
from odt_plugins.mesh.simplex import SimplexMesh

ENOUGH = 1.01
"""Multiple of its size that some vertex must have for sizes to be others."""


def holds(mesh: SimplexMesh) -> ByteArray:
    """What each of the vertices (n,) does: FREELY, STAYS or STIFF."""
    hold = np.where(mesh.fixed | mesh.anchored, STAYS, FREELY).astype(np.uint8)
    hold[mesh.cells[mesh.frozen]] = STIFF
    hold[mesh.stays] = STIFF
    return hold


def whole_edges(mesh: SimplexMesh, *, slides: bool) -> IntArray:
    """Edges (e, 2) between stiff vertices, and of a surface that does not slide."""
    edges = unique_edges(mesh.cells)
    edges = edges[(holds(mesh) == STIFF)[edges].all(axis=1)]
    if slides:
        return edges
    surface = surface_of(mesh.cells, mesh.regions, mesh.faces[1])[0]
    return np.unique(np.concatenate([edges, unique_edges(surface)]), axis=0)


def beside_whole(mesh: SimplexMesh, sizes: Sizes, near: BoolArray, *, slides: bool) -> Sizes | None:
    """Sizes no shorter than the input's at edges that are never cut; None where they are the same.

    Parameters
    ----------
    mesh : SimplexMesh
    sizes : Sizes
    near : (m,) bool      cells at whose vertices the edges count
    slides : bool         whether edges of the surface are cut
    """
    there, whole = np.zeros((2, len(mesh.points)), dtype=np.bool_)
    there[mesh.cells[near]] = True
    whole[whole_edges(mesh, slides=slides)] = True
    least = np.where(there & whole, local_sizes(mesh), 0.0)
    found = sizes.above(mesh, least)
    return found if (found.values > ENOUGH * sizes.values).any() else None
