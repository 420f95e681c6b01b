"""The public functions: a caller's mesh in, optimised, the same type out."""

from __future__ import annotations

import functools
import os
from dataclasses import replace
from importlib import import_module
from threading import Thread
from typing import TYPE_CHECKING, Any, TypeVar, Unpack, overload

import numpy as np

from odt_plugins.adapters.files import (
    check_output,
    expect_same_kind,
    read_file,
    write_file,
)
from odt_plugins.adapters.host import words_of
from odt_plugins.adapters.registry import find_adapter
from odt_plugins.errors import InvalidOptionError, UnsupportedMeshError
from odt_plugins.mesh.simplex import mesh_arrays, turned_alike
from odt_plugins.multiblock import has_parts, run_parts
from odt_plugins.options import (
    OF_UNTANGLING,
    OPTIONS,
    OptionKeywords,
    make_options,
    with_option_signature,
)
from odt_plugins.roundtrip import flat_points, run_engine
from odt_plugins.untangling import Wanted

if TYPE_CHECKING:
    from collections.abc import Mapping

    from odt_plugins.engine.run.outcome import Leaving, Outcome
    from odt_plugins.figures import QualitySummary
    from odt_plugins.mesh.simplex import SimplexMesh
    from odt_plugins.multiblock import Blocks, Scene
    from odt_plugins.options import Options
    from odt_plugins.report.report import Report

MeshT = TypeVar("MeshT")
PartsT = TypeVar("PartsT", bound="Blocks | Scene")


@overload
def optimize(mesh: str | os.PathLike[str], **options: Unpack[OptionKeywords]) -> Any: ...
@overload
def optimize(mesh: MeshT, **options: Unpack[OptionKeywords]) -> MeshT: ...
@with_option_signature()
def optimize(mesh: Any, **options: Unpack[OptionKeywords]) -> Any:
    """Improve a mesh of tetrahedra or of triangles by Optimal Delaunay Triangulation.

    Parameters
    ----------
    mesh : (points, cells) or (points, cells, regions), arrays or lists of rows,
        pyvista.UnstructuredGrid, PolyData or MultiBlock, vtkUnstructuredGrid, vtkPolyData,
        meshio.Mesh, pymeshlab.MeshSet or Mesh, a TriangleMesh, TetraMesh or
        TriangleMeshModel of open3d, trimesh.Trimesh or Scene, a mesh of scikit-fem, Netgen or
        NGSolve, gmsh.model, or the path of a mesh file; arrays may be of any library with DLPack.
        It is never changed, but for gmsh.model, which is in place.
    **options
        The fields of :class:`odt_plugins.Options`, all by keyword.

    Returns
    -------
    same type as `mesh`
        A meshio.Mesh for a path. Vertices keep their index, with insert=True their order, new
        ones last and with interpolated data; dtype, orientation, point, cell and
        field data come back. Fields are interpolated where vertices moved, see `fields`. A cell
        that is still there keeps its data; a new one takes those of the input cell of its region
        with the nearest barycentre.

    Raises
    ------
    InvalidMeshError        the mesh is broken
    TangledMeshError        cells are inverted or flat, and could not or were not to be untangled
    UnsupportedMeshError    the object, or one of its cell types, is nothing that can be optimised
    InvalidOptionError      an option is unknown or out of range
    MeshFileError           the file cannot be read

    What a callable of the caller's, such as a density, raises comes through as it is.

    References
    ----------
    L. Chen, M. Holst, CMAME 200 (2011) 967-984, doi:10.1016/j.cma.2010.11.007.

    Examples
    --------
    >>> import numpy as np
    >>> import odt_plugins
    >>> points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.9, 0.8]])
    >>> cells = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    >>> better_points, better_cells = odt_plugins.optimize((points, cells))
    >>> bool((better_points[:4] == points[:4]).all())
    True
    """
    chosen = make_options(**options)
    if has_parts(mesh):
        return run_parts(mesh, options, optimize_with_report)[0]
    return run_engine(mesh, chosen)[0]


