"""A run from mesh to mesh: cycles, or finishing alone; insertion; the promise at the end."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.cells.geometry import boundary_vertices, interface_vertices
from odt_plugins.engine.compiled.threads import thread_pool
from odt_plugins.engine.finish.resampling import resample_in_rounds, with_spare_vertices
from odt_plugins.engine.odt.density import Density, NodalDensity, make_density
from odt_plugins.engine.odt.rounds import Log
from odt_plugins.engine.record.figures import Figures, figures
from odt_plugins.engine.record.memory import Memory, State
from odt_plugins.engine.record.progress import in_turn, report_insertion, silent, until_insertion
from odt_plugins.engine.run.cycles import extremes, finish_alone, run_cycles, settle
from odt_plugins.engine.run.judge import Slid, cut_vertices, envelope_length, faults, slides
from odt_plugins.engine.sliding.boundary import Skin
from odt_plugins.engine.sliding.skin import make_skin
from odt_plugins.engine.topology.adjacency import cell_neighbors
from odt_plugins.engine.topology.complex import make_complex
from odt_plugins.engine.topology.frame import Frame, callers_vertices, make_frame
from odt_plugins.errors import InvalidOptionError
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.numbering import new_numbers
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.options import Options

INPUT = "the input is returned, "

RETREATS = 4
"""How often a surface slides again, with those vertices left alone at which it was spoiled."""

POOR, FEW = 0.15, 3000
"""1 % quantile of q, and number of cells, below which a fixed boundary is tried besides."""

STILL = 0.02
"""Share of the vertices that may move below which stage 1 has little to do."""

ALONE = "finishing alone"
BESIDES = "finishing alone, besides"
NO_DENSITY = "nothing that follows the density kept the promise, the sizes are those of the input"


@dataclass(frozen=True)
class Outcome:
    """What the engine hands back.

    Attributes
    ----------
    points : (n, d) float64         same numbering as the input
    cells : (m', d + 1) int32       positively oriented
    regions : (m',) int32           exact region labels
    energy : list of (stage, E)     ODT energy after every round
    times : dict stage -> seconds   wall time
    stop_reason : str               one sentence
    fallback : str or None          why an earlier state is returned, when it is
    counts : dict name -> int       sweeps, flips, exchanges, refusals
    slid : Slid or None             how far the boundary moved, when it may slide and did
    sizes : (n,) float64 or None    values of a :class:`NodalDensity` where the vertices are now,
                                    None without one, or with new vertices
    origin : (n',) int64 or None    input vertex of every vertex, -1 for the new ones at the end;
                                    None when the vertices are those of the input
    written : (n', D) or None       points in the caller's type and space, as they leave
    source : (m',) int32 or None    input cell of which every cell takes the data, as it leaves
    """

    points: FloatArray
    cells: IntArray
    regions: IntArray
    energy: list[tuple[str, float]] = field(default_factory=list)
    times: dict[str, float] = field(default_factory=dict)
    stop_reason: str = ""
    fallback: str | None = None
    counts: dict[str, int] = field(default_factory=dict)
    slid: Slid | None = None
    sizes: FloatArray | None = None
    origin: NDArray[np.int64] | None = None
    written: NDArray[Any] | None = None
    source: IntArray | None = None


Leaving = Callable[[Outcome], Outcome]
"""What a mesh goes through before the caller has it: its points are rounded to the caller's type,
its cells sorted. The points of the new outcome are those that the caller will read."""


def as_it_is(outcome: Outcome) -> Outcome:
    """Let a mesh leave as the engine has it."""
    return outcome


def locked_vertices(mesh: SimplexMesh, neighbors: IntArray) -> tuple[BoolArray, BoolArray]:
    """Vertices that may not move, and those on the boundary or on an interface, (n,) each.

    A vertex of a frozen cell may not move either.
    """
    rim = boundary_vertices(mesh.cells, len(mesh.points), mesh.regions, neighbors)
    locked = rim | mesh.fixed
    locked[mesh.cells[mesh.frozen]] = True
    return locked, rim


def run(
    mesh: SimplexMesh, options: Options, leaving: Leaving = as_it_is, *,
    cut: BoolArray | None = None, whole: Figures | None = None,
) -> Outcome:
    """Optimise a valid mesh.

    Parameters
    ----------
    mesh : SimplexMesh
    options : Options
    leaving : callable           applied to every state before it is judged
    cut : (n,) bool, optional    vertices at which a mesh whose boundary does not slide was cut from
                                 a larger one: the worst cells are looked for away from them, since
                                 what lies around them waits for another run
    whole : Figures, optional    of the larger mesh: its extremes are those that no cell may pass,
                                 and the promise is left to its judge

    Returns
    -------
    Outcome    a mesh that keeps the promise as it leaves, at worst the input itself

    Raises
    ------
    InvalidOptionError    a boundary in the plane is asked to slide
    """
    if options.boundary == "slide" and mesh.dim == 2:
        msg = (
            "got boundary='slide' for a mesh in the plane; expected 'fixed': only the surface of a "
            "mesh of tetrahedra slides"
        )
        raise InvalidOptionError(msg)
    if not slides(mesh, options):
        return _run(mesh, options, leaving, cut, whole)[0]
    outcome = _run_sliding(mesh, options, leaving)
    (options.progress or silent)("finishing", 1.0)
    return outcome


def _run_sliding(mesh: SimplexMesh, options: Options, leaving: Leaving) -> Outcome:
    """Runs from the input on until a surface that slid keeps the promise, at last without.

    Where stage 1 failed, where flat cells are left and where it costs little, the boundary is
    fixed in another run, and the better of the two is handed back.
    """
    outcome, spoiled = _run(mesh, in_turn(options, 0), leaving)
    fixed = mesh.fixed.copy()
    times = Counter(outcome.times)
    for turn in range(RETREATS):
        if outcome.slid is not None or fixed[spoiled].all():
            break
        fixed[spoiled] = True
        outcome, spoiled = _run(
            replace(mesh, fixed=fixed), in_turn(options, turn + 1), leaving
        )
        times.update(outcome.times)
    if outcome.slid is not None:
        left_alone = int((fixed & ~mesh.fixed).sum())
        more = {"surface vertices left alone": left_alone} if left_alone else {}
        outcome = replace(outcome, counts=outcome.counts | more, times=dict(times))
        if not _may_be_beaten(outcome, options):
            return outcome
    still, _ = _run(mesh, replace(in_turn(options, RETREATS + 1), boundary="fixed"), leaving)
    times.update(still.times)
    why = (outcome.fallback or outcome.stop_reason).removeprefix(INPUT)
    if outcome.slid is not None:
        if not _score(still, options) > _score(outcome, options):
            return replace(outcome, times=dict(times))
        why = "a surface that slid gave less"
    reasons = "; ".join(reason for reason in (why, still.fallback) if reason)
    return replace(
        still, fallback=f"the boundary is left as it is; {reasons}", times=dict(times)
    )


def _may_be_beaten(outcome: Outcome, options: Options) -> bool:
    """Whether a fixed boundary is worth a run of its own beside a surface that slid."""
    if not options.finish:
        return False
    few, alone = len(outcome.cells) < FEW, f"runs of {ALONE}" in outcome.counts
    return few or alone or figures(outcome.points, outcome.cells).p1_quality < POOR


def _score(outcome: Outcome, options: Options) -> float:
    return figures(outcome.points, outcome.cells, options.objective).score


def _run(
    mesh: SimplexMesh, options: Options, leaving: Leaving, cut: BoolArray | None = None,
    whole: Figures | None = None,
) -> tuple[Outcome, IntArray]:
    """One run of all stages; also the surface vertices at which a surface that slid is spoiled."""
    with thread_pool(options.threads) as pool, callers_vertices(mesh):
        return _run_in(pool, mesh, options, leaving, cut, whole)


def _run_in(
    pool: ThreadPoolExecutor | None, mesh: SimplexMesh, options: Options, leaving: Leaving,
    cut: BoolArray | None, whole: Figures | None,
) -> tuple[Outcome, IntArray]:
    clock = time.perf_counter()
    nowhere = np.zeros(0, dtype=np.int32)
    neighbors = cell_neighbors(mesh.cells, pool=pool)
    locked, rim = locked_vertices(mesh, neighbors)
    if mesh.frozen.all() or len(mesh.cells) == 0:
        return _unchanged(mesh, "no cell may change"), nowhere
    frame, cells = make_frame(mesh)
    inner_locked = np.ascontiguousarray(locked[frame.vertices])
    inner_rim = np.ascontiguousarray(rim[frame.vertices])
    input_points = frame.inside(mesh.points[frame.vertices])
    points = input_points.copy()
    regions = np.ascontiguousarray(mesh.regions[frame.active])
    skin = _skin(mesh, options, frame, points, cells) if slides(mesh, options) else None
    start = make_complex(
        points, cells, regions, inner_locked, inner_rim, skin, frame.inner_neighbors(neighbors)
    )
    del neighbors
    before = figures(points, cells, options.objective)
    before = before if whole is None else before.with_extremes_of(whole)
    near = None if cut is None or not cut.any() else cut[frame.vertices]
    memory = Memory(before, tuple(options.keep), options.objective, by_score=options.finish,
                    aside=None if whole is None else near)
    spec = inner_density(mesh, options, frame)
    m = start.used
    density = make_density(
        spec, options.exponent, start.points, start.cells[:m], start.neighbors[:m].copy()
    )
    log = Log(times={"prepare": time.perf_counter() - clock})
    bounds = extremes(before, tuple(options.keep))
    first = until_insertion(options) if options.insert else options
    reason = run_cycles(start, density, first, bounds, memory, log, pool, near)
    refused = not memory.states and not (skin and memory.spoiled().size)
    besides = skin is None and _may_finish_alone(memory, inner_locked, options)
    if options.finish and (refused or besides):
        again = input_points.copy()
        skin = _skin(mesh, options, frame, again, cells) if skin else None
        second = make_complex(again, cells, regions, inner_locked, inner_rim, skin)
        log.add(f"runs of {ALONE}", 1)
        name = ALONE if refused else BESIDES
        clock = time.perf_counter()
        finish_alone(second, options, bounds, memory, name, log, pool)
        log.times[ALONE] = time.perf_counter() - clock
        if refused and not _keeps_sizes(options):
            reason += f"; {NO_DENSITY}"
    if options.insert and (memory.states or skin is None):
        clock = time.perf_counter()
        best = (memory.states or [State(input_points, cells, regions, before, "input")])[0]
        spare = with_spare_vertices(
            best.points, best.cells, best.regions, inner_locked, inner_rim,
            mesh.anchored[frame.vertices],
        )
        resample_in_rounds(
            spare, best.figures, options.objective,
            limits=partial(extremes, keep=tuple(options.keep)),
            settle=partial(settle, log=log, pool=pool, threads=options.threads),
            offer=partial(memory.offer, name="resampled"),
            report=partial(report_insertion, options.progress or silent), log=log,
        )
        log.times["inserting"] = time.perf_counter() - clock
    clock = time.perf_counter()
    outcome = _best(
        mesh, frame, input_points, memory, options, log, reason,
        leaving if whole is None else None,
    )
    sizes = _sizes(mesh, options, frame, density, outcome, pool)
    log.times["check"] = time.perf_counter() - clock
    outcome = replace(
        outcome, times=log.times, energy=log.energy, counts=log.counts, sizes=sizes
    )
    if skin is None or outcome.slid is not None:
        return outcome, nowhere
    spoiled = memory.spoiled()
    if memory.states:
        best = memory.states[0]
        spoiled = cut_vertices(input_points, cells, best.points, best.cells)
    spoiled = spoiled[spoiled < len(inner_rim)]
    return outcome, frame.vertices[spoiled[inner_rim[spoiled]]]


def _skin(
    mesh: SimplexMesh, options: Options, frame: Frame, points: FloatArray, cells: IntArray
) -> Skin:
    """The boundary as it may slide; interfaces, fixed vertices and frozen cells hold it."""
    number = np.full(len(mesh.points), -1, dtype=np.int32)
    number[frame.vertices] = np.arange(len(frame.vertices), dtype=np.int32)
    held = mesh.fixed | interface_vertices(mesh.cells, len(mesh.points), mesh.regions)
    held[mesh.cells[mesh.frozen]] = True
    stays, lines = (number[pairs] for pairs in (mesh.stays, mesh.lines))
    return make_skin(
        points, cells, held=held[frame.vertices],
        envelope=envelope_length(mesh, options) * frame.scale, angle=options.feature_angle,
        stays=stays[(stays >= 0).all(axis=1)], lines=lines[(lines >= 0).all(axis=1)],
    )


def _sizes(
    mesh: SimplexMesh, options: Options, frame: Frame, density: Density, outcome: Outcome,
    pool: ThreadPoolExecutor | None,
) -> FloatArray | None:
    """The values of a density that came with the vertices, None without or with new vertices."""
    if not isinstance(options.density, NodalDensity) or outcome.origin is not None:
        return None
    values = options.density.values.copy()
    now = outcome.points[frame.vertices]
    moved = (now != mesh.points[frame.vertices]).any(axis=1)
    walk = density.walk_start(len(now))[moved]
    found = replace(density, power=1.0).at(frame.inside(now[moved]), pool, walk)
    values[frame.vertices[moved]] = found
    return values


def _unchanged(mesh: SimplexMesh, reason: str) -> Outcome:
    return Outcome(mesh.points.copy(), mesh.cells.copy(), mesh.regions.copy(), stop_reason=reason)


def inner_density(mesh: SimplexMesh, options: Options, frame: Frame) -> Any:
    """``options.density`` in inner numbering and coordinates.

    Raises
    ------
    InvalidOptionError    an array does not fit the mesh, or holds bad values
    """
    spec = options.density
    if callable(spec):
        function = spec

        def inner(inner_points: FloatArray) -> Any:
            return function(frame.outside(inner_points))

        return inner
    if isinstance(spec, str):
        return spec
    if isinstance(spec, NodalDensity):
        return replace(spec, values=spec.values[frame.vertices])
    make_density(spec, options.exponent, mesh.points, mesh.cells, mesh.cells)
    values = np.asarray(spec, dtype=np.float64)
    per_cell = len(values) == len(mesh.cells) and len(values) != len(mesh.points)
    return values[frame.active] if per_cell else values[frame.vertices]


def _may_finish_alone(memory: Memory, locked: BoolArray, options: Options) -> bool:
    """Whether stage 2 alone may do better than what was reached: where few vertices move, or cells
    that nothing can improve make the 1 % quantile, and their neighbours pay for them.
    """
    if not (memory.states and _keeps_sizes(options)):
        return False
    return memory.states[0].figures.p1_quality < POOR or (~locked).mean() < STILL


def _keeps_sizes(options: Options) -> bool:
    spec = options.density
    if isinstance(spec, NodalDensity):
        return spec.keeps
    return isinstance(spec, str) and spec == "keep"


def _best(
    mesh: SimplexMesh, frame: Frame, start: FloatArray, memory: Memory, options: Options, log: Log,
    reason: str, leaving: Leaving | None,
) -> Outcome:
    """The best remembered state that keeps the promise as it leaves, at worst the input.

    Without ``leaving`` no state is judged.
    """
    broken: list[str] = [f"{name} would be worse" for name in memory.worse]
    for rank, state in enumerate(memory.states):
        points = mesh.points.copy()
        n = len(start)
        moved = (state.points[:n] != start).any(axis=1)
        points[frame.vertices[moved]] = frame.outside(state.points[:n][moved])
        outcome = _in_caller_terms(mesh, frame, points, state)
        broken_now: list[str] = []
        slid = None
        if leaving is not None:
            outcome = leaving(outcome)
            broken_now, slid = faults(
                mesh, outcome.points, outcome.cells, outcome.regions, options, outcome.origin
            )
        if not broken_now:
            fallback = None
            if state.name == BESIDES:
                reason += "; finishing without smoothing before it gave more"
            if rank or state.name == ALONE:
                why = "; ".join(broken) or "no better than the input"
                fallback = f"a later state was given up ({why}){memory.price()}"
            return replace(outcome, stop_reason=reason, fallback=fallback, slid=slid)
        log.add("states refused", 1)
        broken = broken_now
    if not broken:
        return _unchanged(mesh, f"nothing could be improved ({reason})")
    unchanged = _unchanged(mesh, reason)
    return replace(
        unchanged,
        fallback=f"{INPUT}nothing better kept the promise ({'; '.join(broken)}){memory.price()}",
    )


def _in_caller_terms(
    mesh: SimplexMesh, frame: Frame, points: FloatArray, state: State
) -> Outcome:
    """A state in the caller's numbering, with the frozen cells; ``points`` are the old vertices.

    Vertices keep their index, or their order when some have gone; new ones stand at the end.
    """
    n = len(frame.vertices)
    regions = np.concatenate([mesh.regions[mesh.frozen], state.regions])
    used = np.zeros(len(state.points), dtype=bool)
    used[state.cells] = True
    new = n + np.flatnonzero(used[n:])
    if used[:n].all() and not len(new):
        cells = np.concatenate([mesh.cells[mesh.frozen], frame.vertices[state.cells]])
        return Outcome(points, np.ascontiguousarray(cells), regions)
    stays = np.ones(len(points), dtype=bool)
    stays[frame.vertices[~used[:n]]] = False
    kept = np.flatnonzero(stays)
    origin = np.concatenate([kept, np.full(len(new), -1, dtype=np.int64)])
    outer = new_numbers(origin, len(points))
    inner = np.full(len(state.points), -1, dtype=np.int32)
    inner[:n] = outer[frame.vertices]
    inner[new] = len(kept) + np.arange(len(new))
    cells = np.concatenate([outer[mesh.cells[mesh.frozen]], inner[state.cells]])
    points = np.concatenate([points[kept], frame.outside(state.points[new])])
    return Outcome(points, np.ascontiguousarray(cells), regions, origin=origin)
