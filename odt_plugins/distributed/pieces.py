"""A mesh that fits no memory: its pieces are on disk, the driver knows their interfaces only."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from odt_plugins.adapters.fields import field_names
from odt_plugins.adapters.regions import AUTO, are_names, region_names
from odt_plugins.distributed.apply import Apply, told
from odt_plugins.distributed.figures import Figures, total, worse
from odt_plugins.distributed.local import executor
from odt_plugins.distributed.mending import mended
from odt_plugins.distributed.optimize import check, first, later
from odt_plugins.distributed.piecework import (
    Cut,
    Done,
    Ids,
    Numbers,
    Taken,
    first_round,
    merge,
    publish,
    split,
    take_in,
)
from odt_plugins.distributed.placing import piece_name, place_pieces
from odt_plugins.distributed.scratch import clear, make_scratch
from odt_plugins.distributed.store import GHOSTS, IDS, TABLES, piece_files
from odt_plugins.engine.cells.elementary import exp, log
from odt_plugins.errors import (
    DataNotKeptWarning,
    InvalidMeshError,
    InvalidOptionError,
    MeshFileError,
    counted,
    warn,
    writing,
)
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.options import Options
from odt_plugins.progress import part as part_of
from odt_plugins.progress import telling
from odt_plugins.report.joined import bare_report
from odt_plugins.report.report import Report


def optimize_pieces(
    source: str | os.PathLike[str], target: str | os.PathLike[str], options: Options,
    block_rounds: int = 3, client: Any = None, workers: int = 0,
) -> Report:
    """Improve a mesh of tetrahedra whose pieces are files, without ever holding it as a whole.

    A process holds one piece at a time, or what lies around the seams of some. Pieces have those
    vertices in common that have the same number in the point array GlobalPointIds, or when not all
    come with it, whose coordinates are the same bits.

    Parameters
    ----------
    source : path
        A .pvtu file, or a directory of .vtu files. Cells that the array vtkGhostType gives to
        another piece are left out, and so are empty pieces.
    target : path
        A .pvtu file; its pieces go into a new directory of its name beside it. What lies around the
        interfaces of the input comes as pieces of its own. Vertices of several pieces have the
        same number in the point array GlobalPointIds; coordinates are float64.
    options : Options
        Those that every piece can tell: no arrays, and of the densities "keep" and "uniform". Its
        `progress` is told the stage ("reading", "round 1", "round 2: cutting", "round 2", ...,
        "writing") and the share of the work that is done.
    block_rounds : int
        In the last one a single process holds what lies around the curves where three pieces meet.
    client, workers
        As of :func:`odt_plugins.optimize`; workers of a cluster see the files under the same paths.

    Returns
    -------
    Report    its counts are those of the "pieces" of the result, of the vertices "on interfaces" of
              the input, which the driver holds, and of cells that were inverted or flat
              ("untangled"): the figures before are those of the others then

    Raises
    ------
    MeshFileError             a file cannot be read or written; `target` is then as it was before
    TangledMeshError          cells are inverted or flat, and could not be untangled in their piece
                              and those around it, or were not to be
    InvalidMeshError, UnsupportedMeshError, InvalidOptionError, WorkerError

    Warns
    -----
    DataNotKeptWarning        arrays that the pieces do not have alike do not come through
    """
    check(1, block_rounds, workers, options, several=False)
    _check_for_pieces(options)
    (sources, ghosts), index = piece_files(source), Path(target).absolute()
    if index.is_dir():
        msg = f"cannot write {target}: it is a directory; expected a path for a file"
        raise MeshFileError(msg)
    if index.suffix != ".pvtu":
        msg = f"cannot write {target}: expected a file ending in .pvtu"
        raise MeshFileError(msg)
    folder = None
    try:
        with writing(target, "another directory"):
            folder = make_scratch(index.parent, f".{index.stem}")
            with executor(client, workers) as apply, telling(options.progress, "reading") as tell:
                told_of = replace(options, progress=tell)
                return _run(sources, index, folder, block_rounds, told_of, apply, ghosts=ghosts)
    finally:
        if folder is not None:
            clear(folder)


def _check_for_pieces(options: Options) -> None:
    if options.boundary == "slide" or options.insert:
        name = "insert=True" if options.insert else "boundary='slide'"
        msg = (f"got {name} for a mesh in pieces; expected a boundary and vertices that stay, "
               "try blocks=, in memory")
        raise InvalidOptionError(msg)
    if options.fields == "conserve":
        msg = ("got fields='conserve' for a mesh in pieces; expected 'auto', 'interpolate' or "
               "'keep', try blocks=, in memory")
        raise InvalidOptionError(msg)
    for name in ("fixed", "selection", "reference", "metric"):
        if getattr(options, name) is not None:
            msg = (f"got {name}= for a mesh in pieces; expected options that every piece can tell, "
                   "try blocks=, in memory")
            raise InvalidOptionError(msg)
    if not are_names(options.regions):
        msg = "got an array of regions= for a mesh in pieces; expected the name of a cell array"
        raise InvalidOptionError(msg)
    if not isinstance(options.density, str) or options.density not in ("keep", "uniform"):
        msg = "got a density that no piece can tell; expected 'keep' or 'uniform'"
        raise InvalidOptionError(msg)


def _run(
    sources: Sequence[str], index: Path, folder: Path, rounds: int, options: Options,
    apply: Apply, *, ghosts: bool,
) -> Report:
    chosen = options
    given: Any = options.regions
    report, options = options.progress, replace(options, regions=None, progress=None)

    turns, stages = itertools.count(), 2 * rounds + 1

    def stage(name: str, count: int) -> Apply:
        turn = next(turns)
        return told(apply, part_of(report, turn / stages, (turn + 1) / stages), name, count)

    read = stage("reading", len(sources))
    found = list(read(partial(take_in, regions=given, untangle=options.repair != "none"), [
        (path, str(folder / f"0-{k}.npz")) for k, path in enumerate(sources)]))
    taken: list[Taken] = [part for part in found if part is not None]
    _check_taken(taken, ghosts=ghosts)
    spreads = [part.spreads for part in taken]
    labels = region_names(spreads) if given == AUTO else tuple(spreads[0])
    kept = _data_of_all(taken)
    kinds = taken[0].kinds["data"]
    fields = field_names({name: np.empty((0, *kinds[name][0]), kinds[name][1])
                          for name in kept["data"]})
    valid = [(part.path, part.figures) for part in taken if part.figures is not None]
    untangled = sum(part.inverted for part in taken)
    if untangled:
        names = [path for path, part in zip(sources, found, strict=True) if part is not None]
        report("untangling", 1 / stages)
        taken = mended(taken, names, folder, options,
                       lambda parts: _number(parts, kept, labels)[0], apply)
    numbers, waiting = _number(taken, kept, labels)
    states = [_state(taken)]
    start = total(states[0])
    before = replace(total(valid), volume=start.volume) if untangled and valid else start
    improve = stage("round 1", len(taken))
    work = partial(first_round, options=first(options, start.n_cells))
    done: list[Done] = list(improve(work, [
        (part.path, str(folder / f"1-{k}.npz"), number)
        for k, (part, number) in enumerate(zip(taken, numbers, strict=True))]))
    interface = len(waiting)
    states.append(_state(done))
    for turn in range(2, rounds + 1):
        done, waiting = _later_round(done, waiting, folder / str(turn), later(options), stage,
                                     last=turn == rounds)
        states.append(_state(done))
    broken: list[str] = []
    after = total(states[-1])
    while len(states) > 1 and (now := worse(before, after, options.keep)):
        broken = now
        states.pop()
        after = total(states[-1])
    paths = [path for path, _ in states[-1]]
    given = numbers if len(states) == 1 else [None] * len(paths)
    orientation = max(part.orientation for part in taken)
    turned = sum(part.turned if part.orientation == orientation or part.figures is None
                 else part.figures.summary.n_cells for part in taken)
    _publish(list(zip(paths, given, strict=True)), index, folder, partial(
        publish, orientation=orientation), stage("writing", len(paths)))
    vertices = (sum(part.vertices for part in taken) + interface
                - sum(len(number.rim) for number in numbers))
    ends = valid if untangled and valid else states[0], states[-1]
    counts = {"pieces": len(paths), "vertices on interfaces": interface}
    counts |= {"cells turned": turned} if turned else {}
    return bare_report(
        replace(before, n_points=vertices, turned=turned), replace(after, n_points=vertices),
        [tuple(map(sum, zip(*(f.histogram for _, f in end), strict=True))) for end in ends],
        chosen, stop_reason=f"{rounds} rounds of pieces",
        fallback=f"a later round was given up ({'; '.join(broken)})" if broken else None,
        counts=counts | ({"cells untangled": untangled} if untangled else {}),
        regions_from=labels, interpolated=fields if options.fields != "keep" else ())


def _state(parts: Sequence[Taken | Done]) -> list[tuple[str, Figures]]:
    """Where the pieces are kept after a round, and their figures."""
    return [(part.path, part.figures) for part in parts if part.figures is not None]


def _check_taken(taken: Sequence[Taken], *, ghosts: bool) -> None:
    if not taken:
        msg = "the pieces have no cells; expected tetrahedra"
        raise InvalidMeshError(msg)
    if ghosts and not all(part.ghosts for part in taken):
        msg = (f"got pieces with ghost cells; expected the cell array {GHOSTS} that tells which "
               "they are, or every cell in one piece only")
        raise InvalidMeshError(msg)


def _data_of_all(taken: Sequence[Taken]) -> dict[str, tuple[str, ...]]:
    """Names of the arrays that all pieces have alike, in each of TABLES; warns of all others."""
    alike: dict[str, tuple[str, ...]] = {}
    other: set[str] = set()
    for table in TABLES:
        kinds = [part.kinds[table] for part in taken]
        alike[table] = tuple(name for name, kind in kinds[0].items()
                             if all(found.get(name) == kind for found in kinds))
        other |= {name for found in kinds for name in found} - set(alike[table])
    more = sorted({name for part in taken for name in part.more})
    if more:
        warn(f"field data of pieces do not come through: {', '.join(more)}", DataNotKeptWarning)
    if other:
        names = ", ".join(sorted(other))
        msg = f"arrays that pieces do not have alike do not come through: {names}"
        warn(msg, DataNotKeptWarning)
    return alike


def _number(
    taken: Sequence[Taken], kept: dict[str, tuple[str, ...]], labels: tuple[str, ...]
) -> tuple[list[Numbers], Ids]:
    """Find vertices of several pieces; numbers for all, and those of the vertices found.

    Raises
    ------
    InvalidMeshError      numbers that came with the pieces, or coordinates, do not tell
    InvalidOptionError    arrays of labels are of several types
    """
    lost = [name for name in labels if name not in kept["cell_data"]]
    if lost:
        msg = f"got pieces whose cell arrays {lost[0]!r} are of several types; expected one in all"
        raise InvalidOptionError(msg)
    known = [np.unique(np.concatenate([part.spreads[name].values for part in taken]))
             for name in labels]
    points = np.ascontiguousarray(np.concatenate([part.points for part in taken]) + 0.0)
    lengths = [len(part.rim) for part in taken]
    piece = np.repeat(np.arange(len(taken)), lengths)
    first = np.cumsum([0, *(part.vertices for part in taken)])[:-1]
    given = [part.ids for part in taken if part.ids is not None]
    came = len(given) == len(taken)
    ids = np.concatenate(given if came else [
        part.rim + start for part, start in zip(taken, first, strict=True)])
    _, one, inverse = np.unique(ids if came else points.view("V24").ravel(),
                                return_index=True, return_inverse=True)
    inverse = inverse.ravel()
    if came:
        _expect_one_place(ids, points, points[one[inverse]])
    members = np.bincount(inverse)
    pieces = np.bincount(np.unique(inverse * len(taken) + piece) // len(taken))
    unclear = np.flatnonzero((pieces > 1) & (members > pieces))
    if len(unclear):
        msg = (f"pieces meet at {counted(len(unclear), 'place')} where one of them has several "
               f"vertices, as at {points[one[unclear[0]]].tolist()}; expected the point array "
               f"{IDS} to tell which of them are one")
        raise InvalidMeshError(msg)
    shared = (pieces > 1)[inverse]
    logarithms = log(np.concatenate([part.sizes for part in taken]))
    sizes = exp(np.bincount(inverse, logarithms) / members)
    scale = float(np.mean([part.mean for part in taken]))
    ends = np.cumsum(lengths)
    numbers = []
    for k, part in enumerate(taken):
        place = slice(ends[k] - lengths[k], ends[k])
        here = inverse[place][shared[place]]
        numbers.append(Numbers(None if came else int(first[k]), part.rim[shared[place]],
                               ids[one[here]], sizes[here], scale, kept, labels, known))
    return numbers, np.unique(ids[one[pieces > 1]])


def _expect_one_place(ids: Ids, points: FloatArray, first: FloatArray) -> None:
    split = np.unique(ids[(points != first).any(axis=1)])
    if len(split):
        msg = (f"{counted(len(split), 'number')} in {IDS} at several places, as {split[0]}; "
               "expected the same coordinates in all pieces, try without that array")
        raise InvalidMeshError(msg)


def _later_round(
    done: Sequence[Done], waiting: Ids, place: Path, options: Options,
    stage: Callable[[str, int], Apply], *, last: bool,
) -> tuple[list[Done], Ids]:
    """Cut off what lies around the vertices that wait, and improve it as pieces of its own.

    In the last round all of it together, else what lies between the same two pieces.
    """
    shared, count, patch = _seams([part.rim for part in done])
    here = np.isin(shared, waiting) & ((patch >= 0) | last)
    chosen, label = shared[here], np.zeros(int(here.sum()), np.int64) if last else patch[here]
    cutting, kept = [], []
    for k, part in enumerate(done):
        mine = np.isin(chosen, part.rim)
        if mine.any():
            cutting.append((part.path, f"{place}-{k}", part.rim, chosen[mine], label[mine]))
        else:
            kept.append(part)
    name = f"round {place.name}"
    cuts: list[Cut] = list(stage(f"{name}: cutting", len(cutting))(split, cutting))
    parts: dict[int, list[str]] = {}
    near: dict[int, list[Ids]] = {}
    for item, found in zip(cutting, cuts, strict=True):
        kept += [found.rest] if found.rest is not None else []
        for seam, path in found.parts:
            parts.setdefault(seam, []).append(path)
            near.setdefault(seam, []).append(item[2])
    jobs = []
    for seam in sorted(parts):
        rows = np.searchsorted(shared, np.unique(np.concatenate(near[seam])))
        jobs.append((parts[seam], f"{place}-seam-{seam}.npz", shared[rows], count[rows], chosen))
    merged: list[Done] = list(stage(name, len(jobs))(partial(merge, options=options), jobs))
    freed = [part.freed for part in merged]
    return [*kept, *merged], np.setdiff1d(waiting, np.concatenate([waiting[:0], *freed]))


def _seams(rims: Sequence[Ids]) -> tuple[Ids, Ids, IntArray]:
    """Ids of all rims, in how many pieces each is, and a label for each pair of pieces, else -1."""
    ids, inverse = np.unique(np.concatenate(rims), return_inverse=True)
    piece = np.repeat(np.arange(len(rims)), [len(rim) for rim in rims])
    count = np.bincount(inverse, minlength=len(ids))
    low = np.full(len(ids), len(rims))
    high = np.full(len(ids), -1)
    np.minimum.at(low, inverse, piece)
    np.maximum.at(high, inverse, piece)
    patch = np.full(len(ids), -1, dtype=np.int32)
    two = count == 2
    patch[two] = np.unique(low[two] * len(rims) + high[two], return_inverse=True)[1]
    return ids, count, patch


def _publish(
    items: Sequence[tuple[str, Numbers | None]], index: Path, folder: Path, write: Any,
    apply: Apply,
) -> None:
    """Write the pieces of the result, move them to their place, then write their index."""
    fresh = folder / "pieces"
    fresh.mkdir()
    files = [fresh / piece_name(index, k) for k in range(len(items))]
    examples = list(apply(write, [(path, file, number)
                                  for (path, number), file in zip(items, files, strict=True)]))
    place_pieces(index, files, examples[0])
