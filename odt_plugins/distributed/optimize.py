"""One huge mesh in blocks: cut, optimise the blocks apart, glue, cut elsewhere."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from odt_plugins.carrying.roundtrip import optimized
from odt_plugins.distributed.apply import told
from odt_plugins.distributed.glue import Map, Task, Traffic, Whole, labels, near_cuts, one_round
from odt_plugins.distributed.local import executor
from odt_plugins.engine.cells.geometry import boundary_facets, signed_volumes
from odt_plugins.engine.odt.density import NodalDensity, make_density
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import COS_SMALL, cell_shapes
from odt_plugins.engine.record.figures import figures as figures_of
from odt_plugins.engine.record.progress import in_turn
from odt_plugins.engine.run.judge import envelope_length, faults, slides
from odt_plugins.engine.run.outcome import Leaving, Outcome, as_it_is, unchanged
from odt_plugins.engine.run.within import Within
from odt_plugins.engine.sliding.skin import skin_features
from odt_plugins.engine.surface.driver import surface_kept, surface_outcome, surface_sizes
from odt_plugins.engine.surface.judge import Distance, Kept
from odt_plugins.engine.surface.judge import faults as surface_faults
from odt_plugins.engine.topology.part import rings
from odt_plugins.errors import InvalidOptionError, expect
from odt_plugins.mesh.arrays import BoolArray, IntArray
from odt_plugins.mesh.numbering import most_vertices, without_removed
from odt_plugins.mesh.seen import NO_METRIC, as_seen
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.options import Options
from odt_plugins.progress import part, silent

LEAST_CELLS = 40_000
"""Meshes are cut into no smaller blocks: half of such a block would be done twice."""

WORTH_CELLS = 100_000
"""Meshes of fewer cells are done in this process: others take as long to start."""

LAST_CELLS = 50_000
"""No more cells around the cuts than that are done in one last round."""

WORST_CELLS = 20
"""So many tetrahedra, worst first by each measure, are looked after in the last round."""

FIRST_SHARE = 0.9
"""Part of the allowed change of the volume for the first round; the cuts need the rest."""

FIRST_PART = 0.5
"""``part`` of :class:`Within` in the first round, where many of the worst cells are at the cuts and
no later round sees most of the others again."""

MOST_POLISHED = 0.01
"""Largest share of the tetrahedra whose small angles are looked after in the last round."""

LAST = ("extremes", "polish", "after polish")
"""Phases of stage 2 for the worst cells of the whole, which come in the last round."""

EXTREMES = ("min_quality", "min_angle", "max_angle", "min_altitude")
"""Figures of one part that say something of the whole: kept by every block in later rounds."""


def block_engine(
    options: Options, blocks: int, rounds: int, client: Any, workers: int
) -> Callable[[SimplexMesh, Options, Leaving], Outcome]:
    """Give the engine that optimises block by block, after a check of its arguments.

    The first round optimises the whole mesh in blocks whose rims are fixed; each later one, what
    lies around those vertices that have been on rims only. In the last one nothing is cut again, so
    that from two on every cell has been inside a block in some round. The second is the last where
    at most 50,000 cells lie around the cuts. The bits are the same for any number of workers and
    any order in which they finish.

    Parameters
    ----------
    options : Options
    blocks, rounds, client, workers    as of :func:`odt_plugins.optimize`

    Raises
    ------
    InvalidOptionError      an option is out of range, or does not go with blocks
    """
    check(blocks, rounds, workers, options, several=client is not None or workers > 0)

    def engine(simplices: SimplexMesh, chosen: Options, leaving: Leaving) -> Outcome:
        few = len(simplices.cells) < WORTH_CELLS
        with executor(client, 0 if few else workers) as apply:
            return run_blocks(simplices, chosen, blocks, rounds, apply, leaving)

    return engine


def run_blocks(
    mesh: SimplexMesh, options: Options, blocks: int, rounds: int, apply: Map,
    leaving: Leaving = as_it_is,
) -> Outcome:
    """Optimise a valid mesh in blocks.

    Parameters
    ----------
    mesh : SimplexMesh
    options : Options
    blocks, rounds : int     as `blocks` and `block_rounds` of :func:`odt_plugins.optimize`
    apply : callable         applies a function to blocks, results in their order
    leaving : callable       applied to the mesh after a round before it is judged

    Returns
    -------
    Outcome                  of the last round after which the whole mesh keeps the promise

    Notes
    -----
    Blocks are held to the worst cell and the extreme angles of the whole first; what passes them at
    the cuts a later round mends. Where a round breaks the promise of the whole, all are done again
    with blocks that each keep it by themselves.
    """
    active = np.flatnonzero(~mesh.frozen)
    count = min(blocks, len(active) // LEAST_CELLS)
    if count < 2:
        return optimized(mesh, options, leaving)
    clock = time.perf_counter()
    kept = surface_kept(mesh, options) if mesh.is_surface else None
    start, plain, power = _start(_with_features(mesh, options, kept), options)
    length = envelope_length(mesh, options) if kept or slides(mesh, options) else 0.0
    times = {"prepare": time.perf_counter() - clock}
    figures = figures_of(*as_seen(mesh.points, mesh.cells[active], mesh.metric))
    found: list[tuple[int, Outcome]] = []
    for judged in (True,) if mesh.is_surface else (False, True):
        done = _Done([start])
        told_all = replace(options, progress=options.progress or silent)
        report = in_turn(told_all, int(judged)).progress
        for index in range(rounds):
            state = done.states[-1]
            last = index == rounds - 1 or (index > 0 and near_cuts(state).sum() <= LAST_CELLS)
            if length and index == 1:
                state = replace(state, mesh=_on_ground(start.mesh, state.mesh))
                done.states[-1] = state
            label = labels(state, count, index, index + 1 if last else rounds,
                           _worst(state) if last else None)
            if label.max() < 0:
                continue
            name = f"round {index + 1}"
            told_of = part(report, index / rounds, (index + 1) / rounds)
            blockwise = told(apply, told_of, name, int(label.max()) + 1)
            share = _share(mesh, state.mesh) if length and index else FIRST_SHARE
            within = Within(whole=None if judged else figures, without=() if last else LAST,
                            share=share, part=1.0 if index else FIRST_PART)
            task = Task(first(plain, len(active)) if index == 0 else later(plain), power, within,
                        length, _room(mesh, state.mesh, options))
            done.add(name, label, task, blockwise)
            if last:
                break
        clock = time.perf_counter()
        outcome, good = _judged(mesh, done, options, leaving, kept)
        done.times["check"] = time.perf_counter() - clock
        found.append((good, replace(outcome, times=times | done.times, counts=done.counts)))
        if good == len(done.states) - 1:
            break
    return max(found, key=lambda pair: pair[0])[1]


@dataclass
class _Done:
    """The whole before the first round and after every one, and what the rounds did."""

    states: list[Whole]
    times: dict[str, float] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    fallbacks: list[str] = field(default_factory=list)

    def add(self, name: str, label: IntArray, task: Task, apply: Map) -> None:
        """Do one round."""
        clock = time.perf_counter()
        whole, traffic = one_round(self.states[-1], label, task, apply)
        self.states.append(whole)
        _count(self.counts, name, traffic)
        self.fallbacks += [f"{name}: {reason}" for reason in traffic.fallbacks]
        self.times[name] = time.perf_counter() - clock


def _share(mesh: SimplexMesh, now: SimplexMesh) -> float:
    """The part of the allowed change of the volume that former rounds left."""
    if mesh.is_surface:
        return 1.0
    was, after = (float(signed_volumes(m.points, m.cells).sum()) for m in (mesh, now))
    return max(0.0, 1.0 - abs(after / was - 1.0) / POLICY.slide_volume)


def _room(mesh: SimplexMesh, now: SimplexMesh, options: Options) -> int:
    """How many vertices may be added to the mesh as it is now."""
    if not options.insert:
        return 0
    most = most_vertices(len(mesh.used), options.insert)
    return most - len(now.used)


def _worst(whole: Whole) -> BoolArray | None:
    """Vertices (n,) of the worst tetrahedra by radius ratio and angles, and of small angles.

    Those at the cuts, which were never optimised, are looked after in any case.
    """
    mesh = whole.mesh
    if mesh.dim == 2:
        return None
    cells = mesh.cells[~mesh.frozen & ~rings(whole.waiting, mesh.cells, 1)]
    shapes = cell_shapes(*as_seen(mesh.points, cells, mesh.metric)) * [1.0, -1.0, 1.0, 1.0]
    worst = np.zeros(len(mesh.points), dtype=np.bool_)
    small = min(int((shapes[:, 1] < -COS_SMALL).sum()), int(MOST_POLISHED * len(cells)))
    for column, count in zip(shapes.T, (WORST_CELLS, max(WORST_CELLS, small), WORST_CELLS),
                             strict=False):
        worst[cells[np.argsort(column, kind="stable")[:count]]] = True
    return worst


def _with_features(mesh: SimplexMesh, options: Options, kept: Kept | None) -> SimplexMesh:
    """The mesh with the features of a surface that slides; what holds there is held."""
    if kept is not None:
        return replace(mesh, fixed=mesh.fixed | kept.locked, lines=kept.lines)
    if not slides(mesh, options):
        return mesh
    lines, corners = skin_features(mesh, options)
    return replace(mesh, fixed=mesh.fixed | corners, lines=lines)


def _on_ground(before: SimplexMesh, now: SimplexMesh) -> SimplexMesh:
    """A mesh whose surface slid in a former round: it slides on that of the input, lines apart."""
    fixed = now.fixed.copy()
    fixed[before.lines] = True
    cells = before.cells if before.is_surface else boundary_facets(before.cells)
    nowhere = np.zeros(len(cells), dtype=np.int32)
    ground = SimplexMesh(before.points, cells, nowhere, before.fixed, lines=before.lines,
                         metric=before.metric if before.is_surface else NO_METRIC)
    return replace(now, fixed=fixed, ground=ground)


def _start(mesh: SimplexMesh, options: Options) -> tuple[Whole, Options, float]:
    """The mesh before the first round, the options of a block, and the power of the density.

    A density over vertices or cells becomes a field that is carried with the vertices.
    """
    active = np.flatnonzero(~mesh.frozen)
    spec, power, values = options.density, 1.0, None
    unused = mesh.cells[:0]
    named = isinstance(spec, str)
    if isinstance(spec, NodalDensity):
        values, power, spec = spec.values, spec.power, "keep" if spec.keeps else "uniform"
    elif named and spec == "curvature" and mesh.is_surface:
        values, named, spec = surface_sizes(mesh, options), False, "uniform"
    elif spec == "keep" if named else not callable(spec):
        if not named:
            make_density(spec, None, mesh.points, mesh.cells, unused)
            spec = np.asarray(spec, dtype=np.float64)
            spec = spec[active] if len(spec) != len(mesh.points) else spec
        cells = mesh.cells[active]
        density = make_density(spec, options.smoothing.exponent, mesh.points, cells, unused)
        values, power = density.field, density.power
        spec = "keep" if named else "uniform"
    plain = replace(options, density=spec, progress=None, fixed=None, selection=None,
                    regions=None, smoothing=replace(options.smoothing, exponent=None))
    waiting = np.zeros(len(mesh.points), dtype=np.bool_)
    waiting[mesh.cells[active]] = True
    patch = np.full(len(mesh.points), -1, dtype=np.int32)
    return Whole(mesh, values, waiting, patch), plain, power


def first(options: Options, cells: int) -> Options:
    """Options of the first round: its blocks choose as the whole, of so many cells, would."""
    if options.smoothing.connectivity != "auto" or cells <= POLICY.exchange_cells:
        return options
    return replace(options, smoothing=replace(options.smoothing, connectivity="flips"))


def later(options: Options) -> Options:
    """Options of later rounds: their blocks are near the optimum and hold a part of the bad cells.

    Means and quantiles of such a part say nothing; the whole is judged by them at the end.
    """
    keep = tuple(name for name in options.keep if name in EXTREMES)
    lab = options.smoothing
    if lab.connectivity == "auto":
        lab = replace(lab, connectivity="flips")
    return replace(options, keep=keep, smoothing=lab)


def _judged(
    mesh: SimplexMesh, done: _Done, options: Options, leaving: Leaving, kept: Kept | None
) -> tuple[Outcome, int]:
    """The last state that keeps the promise as it leaves, or the input, and after which round."""
    broken: list[str] = []
    reason = f"{len(done.states) - 1} rounds of blocks"
    for index in range(len(done.states) - 1, 0, -1):
        last = done.states[index].mesh
        points, cells, origin = without_removed(mesh, last.points, last.cells)
        outcome = leaving(Outcome(points, cells, last.regions, stop_reason=reason, origin=origin,
                                  metric=last.metric))
        outcome, now = _looked_at(mesh, outcome, options, kept)
        if not now:
            given_up = [f"a later round was given up ({'; '.join(broken)})"] if broken else []
            fallback = "; ".join((given_up + done.fallbacks)[:3]) or None
            return replace(outcome, fallback=fallback), index
        broken = now
    outcome = replace(
        unchanged(mesh, reason),
        fallback=f"the input is returned, nothing better kept the promise ({'; '.join(broken)})",
    )
    if kept is not None:
        outcome = surface_outcome(outcome, kept, Distance(0.0, 0.0))
    return outcome, 0


def _looked_at(
    mesh: SimplexMesh, outcome: Outcome, options: Options, kept: Kept | None
) -> tuple[Outcome, list[str]]:
    """Judge a mesh that leaves: the mesh with the measured distances, and the broken promises."""
    given = outcome.points, outcome.cells, outcome.regions, options
    if kept is None:
        broken, slid = faults(mesh, *given, outcome.origin, outcome.metric)
        return replace(outcome, slid=slid), broken
    broken, distance = surface_faults(mesh, kept, *given, outcome.metric)
    return surface_outcome(outcome, kept, distance), broken


def _count(counts: dict[str, int], name: str, traffic: Traffic) -> None:
    counts |= {f"{name} blocks": traffic.blocks, f"{name} cells": traffic.cells,
               f"{name} bytes sent": traffic.sent, f"{name} bytes received": traffic.received}
    for what, value in traffic.counts.items():
        counts[what] = counts.get(what, 0) + value


def check(blocks: int, rounds: int, workers: int, options: Options, *, several: bool) -> None:
    """Refuse values out of range, and options that do not go with blocks."""
    given = (("blocks", blocks, 1), ("block_rounds", rounds, 1), ("workers", workers, 0))
    for name, value, least in given:
        good = isinstance(value, int) and not isinstance(value, bool) and value >= least
        expect(good, name, value, f"an integer of at least {least}")
    if several and callable(options.density):
        _expect_picklable(options.density)


def _expect_picklable(function: Any) -> None:
    """See whether other processes can get a function by its name."""
    import pickle

    try:
        pickle.dumps(function)
    except (pickle.PicklingError, AttributeError, TypeError) as exc:
        msg = (f"got a density function that other processes cannot import ({exc}); expected one "
               "of a module, try an array with a value for every vertex")
        raise InvalidOptionError(msg) from exc
