"""The outer loop for curved surfaces: stages, best-state memory, and the promise at the end."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from odt_plugins.engine.compiled.threads import thread_pool
from odt_plugins.engine.finish.phases import Phase, bulk, tail
from odt_plugins.engine.ground.build import make_ground, make_sheet
from odt_plugins.engine.ground.features import EXACT, Features, find_features
from odt_plugins.engine.ground.sheet import HELD, LINE, Limits
from odt_plugins.engine.odt.rounds import Log
from odt_plugins.engine.record.figures import Figures, figures
from odt_plugins.engine.record.memory import Memory, State
from odt_plugins.engine.record.progress import in_turn, report_share, silent
from odt_plugins.engine.run.cycles import extremes, settled
from odt_plugins.engine.run.driver import Leaving, Outcome, as_it_is, inner_density
from odt_plugins.engine.surface.density import SurfaceDensity, surface_density
from odt_plugins.engine.surface.judge import Distance, Kept, faults, outside
from odt_plugins.engine.surface.passes import Surface, finish_phase
from odt_plugins.engine.surface.rounds import check_method, smooth_surface
from odt_plugins.engine.topology.frame import Frame, callers_vertices, make_frame
from odt_plugins.engine.topology.star import vertex_stars
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.simplex import SimplexMesh, diagonal
from odt_plugins.mesh.surface import Edges, surface_edges
from odt_plugins.options import Options

GUARD = 0.975
"""Part of the envelope that the guards use; the rest is for the bounds of the judge."""

SLIDING = 0.5
"""Part of the envelope by which feature lines may change when the boundary slides."""

NORMALS = 60.0
"""Degrees by which the normal of a new triangle may differ from that of the ground under it."""

THIN = 0.02
"""Radius ratio below which stage 1 makes no triangle worse."""

TAIL = tail(2)[:2]
"""Phases for the worst triangles; beyond p = 8 the envelope leaves them nothing to gain."""

REPAIR = (Phase(16.0, 0.3, 20, 3), Phase(32.0, 0.3, 20, 3), Phase(64.0, 0.3, 20, 3))
"""Phases for a surface that is good but for a few triangles beyond the input's extremes."""

ATTEMPTS = 4
"""Runs until the input is returned; each leaves alone what broke the promise in those before, with
one more ring of triangles around it every time."""

SPOILED = 0.3
"""Part of the vertices that may be left alone because of triangles beyond the input's extremes."""


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
class Start:
    """The input of one run in inner numbering and coordinates.

    Attributes
    ----------
    frame : Frame
    points : (k, 3) float64, triangles : (m1, 3) int32, regions : (m1,) int32
    fixed : (k,) bool           vertices that the caller holds
    marked : (l, 2) int32       edges that the caller marked as features
    edges : Edges
    """

    frame: Frame
    points: FloatArray
    triangles: IntArray
    regions: IntArray
    fixed: BoolArray
    marked: IntArray
    edges: Edges


def run_surface(
    mesh: SimplexMesh, options: Options, leaving: Leaving = as_it_is
) -> SurfaceOutcome:
    """Optimise a curved surface.

    Parameters
    ----------
    mesh : SimplexMesh    triangles in space, made by :func:`odt_plugins.mesh.surface.surface_mesh`
    options : Options
    leaving : callable    applied to every state before it is judged

    Returns
    -------
    SurfaceOutcome        a surface that keeps the promise as it leaves, at worst the input itself

    Raises
    ------
    InvalidOptionError    a method or solver that surfaces do not know, or a bad density
    """
    check_method(options)
    if mesh.frozen.all():
        return _unchanged(mesh, "no triangle may change")
    with callers_vertices(mesh):
        return _run_until_kept(mesh, options, leaving)


def _run_until_kept(
    mesh: SimplexMesh, options: Options, leaving: Leaving
) -> SurfaceOutcome:
    """Runs from the input on until one keeps the promise, at last the input itself."""
    clock = time.perf_counter()
    start = _start(mesh)
    log = Log()
    times: dict[str, float] = {"prepare": time.perf_counter() - clock}
    alone = np.zeros(len(mesh.points), dtype=np.bool_)
    broken: list[str] = []
    for attempt in range(ATTEMPTS):
        memory, kept, reason = _run(
            mesh, start, in_turn(options, attempt), alone, log, times
        )
        if not memory.states and options.finish:
            spoiled = np.zeros(len(mesh.points), dtype=np.bool_)
            spoiled[start.frame.vertices[memory.spoiled()]] = True
            spoiled = _with_rings(mesh, spoiled, 1)
            if attempt < ATTEMPTS - 1 and 0 < spoiled.sum() <= SPOILED * len(start.points):
                broken = [f"{name} would be worse" for name in memory.worse]
                alone |= spoiled
                continue
            _finishing_alone(mesh, start, options, alone, memory, log, times)
        clock = time.perf_counter()
        outcome, found = _best(mesh, start, kept, memory, options, log, leaving)
        if outcome is None and not memory.states:
            found = [f"{name} would be worse" for name in memory.worse]
        times["check"] = times.get("check", 0.0) + time.perf_counter() - clock
        if outcome is not None:
            (options.progress or silent)("finishing", 1.0)
            fallback = None if not broken else (
                f"some vertices stay where they are, since a run that moved them was given up: "
                f"{'; '.join(broken)}")
            return replace(
                outcome, times=times, energy=log.energy, counts=log.counts, stop_reason=reason,
                fallback=outcome.fallback or fallback, kept=kept,
            )
        broken = found
        if not memory.states or attempt == ATTEMPTS - 1:
            break
        alone |= _left_alone(mesh, start, kept, memory, leaving, attempt + 1)
    (options.progress or silent)("finishing", 1.0)
    unchanged = replace(
        _unchanged(mesh, reason), times=times, energy=log.energy, counts=log.counts, kept=kept
    )
    if not broken:
        return replace(unchanged, stop_reason=f"nothing could be improved ({reason})")
    fallback = (
        f"the input is returned, nothing better kept the promise ({'; '.join(broken)})"
        f"{memory.price()}"
    )
    return replace(unchanged, fallback=fallback)


