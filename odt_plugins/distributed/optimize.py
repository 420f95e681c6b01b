"""One huge mesh in blocks: cut, optimise the blocks apart, glue, cut elsewhere."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from odt_plugins.adapters.files import check_output, read_file, write_file
from odt_plugins.distributed.apply import told
from odt_plugins.distributed.glue import Map, Traffic, Whole, labels, one_round
from odt_plugins.distributed.local import executor
from odt_plugins.engine.odt.density import NodalDensity, make_density
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import Figures
from odt_plugins.engine.record.figures import figures as figures_of
from odt_plugins.engine.record.progress import in_turn
from odt_plugins.engine.run.driver import run
from odt_plugins.engine.run.judge import faults
from odt_plugins.engine.run.outcome import Leaving, Outcome, as_it_is
from odt_plugins.errors import InvalidOptionError, UnsupportedMeshError
from odt_plugins.mesh.arrays import IntArray
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.options import OptionKeywords, Options, make_options, with_option_signature
from odt_plugins.progress import part, silent
from odt_plugins.roundtrip import run_engine

if TYPE_CHECKING:
    from odt_plugins.report.report import Report

LEAST_CELLS = 5000
"""Meshes are cut into no smaller blocks: most of such a block lies beside its rim."""

EXTREMES = ("min_quality", "min_angle", "max_angle", "min_altitude")
"""Figures of one part that say something of the whole: kept by every block in later rounds."""


@with_option_signature("odt")
def optimize_partitioned(
    mesh: Any,
    blocks: int,
    block_rounds: int = 3,
    *,
    client: Any = None,
    workers: int = 0,
    odt: Mapping[str, Any] | None = None,
    **options: Unpack[OptionKeywords],
) -> Any:
    """Improve a mesh block by block, in this process or on a Dask cluster.

    The first round optimises the whole mesh in blocks whose rims are fixed; each later one, what
    lies around those vertices that have been on rims only. The result is about as good as that of
    :func:`odt_plugins.optimize`, and the same bits for any number of workers and any order in which
    they finish.

    Parameters
    ----------
    mesh : object
        What :func:`odt_plugins.optimize` takes: tetrahedra, or triangles in a plane.
    blocks : int
        Blocks of about equal size in the first round; fewer when they had less than 5000 cells.
    block_rounds : int
        Most rounds of blocks. In the last one nothing is cut again, so that from two on every cell
        has been inside a block in some round.
    client : distributed.Client, optional
        Blocks go to the workers of this cluster; Dask gives those of a lost worker to another.
    workers : int
        Processes of this machine, without a server; 0 works in this process. Scripts that give
        more must be importable (``if __name__ == "__main__":``).
    **options
        The fields of :class:`odt_plugins.Options`.

    Returns
    -------
    same type as `mesh`

    Raises
    ------
    InvalidOptionError      an option is out of range, does not go with blocks, or a worker has
                            other packages than this process
    UnsupportedMeshError    the mesh is a curved surface
    WorkerError             workers were lost again and again
    and what :func:`odt_plugins.optimize` raises
    """
    chosen = make_options(odt, **options)
    return _partitioned(mesh, blocks, block_rounds, client, workers, chosen)[0]


@with_option_signature("odt")
def optimize_partitioned_with_report(
    mesh: Any,
    blocks: int,
    block_rounds: int = 3,
    *,
    client: Any = None,
    workers: int = 0,
    odt: Mapping[str, Any] | None = None,
    **options: Unpack[OptionKeywords],
) -> tuple[Any, Report]:
    """Improve a mesh as :func:`optimize_partitioned` does and tell what was done.

    Returns
    -------
    mesh : same type as the input
    report : Report     its times and counts are those of the rounds, bytes sent and received
    """
    from odt_plugins.report.report import make_report

    chosen = make_options(odt, **options)
    result, before, outcome, told = _partitioned(
        mesh, blocks, block_rounds, client, workers, chosen)
    return result, make_report(before, outcome, chosen, **told)


def _partitioned(
    mesh: Any, blocks: int, rounds: int, client: Any, workers: int, options: Options
) -> tuple[Any, SimplexMesh, Outcome, dict[str, Any]]:
    """What :func:`run_engine` returns."""
    check(blocks, rounds, workers, options, several=client is not None or workers > 0)

    def engine(simplices: SimplexMesh, chosen: Options, leaving: Leaving) -> Outcome:
        if simplices.is_surface:
            msg = (
                "got a curved surface; expected tetrahedra, or triangles in a plane, for blocks; "
                "try optimize"
            )
            raise UnsupportedMeshError(msg)
        with executor(client, workers) as apply:
            return run_blocks(simplices, chosen, blocks, rounds, apply, leaving)

    return run_engine(mesh, options, engine)


@with_option_signature("odt")
def optimize_file_partitioned(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    blocks: int,
    block_rounds: int = 3,
    *,
    client: Any = None,
    odt: Mapping[str, Any] | None = None,
    file_format: str | None = None,
    binary: bool | None = None,
    **options: Unpack[OptionKeywords],
) -> Report:
    """Improve the mesh of one file in blocks and write it to another, or to the same.

    As :func:`odt_plugins.optimize_file`: `target` is complete, or as it was before.
    """
    check_output(target, file_format, binary)
    mesh, report = optimize_partitioned_with_report(
        read_file(source), blocks, block_rounds, client=client, odt=odt, **options
    )
    write_file(target, mesh, file_format, binary)
    return report


def run_blocks(
    mesh: SimplexMesh, options: Options, blocks: int, rounds: int, apply: Map,
    leaving: Leaving = as_it_is,
) -> Outcome:
    """Optimise a valid mesh in blocks.

    Parameters
    ----------
    mesh : SimplexMesh
    options : Options
    blocks, rounds : int     as `blocks` and `block_rounds` of :func:`optimize_partitioned`
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
        return run(mesh, options, leaving)
    clock = time.perf_counter()
    start, plain, power = _start(mesh, options)
    times = {"prepare": time.perf_counter() - clock}
    figures = figures_of(mesh.points, mesh.cells[active])
    found: list[tuple[int, Outcome]] = []
    for judged in (False, True):
        done = _Done([start])
        told_all = replace(options, progress=options.progress or silent)
        report = in_turn(told_all, int(judged)).progress
        for index in range(rounds):
            label = labels(done.states[-1], count, index, rounds)
            if label.max() < 0:
                continue
            name = f"round {index + 1}"
            share = part(report, index / rounds, (index + 1) / rounds)
            blockwise = told(apply, share, name, int(label.max()) + 1)
            chosen = first(plain, len(active)) if index == 0 else later(plain)
            done.add(name, label, chosen, power, blockwise, None if judged else figures)
        clock = time.perf_counter()
        outcome, kept = _judged(mesh, done, options, leaving)
        done.times["check"] = time.perf_counter() - clock
        found.append((kept, replace(outcome, times=times | done.times, counts=done.counts)))
        if kept == len(done.states) - 1:
            break
    return max(found, key=lambda pair: pair[0])[1]


