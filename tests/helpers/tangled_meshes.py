"""Meshes some of whose cells are inverted, though they can be mended."""

import numpy as np
from contract import grid


def tangled(dim, n, how, seed=0):
    """A grid whose inner vertices are where they should not be: points, cells, movable."""
    points, cells, _ = grid(dim, n)
    cells = cells.astype(np.int32)
    movable = ((points > 0.0) & (points < 1.0)).all(axis=1)
    rng = np.random.default_rng(seed)
    if how == "random":
        points[movable] += rng.normal(size=(movable.sum(), dim)) * 3 / n
    elif how == "one point":
        points[movable] = 0.5
    elif how == "reflected":
        points[movable, 0] = 1.0 - points[movable, 0]
    elif how == "one vertex":
        points[np.flatnonzero(movable)[0]] = 0.9
    elif how == "bent":
        bend = np.where(movable, 0.0, 3.0 * (points[:, 0] - 0.5) ** 2)
        points[:, -1] += bend
    return points, cells, movable


def schoenhardt(turn=0.4):
    """Schoenhardt's prism (1928) with cells around a diagonal outside of it: points, cells.

    Its six vertices alone are the corners of no tetrahedra that fill it; with one vertex inside
    they are, unless it is turned too far.
    """
    angle = 2.0 * np.pi * np.arange(3) / 3.0
    points = np.array([[np.cos(a + t), np.sin(a + t), z]
                       for z, t in ((0.0, 0.0), (1.0, turn)) for a in angle])
    return points, np.array([[0, 3, 4, 5], [0, 1, 2, 5], [0, 1, 5, 4], [0, 2, 3, 5]])
