"""Start meshes of the paper's tests and hypothesis strategies for geometry."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import reference as ref
from hypothesis import strategies as st
from scipy.spatial import ConvexHull, Delaunay

SEEDS = st.integers(0, 2**20)
DIMENSIONS = st.sampled_from([2, 3])
SCALES = st.sampled_from([1e-9, 1e-3, 1.0, 1e4, 1e9])


def lattice(d, n):
    """Cube lattice of n^d cubes and its Kuhn simplices, which fit together and are positive."""
    points = np.array(list(product(range(n + 1), repeat=d)), dtype=float) / n
    stride = (n + 1) ** np.arange(d)[::-1]
    corner = np.array(list(product(range(n), repeat=d))) @ stride
    cells = []
    for order in permutations(range(d)):
        steps = np.concatenate([[0], np.cumsum(stride[list(order)])])
        cells.append(corner[:, None] + steps)
    return points, positive(points, np.concatenate(cells).astype(np.int32))


def positive(points, cells):
    """Swap two corners of the cells of negative volume."""
    cells = cells.copy()
    bad = ref.volumes(points, cells) < 0
    cells[bad, :2] = cells[bad, 1::-1]
    return cells


def on_box(points):
    return np.any((points == 0.0) | (points == 1.0), axis=1)


def jittered(d, n, seed, jitter=0.3):
    """Lattice with its interior moved at random by at most jitter of the spacing, unfolded."""
    points, cells = lattice(d, n)
    move = np.random.default_rng(seed).uniform(-1, 1, points.shape) * jitter / n
    move[on_box(points)] = 0.0
    while ref.volumes(points + move, cells).min() < 0.05 / (n**d):
        move *= 0.8
    return points + move, cells


def random_delaunay(d, n, seed):
    """Delaunay mesh of random points in a ball and points on its sphere; slivers in space."""
    rng = np.random.default_rng(seed)
    sphere = rng.normal(size=(n, d))
    sphere /= np.linalg.norm(sphere, axis=1)[:, None]
    inside = rng.normal(size=(2 * n, d))
    inside *= 0.8 * rng.random((2 * n, 1)) ** (1 / d) / np.linalg.norm(inside, axis=1)[:, None]
    points = np.concatenate([sphere, inside])
    cells = Delaunay(points).simplices.astype(np.int32)
    return points, positive(points, cells)


def circular_star(d, seed, height=0.08):
    """One vertex amid neighbours on the unit sphere; the first d of them span a low facet.

    The facet lies at the given height above the centre of the sphere, where the vertex is drawn
    if all centres are circumcenters; the other neighbours are spread below.
    """
    rng = np.random.default_rng(seed)
    radius = np.sqrt(1 - height**2)
    if d == 2:
        angles = np.linspace(np.pi - np.arcsin(height), 2 * np.pi + np.arcsin(height), 6)
        ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
        ring = ring[[0, 5, 1, 2, 3, 4]]
        facets = [(0, 1), (0, 2), (2, 3), (3, 4), (4, 5), (5, 1)]
    else:
        angles = 2 * np.pi * np.arange(3) / 3
        top = np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(3, height)], 1)
        low = rng.normal(size=(14, 3))
        low[:, 2] = -np.abs(low[:, 2]) - 0.1
        ring = np.concatenate([top, low / np.linalg.norm(low, axis=1)[:, None]])
        facets = ConvexHull(ring).simplices
    inside = np.zeros((1, d))
    inside[0, -1] = -0.4
    points = np.concatenate([ring, inside])
    cells = np.array([[*facet, len(ring)] for facet in facets], dtype=np.int32)
    return points, positive(points, cells)


@st.composite
def meshes(draw):
    """Valid meshes of both dimensions: jittered lattices and Delaunay balls."""
    d, seed = draw(DIMENSIONS), draw(SEEDS)
    if draw(st.booleans()):
        return jittered(d, 4 if d == 2 else 3, seed)
    return random_delaunay(d, 20, seed)


@st.composite
def simplices(draw, flattest=1e-5):
    """One positive simplex of about unit size, its last vertex pressed towards the others.

    Flatness is bounded so that the volume keeps some ten digits.
    """
    d, seed = draw(DIMENSIONS), draw(SEEDS)
    rng = np.random.default_rng(seed)
    x = np.concatenate([np.zeros((1, d)), np.eye(d)]) + rng.uniform(-0.2, 0.2, (d + 1, d))
    flatness = 10 ** draw(st.floats(np.log10(flattest), 0))
    weights = rng.dirichlet(np.ones(d))
    x[d] = (1 - flatness) * (weights @ x[:d]) + flatness * x[d]
    if ref.volume(x) < 0:
        x[[0, 1]] = x[[1, 0]]
    return x


def rotation(d, seed):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(d, d)))
    q = q * np.sign(np.diag(r))
    if np.linalg.det(q) < 0:
        q[:, 0] *= -1
    return q
