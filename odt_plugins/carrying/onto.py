"""Vertices onto the geometry that a mesh was made of, those that came as well as those that moved.

A vertex that came is on the curve or the face whose lines or triangles it is in.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.elevated import BentEdges
from odt_plugins.adapters.host import Geometry, HostMesh
from odt_plugins.carrying.following import Prepared
from odt_plugins.errors import counted
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray, LongArray
from odt_plugins.mesh.faces import Faces, labels_at
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.simplex import Smooth, diagonal
from odt_plugins.options import Options

if TYPE_CHECKING:
    from odt_plugins.engine.run.outcome import Outcome

LARGEST = 0.5
"""Envelope, as a part of the diagonal, up to which the sag of a surface is added to it."""

THERE = 1e-11
"""Distance, as a part of the largest coordinate, within which a vertex is on the geometry and stays
where it is."""

ASTRAY = 1e-4
"""Distance, as a part of the diagonal, from which on a vertex is not on the geometry."""


def on_geometry(work: Prepared) -> Prepared:
    """Drop the geometry of a mesh whose vertices do not lie on it, and note that."""
    geometry = work.host.geometry
    if geometry is None:
        return work
    own = np.flatnonzero(geometry.on >= 0)
    places = np.asarray(work.host.points[own], dtype=np.float64)
    off = np.abs(geometry.closest(geometry.on[own], places) - places).max(axis=1, initial=0.0)
    astray = int((off > ASTRAY * diagonal(places)).sum()) if len(own) else 0
    if not astray:
        return work
    are = counted(astray, "vertex of the surface is", "vertices of the surface are")
    note = (f"{are} not on the geometry that the mesh refers to, {off.max():.3g} from it at most; "
            f"the surface slides on its own triangles")
    return work._replace(host=replace(work.host, geometry=None), notes=(*work.notes, note))


def near_geometry(work: Prepared, options: Options) -> tuple[Prepared, Options]:
    """The mesh with the geometry that its surface is on, and an envelope around that.

    The surface of the input sags from the geometry.
    """
    geometry = work.host.geometry
    if geometry is None:
        return work, options
    sag = geometry.sag()

    def put(outcome: Outcome) -> FloatArray:
        points, moved = outcome.points.copy(), came_or_moved(work.mesh.points, outcome)
        new = in_space(work, outcome, moved, onto=True)
        points[moved] = new if work.frame is None else work.frame.to_plane(new)
        return points

    envelope = min(options.envelope + sag / work.mesh.extent, LARGEST)
    mesh = replace(work.mesh, smooth=Smooth(sag, put))
    return work._replace(mesh=mesh), replace(options, envelope=envelope)


def came_or_moved(before: FloatArray, outcome: Outcome) -> BoolArray:
    """Vertices (n,) that are not where one of a mesh was; vertices of no mesh may be among them."""
    n = len(outcome.points)
    origin = np.arange(n) if outcome.origin is None else outcome.origin
    known = (origin >= 0) & (origin < len(before))
    stays = np.zeros(n, dtype=np.bool_)
    stays[known] = (outcome.points[known] == before[origin[known]]).all(axis=1)
    return ~stays


def in_space(work: Prepared, outcome: Outcome, moved: BoolArray, *, onto: bool) -> NDArray[Any]:
    """Places (k, D) of vertices that moved or came, as the caller sees them.

    Parameters
    ----------
    work : Prepared
    outcome : Outcome    its `faces` tell on which pieces of the geometry vertices came
    moved : (n,) bool
    onto : bool          whether those of a surface are put on the geometry
    """
    places = outcome.points[moved]
    if work.frame is not None:
        places = work.frame.to_space(places)
    if not onto or work.host.geometry is None:
        return places
    found = work.host.geometry.closest(_pieces(work, outcome)[moved], places)
    off = np.abs(found - places).max(axis=1, initial=0.0)
    there = off <= THERE * np.abs(places).max(initial=0.0)
    return np.where(there[:, None], places, found)


def _pieces(work: Prepared, outcome: Outcome) -> LongArray:
    """Face or curve (n,) of the geometry on which every vertex is, -1 of none."""
    geometry = work.host.geometry
    n = len(outcome.points)
    origin = np.arange(n) if outcome.origin is None else outcome.origin
    out = np.full(n, -1, dtype=np.int64)
    if geometry is None:
        return out
    known = (origin >= 0) & (origin < len(geometry.on))
    out[known] = geometry.on[origin[known]]
    came = origin < 0
    if not came.any():
        return out
    for rows, piece in _rows_on(work, outcome, geometry):
        low, high = np.full(n, np.iinfo(np.int64).max), np.full(n, -1)
        np.minimum.at(low, rows.ravel(), np.repeat(piece, rows.shape[1]))
        np.maximum.at(high, rows.ravel(), np.repeat(piece, rows.shape[1]))
        here = came & (low <= high)
        out[here] = np.where(low == high, low, -1)[here]
    return out


def edges_onto(work: Prepared, outcome: Outcome, curved: BentEdges | None) -> BentEdges | None:
    """Edges on faces and curves of the geometry, and places of their nodes there.

    Parameters
    ----------
    work : Prepared               of the corners of quadratic cells
    outcome : Outcome             its `faces` tell on which pieces of the geometry edges are
    curved : BentEdges or None    edges whose nodes are near some places; others are near middles
    """
    geometry, n = work.host.geometry, len(outcome.points)
    if geometry is None:
        return curved
    ends, on = _edges_on(work, outcome, geometry)
    places = outcome.points[ends].mean(axis=1)
    places = places if work.frame is None else work.frame.to_space(places)
    if curved is not None:
        known = row_keys(np.sort(curved.ends, axis=1), n)
        order, key = np.argsort(known), row_keys(ends, n)
        near = np.isin(key, known)
        places[near] = curved.places[order[np.searchsorted(known[order], key[near])]]
        rest = ~np.isin(known, key)
        ends = np.concatenate([ends, np.sort(curved.ends[rest], axis=1)])
        places = np.concatenate([places, curved.places[rest]])
        on = np.concatenate([on, np.full(rest.sum(), -1)])
    return BentEdges(ends, geometry.closest(on, places))


def _edges_on(
    work: Prepared, outcome: Outcome, geometry: Geometry
) -> tuple[IntArray, LongArray]:
    """Edges (k, 2) of lines and triangles of a geometry, and the one curve or face (k,) of each."""
    pairs, of, line = [np.zeros((0, 2), np.int32)], [np.zeros(0, np.int64)], [np.zeros(0, bool)]
    for rows, piece in _rows_on(work, outcome, geometry):
        k = rows.shape[1]
        for i in range(k if k > 2 else 1):
            pairs.append(rows[:, [i, (i + 1) % k]])
            of.append(piece)
            line.append(np.full(len(rows), k == 2))
    ends, number, lines = np.sort(np.concatenate(pairs), axis=1), np.concatenate(of), (
        np.concatenate(line))
    _, first, edge = np.unique(
        row_keys(ends, len(outcome.points)), return_index=True, return_inverse=True)
    is_line = np.zeros(len(first), dtype=np.bool_)
    is_line[edge[lines]] = True
    counts = lines | ~is_line[edge]
    low, high = np.full(len(first), np.iinfo(np.int64).max), np.full(len(first), -1)
    np.minimum.at(low, edge[counts], number[counts])
    np.maximum.at(high, edge[counts], number[counts])
    one = (low == high) & (low >= 0)
    return ends[first[one]].astype(np.int32), low[one]


def _rows_on(
    work: Prepared, outcome: Outcome, geometry: Geometry
) -> list[tuple[IntArray, LongArray]]:
    """Triangles (q, 3), then lines (q, 2), each with the faces or curves (q,) that they are on."""
    mesh, found = work.mesh, []
    if mesh.is_surface:
        regions, first = np.unique(mesh.regions, return_index=True)
        piece = geometry.cells[first][np.searchsorted(regions, outcome.regions)]
        found.append((outcome.cells, piece))
    for was, now in zip(mesh.faces[::-1], outcome.faces[::-1], strict=True):
        if len(now.rows):
            found.append((now.rows, _of_labels(was, work.host)[now.labels]))
    return found


def _of_labels(faces: Faces, host: HostMesh) -> LongArray:
    """Face or curve of the geometry of every label of lines or triangles."""
    out = np.full(int(faces.labels.max(initial=-1)) + 1, -1, dtype=np.int64)
    for _, raw, classes, *_ in host.kept:
        if classes is None or np.shape(raw)[1] != faces.rows.shape[1]:
            continue
        label = labels_at(np.asarray(raw), faces)
        own = np.flatnonzero(label >= 0)
        own = own[out[label[own]] < 0]
        out[label[own]] = classes[own]
    return out
