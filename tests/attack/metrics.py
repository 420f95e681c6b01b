"""Random small meshes in random metrics: what is optimised or made anew keeps the promise."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import odt_plugins
from attack.judge import LOWER_IS_BETTER, SLACK, Broken, Mesh, broken, broken_by_sizes
from attack.meshes import curved, same
from attack.shapes import piece, placed, random_mesh, tilted
from odt_plugins.engine.cells.tensors import packed
from odt_plugins.options import FIGURES, Options

SECONDS = 240.0
"""No case may take longer."""

RATIO = 4.0
"""Exponent of ten of the largest ratio of lengths."""

Rng = np.random.Generator


def attack(rng: Rng, folder: Path) -> None:
    """Optimise or remesh one random mesh in a random metric and judge the result.

    Raises
    ------
    Broken    what of the promise does not hold
    """
    resized = bool(rng.random() < 0.5)
    mesh = _mesh(rng, resized=resized)
    before = Mesh(*mesh)
    options: dict[str, Any] = {"metric": random_metric(rng, mesh[0]), "free": "layers"}
    if rng.random() < 0.3:
        options["keep"] = tuple(name for name in FIGURES if rng.random() < 0.5)
    if rng.random() < 0.2:
        options["fixed"] = rng.random(len(mesh[0])) < 0.2
    if resized:
        run: Callable[..., Any] = odt_plugins.remesh_with_report
        options = {"keep": ()} | options | {
            "boundary": str(rng.choice(["slide", "fixed"])),
            "envelope": float(10.0 ** rng.uniform(-4, -1))}
        wish = {"cells": int(10.0 ** rng.uniform(0, 2.3)), "most_cells": 20_000}
    else:
        run, wish = odt_plugins.optimize_with_report, {}
    found, report = run(mesh, **wish, **options)
    after = Mesh(*found)
    judge = broken_by_sizes if resized else broken
    faults = judge(before, after, Options(**options), curved=curved(before))
    sound = not resized and report.untangled is None
    for name in Options(**options).keep if sound else ():
        was, now = getattr(report.before, name), getattr(report.after, name)
        if (now - was if name in LOWER_IS_BETTER else was - now) > SLACK * abs(was):
            faults.append(f"the report tells that {name} went from {was} to {now}")
    if rng.random() < 0.5:
        k = int(rng.integers(2, 4))
        again = Mesh(*run(mesh, **wish, **options, threads=k)[0])
        faults += [f"the result is another one for {k} threads"] * (not same(after, again))
    str(report), report.to_json()
    if faults:
        raise Broken(faults)


def _mesh(rng: Rng, *, resized: bool) -> tuple[np.ndarray, np.ndarray]:
    """A sound mesh, now and then one of those of :mod:`attack.meshes`."""
    if not resized and rng.random() < 0.2:
        return random_mesh(rng)[:2]
    kind = str(rng.choice(["plane", "space", "surface"]))
    points, cells = piece(kind, rng)
    points = placed(points, rng)
    return (tilted(points, rng) if kind == "plane" and rng.random() < 0.2 else points), cells


def random_metric(rng: Rng, points: np.ndarray) -> Any:
    """The mesh's own, or lengths in random directions: constant, linear, or anything."""
    n, d = points.shape
    style = rng.choice(["input", "constant", "linear", "random"])
    if style == "input":
        return style
    size = float(np.ptp(points[np.isfinite(points).all(axis=1)])) or 1.0
    low = points.min(axis=0)
    axes = np.linalg.qr(rng.normal(size=(n if style == "random" else 1, d, d)))[0]
    lengths = size * 10.0 ** rng.uniform(-RATIO, 0.0, (n if style == "random" else 2, d))

    def metric(x: np.ndarray) -> np.ndarray:
        h = lengths if style == "random" else lengths[:1]
        if style == "linear":
            part = np.clip((x[:, :1] - low[0]) / size, 0.0, 1.0)
            h = (1.0 - part) * lengths[:1] + part * lengths[1:]
        tensors = (axes * h[:, None] ** -2.0) @ axes.swapaxes(1, 2)
        return np.broadcast_to(0.5 * (tensors + tensors.swapaxes(1, 2)), (len(x), d, d))

    if style != "random" and rng.random() < 0.3:
        return metric
    return packed(metric(points)) if rng.random() < 0.3 else metric(points)
