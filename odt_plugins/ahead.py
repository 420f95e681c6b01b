"""Kernels compiled ahead: what an installation does, so that no first run has to.

    python -m odt_plugins.ahead FILE         builds the library of kernels
    python -m odt_plugins.ahead --record     writes down which kernels Python calls, with what types

Parts of the library are made side by side.  What the runs below call is written down in
``engine/compiled/signatures.txt``, from which the library is built without them.
"""

from __future__ import annotations

import gc
import os
import shlex
import subprocess
import sys
from argparse import ArgumentParser
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

SIGNATURES = Path(__file__).parent / "engine" / "compiled" / "signatures.txt"
"""Kernels that Python calls, with the types of their arguments."""

WORKERS = 4
"""Most processes side by side."""

PART = "from odt_plugins.ahead import build_part; build_part({lines!r}, {first}, {folder!r})"

SMALL = 300
"""Vertices of most meshes, about."""

LARGE = 14_000
"""Vertices of one that is cut into slabs."""
RUNS: dict[str, dict[tuple[str, int], tuple[dict[str, Any], ...]]] = {
    "cells": {
        ("ball", SMALL): ({}, {"insert": True}, {"objective": "time_step", "insert": True},
                          {"objective": "min_dihedral", "insert": True, "boundary": "slide"},
                          {"density": "inverse-volume"}, {"metric": "input"},
                          {"smoothing": {"solver": "global"}, "finish": False},
                          {"method": "cpt", "smoothing": {"solver": "jacobi"}, "finish": False}),
        ("ball", LARGE): ({"smoothing": {"rounds": 1}, "finish": False, "threads": 2},),
    },
    "triangles": {
        ("plate", SMALL): ({}, {"objective": "min_dihedral"}, {"density": "inverse-volume"},
                           {"metric": "input"}),
        ("pebble", SMALL): ({}, {"boundary": "fixed"}, {"density": "curvature"},
                            {"smoothing": {"solver": "jacobi"}, "finish": False}),
    },
}
"""For every process the start meshes, their vertices, and the options of their runs."""


