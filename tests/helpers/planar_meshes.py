"""Planar start meshes of the tests: a graded mesh around an airfoil, jittered grids, regions."""

from __future__ import annotations

import numpy as np
import reference_flips as ref
from scipy.spatial import Delaunay, cKDTree

from odt_plugins.engine.cells.measures import DIHEDRAL, MEAN_RATIO, QUALITY, STEP


def shape(points, cells):
    """Radius ratio 2r/R and the three angles in degrees, from the side lengths alone."""
    x = points[cells]
    a, b, c = (np.linalg.norm(x[:, i] - x[:, j], axis=1) for i, j in ((1, 2), (2, 0), (0, 1)))
    q = (b + c - a) * (c + a - b) * (a + b - c) / (a * b * c)
    cosines = np.stack([(b * b + c * c - a * a) / (2 * b * c),
                        (c * c + a * a - b * b) / (2 * c * a),
                        (a * a + b * b - c * c) / (2 * a * b)], axis=1)
    return q, np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))


def amips(points, cells):
    """AMIPS energy tr(J^T J) / det(J), J from the regular triangle with unit edges."""
    x = points[cells]
    regular = np.array([[1.0, 0.5], [0.0, np.sqrt(0.75)]])
    jacobian = np.swapaxes(x[:, 1:] - x[:, :1], 1, 2) @ np.linalg.inv(regular)
    return (jacobian**2).sum(axis=(1, 2)) / np.linalg.det(jacobian)


def softened_sine(points, cells):
    """Power mean of the three squared sines, 1 for the regular triangle."""
    sines = np.sin(np.radians(shape(points, cells)[1]))
    return 4 / 3 * (sines**-8).mean(axis=1) ** -0.25


def areas(points, cells):
    """Signed areas."""
    u, v = points[cells[:, 1]] - points[cells[:, 0]], points[cells[:, 2]] - points[cells[:, 0]]
    return 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def energy(points, cells):
    """ODT energy of Lemma 2.7, uniform density."""
    x = points[cells]
    t = sum(((x[:, i] - x[:, j]) ** 2).sum(axis=1) for i, j in ((0, 1), (1, 2), (2, 0)))
    return float((areas(points, cells) * t).sum() / 12.0)


def edge_cells(cells):
    """Dictionary: undirected edge -> cells that have it."""
    found: dict[tuple[int, int], list[int]] = {}
    for t, (a, b, c) in enumerate(cells.tolist()):
        for edge in ((a, b), (b, c), (c, a)):
            found.setdefault((min(edge), max(edge)), []).append(t)
    return found


def kept_edges(cells, regions):
    """Boundary and interface edges as a set of vertex pairs."""
    return {edge for edge, owners in edge_cells(cells).items()
            if len(owners) == 1 or regions[owners[0]] != regions[owners[1]]}


def kept_vertices(cells, regions, n):
    """Mask of the vertices on the boundary or on an interface."""
    mask = np.zeros(n, dtype=bool)
    mask[list({v for edge in kept_edges(cells, regions) for v in edge})] = True
    return mask


def oriented(points, cells):
    """The same cells, counterclockwise, int32."""
    cells = np.array(cells, dtype=np.int32)
    turned = areas(points, cells) < 0
    cells[turned, :2] = cells[turned, 1::-1]
    return cells


def _resampled(curve, h):
    """Points of a closed curve with the spacing h(x), evenly in the integral of 1/h."""
    closed = np.vstack([curve, curve[:1]])
    step = np.linalg.norm(np.diff(closed, axis=0), axis=1)
    count = np.concatenate([[0.0], np.cumsum(step / h(0.5 * (closed[1:] + closed[:-1])))])
    places = np.linspace(0.0, count[-1], round(count[-1]) + 1)[:-1]
    return np.stack([np.interp(places, count, closed[:, k]) for k in (0, 1)], axis=1)


def _in_polygon(points, polygon):
    """Even-odd rule."""
    inside = np.zeros(len(points), dtype=bool)
    for p, q in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        crosses = (p[1] > points[:, 1]) != (q[1] > points[:, 1])
        rise = q[1] - p[1]
        if rise != 0.0:
            inside ^= crosses & (points[:, 0] < p[0] + (points[:, 1] - p[1]) / rise * (q[0] - p[0]))
    return inside


