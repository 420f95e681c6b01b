"""A mesh that fits no memory: its pieces are on disk, the driver knows their interfaces only."""

from __future__ import annotations

import os
import shutil
import tempfile
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from odt_plugins.api import make_options
from odt_plugins.distributed.figures import Figures, total, worse
from odt_plugins.distributed.local import Apply, executor, told
from odt_plugins.distributed.optimize import check, later
from odt_plugins.distributed.piecework import (
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
from odt_plugins.distributed.store import piece_files, write_index
from odt_plugins.errors import DataNotKeptWarning, InvalidOptionError, MeshFileError, writing
from odt_plugins.mesh import IntArray
from odt_plugins.options import Options

REGIONS = "marker"
"""Name of the cell array of labels in the result when none was given."""


class PiecesReport(NamedTuple):
    """What was done to a mesh in pieces.

    Attributes
    ----------
    before, after : Figures     of the whole
    pieces : int                files of the result
    interface : int             vertices of the interfaces of the input: what the driver holds
    fallback : str or None      why the result of an earlier round is returned, when it is
    """

    before: Figures
    after: Figures
    pieces: int
    interface: int
    fallback: str | None

    def __str__(self) -> str:
        """A few lines: the figures before and after."""
        lines = [f"{'':20}{'before':>10}{'after':>10}"]
        for name in ("min_quality", "p1_quality", "mean_quality", "min_angle", "max_angle"):
            a, b = getattr(self.before, name), getattr(self.after, name)
            lines.append(f"{name:20}{a:10.4f}{b:10.4f}")
        lines.append(f"{'cells':20}{self.before.cells:10d}{self.after.cells:10d}")
        lines.append(f"{self.pieces} pieces; {self.interface} vertices on interfaces of the input")
        return "\n".join(lines + ([f"fell back: {self.fallback}"] if self.fallback else []))


def optimize_pieces(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    rounds: int = 3,
    *,
    client: Any = None,
    workers: int = 0,
    odt: Mapping[str, Any] | None = None,
) -> PiecesReport:
    """Improve a mesh of tetrahedra whose pieces are files, without ever holding it as a whole.

    A process holds one piece at a time, or what lies around the seams of some. Pieces have those
    vertices in common whose coordinates are the same bits.

    Parameters
    ----------
    source : path
        A .pvtu file without ghost cells, or a directory of .vtu files.
    target : path
        A .pvtu file; its pieces go into a directory of its name beside it. What lies around the
        interfaces of the input comes as pieces of its own. Vertices of several pieces have the
        same number in the point array GlobalPointIds; coordinates are float64.
    rounds : int
        See :func:`odt_plugins.optimize_partitioned`; in the last one a single process holds what
        lies around the curves where three pieces meet.
    client, workers
        As there; workers of a cluster see the files under the same paths.
    odt : dict, optional
        Options of :func:`odt_plugins.optimize` that every piece can tell: no arrays, and of the
        densities "keep" and "uniform". Its `progress` is told the stage ("reading", "round 1",
        "round 2: cutting", "round 2", ..., "writing") and the share of the pieces that is done.

    Returns
    -------
    PiecesReport

    Raises
    ------
    MeshFileError             a file cannot be read or written; `target` is then as it was before
    InvalidMeshError, UnsupportedMeshError, InvalidOptionError, WorkerError

    Warns
    -----
    DataNotKeptWarning        cell arrays beside the regions do not come through
    """
    options = make_options(**(odt or {}))
    check(1, rounds, workers, options, several=False)
    _check_for_pieces(options)
    sources, index = piece_files(source), Path(target).absolute()
    if index.suffix != ".pvtu":
        msg = f"cannot write {target}: expected a file ending in .pvtu"
        raise MeshFileError(msg)
    folder = None
    try:
        with writing(target, "another directory"):
            folder = Path(tempfile.mkdtemp(prefix=f".{index.stem}-", dir=index.parent))
            with executor(client, workers) as apply:
                return _run(sources, index, folder, rounds, options, apply)
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


def _check_for_pieces(options: Options) -> None:
    for name in ("fixed", "selection"):
        if getattr(options, name) is not None:
            msg = f"got {name} for a mesh in pieces; expected options that every piece can tell"
            raise InvalidOptionError(msg)
    if not isinstance(options.regions, str | None):
        msg = "got an array of regions for a mesh in pieces; expected the name of a cell array"
        raise InvalidOptionError(msg)
    if not isinstance(options.density, str) or options.density not in ("keep", "uniform"):
        msg = "got a density that no piece can tell; expected 'keep' or 'uniform'"
        raise InvalidOptionError(msg)


def _run(
    sources: Sequence[str], index: Path, folder: Path, rounds: int, options: Options, apply: Apply
) -> PiecesReport:
    named = options.regions if isinstance(options.regions, str) else None
    report, options = options.progress, replace(options, regions=None, progress=None)

    def stage(name: str, count: int) -> Apply:
        return told(apply, report, name, count)

    read = stage("reading", len(sources))
    taken: list[Taken] = list(read(partial(take_in, regions=named), [
        (path, str(folder / f"0-{k}.npz")) for k, path in enumerate(sources)]))
    names = {part.regions for part in taken}
    if len(names) > 1:
        msg = f"got pieces with labels in different cell arrays ({names}); expected one name in all"
        raise InvalidOptionError(msg)
    name = names.pop() or REGIONS
    _tell_lost(taken)
    numbers, waiting = _number(taken)
    improve = stage("round 1", len(taken))
    done: list[Done] = list(improve(partial(first_round, options=options), [
        (part.path, str(folder / f"1-{k}.npz"), number)
        for k, (part, number) in enumerate(zip(taken, numbers, strict=True))]))
    before = total([part.figures for part in taken])
    interface = len(waiting)
    states = [[part.path for part in taken], [part.path for part in done]]
    after = [before, total([part.figures for part in done])]
    for turn in range(2, rounds + 1):
        done, waiting = _later_round(done, waiting, folder / str(turn), later(options), stage,
                                     last=turn == rounds)
        states.append([part.path for part in done])
        after.append(total([part.figures for part in done]))
    broken: list[str] = []
    while len(states) > 1 and (now := worse(before, after[-1], options.keep)):
        broken = now
        states.pop()
        after.pop()
    _publish(states[-1], index, folder, partial(
        publish, regions=name, orientation=taken[0].orientation), stage("writing", len(states[-1])))
    fallback = f"a later round was given up ({'; '.join(broken)})" if broken else None
    return PiecesReport(before, after[-1], len(states[-1]), interface, fallback)


def _tell_lost(taken: Sequence[Taken]) -> None:
    lost = sorted({name for part in taken for name in part.lost})
    if lost:
        msg = f"of cell arrays only regions come through pieces, not {', '.join(lost)}"
        warnings.warn(msg, DataNotKeptWarning, stacklevel=4)


def _number(taken: Sequence[Taken]) -> tuple[list[Numbers], Ids]:
    """Find vertices of several pieces by their coordinates; numbers for all, and their ids."""
    points = np.ascontiguousarray(np.concatenate([part.points for part in taken]) + 0.0)
    first = np.cumsum([0, *(part.vertices for part in taken)])
    ids = np.concatenate([part.rim + start for part, start in zip(taken, first[:-1], strict=True)])
    _, one, inverse, count = np.unique(
        points.view("V24").ravel(), return_index=True, return_inverse=True, return_counts=True)
    inverse = inverse.ravel()
    sizes = np.exp(np.bincount(inverse, np.log(np.concatenate([p.sizes for p in taken]))) / count)
    scale = float(np.mean([part.mean for part in taken]))
    numbers = []
    start = 0
    for part, offset in zip(taken, first[:-1], strict=True):
        here = inverse[start : start + len(part.rim)]
        start += len(part.rim)
        shared = count[here] > 1
        numbers.append(Numbers(int(offset), part.rim[shared], ids[one[here[shared]]],
                               sizes[here[shared]], scale))
    return numbers, np.unique(ids[one[count > 1]])


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
    cuts = list(stage(f"{name}: cutting", len(cutting))(split, cutting))
    parts: dict[int, list[str]] = {}
    near: dict[int, list[Ids]] = {}
    for item, cut in zip(cutting, cuts, strict=True):
        kept += [cut.rest] if cut.rest is not None else []
        for seam, path in cut.parts:
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


def _publish(paths: Sequence[str], index: Path, folder: Path, write: Any, apply: Apply) -> None:
    """Write the pieces of the result, move them to their place, then write what names them."""
    fresh = folder / "pieces"
    fresh.mkdir()
    names = [f"{index.stem}-{k}.vtu" for k in range(len(paths))]
    examples = list(apply(write, [(path, fresh / name)
                                  for path, name in zip(paths, names, strict=True)]))
    places = [index.with_name(f"{index.stem}{tail}") for tail in ("", "-new")]
    place, other = places if not places[0].exists() else places[::-1]
    if place.exists():
        shutil.rmtree(place)
    os.replace(fresh, place)
    write_index(index, [f"{place.name}/{name}" for name in names], examples[0],
                write.keywords["regions"])
    if other.is_dir():
        shutil.rmtree(other)
