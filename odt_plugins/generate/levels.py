"""Large meshes from coarse ones: refine, project the boundary, optimise, and so on.

TetWild needs milliseconds for every tetrahedron, refinement and Optimal Delaunay Triangulation a
few dozen microseconds. So TetWild makes a coarse mesh only.
"""

from __future__ import annotations

import json
import os
import time
import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from numbers import Integral, Real
from typing import Any, NamedTuple, Unpack

import numpy as np

from odt_plugins.adapters import meshio_mesh, pyvista_mesh
from odt_plugins.adapters.files import read_file
from odt_plugins.adapters.host import HostMesh, Result, is_instance
from odt_plugins.adapters.registry import find_adapter
from odt_plugins.api import (
    OptionKeywords,
    make_options,
    optimize_with_report,
    with_option_signature,
)
from odt_plugins.engine.geometry import boundary_facets, interface_vertices
from odt_plugins.engine.surface.envelope import distances
from odt_plugins.errors import InvalidMeshError, InvalidOptionError, ODTWarning
from odt_plugins.generate.project import Target, make_target, project
from odt_plugins.generate.refine3d import check_size, numbered_edges
from odt_plugins.generate.uniform import read_linear, uniform_refine
from odt_plugins.mesh import (
    BoolArray,
    FloatArray,
    IntArray,
    compact_labels,
    mesh_arrays,
    row_keys,
    simplex_mesh,
    vertex_mask,
)
from odt_plugins.options import Options
from odt_plugins.quality import QualitySummary, volumes
from odt_plugins.tetwild import run_tetwild

SLIDES: tuple[dict[str, Any], ...] = (
    {"envelope": 0.25, "objective": "radius_ratio"},
    {"envelope": 0.25, "objective": "min_dihedral", "rounds": 0},
)
"""Runs on the coarse mesh whose boundary slides, with parts of the envelope: what is sharp there
stays so at every level. Fine boundaries move to the surface again."""

TETWILD_PART = 0.75
"""Part of the envelope for TetWild, which holds its surface near yours but not yours near its."""

TOLERANCE = 0.02
"""Distances are bounded to this part of the envelope."""

CARRIED = ("selection", "fixed", "regions", "insert", "boundary", "progress", "envelope",
           "feature_angle")
"""Options that are not the same at every level."""


@dataclass(frozen=True)
class Level:
    """What was done at one level.

    Attributes
    ----------
    level : int                       0 is the coarse mesh
    quality : QualitySummary          at the end of the level
    asked, short : int                boundary vertices that were to move to the surface, and those
                                      that had to stop before it
    refining, projecting, optimising : float    wall seconds
    fallback : str or None            why optimisation gave an earlier state back
    """

    level: int
    quality: QualitySummary
    asked: int
    short: int
    refining: float
    projecting: float
    optimising: float
    fallback: str | None