def airfoil(seed=7, h0=0.01, grading=0.1, sweeps=60):
    """Good graded mesh around a rounded airfoil in a disk: points, cells, boundary mask."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(0.0, 2.0 * np.pi, 4000, endpoint=False)
    circle = -0.08 + 0.06j + abs(0.95 + 0.08 - 0.06j) * 1.04 * np.exp(1j * angle)
    curve = (circle + 0.9 / circle) / 4.0
    wing = np.stack([curve.real, curve.imag], axis=1)
    tree = cKDTree(wing)

    def h(x):
        return h0 + grading * tree.query(x)[0]

    rim = 2.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    wing, rim = _resampled(wing, h), _resampled(rim, h)
    fixed = np.vstack([wing, rim])
    candidates = [fixed]
    size = float(h(rim).max())
    while size > h0 / 2:
        reach = min(2.1, 0.6 + max(0.0, 1.1 * size - h0) / grading)
        rows, columns = np.mgrid[-reach:reach:size * 0.75**0.5, -reach:reach:size]
        columns = columns + size / 2 * (np.arange(len(rows)) % 2)[:, None]
        grid = np.stack([columns.ravel(), rows.ravel()], axis=1)
        grid += rng.uniform(-0.02, 0.02, grid.shape) * size
        grid = grid[(np.linalg.norm(grid, axis=1) < 2.0) & ~_in_polygon(grid, wing)]
        wanted = h(grid)
        grid = grid[(wanted < 1.1 * size) & (wanted >= size / 1.1)]
        grid = grid[cKDTree(np.vstack(candidates)).query(grid)[0] > 0.72 * h(grid)]
        candidates.append(grid)
        size /= 1.1**2
    points = np.vstack(candidates)
    boundary = np.arange(len(points)) < len(fixed)

    def triangulate(x):
        cells = Delaunay(x).simplices
        inside = np.sort(cells, axis=1)
        # a triangle of three boundary vertices may lie outside; any other is inside
        doubtful = np.flatnonzero(inside[:, 2] < len(fixed))
        b = x[cells[doubtful]].mean(axis=1)
        outside = doubtful[_in_polygon(b, wing) | ~_in_polygon(b, rim)]
        return oriented(x, np.delete(cells, outside, axis=0))

    for sweep in range(sweeps):
        if sweep % 4 == 0:
            cells = triangulate(points)
            edges = np.unique(np.sort(np.vstack([cells[:, [0, 1]], cells[:, [1, 2]],
                                                 cells[:, [2, 0]]]), axis=1), axis=0)
        bar = points[edges[:, 1]] - points[edges[:, 0]]
        length = np.linalg.norm(bar, axis=1)
        rest = h(0.5 * (points[edges[:, 0]] + points[edges[:, 1]]))
        rest *= 1.15 * np.sqrt((length**2).sum() / (rest**2).sum())
        push = (np.maximum(rest - length, 0.0) / length)[:, None] * bar * 0.2
        for d in (0, 1):
            points[:, d] += ~boundary * (
                np.bincount(edges[:, 1], push[:, d], len(points))
                - np.bincount(edges[:, 0], push[:, d], len(points)))
    return points, triangulate(points), boundary


def perturbed(points, cells, boundary, seed=11, amount=0.36, floor=0.25):
    """Move interior vertices at random, boundary kept, until the worst q is about ``floor``."""
    rng = np.random.default_rng(seed)
    star = np.bincount(cells.ravel(), np.repeat(areas(points, cells), 3), len(points))
    step = rng.uniform(-1.0, 1.0, points.shape) * np.sqrt(star / 6.0)[:, None]
    step *= amount * ~boundary[:, None]
    for _ in range(60):
        moved = points + step
        q, _ = shape(moved, cells)
        q[areas(moved, cells) <= 0.0] = -1.0
        bad = np.unique(cells[q < floor])
        if len(bad) == 0:
            break
        step[bad] *= 0.8
    return moved


def jittered_grid(nx, ny, rng, amount=0.24, holes=()):
    """Grid with moved interior vertices, random diagonals, quads in ``holes`` left out.

    Every cell is positive for amount < 0.25: an altitude is 0.707, a move at most 0.354 long.
    """
    points = np.stack(np.meshgrid(np.arange(nx + 1.0), np.arange(ny + 1.0), indexing="ij"),
                      axis=2).reshape(-1, 2)
    cells = []
    for i in range(nx):
        for j in range(ny):
            if (i, j) in holes:
                continue
            a, b = i * (ny + 1) + j, (i + 1) * (ny + 1) + j
            c, d = b + 1, a + 1
            cells += [[a, b, c], [a, c, d]] if rng.random() < 0.5 else [[a, b, d], [b, c, d]]
    cells = np.array(cells, dtype=np.int32)
    boundary = kept_vertices(cells, np.zeros(len(cells), dtype=np.int32), len(points))
    jitter = rng.uniform(-amount, amount, points.shape)
    points = points + jitter * ~boundary[:, None]
    return points, cells, boundary


HOLES = {(2, 2), (2, 3), (5, 5), (6, 0)}


def grid(seed, n=7, holes=HOLES, flips=0):
    rng = np.random.default_rng(seed)
    points, cells, _ = jittered_grid(n, n, rng, 0.24, holes)
    return points, ref.random_flips(points, cells, rng, flips)


def altitudes(points, cells):
    """Three altitudes of every triangle, (m, 3): twice the area over the length of an edge."""
    x = points[cells]
    length = np.stack([np.linalg.norm(x[:, j] - x[:, i], axis=1)
                       for i, j in ((1, 2), (0, 2), (0, 1))], axis=1)
    return 2.0 * np.abs(areas(points, cells))[:, None] / length


def step(points, cells):
    """Fourth root of (sum h^-2)^(-1/2), h the altitudes."""
    return (altitudes(points, cells) ** -2.0).sum(axis=1) ** -0.125


MEASURES = {
    QUALITY: lambda points, cells: shape(points, cells)[0],
    MEAN_RATIO: lambda points, cells: (2.0 / amips(points, cells)) ** 2,
    DIHEDRAL: softened_sine,
    STEP: step,
}
