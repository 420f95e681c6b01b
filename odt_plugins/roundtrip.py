"""Round trip of a mesh: any object to the engine, and a new object of the same type back.

This is the only place where adapters and engine meet.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

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
from odt_plugins.options import Options
from odt_plugins.progress import telling

if TYPE_CHECKING:
    from odt_plugins.engine.run.driver import Leaving, Outcome


class _Prepared(NamedTuple):
    """A caller's mesh in the engine's form, and the way back."""

    adapter: Adapter
    host: HostMesh
    frame: PlaneFrame | None
    mesh: SimplexMesh
    orientation: int


def run_engine(
    mesh: Any,
    options: Options,
    engine: Callable[[SimplexMesh, Options, Leaving], Outcome] | None = None,
) -> tuple[Any, SimplexMesh, Outcome]:
    """Adapter, engine, adapter: the caller's new mesh, the engine's input and its outcome.

    Parameters
    ----------
    mesh : object        what :func:`odt_plugins.optimize` takes
    options : Options
    engine : callable    takes the place of the engine for this kind of mesh; it judges meshes as
                         they leave
    """
    work = _prepare(mesh, options)
    leaving = partial(_as_it_leaves, work, options.threads)
    with words_of(work.host), telling(options.progress, "preparing") as progress:
        chosen = _in_frame(options, work.frame)
        chosen = replace(chosen, progress=progress if options.progress else None)
        outcome = (engine or _optimized)(work.mesh, chosen, leaving)
    if outcome.written is None:
        outcome = leaving(outcome)
    points: Any = outcome.written
    source: Any = outcome.source
    cells = outcome.cells
    if work.orientation < 0:
        cells = reverse(cells, np.ones(len(cells), dtype=np.bool_))
    kind = work.host.cells.dtype
    if outcome.origin is not None and kind.kind != "f":
        kind = np.promote_types(kind, np.min_scalar_type(len(outcome.points) - 1))
    result = Result(
        points, cells.astype(kind), source, work.mesh.is_surface,
        _feet(work, outcome.points, cells), _new_vertices(work.mesh, outcome),
    )
    return work.adapter.write(result, work.host), work.mesh, outcome


def _optimized(mesh: SimplexMesh, options: Options, leaving: Leaving) -> Outcome:
    """Let the engine for this kind of mesh do the work."""
    if mesh.is_surface:
        from odt_plugins.engine.surface.driver import run_surface

        return run_surface(mesh, options, leaving)
    from odt_plugins.engine.run.driver import run

    return run(mesh, options, leaving)


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
    with words_of(host):
        if options.insert:
            _expect_linear_tetrahedra(host)
        points, frame = flat_points(host)
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
def words_of(host: HostMesh) -> Iterator[None]:
    """Put the errors of what is done here into the words of the caller's toolkit."""
    try:
        yield
    except ODTError as exc:
        text = host.words(str(exc))
        if text == str(exc):
            raise
        raise type(exc)(text) from exc


def flat_points(host: HostMesh) -> tuple[FloatArray, PlaneFrame | None]:
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


def _as_it_leaves(work: _Prepared, threads: int, outcome: Outcome) -> Outcome:
    """The outcome with the points that the caller will read, and cells in the order of the input's.

    A vertex that did not move keeps the caller's coordinates bit for bit.
    """
    n = len(work.mesh.points)
    origin = outcome.origin if outcome.origin is not None else np.arange(n)
    moved = (origin < 0) | (outcome.points != work.mesh.points[origin]).any(axis=1)
    written = np.array(work.host.points)[origin]
    points, new = outcome.points.copy(), outcome.points[moved]
    written[moved] = new if work.frame is None else work.frame.to_space(new)
    read = written[moved].astype(np.float64)
    points[moved] = read if work.frame is None else work.frame.to_plane(read)
    outcome = replace(outcome, points=points, written=written)
    cells, regions, source = _sorted_cells(work.mesh, outcome, threads)
    return replace(outcome, cells=cells, regions=regions, source=source)


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
