"""The outer loop for curved surfaces: stages, best-state memory, and the promise at the end."""

from __future__ import annotations

import math
import time
from collections.abc import Container
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from odt_plugins.engine.cells.extremes import FREELY, Extremes
from odt_plugins.engine.compiled.threads import thread_pool
from odt_plugins.engine.finish.descent import finish_phase
from odt_plugins.engine.finish.phases import Phase, bulk, tail, without_flips
from odt_plugins.engine.ground.build import earlier_ground, laid_on, make_ground, make_sheet
from odt_plugins.engine.ground.features import (
    EXACT,
    Features,
    find_features,
    label_borders,
    marked_edges,
)
from odt_plugins.engine.ground.sheet import LINE, LOCKED, Guards, Limits
from odt_plugins.engine.odt.rounds import Log
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import COS_SMALL, Figures, cell_shapes, figures
from odt_plugins.engine.record.memory import Memory, State, having
from odt_plugins.engine.record.progress import in_turn
from odt_plugins.engine.run.best import ALONE, best_state, input_returned
from odt_plugins.engine.run.outcome import Leaving, Outcome, as_it_is, unchanged
from odt_plugins.engine.run.sizes import inner_density
from odt_plugins.engine.run.stages import alternate, repaired
from odt_plugins.engine.run.work import Start, extremes, make_start
from odt_plugins.engine.surface.density import SurfaceDensity, surface_density
from odt_plugins.engine.surface.judge import Distance, Kept, faults, outside, values_on
from odt_plugins.engine.surface.mending import mended_state
from odt_plugins.engine.surface.passes import Surface, SurfaceDescent
from odt_plugins.engine.surface.rounds import check_method, smooth_surface
from odt_plugins.engine.topology.frame import Frame, callers_vertices
from odt_plugins.engine.topology.star import vertex_stars
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.seen import as_seen, in_unit
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.mesh.surface import Edges, surface_edges
from odt_plugins.objectives import AIMS, Objective
from odt_plugins.options import Options
from odt_plugins.progress import silent

COMPOUND = Phase(2.0, 1.0, 20, 2, 2, enough=0.97, name="compound")
"""The bulk once more, from where the compound moves have led."""

TAIL = (Phase(4.0, 0.05, 10, 2, name="tail 1"), Phase(8.0, 0.01, 10, 2, name="tail 2"))
"""Phases for the worst triangles; beyond p = 8 the envelope leaves them nothing to gain."""

REGAIN = Phase(0.5, 1.0, 20, 2, name="regain")
"""Phase for the mean, where phases for worse triangles cost it."""


def descents(objective: Objective) -> tuple[tuple[Phase, ...], ...]:
    """Phases that follow the bulk, one descent after another; the best of the results is taken."""
    own = () if AIMS[objective].by_ratios else (tail(2, objective),)
    return ((COMPOUND, *TAIL), *own)


REPAIR = tuple((Phase(power, 0.3, 20, 3, name="repair"),) for power in (16.0, 32.0, 64.0))
"""Phases for a surface that is good but for a few triangles beyond the input's extremes."""


@dataclass(frozen=True)
class SurfaceOutcome(Outcome):
    """What the engine hands back for a surface.

    Attributes
    ----------
    kept : Kept or None             features, envelope and vertices that stay
    distance : Distance or None     between the surfaces before and after
    """

    kept: Kept | None = None
    distance: Distance | None = None


@dataclass(frozen=True)
class SurfaceStart(Start):
    """The input of a run on a surface.

    Attributes
    ----------
    fixed : (k,) bool           vertices that the caller holds
    edges : Edges
    kept : (e,) bool            edges between regions, or that the caller marked as features
    """

    fixed: BoolArray
    edges: Edges
    kept: BoolArray


def run_surface(
    mesh: SimplexMesh, options: Options, leaving: Leaving = as_it_is, *,
    without: Container[str] = frozenset(),
) -> SurfaceOutcome:
    """Optimise a curved surface.

    Parameters
    ----------
    mesh : SimplexMesh    triangles in space, made by :func:`odt_plugins.mesh.surface.surface_mesh`
    options : Options
    leaving : callable    applied to every state before it is judged
    without : container   names of the phases of stage 2 that are left out

    Returns
    -------
    SurfaceOutcome        a surface that keeps the promise as it leaves, at worst the input itself

    Raises
    ------
    InvalidOptionError    a method or solver that surfaces do not know, or a bad density
    """
    check_method(options)
    if mesh.frozen.all():
        return _as_given(unchanged(mesh, "no triangle may change"))
    with callers_vertices(mesh):
        return _run_until_kept(mesh, options, leaving, without)


