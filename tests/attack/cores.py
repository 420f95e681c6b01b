"""Kinds of processors: the promise holds under all, and the figures are nearly the same."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import platform
import tempfile
from functools import cache
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import reference
from llvmlite import binding

import odt_plugins
from attack.judge import Broken, Mesh, broken
from attack.meshes import curved
from attack.options import random_options
from attack.shapes import random_mesh
from odt_plugins.options import Options

SECONDS = 900.0
"""No case may take longer; kernels are compiled anew for every kind of processor."""

MEAN = 0.02
"""By how much mean qualities may differ: other roundings lead to other flips."""

Rng = np.random.Generator


def settings() -> list[dict[str, str]]:
    """Environments that make BLAS or numba work as on another processor that this one can be."""
    if platform.machine() not in ("x86_64", "AMD64"):
        return [{}, {"NUMBA_CPU_NAME": "generic"}]
    features = binding.get_host_cpu_features()
    cores = ["Prescott", "Nehalem"]
    cores += ["Haswell", "Zen"] if features.get("avx2") else []
    cores += ["SkylakeX"] if features.get("avx512f") else []
    return [{"OPENBLAS_CORETYPE": core} for core in cores] + [
        {"NUMBA_CPU_NAME": "x86-64-v2", "NUMBA_CPU_FEATURES": ""}]


def attack(rng: Rng, _folder: Path) -> None:
    """Optimise one mesh as two kinds of processors do.

    Raises
    ------
    Broken      a promise was broken, or the results are far apart
    ODTError    all refuse the mesh
    """
    mesh = random_mesh(rng)
    options = random_options(rng, mesh, mesh.labels)
    options = {k: v for k, v in options.items() if not callable(v)}
    every = settings()
    chosen = [every[i] for i in rng.permutation(len(every))[:2]]
    compare(mesh.points, mesh.cells, options, chosen)


def compare(
    points: np.ndarray, cells: np.ndarray, options: dict[str, Any], chosen: list[dict[str, str]]
) -> None:
    """Optimise a mesh in several environments and compare what comes out."""
    found = [_result(points, cells, options, tuple(sorted(s.items()))) for s in chosen]
    refused = [f for f in found if isinstance(f, Exception)]
    if refused:
        if len({type(f) for f in found}) > 1:
            raise Broken([f"{chosen}: one says {refused[0]!r}"])
        raise refused[0]
    faults = []
    labels = options.get("regions")
    before = Mesh(points, cells, None if isinstance(labels, str) else labels)
    for setting, result in zip(chosen, found, strict=True):
        faults += [f"{setting}: {fault}" for fault in broken(
            before, Mesh(*result), Options(**options), curved=curved(before))]
    means = [reference.figures(*result[:2])["mean_quality"] for result in found]
    if max(means) - min(means) > MEAN:
        faults.append(f"{chosen}: mean qualities {[round(float(x), 4) for x in means]}")
    if faults:
        raise Broken(faults)


def _result(
    points: np.ndarray, cells: np.ndarray, options: dict[str, Any],
    setting: tuple[tuple[str, str], ...],
) -> Any:
    pipe = _process(setting)
    try:
        pipe.send((points, cells, options))
        return pipe.recv()
    except EOFError:
        _process.cache_clear()
        msg = f"{dict(setting)}: the process crashed"
        raise Broken([msg]) from None


@cache
def _process(setting: tuple[tuple[str, str], ...]) -> Connection:
    """The way to a process that lives in an environment."""
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    old = dict(os.environ)
    os.environ.update(setting)
    try:
        spawn.Process(target=_serve, args=(theirs,), daemon=True).start()
    finally:
        os.environ.clear()
        os.environ.update(old)
    theirs.close()
    return ours


def _serve(pipe: Connection) -> None:
    # The folder of the first case goes.
    os.chdir(tempfile.gettempdir())
    with contextlib.suppress(EOFError):
        while True:
            points, cells, options = pipe.recv()
            try:
                pipe.send(odt_plugins.optimize((points, cells), **options))
            # Told where the results are compared.
            except Exception as exc:
                pipe.send(exc)
