"""Laplacian smoothing as everybody writes it, plain and smart, in numpy, between what stays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.compare.baselines.task import Settings, Task
from odt_plugins.compare.hull import held_vertices
from odt_plugins.compare.start import StartMesh
from odt_plugins.figures import EDGES, radius_ratio
from odt_plugins.mesh.arrays import FloatArray


def prepare(start: StartMesh, settings: Settings) -> Task:
    """Find neighbours and free vertices. Settings: `iterations`, `smart` (bool).

    The plain kind moves all vertices at once to the mean of their neighbours. The smart kind
    moves a vertex only if the worst cell around it does not get worse, one independent set of
    vertices after the other.
    """
    from scipy import sparse

    n, cells = len(start.points), start.cells
    pairs = np.concatenate([cells[:, list(e)] for e in EDGES[cells.shape[1]]])
    ones = np.ones(len(pairs))
    graph = sparse.coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(n, n)).tocsr()
    graph = abs(graph + graph.T).tocsr()
    graph.data[:] = 1.0
    mean: Any = sparse.diags(1.0 / graph.sum(axis=1).A1) @ graph
    free = ~held_vertices(start)
    sets = _independent_sets(graph, free) if settings["smart"] else [np.flatnonzero(free)]

    def call() -> FloatArray:
        points = start.points.copy()
        for _ in range(settings["iterations"]):
            for movable in sets:
                moved = points.copy()
                moved[movable] = mean[movable] @ points
                if settings["smart"]:
                    _take_back_worse(points, moved, cells, movable)
                points = moved
        return points

    return Task(call, lambda points: (points, cells, start.regions))


def _take_back_worse(
    points: FloatArray, moved: FloatArray, cells: NDArray[np.int32], movable: NDArray[np.intp]
) -> None:
    touched = np.zeros(len(points), dtype=np.bool_)
    touched[movable] = True
    near = cells[touched[cells].any(axis=1)]
    worst = np.full((2, len(points)), np.inf)
    for row, x in zip(worst, (points, moved), strict=True):
        np.minimum.at(row, near.ravel(), np.repeat(radius_ratio(x, near), near.shape[1]))
    back = worst[1] < worst[0]
    moved[back] = points[back]


def _independent_sets(graph: Any, free: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Colour the free vertices greedily, in their order."""
    colour = np.full(len(free), -1)
    start, neighbours = graph.indptr, graph.indices
    for i in np.flatnonzero(free):
        taken = set(colour[neighbours[start[i]:start[i + 1]]].tolist())
        colour[i] = next(c for c in range(len(free)) if c not in taken)
    return [np.flatnonzero(colour == c) for c in range(colour.max() + 1)]
