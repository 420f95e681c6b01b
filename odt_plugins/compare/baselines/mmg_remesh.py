"""mmg3d, mmg2d and mmgs through mmgpy: a mesh made anew with edges of one length."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from odt_plugins.compare.baselines.task import Settings, Task, wanted_size
from odt_plugins.compare.hull import labels_of
from odt_plugins.compare.start import StartMesh
from odt_plugins.mesh.simplex import diagonal


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Give the start to the program for its kind.

    Settings: `envelope`, its `hausd` as a part of the diagonal of the bounding box; `size`.
    """
    import mmgpy

    solid = start.kind == "tets"
    kind, given = {"tets": (mmgpy.MmgMesh3D, mmgpy.Mmg3DOptions),
                   "planar": (mmgpy.MmgMesh2D, mmgpy.Mmg2DOptions),
                   "surface": (mmgpy.MmgMeshS, mmgpy.MmgSOptions)}[start.kind]
    options = given(hausd=settings["envelope"] * diagonal(start.points),
                    hsiz=wanted_size(start, settings), verbose=-1).to_dict()
    mesh: Any = kind(start.points, start.cells)
    (mesh.set_tetrahedra if solid else mesh.set_triangles)(start.cells, labels_of(start))

    def call() -> None:
        mesh.remesh(**options)

    def collect(_: Any) -> tuple[NDArray[Any], ...]:
        cells = mesh.get_tetrahedra_with_refs() if solid else mesh.get_triangles_with_refs()
        return mesh.get_vertices(), *cells

    return Task(call, collect)
