"""Kernels compiled ahead: what an installation does, so that no first run has to.

    python -m odt_plugins.ahead FOLDER

puts machine code into a folder, for the best of the processors in common use that this one can
stand in for (`common_machine`).  Runs of one kind of mesh share kernels and one process; the
processes run side by side.
"""

from __future__ import annotations

import os
import subprocess
import sys
from argparse import ArgumentParser
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

SMALL = 300
"""Vertices of most meshes, about."""

LARGE = 14_000
"""Vertices of one that is cut into slabs."""

RUNS: dict[str, dict[tuple[str, int], tuple[dict[str, Any], ...]]] = {
    "cells": {
        ("ball", SMALL): ({}, {"insert": True}, {"objective": "time_step", "insert": True},
                          {"objective": "min_dihedral", "insert": True, "boundary": "slide"},
                          {"density": "inverse-volume"}),
        ("ball", LARGE): ({"smoothing": {"rounds": 1}, "finish": False, "threads": 2},),
    },
    "triangles": {
        ("plate", SMALL): ({}, {"objective": "min_dihedral"}, {"density": "inverse-volume"}),
        ("pebble", SMALL): ({}, {"boundary": "fixed"}, {"density": "curvature"}),
    },
}
"""For every process the start meshes, their vertices, and the options of their runs."""

PROGRAMS = tuple(f"from odt_plugins.ahead import run; run({name!r})" for name in RUNS)
"""What is run side by side."""


def run(name: str) -> None:
    """Do the runs of one process, improve the same small cells tangled, and pressed flat; remesh.

    Parameters
    ----------
    name : str    in :data:`RUNS`
    """
    import numpy as np

    from odt_plugins.api import optimize
    from odt_plugins.conserve import After, conserved
    from odt_plugins.engine.cells.geometry import boundary_vertices
    from odt_plugins.generate import clouds
    from odt_plugins.mesh.simplex import simplex_mesh
    from odt_plugins.remeshing import remesh

    for (mesh, vertices), options in RUNS[name].items():
        points, cells = getattr(clouds, mesh)(vertices)
        for chosen in options:
            optimize((points, cells), **chosen)
        if vertices == SMALL:
            remesh((points, cells), scale=0.9)
        if mesh != "pebble" and vertices == SMALL:
            inside = ~boundary_vertices(cells, len(points))
            noise = np.random.default_rng(0).normal(scale=0.1, size=points.shape)
            optimize((points + noise * inside[:, None], cells), layers="improve")
            before, same = simplex_mesh(points, cells)[0], np.arange(max(len(points), len(cells)))
            after = After(0.9 * points, before.cells, same[:len(cells)], same[:len(points)])
            conserved(before, after, {"": before.cells[:, 0] * 1.0}, {"": (points, after.points)})
            squeezed = points * np.where(np.arange(points.shape[1]) > 0, 1.0, 0.2)
            optimize((squeezed, cells), layers="improve")


def compile_ahead(folder: Path, programs: Sequence[str] = PROGRAMS) -> None:
    """Compile the kernels that programs use into a folder.

    Parameters
    ----------
    folder : path         is made where it is missing; what was there goes
    programs : of str     are run side by side

    Raises
    ------
    CalledProcessError    a run ended with an error
    """
    from odt_plugins.engine.compiled.cache import SUFFIX, common_machine

    _, processor, features = common_machine()
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder) as made:
        work = os.environ | {"NUMBA_CACHE_DIR": made, "NUMBA_CPU_NAME": processor,
                             "NUMBA_CPU_FEATURES": features}
        processes = [subprocess.Popen([sys.executable, "-c", program], env=work)
                     for program in programs]
        for process in [process for process in processes if process.wait()]:
            raise subprocess.CalledProcessError(process.returncode, process.args)
        for old in folder.glob(f"*{SUFFIX}"):
            old.unlink()
        for new in Path(made).rglob(f"*{SUFFIX}"):
            new.replace(folder / new.name)


def kept_kernels() -> tuple[Path | None, list[Path]]:
    """Folder and files of machine code that this user has compiled; None without a home."""
    from odt_plugins.engine.compiled.cache import SUFFIX, place

    folder = place()
    return folder, [] if folder is None else sorted(folder.glob(f"*{SUFFIX}"))


if __name__ == "__main__":
    parser = ArgumentParser("python -m odt_plugins.ahead", description="Compile the kernels.")
    parser.add_argument("folder", type=Path, help="takes the machine code; is made where missing")
    compile_ahead(parser.parse_args().folder)
