"""Bodies, which are parted into regions where facets inside of them stay."""

from __future__ import annotations

from odt_plugins.mesh.simplex import SimplexMesh, with_same_cells


def of_bodies(mesh: SimplexMesh) -> SimplexMesh:
    """The mesh whose regions are its bodies."""
    if not mesh.body.size:
        return mesh
    return with_same_cells(mesh, regions=mesh.bodies(), body=mesh.body[:0])
