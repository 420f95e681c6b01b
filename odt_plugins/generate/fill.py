"""From the file of a surface to good tetrahedra: TetWild, ODT, labels of faces on the facets."""

from __future__ import annotations

import inspect
import os
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins import tetwild
from odt_plugins.adapters import files, meshio_mesh
from odt_plugins.adapters.lengths import NOT_CELL_INDICES
from odt_plugins.adapters.registry import find_adapter
from odt_plugins.engine.cells.geometry import boundary_facets
from odt_plugins.engine.ground.reference import make_reference
from odt_plugins.engine.topology.adjacency import cell_neighbors
from odt_plugins.errors import (
    InvalidMeshError,
    InvalidOptionError,
    NotFilledWarning,
    ODTWarning,
    UnsupportedMeshError,
    counted,
    warn,
)
from odt_plugins.generate.bodies import body_labels, outward
from odt_plugins.generate.coarse import NO_DATA, TETWILD_PART, tell_curved
from odt_plugins.generate.covered import REACH, compare
from odt_plugins.generate.levels import check_levels, refine_with_report
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.simplex import diagonal, mesh_arrays, reverse
from odt_plugins.options import EDGE_LENGTH, OF_MESHES, OPTIONS, make_options

if TYPE_CHECKING:
    from odt_plugins.adapters.host import HostMesh
    from odt_plugins.generate.levels_report import LevelsReport
    from odt_plugins.report.report import Report

FLAT = ("triangle", "quad", "polygon")
"""Types of the cells of a surface that is filled."""

SIZED_PART = 0.5
"""Part of the envelope for TetWild where sizes follow, which have the rest."""

NO_SIZES: Mapping[str, Any] = MappingProxyType({})

BODY = "body"
"""Cell array with the numbers of closed components."""

OF_TOOLKITS = {
    "pyvista": "mesh.odt.tetrahedralize()",
    "pymeshlab": "meshes.generate_odt_tetrahedralization()",
    "trimesh": "mesh.vertices, mesh.faces",
    "open3d": "numpy.asarray(mesh.vertices), numpy.asarray(mesh.triangles)",
}
"""What to try instead of a mesh of a toolkit, by its package."""

OF_PYTETWILD = tuple(name for name in inspect.signature(tetwild.tetrahedralize).parameters
                     if name not in ("vertices", "faces", "odt", *tetwild.SIZES, *OPTIONS))
"""Keywords of pytetwild."""

OF_ARRAYS = ("odt", "regions_of", *OF_PYTETWILD)
"""Keywords that the file of a surface has not."""

GROUPS = ("gmsh:physical", "gmsh:geometrical")
"""Labels of Gmsh, in which 0 is none; the tetrahedra are the volume 1, or that of their body."""


