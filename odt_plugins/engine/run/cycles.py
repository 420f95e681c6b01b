"""Stage 1 and stage 2 in cycles, the worst cells after them; or stage 2 alone."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np

from odt_plugins.engine.cells.extremes import Bounds, Extremes
from odt_plugins.engine.finish.phases import WORST, Phase, bulk, cautious, descents, repair, tail
from odt_plugins.engine.finish.polishing import polish_small_angles
from odt_plugins.engine.finish.repair2d import within_bounds
from odt_plugins.engine.finish.volume import finish, held_angles
from odt_plugins.engine.odt.density import Density
from odt_plugins.engine.odt.rounds import Log, smooth
from odt_plugins.engine.record.figures import Figures, figures
from odt_plugins.engine.record.memory import Memory
from odt_plugins.engine.record.progress import report_share, silent
from odt_plugins.engine.topology.complex import Complex
from odt_plugins.engine.topology.part import Part, around, away_from, inside, joined
from odt_plugins.mesh.arrays import BoolArray
from odt_plugins.options import Options

WORTH = 5e-4
"""Gain of the mean quality for which a cycle is worth its time."""

LOCKED_QUALITY = 0.3
LOCKED_ANGLES = (14.0, 157.0)
"""What a cell without a movable vertex must reach when there was none such before (d = 3)."""


def extremes(before: Figures, keep: tuple[str, ...]) -> Bounds:
    """Extremes that no new cell may pass: those of the input, where they are to be kept."""
    quality = float(before.min_quality) if "min_quality" in keep else 0.0
    large = float(before.cos_min_angle) if "min_angle" in keep else 1.0
    small = float(before.cos_max_angle) if "max_angle" in keep else -1.0
    low, high = (math.cos(math.radians(angle)) for angle in LOCKED_ANGLES)
    locked = Extremes(LOCKED_QUALITY, min(large, low), max(small, high))
    return Bounds(Extremes(quality, large, small), locked)


def settled(means: Sequence[float]) -> str:
    """Why no cycle follows those that ended with these mean qualities; empty when one may."""
    *before, now = means
    if not before or now - max(before) >= WORTH:
        return ""
    return f"the mean quality settled after {len(means)} cycles"


def run_cycles(
    mesh: Complex, density: Density, options: Options, bounds: Bounds, memory: Memory,
    log: Log, pool: ThreadPoolExecutor | None, near: BoolArray | None,
) -> str:
    """Alternate the two stages; returns why stage 1 stopped last."""
    report = options.progress if options.progress is not None else silent
    cycles = options.cycles if options.finish else 1
    reason = "nothing was asked for"
    limits = bounds
    if not options.finish and "p1_quality" in options.keep:
        limits = bounds.with_quality(memory.before.p1_quality)
    means: list[float] = []
    for cycle in range(cycles):
        clock = time.perf_counter()
        base = cycle / cycles
        watch = None if options.finish else partial(memory.offer, name="smoothing")
        mesh, reason = smooth(
            mesh, density, options, limits, log,
            partial(report_share, report, base, 0.5 / cycles), watch, pool,
        )
        log.add_time("smoothing", time.perf_counter() - clock)
        if not options.finish:
            continue
        clock = time.perf_counter()
        settle(mesh, bulk(mesh.dim, options.objective), bounds, log, pool, options.threads)
        report("finishing", (cycle + 1) / cycles)
        cells, _ = mesh.mesh_arrays()
        means.append(figures(mesh.points, cells).mean_quality)
        log.add_time("finishing", time.perf_counter() - clock)
        if end := settled(means):
            reason = end
            break
    if options.finish:
        clock = time.perf_counter()
        state: Complex | Part = mesh
        for descent in descents(mesh.dim, options.objective):
            if near is not None:
                state = away_from(state, near) or joined(state)
            work = inside(state)
            held = bounds if descent.hold is None else held_angles(work, bounds, descent.hold)
            settle(work, descent.phases, held, log, pool, options.threads)
            if memory.offer(state, "finished") or mesh.dim == 2:
                continue
            edge = None if near is None else around(state, near)
            if edge is not None and _repair(edge, held, options, memory, log, pool):
                state = edge
            else:
                state = joined(edge or state)
                _repair(state, held, options, memory, log, pool)
        work_on = partial(settle, log=log, pool=pool, threads=options.threads)
        polish_small_angles(state, bounds, memory, "finished", work_on, pool, near)
        mesh = mesh if memory.states else joined(state)
        if not memory.states and options.objective != "radius_ratio":
            settle(mesh, tail(mesh.dim), bounds, log, pool, options.threads)
            memory.offer(mesh, "finished")
        if not memory.states and mesh.dim == 2:
            log.add("repairs", 1)
            if within_bounds(mesh.points, mesh.cells, mesh.neighbors, mesh.regions, ~mesh.locked,
                             np.array(bounds.cells)):
                memory.offer(mesh, "repaired")
                settle(mesh, bulk(2), bounds, log, pool, options.threads)
                memory.offer(mesh, "finished")
        log.add_time("finishing", time.perf_counter() - clock)
    report("finishing", 1.0)
    return reason


def finish_alone(
    mesh: Complex, options: Options, bounds: Bounds, memory: Memory, name: str, log: Log,
    pool: ThreadPoolExecutor | None,
) -> None:
    """Improve the input by stage 2 alone, which never leaves the extremes of the input.

    New cells are also held to a multiple of the 1 % quantile, or that figure of a mesh full of
    flat cells falls as soon as the number of cells does. Where it falls all the same, the worst
    cells are taken first and the mean is regained.
    """
    enough = min(LOCKED_QUALITY, 100.0 * memory.before.p1_quality)
    strict = bounds.with_quality(max(bounds.cells.quality, enough))
    schedule = cautious(mesh.dim, options.objective)
    for phase in (schedule[0], *schedule):
        settle(mesh, (phase,), strict, log, pool, options.threads)
        if memory.offer(mesh, name) or "mean_quality" in memory.worse:
            continue
        settle(mesh, (WORST,), strict, log, pool, options.threads)
        memory.offer(mesh, name)
    work_on = partial(settle, log=log, pool=pool, threads=options.threads)
    polish_small_angles(mesh, bounds, memory, name, work_on, pool)


def settle(
    mesh: Complex, phases: tuple[Phase, ...], bounds: Bounds, log: Log,
    pool: ThreadPoolExecutor | None, threads: int,
) -> None:
    """Run phases of stage 2 and count."""
    flips, moves = finish(mesh, phases, bounds, pool, threads)
    log.add("quality flips", flips)
    log.add("vertex moves", moves)


def _repair(
    mesh: Complex | Part, bounds: Bounds, options: Options, memory: Memory, log: Log,
    pool: ThreadPoolExecutor | None,
) -> bool:
    """Bring the few cells of a good mesh that pass an extreme of the input back; says whether."""
    for phase in repair(memory.worse):
        log.add("repairs", 1)
        settle(inside(mesh), (phase,), bounds, log, pool, options.threads)
        if memory.offer(mesh, "repaired"):
            return True
    return False