def _unchanged(mesh: SimplexMesh, reason: str) -> SurfaceOutcome:
    return SurfaceOutcome(
        mesh.points.copy(), mesh.cells.copy(), mesh.regions.copy(), stop_reason=reason,
        distance=Distance(0.0, 0.0),
    )


def _start(mesh: SimplexMesh) -> Start:
    frame, triangles = make_frame(mesh)
    number = np.full(len(mesh.points), -1, dtype=np.int32)
    number[frame.vertices] = np.arange(len(frame.vertices), dtype=np.int32)
    marked = number[mesh.lines]
    fixed = mesh.fixed.copy()
    fixed[mesh.cells[mesh.frozen]] = True
    return Start(
        frame,
        frame.inside(mesh.points[frame.vertices]),
        triangles,
        np.ascontiguousarray(mesh.regions[frame.active]),
        fixed[frame.vertices],
        marked[(marked >= 0).all(axis=1)],
        _inner_edges(mesh, frame, triangles),
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
    mesh: SimplexMesh, start: Start, options: Options, alone: BoolArray, log: Log,
    times: dict[str, float],
) -> tuple[Memory, Kept, str]:
    """Both stages from the input on; triangles of vertices ``alone``, (n,) bool, stay."""
    clock = time.perf_counter()
    surface, features, kept = _build(mesh, start, options, alone)
    density = surface_density(
        inner_density(mesh, options, start.frame), options.exponent, start.points,
        start.triangles, start.edges, features,
    )
    before = figures(start.points, start.triangles)
    memory = Memory(before, tuple(options.keep), options.objective, by_score=options.finish)
    times["prepare"] += time.perf_counter() - clock
    with thread_pool(options.threads) as pool:
        surface = replace(surface, pool=pool, threads=options.threads)
        reason = _cycles(surface, density, options, before, memory, log, times)
    return memory, kept, reason


def _finishing_alone(
    mesh: SimplexMesh, start: Start, options: Options, alone: BoolArray, memory: Memory, log: Log,
    times: dict[str, float],
) -> None:
    """Improve the input by stage 2 alone, which never leaves the extremes of the input."""
    log.add("runs of finishing alone", 1)
    surface, _, _ = _build(mesh, start, options, alone)
    strict = np.array(extremes(memory.before, tuple(options.keep)).cells)
    for phases in (bulk(2), TAIL):
        _descend(surface, phases, strict, log, times)
        memory.offer(surface, "finishing alone")


def _build(
    mesh: SimplexMesh, start: Start, options: Options, alone: BoolArray
) -> tuple[Surface, Features, Kept]:
    """Find the features and lay ground and sheet out."""
    points, triangles, edges = start.points, start.triangles, start.edges
    frame = start.frame
    shut = alone[frame.vertices]
    stars = vertex_stars(triangles, len(points))
    slack = SLIDING * options.envelope if options.boundary == "slide" else EXACT
    features = find_features(
        points, triangles, edges, stars, angle=options.feature_angle, fixed=start.fixed | shut,
        regions=start.regions, marked=start.marked, slack=slack,
    )
    ground = make_ground(points, triangles, edges, stars, features)
    sheet = make_sheet(points, triangles, edges, features)
    sheet.locked[edges.of_cell[shut[triangles].all(axis=1)]] = True
    used = mesh.points[np.unique(mesh.cells)]
    length = diagonal(used) * frame.scale
    limits = Limits(
        (GUARD * options.envelope * length) ** 2, (slack * length) ** 2,
        math.cos(math.radians(NORMALS)),
    )
    held = np.ones(len(mesh.points), dtype=np.bool_)
    held[frame.vertices] = features.kind == HELD
    kept = Kept(
        length / frame.scale, options.envelope * length / frame.scale,
        frame.vertices[edges.vertices[features.edges]], held, features.corners,
        int((features.kind == LINE).sum()),
    )
    return Surface(sheet, ground, features.lines, limits, start.regions), features, kept


