"""Connected components of a graph, by scipy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def components(start: NDArray[Any], end: NDArray[Any], n: int) -> NDArray[np.int32]:
    """Number the connected components of n nodes that are linked in pairs.

    Parameters
    ----------
    start, end : (k,) int     nodes of every link
    n : int

    Returns
    -------
    (n,) int32                component of every node
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    # SciPy before 1.13 takes no longer indices.
    ends = (start.astype(np.int32, copy=False), end.astype(np.int32, copy=False))
    graph = coo_array((np.ones(len(start), dtype=np.int8), ends), shape=(n, n))
    label: NDArray[np.int32] = connected_components(graph, directed=False)[1]
    return label