def tetrahedralize(vertices: Any, faces: Any = None, *more: Any, **how: Any) -> Any:
    """Fill a surface of triangles with tetrahedra by TetWild and improve them.

    Parameters
    ----------
    vertices, faces, ..., bg_values
        What `pytetwild.tetrahedralize` takes, with its defaults; edge_length_fac and epsilon are
        relative to the diagonal of the box around the faces, the other lengths are in the caller's
        unit.
        `vertices` may also be the path of a file, without `faces` and the others.
    odt : bool or dict
        False for TetWild alone; a dict of options, should one of pytetwild's keywords ever have
        the name of an option. For arrays.
    target : path, optional
        File for the tetrahedra of a file; `file_format` and `binary` as for
        :func:`odt_plugins.optimize`.
    levels : int
        Of a file. 0: TetWild and ODT; otherwise TetWild makes a coarse mesh, which is refined so
        often, see :func:`odt_plugins.refine`.
    edge_length : float
        Of a file: edges that TetWild aims at, as a part of the diagonal.
    bodies : bool
        Of a file: whether tetrahedra get a cell array "body": the number, from 1, of the closed
        component of the surface that they lie in, 0 for none; interfaces between bodies stay,
        without `levels`.
    size, scale, cells, growth
        Of :func:`odt_plugins.remesh`, which takes the tetrahedra of TetWild then instead of
        :func:`odt_plugins.optimize`; without `levels`.
    **options
        The fields of :class:`odt_plugins.Options`. With `repair="orient"` faces are turned first:
        neighbours agree, closed components face outward, hollows within them stay hollow. With a
        sizing field (bg_vertices, bg_tets, bg_values) its edge length h is the size that the
        density rho = h^-r keeps, unless a `density` is given; `exponent` of `smoothing` is r, 5 by
        default. Outside the background mesh h is the ideal edge length, as for TetWild. TetWild
        follows a field that asks for larger cells than it starts from only with `coarsen`. For a
        file none of those of a mesh that is there already; `envelope` is how far the boundary may
        be from the surface then: TetWild gets all of it, or three quarters where the boundary moves
        afterwards, or half where it is resized.

    Returns
    -------
    points : (n, 3) float64
    cells : (m, 4) int32         of negative volume, or of positive with vtk_ordering
    or of a file meshio.Mesh or `target`
        Every array of the faces but normals, such as a label, and every set of them comes to the
        triangles of the boundary beside the tetrahedra: each takes the values of the closest face.

    Raises
    ------
    MissingDependencyError       pytetwild is not installed
    InvalidMeshError             the surface is broken, or TetWild found no tetrahedra
    UnsupportedMeshError         there are no faces, as where a toolkit's mesh is given for both
    CrashError                   the same, since the process of TetWild crashed
    InvalidOptionError           an option is unknown or out of range, or TetWild is to run alone
    MeshFileError                a file cannot be read or written; `target` is then as it was before
    TypeError, ValueError, ...   what pytetwild raises

    Warns
    -----
    NotFilledWarning             more than a hundredth of the area of the surface has no boundary
                                 beside it, or of that of the boundary no surface; not where TetWild
                                 runs alone, nor with disable_filtering, which fills a box
    ODTWarning                   parts of the boundary stand for no face, as where holes were closed
    ODTWarning                   faces with labels have no triangle beside them, as those within
                                 another body without `bodies`
    ODTWarning                   a file holds point data, lines or single points, which do not come
    ODTWarning                   faces of higher order are curved, by more than the envelope

    References
    ----------
    Y. Hu, Q. Zhou, X. Gao, A. Jacobson, D. Zorin, D. Panozzo, Tetrahedral meshing in the wild, ACM
    Trans. Graph. 37 (2018), doi:10.1145/3197517.3201353.
    """
    _expect_kind(vertices, faces, how)
    if isinstance(vertices, str | os.PathLike):
        return _from_file(vertices, faces, *more, **how)[0]
    return tetwild.tetrahedralize(vertices, faces, *more, **how)


def tetrahedralize_with_report(
    vertices: Any, faces: Any = None, *more: Any, **how: Any
) -> tuple[Any, Report | LevelsReport]:
    """Fill a surface as :func:`tetrahedralize` does and tell what was done.

    Parameters
    ----------
    vertices, faces, ..., bg_values, **how
        Of :func:`tetrahedralize`, of arrays all but the first two by keyword.
    regions_of : callable
        Of arrays: is given points and cells of TetWild, and gives labels (m,) of regions; the
        interfaces between them stay.

    Returns
    -------
    mesh : (points, cells), with `regions_of` (points, cells, labels); or of a file meshio.Mesh or
        `target`
    report : Report     before is the mesh of TetWild, whose seconds stand among the times; `filled`
                        compares surface and boundary both ways; with `levels` a LevelsReport

    Raises
    ------
    InvalidOptionError  odt=False, and what :func:`tetrahedralize` raises
    """
    _expect_kind(vertices, faces, how)
    if isinstance(vertices, str | os.PathLike):
        return _from_file(vertices, faces, *more, **how)
    return tetwild.tetrahedralize_with_report(vertices, faces, *more, **how)


def _expect_kind(vertices: Any, faces: Any, how: Mapping[str, Any]) -> None:
    """Refuse a single object that is no path, and keywords of arrays with a path."""
    path = isinstance(vertices, str | os.PathLike)
    if faces is None and not path:
        kind = type(vertices)
        hint = OF_TOOLKITS.get(kind.__module__.partition(".")[0], "those of the mesh")
        msg = (f"got a {kind.__name__} as vertices, without faces; expected arrays of both, or the "
               f"path of a file, try {hint}")
        raise UnsupportedMeshError(msg)
    if path:
        tetwild.expect_none_of(OF_ARRAYS, how, "the path of a file", "arrays")