def _run_until_kept(
    mesh: SimplexMesh, options: Options, leaving: Leaving, without: Container[str]
) -> SurfaceOutcome:
    """Runs from the input on until one keeps the promise, at last the input itself.

    Where the promise costs more than a little of what the best state had, runs within half of the
    envelope follow, and so on: a larger envelope gives no less than one of its halves.
    """
    clock = time.perf_counter()
    start = surface_start(mesh)
    log = Log(times={"prepare": time.perf_counter() - clock}, without=without,
              flips=options.smoothing.connectivity != "none")
    first = tried = _attempts(start, options, leaving, log, 0)
    every = list(first.found)
    for halving in range(1, POLICY.surface_halvings + 1):
        if not tried.refused or _enough(every, first.refused):
            break
        within = replace(options, envelope=options.envelope * 0.5**halving)
        tried = _attempts(start, within, leaving, log, halving)
        why = (f"the surface stays within {within.envelope:.3g} of the diagonal, since runs "
               f"within {options.envelope:.3g} were given up: {'; '.join(first.broken)}")
        every += [one._replace(outcome=replace(one.outcome, fallback=why)) for one in tried.found]
    best = _best(every, options.objective)
    (options.progress or silent)("finishing", 1.0)
    if best is None:
        returned = input_returned(mesh, tried.memory, first.broken, tried.reason)
        outcome, kept = _as_given(returned), first.kept
    else:
        outcome, kept = best.outcome, best.kept
    return replace(outcome, times=log.times, energy=log.energy, counts=log.counts, kept=kept)


class Found(NamedTuple):
    """A surface that keeps the promise, what was kept of it and its figures."""

    outcome: SurfaceOutcome
    kept: Kept
    worth: Figures


class Attempts(NamedTuple):
    """What runs within one envelope led to.

    Attributes
    ----------
    found : list of Found        surfaces that keep the promise
    refused : Figures or None    of the best state of the first run that did not, if any
    broken : list of str         what of the promise it did not keep
    kept : Kept, memory : Memory, reason : str    of the last run
    """

    found: list[Found]
    refused: Figures | None
    broken: list[str]
    kept: Kept
    memory: Memory
    reason: str


def _best(found: list[Found], objective: Objective) -> Found | None:
    """The one of highest score; for radius ratios of those with about the highest mean."""
    if not found:
        return None
    least = max(one.worth.mean_quality for one in found) - POLICY.surface_equal
    if not AIMS[objective].by_ratios:
        least = 0.0
    return max((one for one in found if one.worth.mean_quality >= least),
               key=lambda one: one.worth.score)


def _enough(found: list[Found], refused: Figures | None) -> bool:
    """Whether the promise costs little of the mean quality of a state that did not keep it."""
    if not found or refused is None:
        return bool(found)
    best = max(one.worth.mean_quality for one in found)
    return best >= refused.mean_quality - POLICY.surface_loss


