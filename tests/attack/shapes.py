"""Random meshes: small, of all kinds, in one or several pieces, and odd in many ways."""

from __future__ import annotations

from typing import NamedTuple

import contract
import numpy as np
import surface_meshes
from measure.hard import CLOUDS, delaunay
from scipy.spatial import QhullError

Rng = np.random.Generator
Arrays = tuple[np.ndarray, np.ndarray]


class RandomMesh(NamedTuple):
    """Points (n, 2 or 3), cells (m, 3 or 4), labels (m,) or None, and what it is."""

    points: np.ndarray
    cells: np.ndarray
    labels: np.ndarray | None
    kind: str


def random_mesh(rng: Rng) -> RandomMesh:
    """A mesh of one of three kinds, and with a small probability of each fault or oddity."""
    kind = str(rng.choice(["plane", "space", "surface"], p=[0.3, 0.4, 0.3]))
    points, cells = _pieces(kind, rng)
    for change, probability in ((_some_cells, 0.2), (_split_vertices, 0.12), (_loose_cell, 0.12),
                                (_fins, 0.2), (_pressed, 0.2)):
        if rng.random() < probability:
            points, cells = change(points, cells, rng)
    labels = _labels(points, cells, rng) if rng.random() < 0.4 else None
    points = placed(points, rng)
    if rng.random() < 0.3:
        points, cells = _unused(points, cells, rng)
    if rng.random() < 0.5:
        points, cells, labels = _shuffled(points, cells, labels, rng)
    chance = rng.random()
    if chance < 0.25:
        cells = _turned(cells, np.ones(len(cells), dtype=bool))
    elif chance < 0.35:
        cells = _turned(cells, rng.random(len(cells)) < 0.3)
    if kind == "plane" and rng.random() < 0.2:
        points = tilted(points, rng)
    if rng.random() < 0.04:
        points, cells, labels = _spoilt(points, cells, labels, rng)
    return RandomMesh(points, cells, labels, kind)


def _pieces(kind: str, rng: Rng) -> Arrays:
    """One or several pieces beside, in or at each other."""
    points, cells = piece(kind, rng)
    while rng.random() < 0.2:
        more, rows = piece(kind, rng)
        size = np.ptp(points, axis=0)
        away = rng.choice([-1.0, 0.0, 1.0], size=points.shape[1]) * (1 + rng.random())
        rows = rows + len(points)
        if rng.random() < 0.3:
            # Both have this vertex.
            i, j = rng.integers(len(points)), rng.integers(len(more))
            away, more = 0.0, more - more[j] + points[i]
            rows = np.where(rows == len(points) + j, i, rows)
        points = np.concatenate([points, more + away * size])
        cells = np.concatenate([cells, rows])
    return points, cells


def piece(kind: str, rng: Rng) -> Arrays:
    """One sound mesh in the "plane", in "space" or of a "surface"."""
    n = int(np.exp(rng.uniform(np.log(4), np.log(100))))
    if kind == "surface":
        return _surface(rng, n)
    d = 2 if kind == "plane" else 3
    style = rng.random()
    if style < 0.1:
        return _loose(d, rng)
    if style < 0.4:
        points, cells, _ = contract.grid(d, int(rng.integers(1, 7 if d == 2 else 4)),
                                         int(rng.integers(1 << 30)))
        return points, cells
    for _ in range(5):
        name = rng.choice(sorted(CLOUDS))
        try:
            points, cells = delaunay(CLOUDS[name](rng, d, max(n, 12)))
        except QhullError:
            continue
        if len(cells):
            return points, cells
    return _loose(d, rng)


def _loose(d: int, rng: Rng) -> Arrays:
    """One simplex, anyhow."""
    points = rng.random((d + 1, d))
    cells = np.arange(d + 1)[None]
    return points, _turned(cells, contract.volumes(points, cells) < 0)


