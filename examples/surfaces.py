"""Curved surfaces before and after, beside what MeshLab's own remeshing makes of them.

python examples/surfaces.py [MESH ...] [--envelope 1e-3 ...] [--picture surface.png]

Takes files of surfaces of any format that VTK or meshio reads, and the bunny and the cow that ship
with pymeshlab when none is named. All results are
measured alike, by numpy and VTK: distances there and back at the vertices, midpoints and
barycentres, in thousandths of the diagonal.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyvista
from PIL import Image

import odt_plugins
from odt_plugins.cli.demo import bunny_path, read_obj
from odt_plugins.compare.contestants import OURS, Contestant, choose
from odt_plugins.compare.rows import Measured, compare_on
from odt_plugins.compare.runner import Limits
from odt_plugins.compare.start import StartMesh, make_start
from odt_plugins.report.plotting import plot_before_after

PEERS = ("MeshLab isotropic, no refinement", "MeshLab isotropic remeshing", "MeshLab Taubin")
SAMPLES = ("bunny10k_textured.obj", "cow.obj")
HEADER = (
    "| start | | vertices | mean q | 1 % | min q | < 20° | there | back | seconds |\n"
    "|---|---|---|---|---|---|---|---|---|---|"
)


def read(path: Path) -> StartMesh:
    """Read a file of a surface; vertices at the same place become one."""
    if path.suffix.lower() == ".obj":
        points, faces = read_obj(path)
    else:
        mesh = pyvista.read(path).triangulate()
        points = np.array(mesh.points, dtype=np.float64)
        plain = isinstance(mesh, pyvista.PolyData)
        faces = mesh.regular_faces if plain else mesh.cells_dict[pyvista.CellType.TRIANGLE]
    _, first, inverse = np.unique(points, axis=0, return_index=True, return_inverse=True)
    faces = first[inverse.ravel()][faces]
    proper = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return make_start(path.stem, points, faces[proper])


def row(name: str, result: str, measured: Measured, seconds: str) -> str:
    """One line of the table."""
    q, moved = measured.summary, measured.boundary
    far = [f"{1e3 * d:.2f}" if d else "" for d in (moved.outward, moved.inward)]
    return (
        f"| {name} | {result} | {q.n_points} | {q.mean_quality:.3f} | {q.p1_quality:.3f} | "
        f"{q.min_quality:.3f} | {q.below_20} | {far[0]} | {far[1]} | {seconds} |"
    )


def ours(envelope: float) -> Contestant:
    """Every default but the envelope."""
    options: dict[str, Any] = {"options": {"envelope": envelope}}
    return Contestant(f"odt-plugins, envelope {1e3 * envelope:g}e-3", OURS, ("surface",), "ours",
                      options, package="odt-plugins")


def picture(start: StartMesh, envelope: float, path: Path) -> None:
    """Draw a surface before and after."""
    before = (start.points, start.cells)
    after, report = odt_plugins.optimize_with_report(before, envelope=envelope)
    plot_before_after(before, after, report, path, title=f"{start.name}, envelope {envelope:g}",
                      up=1)
    with Image.open(path) as drawn:
        size = tuple(4 * side // 5 for side in drawn.size)
        small = drawn.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    small.quantize(128, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
        path, optimize=True)


def main(arguments: list[str]) -> None:
    """Measure every mesh and print one table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("meshes", nargs="*", type=Path, metavar="MESH")
    parser.add_argument("--envelope", nargs="+", type=float, default=[1e-3, 2e-3, 3e-3])
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args(arguments)
    folder = bunny_path().parent
    starts = [read(path) for path in given.meshes or [folder / name for name in SAMPLES]]
    tools = [ours(envelope) for envelope in given.envelope]
    tools += [tool for tool in choose(PEERS) if tool.name in PEERS]
    print(HEADER)
    for start in starts:
        result = compare_on(start, tools, Limits(), poisson=False)
        print(row(start.name, "before", result.measured, ""))
        for r in result.rows:
            if r.measured is not None and r.timing is not None:
                print(row(start.name, r.contestant, r.measured, f"{r.timing.median:.1f}"))
            else:
                print(f"| {start.name} | {r.contestant}: {r.message or r.status} |")
    if given.picture:
        picture(starts[0], given.envelope[0], given.picture)


if __name__ == "__main__":
    main(sys.argv[1:])
