"""Whether a mesh looks stretched on purpose, as boundary layers, plates and adapted meshes do."""

from __future__ import annotations

from odt_plugins.mesh.layers import layer_cells
from odt_plugins.mesh.simplex import SimplexMesh

MOST = 0.5
"""Share of the cells that are stretched alike with their neighbours, above which a mesh looks
stretched on purpose: 0 of isotropic, graded and random ones, up to 0.21 of tangled ones; 0.77 and
more of plates, and of meshes that mmg adapted to layers."""


ADVICE = ("most cells are stretched alike with their neighbours; metric='input' improves them so "
          "that they stay stretched")
"""What a report says of such a mesh."""


def looks_anisotropic(mesh: SimplexMesh, threads: int = 1) -> bool:
    """Whether most cells are stretched alike with their neighbours.

    Parameters
    ----------
    mesh : SimplexMesh    of curved surfaces, whose needles may be alike too, nothing is said
    threads : int         how many share the work
    """
    if mesh.is_surface:
        return False
    found = layer_cells(mesh.points, mesh.cells, mesh.bodies(), threads)
    return bool(found.sum() > MOST * len(mesh.cells))
