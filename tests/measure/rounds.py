"""What every part of a round of resizing is worth: remeshing with one part left out at a time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from typing import Any
from unittest.mock import patch

import numpy as np

import odt_plugins
from measure.ablation import FALLING, FIGURES
from odt_plugins.compare.baselines.task import edge_lengths, mean_edge
from odt_plugins.compare.sized import ENVELOPES, FACTORS, IN
from odt_plugins.compare.start import StartMesh
from odt_plugins.compare.table import Say, Table, Value
from odt_plugins.engine.remesh import volume
from odt_plugins.figures import summarize
from odt_plugins.mesh.arrays import FloatArray, IntArray

WHOLE = ""

LEFT_OUT: dict[str, dict[str, Any]] = {
    WHOLE: {},
    "boundary flips": {"_flip": lambda _work: 0},
    "moves of the surface": {"_relax": lambda _work: 0},
    "ODT inside": {"smooth": lambda mesh, *_rest: (mesh, "")},
    "slivers": {"SLIVER": 0.0},
    "rounds after the first": {"ROUNDS": 1},
    "rounds after the third": {"ROUNDS": 3},
}
"""What stands in the place of names of ``engine.remesh.volume``."""

HEADS = ("left out", "runs", "mean q", "1 % q", "least q", "smallest angle", "largest angle",
         "cells < 20", "in", "CPU [%]")

TURNS = 2
"""Runs of each; the quicker ones count."""


def rounds_table(
    starts: Sequence[StartMesh], say: Say, factors: Sequence[float] = FACTORS,
    remesh: Callable[..., tuple[FloatArray, IntArray]] = odt_plugins.remesh,
) -> Table:
    """Make meshes of tetrahedra anew, whole and with each part left out in turn.

    Parameters
    ----------
    starts : meshes      of tetrahedra
    say : callable       is told the name of every mesh
    factors : floats     lengths of edges, in units of their mean
    remesh : callable    takes the place of :func:`odt_plugins.remesh`

    Returns
    -------
    Table                what each gains, summed over all runs, positive is better: figures, the
                         share of edges near their length in percent, and its part of the time
    """
    gains = {name: np.zeros(len(FIGURES) + 2) for name in LEFT_OUT}
    better = np.append(FALLING, [1.0, -1.0])
    for start in starts:
        for factor in factors:
            say(f"{start.name}, h x{factor:g}")
            found = {name: _figures(start, factor * mean_edge(start), parts, remesh)
                     for name, parts in LEFT_OUT.items()}
            for name, figures in found.items():
                gains[name] += better * (found[WHOLE] - figures if name else figures)
    whole = -float(gains.pop(WHOLE)[-1])
    rows: list[tuple[Value, ...]] = []
    for name, gain in gains.items():
        *figures, small, near, seconds = gain.tolist()
        rows.append((name, len(starts) * len(factors), *(f"{x:+.3f}" for x in figures[:3]),
                     *(f"{x:+.1f}" for x in figures[3:]), f"{small:+.0f}", f"{near:+.1f}",
                     f"{-100.0 * seconds / whole:+.0f}"))
    title = "What every part of resizing gains, summed; positive is better"
    return Table("rounds", title, HEADS, rows)


def _figures(
    start: StartMesh, size: float, parts: dict[str, Any],
    remesh: Callable[..., tuple[FloatArray, IntArray]],
) -> FloatArray:
    """Figures of a run without some parts, the share of edges near their length, and seconds."""
    seconds = math.inf
    with ExitStack() as stack:
        for name, value in parts.items():
            stack.enter_context(patch.object(volume, name, value))
        for _ in range(TURNS):
            clock = time.process_time()
            points, cells = remesh((start.points, start.cells), size, envelope=ENVELOPES[0])
            seconds = min(seconds, time.process_time() - clock)
    summary = summarize(points, cells)
    ratio = edge_lengths(points, cells) / size
    near = 100.0 * float(((ratio > IN[0]) & (ratio < IN[1])).mean())
    return np.array([*(getattr(summary, name) for name in FIGURES), near, seconds])
