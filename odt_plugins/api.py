"""The public functions: a caller's mesh in, optimised, the same type out.

This is the only place where adapters and engine meet.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, Unpack, overload

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.files import check_output, read_file, write_file
from odt_plugins.adapters.host import CHARTS, Adapter, Feet, HostMesh, NewVertices, Result
from odt_plugins.adapters.kept import hold_charts, protect, protect_surface
from odt_plugins.adapters.registry import find_adapter
from odt_plugins.adapters.wedges import SEAM
from odt_plugins.carry import in_input_order, surrounding_cells
from odt_plugins.errors import InvalidOptionError, ODTError
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.numbering import in_old_numbers, new_numbers, old_numbers
from odt_plugins.mesh.plane import PlaneFrame, plane_frame
from odt_plugins.mesh.simplex import SimplexMesh, compact_labels, mesh_arrays, reverse, simplex_mesh
from odt_plugins.mesh.surface import surface_mesh
from odt_plugins.options import OptionKeywords, Options, make_options, with_option_signature

if TYPE_CHECKING:
    from odt_plugins.engine.run.driver import Outcome
    from odt_plugins.quality import QualitySummary
    from odt_plugins.report.report import Report

TURNED = "the input, since cells were turned over on the way out"

MeshT = TypeVar("MeshT")

ROUNDED = (
    "the input, since the optimised coordinates broke the promise once rounded to the caller's "
    "type: "
)


class _Prepared(NamedTuple):
    """A caller's mesh in the engine's form, and the way back."""

    adapter: Adapter
    host: HostMesh
    frame: PlaneFrame | None
    mesh: SimplexMesh
    orientation: int


@overload
def optimize(mesh: str | os.PathLike[str], **options: Unpack[OptionKeywords]) -> Any: ...
@overload
def optimize(mesh: MeshT, **options: Unpack[OptionKeywords]) -> MeshT: ...
@with_option_signature()
def optimize(mesh: Any, **options: Unpack[OptionKeywords]) -> Any:
    """Improve a mesh of tetrahedra or of triangles by Optimal Delaunay Triangulation.

    Parameters
    ----------
    mesh : (points, cells) or (points, cells, regions) arrays, pyvista.UnstructuredGrid,
        pyvista.PolyData, meshio.Mesh, pymeshlab.MeshSet or Mesh, an open3d TriangleMesh or
        TetraMesh, or the path of a mesh file. It is never changed.
    **options
        The fields of :class:`odt_plugins.Options`, all by keyword.

    Returns
    -------
    same type as `mesh`
        A meshio.Mesh for a path. Vertices keep their index, with insert=True their order, new
        ones last and with interpolated data; dtype, orientation, point, cell and
        field data come back. A cell that is still there keeps its data; a new one takes those of
        the input cell of its region with the nearest barycentre.

    Raises
    ------
    InvalidMeshError        the mesh is broken
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
    return run_engine(mesh, make_options(**options))[0]


@overload
def optimize_with_report(
    mesh: str | os.PathLike[str], **options: Unpack[OptionKeywords]
) -> tuple[Any, Report]: ...
@overload
def optimize_with_report(
    mesh: MeshT, **options: Unpack[OptionKeywords]
) -> tuple[MeshT, Report]: ...
@with_option_signature()
def optimize_with_report(mesh: Any, **options: Unpack[OptionKeywords]) -> tuple[Any, Report]:
    """Improve a mesh as :func:`optimize` does and tell what was done.

    Returns
    -------
    mesh : same type as the input
    report : Report     figures before and after, energy, times, why it stopped, what binds
    """
    from odt_plugins.report.report import make_report

    chosen = make_options(**options)
    result, before, outcome = run_engine(mesh, chosen)
    return result, make_report(before, outcome, chosen)


@with_option_signature()
def optimize_file(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    **options: Unpack[OptionKeywords],
) -> Report:
    """Improve the mesh of one file and write it to another, or to the same.

    Parameters
    ----------
    source, target : path    any format of meshio, by suffix
    **options
        The fields of :class:`odt_plugins.Options`.

    Returns
    -------
    Report

    Raises
    ------
    MeshFileError            a file cannot be read or written; `target` is then as it was before
    """
    chosen = make_options(**options)
    check_output(target)
    mesh, report = optimize_with_report(read_file(source), **_keywords(chosen))
    write_file(target, mesh)
    return report