def _attempts(
    start: SurfaceStart, options: Options, leaving: Leaving, log: Log, before: int
) -> Attempts:
    """Runs within one envelope: each leaves alone what broke the promise in those before.

    A state that breaks it goes back to the input there, too, without a run.
    """
    mesh = start.mesh
    alone = np.zeros(len(mesh.points), dtype=np.bool_)
    broken: list[str] = []
    found, refused = list[Found](), None

    def worth(outcome: Outcome) -> Figures:
        seen = as_seen(outcome.points, outcome.cells, outcome.metric)
        return figures(*seen, options.objective)

    for attempt in range(POLICY.surface_attempts):
        last = attempt == POLICY.surface_attempts - 1
        turn = before * POLICY.surface_attempts + attempt
        memory, kept, reason = _run(start, in_turn(options, turn), alone, log)
        if not memory.states and options.finish:
            spoiled = np.zeros(len(mesh.points), dtype=np.bool_)
            spoiled[start.frame.vertices[memory.spoiled()]] = True
            spoiled = _with_rings(mesh, spoiled, 1)
            if not last and 0 < spoiled.sum() <= POLICY.surface_spoiled * len(start.points):
                broken = [f"{name} would be worse" for name in memory.worse]
                alone |= spoiled
                continue
            for _ in range(POLICY.surface_attempts):
                _finishing_alone(start, options, alone, memory, log)
                if memory.states or not {"share_below_20", "mean_quality"} & set(memory.worse):
                    break
                small = _newly_small(start, memory)
                if not small.any():
                    break
                alone |= _with_rings(mesh, small, 1)
        clock = time.perf_counter()
        judge = partial(_judged, start, kept, options, leaving)
        outcome, faulty = best_state(memory, judge, log, reason)
        plain = outcome is not None and not outcome.fallback
        if isinstance(outcome, SurfaceOutcome):
            if broken and plain:
                outcome = replace(outcome, fallback=_held(broken))
            found.append(Found(outcome, kept, worth(outcome)))
        if not plain and memory.states:
            first, faulty = judge(memory.states[0])
            if faulty:
                refused = refused or worth(first)
                state = mended_state(start, kept, options, leaving, memory)
                mended, left = judge(state) if state is not None else (None, faulty)
                if isinstance(mended, SurfaceOutcome) and not left:
                    why = _held(faulty) + having(memory.states[0].figures)
                    mended = replace(mended, stop_reason=reason, fallback=why)
                    found.append(Found(mended, kept, worth(mended)))
        log.add_time("check", time.perf_counter() - clock)
        if faulty:
            broken = faulty
        if not faulty or not memory.states or last:
            break
        if outcome is not None and _enough(found, refused):
            break
        alone |= _left_alone(start, kept, memory, leaving, attempt + 1)
    return Attempts(found, refused, broken, kept, memory, reason)


def _held(broken: list[str]) -> str:
    """Why some vertices are where they were."""
    return ("some vertices stay where they are, since a run that moved them was given up: "
            f"{'; '.join(broken)}")


def _as_given(outcome: Outcome) -> SurfaceOutcome:
    """The outcome of a surface on which nothing moved."""
    return SurfaceOutcome(**vars(outcome), distance=Distance(0.0, 0.0))


def surface_kept(mesh: SimplexMesh, options: Options) -> Kept:
    """What a run would keep of a surface."""
    check_method(options)
    return _build(surface_start(mesh), options, np.zeros(len(mesh.points), dtype=np.bool_))[2]


def surface_sizes(mesh: SimplexMesh, options: Options) -> FloatArray:
    """The density "curvature" of a surface at its vertices, (n,)."""
    start = surface_start(mesh)
    _, features, _ = _build(start, options, np.zeros(len(mesh.points), dtype=np.bool_))
    density = surface_density(
        options.density, options.smoothing.exponent, start.points, start.cells, start.edges,
        features
    )
    values = np.ones(len(mesh.points))
    values[start.frame.vertices] = density.values
    return values


def surface_outcome(outcome: Outcome, kept: Kept, distance: Distance) -> SurfaceOutcome:
    """The outcome of a surface, with what was kept of it and how far it moved."""
    return SurfaceOutcome(**vars(outcome) | {"kept": kept, "distance": distance})


def surface_start(mesh: SimplexMesh) -> SurfaceStart:
    """Number the triangles that may change along a curve, and list their edges."""
    start = make_start(mesh)
    fixed = mesh.fixed.copy()
    fixed[mesh.cells[mesh.frozen]] = True
    edges = _inner_edges(mesh, start.frame, start.cells)
    marked = marked_edges(edges, start.pairs(mesh.lines), len(start.points))
    return SurfaceStart(
        **vars(start), fixed=fixed[start.frame.vertices], edges=edges,
        kept=label_borders(edges, start.regions) | marked,
    )


def _inner_edges(mesh: SimplexMesh, frame: Frame, triangles: IntArray) -> Edges:
    """The edges of the triangles that may change; frozen ones count where three or more meet."""
    edges = surface_edges(triangles, len(frame.vertices))
    if mesh.frozen.any():
        whole = surface_edges(mesh.cells, len(mesh.points))
        degree = whole.degree[whole.of_cell[frame.active]]
        crowded = degree > 2
        edges.degree[edges.of_cell[crowded]] = degree[crowded]
        edges.neighbors[crowded] = -1
    return edges


