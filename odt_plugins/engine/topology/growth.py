"""Values at vertices that grow no faster than at a rate along edges."""

from __future__ import annotations

from typing import Any

import numpy as np

from odt_plugins.mesh.arrays import FloatArray, IntArray


def grown_along(points: FloatArray, edges: IntArray, values: FloatArray, rate: float) -> FloatArray:
    """The largest values (n,) below some, above 0, that grow by at most ``rate`` times the way.

    The shortest ways along edges (e, 2) from a node that is as far from every vertex as its value.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    n = len(values)
    step = points[edges[:, 1]] - points[edges[:, 0]]
    # a way of length 0 would be no way
    far = np.maximum(rate * np.sqrt((step * step).sum(axis=1)), 1e-12 * values.min())
    own = np.arange(n, dtype=np.int32)
    start = np.concatenate([edges[:, 0], edges[:, 1], np.full_like(own, n)])
    end = np.concatenate([edges[:, 1], edges[:, 0], own])
    graph: Any = coo_array((np.concatenate([far, far, values]), (start, end)), shape=(n + 1, n + 1))
    search: Any = dijkstra
    found: FloatArray = search(graph.tocsr(), indices=n)[:n]
    return np.minimum(found, values)
