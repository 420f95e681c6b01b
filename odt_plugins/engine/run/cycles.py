"""Stage 1 and stage 2 in cycles, the worst cells after them; or stage 2 alone."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from odt_plugins.engine.cells.extremes import Bounds, Extremes
from odt_plugins.engine.finish.phases import (
    WORST,
    Phase,
    bulk,
    cautious,
    descents,
    moves_alone,
    repair,
    tail,
    without_flips,
)
from odt_plugins.engine.finish.polishing import Settle, polish_small_angles
from odt_plugins.engine.finish.volume import finish, held_angles
from odt_plugins.engine.odt.density import Density
from odt_plugins.engine.odt.rounds import Log, smooth
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import Figures, figures
from odt_plugins.engine.record.memory import Memory, State
from odt_plugins.engine.run.within import Within
from odt_plugins.engine.topology.complex import Complex, make_complex
from odt_plugins.engine.topology.part import Part, around, away_from, inside, joined
from odt_plugins.engine.topology.triangles import Triangles
from odt_plugins.mesh.chunks import Pool
from odt_plugins.options import Options
from odt_plugins.progress import part, silent


def extremes(before: Figures, keep: tuple[str, ...]) -> Bounds:
    """Extremes that no new cell may pass: those of the input, where they are to be kept."""
    quality = float(before.min_quality) if "min_quality" in keep else 0.0
    large = float(before.cos_min_angle) if "min_angle" in keep else 1.0
    small = float(before.cos_max_angle) if "max_angle" in keep else -1.0
    low, high = (math.cos(math.radians(angle)) for angle in POLICY.locked_angles)
    locked = Extremes(POLICY.locked_quality, min(large, low), max(small, high))
    return Bounds(Extremes(quality, large, small), locked)


def settled(means: Sequence[float]) -> str:
    """Why no cycle follows those that ended with these mean qualities; empty when one may."""
    if len(means) < 2 or means[-1] - max(means[:-1]) >= POLICY.cycle_worth:
        return ""
    return f"the mean quality settled after {len(means)} cycles"


def alternate(
    smooth: Callable[[Callable[[float], None]], str], finish: Callable[[], None],
    mean_quality: Callable[[], float], options: Options, log: Log,
) -> str:
    """Alternate stage 1 and the phases of stage 2 for the mean; without finishing, stage 1 once.

    Parameters
    ----------
    smooth : callable          runs stage 1, tells what it is given the share that is done, and
                               returns why it stopped
    finish : callable          runs the phases
    mean_quality : callable    of the mesh as it is; asked after every cycle of several
    options : Options
    log : Log                  takes the times

    Returns
    -------
    str                        why it stopped
    """
    report = options.progress if options.progress is not None else silent
    cycles = options.cycles if options.finish else 1
    reason = "nothing was asked for"
    means: list[float] = []
    for cycle in range(cycles):
        clock = time.perf_counter()
        half = part(report, cycle / cycles, (cycle + 0.5) / cycles)
        reason = smooth(partial(half, "smoothing"))
        log.add_time("smoothing", time.perf_counter() - clock)
        if not options.finish:
            continue
        clock = time.perf_counter()
        finish()
        report("finishing", (cycle + 1) / cycles)
        if cycles > 1:
            means.append(mean_quality())
        log.add_time("finishing", time.perf_counter() - clock)
        if end := settled(means):
            return end
    return reason


def repaired(
    steps: Sequence[tuple[Phase, ...]], settle: Callable[[tuple[Phase, ...]], None],
    offer: Callable[[], bool], log: Log,
) -> bool:
    """Run steps of phases that bring a mesh back within what the input had, until one does.

    Parameters
    ----------
    settle : callable    runs phases on a mesh
    offer : callable     shows the mesh to the memory; says whether it was taken
    """
    for phases in steps:
        log.add("repairs", 1)
        settle(phases)
        if offer():
            return True
    return False


def run_cycles(
    mesh: Complex, density: Density, options: Options, bounds: Bounds, memory: Memory,
    log: Log, pool: Pool | None, within: Within,
) -> str:
    """Alternate the two stages, then look after the worst cells; returns why stage 1 stopped."""
    limits = bounds
    if not options.finish and "p1_quality" in options.keep:
        limits = bounds.with_quality(memory.before.p1_quality)
    watch = None if options.finish else partial(memory.offer, name="smoothing")
    work_on = partial(settle, log=log, pool=pool, threads=options.threads, part=within.part)
    some = None if within.fresh is None else around(mesh, within.fresh)
    work = some.inside if some else mesh

    def stage1(tick: Callable[[float], None]) -> str:
        nonlocal work
        work, reason = smooth(work, density, options, limits, log, tick, watch, pool)
        return reason

    reason = "no vertex is new"
    if some or within.fresh is None:
        reason = alternate(
            stage1, lambda: work_on(work, bulk(work.dim, options.objective), bounds),
            lambda: figures(work.points, work.mesh_arrays()[0], pool=pool).mean_quality,
            options, log,
        )
        mesh = joined(replace(some, inside=work)) if some else work
    if options.finish:
        clock = time.perf_counter()
        _worst_cells(mesh, options, bounds, memory, log, pool, within)
        log.add_time("finishing", time.perf_counter() - clock)
    (options.progress or silent)("finishing", 1.0)
    return reason


def _worst_cells(
    mesh: Complex, options: Options, bounds: Bounds, memory: Memory, log: Log,
    pool: Pool | None, within: Within,
) -> None:
    """The phases of stage 2 that follow the bulk; good states go to the memory."""
    work_on = partial(settle, log=log, pool=pool, threads=options.threads, part=within.part)
    state: Complex | Part = mesh
    near = within.cut
    for descent in descents(mesh.dim, options.objective):
        if near is not None:
            state = away_from(state, near) or joined(state)
        work = inside(state)
        limits = bounds if descent.hold is None else held_angles(work, bounds, descent.hold, pool)
        work_on(work, descent.phases, limits)
        if memory.offer(state, "finished") or mesh.dim == 2:
            continue
        edge = None if near is None else around(state, near)
        if edge is not None and _repair(edge, limits, memory, log, work_on):
            state = edge
        else:
            state = joined(edge or state)
            _repair(state, limits, memory, log, work_on)
    polish_small_angles(state, bounds, memory, "finished", work_on, pool, near)
    mesh = mesh if memory.states else joined(state)
    if not memory.states and options.objective != "radius_ratio":
        work_on(mesh, tail(mesh.dim), bounds)
        memory.offer(mesh, "finished")
    if not memory.states and mesh.dim == 2:
        from odt_plugins.engine.finish.repair2d import within_bounds

        log.add("repairs", 1)
        plane = Triangles(mesh.points, mesh.cells, mesh.neighbors, mesh.regions)
        if within_bounds(plane, ~mesh.locked, bounds.cells, flips=log.flips):
            memory.offer(mesh, "repaired")
            work_on(mesh, bulk(2), bounds)
            memory.offer(mesh, "finished")
    elif not memory.states and memory.nearest:
        _bring_back(mesh, memory.nearest, bounds, memory, log, work_on, pool)


def _bring_back(
    mesh: Complex, state: State, bounds: Bounds, memory: Memory, log: Log, work_on: Settle,
    pool: Pool | None,
) -> None:
    """Bring the few cells of a state that are beyond the extremes of the input back on their own.

    What lies around them gives way in between, where that does not help by compound moves.
    """
    from odt_plugins.engine.finish.repair3d import lacking, within_bounds

    beyond = state.cells[lacking(state.points, state.cells, bounds.cells) > 0.0]
    if not 0 < len(beyond) <= POLICY.beyond:
        return
    near = np.zeros(len(state.points), dtype=np.bool_)
    near[beyond] = True
    whole = make_complex(
        state.points.copy(), state.cells, state.regions, mesh.locked, mesh.boundary
    )
    zone = around(whole, near, POLICY.beyond_rings) or whole
    work = inside(zone)
    before, stuck = math.inf, False
    for _ in range(POLICY.beyond_turns):
        log.add("repairs", 1)
        now = within_bounds(work.points, work.mesh_arrays()[0], ~work.locked, bounds.cells)
        was, stuck = stuck, now > 0.95 * before
        if now == 0.0 or (was and stuck):
            break
        before = now
        work_on(work, cautious(3)[2:] if stuck else bulk(3, memory.objective), bounds)
    if memory.offer(zone, "repaired"):
        polish_small_angles(joined(zone), bounds, memory, "finished", work_on, pool)


def finish_alone(
    mesh: Complex, options: Options, bounds: Bounds, memory: Memory, name: str, work_on: Settle,
    pool: Pool | None, *, flips: bool,
) -> None:
    """Improve the input by stage 2 alone, which never leaves the extremes of the input.

    New cells are also held to a multiple of the 1 % quantile, or that figure of a mesh full of
    flat cells falls as soon as the number of cells does. Where it falls all the same, the worst
    cells are taken first and the mean is regained. Without ``flips`` vertices alone move until
    small angles are polished.
    """
    enough = min(POLICY.locked_quality, 100.0 * memory.before.p1_quality)
    strict = bounds.with_quality(max(bounds.cells.quality, enough))
    schedule = (*cautious(mesh.dim, options.objective), WORST)
    *phases, worst = schedule if flips else map(moves_alone, schedule)
    for phase in (phases[0], *phases):
        work_on(mesh, (phase,), strict)
        if memory.offer(mesh, name) or "mean_quality" in memory.worse:
            continue
        work_on(mesh, (worst,), strict)
        memory.offer(mesh, name)
    polish_small_angles(mesh, bounds, memory, name, work_on, pool)


def settle(
    mesh: Complex, phases: tuple[Phase, ...], bounds: Bounds, log: Log,
    pool: Pool | None, threads: int, part: float,
) -> None:
    """Run phases of stage 2 that are not left out, and count.

    A guard is a share of the cells divided by ``part``, see :class:`Within`.
    """
    phases = tuple(
        replace(phase, guard=min(1.0, phase.guard / part)) if phase.guard else phase
        for phase in phases if phase.name not in log.without
    )
    if not log.flips:
        phases = tuple(map(without_flips, phases))
    flips, moves = finish(mesh, phases, bounds, pool, threads)
    log.add("quality flips", flips)
    log.add("vertex moves", moves)


def _repair(
    mesh: Complex | Part, bounds: Bounds, memory: Memory, log: Log, work_on: Settle
) -> bool:
    """Bring the few cells of a good mesh that pass an extreme of the input back; says whether."""
    small = memory.refused.figures.small_angles if memory.refused else 0.0
    return repaired(
        repair(memory.worse, small), lambda phases: work_on(inside(mesh), phases, bounds),
        lambda: memory.offer(mesh, "repaired"), log,
    )
