"""How well meshes match the metrics of the Unstructured Grid Adaptation Working Group.

D. Ibanez et al., First benchmark of the unstructured grid adaptation working group, Procedia Eng.
203 (2017) 154-166; https://github.com/UGAWG/adapt-benchmarks.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np
from skfem import MeshTet

import odt_plugins
from odt_plugins.compare.table import Say, Table, Value
from odt_plugins.engine.cells.tensors import logarithm
from odt_plugins.engine.remesh.sizes import lengths_of, unique_edges
from odt_plugins.figures import summarize
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.seen import as_seen

ROUNDS = 3
"""Meshes, each in the metric at the vertices of the one before."""

Mesh = tuple[FloatArray, IntArray]

FINEST = 0.01
"""Least length in the metrics of the working group, whose own is 0.001."""

MATCHED = ("test", "vertices", "cells", "edges in [.71, 1.41]", "mean q", "least q", "s")


def linear(x: FloatArray) -> FloatArray:
    """Lengths along the axes (n, 3), as tensors, that are short in the middle of the height."""
    h = np.full((len(x), 3), 0.1)
    h[:, 2] = FINEST + 2.0 * (0.1 - FINEST) * np.abs(x[:, 2] - 0.5)
    return h[:, :, None] ** -2.0 * np.eye(3)


def polar(x: FloatArray, *, fine: bool) -> FloatArray:
    """Lengths that are short across the cylinder of radius .5, and along its arcs too if fine."""
    r = np.hypot(x[:, 0], x[:, 1])
    h = np.full((len(x), 3), 0.1)
    h[:, 0] = FINEST + 2.0 * (0.1 - FINEST) * np.abs(r - 0.5)
    if fine:
        near = np.maximum(10.0 * (0.6 - r), 0.0)
        h[:, 1] = near / 40.0 + (1.0 - near) * 0.1
    c, s = x[:, 0] / r, x[:, 1] / r
    zero, one = np.zeros(len(x)), np.ones(len(x))
    turn = np.stack([np.stack(row, axis=1) for row in (
        (c, -s, zero), (s, c, zero), (zero, zero, one))], axis=1)
    return np.asarray((turn * h[:, None] ** -2.0) @ turn.swapaxes(1, 2))


def cut_cube() -> Mesh:
    """The unit cube without the cylinder of radius .5 around an edge, as a bent grid."""
    grid = MeshTet.init_tensor(np.linspace(0, 1, 6), np.linspace(0, 1, 17), np.linspace(0, 1, 11))
    s, t, z = grid.p
    angle = 0.5 * np.pi * t
    arc = np.stack([np.cos(angle), np.sin(angle)])
    x, y = (0.5 * (1.0 - s) + s / np.abs(arc).max(axis=0)) * arc
    return np.stack([x, y, z], axis=1), grid.t.T.astype(np.int32)


def cube() -> Mesh:
    """The unit cube."""
    grid = MeshTet.init_tensor(*[np.linspace(0.0, 1.0, 12)] * 3)
    return grid.p.T.copy(), grid.t.T.astype(np.int32)


CASES: dict[str, tuple[Callable[[], Mesh], Callable[[FloatArray], FloatArray]]] = {
    "cube, linear": (cube, linear),
    "cube-cylinder, polar 1": (cut_cube, partial(polar, fine=False)),
    "cube-cylinder, polar 2": (cut_cube, partial(polar, fine=True)),
}
"""Meshes and metrics."""


def matched(say: Say) -> Table:
    """How well meshes match the metrics of CASES after as many rounds."""
    rows: list[tuple[Value, ...]] = []
    for name, (make, metric) in CASES.items():
        mesh, clock = make(), time.perf_counter()
        for _ in range(ROUNDS):
            mesh = odt_plugins.remesh(mesh, metric=metric)
        seconds = time.perf_counter() - clock
        points, cells = mesh
        i, j = np.triu_indices(3)
        logs = 0.5 * logarithm(metric(points))[:, i, j]
        length = lengths_of(points, unique_edges(cells), logs)
        found = summarize(*as_seen(points, cells, logs))
        share = float(((length > 0.71) & (length < 1.41)).mean())
        rows.append((name, len(np.unique(cells)), len(cells), share, found.mean_quality,
                     found.min_quality, seconds))
        say(" ".join(map(str, rows[-1])))
    return Table("benchmark", f"Edges and cells in a metric, finest {FINEST:g}", MATCHED, rows)