@dataclass
class _Done:
    """The whole before the first round and after every one, and what the rounds did."""

    states: list[Whole]
    times: dict[str, float] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    fallbacks: list[str] = field(default_factory=list)

    def add(
        self, name: str, label: IntArray, options: Options, power: float, apply: Map,
        figures: Figures | None,
    ) -> None:
        """Do one round, its blocks within those figures of the whole, or judged on their own."""
        clock = time.perf_counter()
        whole, traffic = one_round(self.states[-1], label, options, power, apply, figures)
        self.states.append(whole)
        _count(self.counts, name, traffic)
        self.fallbacks += [f"{name}: {reason}" for reason in traffic.fallbacks]
        self.times[name] = time.perf_counter() - clock


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
    elif spec == "keep" if named else not callable(spec):
        if not named:
            make_density(spec, None, mesh.points, mesh.cells, unused)
            spec = np.asarray(spec, dtype=np.float64)
            spec = spec[active] if len(spec) != len(mesh.points) else spec
        cells = mesh.cells[active]
        density = make_density(spec, options.exponent, mesh.points, cells, unused)
        values, power = density.field, density.power
        spec = "keep" if named else "uniform"
    plain = replace(options, density=spec, exponent=None, progress=None, fixed=None,
                    selection=None, regions=None, orient=False)
    waiting = np.zeros(len(mesh.points), dtype=np.bool_)
    waiting[mesh.cells[active]] = True
    patch = np.full(len(mesh.points), -1, dtype=np.int32)
    return Whole(mesh, values, waiting, patch), plain, power


def first(options: Options, cells: int) -> Options:
    """Options of the first round: its blocks choose as the whole, of so many cells, would."""
    if options.connectivity != "auto" or cells <= POLICY.exchange_cells:
        return options
    return replace(options, connectivity="flips")


def later(options: Options) -> Options:
    """Options of later rounds: their blocks are near the optimum and hold a part of the bad cells.

    Means and quantiles of such a part say nothing; the whole is judged by them at the end.
    """
    keep = tuple(name for name in options.keep if name in EXTREMES)
    connectivity = "flips" if options.connectivity == "auto" else options.connectivity
    return replace(options, keep=keep, connectivity=connectivity)


def _judged(
    mesh: SimplexMesh, done: _Done, options: Options, leaving: Leaving
) -> tuple[Outcome, int]:
    """The last state that keeps the promise as it leaves, or the input, and after which round."""
    broken: list[str] = []
    reason = f"{len(done.states) - 1} rounds of blocks"
    for kept in range(len(done.states) - 1, 0, -1):
        last = done.states[kept].mesh
        outcome = leaving(Outcome(last.points, last.cells, last.regions, stop_reason=reason))
        now, _ = faults(mesh, outcome.points, outcome.cells, outcome.regions, options)
        if not now:
            given_up = [f"a later round was given up ({'; '.join(broken)})"] if broken else []
            fallback = "; ".join((given_up + done.fallbacks)[:3]) or None
            return replace(outcome, fallback=fallback), kept
        broken = now
    return Outcome(
        mesh.points.copy(), mesh.cells.copy(), mesh.regions.copy(), stop_reason=reason,
        fallback=f"the input is returned, nothing better kept the promise ({'; '.join(broken)})",
    ), 0


def _count(counts: dict[str, int], name: str, traffic: Traffic) -> None:
    counts |= {f"{name} blocks": traffic.blocks, f"{name} cells": traffic.cells,
               f"{name} bytes sent": traffic.sent, f"{name} bytes received": traffic.received}
    for what, value in traffic.counts.items():
        counts[what] = counts.get(what, 0) + value


def check(blocks: int, rounds: int, workers: int, options: Options, *, several: bool) -> None:
    """Refuse values out of range, and options that do not go with blocks.

    Raises
    ------
    InvalidOptionError
    """
    given = (("blocks", blocks, 1), ("block_rounds", rounds, 1), ("workers", workers, 0))
    for name, value, least in given:
        if not isinstance(value, int) or isinstance(value, bool) or value < least:
            msg = f"got {name}={value!r}; expected an integer of at least {least}"
            raise InvalidOptionError(msg)
    if options.boundary == "slide" or options.insert:
        name = "insert=True" if options.insert else "boundary='slide'"
        msg = (f"got {name} with blocks; expected a boundary and vertices that stay, "
               "try optimize without blocks")
        raise InvalidOptionError(msg)
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