def _from_file(
    source: str | os.PathLike[str], faces: None = None, *, target: Any = None, levels: int = 0,
    edge_length: float = EDGE_LENGTH, bodies: bool = False, file_format: str | None = None,
    binary: bool | None = None, size: Any = None, scale: float | None = None,
    cells: int | None = None, growth: float | None = None, **options: Any,
) -> tuple[Any, Report | LevelsReport]:
    sizes = tetwild.asked(size=size, scale=scale, cells=cells, growth=growth)
    if faces is not None:
        msg = f"got faces beside the path {os.fspath(source)!r}; expected None"
        raise InvalidOptionError(msg)
    check_fill(levels, edge_length, options, sizes)
    if target is not None:
        files.check_output(target, file_format, binary)
        files.expect_same_kind(meshio_mesh.one_cell(4), target)
    mesh, report, _ = fill(source, levels, edge_length, options, bodies, sizes)
    if target is None:
        return mesh, report
    files.write_file(target, mesh, file_format, binary)
    return target, report


def _show_signature() -> None:
    """Let help() show what is for arrays, then what is for files, then the options."""
    shown = dict(inspect.signature(tetwild.tetrahedralize).parameters)
    own = [about for name, about in inspect.signature(_from_file).parameters.items()
           if name not in ("source", "options", *shown)]
    options = [shown.pop(name) for name in OPTIONS]
    shown["faces"] = shown["faces"].replace(default=None)
    tetrahedralize.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [shown["vertices"], *list(shown.values())[1:], *own, *options],
        return_annotation="Any")


_show_signature()


def check_fill(
    levels: Any, edge_length: Any, options: Any, sizes: Mapping[str, Any] = NO_SIZES
) -> None:
    """Refuse what has no meaning for a surface, before any work is done."""
    make_options(**options)
    check_levels(levels, edge_length, options if levels else {})
    if sizes and levels:
        given = " and ".join(f"{name}=" for name in sizes)
        msg = f"got {given} beside levels={levels}; expected either"
        raise InvalidOptionError(msg)
    if sizes:
        tetwild.check_asked(sizes, options)
    if sizes.get("adapt"):
        msg = "got adapt for a surface; expected it for meshes, try odt_plugins.remesh"
        raise InvalidOptionError(msg)
    for name in OF_MESHES:
        usual = OPTIONS[name].default
        value = options.get(name, usual)
        if isinstance(value, str | bool | tuple | None) and value == usual:
            continue
        msg = f"got {name} for a surface; expected it for meshes, try odt_plugins.optimize"
        raise InvalidOptionError(msg)