def _run(
    start: SurfaceStart, options: Options, alone: BoolArray, log: Log
) -> tuple[Memory, Kept, str]:
    """Both stages from the input on; triangles of vertices ``alone``, (n,) bool, stay."""
    clock = time.perf_counter()
    surface, features, kept = _build(start, options, alone)
    density = surface_density(
        inner_density(start.mesh, options, start.frame), options.smoothing.exponent, start.points,
        start.cells, start.edges, features,
    )
    if start.mesh.ground is not None and density.values is not None:
        density = replace(density, values=values_on(
            start.points, start.cells, density.values, surface.guards.ground.points))
    before = figures(start.seen, start.cells, options.objective)
    memory = Memory(before, tuple(options.keep), options.objective, by_score=options.finish)
    log.add_time("prepare", time.perf_counter() - clock)
    with thread_pool(options.threads) as pool:
        surface = replace(surface, pool=pool, threads=options.threads)
        reason = _cycles(surface, density, options, memory, log)
    return memory, kept, reason


def _finishing_alone(
    start: SurfaceStart, options: Options, alone: BoolArray, memory: Memory, log: Log
) -> None:
    """Improve the input by stage 2 alone, which never leaves the extremes of the input."""
    log.add(f"runs of {ALONE}", 1)
    clock = time.perf_counter()
    surface, _, _ = _build(start, options, alone)
    strict = extremes(memory.before, tuple(options.keep))
    if "share_below_20" in memory.worse:
        strict = strict.with_large(COS_SMALL)
    first = ((REGAIN,),) if "mean_quality" in memory.worse else ()
    for phases in (*first, bulk(2, options.objective), *descents(options.objective)):
        _settle(surface, phases, strict.cells, log)
        memory.offer(surface, ALONE)
    log.add_time("finishing", time.perf_counter() - clock)


def _newly_small(start: SurfaceStart, memory: Memory) -> BoolArray:
    """Vertices, (n,) bool, of triangles of a small angle that the last refused state alone has."""
    refused: Any = memory.refused
    small = refused.cells[cell_shapes(refused.points, refused.cells)[:, 1] > COS_SMALL]
    n = len(start.points)
    own, new = (row_keys(np.sort(rows, axis=1).astype(np.int64), n)
                for rows in (start.cells, small))
    found = np.zeros(len(start.mesh.points), dtype=np.bool_)
    found[start.frame.vertices[small[~np.isin(new, own)]]] = True
    return found


def _build(
    start: SurfaceStart, options: Options, alone: BoolArray
) -> tuple[Surface, Features, Kept]:
    """Find the features and lay ground and sheet out."""
    points, triangles, edges = start.points, start.cells, start.edges
    frame, mesh = start.frame, start.mesh
    shut = alone[frame.vertices]
    stars = vertex_stars(triangles, len(points))
    slides = options.boundary == "slide"
    slack = POLICY.surface_lines * options.envelope if slides else EXACT
    features = find_features(
        points, triangles, edges, stars, angle=options.feature_angle, fixed=start.fixed | shut,
        kept=start.kept, slack=slack,
    )
    ground = make_ground(points, triangles, edges, stars, features.edges)
    sheet = make_sheet(points, triangles, edges, features)
    sheet.locked[edges.of_cell[shut[triangles].all(axis=1)]] = True
    length = mesh.extent * frame.scale
    limits = Limits(
        (POLICY.surface_guard * options.envelope * length) ** 2, (slack * length) ** 2,
        math.cos(math.radians(POLICY.surface_turn)),
    )
    between, metric = options.envelope * length, start.metric
    if mesh.ground is not None:
        ground = earlier_ground(mesh.ground, frame.inside(mesh.ground.points))
        metric = in_unit(mesh.ground.metric, frame.scale)
        sheet = laid_on(sheet, ground, limits.distance)
        between *= 2.0  # both surfaces are within the envelope of the ground
    locked = np.ones(len(mesh.points), dtype=np.bool_)
    locked[frame.vertices] = features.kind == LOCKED
    kept = Kept(
        length / frame.scale, between / frame.scale,
        frame.vertices[edges.vertices[features.edges]], locked, features.corners,
        int((features.kind == LINE).sum()),
    )
    surface = Surface(
        sheet._replace(points=start.seen), Guards(ground, features.lines, limits), start.regions,
        np.ascontiguousarray(metric.T),
    )
    return surface, features, kept


