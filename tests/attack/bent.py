"""Random curved quadratic meshes that are improved or get other sizes."""

from __future__ import annotations

from collections import Counter
from itertools import combinations
from pathlib import Path
from typing import Any

import meshio
import numpy as np

import odt_plugins
from attack.judge import Broken
from attack.shapes import piece, placed
from attack.sizes import random_wish

SECONDS = 240.0
"""No case may take longer."""

EDGES = {3: ((0, 1), (1, 2), (2, 0)), 4: ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3))}
"""Corners around the nodes of a cell with so many corners."""

NAMES = {3: "triangle6", 4: "tetra10"}

Rng = np.random.Generator


def attack(rng: Rng, folder: Path) -> None:
    """Let one random mesh of curved cells be improved or get other sizes, and judge the result.

    Raises
    ------
    Broken    what of the promise does not hold
    """
    kind = str(rng.choice(["plane", "space", "surface"]))
    points, corners = piece(kind, rng)
    points = placed(points, rng)
    nodes, cells = bent(points, corners, rng, everywhere=kind == "surface")
    mesh = meshio.Mesh(nodes, [(NAMES[corners.shape[1]], cells)],
                       point_data={"field": nodes.sum(axis=1)})
    options: dict[str, Any] = {"boundary": str(rng.choice(["slide", "fixed"], p=[0.8, 0.2])),
                               "envelope": float(10.0 ** rng.uniform(-4, -1))}
    if rng.random() < 0.7:
        wish = random_wish(rng, points, corners)
        if isinstance(wish.get("size"), np.ndarray):
            wish = {"scale": 0.7}
        out = odt_plugins.remesh(mesh, **wish, **options, most_cells=20_000)
    else:
        out = odt_plugins.optimize(mesh, **options)
    faults = _faults(mesh, out, corners.shape[1], rng)
    if faults:
        raise Broken(faults)


def bent(
    points: np.ndarray, corners: np.ndarray, rng: Rng, *, everywhere: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and cells whose edges on the boundary, or all of them, are bent at random."""
    size = corners.shape[1]
    count = Counter(facet for row in np.sort(corners, axis=1).tolist()
                    for facet in combinations(row, size - 1))
    outer = {edge for facet, k in count.items() if k == 1 or everywhere
             for edge in combinations(facet, 2)}
    amount = float(rng.choice([0.003, 0.02, 0.08]))
    nodes, number, rows = list(points), {}, []
    for row in corners.tolist():
        for i, j in EDGES[size]:
            edge = (min(row[i], row[j]), max(row[i], row[j]))
            if edge not in number:
                number[edge] = len(nodes)
                a, b = points[list(edge)]
                off = amount * np.linalg.norm(b - a) * rng.normal(size=points.shape[1])
                nodes.append(0.5 * (a + b) + (off if edge in outer else 0.0))
        rows.append(row + [number[min(row[i], row[j]), max(row[i], row[j])]
                           for i, j in EDGES[size]])
    return np.array(nodes), np.array(rows)


def determinants(x: np.ndarray, corners: int, rng: Rng) -> np.ndarray:
    """Least determinant (m,) of cells (m, k, D) at random places, by that of the corners."""
    weights = np.vstack([np.eye(corners), rng.dirichlet(np.ones(corners), 60)])
    least = np.full(len(x), np.inf)
    for w in weights:
        slope = np.zeros((x.shape[1], corners))
        for i in range(corners):
            slope[i, i] = 4 * w[i] - 1
        for k, (i, j) in enumerate(EDGES[corners]):
            slope[corners + k, [i, j]] = 4 * w[j], 4 * w[i]
        along = np.einsum("mkx,kc->mcx", x, slope[:, 1:] - slope[:, :1])
        edges = x[:, 1:corners] - x[:, :1]
        if x.shape[2] == corners:
            normal = np.cross(edges[:, 0], edges[:, 1])[:, None]
            along, edges = (np.concatenate([both, normal], axis=1) for both in (along, edges))
        whole = np.linalg.det(edges)
        least = np.minimum(least, np.linalg.det(along) / np.where(whole == 0.0, np.nan, whole))
    return least


def _faults(before: meshio.Mesh, after: meshio.Mesh, corners: int, rng: Rng) -> list[str]:
    was, now = (mesh.cells[0].data for mesh in (before, after))
    faults = []
    if not np.isfinite(after.points).all():
        return ["a node is nowhere"]
    if (determinants(before.points[was], corners, rng) > 1e-6).all():
        folded = determinants(after.points[now], corners, rng) < -1e-9
        if folded.any():
            faults.append(f"{folded.sum()} cells are folded, first {folded.argmax()}")
    node: dict[tuple[int, ...], int] = {}
    for row in now.tolist():
        for k, (i, j) in enumerate(EDGES[corners]):
            edge = (min(row[i], row[j]), max(row[i], row[j]))
            if node.setdefault(edge, row[corners + k]) != row[corners + k]:
                faults.append(f"edge {edge} has two nodes")
    if len(set(node.values())) < len(node):
        faults.append("a node is on two edges")
    used = len(np.unique(was)) == len(before.points)
    if used and len(np.unique(now)) < len(after.points):
        faults.append("a node is of no cell")
    return faults