def fill(
    source: str | os.PathLike[str], levels: int, edge_length: float, options: Any,
    bodies: bool = False, sizes: Mapping[str, Any] = NO_SIZES,
) -> tuple[Any, Report | LevelsReport, float]:
    """Give the mesh of :func:`tetrahedralize` of a file, its report, and TetWild's seconds."""
    given = files.read_file(source)
    found = _of_triangles(given)
    host: HostMesh = find_adapter(found).read(found)
    if host.cells.shape[1] != 3 or host.points.shape[1] != 3:
        what = "tetrahedra" if host.cells.shape[1] == 4 else "triangles in the plane"
        msg = (f"{os.path.basename(source)} holds {what}; expected a surface of triangles to be "
               "filled")
        raise InvalidMeshError(msg)
    if bodies and BODY in host.source.cell_data:
        msg = (f"got bodies=True for faces that have an array {BODY!r}; expected none of that "
               f"name, try renaming it")
        raise InvalidOptionError(msg)
    if gone := _without_a_place(given):
        msg = (f"got {', '.join(gone)} beside the faces of {os.path.basename(source)}, which the "
               "tetrahedra do not have; expected data of faces, which come to the boundary")
        warn(msg, ODTWarning)
    options = dict(options)
    orient = options.get("repair") == "orient"
    if orient:
        del options["repair"]
    ground = mesh_arrays(host.points, host.cells)
    turned = outward(*ground) if orient else np.zeros(len(ground[1]), dtype=np.bool_)
    surface = ground[0], reverse(ground[1], turned)
    envelope = options.get("envelope", make_options().envelope)
    reach = REACH * envelope * diagonal(ground[0][np.unique(ground[1])])
    tell_curved(host, envelope)
    label: IntArray | None = None

    def labelled(points: FloatArray, cells: IntArray) -> IntArray:
        return body_labels(points[cells].mean(axis=1), *surface, reach)

    report: Report | LevelsReport
    if levels:
        (points, cells), report = refine_with_report(
            surface, levels, edge_length=edge_length, **options)
        seconds = report.meshing
        if bodies:
            label = labelled(points, cells)
    else:
        slides = options.get("boundary", "slide" if sizes else "fixed") == "slide"
        first = SIZED_PART if sizes else TETWILD_PART
        first, rest = (first, 1.0 - first) if slides else (1.0, 1.0)
        (points, cells, *labels), report = tetwild.tetrahedralize_with_report(
            host.points, reverse(host.cells, turned), labelled if bodies else None,
            edge_length_fac=edge_length, epsilon=first * envelope,
            num_threads=options.get("threads", 1), vtk_ordering=True,
            **sizes, **options | {"envelope": rest * envelope})
        label = labels[0] if bodies else None
        seconds = report.times["TetWild"]
    filled = report.filled
    if filled is None:
        filled = compare(surface, (points, cells), reach)
        if not filled.filled:
            warn(filled.complaint(), NotFilledWarning)
    mesh = _labelled(points, cells, host, reach, None if levels else label,
                     "" if levels or bodies else "; try bodies=True")
    if label is not None:
        mesh.cell_data[BODY] = [label] + [np.zeros(len(block.data), dtype=np.int32)
                                          for block in mesh.cells[1:]]
        for name in mesh.cell_data.keys() & {*GROUPS}:
            mesh.cell_data[name][0] = label.astype(mesh.cell_data[name][0].dtype)
    return mesh, replace(report, filled=filled), seconds


def _without_a_place(mesh: Any) -> list[str]:
    """What a surface has that comes to no tetrahedra: point data but normals and zeros, lines,
    vertices; of Gmsh those of physical groups.
    """
    names = [repr(name) for name, values in getattr(mesh, "point_data", {}).items()
             if "normal" not in name.lower() and name not in NO_DATA and np.any(values != 0)]
    count = {noun: sum(len(block.data) for block in getattr(mesh, "cells", ())
                       if block.type.startswith(kind))
             for kind, noun in (("line", "line"), ("vertex", "single point"))}
    everything = list(getattr(mesh, "cell_data", ())) == [GROUPS[1]]
    return [f"point data {name}" for name in names] + [
        counted(many, noun) for noun, many in count.items() if many and not everything]


def _of_triangles(mesh: Any) -> Any:
    """A surface with quadrilaterals and polygons as fans of triangles, which have their data."""
    from meshio import Mesh

    kinds = {block.type for block in getattr(mesh, "cells", ()) if len(block.data)}
    flat = [i for i, block in enumerate(getattr(mesh, "cells", ())) if block.type in FLAT]
    if not kinds & {*FLAT[1:]} or not kinds <= {*FLAT, "line", "vertex"}:
        return mesh
    rows, origin, count = [], [], 0
    for i in flat:
        cells = np.asarray(mesh.cells[i].data)
        fans = np.arange(cells.shape[1] - 2)
        corners = np.stack([np.zeros_like(fans), fans + 1, fans + 2], axis=1)
        rows.append(cells[:, corners].reshape(-1, 3))
        origin.append(count + np.repeat(np.arange(len(cells)), len(fans)))
        count += len(cells)
    of = np.concatenate(origin)
    data: dict[str, Any] = {
        name: [np.concatenate([np.asarray(values[i]) for i in flat])[of]]
        for name, values in mesh.cell_data.items()}
    sets: dict[str, Any] = {
        name: [np.flatnonzero(_members(parts, mesh, flat)[of])]
        for name, parts in mesh.cell_sets.items() if name not in NOT_CELL_INDICES}
    return Mesh(mesh.points, [("triangle", np.concatenate(rows))], mesh.point_data, data,
                mesh.field_data, cell_sets=sets)


