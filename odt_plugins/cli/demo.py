"""The demo: the Stanford bunny from the pymeshlab wheel, tetrahedralised by TetWild, improved."""

from __future__ import annotations

import time
from collections.abc import Callable
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import MeshFileError, MissingDependencyError, require
from odt_plugins.report.report import Report
from odt_plugins.tetwild import tetrahedralize

BUNNY = Path("tests", "sample_meshes", "bunny10k_textured.obj")
"""Place of the bunny inside the pymeshlab package."""

EDGE_LENGTH = 0.08
"""Edge length asked of TetWild, relative to the bounding-box diagonal; coarse to be quick."""

EPSILON = 0.003
"""Envelope of TetWild around the surface, relative to the diagonal."""

FILES = ("bunny-before.vtu", "bunny-after.vtu", "report.json", "bunny.png")


def run_demo(
    out: Path,
    *,
    edge_length: float = EDGE_LENGTH,
    say: Callable[[str], None] = lambda line: None,
    **options: Any,
) -> Report:
    """Make the bunny, improve it and write meshes, report and picture.

    Parameters
    ----------
    out : directory          is made; gets bunny-before.vtu, bunny-after.vtu, report.json and
                             bunny.png
    edge_length : float      for TetWild, relative to the diagonal of the bunny
    say : callable           is told, line by line, what happens
    **options                of :func:`odt_plugins.optimize`

    Raises
    ------
    MissingDependencyError   pymeshlab, pytetwild or matplotlib is not installed
    MeshFileError            `out` cannot be written to
    InvalidMeshError         TetWild gave no mesh
    """
    from odt_plugins.adapters import files
    from odt_plugins.api import optimize_file
    from odt_plugins.report.plotting import plot_before_after

    require("the demo", "all", "pymeshlab", "pytetwild", "matplotlib", "meshio")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        msg = f"got {out} for the demo's files, it cannot be made: {exc}; try another --out"
        raise MeshFileError(msg) from exc
    before, after, report_file, picture = (out / name for name in FILES)
    files.check_output(before)

    points, faces = read_obj(bunny_path())
    say(f"Stanford bunny: {len(points)} vertices, {len(faces)} triangles")
    say("TetWild fills it with tetrahedra (up to a minute) ...")
    start = time.perf_counter()
    vertices, tets = tetrahedralize(
        points, faces, edge_length_fac=edge_length, epsilon=EPSILON, vtk_ordering=True, odt=False
    )
    say(f"  {len(vertices)} vertices, {len(tets)} tetrahedra in "
        f"{time.perf_counter() - start:.0f} s")
    import meshio

    files.write_file(before, meshio.Mesh(vertices, [("tetra", tets)]))
    say("odt-plugins improves it, surface fixed ...")
    report = optimize_file(before, after, **options)
    report_file.write_text(report.to_json() + "\n", encoding="utf-8")
    improved = files.read(after)
    plot_before_after((vertices, tets), (improved.points, improved.cells), report, picture,
                      title="Stanford bunny, TetWild mesh cut open", up=1)
    return report


def bunny_path() -> Path:
    """Find the bunny in the installed pymeshlab, without importing it.

    Raises
    ------
    MissingDependencyError    pymeshlab is not installed, or came without its sample meshes
    """
    spec = find_spec("pymeshlab")
    for folder in (spec.submodule_search_locations or []) if spec else []:
        if (Path(folder) / BUNNY).is_file():
            return Path(folder) / BUNNY
    msg = ("the demo takes the Stanford bunny from the pymeshlab wheel and did not find it; try "
           'pip install "odt-plugins[all]"')
    raise MissingDependencyError(msg)


def read_obj(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Read the vertices (n, 3) and the triangles (m, 3) of an OBJ file, and nothing else.

    OBJ counts from 1, or from -1 backwards from the last vertex so far. A polygon becomes a fan.
    """
    points, faces = [], []
    for line in path.read_text(encoding="utf-8").splitlines():
        kind, *words = line.split() or [""]
        if kind == "v":
            points.append([float(x) for x in words[:3]])
        elif kind == "f":
            corner = [int(word.split("/")[0]) for word in words]
            first, *others = [i - 1 if i > 0 else len(points) + i for i in corner]
            faces += [[first, *pair] for pair in pairwise(others)]
    return np.array(points), np.array(faces, dtype=np.int32)
