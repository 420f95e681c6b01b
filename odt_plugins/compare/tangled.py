"""Tangled meshes: valid ones whose inner vertices are where they must not be, mended by each tool.

What odt-plugins makes of them is held against what it makes of the mesh without the tangle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from odt_plugins.compare.contestants import FLAT, OURS, SOLID, Contestant, of_families
from odt_plugins.compare.hull import held_vertices
from odt_plugins.compare.output import write_rows_of
from odt_plugins.compare.runner import Limits, Run, run_contestant
from odt_plugins.compare.start import StartMesh
from odt_plugins.compare.table import Say, Table, as_text
from odt_plugins.engine.untangle.places import bad_cells
from odt_plugins.figures import EDGES, summarize
from odt_plugins.generate.clouds import SEED
from odt_plugins.mesh.arrays import FloatArray

FILE = "tangled.json"

SPREADS = (1, 3, 10)
"""Mean edge lengths by which inner vertices are moved at random."""

CONTESTANTS = (
    Contestant(OURS, "odt-plugins", (*SOLID, *FLAT), "ours", {"options": {}},
               package="odt-plugins"),
    Contestant("Gmsh", "gmsh", (*SOLID, *FLAT), "gmsh_optimize",
               {"sequence": [["UntangleMeshGeometry", 1]]}, package="gmsh"),
    Contestant("Laplacian", "laplacian", (*SOLID, *FLAT), "averaging",
               {"iterations": 100, "smart": False}),
    Contestant("MFEM TMOP", "mfem", (*SOLID, *FLAT), "mfem_tmop",
               {"newton": 200, "linear": 50, "gain": 1e-6}, package="mfem",
               extra="mfem"),
)

HEADS = ("mesh", "how", "inverted", "of locked", *(f"left by {c.name}" for c in CONTESTANTS),
         "mean q", "1 % q", "seconds", "untouched: mean q", "1 % q", "seconds", "time ratio")


def tangles(start: StartMesh) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """How the vertices of a valid mesh are tangled, their places (n, d) then, and without that.

    The first five move inner vertices alone. The last two move the mesh by maps that keep its
    boundary simple, and leave the inner vertices behind.
    """
    inner = ~held_vertices(start)
    points, rng = start.points, np.random.default_rng(SEED)
    d = points.shape[1]
    edges = np.concatenate([start.cells[:, list(e)] for e in EDGES[d + 1]])
    length = float(np.sqrt(((points[edges[:, 0]] - points[edges[:, 1]]) ** 2).sum(axis=1)).mean())
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = 0.5 * (low + high), high - low
    for spread in SPREADS:
        step = rng.normal(size=points.shape) * spread * length / math.sqrt(d)
        yield f"random, {spread} h", points + step * inner[:, None], points
    yield "one point", np.where(inner[:, None], middle, points), points
    mirrored = points.copy()
    mirrored[:, 0] = 2.0 * middle[0] - points[:, 0]
    yield "reflected", np.where(inner[:, None], mirrored, points), points
    along = int(size.argmax())
    across = [axis for axis in range(d) if axis != along]
    share = (points[:, along] - middle[along]) / size[along]
    bent = points.copy()
    bent[:, across[0]] += 1.5 * size[along] * share**2
    yield "bent", np.where(inner[:, None], points, bent), bent
    if d == 3:
        turned = points.copy()
        angle = 0.5 * math.pi * share
        x, y = (points[:, axis] - middle[axis] for axis in across)
        turned[:, across[0]] = middle[across[0]] + np.cos(angle) * x - np.sin(angle) * y
        turned[:, across[1]] = middle[across[1]] + np.sin(angle) * x + np.cos(angle) * y
        yield "twisted", np.where(inner[:, None], points, turned), turned


def run_tangled(
    out: Path, starts: Sequence[StartMesh], against: Sequence[str], limits: Limits, say: Say,
    run: Callable[[StartMesh, Contestant, Limits], Run] = run_contestant,
) -> str:
    """Tangle every mesh in every way, let the tools mend it, write FILE; the table as text.

    Parameters and errors are those of :func:`odt_plugins.compare.sized.run_sized`, but `starts` are
    all the meshes: valid ones, of triangles in the plane or tetrahedra.
    """
    chosen = of_families(CONTESTANTS, against)
    rows: list[dict[str, Any]] = []
    for start in starts:
        known: dict[bytes, dict[str, Any]] = {}
        for how, points, places in tangles(start):
            say(f"{start.name}: {how}")
            knot = replace(start, points=np.ascontiguousarray(points))
            as_it_was = replace(start, points=places)
            whole = known.get(places.tobytes())
            if whole is None:
                whole = _told(as_it_was, run(as_it_was, CONTESTANTS[0], limits))
                known[places.tobytes()] = whole
            bad = bad_cells(points, start.cells)
            free = (~held_vertices(start))[start.cells].any(axis=1)
            rows.append({
                "mesh": start.name, "how": how, "inverted": int(bad.sum()),
                "locked": int((bad & ~free).sum()), "as_it_was": whole,
                "left": {c.name: _told(knot, run(knot, c, limits)) for c in chosen},
            })
    mended = sum(row["left"][OURS]["inverted"] == 0 for row in rows)
    possible = sum(row["locked"] == 0 for row in rows)
    table = Table(
        "tangled", "Tangled meshes: cells left inverted by each tool", HEADS,
        [_line(row) for row in rows],
        [f"odt-plugins mended {mended} of {len(rows)}; in {possible} of them no inverted cell had "
         f"all its vertices on the boundary or an interface"],
    )
    write_rows_of(out, FILE, rows, limits)
    return "\n".join(as_text(table))


def _told(start: StartMesh, run: Run) -> dict[str, Any]:
    """What a tool made of a mesh: inverted cells, figures, seconds; or why it made nothing."""
    if not run.meshes:
        return {"status": run.status, "message": run.message, "inverted": None}
    points, cells, _ = run.meshes[0]
    held = held_vertices(start)
    stays = len(points) == len(start.points) and (points[held] == start.points[held]).all()
    return {
        "status": "ok" if stays else "moved the boundary",
        "inverted": int(bad_cells(points, np.ascontiguousarray(cells, dtype=np.int32)).sum()),
        "figures": summarize(points, cells).to_dict(),
        "seconds": median(run.facts["seconds"]),
    }


def _line(row: dict[str, Any]) -> tuple[str | int | float, ...]:
    left = [row["left"].get(c.name, {"inverted": ""}) for c in CONTESTANTS]
    counts = [told["status"] if told["inverted"] is None else told["inverted"] for told in left]
    ours, whole = row["left"][OURS], row["as_it_was"]
    figures: list[str | float] = []
    for told in (ours, whole):
        names = ("mean_quality", "p1_quality")
        figures += [told["figures"][name] for name in names] if "figures" in told else ["", ""]
        figures.append(told.get("seconds", ""))
    both = "seconds" in ours and "seconds" in whole
    ratio = ours["seconds"] / whole["seconds"] if both else ""
    return row["mesh"], row["how"], row["inverted"], row["locked"], *counts, *figures, ratio