def _cycles(
    surface: Surface, density: SurfaceDensity, options: Options, memory: Memory, log: Log
) -> str:
    """Alternate the two stages, then look after the worst triangles; why stage 1 stopped."""
    strict = extremes(memory.before, tuple(options.keep)).cells
    bounds = FREELY._replace(quality=POLICY.surface_thin)
    if not options.finish:
        bounds = strict
        if "p1_quality" in options.keep:
            bounds = bounds._replace(quality=memory.before.p1_quality)
        if "share_below_20" in options.keep:
            bounds = bounds._replace(large=min(bounds.large, COS_SMALL))
    watch = None if options.finish else partial(memory.offer, name="smoothing")
    reason = alternate(
        lambda tick: smooth_surface(surface, density, options, bounds, log, tick, watch),
        lambda: _settle(surface, bulk(2, options.objective), strict, log),
        lambda: figures(surface.points, surface.triangles).mean_quality, options, log,
    )
    if options.finish:
        clock = time.perf_counter()
        _worst_triangles(surface, strict, memory, log)
        log.add_time("finishing", time.perf_counter() - clock)
    (options.progress or silent)("finishing", 1.0)
    return reason


def _worst_triangles(surface: Surface, strict: Extremes, memory: Memory, log: Log) -> None:
    """The phases of stage 2 that follow the bulk; good states go to the memory.

    Compound moves that lead to a surface which no repair brings back within the input's extremes
    are made once more, after it was repaired without them.
    """
    memory.offer(surface, "bulk")
    plain = surface.twin()
    for phases in descents(memory.objective):
        _settle(surface, phases, strict, log)
        memory.offer(surface, "finished")
    if memory.states or _repaired(surface, strict, memory, log):
        return
    _settle(plain, TAIL, strict, log)
    if memory.offer(plain, "finished") or _repaired(plain, strict, memory, log):
        for phases in descents(memory.objective):
            _settle(plain, phases, strict, log)
            memory.offer(plain, "finished")


def _repaired(surface: Surface, strict: Extremes, memory: Memory, log: Log) -> bool:
    """Whether the surface is good but for a few triangles, and comes back within the extremes."""
    worse, refused = memory.worse, memory.refused
    if "mean_quality" in worse:
        return False
    if repaired(REPAIR, lambda phases: _settle(surface, phases, strict, log),
                lambda: memory.offer(surface, "repaired"), log):
        return True
    memory.worse, memory.refused = worse, refused
    return False


def _settle(surface: Surface, phases: tuple[Phase, ...], bounds: Extremes, log: Log) -> None:
    """Run phases of stage 2 that are not left out, and count."""
    for phase in phases:
        if phase.name in log.without:
            continue
        phase = phase if log.flips else without_flips(phase)
        descent = SurfaceDescent(surface, phase, bounds)
        compound = descent.compound()
        flips, moves = finish_phase(descent, phase)
        surface.resample()
        log.add("quality flips", flips + compound)
        log.add("vertex moves", moves)


def _judged(
    start: SurfaceStart, kept: Kept, options: Options, leaving: Leaving, state: State
) -> tuple[Outcome, list[str]]:
    """Judge a state: the outcome as it leaves, and the broken promises."""
    outcome = leaving(start.placed(state))
    broken, distance = faults(
        start.mesh, kept, outcome.points, outcome.cells, outcome.regions, options, outcome.metric
    )
    return SurfaceOutcome(**vars(outcome), distance=distance), broken


def _left_alone(
    start: SurfaceStart, kept: Kept, memory: Memory, leaving: Leaving, rings: int
) -> BoolArray:
    """Vertices, (n,) bool, around the places where a state broke the promise."""
    mesh = start.mesh
    alone = np.zeros(len(mesh.points), dtype=np.bool_)
    for state in memory.states:
        placed = leaving(start.placed(state))
        alone |= outside(mesh, kept, placed.points, placed.cells)
    return _with_rings(mesh, alone, rings)


def _with_rings(mesh: SimplexMesh, vertices: BoolArray, rings: int) -> BoolArray:
    """The same vertices, (n,) bool, with rings of triangles of the input around them."""
    for _ in range(rings):
        vertices[mesh.cells[vertices[mesh.cells].any(axis=1)]] = True
    return vertices
