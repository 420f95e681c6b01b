"""Tetrahedra remeshed to multiples of their mean edge, beside mmg3d, measured by none of both."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from itertools import combinations, product
from pathlib import Path
from typing import Any

import igl
import numpy as np

from measure.meshes import kuhn_lattice
from odt_plugins.compare.start import read_start
from odt_plugins.figures import cell_figures
from odt_plugins.mesh.facets import uneven_facets
from odt_plugins.remeshing import remesh

FACTORS = (0.6, 1.0, 2.0)
ENVELOPES = (1e-2, 1e-3)
HEADS = ("mesh", "h", "envelope", "who", "s", "vertices", "cells", "q least", "1 %", "mean",
         "angles", "in", "there", "back")

Arrays = tuple[Any, Any]


def edge_lengths(points: Any, cells: Any) -> Any:
    """Lengths of all edges, each once."""
    pairs = np.concatenate([cells[:, list(pair)] for pair in combinations(range(4), 2)])
    edges = np.unique(np.sort(pairs, axis=1), axis=0)
    return np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)


def distance(one: Arrays, other: Arrays) -> float:
    """Largest distance of samples of the boundary of one mesh from that of another."""
    rows, others = (uneven_facets(cells, len(points)).open for points, cells in (one, other))
    x = one[0][rows]
    weights = np.random.default_rng(0).dirichlet([1.0, 1.0, 1.0], 30)
    samples = np.concatenate([np.einsum("kc,mcd->mkd", weights, x).reshape(-1, 3),
                              one[0][np.unique(rows)]])
    square, _, _ = igl.point_mesh_squared_distance(samples, other[0], others)
    return float(np.sqrt(square.max()))


def mmg3d(mesh: Arrays, size: float, hausd: float) -> Arrays:
    """What mmg makes of it."""
    import mmgpy

    made = mmgpy.MmgMesh3D(mesh[0], mesh[1].astype(np.int32))
    made.remesh(hsiz=size, hausd=hausd, verbose=-1)
    return made.get_vertices(), made.get_tetrahedra().astype(np.int32)


def run_remesh(paths: list[Path], say: Callable[[str], None]) -> str:
    """Remesh some meshes, or one of a lattice, and give a table in text."""
    starts = [(start.name, (start.points, start.cells)) for start in map(read_start, paths)]
    if not starts:
        points, cells = kuhn_lattice(8)
        starts = [("lattice", (points.astype(np.float64), cells))]
    lines = [" | ".join(HEADS)]
    say(lines[0])
    for (name, mesh), envelope, factor in product(starts, ENVELOPES, FACTORS):
        size = factor * float(edge_lengths(*mesh).mean())
        extent = float(np.linalg.norm(np.ptp(mesh[0], axis=0)))
        makers = {"ours": partial(remesh, mesh, size, envelope=envelope, free="periodic"),
                  "mmg3d": partial(mmg3d, mesh, size, envelope * extent)}
        for who, make in makers.items():
            clock = time.perf_counter()
            made = make()
            seconds = time.perf_counter() - clock
            lines.append(" | ".join([name, f"x{factor:g}", f"{envelope:g}", who, f"{seconds:.1f}",
                                     *_row(mesh, made, size, extent)]))
            say(lines[-1])
    return "\n".join(lines)


def _row(mesh: Arrays, made: Arrays, size: float, extent: float) -> list[str]:
    points, cells = made
    found = cell_figures(points, cells)
    ratio = edge_lengths(points, cells) / size
    inside = ((ratio > 0.5**0.5) & (ratio < 2.0**0.5)).mean()
    return [str(len(np.unique(cells))), str(len(cells)), f"{found.quality.min():.3f}",
            f"{np.quantile(found.quality, 0.01):.3f}", f"{found.quality.mean():.3f}",
            f"{found.min_angle.min():.1f}..{found.max_angle.max():.1f}", f"{inside:.3f}",
            f"{distance(made, mesh) / extent:.2e}", f"{distance(mesh, made) / extent:.2e}"]
