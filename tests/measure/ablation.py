"""What every phase of the schedule is worth: default runs with one phase left out at a time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Container, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from odt_plugins.compare.start import StartMesh
from odt_plugins.compare.table import Say, Table, Value
from odt_plugins.engine.run.outcome import Outcome
from odt_plugins.engine.run.plan import run
from odt_plugins.engine.run.within import Within
from odt_plugins.engine.surface.driver import run_surface
from odt_plugins.figures import summarize
from odt_plugins.mesh.arrays import FloatArray
from odt_plugins.mesh.simplex import simplex_mesh
from odt_plugins.mesh.surface import surface_mesh
from odt_plugins.options import Options

SMOOTHING = "smoothing"
"""Stage 1, which is left out as a phase is."""

HEADS = ("left out", "meshes", "mean q", "1 % q", "least q", "smallest angle", "largest angle",
         "cells < 20", "CPU [%]")

FIGURES = ("mean_quality", "p1_quality", "min_quality", "min_angle", "max_angle", "below_20")

FALLING = np.array([1.0, 1.0, 1.0, 1.0, -1.0, -1.0])
"""-1 for figures that shall fall."""

TURNS = 4
"""Runs with and without a phase, in turns; the quicker ones count."""


class _Asked:
    """Leaves nothing out, and remembers in order which phases there were."""

    def __init__(self) -> None:
        self.names = {SMOOTHING: True}

    def __contains__(self, name: object) -> bool:
        self.names[str(name)] = True
        return False


def ablation(starts: Sequence[StartMesh], options: Options, say: Say) -> Table:
    """Run the schedule on every mesh, whole and with each of its phases left out in turn.

    Parameters
    ----------
    starts : sequence    meshes of one kind or of several
    options : Options
    say : callable       is told the name of every mesh

    Returns
    -------
    Table                of every phase the number of meshes on which it was run, and what it gains:
                         sums over those meshes, more is better; and its part of their processor
                         time
    """
    gains: dict[str, list[FloatArray]] = {}
    for start in starts:
        say(start.name)
        optimise = _optimiser(start)
        asked = _Asked()
        optimise(options, asked)
        for name in asked.names:
            fewer = options if name != SMOOTHING else replace(
                options, smoothing=replace(options.smoothing, rounds=0))
            whole, without = _in_turns(
                partial(optimise, options, ()), partial(optimise, fewer, (name,)))
            gain = (whole - without) * np.append(FALLING, 1.0)
            gains.setdefault(name, []).append(np.append(gain, whole[-1]))
    rows: list[tuple[Value, ...]] = []
    for name, found in gains.items():
        *figures, small, seconds, of_all = np.sum(found, axis=0).tolist()
        rows.append((name, len(found), *(f"{x:+.4f}" for x in figures[:3]),
                     *(f"{x:+.1f}" for x in figures[3:]), f"{small:+.0f}",
                     f"{100.0 * seconds / of_all:+.0f}"))
    title = "What every phase gains on the meshes where it runs, summed; positive is better"
    return Table("ablation", title, HEADS, rows)


def _optimiser(start: StartMesh) -> Callable[[Options, Container[str]], Outcome]:
    """The engine on one mesh."""
    if start.kind == "surface":
        surface = surface_mesh(start.points, start.cells, regions=start.regions)
        return lambda options, without: run_surface(surface, options, without=without)
    mesh = simplex_mesh(start.points, start.cells, regions=start.regions)[0]
    return lambda options, without: run(mesh, options, within=Within(without=without))


def _in_turns(*runs: Callable[[], Outcome]) -> list[FloatArray]:
    """Figures of what each returns and its processor seconds, the least of some turns."""
    seconds = np.full(len(runs), math.inf)
    for _ in range(TURNS):
        outcomes = []
        for k, run_once in enumerate(runs):
            clock = time.process_time()
            outcomes.append(run_once())
            seconds[k] = min(seconds[k], time.process_time() - clock)
    summaries = (summarize(outcome.points, outcome.cells) for outcome in outcomes)
    return [np.array([*(getattr(summary, name) for name in FIGURES), least])
            for summary, least in zip(summaries, seconds, strict=True)]
