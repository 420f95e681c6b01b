"""A batch of meshes, every input in a process of its own: its end is a row in a table."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from glob import glob
from pathlib import Path
from typing import Any

from odt_plugins.adapters.files import check_output
from odt_plugins.api import make_options
from odt_plugins.compare.runner import exit_name
from odt_plugins.distributed.job import ROW
from odt_plugins.distributed.versions import versions_here
from odt_plugins.errors import InvalidOptionError, MeshFileError

HIDDEN = ".batch"
"""Folder within the output: rows of what is done, and work folders while it is being done."""

Row = dict[str, Any]


@dataclass(frozen=True)
class Job:
    """One input of a batch.

    Attributes
    ----------
    source : str                 absolute path of the input
    out : str                    absolute path of the output folder
    name : str                   path of the result within it
    options : dict               of :func:`odt_plugins.optimize`, plain values
    tetrahedralize : bool        whether TetWild fills the surface first
    edge_length : float          for TetWild, relative to the diagonal
    timeout : float or None      seconds after which it is ended
    memory_limit : int or None   bytes that its process may take
    resume : bool                whether what is done already is left as it is
    """

    source: str
    out: str
    name: str
    options: dict[str, Any]
    tetrahedralize: bool = False
    edge_length: float = 0.05
    timeout: float | None = None
    memory_limit: int | None = None
    resume: bool = False


def find_inputs(patterns: Sequence[str]) -> list[str]:
    """List the files that paths and patterns such as models/**/*.stl name.

    Raises
    ------
    InvalidOptionError       one names no file
    """
    found: list[str] = []
    for pattern in patterns:
        paths = [pattern] if os.path.exists(pattern) else sorted(glob(pattern, recursive=True))
        if not paths:
            msg = f"got {pattern!r}, which names no file; expected a path or a pattern"
            raise InvalidOptionError(msg)
        found += paths
    return found


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
    suffix : str or None         of the results; unless given that of the input, for tetrahedra
                                 .vtu
    **settings                   other fields of :class:`Job`

    Raises
    ------
    InvalidOptionError           an option is wrong, or holds an array, which fits one mesh only
    MeshFileError                the suffix is none of a mesh file
    """
    make_options(**options)
    for option, value in options.items():
        if not isinstance(value, str | int | float | tuple | None):
            msg = f"got {option} of type {type(value).__name__}; expected a plain value for a batch"
            raise InvalidOptionError(msg)
    paths = sorted({os.path.abspath(source) for source in sources})
    top = os.path.commonpath([os.path.dirname(path) for path in paths])
    jobs: list[Job] = []
    taken: set[str] = set()
    for path in paths:
        inner = Path(os.path.relpath(path, top))
        ending = suffix or (".vtu" if settings.get("tetrahedralize") else inner.suffix)
        name = inner.with_suffix(ending)
        if str(name) in taken:
            name = inner.with_name(inner.name.replace(".", "-") + ending)
        taken.add(str(name))
        jobs.append(Job(path, os.path.abspath(out), str(name), dict(options), **settings))
    if suffix:
        check_output(Path(tempfile.gettempdir()) / f"x{suffix}")
    return jobs


def run_batch(
    jobs: Sequence[Job],
    *,
    client: Any = None,
    progress: Callable[[str, float], None] | None = None,
) -> list[Row]:
    """Run all jobs, one after the other here, or on the workers of a cluster.

    Parameters
    ----------
    jobs : list of Job         see :func:`make_jobs`
    client : distributed.Client, optional
                               its workers see the same files under the same paths
    progress : callable        is told "3 of 40" and the share

    Returns
    -------
    list of dict               one row for every job, in their order: source, result, status
                               ("ok", "failed", "crashed", "timeout", "memory", "lost"), message,
                               seconds, figures before and after

    Raises
    ------
    MeshFileError              the output folder cannot be made
    InvalidOptionError         a worker has other packages than this process
    """
    if not jobs:
        return []
    hidden = Path(jobs[0].out) / HIDDEN
    try:
        shutil.rmtree(hidden / "work", ignore_errors=True)
        (hidden / "work").mkdir(parents=True)
        with tempfile.TemporaryFile(dir=hidden):
            pass
    except OSError as exc:
        msg = f"cannot write into {jobs[0].out}: {exc.strerror or exc}; try another folder"
        raise MeshFileError(msg) from exc
    rows: list[Row] = [{} for _ in jobs]
    try:
        for done, (index, row) in enumerate(_as_they_finish(jobs, client), 1):
            if isinstance(row, BaseException):
                row = _row(jobs[index], {"status": "lost", "message": str(row)})
            rows[index] = row
            if progress is not None:
                progress(f"{done} of {len(jobs)}", done / len(jobs))
    finally:
        shutil.rmtree(hidden / "work", ignore_errors=True)
    return rows


