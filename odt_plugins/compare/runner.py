"""Runs contestants one after the other, each in a process of its own with a time limit."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import odt_plugins
from odt_plugins.compare.contestants import Contestant
from odt_plugins.compare.start import StartMesh
from odt_plugins.compare.worker import READY, RESULT, load_mesh, save_mesh
from odt_plugins.errors import exit_name
from odt_plugins.generate.clouds import SEED
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.processes import GROUP, end_group

IMPORTS = {
    "gmsh_optimize": ["gmsh"], "netgen_optimize": ["netgen.meshing"], "mmg_optimize": ["mmgpy"],
    "cgal_optimize": ["CGAL.CGAL_Mesh_3"], "gmsh_remesh": ["gmsh"], "mmg_remesh": ["mmgpy"],
    "pyacvd_cluster": ["pyacvd"], "tetwild": ["pytetwild"], "meshlab": ["pymeshlab"],
    "open3d_smooth": ["open3d"], "averaging": ["scipy.sparse"], "ours": ["odt_plugins.api"],
    "mfem_tmop": ["mfem.ser"],
}
"""What a baseline imports, so that the time of importing is measured by itself."""

PREPARING = 300.0
"""Seconds for importing a tool and compiling kernels."""

POLL = 0.05
"""Seconds between two looks at a worker that gets ready."""


@dataclass(frozen=True)
class Limits:
    """How long and how often a contestant may run.

    Attributes
    ----------
    seconds : float    after which its process is ended, counted from when its tool is
                       imported and its kernels are compiled
    repeats : int      runs of the optimising call
    enough : float     no further repeat once they took so many seconds together
    threads : int      for tools that can use several
    """

    seconds: float = 60.0
    repeats: int = 3
    enough: float = 6.0
    threads: int = 1


@dataclass(frozen=True)
class Run:
    """What came back from a contestant's process.

    Attributes
    ----------
    status : str      "ok", "missing" (not installed), "unsupported" (cannot take this start),
                      "failed" (raised), "crashed", "timeout", "nothing" (no cells)
    message : str     what to tell about it
    facts : dict      seconds, convert, import, compile, peak_before, peak of the worker
    meshes : list of (points, cells, regions), one per finished repeat; regions are None where
                      the tool gives none back
    """

    status: str
    message: str = ""
    facts: dict[str, Any] = field(default_factory=dict)
    meshes: list[tuple[FloatArray, IntArray, IntArray | None]] = field(default_factory=list)


def run_contestant(start: StartMesh, contestant: Contestant, limits: Limits) -> Run:
    """Run one contestant on one start mesh in a process and a temporary folder of its own."""
    if contestant.installed() is None:
        return Run("missing", contestant.missing)
    with tempfile.TemporaryDirectory(prefix="odt-compare-") as name:
        folder = Path(name)
        function = str(contestant.settings.get("function", ""))
        imports = [function.partition(":")[0]] if function else []
        job = {"mesh": start.name, "kind": start.kind, "module": contestant.module,
               "settings": contestant.settings,
               "imports": IMPORTS.get(contestant.module, imports),
               "threads": limits.threads, "repeats": limits.repeats, "enough": limits.enough,
               "seed": SEED}
        (folder / "job.json").write_text(json.dumps(job), encoding="utf-8")
        save_mesh(folder / "start.npz", start.points, start.cells, start.regions)
        ending, said = _process(folder, limits, os.getcwd() if function else "")
        return _read(folder, start, ending, said, limits)


def _process(folder: Path, limits: Limits, place: str) -> tuple[int | None, str]:
    """Run the worker; its exit code (None after the time limit) and the last line it wrote.

    Modules are looked for in `place`, too.
    """
    environment = dict(os.environ)
    environment |= dict.fromkeys(
        ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "IGL_NUM_THREADS"),
        str(limits.threads))
    here = str(Path(odt_plugins.__file__).parents[1])
    environment["PYTHONPATH"] = os.pathsep.join(
        p for p in (here, environment.get("PYTHONPATH", ""), place) if p)
    log = folder / "log"
    with log.open("wb") as file:
        process = subprocess.Popen(
            [sys.executable, "-m", "odt_plugins.compare.worker", str(folder)],
            stdout=file, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, cwd=folder,
            env=environment, **GROUP,
        )
        try:
            ending = _wait(process, folder / READY, limits.seconds)
        finally:
            # The worker's whole session, so that no helper of a tool stays behind.
            end_group(process)
    lines = log.read_text(encoding="utf-8", errors="replace").split("\n")
    return ending, next((line.strip() for line in reversed(lines) if line.strip()), "")


def _wait(process: subprocess.Popen[bytes], ready: Path, seconds: float) -> int | None:
    """Exit code, or None when it did not end in so many seconds after it was ready."""
    ends = time.monotonic() + PREPARING
    counts = False
    while True:
        try:
            return process.wait(min(POLL, max(ends - time.monotonic(), 0.0)))
        except subprocess.TimeoutExpired:
            if time.monotonic() >= ends:
                return None
        if not counts and ready.exists():
            counts, ends = True, time.monotonic() + seconds


def _read(
    folder: Path, start: StartMesh, ending: int | None, said: str, limits: Limits
) -> Run:
    file = folder / RESULT
    facts = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    status = str(facts.get("status", "crashed"))
    message = str(facts.get("message", ""))
    meshes = []
    for turn in range(len(facts.get("seconds", []))):
        meshes.append(load_mesh(folder / f"mesh-{turn}.npz"))
    if ending is None:
        status, message = "timeout", f"no answer within {limits.seconds:g} s"
    elif ending:
        status = "crashed"
        message = f"ended by {exit_name(ending)}" + (f": {said}" if said else "")
    if meshes and status in ("timeout", "crashed"):
        message = f"{message}, after {len(meshes)} complete runs, which are shown"
        status = "ok"
    if status == "ok" and any(fault := [_fault(start, *mesh) for mesh in meshes]):
        return Run("nothing", next(f for f in fault if f), facts)
    return Run(status, message, facts, meshes)


def _fault(
    start: StartMesh, points: NDArray[Any], cells: NDArray[Any], regions: NDArray[Any] | None
) -> str:
    """Say what makes arrays no mesh at all, or none of the kind of the start."""
    if not cells.size:
        return "returned no cells"
    for name, array, like in (("points", points, start.points), ("cells", cells, start.cells)):
        if array.shape[1:] != like.shape[1:]:
            return f"returned {name} of shape {array.shape}, expected (n, {like.shape[1]})"
    if regions is not None and regions.shape != cells.shape[:1]:
        return f"returned labels of shape {regions.shape}, expected ({len(cells)},)"
    if cells.min() < 0 or cells.max() >= len(points):
        return "returned cells with vertices that do not exist"
    if not np.isfinite(points[cells]).all():
        return "returned coordinates that are not finite"
    return ""
