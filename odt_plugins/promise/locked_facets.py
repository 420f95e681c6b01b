"""The facets that must stay: those on the boundary and those between two region labels."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.mesh.facets import UnevenFacets, row_keys, sorted_columns, uneven_facets

LOCAL_FACETS = {3: ((1, 2), (2, 0), (0, 1)), 4: ((1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1))}
"""Facets of a positive simplex by local vertex, outward, the one opposite vertex 0 first."""


class LockedFacets(NamedTuple):
    """Facets that must stay: on the boundary or between two region labels, once per side.

    Attributes
    ----------
    facets : (k, d) vertex indices, outward from its cell
    labels : (k,) region label of that cell
    cells : (k,) index of that cell
    boundary : (k,) bool, no cell on the other side
    """

    facets: NDArray[Any]
    labels: NDArray[Any]
    cells: NDArray[Any]
    boundary: NDArray[np.bool_]


def locked_facets(cells: NDArray[Any], regions: NDArray[Any], n_points: int) -> LockedFacets:
    """Collect the boundary and interface facets of a mesh, sorted; any broken mesh will do.

    Returns
    -------
    LockedFacets             a facet between two labels appears twice, once from each side
    """
    return facet_census(cells, regions, n_points, uneven_facets(cells, n_points))[0]


def facet_census(
    cells: NDArray[Any], regions: NDArray[Any], n_points: int, uneven: UnevenFacets
) -> tuple[LockedFacets, NDArray[Any]]:
    """Locked facets, and the facets that two cells claim from the same side (overlaps).

    All of them have their vertices among those of ``uneven.open`` and of cells of different
    labels; only facets of such vertices are looked at. The key of a facet is its sorted
    vertices and, as last bit, the parity of the sorting, so that one sort brings both sides of
    every facet together.
    """
    k = cells.shape[1]
    near = _between_labels(cells, regions, n_points)
    near[uneven.open] = True
    touched = np.flatnonzero(sum(near[corner].view(np.int8) for corner in cells.T) >= k - 1)
    table = cells[touched[:, None, None], np.array(LOCAL_FACETS[k])]
    cell, local = np.nonzero(near[table].all(axis=2))
    facets, cell = table[cell, local], touched[cell]
    columns, odd = sorted_columns(facets)
    key = 2 * row_keys(np.stack(columns, axis=1), n_points) + odd
    order = np.argsort(key, kind="stable")
    facets, cell, key = facets[order], cell[order], key[order]
    side = key >> 1
    first = np.flatnonzero(side[1:] == side[:-1])
    twice = first[key[first] == key[first + 1]]
    label = regions[cell]
    alone = np.ones(len(key), bool)
    alone[first] = alone[first + 1] = False
    locked = alone.copy()
    split = first[label[first] != label[first + 1]]
    locked[split] = locked[split + 1] = True
    return LockedFacets(facets[locked], label[locked], cell[locked], alone[locked]), facets[twice]


def _between_labels(cells: NDArray[Any], regions: NDArray[Any], n_points: int) -> NDArray[np.bool_]:
    """Mark the vertices (n,) of cells of different labels."""
    mixed = np.zeros(n_points, bool)
    if (regions == regions[:1]).all():
        return mixed
    one = np.zeros(n_points, regions.dtype)
    for corner in cells.T:
        one[corner] = regions
    for corner in cells.T:
        mixed[corner[one[corner] != regions]] = True
    return mixed
