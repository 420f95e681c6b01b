"""The way back of data: from which cells and vertices the caller's arrays follow the mesh."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.fields import numbers
from odt_plugins.adapters.host import Adapter, HostMesh, NewFaces, NewVertices
from odt_plugins.adapters.point_sets import depths
from odt_plugins.carrying.conserve import After, conserved
from odt_plugins.carrying.integrals import changed_integrals, of_points
from odt_plugins.carrying.sources import in_order_of, surrounding_cells
from odt_plugins.carrying.untangling import Tangle
from odt_plugins.errors import TangledMeshError, UnsupportedMeshError
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.faces import labels_at, turns_of
from odt_plugins.mesh.numbering import new_numbers
from odt_plugins.mesh.plane import PlaneFrame
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.options import Options
from odt_plugins.promise.locked_facets import locked_facets

if TYPE_CHECKING:
    from odt_plugins.engine.run.outcome import Outcome

CONSERVE = "conserve"
"""Value of the option `fields` with which integrals stay."""


class Prepared(NamedTuple):
    """A caller's mesh in the engine's form, and the way back.

    `own` are the cells that it has of the caller's, if not all. Where it was untangled, `host` has
    its new places and cells, and `tangle` says what it was.
    """

    adapter: Adapter
    host: HostMesh
    frame: PlaneFrame | None
    mesh: SimplexMesh
    orientation: int
    same: NDArray[np.int64] | None = None
    notes: tuple[str, ...] = ()
    tangle: Tangle | None = None
    own: NDArray[np.int64] | None = None


class Followed(NamedTuple):
    """Data on the new mesh.

    Attributes
    ----------
    vertices : NewVertices or None
    of_cells : dict of (m', ...)                     cell arrays whose integrals stay
    cell_integrals, point_integrals : dict of float  how much others changed, by their names
    """

    vertices: NewVertices | None
    of_cells: Mapping[str, NDArray[Any]]
    cell_integrals: Mapping[str, float]
    point_integrals: Mapping[str, float]


def follow(
    work: Prepared, given: HostMesh, outcome: Outcome, vertices: NewVertices | None,
    options: Options,
) -> Followed:
    """Carry arrays to the result, with their integrals if asked; tell which integrals changed."""
    if work.tangle is not None:
        return Followed(vertices, {}, {}, {})
    before, source = work.mesh, np.asarray(outcome.source)
    cells = given.densities_of(work.own)
    old_points = {} if work.same is not None or given.higher_order else numbers(given.fields)
    points = {name: (values, values if vertices is None else vertices.carried(
        values, field=name in interpolated(work, options))) for name, values in old_points.items()}
    kept: dict[str, NDArray[Any]] = {}
    if options.fields == CONSERVE and outcome.cells is not before.cells:
        origin = np.arange(len(before.points)) if outcome.origin is None else outcome.origin
        labels = work.host.regions_from
        kept, at_vertices = conserved(
            before, After(outcome.points, outcome.cells, source, origin),
            {name: values for name, values in cells.items() if name not in labels}, points,
            options.threads)
        points |= {name: (points[name][0], values) for name, values in at_vertices.items()}
        vertices = vertices and vertices._replace(conserved=at_vertices)
    meshes = (before.points, before.cells), (outcome.points, outcome.cells)
    told = changed_integrals({name: (values, kept.get(name, values[source]))
                              for name, values in cells.items()}, *meshes)
    return Followed(vertices, kept, told, changed_integrals(of_points(points, *meshes), *meshes))


def expect_overlaps(work: Prepared, given: HostMesh, options: Options) -> None:
    """Refuse meshes whose cells have no exact overlaps with others, if these are asked for.

    Raises
    ------
    UnsupportedMeshError    cells of higher order
    TangledMeshError        inverted or flat cells
    """
    if options.fields != CONSERVE:
        return
    if given.higher_order:
        msg = ("got fields='conserve' for cells of higher order; expected linear cells, which are "
               "clipped exactly, try fields='interpolate'")
        raise UnsupportedMeshError(msg)
    if work.tangle is not None:
        msg = ("got fields='conserve' for a mesh with inverted or flat cells, over which integrals "
               "mean nothing; try fields='interpolate', or untangling it first")
        raise TangledMeshError(msg)


def interpolated(work: Prepared, options: Options) -> tuple[str, ...]:
    """Names of the point arrays that are interpolated at vertices that moved."""
    return tuple(work.host.fields) if interpolates(work, options) else ()


def interpolates(work: Prepared, options: Options) -> bool:
    """Whether vertices that moved have the values that fields have at their new places."""
    by_default = work.host.follows and not work.mesh.is_surface
    return options.fields in ("interpolate", CONSERVE) or (options.fields == "auto" and by_default)


def around(
    work: Prepared, threads: int, x: NDArray[Any], near: IntArray
) -> tuple[IntArray, FloatArray]:
    """Input cells in which places (k, D) lie or, on a curved surface, under them; coordinates."""
    before = work.mesh if work.tangle is None else work.tangle.around
    return _around(before, work.frame, threads, x, near)


def _around(
    before: SimplexMesh, frame: PlaneFrame | None, threads: int, x: NDArray[Any], near: IntArray
) -> tuple[IntArray, FloatArray]:
    x = x if frame is None else frame.to_plane(x)
    if not before.is_surface:
        return surrounding_cells(before, x, near, threads)
    from odt_plugins.engine.surface.judge import feet_on

    return feet_on(before.points, before.cells, x)


def locating(work: Prepared, given: HostMesh, threads: int) -> Callable[..., Any]:
    """What :func:`around` does, in the caller's cells, with coordinates in the order of their
    corners; cells that were untangled are those before, with their corners where these are after.
    """
    before, own = work.mesh, work.own
    if work.tangle is not None:
        before = work.tangle.before
        before = replace(before, points=work.tangle.after.points[: len(before.points)])
    caller = given.cells if own is None else given.cells[own]

    def locate(x: NDArray[Any], near: IntArray) -> tuple[NDArray[Any], FloatArray]:
        near = near if own is None else np.searchsorted(own[:-1], near).astype(near.dtype)
        cell, weights = in_order_of(
            caller, before.cells, *_around(before, work.frame, threads, x, near))
        return cell if own is None else own[cell], weights

    return locate


def new_vertices(
    work: Prepared, outcome: Outcome, around: Callable[..., Any], *, moved: bool,
    always: bool = False,
) -> NewVertices | None:
    """Where point data come from, when vertices came or went, or have others where they moved.

    If cells that change alone give vertices other data, it is asked for `always`.
    """
    before = work.mesh if work.tangle is None else work.tangle.around
    n = len(before.points)
    written: Any = outcome.written
    origin = np.arange(n) if outcome.origin is None else outcome.origin
    placed = origin < 0
    if moved:
        placed |= (written != work.host.points[origin]).any(axis=1)
    if outcome.origin is None and not placed.any() and not always:
        return None
    star = np.zeros(n, dtype=np.int32)
    star[before.cells] = np.arange(len(before.cells), dtype=np.int32)[:, None]
    near = star[origin]
    if outcome.origin is not None:
        beside = np.zeros(len(written), dtype=np.int32)
        source: Any = outcome.source
        source = source if work.tangle is None else work.tangle.source_around[source]
        beside[outcome.cells] = source[:, None]
        near = np.where(origin < 0, beside, near)
    cell, weights = around(written[placed].astype(np.float64), near[placed])
    if before.is_surface and (work.same is None or outcome.origin is not None):
        from odt_plugins.engine.surface.sides import on_own_side

        cell, weights = on_own_side(before.points, before.cells, (cell, weights),
                                    outcome.points, outcome.cells, np.flatnonzero(placed))
    number = new_numbers(origin, n)[:n].astype(np.int64)
    if work.same is not None:
        number = np.where(number < 0, number[work.same], number)

    @cache
    def both() -> tuple[NDArray[np.int8], NDArray[np.int8]]:
        was, now = (depths(m.points, m.cells, m.regions) for m in (before, outcome))
        return was, now[placed]

    return NewVertices(origin, number, np.flatnonzero(placed), before.cells[cell], weights,
                       depths=both)


def new_faces(work: Prepared, given: HostMesh, outcome: Outcome) -> tuple[NewFaces | None, ...]:
    """What the lines and triangles beside the cells have become; nothing where all stayed."""
    from scipy.spatial import cKDTree

    before, origin = work.mesh, outcome.origin
    if origin is None or not any(len(faces.rows) for faces in before.faces):
        return ()
    number = new_numbers(origin, len(before.points))
    out: list[NewFaces | None] = []
    for _, raw, classes, *_ in given.kept:
        rows = np.asarray(raw, dtype=np.int64)
        size = rows.shape[1]
        labels = np.full(len(rows), -1, dtype=np.int32)
        if classes is not None and size > 1:
            labels = labels_at(rows, before.faces[size - 2])
        if (labels < 0).all():
            out.append(None)
            continue
        now = outcome.faces[size - 2]
        fresh = np.isin(now.labels, labels[labels >= 0])
        made, of = now.rows[fresh], now.labels[fresh]
        source = np.empty(len(made), dtype=np.int64)
        for label in np.unique(of).tolist():
            own = np.flatnonzero(labels == label)
            places = before.points[rows[own]].mean(axis=1)
            here = of == label
            nearest = cKDTree(places).query(outcome.points[made[here]].mean(axis=1))[1]
            source[here] = own[nearest]
        turned = _turned(before, rows[source], outcome, made)
        made[turned, -2:] = made[turned, :-3:-1]
        same = number[rows[source]]
        itself = (np.sort(made, axis=1) == np.sort(same, axis=1)).all(axis=1)
        made[itself] = same[itself]
        stays = np.flatnonzero(labels < 0)
        both = np.concatenate([number[rows[stays]], made]).astype(np.int64)
        source = np.concatenate([stays, source])
        order = np.argsort(source, kind="stable")
        out.append(NewFaces(both[order], source[order]))
    return tuple(out)


def _turned(
    before: SimplexMesh, rows: NDArray[np.int64], after: Outcome, made: IntArray
) -> BoolArray:
    """Which faces made (k, r) are the other way round than those (k, r) they come from.

    Facets are looked at from the cell of the lower region, lines along those they come from.
    """
    out = np.zeros(len(made), dtype=np.bool_)
    if made.shape[1] == 2:
        along, was = (x.points[pair[:, 1]] - x.points[pair[:, 0]] for x, pair in (
            (after, made), (before, rows)))
        out = (along * was).sum(axis=1) < 0.0
    if made.shape[1] == before.cells.shape[1] - 1:
        (one, old), (two, new) = (turns_of(faces, _outward(x))
                                  for x, faces in ((before, rows), (after, made)))
        out = np.where(one & two, old != new, out)
    return out


def _outward(mesh: SimplexMesh | Outcome) -> IntArray:
    """Facets (q, d) of boundary and interfaces, out of the cell of the lower region first."""
    found = locked_facets(mesh.cells, mesh.regions, len(mesh.points))
    facets: IntArray = found.facets[np.argsort(found.labels, kind="stable")].astype(np.int32)
    return facets