def closest_faces(
    points: FloatArray, facets: IntArray, surface: tuple[FloatArray, IntArray], reach: float
) -> IntArray:
    """Find the face of a surface that every facet stands for: the closest to its barycentre.

    Parameters
    ----------
    points : (n, 3) float64, facets : (k, 3) int
    surface : (points, faces)    any triangles in space
    reach : float                a facet further away than that stands for none

    Returns
    -------
    (k,) int32                   -1 for none

    Raises
    ------
    InvalidMeshError             the surface has no faces
    """
    distance, face, _ = make_reference(*surface).closest(points[facets].mean(axis=1))
    return np.where(distance <= reach, face, np.int32(-1))


def _labelled(
    points: FloatArray, cells: IntArray, host: HostMesh, reach: float, body: IntArray | None,
    advice: str,
) -> Any:
    """The tetrahedra, beside them their boundary with the data of the faces, if there are any.

    Facets between bodies (m,), too, as facets of those with the larger numbers. Where faces have no
    facet beside them a warning gives advice.
    """
    from meshio import Mesh

    surface, blocks = host.source, host.layout
    arrays = {name: np.concatenate([np.asarray(values[i]) for i in blocks])
              for name, values in surface.cell_data.items() if "normal" not in name.lower()}
    sets = {name: _members(parts, surface, blocks) for name, parts in surface.cell_sets.items()
            if name not in NOT_CELL_INDICES}
    if not arrays and not sets:
        return meshio_mesh.tetrahedra(points, cells)
    neighbors = cell_neighbors(cells)
    if body is not None:
        neighbors[body[:, None] > body[neighbors]] = -1
    facets = boundary_facets(cells, neighbors)
    ground = mesh_arrays(host.points, host.cells)
    face = closest_faces(points, facets, ground, reach)
    lost = int((face < 0).sum())
    if lost:
        stand, have = ("stands", "it has") if lost == 1 else ("stand", "they have")
        msg = (f"{lost} of {counted(len(face), 'triangle')} of the boundary {stand} for no face of "
               f"the surface, as where a hole was closed; {have} no label")
        warn(msg, ODTWarning)
    within = int((closest_faces(*ground, (points, facets), reach) < 0).sum())
    if within:
        have, those, their, come = (("has", "it", "its label", "does") if within == 1 else
                                    ("have", "them", "their labels", "do"))
        msg = (f"{within} of {counted(len(ground[1]), 'face')} of the surface {have} no triangle "
               f"beside {those}, as within another body; {their} {come} not come{advice}")
        warn(msg, ODTWarning)
    data: dict[str, Any] = {
        name: [_of_cells(name, values, len(cells)), _of_facets(values, face)]
        for name, values in arrays.items()}
    none = np.zeros(0, dtype=np.int64)
    return Mesh(
        points, [("tetra", cells), ("triangle", facets)], cell_data=data,
        cell_sets={name: [none, np.flatnonzero(_of_facets(inside, face))]
                   for name, inside in sets.items()},
        field_data=dict(surface.field_data),
    )


def _members(parts: Any, surface: Any, blocks: Any) -> NDArray[np.bool_]:
    """Whether each of the faces is in a set, which holds indices for every block."""
    inside = [np.zeros(len(surface.cells[i].data), dtype=np.bool_) for i in blocks]
    for mask, i in zip(inside, blocks, strict=True):
        if parts[i] is not None:
            mask[np.asarray(parts[i], dtype=np.int64)] = True
    return np.concatenate(inside)


def _of_cells(name: str, values: NDArray[Any], count: int) -> NDArray[Any]:
    """What tetrahedra have of an array of faces: nothing, or the number of their volume."""
    return np.full((count, *values.shape[1:]), 1 if name in GROUPS else _nothing(values),
                   dtype=values.dtype)


def _of_facets(values: NDArray[Any], face: IntArray) -> NDArray[Any]:
    out = values[face].copy()
    out[face < 0] = _nothing(values)
    return np.asarray(out)


def _nothing(values: NDArray[Any]) -> Any:
    return np.nan if values.dtype.kind in "fc" else np.zeros((), dtype=values.dtype)[()]