def build(file: Path, lines: Sequence[str] = ()) -> None:
    """Compile and link a library of kernels, by the linker of the system or of ``CC``.

    Parameters
    ----------
    file : path         takes the library
    lines : of str      its kernels; those of the file of signatures unless given

    Raises
    ------
    OSError, CalledProcessError    there is no linker, or a program ended with an error
    """
    from odt_plugins.engine.compiled.building import levels, table
    from odt_plugins.engine.compiled.library import stamp

    chosen = {name: "" for name in os.environ if name.startswith("NUMBA_")}
    work = os.environ | chosen | {"NUMBA_OPT": "0", "PYTHONHASHSEED": "0"}
    with TemporaryDirectory() as made:
        lines = lines or SIGNATURES.read_text(encoding="utf-8").splitlines()
        count = min(os.cpu_count() or 1, WORKERS)
        parts = [PART.format(lines=lines, first=len(lines) * each // count, folder=made)
                 for each in range(count)]
        processes = [subprocess.Popen([sys.executable, "-c", part], env=work) for part in parts]
        for process in [process for process in processes if process.wait()]:
            raise subprocess.CalledProcessError(process.returncode, process.args)
        contents = [line for path in sorted(Path(made).glob("*.txt"))
                    for line in path.read_text(encoding="utf-8").splitlines()]
        (Path(made) / "table.o").write_bytes(table([" ".join([stamp(), *levels()]), *contents]))
        objects = sorted(map(str, Path(made).glob("*.o")))
        linker = shlex.split(os.environ.get("CC", "cc"))
        file.parent.mkdir(parents=True, exist_ok=True)
        subprocess.run([*linker, "-shared", "-s", "-o", str(file), *objects, "-lm"], check=True)


def build_part(lines: Sequence[str], first: int, folder: str) -> None:
    """Compile kernels into object files; write down what they return.

    Kernels are taken in turn from number ``first`` on, but those that another process took.
    """
    from odt_plugins.engine.compiled.building import Units, levels

    # What numba makes of a kernel lives on: looking for garbage finds little.
    gc.set_threshold(100_000, 20, 20)
    units = Units(Path(folder))
    for number in (*range(first, len(lines)), *range(first)):
        with suppress(FileExistsError), (Path(folder) / f"{number:04}.txt").open("x") as contents:
            entry, results = units.entry(lines[number])
            contents.write(f"{lines[number]} -> {results}\n")
            names = [f"odt_{level}_{number}" for level, _ in enumerate(levels(), 1)]
            for name, code in zip(names, units.machine_code(entry, names), strict=True):
                (Path(folder) / f"{name}.o").write_bytes(code)


def record() -> None:
    """Do the runs, and write down which kernels they call from Python with what types."""
    from odt_plugins.engine.compiled.kernel import Kernel

    for name in RUNS:
        run(name)
    kernels = {value for name, module in list(sys.modules.items()) if "odt_plugins" in name
               for value in vars(module).values() if isinstance(value, Kernel)}
    lines = sorted(line for kernel in kernels for line in kernel.loaded)
    SIGNATURES.write_text("\n".join(lines) + "\n", encoding="utf-8")


def run(name: str) -> None:
    """Do the runs of a kind of mesh, improve small cells tangled, and pressed flat; remesh.

    Parameters
    ----------
    name : str    in :data:`RUNS`
    """
    import numpy as np

    from odt_plugins.api import optimize
    from odt_plugins.carrying.conserve import After, conserved
    from odt_plugins.engine.cells.extremes import FREELY, Bounds, Extremes
    from odt_plugins.engine.cells.geometry import boundary_vertices
    from odt_plugins.engine.finish.repair2d import within_bounds
    from odt_plugins.engine.ground.envelope import uncovered
    from odt_plugins.engine.ground.reference import make_reference
    from odt_plugins.engine.moves.passes import more_cells
    from odt_plugins.engine.topology.adjacency import cell_neighbors
    from odt_plugins.engine.topology.complex import make_complex
    from odt_plugins.engine.topology.triangles import Triangles
    from odt_plugins.generate import clouds
    from odt_plugins.generate.refine2d import refine_triangles
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
            optimize((points + noise * inside[:, None], cells), free="layers")
            before, same = simplex_mesh(points, cells)[0], np.arange(max(len(points), len(cells)))
            after = After(0.9 * points, before.cells, same[:len(cells)], same[:len(points)])
            conserved(before, after, {"": before.cells[:, 0] * 1.0}, {"": (points, after.points)})
            squeezed = points * np.where(np.arange(points.shape[1]) > 0, 1.0, 0.2)
            optimize((squeezed, cells), free="layers")
        if mesh == "ball" and vertices == SMALL:
            body = simplex_mesh(points, cells)[0]
            solid = make_complex(body.points, body.cells, body.regions, inside, ~inside)
            more_cells(solid, 1, Bounds(FREELY, FREELY))
        if mesh == "plate":
            refine_triangles(points, cells)
            plane = Triangles(points.copy(), cells.copy(), cell_neighbors(cells), 0 * cells[:, 0])
            within_bounds(plane, inside, Extremes(1.0, 0.5, 0.5))
        if mesh == "pebble":
            uncovered(make_reference(points, cells), 1.01 * points, cells, 1e-6)


def kept_kernels() -> tuple[Path | None, list[Path]]:
    """Folder and files of machine code that this user's runs compiled; None without a home."""
    from odt_plugins.engine.compiled.library import place

    folder = place()
    return folder, [] if folder is None else sorted(folder.rglob("*.nbc"))


if __name__ == "__main__":
    parser = ArgumentParser("python -m odt_plugins.ahead", description="Compile the kernels.")
    parser.add_argument("file", type=Path, nargs="?", help="takes the library")
    parser.add_argument("--record", action="store_true",
                        help="do runs, and write down what kernels the library is to have")
    chosen = parser.parse_args()
    if chosen.record:
        record()
    if chosen.file is not None:
        build(chosen.file)