def _surface(rng: Rng, n: int) -> Arrays:
    seed, noise, k = int(rng.integers(1 << 30)), rng.choice([0.0, 0.3, 0.8]), int(n**0.5) + 3
    style = rng.integers(9)
    if style == 0:
        return surface_meshes.sphere(int(rng.integers(3)), 0.4 * noise, seed)
    if style == 1:
        return surface_meshes.torus(k + 3, k, noise, seed)
    if style == 2:
        return surface_meshes.bowl(k, noise, seed)
    if style == 3:
        return surface_meshes.cube(k // 3, noise, seed)
    if style == 4:
        return surface_meshes.cylinder(k, max(k // 2, 1), 2, noise, seed)
    if style == 5:
        return surface_meshes.moebius(k)
    if style == 6:
        return surface_meshes.plate(*surface_meshes.ring(), rng.choice([1e-3, 0.1]))
    points, cells = piece("space", rng) if style == 7 else piece("plane", rng)
    if points.shape[1] == 2:
        height = (points**2).sum(axis=1) / np.ptp(points) + 0.05 * rng.random(len(points))
        return np.column_stack([points, height]), cells
    return points, _faces(cells, rng)


def _faces(cells: np.ndarray, rng: Rng) -> np.ndarray:
    """The boundaries of parts of a mesh of tetrahedra, and the interfaces between them."""
    part = rng.integers(0, rng.integers(1, 4), len(cells))
    owners: dict[tuple[int, ...], list[tuple[int, tuple[int, ...]]]] = {}
    for label, (a, b, c, d) in zip(part.tolist(), cells.tolist(), strict=True):
        for face in ((b, c, d), (a, d, c), (a, b, d), (a, c, b)):
            owners.setdefault(tuple(sorted(face)), []).append((label, face))
    return np.array([found[0][1] for found in owners.values()
                     if len(found) == 1 or found[0][0] != found[1][0]])


def _some_cells(points: np.ndarray, cells: np.ndarray, rng: Rng) -> Arrays:
    if rng.random() < 0.5:
        keep = rng.random(len(cells)) < rng.uniform(0.3, 1.0)
    else:
        center = points[cells].mean(axis=1)
        keep = center @ rng.normal(size=points.shape[1]) < center.mean()
    keep[rng.integers(len(cells))] = True
    return points, cells[keep]


def _split_vertices(points: np.ndarray, cells: np.ndarray, rng: Rng) -> Arrays:
    """Some cells get copies of their vertices: cracks, or cells that are all apart."""
    share = rng.choice([0.02, 0.3, 1.0])
    chosen = rng.random(cells.shape) < share
    cells = cells.copy()
    old = cells[chosen]
    cells[chosen] = len(points) + np.arange(len(old))
    return np.concatenate([points, points[old]]), cells


def torn(points: np.ndarray, cells: np.ndarray, rng: Rng) -> Arrays:
    """Parts that meet at a plane, or anyhow, get vertices of their own."""
    center = points[cells].mean(axis=1) @ rng.normal(size=points.shape[1])
    part = center > np.quantile(center, rng.random())
    if rng.random() < 0.4:
        part = part + 2 * (rng.random(len(cells)) < rng.choice([0.05, 0.4]))
    pairs, number = np.unique(
        np.stack([cells, np.broadcast_to(part[:, None], cells.shape)], axis=-1).reshape(-1, 2),
        axis=0, return_inverse=True)
    return points[pairs[:, 0]], number.reshape(cells.shape)


def _loose_cell(points: np.ndarray, cells: np.ndarray, rng: Rng) -> Arrays:
    k, d = cells.shape[1], points.shape[1]
    corners = np.concatenate([np.zeros((1, d)), np.eye(d)[: k - 1]]) + 0.2 * rng.random((k, d))
    row = len(points) + np.arange(k)[None]
    place = points.max(axis=0) + np.ptp(points) * rng.random()
    return np.concatenate([points, place + 10.0 ** rng.uniform(-3, 1) * corners]), \
        np.concatenate([cells, row])


def _fins(points: np.ndarray, cells: np.ndarray, rng: Rng) -> Arrays:
    """Cells on a face of a lower dimension of others: edges of three triangles, hinges."""
    d = points.shape[1]
    for _ in range(rng.integers(1, 4)):
        row = cells[rng.integers(len(cells))]
        shared = rng.permutation(row)[: cells.shape[1] - 1 - (d == cells.shape[1] - 1)]
        fresh = cells.shape[1] - len(shared)
        away = points[shared].mean(axis=0) + 0.5 * np.ptp(points) * rng.normal(size=(fresh, d))
        new = np.concatenate([shared, len(points) + np.arange(fresh)])
        points = np.concatenate([points, away])
        if d == cells.shape[1] - 1:
            new = _turned(new[None], contract.volumes(points, new[None]) < 0)[0]
        cells = np.concatenate([cells, new[None]])
    return points, cells


def _pressed(points: np.ndarray, cells: np.ndarray, rng: Rng) -> Arrays:
    """Move vertices towards others: slivers, needles, flat triangles."""
    points = points.copy()
    share = 10.0 ** rng.uniform(-6, -1)
    for _ in range(rng.integers(1, 6)):
        row = rng.permutation(cells[rng.integers(len(cells))])
        old = points[row[0]].copy()
        goal = points[row[1:]].mean(axis=0) if rng.random() < 0.7 else points[row[1]]
        points[row[0]] = goal + share * (old - goal)
        if cells.shape[1] == points.shape[1] + 1 and (contract.volumes(points, cells) <= 0).any():
            points[row[0]] = old
    return points, cells


def _labels(points: np.ndarray, cells: np.ndarray, rng: Rng) -> np.ndarray:
    style = rng.random()
    if style < 0.3:
        found = rng.integers(0, rng.integers(1, 5), len(cells))
    elif style < 0.8:
        center = points[cells].mean(axis=1) @ rng.normal(size=points.shape[1])
        found = (center > np.median(center)).astype(int) + (center > center.mean() + center.std())
    else:
        found = np.arange(len(cells))
    return found * rng.choice([1, 7]) - rng.choice([0, 3])


def placed(points: np.ndarray, rng: Rng) -> np.ndarray:
    """Stretch, scale, shift, round."""
    if rng.random() < 0.3:
        points = points * 10.0 ** rng.uniform(-2, 2, points.shape[1])
    chance = rng.random()
    points = points * (10.0 ** rng.uniform(-38, 38) if chance < 0.1 else
                       10.0 ** rng.uniform(-9, 9) if chance < 0.3 else 1.0)
    if rng.random() < 0.2:
        points = points + np.ptp(points) * 10.0 ** rng.uniform(-1, 7) * rng.choice([-1, 1])
    if rng.random() < 0.15:
        step = np.ptp(points) * 10.0 ** rng.uniform(-5, -1)
        points = np.round(points / step) * step
    return points


def _unused(points: np.ndarray, cells: np.ndarray, rng: Rng) -> Arrays:
    """Vertices of no cell, some of them where others are."""
    fresh = points[rng.integers(len(points), size=rng.integers(1, 5))].copy()
    fresh += np.ptp(points) * rng.choice([0.0, 3.0]) * rng.normal(size=fresh.shape)
    n = len(points)
    order = rng.permutation(n + len(fresh))
    place = np.empty(len(order), dtype=int)
    place[order] = np.arange(len(order))
    return np.concatenate([points, fresh])[order], place[cells]


def _shuffled(
    points: np.ndarray, cells: np.ndarray, labels: np.ndarray | None, rng: Rng
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    order = rng.permutation(len(points))
    place = np.empty(len(order), dtype=int)
    place[order] = np.arange(len(order))
    rows = rng.permutation(len(cells))
    cells = place[cells][rows]
    some = rng.random(len(cells)) < 0.5
    cells[some, :3] = cells[some][:, [1, 2, 0]]
    return points[order], cells, None if labels is None else labels[rows]


def _turned(cells: np.ndarray, mask: np.ndarray) -> np.ndarray:
    cells = cells.copy()
    cells[mask, :2] = cells[mask, 1::-1]
    return cells


def tilted(points: np.ndarray, rng: Rng) -> np.ndarray:
    """Points of a plane in space."""
    space = np.column_stack([points, np.full(len(points), rng.choice([0.0, 1.0]))])
    if rng.random() < 0.5:
        q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        space = space @ q
    return space


def _spoilt(
    points: np.ndarray, cells: np.ndarray, labels: np.ndarray | None, rng: Rng
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Break a mesh in one of the ways in which callers break theirs."""
    points, cells = points.copy(), cells.copy()
    row, column = rng.integers(len(cells)), rng.integers(cells.shape[1])
    way = rng.integers(9)
    if way == 0:
        points[rng.integers(len(points))] = rng.choice([np.nan, np.inf, 1e300, -1e300])
    elif way == 1:
        cells = cells.astype(np.int64)
        cells[row, column] = rng.choice([-1, len(points), 1 << 31, 1 << 40])
    elif way == 2:
        cells[row, column] = cells[row, column - 1]
    elif way == 3:
        points[cells[row, column]] = points[cells[row, column - 1]]
    elif way == 4:
        cells = np.concatenate([cells, cells[row : row + 1]])
        labels = None if labels is None else np.append(labels, labels[row])
    elif way == 5:
        points[:] = points[0]
    elif way == 6:
        cells, labels = cells[:0], None if labels is None else labels[:0]
    elif way == 7:
        labels = rng.integers(0, 3, len(cells) + 1)
    else:
        points[:, rng.integers(points.shape[1])] = 0.0
    return points, cells, labels
