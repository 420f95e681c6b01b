"""Gmsh on a mesh from elsewhere: tetrahedra on a discrete volume, triangles in the plane."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.compare.baselines.task import Settings, Task, in_space
from odt_plugins.compare.hull import hull_facets
from odt_plugins.compare.start import StartMesh

TRIANGLE, TETRAHEDRON, LINE = 2, 4, 1
"""Gmsh's numbers of element types."""


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Give the start to Gmsh.

    Settings: `sequence` of (method, passes), `threshold` of quality below which cells are worked
    on, `times` that the sequence is run.
    """
    import gmsh

    gmsh.initialize(["-nopopup"], readConfigFiles=False)
    gmsh.option.setNumber("General.Terminal", 0)
    gmsh.option.setNumber("General.NumThreads", settings["threads"])
    if "threshold" in settings:
        gmsh.option.setNumber("Mesh.OptimizeThreshold", settings["threshold"])
    dim = 3 if start.kind == "tets" else 2
    _fill(gmsh.model, start, dim)

    steps = settings.get("times", 1) * list(settings["sequence"])
    kind = TETRAHEDRON if dim == 3 else TRIANGLE

    def call() -> NDArray[Any]:
        replaced = np.empty(0, dtype=np.uint64)
        for method, passes in steps:
            if len(replaced):
                _keep_new(gmsh.model, replaced)
            old = gmsh.model.mesh.getElementsByType(kind)[0]
            gmsh.model.mesh.optimize(method, True, passes)
            replaced = old if method == "Netgen" else old[:0]
        return replaced

    def collect(replaced: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        tags, flat, _ = gmsh.model.mesh.getNodes()
        place = np.zeros(int(tags.max()) + 1, dtype=np.int64)
        place[tags] = np.arange(len(tags))
        cells = place[_cells(gmsh.model, kind, replaced)]
        gmsh.finalize()
        return flat.reshape(-1, 3)[:, :dim], cells

    return Task(call, collect)


def _fill(model: Any, start: StartMesh, dim: int) -> None:
    model.add("start")
    model.addDiscreteEntity(dim - 1, 1)
    model.addDiscreteEntity(dim, 1, [1] if dim == 3 else [])
    points = in_space(start.points)
    facets = hull_facets(start)
    rim = np.unique(facets)
    inside = np.setdiff1d(np.arange(len(points)), rim)
    model.mesh.addNodes(dim - 1, 1, rim + 1, points[rim].ravel())
    model.mesh.addNodes(dim, 1, inside + 1, points[inside].ravel())
    kinds = (TRIANGLE, TETRAHEDRON) if dim == 3 else (LINE, TRIANGLE)
    first = 1
    for kind, rows in zip(kinds, (facets, start.cells), strict=True):
        tags = np.arange(first, first + len(rows))
        model.mesh.addElementsByType(1, kind, tags, (rows.astype(np.uint64) + 1).ravel())
        first += len(rows)
    if dim == 2:
        # Gmsh moves vertices of a surface only where it has a parametrisation of it.
        model.mesh.createTopology()
        model.mesh.createGeometry()


def _cells(model: Any, kind: int, replaced: NDArray[Any]) -> NDArray[Any]:
    """Node tags (m, k) of the cells that are not replaced by others beside them.

    On a discrete volume Netgen adds its own cells to the old ones, unless it has nothing to do.
    """
    tags, nodes = model.mesh.getElementsByType(kind)
    new = ~np.isin(tags, replaced)
    cells: NDArray[Any] = nodes.reshape(len(tags), -1)
    return cells[new] if new.any() else cells


def _keep_new(model: Any, replaced: NDArray[Any]) -> None:
    """Fill the volume anew with the cells that count; removing the others one by one is slow."""
    cells = _cells(model, TETRAHEDRON, replaced)
    tags, flat, _ = model.mesh.getNodes(3, 1)
    used = np.isin(tags, cells)
    model.mesh.clear([(3, 1)])
    model.mesh.addNodes(3, 1, tags[used], flat.reshape(-1, 3)[used].ravel())
    model.mesh.addElementsByType(1, TETRAHEDRON, [], cells.ravel())