def _cycles(
    surface: Surface, density: SurfaceDensity, options: Options, before: Figures, memory: Memory,
    log: Log, times: dict[str, float],
) -> str:
    """Alternate the two stages; returns why stage 1 stopped last."""
    report = options.progress if options.progress is not None else silent
    strict = np.array(extremes(before, tuple(options.keep)).cells)
    bounds = np.array([THIN, 1.0, -1.0])
    watch = None
    if not options.finish:
        bounds = strict
        watch = partial(memory.offer, name="smoothing")
        if "p1_quality" in options.keep:
            bounds[0] = before.p1_quality
    cycles = options.cycles if options.finish else 1
    reason = "nothing was asked for"
    means: list[float] = []
    for cycle in range(cycles):
        clock = time.perf_counter()
        reason = smooth_surface(
            surface, density, options, bounds, log,
            partial(report_share, report, cycle / cycles, 0.5 / cycles), watch,
        )
        times["smoothing"] = times.get("smoothing", 0.0) + time.perf_counter() - clock
        if not options.finish:
            continue
        _descend(surface, bulk(2), strict, log, times)
        report("finishing", (cycle + 1) / cycles)
        means.append(figures(surface.points, surface.triangles).mean_quality)
        if end := settled(means):
            reason = end
            break
    if options.finish:
        memory.offer(surface, "bulk")
        _descend(surface, TAIL, strict, log, times)
        memory.offer(surface, "finished")
        if not memory.states and "mean_quality" not in memory.worse:
            _repair(surface, strict, memory, log, times)
    report("finishing", 1.0)
    return reason


def _repair(
    surface: Surface, bounds: FloatArray, memory: Memory, log: Log, times: dict[str, float]
) -> None:
    """Bring the triangles beyond the bounds back; what is refused all the same is forgotten."""
    worse, refused = memory.worse, memory.refused
    for phase in REPAIR:
        log.add("repairs", 1)
        _descend(surface, (phase,), bounds, log, times)
        if memory.offer(surface, "repaired"):
            return
    memory.worse, memory.refused = worse, refused


def _descend(
    surface: Surface, phases: tuple[Phase, ...], bounds: FloatArray, log: Log,
    times: dict[str, float],
) -> None:
    """Run phases of stage 2 and count."""
    clock = time.perf_counter()
    for phase in phases:
        flips, moves = finish_phase(surface, phase, bounds)
        log.add("quality flips", flips)
        log.add("vertex moves", moves)
    times["finishing"] = times.get("finishing", 0.0) + time.perf_counter() - clock


def _placed(mesh: SimplexMesh, start: Start, state: State, leaving: Leaving) -> Outcome:
    """A state in the caller's numbering as it leaves; what did not move keeps its bits."""
    frame = start.frame
    points = mesh.points.copy()
    moved = (state.points != start.points).any(axis=1)
    points[frame.vertices[moved]] = frame.outside(state.points[moved])
    cells = np.concatenate([mesh.cells[mesh.frozen], frame.vertices[state.cells]])
    regions = np.concatenate([mesh.regions[mesh.frozen], state.regions])
    return leaving(Outcome(points, np.ascontiguousarray(cells), regions))


def _best(
    mesh: SimplexMesh, start: Start, kept: Kept, memory: Memory, options: Options, log: Log,
    leaving: Leaving,
) -> tuple[SurfaceOutcome | None, list[str]]:
    """The best remembered state that keeps the promise, or what the last one broke."""
    broken: list[str] = []
    for rank, state in enumerate(memory.states):
        placed = _placed(mesh, start, state, leaving)
        found, distance = faults(
            mesh, kept, placed.points, placed.cells, placed.regions, options
        )
        if not found:
            fallback = None
            if rank or state.name == "finishing alone":
                worse = broken or [f"{name} would be worse" for name in memory.worse]
                fallback = f"a later state was given up ({'; '.join(worse)}){memory.price()}"
            return SurfaceOutcome(
                placed.points, placed.cells, placed.regions, fallback=fallback,
                written=placed.written, source=placed.source, kept=kept, distance=distance,
            ), []
        log.add("states refused", 1)
        broken = found
    return None, broken


def _left_alone(
    mesh: SimplexMesh, start: Start, kept: Kept, memory: Memory, leaving: Leaving, rings: int
) -> BoolArray:
    """Vertices, (n,) bool, around the places where a state broke the promise."""
    alone = np.zeros(len(mesh.points), dtype=np.bool_)
    for state in memory.states:
        placed = _placed(mesh, start, state, leaving)
        alone |= outside(mesh, kept, placed.points, placed.cells)
    return _with_rings(mesh, alone, rings)


def _with_rings(mesh: SimplexMesh, vertices: BoolArray, rings: int) -> BoolArray:
    """The same vertices, (n,) bool, with rings of triangles of the input around them."""
    for _ in range(rings):
        vertices[mesh.cells[vertices[mesh.cells].any(axis=1)]] = True
    return vertices
