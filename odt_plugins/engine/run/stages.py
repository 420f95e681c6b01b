"""Stages of a run: cycles, the worst cells after them, finishing alone, insertion."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from odt_plugins.engine.cells.extremes import Bounds
from odt_plugins.engine.finish.phases import (
    WORST,
    Phase,
    bulk,
    cautious,
    descents,
    moves_alone,
    repair,
    tail,
)
from odt_plugins.engine.finish.polishing import polish_small_angles
from odt_plugins.engine.finish.volume import held_angles
from odt_plugins.engine.moves.passes import more_cells
from odt_plugins.engine.odt.rounds import Log, smooth
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import COS_SMALL, Figures, figures
from odt_plugins.engine.record.memory import State
from odt_plugins.engine.run.work import Work, extremes
from odt_plugins.engine.topology.complex import Complex, make_complex
from odt_plugins.engine.topology.part import Part, around, away_from, inside, joined
from odt_plugins.engine.topology.triangles import Triangles
from odt_plugins.objectives import AIMS
from odt_plugins.options import Options
from odt_plugins.progress import part, silent


def settled(means: Sequence[float]) -> str:
    """Reason to stop after cycles with these mean qualities; "" to go on."""
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
    cycles = options.smoothing.cycles if options.finish else 1
    reason = "nothing was asked for"
    means: list[float] = []
    for cycle in range(cycles):
        half = part(report, cycle / cycles, (cycle + 0.5) / cycles)
        with log.timed("smoothing"):
            reason = smooth(partial(half, "smoothing"))
        if not options.finish:
            continue
        with log.timed("finishing"):
            finish()
            report("finishing", (cycle + 1) / cycles)
            if cycles > 1:
                means.append(mean_quality())
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


def in_cycles(mesh: Complex, work: Work) -> tuple[Complex, str]:
    """Alternate stage 1 and the bulk of stage 2; the mesh then, and why stage 1 stopped.

    Where some vertices are fresh, only the cells around these take part.
    """
    options, within, pool = work.options, work.within, work.pool
    limits = work.bounds
    if not options.finish and "p1_quality" in options.keep:
        limits = limits.with_quality(work.memory.before.p1_quality)
    watch = None if options.finish else partial(work.memory.offer, name="smoothing")
    some = None if within.fresh is None else around(mesh, within.fresh)
    if within.fresh is not None and not some:
        return mesh, "no vertex is new"
    slots = some.inside if some else mesh

    def stage1(tick: Callable[[float], None]) -> str:
        nonlocal slots
        slots, reason = smooth(slots, work.density, options, limits, work.log, tick, watch, pool)
        return reason

    reason = alternate(
        stage1,
        lambda: work.settle(slots, bulk(slots.dim, options.objective), work.bounds),
        lambda: figures(slots.points, slots.mesh_arrays()[0], pool=pool).mean_quality,
        options, work.log,
    )
    return joined(replace(some, inside=slots)) if some else slots, reason


def worst_cells(mesh: Complex, work: Work) -> None:
    """The phases of stage 2 that follow the bulk; good states go to the memory."""
    bounds, memory, log, pool = work.bounds, work.memory, work.log, work.pool
    objective = work.options.objective
    state: Complex | Part = mesh
    near = work.within.cut
    for descent in descents(mesh.dim, objective):
        if near is not None:
            state = away_from(state, near) or joined(state)
        slots = inside(state)
        limits = bounds if descent.hold is None else held_angles(slots, bounds, descent.hold, pool)
        work.settle(slots, descent.phases, limits)
        if memory.offer(state, "finished") or mesh.dim == 2:
            continue
        edge = None if near is None else around(state, near)
        if edge is not None and _repair(edge, limits, work):
            state = edge
        else:
            state = joined(edge or state)
            _repair(state, limits, work)
    polish_small_angles(state, bounds, memory, "finished", work.settle, pool, near)
    mesh = mesh if memory.states else joined(state)
    if not memory.states and not AIMS[objective].by_ratios:
        work.settle(mesh, tail(mesh.dim), bounds)
        memory.offer(mesh, "finished")
    if not memory.states and mesh.dim == 2:
        from odt_plugins.engine.finish.repair2d import within_bounds

        log.add("repairs", 1)
        plane = Triangles(mesh.points, mesh.cells, mesh.neighbors, mesh.regions)
        if within_bounds(plane, ~mesh.locked, bounds.cells, flips=log.flips):
            memory.offer(mesh, "repaired")
            work.settle(mesh, bulk(2), bounds)
            memory.offer(mesh, "finished")
    elif not memory.states and memory.nearest:
        _bring_back(mesh, memory.nearest, work)


def _bring_back(mesh: Complex, state: State, work: Work) -> None:
    """Bring the few cells of a state that are beyond the extremes of the input back on their own.

    What lies around them gives way in between, where that does not help by compound moves.
    """
    from odt_plugins.engine.finish.repair3d import lacking, within_bounds

    bounds, memory = work.bounds, work.memory
    beyond = state.cells[lacking(state.points, state.cells, bounds.cells) > 0.0]
    if not 0 < len(beyond) <= POLICY.beyond:
        return
    near = np.zeros(len(state.points), dtype=np.bool_)
    near[beyond] = True
    whole = make_complex(
        state.points.copy(), state.cells, state.regions, mesh.locked, mesh.boundary
    )
    zone = around(whole, near, POLICY.beyond_rings) or whole
    slots = inside(zone)
    before, stuck = math.inf, False
    for _ in range(POLICY.beyond_turns):
        work.log.add("repairs", 1)
        now = within_bounds(slots.points, slots.mesh_arrays()[0], ~slots.locked, bounds.cells)
        was, stuck = stuck, now > 0.95 * before
        if now == 0.0 or (was and stuck):
            break
        before = now
        work.settle(slots, cautious(3)[2:] if stuck else bulk(3, memory.objective), bounds)
    if memory.offer(zone, "repaired"):
        polish_small_angles(joined(zone), bounds, memory, "finished", work.settle, work.pool)


def fill_up(work: Work) -> None:
    """Give the last refused state as many cells as the input has, and improve it by moves alone.

    Where poor cells stay, they are a larger share of fewer cells, and the 1 % quantile falls
    though no cell is worse.
    """
    bounds, memory = work.bounds, work.memory
    state = memory.refused
    if state is None or not set(memory.worse) <= {"p1_quality", "share_below_20"}:
        return
    mesh = make_complex(
        state.points.copy(), state.cells, state.regions, work.locked, work.boundary)
    few = 2.0 * memory.whole.p1_quality
    good, fair = (bounds.with_quality(max(bounds.cells.quality, least)) for least in (
        POLICY.locked_quality, min(POLICY.locked_quality, few)))
    good = good.with_large(COS_SMALL)
    for limits in (good, good, fair):
        missing = len(work.start.cells) - mesh.count()
        if missing <= 0:
            break
        work.log.add("flips for more cells", more_cells(mesh, missing, limits))
        work.settle(mesh, tuple(map(moves_alone, bulk(3, memory.objective))), bounds)
        memory.offer(mesh, "finished")


def finish_alone(mesh: Complex, work: Work, name: str, *, flips: bool) -> None:
    """Improve the input by stage 2 alone, which never leaves the extremes of the input.

    New cells are also held to a multiple of the 1 % quantile, or that figure of a mesh full of
    flat cells falls as soon as the number of cells does. Where it falls all the same, the worst
    cells are taken first and the mean is regained. Without ``flips`` vertices alone move until
    small angles are polished.
    """
    bounds, memory = work.bounds, work.memory
    enough = min(POLICY.locked_quality, 100.0 * memory.before.p1_quality)
    strict = bounds.with_quality(max(bounds.cells.quality, enough))
    schedule = (*cautious(mesh.dim, work.options.objective), WORST)
    *phases, worst = schedule if flips else map(moves_alone, schedule)
    for phase in (phases[0], *phases):
        work.settle(mesh, (phase,), strict)
        if memory.offer(mesh, name) or "mean_quality" in memory.worse:
            continue
        work.settle(mesh, (worst,), strict)
        memory.offer(mesh, name)
    polish_small_angles(mesh, bounds, memory, name, work.settle, work.pool)


def insert(work: Work, share: float) -> None:
    """Add and remove vertices of the best state so far, or of the input.

    Of the progress ``share`` is over.
    """
    from odt_plugins.engine.finish.resampling import resample_in_rounds, with_spare_vertices

    start, options, memory = work.start, work.options, work.memory
    best = (memory.states or
            [State(start.points, start.cells, start.regions, work.before, "input")])[0]
    spare = with_spare_vertices(
        best.points, best.cells, best.regions, work.locked, work.boundary,
        start.mesh.anchored[start.frame.vertices], options.insert,
    )
    resample_in_rounds(
        spare, best.figures, options.objective,
        limits=partial(held_by_insertion, options, work.before),
        settle=work.settle,
        offer=partial(memory.offer, name="resampled"),
        report=partial(part(options.progress or silent, share, 1.0), "inserting"),
        log=work.log,
    )


def held_by_insertion(options: Options, before: Figures, now: Figures) -> Bounds:
    """Bounds of insertion: the extremes of now, but for angles' sake the input's quality."""
    bounds = extremes(now, tuple(options.keep))
    if not AIMS[options.objective].by_angles:
        return bounds
    return bounds.with_quality(extremes(before, tuple(options.keep)).cells.quality)


def _repair(mesh: Complex | Part, bounds: Bounds, work: Work) -> bool:
    """Bring the few cells of a good mesh that pass an extreme of the input back; says whether."""
    memory = work.memory
    small = memory.refused.figures.small_angles if memory.refused else 0.0
    return repaired(
        repair(memory.worse, small), lambda phases: work.settle(inside(mesh), phases, bounds),
        lambda: memory.offer(mesh, "repaired"), work.log,
    )