def measure(mesh: Any) -> QualitySummary:
    """Sum up the quality of a mesh of any kind that :func:`optimize` takes.

    Flat and inverted cells are counted, not refused; a mesh most of whose cells have negative
    volume counts as turned.

    Examples
    --------
    >>> import numpy as np
    >>> import odt_plugins
    >>> points = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, 0.75**0.5]])
    >>> round(odt_plugins.measure((points, np.array([[0, 1, 2]]))).min_quality, 12)
    1.0
    """
    from odt_plugins.quality import summarize, volumes

    host = find_adapter(mesh).read(mesh)
    with _words_of(host):
        points, _ = _flat_points(host)
        p, t = mesh_arrays(points, host.cells)
    if 2 * int((volumes(p, t) < 0).sum()) > len(t):
        t = reverse(t, np.ones(len(t), dtype=np.bool_))
    return summarize(p, t)


def _keywords(options: Options) -> OptionKeywords:
    values: Any = {f.name: getattr(options, f.name) for f in fields(Options)}
    keywords: OptionKeywords = values
    return keywords


def run_engine(
    mesh: Any,
    options: Options,
    engine: Callable[[SimplexMesh, Options], Outcome] | None = None,
) -> tuple[Any, SimplexMesh, Outcome]:
    """Adapter, engine, adapter: the caller's new mesh, the engine's input and its outcome.

    Parameters
    ----------
    mesh : object        what :func:`optimize` takes
    options : Options
    engine : callable    takes the place of the engine for this kind of mesh
    """
    from odt_plugins.quality import volumes

    engine = engine or _optimized

    work = _prepare(mesh, options)
    with _words_of(work.host):
        outcome = engine(work.mesh, _in_frame(options, work.frame))
    points, outcome = _placed(work, outcome, options)
    cells, regions, source = _sorted_cells(work.mesh, outcome, options.threads)
    if not (work.mesh.is_surface or (volumes(outcome.points, cells) > 0.0).all()):
        points, outcome = np.array(work.host.points), _input_instead(work, outcome, TURNED)
        cells, regions = outcome.cells, outcome.regions
        source = np.arange(len(cells), dtype=np.int32)
    outcome = replace(outcome, cells=cells, regions=regions)
    if work.orientation < 0:
        cells = reverse(cells, np.ones(len(cells), dtype=np.bool_))
    kind = work.host.cells.dtype
    if outcome.origin is not None and kind.kind != "f":
        kind = np.promote_types(kind, np.min_scalar_type(len(points) - 1))
    result = Result(
        points, cells.astype(kind), source, work.mesh.is_surface,
        _feet(work, outcome.points, cells), _new_vertices(work.mesh, outcome),
    )
    return work.adapter.write(result, work.host), work.mesh, outcome


def _optimized(mesh: SimplexMesh, options: Options) -> Outcome:
    """Let the engine for this kind of mesh do the work."""
    if mesh.is_surface:
        from odt_plugins.engine.surface.driver import run_surface

        return run_surface(mesh, options)
    from odt_plugins.engine.run.driver import run

    return run(mesh, options)


def _feet(work: _Prepared, points: FloatArray, cells: IntArray) -> Feet | None:
    """Where a textured surface whose vertices moved lies on the input."""
    if not (work.mesh.is_surface and work.host.textured):
        return None
    old = work.mesh.points
    moved = np.flatnonzero((points != old).any(axis=1))
    if not moved.size:
        return None
    from odt_plugins.engine.surface.judge import barycentric, feet_on

    rows = work.host.cells.astype(np.int32)
    face, weights = feet_on(old, rows, np.concatenate([points[moved], points[cells].mean(axis=1)]))
    k = len(moved)
    under = rows[face[k:]]
    corners = [barycentric(old, under, points[cells[:, i]]) for i in range(3)]
    return Feet(moved, face[:k], weights[:k], face[k:], np.stack(corners, axis=1))


def _prepare(mesh: Any, options: Options) -> _Prepared:
    adapter = find_adapter(mesh)
    name = options.regions if isinstance(options.regions, str) else None
    host = adapter.read(mesh, None if name == CHARTS else name)
    charts = name == CHARTS and host.textured
    host = adapter.read(mesh, name) if name == CHARTS and not charts else host
    with _words_of(host):
        if options.insert:
            _expect_linear_tetrahedra(host)
        points, frame = _flat_points(host)
        labels = host.regions if name or options.regions is None else options.regions
        on_surface = host.cells.shape[1] == points.shape[1]
        host = _without_seams(host) if on_surface and not charts else host
        if host.blocks is not None:
            labels = compact_labels(labels, len(host.cells)).astype(np.int64)
            labels = labels * (int(host.blocks.max()) + 1) + host.blocks
        given: Any = {
            "regions": labels,
            "fixed": options.fixed,
            "selection": options.selection,
            "orient": options.orient,
        }
        if on_surface:
            surface = protect_surface(surface_mesh(points, host.cells, **given), host.kept)
            if charts:
                surface = hold_charts(surface, host.blocks)
            return _Prepared(adapter, host, None, surface, 1)
        simplices, orientation = simplex_mesh(points, host.cells, **given)
        simplices = protect(simplices, host.kept, host.anchors)
        return _Prepared(adapter, host, frame, simplices, orientation)


