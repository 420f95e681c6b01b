"""The coarse mesh of tetrahedra that refinement starts from: the caller's, or one of TetWild's."""

from __future__ import annotations

import os
import time
from typing import Any, NamedTuple

import numpy as np

from odt_plugins.adapters import meshio_mesh, pyvista_mesh
from odt_plugins.adapters.files import read_file
from odt_plugins.adapters.host import HostMesh, is_instance
from odt_plugins.adapters.lengths import NOT_CELL_INDICES
from odt_plugins.adapters.registry import find_adapter
from odt_plugins.engine.cells.geometry import boundary_facets
from odt_plugins.errors import (
    DataNotKeptWarning,
    InvalidMeshError,
    InvalidOptionError,
    ODTWarning,
    counted,
    warn,
)
from odt_plugins.generate.project import Target, make_target
from odt_plugins.generate.uniform import read_linear
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.simplex import diagonal, mesh_arrays, simplex_mesh, vertices_of
from odt_plugins.options import EDGE_LENGTH, Options, Progress
from odt_plugins.tetwild import run_tetwild

TETWILD_PART = 0.75
"""Part of the envelope for TetWild, which holds its surface near yours but not yours near its."""

NO_DATA = ("obj:vn", "gmsh:dim_tags", "gmsh:geometrical")
"""Arrays of meshio that tell of the surface alone."""


class Coarse(NamedTuple):
    """A coarse mesh of tetrahedra and the surface it stands for.

    Attributes
    ----------
    mesh : Any            in the caller's type
    target : Target       the surface
    seconds : float       wall time of TetWild
    meshed : bool         whether TetWild made it
    """

    mesh: Any
    target: Target
    seconds: float
    meshed: bool


def coarse_mesh(
    mesh: Any, surface: Any, edge_length: float, options: Options, *reports: Progress
) -> Coarse:
    """Read a coarse mesh, or make one of a surface; parameters as of `refine`.

    A callable besides them is told the share of TetWild that is done.

    Raises
    ------
    InvalidMeshError        the mesh is broken, or the surface is none or not closed
    InvalidOptionError      options for tetrahedra with a mesh of triangles
    UnsupportedMeshError    the object is nothing that can be refined
    MissingDependencyError  a surface, and pytetwild is not installed

    Warns
    -----
    DataNotKeptWarning      a surface has data, which do not come to its tetrahedra
    """
    if isinstance(mesh, str | os.PathLike):
        mesh = read_file(mesh)
    angle = options.feature_angle
    host = find_adapter(mesh).read(mesh)
    points, cells = mesh_arrays(host.points, host.cells)
    if cells.shape[1] == 4:
        read_linear(mesh)
        if edge_length != EDGE_LENGTH:
            msg = (f"got edge_length={edge_length} for a mesh of tetrahedra, where it has no "
                   "effect; expected it for a surface, try odt_plugins.remesh for other sizes")
            raise InvalidOptionError(msg)
        simplex, _ = simplex_mesh(points, cells)
        if surface is None:
            target = make_target(simplex.points, boundary_facets(simplex.cells), angle)
        else:
            target = make_target(*_surface(surface), angle)
        return Coarse(mesh, target, 0.0, False)
    given = {"surface": surface, "fixed": options.fixed, "selection": options.selection,
             "regions": None if options.regions == "auto" else options.regions}
    name = next((name for name, value in given.items() if value is not None), None)
    if name is not None:
        msg = f"got {name} for a mesh of triangles; expected it for tetrahedra only"
        raise InvalidOptionError(msg)
    points, faces = _surface(mesh)
    if gone := _data_of(mesh):
        msg = (f"data of the surface do not come to its tetrahedra: {', '.join(gone)}; those of "
               "the faces of a file do with tetrahedralize, which takes levels too")
        warn(msg, DataNotKeptWarning)
    tell_curved(host, options.envelope)
    target = make_target(points, faces, angle)
    clock = time.perf_counter()
    made = run_tetwild({
        "vertices": points, "faces": faces, "edge_length_fac": edge_length,
        "epsilon": TETWILD_PART * options.envelope, "vtk_ordering": True,
    }, *reports)
    seconds = time.perf_counter() - clock
    p, t = np.asarray(made[0], dtype=np.float64), np.asarray(made[1], dtype=np.int32)
    if is_instance(mesh, "pyvista", "DataSet") or is_instance(mesh, "pyvista", "PolyData"):
        return Coarse(pyvista_mesh.tetrahedra(p, t), target, seconds, True)
    if is_instance(mesh, "meshio", "Mesh"):
        return Coarse(meshio_mesh.tetrahedra(p, t), target, seconds, True)
    return Coarse((p, t), target, seconds, True)


def _data_of(mesh: Any) -> list[str]:
    """Names of sets, and of arrays of several values but normals, at points and of faces."""
    arrays = {name: np.concatenate([np.ravel(part) for part in (
                  values if isinstance(values, list) else [values])])
              for kind in ("point_data", "cell_data")
              for name, values in dict(getattr(mesh, kind, {})).items()}
    names = {name for name, values in arrays.items()
             if "normal" not in name.lower() and (values != values[:1]).any()}
    names |= {*getattr(mesh, "point_sets", ()), *getattr(mesh, "cell_sets", ())}
    return sorted(names - {*NO_DATA, *NOT_CELL_INDICES})


def tell_curved(host: HostMesh, envelope: float) -> None:
    """Warn of curved faces, of which the flat triangles of their corners are filled.

    Parameters
    ----------
    host : HostMesh     a surface
    envelope : float    part of the diagonal that faces may be off without a warning
    """
    if host.nodes is None or host.shape is None:
        return
    x = host.points[host.nodes]
    flat = np.einsum("kc,mcx->mkx", host.shape / host.shape[0].sum(), x[:, : host.shape.shape[1]])
    off = np.sqrt(((x - flat) ** 2).sum(axis=2)).max(axis=1)
    curved = np.flatnonzero(off > envelope * diagonal(host.points[vertices_of(host.cells)]))
    if curved.size:
        msg = (f"got {counted(curved.size, 'face')} (first: face {curved[0]}) that are curved, up "
               f"to {off.max():.3g} off the flat triangles of their corners; the latter are "
               f"filled, try more and smaller faces")
        warn(msg, ODTWarning)


def _surface(mesh: Any) -> tuple[FloatArray, IntArray]:
    """Points and triangles of a surface in space, points at the same place merged."""
    host = find_adapter(mesh).read(mesh)
    points, cells = mesh_arrays(host.points, host.cells)
    if cells.shape[1] != 3 or points.shape[1] != 3:
        what, hint = (("tetrahedra", "the boundary") if cells.shape[1] == 4 else (
            "triangles in the plane", "odt_plugins.remesh, which makes triangles smaller, too"))
        msg = f"got {what} as a surface; expected triangles in space, try {hint}"
        raise InvalidMeshError(msg)
    used, number = np.unique(cells, return_inverse=True)
    places, merged = np.unique(points[used], axis=0, return_inverse=True)
    faces = merged.ravel()[number.reshape(cells.shape)].astype(np.int32)
    flat = (faces == np.roll(faces, 1, axis=1)).any(axis=1)
    return places, np.ascontiguousarray(faces[~flat])
