"""The public functions: a caller's mesh in, optimised, the same type out."""

from __future__ import annotations

import functools
import os
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar, Unpack, overload

import numpy as np

from odt_plugins.adapters.files import check_output, expect_same_kind, read_file, write_file
from odt_plugins.adapters.host import flat_points, words_of
from odt_plugins.adapters.registry import find_adapter
from odt_plugins.carrying.roundtrip import run_engine
from odt_plugins.carrying.untangling import Wanted
from odt_plugins.errors import (
    InvalidOptionError,
    UnsupportedMeshError,
    expect,
    is_number,
    plain_values,
)
from odt_plugins.keywords import RUN, OptionKeywords, RunKeywords, with_option_signature
from odt_plugins.mesh.numbers import even_rows
from odt_plugins.mesh.simplex import mesh_arrays, turned_alike
from odt_plugins.multiblock import has_parts, run_parts
from odt_plugins.options import OF_UNTANGLING, OPTIONS, SMOOTHING, STAYS, expect_known, make_options

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from odt_plugins.engine.run.outcome import Leaving, Outcome
    from odt_plugins.figures import QualitySummary
    from odt_plugins.mesh.simplex import SimplexMesh
    from odt_plugins.options import Options
    from odt_plugins.report.report import Report

MeshT = TypeVar("MeshT")

PLACE = ("blocks", "block_rounds", "client", "workers")
"""Arguments of :func:`optimize` that say where the work is done."""