@dataclass(frozen=True)
class LevelsReport:
    """What :func:`refine_and_optimize` did.

    Attributes
    ----------
    levels : tuple of Level
    envelope : float                  length that was asked for
    forward, backward : float         upper bounds of the distances from the boundary of the mesh to
                                      the surface, and from the surface to it
    volume, surface_volume : float    of the mesh, and inside the surface
    meshing, checking : float         wall seconds of TetWild, and of measuring the distances
    """

    levels: tuple[Level, ...]
    envelope: float
    forward: float
    backward: float
    volume: float
    surface_volume: float
    meshing: float
    checking: float

    @property
    def after(self) -> QualitySummary:
        """Figures of the result."""
        return self.levels[-1].quality

    @property
    def within(self) -> bool:
        """Whether both distances are certainly within the envelope."""
        return max(self.forward, self.backward) <= self.envelope

    @property
    def seconds(self) -> float:
        """Wall time of everything."""
        return self.meshing + self.checking + sum(
            level.refining + level.projecting + level.optimising for level in self.levels)

    def __str__(self) -> str:
        """Text of a few lines: a table of levels, then surface, volume and time."""
        lines = [f"{'level':>5}{'cells':>10}{'mean q':>9}{'1 %':>8}{'min q':>8}{'dihedral':>16}"
                 f"{'seconds':>9}"]
        for at in self.levels:
            q = at.quality
            seconds = at.refining + at.projecting + at.optimising
            angles = f"{q.min_angle:.1f}..{q.max_angle:.1f}"
            lines.append(f"{at.level:>5}{q.n_cells:>10}{q.mean_quality:>9.4f}"
                         f"{q.p1_quality:>8.3f}{q.min_quality:>8.3f}{angles:>16}{seconds:>9.1f}")
            if at.fallback:
                lines.append(f"      {at.fallback}")
        last = self.levels[-1]
        lines += [
            f"surface  {self.forward:.3g} to it, {self.backward:.3g} from it, "
            f"{'within' if self.within else 'not within'} the envelope of {self.envelope:.3g}; "
            f"{last.short} of {last.asked} vertices stopped before it",
            f"volume   {self.volume:.6g}, inside the surface {self.surface_volume:.6g}",
            f"time     {self.seconds:.1f} s, of them TetWild {self.meshing:.1f} s; "
            f"{1e6 * self.seconds / last.quality.n_cells:.0f} us a cell",
        ]
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Give everything as plain values that JSON knows."""
        data = asdict(self)
        for level, at in zip(data["levels"], self.levels, strict=True):
            level["quality"] = at.quality.to_dict()
        return data | {"within": self.within, "seconds": self.seconds}

    def to_json(self) -> str:
        """Give :meth:`to_dict` as JSON text."""
        return json.dumps(self.to_dict(), indent=2, allow_nan=False)


class _Start(NamedTuple):
    """The coarse mesh, the surface it stands for, and the seconds TetWild took."""

    mesh: Any
    target: Target
    seconds: float
    meshed: bool


@with_option_signature
def refine_and_optimize(
    mesh: Any,
    levels: int = 1,
    *,
    surface: Any = None,
    edge_length: float = 0.1,
    **options: Unpack[OptionKeywords],
) -> tuple[Any, LevelsReport]:
    """Make a large mesh of tetrahedra from a closed surface or a coarse mesh.

    At every level all edges are halved, boundary vertices move to the surface, and Optimal
    Delaunay Triangulation follows. A surface is meshed coarsely by TetWild before.

    Parameters
    ----------
    mesh : arrays, pyvista.UnstructuredGrid, meshio.Mesh or path of tetrahedra; or of triangles, a
        closed surface, then also pyvista.PolyData. It is never changed.
    levels : int
        How often to refine, at least 1; each gives about eight times as many tetrahedra.
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
    mesh : same type as `mesh`
        With labels and data carried as by :func:`odt_plugins.uniform_refine` and
        :func:`odt_plugins.optimize`. For a surface: arrays (points, cells), a
        pyvista.UnstructuredGrid for PolyData and grids, a meshio.Mesh for meshio and paths.
    report : LevelsReport
        Quality, times and vertices of every level, distances both ways, volumes.

    Raises
    ------
    InvalidMeshError        the surface is not closed, the mesh is broken, or would be too large
    InvalidOptionError      levels below 1, an envelope out of range, options with no meaning here
    UnsupportedMeshError    the object is nothing that can be refined
    MissingDependencyError  a surface, and pytetwild is not installed

    Warns
    -----
    ODTWarning              the result is not certainly within the envelope; the report says how far

    Notes
    -----
    Every cell is positive at every step. A vertex whose way to the surface would tangle or spoil a
    cell, or take a boundary facet out of the envelope, goes only a half, a quarter, ... or none of
    it.

    References
    ----------
    L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007, Section 5.3.
    """
    chosen = make_options(**options)
    _check(levels, edge_length, options)
    named = chosen.regions
    start = _start(mesh, surface, edge_length, chosen)
    slides = options.get("boundary", "slide" if start.meshed or surface is not None else "fixed")
    low, high = (f(start.target.reference.points[start.target.reference.triangles], axis=(0, 1))
                 for f in (np.min, np.max))
    envelope = chosen.envelope * float(np.linalg.norm(high - low))
    plain: Any = {name: value for name, value in options.items() if name not in CARRIED}
    plain |= {"envelope": chosen.envelope, "feature_angle": chosen.feature_angle, "regions": named}

    current = start.mesh
    host = find_adapter(current).read(current, named)
    n, m = len(host.points), len(host.cells)
    check_size(m, 3, levels)
    fixed = vertex_mask(chosen.fixed, n, "fixed", "vertices")
    frozen = np.zeros(m, dtype=np.bool_)
    if chosen.selection is not None:
        frozen = ~vertex_mask(chosen.selection, m, "selection", "cells")
    done: list[Level] = []
    reached = [0.0]
    for level in range(levels + 1):
        clock = time.perf_counter()
        refining = projecting = 0.0
        asked = short = 0
        if level:
            fixed, frozen = _carried(host, fixed, frozen)
            current = uniform_refine(current)
            refining, clock = _lap(clock)
            current, asked, short = _projected(
                current, named, fixed, frozen, start.target, envelope, last=level == levels)
            projecting, clock = _lap(clock)
        given = plain | {"fixed": fixed, "boundary": "fixed" if level else slides}
        if chosen.progress is not None:
            given["progress"] = _share(chosen.progress, level, levels, reached)
        runs = SLIDES if slides == "slide" and not level and chosen.finish else ({},)
        for run in runs:
            if run:
                given |= run | {"envelope": run["envelope"] * chosen.envelope}
            host = find_adapter(current).read(current, named)
            rows = host.cells[frozen]
            given["selection"] = ~frozen if frozen.any() else None
            current, report = optimize_with_report(current, **given)
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
        checking,
    )
    if not told.within:
        msg = (
            f"the boundary is up to {told.forward:.3g} from the surface and that up to "
            f"{told.backward:.3g} from it; expected at most {envelope:.3g}, try one more level, a "
            f"smaller edge_length or a finer coarse mesh"
        )
        warnings.warn(msg, ODTWarning, stacklevel=2)
    return current, told


def _check(levels: Any, edge_length: Any, options: Mapping[str, Any]) -> None:
    """Refuse what has no meaning for several levels."""
    whole = isinstance(levels, Integral) and not isinstance(levels, bool)
    if not (whole and int(levels) >= 1):
        msg = f"got levels={levels!r}; expected an integer of at least 1"
        raise InvalidOptionError(msg)
    good = isinstance(edge_length, Real) and not isinstance(edge_length, bool)
    if not (good and 0 < edge_length < 1):
        msg = f"got edge_length={edge_length!r}; expected a part of the diagonal, between 0 and 1"
        raise InvalidOptionError(msg)
    regions = options.get("regions")
    if not (regions is None or isinstance(regions, str)):
        msg = (
            "got regions as an array; expected the name of a cell array, try (points, cells, "
            "regions) as the mesh"
        )
        raise InvalidOptionError(msg)
    if options.get("insert"):
        msg = "got insert=True; expected False, try odt_plugins.optimize on the result"
        raise InvalidOptionError(msg)
    density = options.get("density", "keep")
    if not (isinstance(density, str) or callable(density)):
        msg = (
            f"got density as a {type(density).__name__}; expected a name or a callable, since the "
            f"cells are others at every level"
        )
        raise InvalidOptionError(msg)


def _start(
    mesh: Any, surface: Any, edge_length: float, options: Options
) -> _Start:
    """Read a coarse mesh, or make one of a surface."""
    if isinstance(mesh, str | os.PathLike):
        mesh = read_file(mesh)
    angle = options.feature_angle
    host = find_adapter(mesh).read(mesh)
    points, cells = mesh_arrays(host.points, host.cells)
    if cells.shape[1] == 4:
        read_linear(mesh)
        simplex, _ = simplex_mesh(points, cells, orient=options.orient)
        if surface is None:
            target = make_target(simplex.points, boundary_facets(simplex.cells), angle)
        else:
            target = make_target(*_surface(surface), angle)
        return _Start(mesh, target, 0.0, False)
    given = {"surface": surface, "fixed": options.fixed, "selection": options.selection,
             "regions": options.regions}
    name = next((name for name, value in given.items() if value is not None), None)
    if name is not None:
        msg = f"got {name} for a mesh of triangles; expected it for tetrahedra only"
        raise InvalidOptionError(msg)
    points, faces = _surface(mesh)
    target = make_target(points, faces, angle)
    clock = time.perf_counter()
    coarse = run_tetwild({
        "vertices": points, "faces": faces, "edge_length_fac": edge_length,
        "epsilon": TETWILD_PART * options.envelope, "vtk_ordering": True,
    })
    seconds, _ = _lap(clock)
    p, t = np.asarray(coarse[0], dtype=np.float64), np.asarray(coarse[1], dtype=np.int32)
    if is_instance(mesh, "pyvista", "DataSet") or is_instance(mesh, "pyvista", "PolyData"):
        return _Start(pyvista_mesh.tetrahedra(p, t), target, seconds, True)
    if is_instance(mesh, "meshio", "Mesh"):
        return _Start(meshio_mesh.tetrahedra(p, t), target, seconds, True)
    return _Start((p, t), target, seconds, True)


def _surface(mesh: Any) -> tuple[FloatArray, IntArray]:
    """Points and triangles of a surface in space, points at the same place merged."""
    host = find_adapter(mesh).read(mesh)
    points, cells = mesh_arrays(host.points, host.cells)
    if cells.shape[1] != 3 or points.shape[1] != 3:
        what = "tetrahedra" if cells.shape[1] == 4 else "triangles in the plane"
        msg = f"got {what} as a surface; expected triangles in space, try the boundary"
        raise InvalidMeshError(msg)
    used, number = np.unique(cells, return_inverse=True)
    places, merged = np.unique(points[used], axis=0, return_inverse=True)
    faces = merged.ravel()[number.reshape(cells.shape)].astype(np.int32)
    flat = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    return places, np.ascontiguousarray(faces[~flat])


def _carried(
    host: HostMesh, fixed: BoolArray, frozen: BoolArray
) -> tuple[BoolArray, BoolArray]:
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
    mesh: Any, named: str | None, fixed: BoolArray, frozen: BoolArray, target: Target,
    envelope: float, *, last: bool,
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
    new, asked, short = project(
        points, cells, held, target, envelope, host.points.dtype, last=last)
    moved = (new != points).any(axis=1)
    out = np.array(host.points)
    out[moved] = new[moved]
    source = np.arange(len(cells), dtype=np.int32)
    return adapter.write(Result(out, host.cells, source), host), asked, short


def _measured(
    host: HostMesh, target: Target, envelope: float
) -> tuple[tuple[float, float], float]:
    """Distances of the boundary to the surface and back, and the volume of the mesh."""
    points, cells = mesh_arrays(host.points, host.cells)
    volume = volumes(points, cells)
    cells[volume < 0.0] = cells[volume < 0.0][:, [0, 1, 3, 2]]
    both = distances((points, boundary_facets(cells)), target.reference, TOLERANCE * envelope)
    return (both.forward_upper, both.backward_upper), float(np.abs(volume).sum())


def _share(progress: Any, level: int, levels: int, reached: list[float]) -> Any:
    """Progress of one level as a part of all: the last takes most of the time.

    Several runs of one level, each from 0 to 1, do not lead back behind what was ``reached``.
    """
    weights = np.cumsum([0.0, *(8.0**k for k in range(levels + 1))])
    low, high = weights[level] / weights[-1], weights[level + 1] / weights[-1]

    def tell(stage: str, share: float) -> None:
        reached[0] = max(reached[0], float(low + (high - low) * share))
        progress(f"level {level}: {stage}", reached[0])

    return tell


def _lap(clock: float) -> tuple[float, float]:
    """Seconds since then, and now."""
    now = time.perf_counter()
    return now - clock, now
