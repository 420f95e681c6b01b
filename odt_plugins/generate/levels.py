"""Large meshes from coarse ones: refine, project the boundary, optimise, and so on.

TetWild needs milliseconds for every tetrahedron, refinement and Optimal Delaunay Triangulation a
few dozen microseconds. So TetWild makes a coarse mesh only.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from numbers import Integral, Real
from typing import Any, Unpack

import numpy as np

from odt_plugins.adapters.host import HostMesh, NewVertices, Result
from odt_plugins.adapters.regions import are_names
from odt_plugins.adapters.registry import find_adapter
from odt_plugins.api import optimize_with_report
from odt_plugins.carrying.sources import surrounding_cells
from odt_plugins.engine.cells.geometry import boundary_facets, interface_vertices
from odt_plugins.engine.ground.envelope import distances
from odt_plugins.errors import InvalidOptionError, ODTWarning, expect, plain_values, warn
from odt_plugins.figures import volumes
from odt_plugins.generate.coarse import coarse_mesh
from odt_plugins.generate.levels_report import Level, LevelsReport
from odt_plugins.generate.project import Target, project
from odt_plugins.generate.refine3d import check_size, numbered_edges
from odt_plugins.generate.uniform import uniform_refine, unrefined
from odt_plugins.keywords import OptionKeywords, with_option_signature
from odt_plugins.mesh.arrays import BoolArray
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.numbers import vertex_mask
from odt_plugins.mesh.simplex import SimplexMesh, compact_labels, diagonal, mesh_arrays, vertices_of
from odt_plugins.options import EDGE_LENGTH, Options, Progress, make_options
from odt_plugins.progress import part, telling

SLIDES: tuple[dict[str, Any], ...] = (
    {"envelope": 0.25, "objective": "radius_ratio"},
    {"envelope": 0.25, "objective": "min_dihedral", "smoothing": {"rounds": 0}},
)
"""Runs on the coarse mesh whose boundary slides, with parts of the envelope: what is sharp there
stays so at every level. Fine boundaries move to the surface again."""

BY_TETWILD = 0.2
"""Part of the progress that a coarse mesh by TetWild takes."""

TOLERANCE = 0.02
"""Distances are bounded to this part of the envelope."""

MOST_LEVELS = 31
"""Most levels: as many would make too many cells of any mesh."""

CARRIED = ("selection", "fixed", "regions", "insert", "boundary", "progress", "envelope",
           "feature_angle")
"""Options that are not the same at every level."""


@with_option_signature()
def refine(
    mesh: Any,
    levels: int = 1,
    *,
    optimize: bool = True,
    surface: Any = None,
    edge_length: float = EDGE_LENGTH,
    **options: Unpack[OptionKeywords],
) -> Any:
    """Make a large mesh of tetrahedra from a closed surface or a coarse mesh.

    At every level all edges are halved: a triangle becomes four, a tetrahedron eight. Boundary
    vertices of tetrahedra move to the surface, and Optimal Delaunay Triangulation follows. A
    surface is meshed coarsely by TetWild before.

    Parameters
    ----------
    mesh : arrays, pyvista.UnstructuredGrid, meshio.Mesh or path of tetrahedra; or of triangles, a
        closed surface, then also pyvista.PolyData. It is never changed.
    levels : int
        How often to refine; each gives about eight times as many tetrahedra. 0 only optimises
        the coarse mesh.
    optimize : bool
        False halves edges and does no more, see :func:`odt_plugins.generate.uniform_refine`: of
        triangles, too, whose surfaces stay what they are.
    surface : mesh of triangles, optional
        Closed surface that coarse tetrahedra stand for; None: their own boundary.
    edge_length : float
        Of TetWild's coarse mesh, as a part of the diagonal; it takes smaller ones where the
        surface asks for them.
    **options
        The fields of :class:`odt_plugins.Options` for every level. `envelope` is how far the
        boundary may be from the surface, as a part of the diagonal.
        `boundary` "slide" is for the coarse mesh, the default if there is a surface; its finer
        boundaries only move to the surface. `fixed` and `selection` are of `mesh`, and so is
        `regions`, the name of a cell array.

    Returns
    -------
    same type as `mesh`
        With labels and data carried as by :func:`odt_plugins.generate.uniform_refine` and
        :func:`odt_plugins.optimize`. For a surface: arrays (points, cells), a
        pyvista.UnstructuredGrid for PolyData and grids, a meshio.Mesh for meshio and paths.

    Raises
    ------
    InvalidMeshError        the surface is not closed, the mesh is broken, or would be too large
    InvalidOptionError      levels below 0, an envelope out of range, options with no meaning here
    UnsupportedMeshError    the object is nothing that can be refined
    MissingDependencyError  a surface, and pytetwild is not installed

    Warns
    -----
    ODTWarning              the result is not certainly within the envelope; the report says how far
    DataNotKeptWarning      a surface has data, which do not come to its tetrahedra

    Notes
    -----
    Every cell is positive at every step. A vertex whose way to the surface would tangle or spoil a
    cell, or take a boundary facet out of the envelope, goes only a half, a quarter, ... or none of
    it.

    References
    ----------
    L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007, Section 5.3.
    """
    optimize = plain_values("optimize", optimize)
    expect(isinstance(optimize, bool), "optimize", optimize, "a bool")
    if optimize:
        return refine_with_report(
            mesh, levels, surface=surface, edge_length=edge_length, **options)[0]
    check_levels(levels, edge_length, {})
    given = {"surface": surface is not None, "edge_length": edge_length != EDGE_LENGTH}
    other = next((name for name in (*given, *options) if given.get(name, True)), None)
    if other is not None:
        msg = f"got {other}= with optimize=False, where it has no effect; expected optimize=True"
        raise InvalidOptionError(msg)
    for _ in range(levels):
        mesh = uniform_refine(mesh)
    return mesh if levels else unrefined(mesh)


@with_option_signature()
def refine_with_report(
    mesh: Any,
    levels: int = 1,
    *,
    surface: Any = None,
    edge_length: float = EDGE_LENGTH,
    **options: Unpack[OptionKeywords],
) -> tuple[Any, LevelsReport]:
    """Refine and optimise a mesh as :func:`refine` does and tell what was done.

    Returns
    -------
    mesh : same type as `mesh`
    report : LevelsReport     quality, times and vertices of every level, distances both ways,
                              volumes
    """
    chosen = make_options(**options)
    if chosen.fields == "conserve":
        msg = ("got fields='conserve' for refinement, whose levels interpolate; expected 'auto', "
               "'interpolate' or 'keep'")
        raise InvalidOptionError(msg)
    check_levels(levels, edge_length, options)
    with telling(chosen.progress, "coarse mesh") as tell:
        return _refined(mesh, int(levels), surface, edge_length, options,
                        replace(chosen, progress=tell))


def _refined(
    mesh: Any, levels: int, surface: Any, edge_length: float, options: OptionKeywords,
    chosen: Options,
) -> tuple[Any, LevelsReport]:
    """The mesh of the last level; `chosen` are the `options` made, with a progress to tell."""
    reports = (part(chosen.progress, 0.0, BY_TETWILD),) if options.get("progress") else ()
    start = coarse_mesh(mesh, surface, edge_length, chosen, *reports)
    left = part(chosen.progress, BY_TETWILD if start.meshed else 0.0, 1.0)
    slides = options.get("boundary", "slide" if start.meshed or surface is not None else "fixed")
    reference = start.target.reference
    envelope = chosen.envelope * diagonal(reference.points[vertices_of(reference.triangles)])
    plain: Any = {name: value for name, value in options.items() if name not in CARRIED}
    plain |= {"envelope": chosen.envelope, "feature_angle": chosen.feature_angle}

    current = start.mesh
    host = find_adapter(current).read(current, chosen.regions)
    # What is found at the start is held at every level.
    named = host.regions_from or (None if host.regions is None else chosen.regions)
    plain["regions"] = named
    n, m = len(host.points), len(host.cells)
    check_size(m, 3, levels)
    fixed = vertex_mask(chosen.fixed, n, "fixed", "vertices")
    frozen = np.zeros(m, dtype=np.bool_)
    if chosen.selection is not None:
        frozen = ~vertex_mask(chosen.selection, m, "selection", "cells")
    done: list[Level] = []
    before = None
    for level in range(levels + 1):
        clock = time.perf_counter()
        refining = projecting = 0.0
        asked = short = 0
        if level:
            fixed, frozen = _carried(host, fixed, frozen)
            current = uniform_refine(current)
            refining, clock = _lap(clock)
            current, asked, short = _projected(
                current, named, fixed, frozen, start.target, envelope, last=level == levels,
                fields=chosen.fields != "keep")
            projecting, clock = _lap(clock)
        given = plain | {"fixed": fixed, "boundary": "fixed" if level else slides}
        given["progress"] = _share(left, level, levels)
        runs = SLIDES if slides == "slide" and not level and chosen.finish else ({},)
        for run in runs:
            if run:
                given |= run | {
                    "envelope": run["envelope"] * chosen.envelope,
                    "smoothing": replace(chosen.smoothing, **run.get("smoothing", {}))}
            host = find_adapter(current).read(current, named)
            rows = host.cells[frozen]
            given["selection"] = ~frozen if frozen.any() else None
            current, report = optimize_with_report(current, **given)
            before = before or report.before
            host = find_adapter(current).read(current, named)
            frozen = _among(host.cells, rows, len(host.points))
        optimising, _ = _lap(clock)
        done.append(Level(level, report.after, asked, short, refining, projecting, optimising,
                          report.fallback))
    clock = time.perf_counter()
    both, volume = _measured(host, start.target, envelope)
    checking, _ = _lap(clock)
    told = LevelsReport(
        tuple(done), envelope, both[0], both[1], volume, abs(start.target.volume), start.seconds,
        checking, before or done[0].quality,
    )
    if not told.within:
        msg = (f"the boundary is up to {told.forward:.3g} from the surface and that up to "
               f"{told.backward:.3g} from it; expected at most {envelope:.3g}, try one more "
               "level, a smaller edge_length or a finer coarse mesh")
        warn(msg, ODTWarning)
    return current, told


def check_levels(levels: Any, edge_length: Any, options: Mapping[str, Any]) -> None:
    """Refuse what has no meaning for several levels."""
    if options.get("reference") is not None:
        msg = "got reference= for levels, whose envelope is that of the surface; try surface="
        raise InvalidOptionError(msg)
    whole = isinstance(levels, Integral) and not isinstance(levels, bool)
    expect(whole and int(levels) >= 0, "levels", levels, "an integer of at least 0")
    expect(int(levels) <= MOST_LEVELS, "levels", levels, f"an integer of at most {MOST_LEVELS}")
    good = isinstance(edge_length, Real) and not isinstance(edge_length, bool)
    expect(good and 0 < edge_length < 1, "edge_length", edge_length,
           "a part of the diagonal, between 0 and 1")
    if not are_names(options.get("regions")):
        msg = ("got regions as an array; expected the name of a cell array, try (points, cells, "
               "regions) as the mesh")
        raise InvalidOptionError(msg)
    if options.get("insert"):
        msg = (f"got insert={options['insert']}; expected False, try odt_plugins.optimize on the "
               f"result")
        raise InvalidOptionError(msg)
    for name in ("density", "metric"):
        value = options.get(name)
        if not (value is None or isinstance(value, str) or callable(value)):
            msg = (f"got {name} as a {type(value).__name__}; expected a name or a callable, since "
                   "the vertices and cells are others at every level")
            raise InvalidOptionError(msg)


def _carried(host: HostMesh, fixed: BoolArray, frozen: BoolArray) -> tuple[BoolArray, BoolArray]:
    """Fixed vertices and frozen cells after refinement: a mid-point is fixed if both ends are."""
    edges, _ = numbered_edges(np.asarray(host.cells).astype(np.int64), len(host.points))
    return np.concatenate([fixed, fixed[edges].all(axis=1)]), np.repeat(frozen, 8)


def _among(cells: Any, rows: Any, n: int) -> BoolArray:
    """Cells (m,) with the vertices of some of the rows."""
    if not len(rows):
        return np.zeros(len(cells), dtype=np.bool_)
    both = np.sort(np.concatenate([cells, rows]).astype(np.int64), axis=1)
    keys = row_keys(both, n)
    return np.asarray(np.isin(keys[: len(cells)], keys[len(cells) :]))


def _projected(
    mesh: Any, named: str | Sequence[str] | None, fixed: BoolArray, frozen: BoolArray,
    target: Target, envelope: float, *, last: bool, fields: bool,
) -> tuple[Any, int, int]:
    """The caller's mesh with its boundary on the surface, and how many vertices got there."""
    adapter = find_adapter(mesh)
    host = adapter.read(mesh, named)
    points, cells = mesh_arrays(host.points, host.cells)
    negative = volumes(points, cells) < 0.0
    cells[negative] = cells[negative][:, [0, 1, 3, 2]]
    labels = compact_labels(host.regions, len(cells))
    if host.blocks is not None:
        labels = labels * (int(host.blocks.max()) + 1) + host.blocks.astype(np.int32)
    held = fixed | interface_vertices(cells, len(points), labels)
    held[cells[frozen]] = True
    for kept in host.kept:
        if kept.rows.shape[1] == 1:
            held[kept.rows] = True
    new, asked, short = project(points, cells, held, target, envelope, host.points.dtype, last=last)
    moved = (new != points).any(axis=1)
    out = np.array(host.points)
    out[moved] = new[moved]
    source = np.arange(len(cells), dtype=np.int32)
    vertices = None
    if fields and host.fields and moved.any():
        simplices = SimplexMesh(points, cells, labels, held)
        near = np.zeros(len(points), dtype=np.int32)
        near[cells] = source[:, None]
        cell, weights = surrounding_cells(simplices, new[moved], near[moved])
        number = np.arange(len(points))
        vertices = NewVertices(number, number, np.flatnonzero(moved), cells[cell], weights)
    result = Result(out, host.cells, source, vertices=vertices)
    return adapter.write(result, host), asked, short


def _measured(host: HostMesh, target: Target, envelope: float) -> tuple[tuple[float, float], float]:
    """Distances of the boundary to the surface and back, and the volume of the mesh."""
    points, cells = mesh_arrays(host.points, host.cells)
    volume = volumes(points, cells)
    cells[volume < 0.0] = cells[volume < 0.0][:, [0, 1, 3, 2]]
    both = distances((points, boundary_facets(cells)), target.reference, TOLERANCE * envelope)
    return (both.forward_upper, both.backward_upper), float(np.abs(volume).sum())


def _share(progress: Progress, level: int, levels: int) -> Progress:
    """Progress of one level as a part of all: the last takes most of the time."""
    weights = np.cumsum([0.0, *(8.0**k for k in range(levels + 1))])
    low, high = weights[level : level + 2] / weights[-1]
    return part(lambda stage, share: progress(f"level {level}: {stage}", share), low, high)


def _lap(clock: float) -> tuple[float, float]:
    """Seconds since then, and now."""
    now = time.perf_counter()
    return now - clock, now
