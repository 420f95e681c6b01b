"""Delaunay meshes of seeded random points: a ball, a pebble and a plate with a hole."""

from __future__ import annotations

import numpy as np

from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.simplex import reverse

SEED = 2011
"""Seed of every mesh made on the fly."""


def ball(n: int, seed: int = SEED) -> tuple[FloatArray, IntArray]:
    """Random Delaunay mesh of a ball: jittered lattice inside, spiral on the sphere.

    Parameters
    ----------
    n : int       about so many vertices
    seed : int    of the jitter
    """
    from scipy.spatial import Delaunay

    rng = np.random.default_rng(seed)
    h = (4.0 / 3.0 * np.pi / n) ** (1.0 / 3.0)
    axis = np.arange(-1.0, 1.0 + h, h)
    lattice = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    lattice = lattice + rng.uniform(-0.45 * h, 0.45 * h, lattice.shape)
    inside = lattice[(lattice**2).sum(axis=1) < (1.0 - 0.5 * h) ** 2]
    points = np.concatenate([sphere_points(round(4.0 * np.pi / (0.9 * h * h))), inside])
    return points, Delaunay(points).simplices


def pebble(n: int, seed: int = SEED) -> tuple[FloatArray, IntArray]:
    """Delaunay mesh of random points on a sphere, pressed into a smooth shape with hollows.

    Parameters
    ----------
    n : int       vertices
    seed : int
    """
    from scipy.spatial import ConvexHull

    x = np.random.default_rng(seed).standard_normal((n, 3))
    x /= np.linalg.norm(x, axis=1)[:, None]
    cells = ConvexHull(x).simplices
    a, b, c = (x[cells[:, i]] for i in range(3))
    inward = (np.cross(b - a, c - a) * (a + b + c)).sum(axis=1) < 0
    wave = 0.15 * np.sin(3.0 * x[:, 0] + 1.0) * np.cos(4.0 * x[:, 1]) + 0.1 * np.sin(5.0 * x[:, 2])
    return x * (1.0 + wave)[:, None], reverse(cells, inward)


def sphere_points(n: int) -> FloatArray:
    """Spread n points on the unit sphere along a spiral of golden angle, (n, 3)."""
    i = np.arange(n) + 0.5
    polar = np.arccos(1.0 - 2.0 * i / n)
    turn = np.pi * (1.0 + 5.0**0.5) * i
    return np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)],
                    axis=1)


def plate(n: int, seed: int = SEED) -> tuple[FloatArray, IntArray]:
    """Random Delaunay mesh of a square with a round hole, finer towards the hole.

    Parameters
    ----------
    n : int       about so many vertices
    seed : int
    """
    from scipy.spatial import Delaunay

    rng = np.random.default_rng(seed)
    radius = 0.3
    # Cells of size c * r, so that the number of vertices is the integral of 1 / (c r)^2.
    c = np.sqrt(2.0 * np.pi * np.log(1.0 / radius) * 1.2 / n)
    rings = [radius * (1.0 + c) ** k for k in range(int(np.log(1.42 / radius) / np.log1p(c)) + 1)]
    around = max(round(2.0 * np.pi / c), 8)
    cloud = []
    for k, r in enumerate(rings[1:]):
        angle = 2.0 * np.pi * (np.arange(around) + 0.5 * (k % 2)) / around
        angle = angle + rng.uniform(-0.4, 0.4, around) * 2.0 * np.pi / around
        length = r * (1.0 + c * rng.uniform(-0.4, 0.4, around))
        cloud.append(np.stack([length * np.cos(angle), length * np.sin(angle)], axis=1))
    inner = np.concatenate(cloud)
    distance = np.sqrt((inner**2).sum(axis=1))
    keep = (np.abs(inner).max(axis=1) < 1.0 - 0.5 * c) & (distance > radius * (1.0 + 0.5 * c))
    inner = inner[keep]
    angle = 2.0 * np.pi * np.arange(around) / around
    hole = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    side = np.linspace(-1.0, 1.0, max(round(1.8 / c), 3))[:-1]
    one = np.ones_like(side)
    square = np.concatenate([np.stack(s, axis=1) for s in
                             ((side, -one), (one, side), (-side, one), (-one, -side))])
    points = np.concatenate([hole, square, inner])
    cells = Delaunay(points).simplices
    return points, cells[~(cells < around).all(axis=1)]
