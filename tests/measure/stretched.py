"""What is left of the shape of meshes that are stretched on purpose: ``metric="input"``."""

from __future__ import annotations

import time

import numpy as np
from skfem import MeshTet, MeshTri

import odt_plugins
from odt_plugins.compare.table import Say, Table, Value
from odt_plugins.engine.cells.tensors import eigenvalues
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.metric.implied import implied_metric

STRETCHED = ("test", "cells", "q", "least q", "ratio of lengths", "ratio of ratios",
             "degrees turned", "s")

THICKER = 1.25
"""Thickness of a layer over that of the one below it."""

SHAKEN = 0.15
"""Largest displacement of a vertex along every axis of its metric, in units of it."""


def layered(d: int) -> tuple[FloatArray, IntArray]:
    """Layers on a wavy wall, on the unit square or cube, with shaken vertices."""
    axis = np.linspace(0.0, 1.0, {2: 25, 3: 14}[d])
    height = (THICKER ** np.arange(len(axis) + 8) - 1.0) / (THICKER ** (len(axis) + 7) - 1.0)
    grid = (MeshTri if d == 2 else MeshTet).init_tensor(*[axis] * (d - 1), height)
    points, cells = grid.p.T.copy(), grid.t.T.astype(np.int32)
    values, axes = eigenvalues(implied_metric(points, cells))
    step = np.random.default_rng(5).uniform(-SHAKEN, SHAKEN, points.shape) / np.sqrt(values)
    inside = ((points > 0.0) & (points < 1.0)).all(axis=1)
    points[inside] += (axes * step[:, None, :]).sum(axis=2)[inside]
    points[:, -1] += 0.1 * np.sin(3.0 * points[:, 0])
    return points, cells


def stretched(say: Say, dims: tuple[int, ...] = (2, 3)) -> Table:
    """Quality in their own metric, ratios of lengths and directions, before and after."""
    rows: list[tuple[Value, ...]] = []
    for d in dims:
        for boundary in ("fixed", "slide"):
            mesh, clock = layered(d), time.perf_counter()
            found, report = odt_plugins.optimize_with_report(
                mesh, metric="input", boundary=boundary, free="periodic")
            seconds = time.perf_counter() - clock
            shapes = [eigenvalues(implied_metric(*m)) for m in (mesh, found)]
            ratios = [np.sqrt(values.max(axis=1) / values.min(axis=1)) for values, _ in shapes]
            short = [np.take_along_axis(axes, values.argmax(axis=1)[:, None, None], axis=2)[..., 0]
                     for values, axes in shapes]
            cosine = np.clip(np.abs((short[0] * short[1]).sum(axis=1)), 0.0, 1.0)
            turned = np.degrees(np.arccos(cosine))[ratios[0] > 2.0]
            a, b = report.before, report.after
            rows.append((f"{'plane' if d == 2 else 'space'}, {boundary}", len(mesh[1]),
                         f"{a.mean_quality:.3f} to {b.mean_quality:.3f}",
                         f"{a.min_quality:.3f} to {b.min_quality:.3f}",
                         f"{np.median(ratios[0]):.2f} to {np.median(ratios[1]):.2f}",
                         float(np.median(ratios[1] / ratios[0])), float(np.median(turned)),
                         seconds))
            say(" ".join(map(str, rows[-1])))
    return Table("stretched", "Layers in their own metric; medians", STRETCHED, rows)
