"""Triangulated surfaces with known shape, and slow distances between surfaces."""

from __future__ import annotations

from itertools import chain

import numpy as np
from scipy.spatial import cKDTree


def sphere(level=3, noise=0.0, seed=7):
    """Icosphere of radius 1; vertices pushed along the sphere by noise times the edge length."""
    g = (1 + 5**0.5) / 2
    p = np.array([[-1, g, 0], [1, g, 0], [-1, -g, 0], [1, -g, 0], [0, -1, g], [0, 1, g],
                  [0, -1, -g], [0, 1, -g], [g, 0, -1], [g, 0, 1], [-g, 0, -1], [-g, 0, 1]], float)
    t = np.array([[0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9],
                  [5, 11, 4], [11, 10, 2], [10, 7, 6], [7, 1, 8], [3, 9, 4], [3, 4, 2],
                  [3, 2, 6], [3, 6, 8], [3, 8, 9], [4, 9, 5], [2, 4, 11], [6, 2, 10],
                  [8, 6, 7], [9, 8, 1]])
    for _ in range(level):
        p, t = refined(p, t)
        p /= np.linalg.norm(p, axis=1)[:, None]
    rng = np.random.default_rng(seed)
    p = p / np.linalg.norm(p, axis=1)[:, None]
    p = p + noise * 1.1 * 0.5**level * rng.standard_normal(p.shape)
    return p / np.linalg.norm(p, axis=1)[:, None], t


def refined(p, t):
    """Every triangle in four."""
    middle = {}
    points = list(p)

    def half(a, b):
        key = (min(a, b), max(a, b))
        if key not in middle:
            middle[key] = len(points)
            points.append(0.5 * (points[a] + points[b]))
        return middle[key]

    cells = []
    for a, b, c in t.tolist():
        ab, bc, ca = half(a, b), half(b, c), half(c, a)
        cells += [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
    return np.array(points), np.array(cells)


def grid(u, v, wrap_u=False, wrap_v=False):
    """Triangles of a grid of u x v vertices, number i * v + j."""
    cells = []
    for i in range(u if wrap_u else u - 1):
        for j in range(v if wrap_v else v - 1):
            a, b = i * v + j, (i + 1) % u * v + j
            c, d = (i + 1) % u * v + (j + 1) % v, i * v + (j + 1) % v
            cells += [(a, b, c), (a, c, d)] if (i + j) % 2 else [(a, b, d), (b, c, d)]
    return np.array(cells)


def torus(u=40, v=16, noise=0.0, seed=11):
    """Radii 1 and 0.4; noise moves the parameters by that part of a step."""
    rng = np.random.default_rng(seed)
    i, j = (x.ravel().astype(float) for x in np.meshgrid(np.arange(u), np.arange(v),
                                                         indexing="ij"))
    a = 2 * np.pi * (i + noise * rng.uniform(-0.5, 0.5, i.size)) / u
    b = 2 * np.pi * (j + noise * rng.uniform(-0.5, 0.5, i.size)) / v
    r = 1 + 0.4 * np.cos(b)
    return np.stack([r * np.cos(a), r * np.sin(a), 0.4 * np.sin(b)], axis=1), grid(u, v, True, True)


def bowl(k=25, noise=0.0, seed=3, rim_noise=0.0):
    """An open curved square z = x^2 - y^2 / 2; its rim is straight seen from above."""
    rng = np.random.default_rng(seed)
    i, j = (x.ravel() for x in np.meshgrid(np.arange(k), np.arange(k), indexing="ij"))
    inner = (i > 0) & (i < k - 1) & (j > 0) & (j < k - 1)
    x = 2 * i / (k - 1) - 1.0
    y = 2 * j / (k - 1) - 1.0
    step = noise * 2 / (k - 1)
    x[inner] += step * rng.uniform(-0.5, 0.5, int(inner.sum()))
    y[inner] += step * rng.uniform(-0.5, 0.5, int(inner.sum()))
    return np.stack([x, y, 0.3 * (x**2 - 0.5 * y**2)], axis=1), grid(k, k)


def cube(k=8, noise=0.0, seed=5):
    """The cube [0, 1]^3, k x k squares a side; noise moves vertices within sides and edges."""
    rng = np.random.default_rng(seed)
    index, points, cells = {}, [], []

    def vertex(key):
        if key not in index:
            index[key] = len(points)
            x = np.array(key, float)
            free = (x > 0) & (x < k)
            x[free] += noise * rng.uniform(-0.5, 0.5, int(free.sum()))
            points.append(x / k)
        return index[key]

    for axis in range(3):
        for side in (0, k):
            for i in range(k):
                for j in range(k):
                    corner = []
                    for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1)):
                        key = [0, 0, 0]
                        key[axis], key[axis - 2], key[axis - 1] = side, i + di, j + dj
                        corner.append(vertex(tuple(key)))
                    a, b, c, d = corner if side else corner[::-1]
                    cells += [(a, b, c), (a, c, d)] if (i + j) % 2 else [(a, b, d), (b, c, d)]
    return np.array(points), np.array(cells)


