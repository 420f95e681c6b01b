"""The robustness report: default runs over hard meshes, and whether the promise holds on each."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from measure.hard import HardMesh, hard_meshes
from odt_plugins.api import optimize_with_report
from odt_plugins.compare.start import stored
from odt_plugins.compare.table import Say, Table, as_text, shown
from odt_plugins.errors import writing
from odt_plugins.figures import summarize
from odt_plugins.generate.clouds import SEED
from odt_plugins.mesh.simplex import simplex_mesh
from odt_plugins.promise.volume import broken_promises
from odt_plugins.report.machine import describe

FILE = "hard.json"

SIZE = 3000
"""Vertices of the meshes that are made, about."""

SHOWN = ("min_quality", "p1_quality", "mean_quality", "min_angle", "max_angle")

HEADS = ("mesh", "cells", "least q", "1 % q", "mean q", "smallest angle", "largest", "seconds",
         "promise")


def run_hard(out: Path, threads: int, say: Say, size: int = SIZE) -> str:
    """Optimise every hard mesh, write FILE into `out`, and give the table as text.

    Parameters
    ----------
    out : Path        is made
    threads : int
    say : callable    is told the name of every mesh
    size : int        vertices of a mesh that is made, about

    Raises
    ------
    MeshFileError     `out` cannot be written to
    """
    rows = []
    for mesh in _meshes(size):
        say(mesh.name)
        rows.append(judge(mesh, threads))
    kept = sum(row["broken"] == [] for row in rows)
    better = sum(row["after"]["mean_quality"] > row["before"]["mean_quality"] for row in rows)
    table = Table(
        "hard", "Hard meshes, default options: before -> after", HEADS, [_line(r) for r in rows],
        [f"promise kept on {kept} of {len(rows)}, better mean on {better}"],
    )
    values = {"machine": describe(threads, SEED), "meshes": rows}
    with writing(f"into {out}", "another --out"):
        out.mkdir(parents=True, exist_ok=True)
        (out / FILE).write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
    return "\n".join(as_text(table))


def judge(hard: HardMesh, threads: int = 1) -> dict[str, Any]:
    """Optimise one mesh and hold the result against the promise.

    Returns
    -------
    dict    name, figures before and after, the broken sentences of the promise (none when it
            holds), whether the input came back, what the report says, seconds
    """
    mesh = simplex_mesh(hard.points, hard.cells, regions=hard.regions)[0]
    clock = time.perf_counter()
    (points, cells, regions), report = optimize_with_report(
        (mesh.points, mesh.cells, mesh.regions), threads=threads
    )
    seconds = time.perf_counter() - clock
    same = np.array_equal(points, mesh.points) and np.array_equal(cells, mesh.cells)
    return {
        "name": hard.name,
        "before": summarize(mesh.points, mesh.cells).to_dict(),
        "after": summarize(points, cells).to_dict(),
        "broken": broken_promises(mesh, points, cells, regions),
        "unchanged": same,
        "fallback": report.fallback,
        "seconds": seconds,
    }


def _meshes(size: int) -> Iterator[HardMesh]:
    for name in ("bunny", "bone", "cgal-bunny"):
        start = stored(name)
        yield HardMesh(name, start.points, start.cells)
    yield from hard_meshes(size)


def _line(row: dict[str, Any]) -> tuple[str | int | float, ...]:
    before, after = row["before"], row["after"]
    figures = [f"{shown(before[name])} -> {shown(after[name])}" for name in SHOWN]
    verdict = "; ".join(row["broken"]) or ("kept, unchanged" if row["unchanged"] else "kept")
    return row["name"], before["n_cells"], *figures, row["seconds"], verdict
