"""The process of inputs of a batch: ``python -m odt_plugins.distributed.job``.

It reads its jobs as JSON from standard input and leaves each result and its row in a work folder;
whoever started it moves them to their places.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from odt_plugins.errors import CrashError, NotFilledWarning, ODTError, ODTWarning
from odt_plugins.processes import ENDED, end_own_group, limit_memory
from odt_plugins.progress import compiling_heard

ROW, RESULT, COMPILING = "row.json", "result", "compiling"
"""What lies in the work folder: the row, the folder of the result, and when kernels were compiled:
times of a monotonic clock at which that began and ended, by turns."""

MOST = 300.0
"""Seconds of compiling, at most, that do not count for a time limit."""

REPORT = ".json"
"""What the name of a result gets for the name of its report."""

PARTLY = "partly filled"
"""Status of a surface whose tetrahedra are written but leave out more than a stated share."""

WRITTEN = ("ok", PARTLY)
"""Status of inputs that have a result."""

REFUSED = ("bad_alloc", "Cannot allocate memory", "Resource temporarily unavailable",
           "out of memory", "failed to map segment", "Memory allocation still failed")
"""What libraries say of memory that the system refuses them, for the stack of a thread as well."""


def main() -> None:
    """Do the jobs, one after the other."""
    told = json.load(sys.stdin)
    threading.Thread(target=_end_with, args=(told["parent"], told["folder"]), daemon=True).start()
    if (most := told["tasks"][0]["memory_limit"]) is not None:
        limit_memory(most)
    for job in told["tasks"]:
        _do(job)


def _do(job: dict[str, Any]) -> None:
    """Do a job and write its row; a failure that Python can catch is a row as well."""
    row: dict[str, Any] = {"status": "failed", "message": ""}
    clock = time.perf_counter()
    try:
        with (
            compiling_heard(note_compiling(Path(job["folder"]))),
            warnings.catch_warnings(record=True) as caught,
        ):
            warnings.simplefilter("always")
            row |= work(job)
        partly = any(issubclass(w.category, NotFilledWarning) for w in caught)
        row |= {"status": PARTLY if partly else "ok", "message": "; ".join(
            str(w.message) for w in caught if issubclass(w.category, ODTWarning))}
    # A toolkit may raise anything at all on a broken input.
    except Exception as exc:
        row["message"] = f"{'' if isinstance(exc, ODTError) else type(exc).__name__ + ': '}{exc}"
        row["outside"] = outside(exc)
        if isinstance(exc, CrashError):
            row["status"] = "crashed"
        if (any(isinstance(cause, MemoryError) for cause in _causes(exc))
                or beyond_limit(row["message"], job["memory_limit"])):
            row |= {"status": "memory", "message": too_little(job["memory_limit"])}
    place = f"{Path(job['folder']) / RESULT}{os.sep}"
    row["message"] = " ".join(row["message"].replace(place, "").split())
    row["seconds"] = time.perf_counter() - clock
    (Path(job["folder"]) / ROW).write_text(json.dumps(row), encoding="utf-8")


def note_compiling(folder: Path) -> Callable[[bool], None]:
    """Give what notes, in a work folder, when a kernel begins and ends to be compiled."""

    def note(_begins: bool) -> None:
        with contextlib.suppress(OSError), (folder / COMPILING).open("a") as file:
            file.write(f"{time.monotonic()}\n")

    return note


def compiling(folder: Path) -> float:
    """Seconds in which the process of a work folder has compiled kernels, at most MOST."""
    times: list[float] = []
    with contextlib.suppress(OSError, ValueError):
        times = [float(line) for line in (folder / COMPILING).read_text().split()]
    if len(times) % 2:
        times.append(time.monotonic())
    return min(MOST, sum(times[1::2]) - sum(times[::2]))


def any_compiles(work: Path) -> bool:
    """Whether a process of a work folder of a run compiles kernels, or has."""
    return any(work.glob(f"*/{COMPILING}"))


def work(job: dict[str, Any]) -> dict[str, Any]:
    """Read, fill with tetrahedra when asked to, improve, write with a report into the work folder.

    Returns
    -------
    dict    seconds, sizes and figures before and after, and why an earlier state was returned
    """
    from odt_plugins.adapters.files import read_file, write_file
    from odt_plugins.api import optimize_with_report
    from odt_plugins.distributed.named import resolve_named
    from odt_plugins.remeshing import remesh_with_report

    source, target = Path(job["source"]), Path(job["folder"]) / RESULT / job["name"]
    # JSON knows no tuples.
    options: Any = {name: tuple(value) if isinstance(value, list) else value
                    for name, value in job["options"].items()}
    row: dict[str, Any] = {}
    clock = time.perf_counter()
    if job["tetrahedralize"]:
        from odt_plugins.generate.fill import fill

        result, report, seconds = fill(
            source, job["levels"], job["edge_length"], options, sizes=job["sizes"])
        row["tetwild_seconds"] = seconds
    else:
        mesh = read_file(source)
        options = resolve_named(source, options)
        clock = time.perf_counter()
        improve = remesh_with_report if job["sizes"] else optimize_with_report
        result, report = improve(mesh, **job["sizes"], **options)
        row |= {"regions_from": ", ".join(report.regions_from),
                "interpolated": ", ".join(report.interpolated)}
    compiled = compiling(Path(job["folder"]))
    row |= {"compile_seconds": compiled, "fallback": report.fallback,
            "optimize_seconds": time.perf_counter() - clock - compiled
            - row.get("tetwild_seconds", 0.0)}
    write_file(target, result)
    target.with_name(target.name + REPORT).write_text(report.to_json() + "\n", encoding="utf-8")
    for when, summary in (("before", report.before), ("after", report.after)):
        row |= {f"{when}_{name}": value for name, value in summary.to_dict().items()}
    return row


def _end_with(parent: int, folder: str) -> None:
    """End this process and what it started once its parent is gone, or its work folder."""
    while os.getppid() == parent and os.path.isdir(folder):
        time.sleep(0.2)
    end_own_group()


def outside(exc: BaseException) -> bool:
    """Whether a failure comes from the system or a missing package, not from the input."""
    # Errors of the system have a number, those of a parser have none. A writer that finds no room
    # may end its process, or leave a file that cannot be read.
    if str(exc).startswith("cannot write"):
        return True
    return any(isinstance(cause, ImportError) or getattr(cause, "errno", None) is not None
               or (isinstance(cause, CrashError) and -cause.code in ENDED)
               for cause in _causes(exc))


def _causes(exc: BaseException | None) -> Iterator[BaseException]:
    """Give an exception, then its causes."""
    while exc is not None:
        yield exc
        exc = exc.__cause__ or exc.__context__


def beyond_limit(message: str, limit: int | None) -> bool:
    """Whether a message tells of memory that a limit refused."""
    return limit is not None and any(words in message for words in REFUSED)


def too_little(limit: int | None) -> str:
    """What the row of an input says that needs more memory."""
    return "not enough memory" if limit is None else f"more than {limit / 1e9:g} GB needed"


if __name__ == "__main__":
    main()
