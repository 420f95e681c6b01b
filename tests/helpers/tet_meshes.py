"""Tetrahedral start meshes of the tests: random Delaunay balls, grids, labelled and holed ones."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.spatial import Delaunay

from odt_plugins.engine.cells.measures import DIHEDRAL, MEAN_RATIO, QUALITY, STEP


def signed_volumes(points, cells):
    """Signed volumes by the determinant."""
    x = points[cells]
    return np.linalg.det(x[:, 1:] - x[:, :1]) / 6.0


def oriented(points, cells):
    """The same cells, positive, without flat ones, int32."""
    cells = np.array(cells, dtype=np.int32)
    volumes = signed_volumes(points, cells)
    cells[volumes < 0, :2] = cells[volumes < 0, 1::-1]
    return np.ascontiguousarray(cells[np.abs(volumes) > 1e-6 * np.abs(volumes).mean()])


def ball(n, seed):
    """Delaunay tetrahedra of random points in and on the unit ball."""
    points, cells = _ball(n, seed)
    return points.copy(), cells.copy()


@lru_cache(maxsize=100)
def _ball(n, seed):
    rng = np.random.default_rng(seed)
    inside = rng.normal(size=(n, 3))
    inside *= (rng.random(n) ** (1 / 3) / np.linalg.norm(inside, axis=1))[:, None] * 0.93
    shell = rng.normal(size=(n // 2, 3))
    shell /= np.linalg.norm(shell, axis=1)[:, None]
    points = np.vstack([inside, shell])
    mesh = Delaunay(points)
    return points, oriented(points, mesh.simplices)


def shelled(gap, count=180):
    """Two bodies: a ball, and a shell around it across a narrow gap."""
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    whole = Delaunay(np.concatenate([directions, [[0.0, 0.0, 0.0]]]))
    inner, hull = whole.simplices, whole.convex_hull
    n = len(directions)
    points = np.concatenate([directions, [[0.0, 0.0, 0.0]], (1.0 + gap) * directions,
                             1.4 * directions])
    prisms = np.sort(hull, axis=1)
    a, b = prisms + n + 1, prisms + 2 * n + 1
    layers = [np.column_stack([a[:, 0], a[:, 1], a[:, 2], b[:, 2]]),
              np.column_stack([a[:, 0], a[:, 1], b[:, 1], b[:, 2]]),
              np.column_stack([a[:, 0], b[:, 0], b[:, 1], b[:, 2]])]
    return points, oriented(points, np.concatenate([inner, *layers]))


def grid(n, seed, jitter=0.2, hole=False):
    """Jittered (n + 1)^3 lattice cut into six tetrahedra a cube; a hole in the middle if asked."""
    rng = np.random.default_rng(seed)
    axis = np.arange(n + 1)
    lattice = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    inner = ((lattice > 0) & (lattice < n)).all(axis=1)
    number = lambda i, j, k: (i * (n + 1) + j) * (n + 1) + k  # noqa: E731
    cells = []
    for i in range(n):
        for j in range(n):
            for k in range(n):
                if hole and i == j == k == n // 2:
                    continue
                for order in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):
                    corner = [i, j, k]
                    path = [number(*corner)]
                    for step in order:
                        corner[step] += 1
                        path.append(number(*corner))
                    cells.append(path)
    points = lattice.astype(float)
    cells = np.array(cells)
    if hole:
        low, high = n // 2, n // 2 + 1
        inner &= ~((lattice >= low) & (lattice <= high)).all(axis=1)
    points[inner] += jitter * rng.uniform(-1, 1, size=(int(inner.sum()), 3))
    return points, oriented(points, cells)


def facets_of(cells):
    """Dictionary: sorted facet -> cells that have it."""
    found: dict[tuple[int, ...], list[int]] = {}
    for c, cell in enumerate(cells.tolist()):
        for i in range(4):
            found.setdefault(tuple(sorted(cell[:i] + cell[i + 1:])), []).append(c)
    return found


def brute_neighbors(cells):
    """Cell across every facet, -1 outside, by looking for equal rows among all facets."""
    facets = np.sort(cells[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3))
    order = np.lexsort(facets.T)
    same = (facets[order[1:]] == facets[order[:-1]]).all(axis=1)
    assert not (same[1:] & same[:-1]).any(), "a facet of three cells"
    result = np.full(len(facets), -1)
    one, other = order[1:][same], order[:-1][same]
    result[one], result[other] = other // 4, one // 4
    return result.reshape(-1, 4)


def quality(points, cells):
    """3 r/R from the volume, the face areas and the linear system of the circumcenter."""
    x = points[cells]
    volume = signed_volumes(points, cells)
    a, b, c = (x[:, list(corners)] for corners in ((0, 0, 0, 1), (1, 1, 2, 2), (2, 3, 3, 3)))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=2).sum(axis=1)
    edges = x[:, 1:] - x[:, :1]
    center = np.linalg.solve(2.0 * edges, (edges**2).sum(axis=2)[..., None])[..., 0]
    return 3.0 * (3.0 * volume / area) / np.linalg.norm(center, axis=1)


def cost(points, cells, power, shift=0.005):
    """What the finishing stage sums over all cells."""
    return ((1.0 + shift) / (quality(points, cells) + shift)) ** power


def dihedral_angles(points, cells):
    """Six dihedral angles in degrees, from the facet normals."""
    x = points[cells]
    result = []
    for a, b, c, d in ((0, 1, 2, 3), (0, 2, 1, 3), (0, 3, 1, 2), (1, 2, 0, 3), (1, 3, 0, 2),
                       (2, 3, 0, 1)):
        axis = x[:, b] - x[:, a]
        first = np.cross(axis, x[:, c] - x[:, a])
        second = np.cross(axis, x[:, d] - x[:, a])
        result.append(np.degrees(np.arctan2(
            np.linalg.norm(np.cross(first, second), axis=1), (first * second).sum(axis=1))))
    return np.stack(result, axis=1)


def amips(points, cells):
    """AMIPS energy tr(J^T J) / det(J)^(2/3), J from the regular tetrahedron with unit edges."""
    root = np.sqrt(3.0)
    regular = np.array([[1, 0, 0], [0.5, root / 2, 0], [0.5, root / 6, np.sqrt(2 / 3)]]).T
    x = points[cells]
    jacobian = np.swapaxes(x[:, 1:] - x[:, :1], 1, 2) @ np.linalg.inv(regular)
    return (jacobian**2).sum(axis=(1, 2)) / np.linalg.det(jacobian) ** (2 / 3)


def softened_sine(points, cells):
    """Power mean of the six squared sines, 1 for the regular tetrahedron."""
    sines = np.sin(np.radians(dihedral_angles(points, cells)))
    return 9 / 8 * (sines**-8).mean(axis=1) ** -0.25


def energy(points, cells):
    """ODT energy of Lemma 2.7, uniform density."""
    x = points[cells]
    t = sum(((x[:, i] - x[:, j]) ** 2).sum(axis=1) for i in range(4) for j in range(i))
    return float((signed_volumes(points, cells) * t).sum() / 20.0)


def altitudes(points, cells):
    """Four altitudes of every tetrahedron, (m, 4): three volumes over the area of a face."""
    x = points[cells]
    area = np.stack([np.linalg.norm(np.cross(x[:, j] - x[:, i], x[:, k] - x[:, i]), axis=1) / 2
                     for i, j, k in ((1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2))], axis=1)
    return 3.0 * np.abs(signed_volumes(points, cells))[:, None] / area


def step(points, cells):
    """Fourth root of (sum h^-2)^(-1/2), h the altitudes."""
    return (altitudes(points, cells) ** -2.0).sum(axis=1) ** -0.125


TWINS = {
    QUALITY: quality,
    MEAN_RATIO: lambda points, cells: (3.0 / amips(points, cells)) ** 3,
    DIHEDRAL: softened_sine,
    STEP: step,
}


def interior(points, cells):
    mask = np.ones(len(points), dtype=bool)
    for facet, owners in facets_of(cells).items():
        if len(owners) == 1:
            mask[list(facet)] = False
    return mask