def _as_they_finish(jobs: Sequence[Job], client: Any) -> Iterator[tuple[int, Any]]:
    if client is None:
        return ((index, run_job(job)) for index, job in enumerate(jobs))
    from odt_plugins.distributed.cluster import as_they_finish, check_workers

    check_workers(client)
    return as_they_finish(client, run_job, jobs)


def run_job(job: Job) -> Row:
    """Run one job in a process of its own; whatever happens is told in its row.

    The result and then its row are renamed to their places when they are complete, so that a row
    tells of a result that is there.
    """
    try:
        key = job_key(job)
    except OSError as exc:
        message = f"cannot read {job.source}: {exc.strerror or exc}"
        return _row(job, {"status": "failed", "message": message})
    place = Path(job.out) / HIDDEN / "rows" / f"{job.name}.json"
    target = Path(job.out) / job.name
    if job.resume:
        with contextlib.suppress(OSError, ValueError):
            old: Row = json.loads(place.read_text(encoding="utf-8"))
            if old["key"] == key and target.is_file():
                return old | {"resumed": True}
    folder = ""
    try:
        folder = tempfile.mkdtemp(dir=Path(job.out) / HIDDEN / "work")
        row = _row(job, {"key": key} | _process(job, Path(folder)))
        if row["status"] == "ok":
            place.parent.mkdir(parents=True, exist_ok=True)
            target.parent.mkdir(parents=True, exist_ok=True)
            (Path(folder) / ROW).write_text(json.dumps(row), encoding="utf-8")
            place.unlink(missing_ok=True)
            # Formats such as xdmf write companions; the file that refers to them comes last.
            for part in sorted(Path(folder).iterdir(), key=lambda p: p.name == target.name):
                if part.name != ROW:
                    os.replace(part, target.parent / part.name)
            os.replace(Path(folder) / ROW, place)
    except OSError as exc:
        message = f"cannot write {target}: {exc.strerror or exc}"
        return _row(job, {"status": "failed", "message": message})
    finally:
        if folder:
            shutil.rmtree(folder, ignore_errors=True)
    return row


def job_key(job: Job) -> str:
    """Name what decides a result: the bytes of the input, the options, and the versions."""
    digest = hashlib.sha256()
    with open(job.source, "rb") as file:
        while chunk := file.read(1 << 20):
            digest.update(chunk)
    options = {name: value for name, value in job.options.items() if name != "threads"}
    rest = [options, job.name, job.tetrahedralize, job.edge_length, versions_here()]
    digest.update(json.dumps(rest, sort_keys=True).encode())
    return digest.hexdigest()


def _row(job: Job, facts: Row) -> Row:
    base = {"source": job.source, "result": job.name, "status": "failed", "message": "",
            "seconds": None, "resumed": False}
    return base | facts


def _process(job: Job, folder: Path) -> Row:
    """Run the process of a job to its end, or end it with everything it started."""
    threads = str(job.options.get("threads", 1))
    environment = dict(os.environ) | dict.fromkeys(
        ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), threads)
    task = asdict(job) | {"folder": str(folder), "name": Path(job.name).name,
                          "parent": os.getpid()}
    task["options"] = {"threads": 1} | job.options
    process = subprocess.Popen(
        [sys.executable, "-m", "odt_plugins.distributed.job"], text=True, env=environment,
        stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        _, said = process.communicate(json.dumps(task), timeout=job.timeout)
    except subprocess.TimeoutExpired:
        return {"status": "timeout", "message": f"no result within {job.timeout:g} s",
                "seconds": job.timeout}
    finally:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    with contextlib.suppress(OSError, ValueError):
        row: Row = json.loads((folder / ROW).read_text(encoding="utf-8"))
        return row
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    message = f"ended by {exit_name(process.returncode)}: {lines[-1] if lines else 'no word'}"
    return {"status": "crashed", "message": message}