@overload
def optimize_with_report(
    mesh: str | os.PathLike[str], **options: Unpack[OptionKeywords]
) -> tuple[Any, Report]: ...
@overload
def optimize_with_report(  # type: ignore[overload-overlap]  # a mesh has none of their names
    mesh: PartsT, **options: Unpack[OptionKeywords]
) -> tuple[PartsT, list[Report]]: ...
@overload
def optimize_with_report(
    mesh: MeshT, **options: Unpack[OptionKeywords]
) -> tuple[MeshT, Report]: ...
@with_option_signature()
def optimize_with_report(
    mesh: Any, **options: Unpack[OptionKeywords]
) -> tuple[Any, Report | list[Report]]:
    """Improve a mesh as :func:`optimize` does and tell what was done.

    Returns
    -------
    mesh : same type as the input
    report : Report     figures before and after, energy, times, why it stopped, what binds; a list
                        of them for the parts of a pyvista.MultiBlock, a trimesh.Scene or a
                        TriangleMeshModel of open3d
    """
    from odt_plugins.report.report import make_report

    chosen = make_options(**options)
    if has_parts(mesh):
        return run_parts(mesh, options, optimize_with_report)
    result, before, outcome, told = run_engine(mesh, chosen)
    return result, make_report(before, outcome, chosen, **told)


@with_option_signature()
def optimize_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    *,
    file_format: str | None = None,
    binary: bool | None = None,
    **options: Unpack[OptionKeywords],
) -> Report:
    """Improve the mesh of one file and write it to another, or to the same.

    Parameters
    ----------
    source, target : path    any format of meshio, and of VTK where it is installed, by suffix
    file_format : str        "gmsh22" or "gmsh41" for a .msh file; None takes that of `source`
    binary : bool            or as text, where the format has both; None takes that of `source`
                             for .msh files, else binary
    **options
        The fields of :class:`odt_plugins.Options`.

    Returns
    -------
    Report    or a list of them for the geometries of a scene

    Raises
    ------
    MeshFileError            a file cannot be read or written; `target` is then as it was before
    """
    make_options(**options)
    check_output(target, file_format, binary)
    expect_same_kind(source, target)
    Thread(target=import_module, args=("odt_plugins.engine.run.plan",), daemon=True).start()
    report: Report
    mesh, report = optimize_with_report(read_file(source), **options)
    write_file(target, mesh, file_format, binary)
    return report


@with_option_signature(*(name for name in OPTIONS if name not in OF_UNTANGLING))
def untangle(
    mesh: Any, *, rest: Any = None, partial: bool = False, **options: Unpack[OptionKeywords]
) -> Any:
    """Make every cell valid of a mesh some of whose cells are inverted or flat, and no more.

    Parameters
    ----------
    mesh : object             what :func:`optimize` takes, of triangles in the plane or tetrahedra;
                              it is never changed, and a valid one comes back as it is
    rest : object, or (n, d) array or list of rows, optional
                              a valid mesh of the same cells, or the places of its vertices: the
                              cells of the result are brought near to the shapes they have there;
                              regular unless given
    partial : bool            whether to return the mesh with the fewest inverted or flat cells
                              that was found, where no valid one was
    insert : bool or float    whether vertices may be inserted where neither other places nor flips
                              make all tetrahedra valid; they come last, with interpolated data
    fixed, selection, regions, threads, progress
                              as for :func:`optimize`

    Returns
    -------
    same type as `mesh`       Vertices on the boundary and on interfaces, fixed ones and those of
                              cells outside the selection are where they were, bit for bit; every
                              cell has positive volume, in exact arithmetic

    Raises
    ------
    TangledMeshError          some cells stay inverted or flat; `cells` are their indices
    InvalidMeshError          the mesh, or the rest mesh, is broken in another way
    UnsupportedMeshError      a curved surface, whose triangles have no sign
    InvalidOptionError        an option is unknown or out of range

    References
    ----------
    V. Garanzha et al., Foldover-free maps in 50 lines of code, ACM Trans. Graph. 40 (2021),
    doi:10.1145/3450626.3459847.

    Examples
    --------
    >>> import numpy as np
    >>> import odt_plugins
    >>> points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [1.5, 0.5]])
    >>> cells = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    >>> valid_points, _ = odt_plugins.untangle((points, cells))
    >>> bool((valid_points[:4] == points[:4]).all() and 0 < valid_points[4, 0] < 1)
    True
    """
    if has_parts(mesh):
        return untangle_with_report(mesh, rest=rest, partial=partial, **options)[0]
    return _untangled(mesh, _untangling(options), rest, partial=partial)[0]


