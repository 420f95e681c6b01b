"""Gmsh on a mesh from elsewhere: tetrahedra on discrete volumes, triangles in the plane."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.compare.baselines.task import Settings, Task, in_space
from odt_plugins.compare.hull import labels_of, patches
from odt_plugins.compare.start import StartMesh

TRIANGLE, TETRAHEDRON, LINE = 2, 4, 1
"""Gmsh's numbers of element types."""


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Give the start to Gmsh, every region as an entity of its own.

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

    def call() -> dict[int, int]:
        replaced: dict[int, int] = {}
        for method, passes in steps:
            if replaced:
                _keep_new(gmsh.model, replaced)
            replaced = _counts(gmsh.model) if method == "Netgen" else {}
            gmsh.model.mesh.optimize(method, True, passes)
        return replaced

    def collect(replaced: dict[int, int]) -> tuple[NDArray[Any], ...]:
        tags, flat, _ = gmsh.model.mesh.getNodes()
        place = np.zeros(int(tags.max()) + 1, dtype=np.int64)
        place[tags] = np.arange(len(tags))
        entities = [tag for _, tag in gmsh.model.getEntities(dim)]
        parts = [place[_cells(gmsh.model, kind, tag, replaced.get(tag, 0))] for tag in entities]
        labels = np.repeat(np.array(entities) - 1, [len(part) for part in parts])
        gmsh.finalize()
        return flat.reshape(-1, 3)[:, :dim], np.concatenate(parts), labels

    return Task(call, collect)


def _fill(model: Any, start: StartMesh, dim: int) -> None:
    model.add("start")
    points, labels = in_space(start.points), labels_of(start)
    facets, inside, outside = patches(start)
    sides, patch = np.unique(np.column_stack([inside, outside]), axis=0, return_inverse=True)
    patch = patch.ravel()
    kinds = (LINE, TRIANGLE, TETRAHEDRON)[dim - 2:dim]
    free, first = np.ones(len(points), dtype=np.bool_), 1

    def fill(entity: tuple[int, int], kind: int, rows: NDArray[Any]) -> None:
        nonlocal first
        new = np.unique(rows)
        new = new[free[new]]
        free[new] = False
        model.mesh.addNodes(*entity, new + 1, points[new].ravel())
        tags = np.arange(first, first + len(rows))
        model.mesh.addElementsByType(entity[1], kind, tags, (rows.astype(np.uint64) + 1).ravel())
        first += len(rows)

    for k in range(len(sides)):
        model.addDiscreteEntity(dim - 1, k + 1)
        fill((dim - 1, k + 1), kinds[0], facets[patch == k])
    for label in np.unique(labels).tolist():
        around = 1 + np.flatnonzero((sides == label).any(axis=1))
        model.addDiscreteEntity(dim, label + 1, around.tolist() if dim == 3 else [])
        fill((dim, label + 1), kinds[1], start.cells[labels == label])
    if dim == 2:
        # Gmsh moves vertices of a surface only where it has a parametrisation of it.
        model.mesh.createTopology()
        model.mesh.createGeometry()


def _counts(model: Any) -> dict[int, int]:
    """Number of the tetrahedra of every volume."""
    return {entity: len(model.mesh.getElementsByType(TETRAHEDRON, entity)[0])
            for _, entity in model.getEntities(3)}


def _cells(model: Any, kind: int, entity: int, replaced: int) -> NDArray[Any]:
    """Node tags (m, k) of the cells of an entity that are not replaced by others after them.

    On a discrete volume Netgen adds its own cells to the `replaced` old ones, unless it has nothing
    to do; tags are numbered anew where there are several volumes.
    """
    tags, nodes = model.mesh.getElementsByType(kind, entity)
    cells: NDArray[Any] = nodes.reshape(len(tags), -1)
    return cells[replaced:] if len(cells) > replaced else cells


def _keep_new(model: Any, replaced: dict[int, int]) -> None:
    """Fill the volumes anew with the cells that count; removing the others one by one is slow."""
    for _, entity in model.getEntities(3):
        cells = _cells(model, TETRAHEDRON, entity, replaced[entity])
        tags, flat, _ = model.mesh.getNodes(3, entity)
        used = np.isin(tags, cells)
        model.mesh.clear([(3, entity)])
        model.mesh.addNodes(3, entity, tags[used], flat.reshape(-1, 3)[used].ravel())
        model.mesh.addElementsByType(entity, TETRAHEDRON, [], cells.ravel())