def _without_seams(host: HostMesh) -> HostMesh:
    """The same with nothing that keeps the seams of a texture."""
    if not host.textured:
        return host
    kept = tuple(part for part in host.kept if part.kind != SEAM)
    return replace(host, blocks=None, kept=kept)


@contextmanager
def _words_of(host: HostMesh) -> Iterator[None]:
    """Put the errors of what is done here into the words of the caller's toolkit."""
    try:
        yield
    except ODTError as exc:
        text = host.words(str(exc))
        if text == str(exc):
            raise
        raise type(exc)(text) from exc


def _flat_points(host: HostMesh) -> tuple[FloatArray, PlaneFrame | None]:
    """Coordinates as the engine wants them: those of triangles in one plane lie in it."""
    points, cells = mesh_arrays(host.points, host.cells)
    if points.shape[1] == cells.shape[1] - 1:
        return points, None
    frame = plane_frame(points, cells)
    return (points, None) if frame is None else (frame.to_plane(points), frame)


def _in_frame(options: Options, frame: PlaneFrame | None) -> Options:
    """Let a density function see the caller's coordinates."""
    density = options.density
    if frame is None or not callable(density):
        return options
    return replace(options, density=lambda x: density(frame.to_space(x)))


def _placed(
    work: _Prepared, outcome: Outcome, options: Options
) -> tuple[NDArray[Any], Outcome]:
    """Round the outcome to the caller's coordinates; if that breaks the promise, the input.

    A vertex that did not move keeps the caller's coordinates bit for bit.
    """
    origin = outcome.origin if outcome.origin is not None else np.arange(len(work.mesh.points))
    moved = (origin < 0) | (outcome.points != work.mesh.points[origin]).any(axis=1)
    points = np.array(work.host.points)[origin]
    new = outcome.points[moved]
    points[moved] = new if work.frame is None else work.frame.to_space(new)
    exact = np.array(points, dtype=np.float64)
    exact = exact if work.frame is None else work.frame.to_plane(exact)
    if np.array_equal(exact, outcome.points):
        return points, outcome
    broken, judged = _judged(work.mesh, outcome, exact, options)
    if not broken:
        return points, judged
    return np.array(work.host.points), _input_instead(work, outcome, ROUNDED + broken[0])


def _judged(
    mesh: SimplexMesh, outcome: Outcome, points: FloatArray, options: Options
) -> tuple[list[str], Outcome]:
    """What of the promise an outcome breaks with rounded coordinates, and the outcome with them."""
    if mesh.is_surface:
        from odt_plugins.engine.surface.driver import judged

        return judged(mesh, outcome, points, options)
    from odt_plugins.engine.run.judge import faults

    broken, slid = faults(mesh, points, outcome.cells, outcome.regions, options, outcome.origin)
    return broken, replace(outcome, points=points, slid=slid)


def _expect_linear_tetrahedra(host: HostMesh) -> None:
    """Refuse meshes into which no vertices can be inserted."""
    what = "triangles" if host.cells.shape[1:] == (3,) else "quadratic cells"
    if host.quadratic or what == "triangles":
        msg = f"got insert=True for a mesh of {what}; expected one of linear tetrahedra"
        raise InvalidOptionError(msg)


def _sorted_cells(
    before: SimplexMesh, outcome: Outcome, threads: int
) -> tuple[IntArray, IntArray, IntArray]:
    """Cells, regions and source of :func:`in_input_order`, whatever vertices came and went."""
    points, cells, origin = outcome.points, outcome.cells, outcome.origin
    if origin is None:
        return in_input_order(before, points, cells, outcome.regions, threads)
    n = len(before.points)
    points = in_old_numbers(before.points, points, origin)
    cells, regions, source = in_input_order(
        before, points, old_numbers(origin, n)[cells], outcome.regions, threads
    )
    return new_numbers(origin, n)[cells], regions, source


def _new_vertices(before: SimplexMesh, outcome: Outcome) -> NewVertices | None:
    """Where the vertices come from, when some were removed or added."""
    origin = outcome.origin
    if origin is None:
        return None
    corners, weights = surrounding_cells(
        before.points, before.cells, outcome.points[origin < 0]
    )
    n = len(before.points)
    number = new_numbers(origin, n)[:n].astype(np.int64)
    return NewVertices(origin, number, corners, weights)


def _input_instead(work: _Prepared, outcome: Outcome, fallback: str) -> Outcome:
    """The outcome with the input mesh in the place of one that must not be returned."""
    mesh = work.mesh
    return replace(
        outcome, points=mesh.points, cells=mesh.cells, regions=mesh.regions, fallback=fallback,
        slid=None, origin=None,
    )
