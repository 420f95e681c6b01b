"""Boxes of cells whose inner vertices are shaken, and the same with middles of edges."""

import contract
import numpy as np

FACES = [[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]]
EDGES = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]


def box(dim, n, *, plane=None, seed=4):
    """Unit box of n^dim cubes; vertices at x = plane stay in it."""
    points, cells, _ = contract.grid(dim, n)
    points = points / points.max()
    inner = ((points > 0) & (points < 1)).all(axis=1)
    if plane is not None:
        inner &= abs(points[:, 0] - plane) > 1e-9
    rng = np.random.default_rng(seed)
    points[inner] += rng.uniform(-0.2, 0.2, (inner.sum(), dim)) / n
    return points, cells


def rim(cells):
    """Faces of one cell only."""
    faces = FACES if cells.shape[1] == 4 else [[0, 1], [1, 2], [2, 0]]
    rows = cells[:, faces].reshape(-1, len(faces[0]))
    _, place, count = np.unique(np.sort(rows, axis=1), axis=0, return_inverse=True,
                                return_counts=True)
    return rows[count[place.ravel()] == 1]


def quadratic(points, cells):
    edges = np.sort(cells[:, EDGES], axis=2).reshape(-1, 2)
    edges, place = np.unique(edges, axis=0, return_inverse=True)
    return (np.concatenate([points, points[edges].mean(axis=1)]),
            np.concatenate([cells, len(points) + place.reshape(-1, 6)], axis=1))
