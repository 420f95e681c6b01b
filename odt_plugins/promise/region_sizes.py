"""The promise of the size of every region where a boundary moves or has other vertices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import change
from odt_plugins.figures import CellFigures, volumes, volumes_of
from odt_plugins.mesh.facets import uneven_facets
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.promise.volume import VOLUME


def broken_sizes(
    before: SimplexMesh, points: NDArray[np.float64], cells: NDArray[np.int32],
    regions: NDArray[np.int32], figures: CellFigures | None = None,
) -> list[str]:
    """Say of which regions the area or volume changed by more than VOLUME of it.

    ``figures`` are those of the mesh without a metric, when they are at hand.
    """
    size = "area" if before.dim == 2 else "volume"
    return [f"the {size} of region {label} went {change(first, last)}"
            for label, first, last in other_sizes(before, points, cells, regions, figures)]


def other_sizes(
    before: SimplexMesh, points: NDArray[np.float64], cells: NDArray[np.int32],
    regions: NDArray[np.int32], figures: CellFigures | None = None,
) -> list[tuple[int, float, float]]:
    """Regions whose area or volume changed by more than VOLUME of it, with both.

    Where the boundary stays on the geometry that it was made of, what is between it and the
    geometry may be added.
    """
    was, now = before.bodies(), before.bodies(regions)
    labels, own = np.unique(was, return_inverse=True)
    place = np.minimum(np.searchsorted(labels, now), len(labels) - 1)
    there = labels[place] == now
    first = np.bincount(own.ravel(), volumes_of(before), len(labels))
    size = volumes(points, cells) if figures is None else figures.volume
    last = np.bincount(place[there], size[there], len(labels))
    others = []
    for k in np.flatnonzero(~(np.abs(last - first) <= VOLUME * first)).tolist():
        most = VOLUME * first[k]
        if before.sag > 0.0:
            most += before.sag * _outside(before.points, before.cells[was == labels[k]])
        if not abs(last[k] - first[k]) <= most:
            others.append((int(labels[k]), float(first[k]), float(last[k])))
    return others


def _outside(points: NDArray[np.float64], cells: NDArray[np.int32]) -> float:
    """Length or area of the boundary of some cells."""
    x = points[uneven_facets(cells, len(points)).open]
    if cells.shape[1] == 3:
        return float(np.linalg.norm(x[:, 1] - x[:, 0], axis=1).sum())
    return 0.5 * float(np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum())
