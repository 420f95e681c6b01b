"""Meshes made anew with edges of one length, by each tool: whether they have it, and the shape."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from odt_plugins.compare.baselines.task import edge_lengths, in_space, mean_edge
from odt_plugins.compare.contestants import CURVED, FLAT, OURS, SOLID, Contestant, of_families
from odt_plugins.compare.hull import hull_facets
from odt_plugins.compare.output import write_rows_of
from odt_plugins.compare.rows import oriented
from odt_plugins.compare.runner import Limits, Run, run_contestant
from odt_plugins.compare.start import StartMesh, plate, stored
from odt_plugins.compare.table import Say, Table, as_text
from odt_plugins.generate.clouds import SEED
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.simplex import diagonal

FILE = "sized.json"

FACTORS = (0.6, 1.0, 2.0)
"""Sizes, as multiples of the mean edge of the start."""

ENVELOPES = (1e-2, 1e-3)
"""Parts of the diagonal that a surface may be from that of the start."""

IN = (0.5**0.5, 2.0**0.5)
"""Edges have their size within these multiples."""

SAMPLES = 30_000
"""Random points of a surface whose distances are taken, beside vertices and middles of edges."""

ISOTROPIC: dict[str, Any] = {"iterations": 10, "targetlen": None, "checksurfdist": True,
                             "maxsurfdist": None}

CONTESTANTS = (
    Contestant(OURS, "odt-plugins", (*SOLID, *FLAT, *CURVED), "ours",
               {"options": {"free": "periodic"}, "envelope": None}, package="odt-plugins",
               remark="faces need not correspond to one another"),
    Contestant("mmg3d", "mmg", SOLID, "mmg_remesh", {"envelope": None}, package="mmgpy"),
    Contestant("mmg2d", "mmg", FLAT, "mmg_remesh", {"envelope": None}, package="mmgpy"),
    Contestant("mmgs", "mmg", CURVED, "mmg_remesh", {"envelope": None}, package="mmgpy"),
    Contestant("TetWild from the surface", "tetwild", SOLID, "tetwild",
               {"stop_energy": 10.0, "envelope": None}, package="pytetwild"),
    Contestant("CGAL tetrahedral remeshing", "cgal", SOLID, "cgal_tetrahedra",
               {"iterations": 10}, program="cgal_remeshing"),
    Contestant("TetGen -rqa", "tetgen", SOLID, "tetgen_refine", {"flags": "rq"},
               program="tetgen"),
    Contestant("MeshLab isotropic remeshing", "pymeshlab", CURVED, "meshlab",
               {"filters": [["meshing_isotropic_explicit_remeshing", ISOTROPIC]],
                "envelope": None}, package="pymeshlab"),
    Contestant("CGAL isotropic remeshing", "cgal", CURVED, "cgal_remesh", {"iterations": 10},
               package="cgal"),
    Contestant("PyACVD", "pyacvd", CURVED, "pyacvd_cluster", {"subdivide": 2}, package="pyacvd"),
    Contestant("Gmsh", "gmsh", (*FLAT, *CURVED), "gmsh_remesh", {"angle": 40.0}, package="gmsh"),
)
"""Those with the setting `envelope` are told the bound."""

HEADS = ("mesh", "h", "envelope", "who", "vertices", "least q", "1 % q", "mean q", "angles",
         "small", "in", "there, 1e-3", "back, 1e-3", "seconds")

SMALL = {"tets": 20.0, "planar": 30.0, "surface": 30.0}
"""Degrees below which the angle of a cell counts as small."""


def run_sized(
    out: Path, starts: Sequence[StartMesh], against: Sequence[str], limits: Limits, say: Say,
    run: Callable[[StartMesh, Contestant, Limits], Run] = run_contestant,
) -> str:
    """Let the tools make every mesh anew in all sizes, write FILE; the table as text.

    Parameters
    ----------
    out : Path                is made
    starts : meshes           those of the package unless there are any
    against : names           families of tools besides odt-plugins; all unless given
    limits : Limits
    say : callable            is told what is being worked on
    run : callable            takes the place of :func:`run_contestant`

    Raises
    ------
    MeshFileError             `out` cannot be written to
    """
    starts = starts or [stored("bunny"), plate(4000), stored("bunny-surface")]
    chosen = of_families(CONTESTANTS, against)
    rows: list[dict[str, Any]] = []
    for start, envelope, factor in product(starts, ENVELOPES, FACTORS):
        size = factor * mean_edge(start)
        for contestant in chosen:
            named = contestant.family in against
            if start.kind not in contestant.kinds or (
                    contestant.program and contestant.installed() is None and not named):
                continue
            bound = "envelope" in contestant.settings
            if not bound and envelope != ENVELOPES[0]:
                continue
            say(f"{start.name}, h x{factor:g}: {contestant.name}")
            settings = {**contestant.settings, "size": size}
            settings |= {"envelope": envelope} if bound else {}
            found = run(start, replace(contestant, settings=settings), limits)
            rows.append({"mesh": start.name, "factor": factor, "who": contestant.name,
                         "envelope": envelope if bound else None,
                         **sized_figures(start, found, size)})
    table = Table(
        "sized", "Meshes made anew with edges of length h", HEADS, [_line(row) for row in rows],
        ["h: multiples of the mean edge. In: share of edges of 0.71 to 1.41 times that length. "
         "Small: cells with an angle below 20 degrees in space, 30 of triangles. There and back: "
         "largest distance of samples from the surface or rim of the other, in parts of the "
         "diagonal."])
    write_rows_of(out, FILE, rows, limits)
    return "\n".join(as_text(table))


def sized_figures(start: StartMesh, run: Run, size: float) -> dict[str, Any]:
    """Figures of what a tool made; why it made nothing."""
    if not run.meshes:
        return {"status": run.status, "message": run.message}
    mesh, summary, cells = oriented(start, *run.meshes[0][:2])
    ratio = edge_lengths(mesh.points, mesh.cells) / size
    there, back = distances(start, mesh)
    return {
        "status": "ok", "figures": summary.to_dict(),
        "small": int((cells.min_angle < SMALL[start.kind]).sum()),
        "in": float(((ratio > IN[0]) & (ratio < IN[1])).mean()),
        "there": there, "back": back, "seconds": median(run.facts["seconds"]),
    }


def distances(start: StartMesh, mesh: StartMesh) -> Iterator[float]:
    """Largest distances of samples of the surfaces or rims of two meshes from the other one, from
    the second first, as parts of the diagonal of the first.
    """
    import igl

    parts = [(in_space(m.points), _shape(m)) for m in (mesh, start)]
    for (x, rows), (y, others) in (parts, parts[::-1]):
        square, _, _ = igl.point_mesh_squared_distance(_samples(x, rows), y, others)
        yield float(np.sqrt(square.max())) / diagonal(start.points)


def _shape(mesh: StartMesh) -> IntArray:
    """Triangles of a surface; edges of a rim."""
    rows = mesh.cells if mesh.kind == "surface" else hull_facets(mesh)
    return rows.astype(np.int64)


def _samples(points: FloatArray, rows: IntArray) -> FloatArray:
    """Points spread over facets by their size, middles of their edges, and their corners."""
    rng = np.random.default_rng(SEED)
    x = points[rows]
    u, v = x[:, 1] - x[:, 0], x[:, -1] - x[:, 0]
    size = np.linalg.norm(np.cross(u, v) if rows.shape[1] == 3 else u, axis=1)
    chosen = rng.choice(len(rows), SAMPLES, p=size / size.sum())
    weights = rng.dirichlet(np.ones(rows.shape[1]), SAMPLES)
    middles = (0.5 * (x + np.roll(x, 1, axis=1))).reshape(-1, 3)
    return np.concatenate([np.einsum("kc,kcd->kd", weights, x[chosen]), middles,
                           points[np.unique(rows)]])


def _line(row: dict[str, Any]) -> tuple[str | int | float, ...]:
    envelope = "" if row["envelope"] is None else f"{row['envelope']:g}"
    first = row["mesh"], f"x{row['factor']:g}", envelope, row["who"]
    if row["status"] != "ok":
        return *first, row["status"], *[""] * (len(HEADS) - 5)
    f = row["figures"]
    return (*first, f["n_points"], f["min_quality"], f["p1_quality"], f["mean_quality"],
            f"{f['min_angle']:.1f}..{f['max_angle']:.1f}", row["small"], row["in"],
            1e3 * row["there"], 1e3 * row["back"], row["seconds"])
