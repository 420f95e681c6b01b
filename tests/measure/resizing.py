"""How remeshing grows with the mesh: time and memory, beside optimising what came and other tools.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from measure.meshes import ball_of
from measure.stages import fit
from odt_plugins.compare.baselines.task import mean_edge
from odt_plugins.compare.contestants import OURS, Contestant, choose
from odt_plugins.compare.rows import oriented
from odt_plugins.compare.runner import Limits, Run, run_contestant
from odt_plugins.compare.sized import CONTESTANTS, ENVELOPES
from odt_plugins.compare.start import StartMesh
from odt_plugins.compare.table import Say, Table, Value

AGAINST = (OURS, "mmg3d", "CGAL tetrahedral remeshing")

LIMIT = 1800.0
"""Seconds after which a run is ended, and no larger mesh is given to its tool."""

HEADS = ("tets", "who", "tets made", "seconds", "us for each", "memory [MB]")


def resizing_table(
    sizes: Sequence[int], say: Say,
    run: Callable[[StartMesh, Contestant, Limits], Run] = run_contestant,
) -> Table:
    """Make random balls anew with edges of their mean length, each tool on one thread.

    Parameters
    ----------
    sizes : ints      about so many tetrahedra
    say : callable    is told what is measured
    run : callable    takes the place of :func:`~odt_plugins.compare.runner.run_contestant`
    """
    rows: list[tuple[Value, ...]] = []
    times: dict[str, list[tuple[int, float]]] = {}
    optimising = choose([])[0]
    chosen = [c for c in CONTESTANTS if c.name in AGAINST]
    for size in sizes:
        start = ball_of(size)
        for contestant in list(chosen):
            settings = {**contestant.settings, "size": mean_edge(start)}
            settings |= {"envelope": ENVELOPES[0]} if "envelope" in settings else {}
            jobs = [(start, replace(contestant, settings=settings), contestant.name)]
            for mesh, job, name in jobs:
                say(f"{len(start.cells)} tets: {name}")
                found = run(mesh, job, Limits(LIMIT, 1, LIMIT))
                rows.append((len(start.cells), name, *_figures(found)))
                if not found.meshes:
                    chosen.remove(contestant)
                    break
                made = oriented(mesh, *found.meshes[0][:2])[0]
                times.setdefault(name, []).append((len(made.cells), found.facts["seconds"][0]))
                if name == OURS:
                    jobs.append((made, optimising, f"{OURS}, optimize on that"))
    notes = [f"time of {name} grows with the tets made to the power {stage.exponent:.2f}"
             for name, pairs in times.items()
             if (stage := fit(name, pairs)).exponent is not None]
    return Table("resizing", "Balls made anew with edges of their mean length", HEADS, rows, notes)


def _figures(found: Run) -> tuple[Value, ...]:
    if not found.meshes:
        return found.status, "", "", ""
    facts: dict[str, Any] = found.facts
    count, seconds = len(found.meshes[0][1]), float(facts["seconds"][0])
    return count, seconds, f"{1e6 * seconds / count:.0f}", f"{facts['peak'] / 1e6:.0f}"
