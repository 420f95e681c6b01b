"""One piece against blocks: time, memory of every process, bytes moved in every round, quality."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from measure.meshes import ball_of
from measure.part import Part
from measure.stages import LIMIT
from odt_plugins.compare.contestants import Contestant
from odt_plugins.compare.runner import Limits, run_contestant
from odt_plugins.compare.start import StartMesh
from odt_plugins.compare.table import Say, Table, Value
from odt_plugins.figures import summarize

BLOCKS, ROUNDS = 4, 3

WAYS = (("one piece", 0, 0), (f"up to {BLOCKS} blocks, this process", BLOCKS, 0),
        (f"up to {BLOCKS} blocks, 1 worker", BLOCKS, 1),
        (f"up to {BLOCKS} blocks, 2 workers", BLOCKS, 2))
"""Name, number of blocks, and number of worker processes."""

HEADS = ("cells", "how", "wall [s]", "processor [s]", "to one piece", "driver [MB]", "worker [MB]",
         "mean q", "1 % q", "min q", "bits")

TRAFFIC = ("cells", "round", "blocks", "cells in them", "sent [MB]", "received [MB]",
           "bytes a cell of the mesh")


def blocks_part(sizes: Sequence[int], threads: int, say: Say) -> Part:
    """Compare one piece with blocks on random balls of tetrahedra.

    Parameters
    ----------
    sizes : ints      about so many cells
    threads : int     of every process
    say : callable    is told what is measured
    """
    rows: list[tuple[Value, ...]] = []
    moved: list[tuple[Value, ...]] = []
    for size in sizes:
        start = ball_of(size)
        one = expected = None
        for name, blocks, workers in WAYS:
            mesh, facts = _run(start, blocks, workers, threads, say)
            if mesh is None:
                continue
            cpu = facts["cpu"] + facts["workers cpu"]
            one = cpu if blocks == 0 else one
            if blocks and expected is None:
                expected = mesh
                moved += _traffic(len(start.cells), facts)
            q = summarize(*mesh)
            rows.append((len(start.cells), name, facts["seconds"], cpu,
                         "" if one is None else f"{cpu / one:.2f}", facts["peak"] / 1e6,
                         facts.get("workers peak", 0.0) / 1e6 or "", f"{q.mean_quality:.4f}",
                         f"{q.p1_quality:.4f}", f"{q.min_quality:.3f}",
                         _same(expected, mesh) if blocks else ""))
            say(f"{rows[-1][0]} cells, {name}: {facts['seconds']:.1f} s, processor {cpu:.1f} s")
    notes = ("processor: driver and workers together, starting the workers included; worker: "
             "the largest resident size of one, where the mesh is worth one",)
    return Part([Table("blocks", "One piece against blocks", HEADS, rows, notes),
                 Table("traffic", "What the blocks of a round move", TRAFFIC, moved)])


def _run(
    start: StartMesh, blocks: int, workers: int, threads: int, say: Say
) -> tuple[Any, dict[str, float]]:
    settings = {"blocks": blocks, "workers": workers}
    way = Contestant("blocks", "odt-plugins", ("tets",), "measure.partitioned", settings,
                     package="odt-plugins")
    run = run_contestant(start, way, Limits(LIMIT, 1, LIMIT, threads))
    if run.status != "ok":
        say(f"{len(start.cells)} cells, {blocks} blocks: {run.status}, {run.message}")
        return None, {}
    return run.meshes[0], {**run.facts["details"], "peak": run.facts["peak"]}


def _traffic(cells: int, facts: dict[str, float]) -> list[tuple[Value, ...]]:
    rows: list[tuple[Value, ...]] = []
    for index in range(1, ROUNDS + 1):
        found = [facts.get(f"round {index} {what}") for what in
                 ("blocks", "cells", "bytes sent", "bytes received")]
        if None in found:
            continue
        blocks, inside, sent, received = (float(x or 0.0) for x in found)
        rows.append((cells, index, int(blocks), int(inside), sent / 1e6, received / 1e6,
                     (sent + received) / cells))
    return rows


def _same(a: Any, b: Any) -> str:
    same = all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))
    return "the same" if same else "DIFFERENT"
