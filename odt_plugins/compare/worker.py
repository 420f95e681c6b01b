"""The process in which one contestant runs: ``python -m odt_plugins.compare.worker FOLDER``.

FOLDER holds job.json and start.npz; result.json and one mesh per repeat are written beside them.
It becomes the working directory, so whatever a tool leaves behind goes with it.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from odt_plugins.processes import cpu_seconds, peak_memory

RESULT = "result.json"

READY = "ready"
"""File that a worker leaves when the time limit begins to count."""


def run_job(folder: Path) -> None:
    """Run the job of a folder and leave its result there, also when the contestant fails.

    The result is written anew after every repeat, so that what was finished survives a crash or
    the time limit.
    """
    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    result: dict[str, Any] = {"status": "crashed", "message": "", "seconds": [], "cpu": [],
                              "convert": [], "import": None, "compile": None,
                              "peak_before": None, "peak": None}
    try:
        _repeat(job, folder, result)
        result["status"] = "ok"
    except Exception as exc:
        from odt_plugins.compare.baselines.task import NotPossibleError

        missing = isinstance(exc, ModuleNotFoundError) and not str(exc.name).startswith("odt_")
        result["status"] = ("unsupported" if isinstance(exc, NotPossibleError)
                            else "missing" if missing else "failed")
        detail = " ".join(str(exc).split())
        named = isinstance(exc, NotPossibleError | ModuleNotFoundError)
        result["message"] = detail if named else f"{type(exc).__name__}: {detail}"
    _write(folder, result)


def _repeat(job: dict[str, Any], folder: Path, result: dict[str, Any]) -> None:
    from odt_plugins.compare.start import StartMesh

    points, cells, regions = load_mesh(folder / "start.npz")
    start = StartMesh(job["mesh"], job["kind"], points, cells, regions=regions)
    settings = {**job["settings"], "threads": job["threads"], "seed": job["seed"]}
    clock = time.perf_counter()
    name = job["module"]
    place = name if "." in name else f"odt_plugins.compare.baselines.{name}"
    baseline = importlib.import_module(place)
    for name in job["imports"]:
        importlib.import_module(name)
    result["import"] = time.perf_counter() - clock
    warm_up = getattr(baseline, "warm_up", None)
    if warm_up is not None:
        clock = time.perf_counter()
        warm_up(start, settings)
        result["compile"] = time.perf_counter() - clock
    (folder / READY).touch()
    began = time.perf_counter()
    for turn in range(job["repeats"]):
        clock = time.perf_counter()
        task = baseline.prepare(start, settings)
        convert = time.perf_counter() - clock
        result["peak_before"] = result["peak_before"] or peak_memory()
        busy, clock = cpu_seconds(), time.perf_counter()
        state = task.call()
        seconds = time.perf_counter() - clock
        result["cpu"].append(cpu_seconds() - busy)
        result["peak"] = peak_memory()
        clock = time.perf_counter()
        if task.details is not None:
            result["details"] = task.details(state)
        mesh = task.collect(state)
        convert += time.perf_counter() - clock
        save_mesh(folder / f"mesh-{turn}.npz", *mesh)
        result["seconds"].append(seconds)
        result["convert"].append(convert)
        _write(folder, result)
        if time.perf_counter() - began > job["enough"]:
            break


def save_mesh(path: Path, points: Any, cells: Any, regions: Any = None) -> None:
    """Write arrays to a file of numpy; no regions are an empty array."""
    np.savez(path, points=np.ascontiguousarray(points, dtype=np.float64),
             cells=np.ascontiguousarray(cells, dtype=np.int32),
             regions=np.asarray(() if regions is None else regions, dtype=np.int32))


def load_mesh(path: Path) -> tuple[Any, Any, Any]:
    """Read points, cells and regions, None where there are none."""
    with np.load(path) as data:
        regions = data["regions"] if "regions" in data else ()
        return data["points"], data["cells"], regions if len(regions) else None


def _write(folder: Path, result: dict[str, Any]) -> None:
    part = folder / f"{RESULT}.part"
    part.write_text(json.dumps(result), encoding="utf-8")
    os.replace(part, folder / RESULT)


if __name__ == "__main__":
    place = Path(sys.argv[1]).resolve()
    os.chdir(place)
    run_job(place)