def cylinder(around=32, along=12, rings=5, noise=0.0, seed=9):
    """Radius 1, height 2, with flat caps."""
    rng = np.random.default_rng(seed)
    points, cells = [], []
    angle = 2 * np.pi * np.arange(around) / around
    for i in range(along + 1):
        inner = 0 < i < along
        z = 2 * i / along + inner * noise * rng.uniform(-0.5, 0.5, around) * 2 / along
        turn = angle + inner * noise * rng.uniform(-0.5, 0.5, around) * 2 * np.pi / around
        points.append(np.stack([np.cos(turn), np.sin(turn), np.broadcast_to(z, around)], axis=1))
    side = grid(around, along + 1, wrap_u=True)
    order = (np.arange(around)[:, None] + around * np.arange(along + 1)).ravel()
    cells.append(order[side])
    n = around * (along + 1)
    for z, first, way in ((0.0, 0, -1), (2.0, around * along, 1)):
        ring = first + np.arange(around)
        for r in range(rings - 1, 0, -1):
            radius = r / rings
            points.append(np.stack([radius * np.cos(angle), radius * np.sin(angle),
                                    np.full(around, z)], axis=1))
            inner = n + np.arange(around)
            n += around
            a, b, c, d = ring, np.roll(ring, -1), np.roll(inner, -1), inner
            cells.append(np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])[:, ::way])
            ring = inner
        points.append(np.array([[0.0, 0.0, z]]))
        a, b = ring, np.roll(ring, -1)
        cells.append(np.stack([a, b, np.full(around, n)], axis=1)[:, ::way])
        n += 1
    return np.concatenate(points), np.concatenate(cells)


def moebius(k=30):
    """A strip with one side."""
    a = 2 * np.pi * np.arange(k) / k
    half = 0.3
    points = []
    for s in (-half, half):
        r = 1 + s * np.cos(a / 2)
        points.append(np.stack([r * np.cos(a), r * np.sin(a), s * np.sin(a / 2)], axis=1))
    cells = []
    for i in range(k):
        a, d = i, k + i
        b, c = (i + 1, k + i + 1) if i < k - 1 else (k, 0)
        cells += [(a, b, c), (a, c, d)]
    return np.concatenate(points), np.array(cells)


def sheet(k, height=lambda x, y: 0.0 * x):
    """Triangles of k x k squares over the unit square, with a height."""
    x, y = np.meshgrid(np.linspace(0, 1, k + 1), np.linspace(0, 1, k + 1), indexing="ij")
    points = np.stack([x, y, height(x, y)], axis=-1).reshape(-1, 3)
    return points, grid(k + 1, k + 1)


def uneven_sheet(n, height, seed, shift):
    """Triangles of a shifted unit square whose inner vertices were moved at random."""
    rng = np.random.default_rng(seed)
    u = np.linspace(0, 1, n + 1)
    x, y = (a.ravel().copy() for a in np.meshgrid(u, u, indexing="ij"))
    inside = (x > 0) & (x < 1) & (y > 0) & (y < 1)
    x[inside] += rng.uniform(-0.25, 0.25, inside.sum()) / n
    y[inside] += rng.uniform(-0.25, 0.25, inside.sum()) / n
    x, y = x + shift, y + shift / 2
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = (i.ravel() for i in (index[:-1, :-1], index[1:, :-1], index[1:, 1:],
                                      index[:-1, 1:]))
    cells = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return np.stack([x, y, height(x, y)], axis=1), cells


