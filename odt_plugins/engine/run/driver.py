"""A run from mesh to mesh: cycles, or finishing alone; insertion; the promise at the end."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from odt_plugins.engine.cells.extremes import Bounds
from odt_plugins.engine.cells.geometry import boundary_vertices, interface_vertices
from odt_plugins.engine.compiled.threads import thread_pool, worth
from odt_plugins.engine.odt.density import Density, NodalDensity, make_density
from odt_plugins.engine.odt.rounds import Log
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import Figures, figures
from odt_plugins.engine.record.memory import Memory, State
from odt_plugins.engine.record.progress import BEFORE_INSERTION, in_turn, until_insertion
from odt_plugins.engine.run.best import ALONE, BESIDES, INPUT, best_state, input_returned
from odt_plugins.engine.run.cycles import extremes, finish_alone, run_cycles, settle
from odt_plugins.engine.run.judge import cut_vertices, envelope_length, faults, slides
from odt_plugins.engine.run.outcome import Leaving, Outcome, as_it_is, unchanged
from odt_plugins.engine.run.start import Start, make_start
from odt_plugins.engine.run.within import WHOLE, Within
from odt_plugins.engine.topology.adjacency import cell_neighbors
from odt_plugins.engine.topology.complex import make_complex
from odt_plugins.engine.topology.frame import Frame, callers_vertices
from odt_plugins.errors import InvalidOptionError
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.chunks import Pool
from odt_plugins.mesh.numbering import old_numbers
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.options import Options
from odt_plugins.progress import part, silent

if TYPE_CHECKING:
    from odt_plugins.engine.sliding.boundary import Skin


NO_DENSITY = "nothing that follows the density kept the promise, the sizes are those of the input"


def locked_vertices(mesh: SimplexMesh, neighbors: IntArray) -> tuple[BoolArray, BoolArray]:
    """Vertices that may not move, and those on the boundary or on an interface, (n,) each.

    A vertex of a frozen cell may not move either.
    """
    boundary = boundary_vertices(mesh.cells, len(mesh.points), mesh.regions, neighbors)
    locked = boundary | mesh.fixed
    locked[mesh.cells[mesh.frozen]] = True
    return locked, boundary


def run(
    mesh: SimplexMesh, options: Options, leaving: Leaving = as_it_is, *,
    within: Within = WHOLE,
) -> Outcome:
    """Optimise a valid mesh.

    Parameters
    ----------
    mesh : SimplexMesh
    options : Options
    leaving : callable    applied to every state before it is judged
    within : Within       how the mesh lies within a larger one

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
        return _run(mesh, options, leaving, within)[0]
    within = within._replace(without=frozenset(), fresh=None, part=1.0)
    if within.whole is None:
        outcome = _run_sliding(mesh, options, leaving, within)
    else:
        outcome, _ = _run(mesh, options, leaving, within)
    (options.progress or silent)("finishing", 1.0)
    return outcome


def _run_sliding(
    mesh: SimplexMesh, options: Options, leaving: Leaving, within: Within
) -> Outcome:
    """Runs from the input on until a surface that slid keeps the promise, at last without.

    Where stage 1 failed, where flat cells are left and where it costs little, the boundary is
    fixed in another run, and the better of the two is handed back.
    """
    outcome, spoiled = _run(mesh, in_turn(options, 0), leaving, within)
    fixed = mesh.fixed.copy()
    times = Counter(outcome.times)
    for turn in range(POLICY.slide_retreats):
        if outcome.slid is not None or fixed[spoiled].all():
            break
        fixed[spoiled] = True
        outcome, spoiled = _run(
            replace(mesh, fixed=fixed), in_turn(options, turn + 1), leaving, within
        )
        times.update(outcome.times)
    if outcome.slid is not None:
        left_alone = int((fixed & ~mesh.fixed).sum())
        more = {"surface vertices left alone": left_alone} if left_alone else {}
        outcome = replace(outcome, counts=outcome.counts | more, times=dict(times))
        if not _may_be_beaten(outcome, options):
            return outcome
    last = in_turn(options, POLICY.slide_retreats + 1)
    still, _ = _run(mesh, replace(last, boundary="fixed"), leaving, within)
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
    few, alone = len(outcome.cells) < POLICY.few_cells, f"runs of {ALONE}" in outcome.counts
    return few or alone or figures(outcome.points, outcome.cells).p1_quality < POLICY.poor_quality


def _score(outcome: Outcome, options: Options) -> float:
    return figures(outcome.points, outcome.cells, options.objective).score


