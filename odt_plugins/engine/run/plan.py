"""The run, from a valid mesh to one that keeps the promise: the algorithm in one file."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from odt_plugins.engine.compiled.threads import thread_pool, worth
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.memory import State
from odt_plugins.engine.record.progress import (
    BEFORE_INSERTION,
    BEFORE_TAIL,
    BEFORE_WORST,
    until_insertion,
)
from odt_plugins.engine.run.best import ALONE, BESIDES, best_state, input_returned
from odt_plugins.engine.run.judge import cut_vertices, faults, slides, vertices_of_other_sizes
from odt_plugins.engine.run.outcome import Leaving, Outcome, as_it_is, unchanged
from odt_plugins.engine.run.retreat import run_sliding
from odt_plugins.engine.run.sizes import keeps_sizes, sizes_after
from odt_plugins.engine.run.stages import fill_up, finish_alone, in_cycles, insert, worst_cells
from odt_plugins.engine.run.within import WHOLE, Within
from odt_plugins.engine.run.work import Work, begin
from odt_plugins.engine.topology.complex import Complex
from odt_plugins.engine.topology.frame import callers_vertices
from odt_plugins.mesh.arrays import IntArray
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.options import Options
from odt_plugins.progress import silent

AS_THEY_WERE = "no smoothing towards the sizes asked for kept the promise, they stay as they were"
"""What is told where stage 2 alone kept the promise."""


def run(
    mesh: SimplexMesh, options: Options, leaving: Leaving = as_it_is, *,
    within: Within = WHOLE,
) -> Outcome:
    """Optimise a valid mesh.

    Parameters
    ----------
    mesh : SimplexMesh    tetrahedra, or triangles in the plane, whose boundary stays
    options : Options
    leaving : callable    applied to every state before it is judged
    within : Within       how the mesh lies within a larger one

    Returns
    -------
    Outcome    a mesh that keeps the promise as it leaves, at worst the input itself
    """
    if not slides(mesh, options):
        return run_once(mesh, options, leaving, within)[0]
    within = within._replace(without=frozenset(), fresh=None, part=1.0)
    once = partial(run_once, leaving=leaving, within=within)
    # sizes of a metric that a surface cannot have make a poor tail, which a fixed one has as well
    tail = within.sized is None or not len(mesh.metric)
    outcome = (once(mesh, options)[0] if within.whole is not None
               else run_sliding(mesh, options, once, tail=tail))
    (options.progress or silent)("finishing", 1.0)
    return outcome


def run_once(
    mesh: SimplexMesh, options: Options, leaving: Leaving, within: Within = WHOLE
) -> tuple[Outcome, IntArray]:
    """All stages, once; also the surface vertices at which a surface that slid is spoiled."""
    if mesh.frozen.all() or len(mesh.cells) == 0:
        return unchanged(mesh, "no cell may change"), np.zeros(0, dtype=np.int32)
    if not options.finish:
        within = within._replace(fresh=None)
    options = replace(options, threads=worth(options.threads, len(mesh.cells)))
    with thread_pool(options.threads) as pool, callers_vertices(mesh):
        work, first = begin(mesh, options, within, pool)
        reason = follow_plan(work, first)
        return _end(work, leaving, reason)


def follow_plan(work: Work, mesh: Complex) -> str:
    """Improve a mesh; good states go to the memory of the run.

    1. Cycles of stage 1, which lowers the ODT energy by moves of vertices (Section 4) and by
       connectivity (Section 3), and stage 2, which raises the mean quality.
    2. The worst cells: descents with ever higher powers, repair of what fell below the input; as
       many cells as before where fewer ones alone make a poorer mesh.
    3. Stage 2 alone on the input, where that kept nothing or the tail stays poor.
    4. Vertices are added and removed, on request, of a resized mesh where its tail stays poor.

    Parameters
    ----------
    work : Work
    mesh : Complex    the input; changed

    Returns
    -------
    str               why stage 1 stopped, and what followed
    """
    options, memory, log = work.options, work.memory, work.log
    inserts = options.insert and work.within.tail == math.inf
    share = BEFORE_INSERTION if inserts else BEFORE_TAIL
    early = cycles = work
    if options.finish:
        early = replace(work, options=until_insertion(options, share))
        cycles = replace(work, options=until_insertion(early.options, BEFORE_WORST))
    mesh, reason = in_cycles(mesh, cycles)
    if options.finish:
        with log.timed("finishing"):
            worst_cells(mesh, early)
            if mesh.dim == 3 and not memory.states and not work.slides:
                fill_up(work)
    (early.options.progress or silent)("finishing", 1.0)

    refused = not memory.states and not (work.slides and memory.spoiled().size)
    if options.finish and (refused or _may_finish_alone(work)):
        with log.timed(ALONE):
            for flips in (True, False):
                log.add(f"runs of {ALONE}", 1)
                finish_alone(work.slots(), work, ALONE if refused else BESIDES, flips=flips)
                if memory.states or (not work.slides and work.locked.all()):
                    break
        if refused and not keeps_sizes(options):
            reason += f"; {AS_THEY_WERE}"

    reached = memory.states[0].figures if memory.states else work.before
    may = options.insert and (memory.states or not work.slides)
    if may and reached.p1_quality < work.within.tail:
        with log.timed("inserting"):
            insert(work, share)
    elif not inserts:
        (options.progress or silent)("finishing", 1.0)
    return reason


def _may_finish_alone(work: Work) -> bool:
    """Whether stage 2 alone may do better than what was reached: where few vertices move, or cells
    that nothing can improve make the 1 % quantile, and their neighbours pay for them.
    """
    states = work.memory.states
    if work.slides or not (states and keeps_sizes(work.options)):
        return False
    poor = states[0].figures.p1_quality < POLICY.poor_quality
    return poor or bool((~work.locked).mean() < POLICY.few_movable)


def _end(work: Work, leaving: Leaving, reason: str) -> tuple[Outcome, IntArray]:
    """The best state that keeps the promise as it leaves, at worst the input; what is spoiled."""
    start, memory, log = work.start, work.memory, work.log
    with log.timed("check"):
        found, broken = best_state(memory, partial(_judged, work, leaving), log, reason)
        outcome = found or input_returned(start.mesh, memory, broken, reason)
        sizes = sizes_after(start.mesh, work.options, start.frame, work.density, outcome, work.pool)
    outcome = replace(outcome, times=log.times, energy=log.energy, counts=log.counts, sizes=sizes)
    if not work.slides or outcome.slid is not None:
        return outcome, np.zeros(0, dtype=np.int32)
    spoiled, more = memory.spoiled(), np.zeros(0, dtype=np.int32)
    if memory.states:
        best = memory.states[0]
        state = start.placed(best)
        more = vertices_of_other_sizes(start.mesh, state.points, state.cells, state.regions)
        spoiled = cut_vertices(start.points, start.cells, best.points, best.cells)
    spoiled = spoiled[spoiled < len(work.boundary)]
    return outcome, np.union1d(start.frame.vertices[spoiled[work.boundary[spoiled]]], more)


def _judged(work: Work, leaving: Leaving, state: State) -> tuple[Outcome, list[str]]:
    """A state as it leaves, and what it breaks of the promise; a part is left to its judge."""
    start = work.start
    outcome = start.placed(state)
    if work.within.whole is not None:
        return outcome, []
    if work.slides:
        from odt_plugins.engine.run.volumes import with_volumes

        outcome = with_volumes(start.mesh, outcome, work.options, work.within.sized or start.mesh)
    outcome = leaving(outcome)
    broken, slid = faults(
        start.mesh, outcome.points, outcome.cells, outcome.regions, work.options, outcome.origin,
        outcome.metric, partial(outcome.figures, work.options.threads),
    )
    return replace(outcome, slid=slid), broken
