"""Random small meshes that get other sizes, with labelled faces beside the cells or without."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Any

import meshio
import numpy as np

import odt_plugins
from attack.judge import Broken, Mesh, beyond, broken_by_sizes, euler, is_soup
from attack.meshes import curved, same
from attack.shapes import piece, placed, tilted, torn
from odt_plugins.options import FIGURES, Options

SECONDS = 240.0
"""No case may take longer."""

NAMES = {4: "tetra", 3: "triangle", 2: "line"}
"""Kinds of cells by the number of their corners."""

TAG = "tag"
"""Array of the labels."""

Rng = np.random.Generator


def attack(rng: Rng, folder: Path) -> None:
    """Give one random mesh other sizes and judge the result.

    Raises
    ------
    Broken    what of the promise does not hold
    """
    kind = str(rng.choice(["plane", "space", "surface"]))
    points, cells = piece(kind, rng)
    points = placed(points, rng)
    if rng.random() < 0.25:
        points, cells = torn(points, cells, rng)
    if kind == "plane" and rng.random() < 0.2:
        points = tilted(points, rng)
    before = Mesh(points, cells, halves(points, cells, rng) if rng.random() < 0.4 else None)
    options: dict[str, Any] = {
        "keep": tuple(name for name in FIGURES if rng.random() < 0.2), "free": "periodic",
        "boundary": str(rng.choice(["slide", "fixed"], p=[0.8, 0.2])),
        "envelope": float(10.0 ** rng.uniform(-4, -1))}
    if rng.random() < 0.2:
        options["fixed"] = rng.random(len(points)) < 0.2
    wish = random_wish(rng, points, cells) | {"most_cells": 20_000}
    mesh: Any = (points, cells)
    if rng.random() < 0.6:
        mesh = with_faces(before, rng)
    elif before.labels is not None:
        mesh = (points, cells, before.labels)
    found, report = odt_plugins.remesh_with_report(mesh, **wish, **options)
    after = view(found)
    known = Options(**options)
    faults = broken_by_sizes(before, after, known, curved=curved(before))
    if isinstance(mesh, meshio.Mesh) and not is_soup(before):
        faults += broken_faces(mesh, found, known)
    if rng.random() < 0.3:
        k = int(rng.integers(2, 4))
        again = odt_plugins.remesh(mesh, **wish, **options, threads=k)
        faults += [f"the result is another one for {k} threads"] * (not same(after, view(again)))
    str(report), report.to_json()
    if faults:
        raise Broken(faults)


def random_wish(rng: Rng, points: np.ndarray, cells: np.ndarray) -> dict[str, Any]:
    """Sizes in one of the ways in which they are told."""
    edges = points[cells] - points[np.roll(cells, 1, axis=1)]
    length = float(np.sqrt((edges**2).sum(axis=2)).mean())
    low, reach = points.min(axis=0), float(np.ptp(points)) or 1.0
    factor = float(10.0 ** rng.uniform(-0.5, 0.8))

    def function(x: np.ndarray) -> np.ndarray:
        return length * factor * (0.3 + np.abs(x[:, 0] - low[0]) / reach)

    count = len(points) if rng.random() < 0.5 else len(cells)
    ways: dict[str, dict[str, Any]] = {
        "length": {"size": length * factor},
        "array": {"size": length * factor * 10.0 ** rng.uniform(-0.7, 0.7, count)},
        "function": {"size": function}, "curvature": {"size": "curvature"},
        "scale": {"scale": factor}, "cells": {"cells": int(10.0 ** rng.uniform(0, 2.7))},
        "vertices": {"vertices": int(10.0 ** rng.uniform(0, 2.3))}}
    wish = ways[str(rng.choice(sorted(ways)))]
    return wish | ({"growth": float(rng.uniform(1.05, 3.0))} if rng.random() < 0.2 else {})


def halves(points: np.ndarray, rows: np.ndarray, rng: Rng) -> np.ndarray:
    """Labels of simplices by the sides of a plane on which they lie, 3 or 8."""
    middle = points[rows].mean(axis=1) @ rng.normal(size=points.shape[1])
    return np.where(middle > np.quantile(middle, rng.random()), 3, 8)


def with_faces(mesh: Mesh, rng: Rng) -> meshio.Mesh:
    """Also the facets of the boundary and between labels, labelled, and lines where these meet."""
    blocks = [(mesh.cells, np.full(len(mesh.cells), 5) if mesh.labels is None else mesh.labels)]
    owners: dict[tuple[int, ...], list[int]] = {}
    for label, row in zip(blocks[0][1].tolist(), mesh.cells.tolist(), strict=True):
        for facet in combinations(sorted(row), len(row) - 1):
            owners.setdefault(facet, []).append(label)
    facets = [f for f, labels in owners.items() if len(labels) != 2 or labels[0] != labels[1]]
    for _ in range(mesh.cells.shape[1] - 2):
        rows = np.array(facets, dtype=int)
        if not len(rows):
            break
        labels = halves(mesh.points, rows, rng)
        if rng.random() < 0.3:
            rows, labels = rows[labels == labels[0]], labels[labels == labels[0]]
        blocks.append((rows, labels))
        met: dict[tuple[int, ...], set[int]] = {}
        for label, row in zip(labels.tolist(), rows.tolist(), strict=True):
            for edge in combinations(row, len(row) - 1):
                met.setdefault(edge, set()).add(label)
        facets = [edge for edge, of in met.items() if len(of) > 1]
    return meshio.Mesh(mesh.points, [(NAMES[rows.shape[1]], rows) for rows, _ in blocks],
                       cell_data={TAG: [labels for _, labels in blocks]})


def view(found: Any) -> Mesh:
    """Points, cells and labels of a result."""
    if isinstance(found, meshio.Mesh):
        return Mesh(found.points, found.cells[0].data)
    return Mesh(*found)


def broken_faces(before: meshio.Mesh, after: meshio.Mesh, options: Options) -> list[str]:
    """Say what faces beside the cells do not keep: labels, places, topology, and to be faces."""
    faults = []
    kinds = [[block.type for block in mesh.cells] for mesh in (before, after)]
    if kinds[0] != kinds[1]:
        return [f"blocks {kinds[0]} came back as {kinds[1]}"]
    x, y = (np.pad(m.points, ((0, 0), (0, 3 - m.points.shape[1]))) for m in (before, after))
    used = before.cells[0].data
    for i, kind in enumerate(kinds[0]):
        was, now = before.cells[i].data, after.cells[i].data
        old, new = (np.asarray(m.cell_data[TAG][i]) for m in (before, after))
        if set(old.tolist()) != set(new.tolist()):
            faults.append(f"labels of {kind} {set(old.tolist())} came back as {set(new.tolist())}")
            continue
        if i and not _are_faces(now, after.cells[0].data):
            faults.append(f"a {kind} is no face any more, or is there twice")
        for label in np.unique(old) if i else ():
            a, b = was[old == label], now[new == label]
            if euler(a) != euler(b):
                faults.append(f"the Euler number of {kind} {label} is {euler(b)}, was {euler(a)}")
            columns = np.arange(3) % a.shape[1]
            faults += [f"{kind} {label}: {fault}" for fault in beyond(
                x, a[:, columns], y, b[:, columns], options, used)]
    return faults


def _are_faces(rows: np.ndarray, cells: np.ndarray) -> bool:
    """Whether rows are faces of cells, each there once."""
    known = {face for row in np.sort(cells, axis=1).tolist()
             for face in combinations(row, rows.shape[1])}
    found = [tuple(row) for row in np.sort(rows, axis=1).tolist()]
    return set(found) <= known and len(set(found)) == len(found)