def _run(
    mesh: SimplexMesh, options: Options, leaving: Leaving, within: Within = WHOLE
) -> tuple[Outcome, IntArray]:
    """One run of all stages; also the surface vertices at which a surface that slid is spoiled."""
    if not options.finish:
        within = within._replace(fresh=None)
    options = replace(options, threads=worth(options.threads, len(mesh.cells)))
    with thread_pool(options.threads) as pool, callers_vertices(mesh):
        return _run_in(pool, mesh, options, leaving, within)


def _run_in(
    pool: Pool | None, mesh: SimplexMesh, options: Options, leaving: Leaving, within: Within
) -> tuple[Outcome, IntArray]:
    clock = time.perf_counter()
    log, whole = Log(without=within.without, flips=options.connectivity != "none"), within.whole
    nowhere = np.zeros(0, dtype=np.int32)
    neighbors = cell_neighbors(mesh.cells, pool=pool)
    locked, boundary = locked_vertices(mesh, neighbors)
    if mesh.frozen.all() or len(mesh.cells) == 0:
        return unchanged(mesh, "no cell may change"), nowhere
    start = make_start(mesh)
    frame, cells, regions = start.frame, start.cells, start.regions
    inner_locked = np.ascontiguousarray(locked[frame.vertices])
    inner_boundary = np.ascontiguousarray(boundary[frame.vertices])
    points = start.points.copy()
    skin = _skin(start, options, points, within.share) if slides(mesh, options) else None
    first = make_complex(
        points, cells, regions, inner_locked, inner_boundary, skin, frame.inner_neighbors(neighbors)
    )
    del neighbors
    before = figures(points, cells, options.objective, pool)
    before = before if whole is None else before.with_extremes_of(whole)
    if mesh.valid_before is not None:
        places, valid = mesh.valid_before
        before = before.or_worse(figures(frame.inside(places), valid, options.objective))
    within = within.numbered(frame.vertices)
    memory = Memory(before, tuple(options.keep), options.objective, by_score=options.finish,
                    aside=None if whole is None else within.cut, pool=pool)
    spec = inner_density(mesh, options, frame)
    m = first.used
    density = make_density(
        spec, options.exponent, points, first.cells[:m], first.neighbors[:m].copy()
    )
    log.times["prepare"] = time.perf_counter() - clock
    bounds = extremes(before, tuple(options.keep))
    if within.fresh is not None:
        bounds = _as_good_as_before(bounds, points, cells[~within.fresh[cells].any(axis=1)])
    before_insertion = until_insertion(options) if options.insert else options
    told = within if skin is None else within._replace(cut=None)
    reason = run_cycles(first, density, before_insertion, bounds, memory, log, pool, told)
    refused = not memory.states and not (skin and memory.spoiled().size)
    besides = skin is None and _may_finish_alone(memory, inner_locked, options)
    work_on = partial(settle, log=log, pool=pool, threads=options.threads, part=within.part)
    if options.finish and (refused or besides):
        name = ALONE if refused else BESIDES
        clock = time.perf_counter()
        for flips in (True, False):
            again = start.points.copy()
            skin = _skin(start, options, again, within.share) if skin else None
            second = make_complex(again, cells, regions, inner_locked, inner_boundary, skin)
            log.add(f"runs of {ALONE}", 1)
            finish_alone(second, options, bounds, memory, name, work_on, pool, flips=flips)
            if memory.states or (skin is None and inner_locked.all()):
                break
        log.times[ALONE] = time.perf_counter() - clock
        if refused and not _keeps_sizes(options):
            reason += f"; {NO_DENSITY}"
    if options.insert and (memory.states or skin is None):
        from odt_plugins.engine.finish.resampling import resample_in_rounds, with_spare_vertices

        clock = time.perf_counter()
        best = (memory.states or [State(start.points, cells, regions, before, "input")])[0]
        spare = with_spare_vertices(
            best.points, best.cells, best.regions, inner_locked, inner_boundary,
            mesh.anchored[frame.vertices], options.insert,
        )
        resample_in_rounds(
            spare, best.figures, options.objective,
            limits=partial(_held, options, before),
            settle=work_on,
            offer=partial(memory.offer, name="resampled"),
            report=partial(part(options.progress or silent, BEFORE_INSERTION, 1.0), "inserting"),
            log=log,
        )
        log.times["inserting"] = time.perf_counter() - clock
    clock = time.perf_counter()
    found, broken = best_state(
        memory, partial(_judged, start, options, leaving, whole is None), log, reason
    )
    outcome = found or input_returned(mesh, memory, broken, reason)
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
        spoiled = cut_vertices(start.points, cells, best.points, best.cells)
    spoiled = spoiled[spoiled < len(inner_boundary)]
    return outcome, frame.vertices[spoiled[inner_boundary[spoiled]]]


