"""Meshes some of whose cells are inverted or flat, though their cells fit together."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.components import components
from odt_plugins.mesh.facets import directed_facets, row_keys
from odt_plugins.mesh.numbers import vertex_mask
from odt_plugins.mesh.simplex import (
    SimplexMesh,
    cell_signs,
    compact_labels,
    determinant,
    freeze,
    mesh_arrays,
    refuse_overlaps,
    reverse,
)


def tangled_mesh(
    points: ArrayLike,
    cells: ArrayLike,
    *,
    regions: ArrayLike | None = None,
    fixed: ArrayLike | None = None,
    selection: ArrayLike | None = None,
) -> tuple[SimplexMesh, int]:
    """Bring a mesh into the form of the engine that :func:`simplex_mesh` found inverted or flat.

    Parameters as for :func:`odt_plugins.mesh.simplex.simplex_mesh`, which checked all but the
    orientation.

    Returns
    -------
    mesh : SimplexMesh    cells that agree about their orientation, every connected piece of
                          positive volume; some cells have none
    orientation : int     -1 when every cell came the other way round, else 1

    Raises
    ------
    InvalidMeshError      cells are there twice, three have a common facet, or they cannot agree
    """
    p, t = mesh_arrays(points, cells)
    odd = odd_cells(p, t)
    sign, _ = cell_signs(p, t)
    turned = sign < 0 if odd is None else odd
    orientation = -1 if turned.all() else 1
    mesh = SimplexMesh(
        points=p,
        cells=reverse(t, turned),
        regions=compact_labels(regions, len(t)),
        fixed=vertex_mask(fixed, len(p), "fixed", "vertices"),
        turned=int(turned.sum()) if orientation == 1 else 0,
    )
    if odd is None:
        refuse_overlaps(mesh, sign)
    if selection is not None:
        mesh = freeze(mesh, ~vertex_mask(selection, len(t), "selection", "cells"))
    return mesh, orientation


def odd_cells(points: FloatArray, cells: IntArray) -> BoolArray | None:
    """Mark the cells to be turned for all to agree, and every piece to have positive volume.

    Returns
    -------
    (m,) bool, or None    when cells are there twice, a facet has more than two, or none agree

    Notes
    -----
    Every cell is two nodes of a graph, one for each orientation. Across a common facet those are
    linked that agree; a cell both of whose nodes are connected agrees with nothing.
    """
    n, m = len(points), len(cells)
    key, side = directed_facets(cells, n)
    rows = row_keys(np.sort(cells, axis=1), n)
    order = np.argsort(key, axis=None, kind="stable")
    ordered = key.ravel()[order]
    first = np.flatnonzero(ordered[1:] == ordered[:-1])
    if (first[1:] == first[:-1] + 1).any() or len(np.unique(rows)) < m:
        return None
    a, b = order[first], order[first + 1]
    other = (side.ravel()[a] == side.ravel()[b]).astype(np.int64)
    a, b = a // cells.shape[1], b // cells.shape[1]
    label = components(np.concatenate([2 * a, 2 * a + 1]),
                       np.concatenate([2 * b + other, 2 * b + 1 - other]), 2 * m)
    as_it_is, reversed_ = label[::2], label[1::2]
    if (as_it_is == reversed_).any():
        return None
    odd = as_it_is > reversed_
    corner = points[cells]
    det = determinant(np.moveaxis(corner[:, 1:] - corner[:, :1], 0, -1))
    piece = np.minimum(as_it_is, reversed_)
    volume = np.bincount(piece, np.where(odd, -det, det))
    return np.asarray(odd ^ (volume[piece] < 0.0))

