"""Meshes with all that a format may or may not hold."""

from __future__ import annotations

import meshio
import numpy as np
from contract import grid


def mesh_with_everything(dim):
    """Labels, named groups, sets and arrays of several types, facets beside the cells."""
    points, cells, labels = grid(dim, 4, 1)
    middle = points[:, 0] == 0.5
    facets = np.concatenate([np.delete(cells, k, axis=1) for k in range(dim + 1)])
    facets = np.unique(np.sort(facets[middle[facets].all(axis=1)], axis=1), axis=0)
    space = np.zeros((len(points), 3))
    space[:, :dim] = points
    m, q = len(cells), len(facets)
    rng = np.random.default_rng(0)
    none = np.zeros(0, dtype=np.int64)
    return meshio.Mesh(
        space, [("triangle", cells), ("line", facets)] if dim == 2 else
        [("tetra", cells), ("triangle", facets)],
        point_data={"heat": 2 * points[:, 0], "flow": space + 0.5,
                    "small": rng.random(len(points)).astype(np.float32),
                    "node number": np.arange(len(points), dtype=np.int32) + 5,
                    "flag": (np.arange(len(points)) % 3).astype(np.uint8)},
        cell_data={"gmsh:physical": [(labels > 0) + 1, np.full(q, 3)],
                   "density": [rng.random(m), rng.random(q)],
                   "serial": [np.arange(m) + 100, np.arange(q) + 9000],
                   "stress": [rng.random((m, 3)), rng.random((q, 3))],
                   "byte": [(np.arange(m) % 5).astype(np.int8), np.ones(q, dtype=np.int8)]},
        cell_sets={"half": [np.flatnonzero(labels > 0), none], "wall": [none, np.arange(q)]},
        point_sets={"corner": np.array([0, 1]), "plane": np.flatnonzero(middle)},
        field_data={"steel": np.array([1, dim]), "air": np.array([2, dim]),
                    "skin": np.array([3, dim - 1]), "times": np.array([1.5, 2.5, 3.5])})