def _as_good_as_before(bounds: Bounds, points: FloatArray, cells: IntArray) -> Bounds:
    """Hold cells without a movable vertex to the 1 % quantile of cells that were optimised before.

    Most of them are at a cut and were as good as others: no later round will see them again.
    """
    if not len(cells):
        return bounds
    quality = max(bounds.locked.quality, figures(points, cells).p1_quality)
    return bounds._replace(locked=bounds.locked._replace(quality=quality))


def _skin(start: Start, options: Options, points: FloatArray, share: float) -> Skin:
    """The boundary as it may slide; interfaces, fixed vertices and frozen cells hold it."""
    from odt_plugins.engine.sliding.skin import make_skin, on_earlier_ground

    mesh, frame = start.mesh, start.frame
    locked = mesh.fixed | interface_vertices(mesh.cells, len(mesh.points), mesh.regions)
    locked[mesh.cells[mesh.frozen]] = True
    skin = make_skin(
        points, start.cells, locked=locked[frame.vertices],
        envelope=envelope_length(mesh, options) * frame.scale, angle=options.feature_angle,
        stays=start.pairs(mesh.stays), lines=start.pairs(mesh.lines), share=share,
    )
    if mesh.ground is None:
        return skin
    return on_earlier_ground(skin, mesh.ground, frame.inside(mesh.ground.points))


def _judged(
    start: Start, options: Options, leaving: Leaving, is_whole: bool, state: State
) -> tuple[Outcome, list[str]]:
    """A state as it leaves, and what it breaks of the promise; a part is left to its judge."""
    outcome = start.placed(state)
    if not is_whole:
        return outcome, []
    outcome = leaving(outcome)
    broken, slid = faults(
        start.mesh, outcome.points, outcome.cells, outcome.regions, options, outcome.origin
    )
    return replace(outcome, slid=slid), broken


def _sizes(
    mesh: SimplexMesh, options: Options, frame: Frame, density: Density, outcome: Outcome,
    pool: Pool | None,
) -> FloatArray | None:
    """The values of a density that came with the vertices, None without."""
    if not isinstance(options.density, NodalDensity):
        return None
    n, origin = len(mesh.points), outcome.origin
    number = np.arange(n) if origin is None else old_numbers(origin, n)
    values = np.concatenate([options.density.values, np.ones(int((number >= n).sum()))])
    beside = np.zeros(len(values), dtype=np.int32)
    beside[frame.vertices] = density.walk_start(len(frame.vertices))
    cells = number[outcome.cells]
    old = cells.min(axis=1)
    near = np.full(len(values), -1, dtype=np.int32)
    near[cells] = np.where(old < n, old, -1)[:, None]
    added = np.arange(n, len(values))
    beside[added] = beside[near[added]]
    moved = number >= n
    moved[~moved] = (outcome.points[~moved] != mesh.points[number[~moved]]).any(axis=1)
    found = replace(density, power=1.0).at(
        frame.inside(outcome.points[moved]), pool, beside[number[moved]]
    )
    values[number[moved]] = found
    return values[number]


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


def _held(options: Options, before: Figures, now: Figures) -> Bounds:
    """Bounds of insertion: the extremes of now, but for angles' sake the input's quality."""
    bounds = extremes(now, tuple(options.keep))
    if options.objective != "min_dihedral":
        return bounds
    return bounds.with_quality(extremes(before, tuple(options.keep)).cells.quality)


def _may_finish_alone(memory: Memory, locked: BoolArray, options: Options) -> bool:
    """Whether stage 2 alone may do better than what was reached: where few vertices move, or cells
    that nothing can improve make the 1 % quantile, and their neighbours pay for them.
    """
    if not (memory.states and _keeps_sizes(options)):
        return False
    poor = memory.states[0].figures.p1_quality < POLICY.poor_quality
    return poor or bool((~locked).mean() < POLICY.few_movable)


def _keeps_sizes(options: Options) -> bool:
    spec = options.density
    if isinstance(spec, NodalDensity):
        return spec.keeps
    return isinstance(spec, str) and spec == "keep"
