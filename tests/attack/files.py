"""Damaged files of every format: one sentence, or a mesh that keeps the promise."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import contract
import meshio
import numpy as np
import surface_meshes

import odt_plugins
from attack.damage import FORMATS, TRIANGLES, damaged, written
from attack.judge import Broken
from odt_plugins.errors import ODTError

SECONDS = 60.0
"""No case may take longer."""

Rng = np.random.Generator

TETRAHEDRA = ("flac3d", "tetgen", "cgns", "su2")
"""Starts of the names of formats that hold no triangles in space."""


def attack(rng: Rng, folder: Path) -> None:
    """Write a mesh, damage one of its files, measure it or optimise it.

    Raises
    ------
    Broken    a refused file left something behind
    """
    name = str(rng.choice(sorted(FORMATS)))
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        parts = written(name, _mesh(name, rng))
    names = list(parts)
    harmed = names[0] if rng.random() < 0.8 else str(rng.choice(names))
    for _ in range(1 if rng.random() < 0.7 else 2):
        parts[harmed] = damaged(parts[harmed], rng)
    for part, data in parts.items():
        (folder / part).write_bytes(data)
    path = folder / names[0]
    if rng.random() < 0.3:
        target = folder / f"better{path.suffix if rng.random() < 0.5 else '.vtu'}"
        try:
            odt_plugins.optimize(path, target=target, smoothing={"rounds": 1, "cycles": 1})
        except ODTError:
            left = sorted(p.name for p in folder.iterdir() if p.name not in names)
            if left:
                raise Broken([f"{left} were left behind"]) from None
            raise
        return
    odt_plugins.quality(path)


def _mesh(name: str, rng: Rng) -> meshio.Mesh:
    """A sound mesh that a format holds, with data where it holds those."""
    flat = name in TRIANGLES or (not name.startswith(TETRAHEDRA)
                                 and rng.random() < 0.4)
    if flat:
        points, cells = surface_meshes.bowl(int(rng.integers(3, 6)), 0.3, int(rng.integers(99)))
    else:
        points, cells, _ = contract.grid(3, int(rng.integers(1, 4)), int(rng.integers(99)))
    # Coordinates that every format writes.
    points = np.round(points * 1024) / 1024
    mesh = meshio.Mesh(points, [("triangle" if flat else "tetra", cells)])
    if name.startswith(("vtk", "vtu", "xdmf", "gmsh 2")) and rng.random() < 0.5:
        mesh.point_data["temperature"] = rng.random(len(points))
        mesh.cell_data["marker"] = [rng.integers(0, 3, len(cells))]
    return mesh
