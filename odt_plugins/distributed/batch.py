"""A batch of meshes: whatever becomes of an input is a row in a table.

Small inputs share a process. Where one of them ends it, those that are left have each its own.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from glob import glob
from pathlib import Path
from typing import Any

from odt_plugins.adapters.files import chosen_format, expect_same_kind
from odt_plugins.adapters.meshio_mesh import one_cell
from odt_plugins.distributed.job import (
    REPORT,
    RESULT,
    ROW,
    WRITTEN,
    any_compiles,
    beyond_limit,
    compiling,
    too_little,
)
from odt_plugins.distributed.keys import drop_earlier, job_key, placed, read_alone
from odt_plugins.distributed.local import pool_of
from odt_plugins.distributed.scratch import clear, make_scratch
from odt_plugins.distributed.versions import expect_versions, versions_here
from odt_plugins.errors import InvalidOptionError, MeshFileError, exit_name, expect
from odt_plugins.options import COMPILING, EDGE_LENGTH, make_options
from odt_plugins.processes import ENDED, GROUP, end_group, expect_limits
from odt_plugins.progress import silent
from odt_plugins.tetwild import expect_pytetwild

HIDDEN = ".batch"
"""Folder within the output: rows of what is done, and a work folder for every run."""

SMALL, TOGETHER = 1 << 20, 32
"""Most bytes of an input that shares a process, and most inputs that share one."""

EACH = 4
"""Processes for each worker, at least, among which small inputs are divided."""

LOOKED = 0.02
"""Seconds between two looks at whether a row is there."""

TOLD, SAID = "told.json", "said"
"""Files of the folder of a process: what it is to do, and what it says on stderr."""

WATCHED = 0.5
"""Seconds between two looks at whether kernels are compiled."""

Row = dict[str, Any]


class Stopped(KeyboardInterrupt):
    """A batch was stopped; ``rows`` tells of all its inputs, those that were not done as well."""

    def __init__(self, rows: list[Row]) -> None:
        super().__init__()
        self.rows = rows


@dataclass(frozen=True)
class Job:
    """One input of a batch.

    Attributes
    ----------
    source : str                 absolute path of the input
    out : str                    absolute path of the output folder
    name : str                   path of the result within it
    options : dict               of `odt_plugins.optimize`, plain values
    tetrahedralize : bool        whether TetWild fills the surface first
    edge_length : float          for TetWild, relative to the diagonal
    levels : int                 how often the mesh of TetWild is refined
    sizes : dict                 of `odt_plugins.remesh`
    timeout : float or None      seconds after which it is ended, not counting those in which the
                                 kernels were compiled
    memory_limit : int or None   bytes that its process may take
    resume : bool                whether what is done already is left as it is, failures of the
                                 same time and memory limit as well
    retry : bool                 whether failures are tried again
    work : str                   absolute path of the work folder of its run
    versions : dict              of the packages that compute, as they are where the run began
    """

    source: str
    out: str
    name: str
    options: dict[str, Any]
    tetrahedralize: bool = False
    edge_length: float = EDGE_LENGTH
    levels: int = 0
    sizes: dict[str, Any] = field(default_factory=dict)
    timeout: float | None = None
    memory_limit: int | None = None
    resume: bool = False
    retry: bool = False
    work: str = ""
    versions: dict[str, str] = field(default_factory=dict)


def find_inputs(patterns: Sequence[str], out: Path | None = None) -> list[str]:
    """List the meshes that paths and patterns such as models/**/*.stl name.

    Parameters
    ----------
    patterns : list of str
    out : path, optional     patterns leave out what an earlier batch wrote into this folder

    Raises
    ------
    InvalidOptionError       one names no file, or a folder
    """
    found: list[str] = []
    for pattern in patterns:
        if os.path.isdir(pattern):
            msg = (f"got the folder {pattern!r}; expected files or a pattern, try "
                   f"{os.path.join(pattern, '*.vtu')!r}")
            raise InvalidOptionError(msg)
        paths = [pattern] if os.path.exists(pattern) else [
            path for path in sorted(glob(pattern, recursive=True))
            if os.path.isfile(path) and not (out and _is_result(path, out))]
        if not paths:
            msg = f"got {pattern!r}, which names no file; expected a path or a pattern"
            raise InvalidOptionError(msg)
        found += paths
    return read_alone(found)


def _is_result(path: str, out: Path) -> bool:
    name = os.path.relpath(path, out)
    if name.startswith(os.pardir):
        return False
    return any(_row_file(out, one).is_file() for one in (name, name.removesuffix(REPORT)))


def make_jobs(
    sources: Sequence[str], out: Path, options: Mapping[str, Any], *, suffix: str | None = None,
    **settings: Any,
) -> list[Job]:
    """List the jobs of a batch; results lie in the output as the inputs do in their folder.

    Parameters
    ----------
    sources : paths
    out : path
    options : dict               of :func:`odt_plugins.optimize`
    suffix : str or None         of the results; unless given that of the input, .vtu of tetrahedra
    **settings                   other fields of :class:`Job`

    Raises
    ------
    InvalidOptionError           an option is wrong, or holds an array, which fits one mesh only;
                                 or a result would take the place of an input
    MeshFileError                the suffix is none of files that hold such meshes
    """
    filled = bool(settings.get("tetrahedralize"))
    make_options(**{name: value for name, value in options.items()
                    if filled or name != "density" or not isinstance(value, str)})
    if suffix:
        good = suffix[0] == "." and Path(suffix).name == suffix
        expect(good, "suffix", suffix, "one with its dot, as .vtu")
        chosen_format(Path(f"suffix={suffix}"))
    options = placed(options)
    sizes = settings.get("sizes", {})
    if settings.get("tetrahedralize"):
        from odt_plugins.generate.fill import check_fill

        check_fill(settings.get("levels", 0), settings.get("edge_length", EDGE_LENGTH), options,
                   sizes)
    elif settings.get("levels"):
        msg = (f"got levels={settings['levels']} for meshes that are there; expected "
               "tetrahedralize=True beside it")
        raise InvalidOptionError(msg)
    elif sizes:
        from odt_plugins.remeshing import check_sizes

        check_sizes(**sizes, **options)
    for option, value in {**options, **sizes}.items():
        if not isinstance(value, str | int | float | tuple | dict | None):
            msg = f"got {option} of type {type(value).__name__}; expected a plain value"
            raise InvalidOptionError(msg)
    paths = sorted({os.path.abspath(source) for source in sources})
    top = os.path.commonpath([os.path.dirname(path) for path in paths])
    jobs: list[Job] = []
    taken: set[str] = set()
    inputs = {os.path.realpath(path) for path in paths}
    for path in paths:
        inner = Path(os.path.relpath(path, top))
        ending = suffix or (".vtu" if settings.get("tetrahedralize") else inner.suffix)
        name = inner.with_suffix(ending)
        while str(name) in taken:
            name = inner = inner.with_name(inner.name.replace(".", "-") + ending)
        if os.path.realpath(out / name) in inputs:
            msg = (f"got {out} for the results, where {name} would take the place of an input; "
                   "expected another folder")
            raise InvalidOptionError(msg)
        if suffix or filled:
            expect_same_kind(one_cell(4) if filled else path, name)
        taken.add(str(name))
        jobs.append(Job(path, os.path.realpath(out), str(name), dict(options), **settings))
    return jobs


def run_batch(
    jobs: Sequence[Job],
    *,
    client: Any = None,
    workers: int = 0,
    progress: Callable[[str, float], None] | None = None,
) -> list[Row]:
    """Run all jobs: one after the other, by processes of this machine, or on a cluster.

    Small inputs share a process.

    Parameters
    ----------
    jobs : list of Job         see :func:`make_jobs`
    client : distributed.Client, optional
                               its workers see the same files under the same paths
    workers : int              processes of this machine that work at a time; 0 for one after the
                               other
    progress : callable        is told "3 of 40" and the share; and once, from another thread, that
                               kernels are compiled

    Returns
    -------
    list of dict               one row for every job, in their order: source, result, status
                               ("ok", "partly filled", "failed", "crashed", "timeout",
                               "memory", "lost", "stopped"), message, seconds, figures before
                               and after

    Raises
    ------
    MeshFileError              the output folder cannot be made
    InvalidOptionError         a worker has other packages than this process; a limit of memory on
                               a system without such limits
    MissingDependencyError     pytetwild is needed on this machine and not installed
    Stopped                    from a KeyboardInterrupt, with the rows of what was finished
    """
    if not jobs:
        return []
    here = client is None or client.cluster is not None
    if here and any(job.tetrahedralize for job in jobs):
        expect_pytetwild()
    if here and any(job.memory_limit is not None for job in jobs):
        expect_limits()
    hidden = Path(jobs[0].out) / HIDDEN
    try:
        hidden.mkdir(parents=True, exist_ok=True)
        work = make_scratch(hidden, "work")
        with tempfile.TemporaryFile(dir=work):
            pass
    except OSError as exc:
        msg = f"cannot write into {jobs[0].out}: {exc.strerror or exc}; try another folder"
        raise MeshFileError(msg) from exc
    versions = versions_here()
    jobs = [replace(job, work=str(work), versions=versions) for job in jobs]
    rows: list[Row] = [{} for _ in jobs]
    stop = None
    tell = progress or silent
    tell(f"0 of {len(jobs)}", 0.0)
    try:
        with _compiling_told(work, tell):
            for done, (index, row) in enumerate(_as_they_finish(jobs, client, workers), 1):
                if isinstance(row, InvalidOptionError):
                    raise row
                if isinstance(row, BaseException):
                    row = _row(jobs[index], {"status": "lost", "message": str(row)})
                rows[index] = row
                tell(f"{done} of {len(jobs)}", done / len(jobs))
    except KeyboardInterrupt as exc:
        stop = exc
    finally:
        clear(work)
    if stop is not None:
        told = [row or _not_done(job) for job, row in zip(jobs, rows, strict=True)]
        raise Stopped(told) from stop
    return rows


@contextlib.contextmanager
def _compiling_told(work: Path, tell: Callable[[str, float], None]) -> Iterator[None]:
    """Tell once that kernels are compiled, when a process does that."""
    over = threading.Event()

    def watch() -> None:
        while not over.wait(WATCHED):
            if any_compiles(work):
                tell(COMPILING, 0.0)
                return

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def _not_done(job: Job) -> Row:
    """The row of an input that a batch did not come to: one that is there where it still holds."""
    with contextlib.suppress(OSError):
        if old := _recorded(job, job_key(job)):
            return old | {"resumed": True}
    return _row(job, {"status": "stopped", "message": "the batch was stopped before its end"})


def _as_they_finish(jobs: Sequence[Job], client: Any, workers: int) -> Iterator[tuple[int, Any]]:
    """Rows of jobs, on the workers or on this machine; small inputs share a process."""
    if client is None and not workers:
        for group in share_out(jobs):
            yield from _run_group({index: jobs[index] for index in group})
        return
    if client is None:
        groups = [{index: jobs[index] for index in group}
                  for group in share_out(jobs, max(1, len(jobs) // (EACH * workers)))]
        with pool_of(workers) as pool:
            for done in pool.imap_unordered(_list_group, groups):
                yield from done
        return
    from odt_plugins.distributed.cluster import as_they_finish, check_workers

    most = max(1, len(jobs) // (EACH * check_workers(client)))
    groups = [{index: jobs[index] for index in group} for group in share_out(jobs, most)]
    for place, rows in as_they_finish(client, _list_group, groups):
        yield from ([(index, rows) for index in groups[place]]
                    if isinstance(rows, BaseException) else rows)


def _list_group(jobs: Mapping[int, Job]) -> list[tuple[int, Row]]:
    return list(_run_group(jobs))


def _run_group(jobs: Mapping[int, Job]) -> Iterator[tuple[int, Row]]:
    if len(jobs) > 1:
        yield from _run_shared(jobs)
        return
    for index, job in jobs.items():
        yield index, run_job(job)


def share_out(jobs: Sequence[Job], most: int = TOGETHER) -> list[list[int]]:
    """Group jobs, by their indices, so that the inputs of a group share a process.

    Inputs of at most SMALL bytes share one, at most TOGETHER of them, and no more than `most`; none
    does whose memory is limited, or that TetWild fills.
    """
    groups: list[list[int]] = []
    open_group: list[int] = []
    for index, job in enumerate(jobs):
        size = SMALL + 1
        with contextlib.suppress(OSError):
            size = os.stat(job.source).st_size
        if job.memory_limit is not None or job.tetrahedralize or size > SMALL:
            groups.append([index])
            continue
        if not open_group or len(open_group) == min(most, TOGETHER):
            open_group = []
            groups.append(open_group)
        open_group.append(index)
    return groups


def run_job(job: Job) -> Row:
    """Run one job in a process of its own; whatever happens is told in its row.

    The result and then its row are renamed to their places when they are complete, so that a row
    tells of a result that is there. The row of a failure is kept as well, unless its cause is
    outside of the input: a full disk, a missing package, a signal from elsewhere.

    Raises
    ------
    InvalidOptionError    the packages here are not those of the process that began the run
    """
    started = _begun(job)
    if isinstance(started, dict):
        return started
    key, folder = started
    return _ended_row(job, key, folder, lambda: _process(job, folder))


def _begun(job: Job) -> Row | tuple[str, Path]:
    """The row of a job that needs no work, else its key and its work folder."""
    expect_versions(job.versions)
    try:
        key = job_key(job)
    except OSError as exc:
        message = f"cannot read {job.source}: {exc.strerror or exc}"
        return _row(job, {"status": "failed", "message": message})
    if job.resume and (old := _recorded(job, key)):
        return old | {"resumed": True}
    try:
        folder = Path(tempfile.mkdtemp(dir=job.work))
        (folder / RESULT).mkdir()
    except OSError as exc:
        return _unwritten(job, exc)
    return key, folder


def _unwritten(job: Job, exc: OSError) -> Row:
    message = f"cannot write {Path(job.out) / job.name}: {exc.strerror or exc}"
    return _row(job, {"status": "failed", "message": message})


def _ended_row(job: Job, key: str, folder: Path, facts_of: Callable[[], Row]) -> Row:
    """Move the result of a work folder and its row to their places; the folder goes."""
    place, target = _row_file(Path(job.out), job.name), Path(job.out) / job.name
    try:
        facts = facts_of()
        outside = facts.pop("outside", False)
        parts = sorted((folder / RESULT).iterdir(), key=lambda part: part.name == target.name)
        row = _row(job, {"key": key, "limits": [job.timeout, job.memory_limit],
                         "files": [part.name for part in parts]} | facts)
        if row["status"] not in WRITTEN and target.exists():
            row["message"] += f"; {job.name} is there from an earlier run"
        (folder / ROW).write_text(json.dumps(row), encoding="utf-8")
        place.parent.mkdir(parents=True, exist_ok=True)
        drop_earlier(place, target, row)
        if row["status"] in WRITTEN:
            target.parent.mkdir(parents=True, exist_ok=True)
            # Companions, such as those of xdmf, come before what refers to them.
            for part in parts:
                os.replace(part, target.parent / part.name)
        if not outside:
            os.replace(folder / ROW, place)
    except OSError as exc:
        return _unwritten(job, exc)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return row


def _run_shared(jobs: Mapping[int, Job]) -> Iterator[tuple[int, Row]]:
    """Run jobs in one process; if it ends early, each job that is left runs in its own."""
    waiting: list[tuple[int, str, Path]] = []
    for index, job in jobs.items():
        started = _begun(job)
        if isinstance(started, dict):
            yield index, started
        else:
            waiting.append((index, *started))
    if not waiting:
        return
    first = jobs[waiting[0][0]]
    with (
        contextlib.suppress(OSError),
        tempfile.TemporaryDirectory(dir=first.work, ignore_cleanup_errors=True) as name,
    ):
        process = _start(Path(name), [_task(jobs[index], folder) for index, _, folder in waiting])
        since = time.monotonic()
        try:
            while waiting:
                index, key, folder = waiting[0]
                over = process.poll() is not None
                facts = _written(folder)
                if facts is None and not over:
                    late = first.timeout is not None and (
                        since + first.timeout + compiling(folder) <= time.monotonic())
                    if not late:
                        time.sleep(LOOKED)
                        continue
                    facts = _too_late(first.timeout, since)
                if facts is None or facts["status"] == "memory":
                    break
                yield index, _ended_row(jobs[index], key, folder, facts.copy)
                waiting.pop(0)
                since = time.monotonic()
                if facts["status"] == "timeout":
                    break
        finally:
            end_group(process)
    for index, _, folder in waiting:
        shutil.rmtree(folder, ignore_errors=True)
        yield index, run_job(jobs[index])


def _row_file(out: Path, name: str) -> Path:
    return out / HIDDEN / "rows" / f"{name}.json"


def _recorded(job: Job, key: str) -> Row | None:
    """The row of an earlier run, when nothing would be otherwise now."""
    with contextlib.suppress(OSError, ValueError):
        old: Row = json.loads(_row_file(Path(job.out), job.name).read_text(encoding="utf-8"))
        if old["status"] in WRITTEN:
            target = Path(job.out) / job.name
            same = all(target.with_name(name).is_file()
                       for name in old.get("files", [target.name]))
        else:
            same = not job.retry and old["limits"] == [job.timeout, job.memory_limit]
        if same and old["key"] == key:
            return old
    return None


def _row(job: Job, facts: Row) -> Row:
    base = {"source": job.source, "result": job.name, "status": "failed", "message": "",
            "seconds": None, "resumed": False}
    return base | facts


def _task(job: Job, folder: Path) -> Row:
    """What the process of a job is told of it."""
    task = asdict(job) | {"folder": str(folder), "name": Path(job.name).name}
    task["options"] = {"threads": 1} | job.options
    return task


def _start(folder: Path, tasks: list[Row]) -> subprocess.Popen[str]:
    """Start the process of some jobs; what it says on stderr is a file of the folder."""
    threads = str(tasks[0]["options"]["threads"])
    (folder / "temporary").mkdir()
    environment = dict(os.environ) | dict.fromkeys(
        ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), threads)
    # What a process that is ended leaves there goes with its folder.
    environment |= dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder / "temporary"))
    told = {"folder": str(folder), "parent": os.getpid(), "tasks": tasks}
    (folder / TOLD).write_text(json.dumps(told), encoding="utf-8")
    with (
        (folder / TOLD).open(encoding="utf-8") as given,
        (folder / SAID).open("w", encoding="utf-8") as said,
    ):
        return subprocess.Popen(
            [sys.executable, "-m", "odt_plugins.distributed.job"], text=True, env=environment,
            stdin=given, stdout=subprocess.DEVNULL, stderr=said, **GROUP,
        )


def _written(folder: Path) -> Row | None:
    """The row that a process has written, None as long as it is not there as a whole."""
    with contextlib.suppress(OSError, ValueError):
        written: Row = json.loads((folder / ROW).read_text(encoding="utf-8"))
        return written
    return None


def _too_late(timeout: float | None, clock: float) -> Row:
    return {"status": "timeout", "message": f"no result within {timeout:g} s",
            "seconds": time.monotonic() - clock}


def _process(job: Job, folder: Path) -> Row:
    """Run the process of a job to its end, or end it with everything it started."""
    clock = time.monotonic()
    process = _start(folder, [_task(job, folder)])
    try:
        _wait(process, clock, job.timeout, folder)
    except subprocess.TimeoutExpired:
        return _too_late(job.timeout, clock)
    finally:
        end_group(process)
    if (written := _written(folder)) is not None:
        return written
    said = (folder / SAID).read_text(encoding="utf-8", errors="replace")
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    message = f"ended by {exit_name(process.returncode)}: {lines[-1] if lines else 'no word'}"
    row: Row = {"status": "crashed", "message": message, "seconds": time.monotonic() - clock,
           "outside": -process.returncode in ENDED}
    if beyond_limit(said, job.memory_limit):
        row |= {"status": "memory", "message": too_little(job.memory_limit)}
    return row


def _wait(
    process: subprocess.Popen[str], clock: float, timeout: float | None, folder: Path
) -> None:
    """Wait for the end of a process.

    Raises
    ------
    subprocess.TimeoutExpired    it took longer, not counting what it spent on compiling kernels
    """
    while True:
        left = None
        if timeout is not None:
            left = max(0.0, clock + timeout + compiling(folder) - time.monotonic())
        try:
            process.wait(left)
            return
        except subprocess.TimeoutExpired:
            if clock + (timeout or 0.0) + compiling(folder) <= time.monotonic():
                raise