@overload
def optimize(mesh: str | os.PathLike[str], **how: Unpack[RunKeywords]) -> Any: ...
@overload
def optimize(mesh: MeshT, **how: Unpack[RunKeywords]) -> MeshT: ...
@with_option_signature(run=True)
def optimize(mesh: Any, **how: Unpack[RunKeywords]) -> Any:
    """Improve a mesh of tetrahedra or of triangles by Optimal Delaunay Triangulation.

    Parameters
    ----------
    mesh : (points, cells) or (points, cells, regions), arrays or lists of rows,
        pyvista.UnstructuredGrid, PolyData or MultiBlock, vtkUnstructuredGrid, vtkPolyData,
        meshio.Mesh, pymeshlab.MeshSet or Mesh, a TriangleMesh, TetraMesh or
        TriangleMeshModel of open3d, trimesh.Trimesh or Scene, a mesh of scikit-fem, Netgen or
        NGSolve, gmsh.model, or the path of a mesh file; arrays may be of any library with DLPack.
        It is never changed, but for gmsh.model, which is in place.
    target : path, optional
        File for the result where `mesh` is a path: any format of meshio, and of VTK where it is
        installed, by suffix. With a .pvtu file, `mesh` is another or a directory of .vtu files:
        pieces of one mesh, of which a process holds one at a time.
    file_format : str       "gmsh22" or "gmsh41" for a .msh file; None takes that of `mesh`
    binary : bool           or as text, where the format has both; None takes that of `mesh` for
                            .msh files, else binary
    blocks : int            blocks of about equal size into which the mesh is cut, fewer when they
                            had less than 40,000 cells; the bits do not depend on `workers`
    block_rounds : int      most rounds of blocks or pieces; later ones are cut elsewhere, around
                            the vertices that stood still
    workers : int           processes of this machine for blocks and pieces; 0 works in this one, as
                            do blocks of meshes of fewer than 100,000 cells. Scripts that give more
                            must be importable (``if __name__ == "__main__":``).
    client : distributed.Client
                            of a Dask cluster, whose workers take the place of processes
    **how
        The fields of :class:`odt_plugins.Options`, all by keyword.

    Returns
    -------
    same type as `mesh`, or `target`
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
    MeshFileError           a file cannot be read or written; `target` is then as it was before
    WorkerError             workers were lost

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
    return _optimized(mesh, dict(how), tell=False)[0]


@overload
def optimize_with_report(
    mesh: str | os.PathLike[str], **how: Unpack[RunKeywords]
) -> tuple[Any, Report]: ...
@overload
def optimize_with_report(mesh: MeshT, **how: Unpack[RunKeywords]) -> tuple[MeshT, Report]: ...
@with_option_signature(run=True)
def optimize_with_report(mesh: Any, **how: Unpack[RunKeywords]) -> tuple[Any, Report]:
    """Improve a mesh as :func:`optimize` does and tell what was done.

    Returns
    -------
    mesh : same type as the input, or `target`
    report : Report     figures before and after, energy, times, why it stopped, what binds; of an
                        object of several meshes its `parts` are those of each
    """
    return _optimized(mesh, dict(how), tell=True)


def _optimized(mesh: Any, how: dict[str, Any], *, tell: bool) -> tuple[Any, Any]:
    """The mesh or the file, and the report if it is asked for."""
    from odt_plugins.report.joined import report_of_parts
    from odt_plugins.report.report import make_report

    if how.get("target") is not None:
        return how["target"], optimize_file(mesh, **how)
    options = {name: value for name, value in how.items() if name not in RUN}
    run = RUN | {name: plain_values(name, value) for name, value in how.items() if name in RUN}
    for name in ("file_format", "binary"):
        expect(run[name] is None, name, run[name], "None without target=, a file")
    chosen = make_options(**options)
    engine = _engine(chosen, run)
    if has_parts(mesh):
        where = {name: run[name] for name in PLACE}
        whole, reports = run_parts(mesh, options, functools.partial(optimize_with_report, **where))
        return whole, report_of_parts(reports)
    result, before, outcome, told = run_engine(mesh, chosen, engine)
    return result, make_report(before, outcome, chosen, **told) if tell else None


def optimize_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    *,
    file_format: str | None = None,
    binary: bool | None = None,
    **how: Any,
) -> Report:
    """Improve the mesh of one file and write it to another, or to the same; see :func:`optimize`.

    Raises
    ------
    MeshFileError            a file cannot be read or written; `target` is then as it was before
    """
    expect(isinstance(target, str | os.PathLike), "target", target, "a path")
    if not isinstance(source, str | os.PathLike):
        msg = f"got target={os.fspath(target)!r} for a mesh that is no file; expected a path"
        raise InvalidOptionError(msg)
    chosen = make_options(**{name: value for name, value in how.items() if name not in RUN})
    if os.fspath(target).endswith(".pvtu"):
        from odt_plugins.distributed.pieces import optimize_pieces

        given = {"file_format": file_format, "binary": binary, "blocks": how.get("blocks")}
        other = next((name for name, value in given.items() if value is not None), None)
        if other is not None:
            msg = f"got {other}={given[other]!r} for a mesh in pieces; expected it for whole meshes"
            raise InvalidOptionError(msg)
        return optimize_pieces(source, target, chosen, how.get("block_rounds", 3),
                               how.get("client"), how.get("workers", 0))
    check_output(target, file_format, binary)
    expect_same_kind(source, target)
    mesh = read_file(source)
    expect_same_kind(mesh, target)
    mesh, report = optimize_with_report(mesh, **how)
    write_file(target, mesh, file_format, binary)
    return report


def _engine(options: Options, run: Mapping[str, Any]) -> Callable[..., Outcome] | None:
    """The engine for blocks, if there are any."""
    expect(is_number(run["workers"]), "workers", run["workers"], "an integer of at least 0")
    if run["blocks"] is None:
        given = {"workers": run["workers"] != 0, "client": run["client"] is not None}
        other = next((name for name, there in given.items() if there), None)
        if other is not None:
            msg = f"got {other}= without blocks; expected blocks=, how many the mesh is cut into"
            raise InvalidOptionError(msg)
        return None
    from odt_plugins.distributed.optimize import block_engine

    return block_engine(options, *(run[name] for name in PLACE))


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
) -> tuple[Any, Report]:
    """Make every cell valid as :func:`untangle` does and tell what was done.

    Returns
    -------
    mesh : same type as the input
    report : Report     figures before and after, and `untangled`: how many cells were inverted, how
                        it went, and how many are left; of an object of several meshes its
                        `parts` are those of each
    """
    from odt_plugins.report.joined import report_of_parts
    from odt_plugins.report.report import make_report

    chosen = _untangling(options)
    if has_parts(mesh):
        one = functools.partial(untangle_with_report, rest=rest, partial=partial)
        whole, reports = run_parts(mesh, options, one)
        return whole, report_of_parts(reports)
    result, before, outcome, told = _untangled(mesh, chosen, rest, partial=partial)
    report = make_report(before, outcome, chosen, **told)
    if not (report.untangled or {}).get("left"):
        plain = tuple(replace(cell, hint="") for cell in report.binding)
        report = replace(report, binding=plain)
    return result, report


def _untangling(options: Mapping[str, Any]) -> Options:
    """Options of untangling alone; others would have no effect."""
    others = [name for name in options if name in {*OPTIONS, *SMOOTHING, *STAYS} - {*OF_UNTANGLING}]
    if others:
        msg = f"got {others[0]}= for untangling; expected some of {list(OF_UNTANGLING)}"
        raise InvalidOptionError(msg)
    expect_known(options, OF_UNTANGLING, "options")
    return make_options(**options, free="layers")


def _untangled(mesh: Any, options: Options, rest: Any, *, partial: bool) -> tuple[Any, ...]:
    """What :func:`run_engine` gives, with the mesh untangled and left so."""
    partial = plain_values("partial", partial)
    expect(isinstance(partial, bool), "partial", partial, "a bool")
    places = rest
    if isinstance(rest, list) and even_rows("rest", rest[:1]).ndim == 2:
        places = even_rows("rest", rest)
    elif rest is not None and not isinstance(rest, np.ndarray):
        places = np.asarray(find_adapter(rest).read(rest).points)
    return run_engine(mesh, options, _as_it_is, Wanted(
        places, partial, share=1.0, refused=tuple(set(OPTIONS) - {*OF_UNTANGLING})))


def _as_it_is(mesh: SimplexMesh, _options: Options, _leaving: Leaving) -> Outcome:
    """Take the place of the engine and leave the mesh as it is."""
    if mesh.is_surface:
        msg = ("got a curved surface; expected triangles in a plane or tetrahedra, whose cells "
               "may be inverted")
        raise UnsupportedMeshError(msg)
    from odt_plugins.engine.run.outcome import unchanged

    return unchanged(mesh, "untangled")


def quality(mesh: Any) -> QualitySummary:
    """Sum up the quality of one mesh of any kind that :func:`optimize` takes.

    Its attribute `cells` has the figures of every cell, of those of higher order by their corners.

    Flat and inverted cells are counted, not refused. Cells of mixed orientation are turned where
    the mesh then fits together, and counted; otherwise a mesh most of whose cells have negative
    volume is turned as a whole.

    Raises
    ------
    InvalidMeshError        shapes, indices or coordinates that make no mesh
    UnsupportedMeshError    an object of another kind, or of several meshes
    MeshFileError           a file cannot be read

    Examples
    --------
    >>> import numpy as np
    >>> import odt_plugins
    >>> points = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.75**0.5]])
    >>> round(odt_plugins.quality((points, np.array([[0, 1, 2]]))).min_quality, 12)
    1.0
    """
    from odt_plugins.carrying.curved import curved_volume
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
    summary = replace(summarize(p, t, found), turned=turned, cells=found)
    if p.shape[1] == t.shape[1]:
        return summary
    return replace(summary, volume=curved_volume(host, found.volume))