@with_option_signature(*(name for name in OPTIONS if name not in OF_UNTANGLING))
def untangle_with_report(
    mesh: Any, *, rest: Any = None, partial: bool = False, **options: Unpack[OptionKeywords]
) -> tuple[Any, Any]:
    """Make every cell valid as :func:`untangle` does and tell what was done.

    Returns
    -------
    mesh : same type as the input
    report : Report     figures before and after, and `untangled`: how many cells were inverted, how
                        it went, and how many are left; a list of them for the parts of a
                        pyvista.MultiBlock
    """
    from odt_plugins.report.report import make_report

    chosen = _untangling(options)
    if has_parts(mesh):
        one = functools.partial(untangle_with_report, rest=rest, partial=partial)
        return run_parts(mesh, options, one)
    result, before, outcome, told = _untangled(mesh, chosen, rest, partial=partial)
    return result, make_report(before, outcome, chosen, **told)


def _untangling(options: Mapping[str, Any]) -> Options:
    """Options of untangling alone; others would have no effect."""
    others = [name for name in options if name in OPTIONS and name not in OF_UNTANGLING]
    if others:
        msg = f"got {others[0]}= for untangling; expected some of {list(OF_UNTANGLING)}"
        raise InvalidOptionError(msg)
    return make_options(**options, layers="improve")


def _untangled(mesh: Any, options: Options, rest: Any, *, partial: bool) -> tuple[Any, ...]:
    """What :func:`run_engine` gives, with the mesh untangled and left so."""
    places = rest
    if isinstance(rest, list) and np.ndim(rest[:1]) == 2:
        places = np.asarray(rest)
    elif rest is not None and not isinstance(rest, np.ndarray):
        places = np.asarray(find_adapter(rest).read(rest).points)
    return run_engine(mesh, options, _as_it_is, Wanted(places, partial, share=1.0))


def _as_it_is(mesh: SimplexMesh, _options: Options, _leaving: Leaving) -> Outcome:
    """Take the place of the engine and leave the mesh as it is."""
    if mesh.is_surface:
        msg = ("got a curved surface; expected triangles in a plane or tetrahedra, whose cells "
               "may be inverted")
        raise UnsupportedMeshError(msg)
    from odt_plugins.engine.run.outcome import unchanged

    return unchanged(mesh, "untangled")


def quality(mesh: Any) -> QualitySummary:
    """Sum up the quality of a mesh of any kind that :func:`optimize` takes.

    Its attribute `cells` has the figures of every cell.

    Flat and inverted cells are counted, not refused. Cells of mixed orientation are turned where
    the mesh then fits together, and counted; otherwise a mesh most of whose cells have negative
    volume is turned as a whole.

    Examples
    --------
    >>> import numpy as np
    >>> import odt_plugins
    >>> points = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.75**0.5]])
    >>> round(odt_plugins.quality((points, np.array([[0, 1, 2]]))).min_quality, 12)
    1.0
    """
    from odt_plugins.figures import cell_figures, summarize

    host = find_adapter(mesh).read(mesh)
    with words_of(host):
        points, frame = flat_points(host)
        p, t = mesh_arrays(points, host.cells)
    turned = 0
    if p.shape[1] < t.shape[1]:
        t, turned = turned_alike(p, t)
        turned = turned if frame is None else min(turned, len(t) - turned)
    found = cell_figures(p, t)
    return replace(summarize(p, t, found), turned=turned, cells=found)