def ring():
    """A flat square with a square hole in the middle."""
    points, cells = sheet(5)
    return points, cells[np.abs(points[cells][:, :, :2].mean(axis=1) - 0.5).max(axis=1) > 0.15]


def plate(points, cells, thickness):
    """The closed surface around a flat one, with a thickness."""
    n = len(points)
    edges = np.concatenate([cells[:, [i, (i + 1) % 3]] for i in range(3)])
    inner = set(map(tuple, edges[:, ::-1].tolist()))
    a, b = np.array([e for e in edges.tolist() if tuple(e) not in inner]).T
    walls = np.concatenate([np.stack([b, a, a + n], 1), np.stack([b, a + n, b + n], 1)])
    both = np.concatenate([cells, cells[:, ::-1] + n, walls])
    return np.concatenate([points, points - np.array([0, 0, thickness])]), both


def turned(points, seed=2):
    """Points after a random rotation and shift."""
    rng = np.random.default_rng(seed)
    q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return points @ q.T + rng.standard_normal(3)


def diagonal(points):
    return float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))


def samples(points, cells, k=6):
    """Points of every triangle on a lattice of k steps, corners and edges included."""
    w = np.array([(i, j, k - i - j) for i in range(k + 1) for j in range(k + 1 - i)]) / k
    return np.einsum("wc,mcd->mwd", w, points[cells]).reshape(-1, 3)


def distances(x, points, cells):
    """Distance of every point x (k, 3) from a surface.

    Looked at is every triangle whose circle about its barycentre could hold something closer
    than the nearest vertex.
    """
    corner = points[cells]
    centre = corner.mean(axis=1)
    reach = np.linalg.norm(corner - centre[:, None], axis=2).max(axis=1)
    nearest = cKDTree(points[np.unique(cells)]).query(x)[0]
    near = cKDTree(centre).query_ball_point(
        x, (nearest + reach.max()) * (1 + 1e-9), return_sorted=False)
    row = np.repeat(np.arange(len(x)), [len(n) for n in near])
    column = np.fromiter(chain.from_iterable(near), dtype=np.int64, count=len(row))
    within = np.linalg.norm(x[row] - centre[column], axis=1) <= (
        nearest[row] + reach[column]) * (1 + 1e-9)
    row, column = row[within], column[within]
    p = x[row]
    a, b, c = (corner[column, i] for i in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    inside = length > 0
    height = np.abs(((p - a) * normal).sum(axis=1)) / np.where(inside, length, 1.0)
    best = np.full(len(row), np.inf)
    for u, v in ((a, b), (b, c), (c, a)):
        e = v - u
        ee = (e * e).sum(axis=1)
        w = np.clip(((p - u) * e).sum(axis=1) / np.where(ee > 0, ee, 1.0), 0.0, 1.0)
        best = np.minimum(best, np.linalg.norm(p - (u + w[:, None] * e), axis=1))
        inside &= (np.cross(e, p - u) * normal).sum(axis=1) >= 0
    # The normal of a triangle that is all but flat may be anything.
    best = np.where(inside, np.minimum(height, best), best)
    out = np.full(len(x), np.inf)
    np.minimum.at(out, row, best)
    return out


def two_sided(p0, t0, p1, t1, k=5):
    """Largest distances of lattice points of the second surface from the first, and back."""
    first, second = (np.unique(samples(*s, k), axis=0) for s in ((p0, t0), (p1, t1)))
    return float(distances(second, p0, t0).max()), float(distances(first, p1, t1).max())


def edge_set(cells):
    """Edges with the number of triangles that hold them."""
    pairs = np.sort(np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [2, 0]]]), axis=1)
    found, count = np.unique(pairs, axis=0, return_counts=True)
    return {tuple(e): c for e, c in zip(found.tolist(), count.tolist(), strict=True)}


def topology(cells):
    """Euler number, edges by the number of their triangles, connected pieces."""
    edges = edge_set(cells)
    root = {v: v for v in np.unique(cells).tolist()}

    def find(v):
        while root[v] != v:
            root[v] = root[root[v]]
            v = root[v]
        return v

    for a, b in edges:
        root[find(a)] = find(b)
    pieces = len({find(v) for v in root})
    counts = tuple(np.bincount(list(edges.values())).tolist())
    return len(root) - len(edges) + len(cells), counts, pieces
