"""Keep sound the cells that lie beside the optimised ones: lines, boundary triangles, hexahedra."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.host import (
    CELL_VERTEX,
    NAMED_VERTEX,
    SET_VERTEX,
    SPLINE_VERTEX,
    HostMesh,
    KeptCells,
)
from odt_plugins.errors import InvalidMeshError, counted, place_within
from odt_plugins.mesh.arrays import BoolArray, IntArray
from odt_plugins.mesh.components import components
from odt_plugins.mesh.faces import Faces, borders_of, ends_of, no_faces
from odt_plugins.mesh.facets import directed_facets, facets_within, row_keys
from odt_plugins.mesh.periodic import periodic_triangles
from odt_plugins.mesh.simplex import SimplexMesh, freeze, with_same_cells
from odt_plugins.mesh.soup import HELD, hold_twins, told_of_twins, twins
from odt_plugins.mesh.surface import disagreeing_edges, ways_out

NAMED = 5
"""Most places that a note names."""


def hold_kept(
    mesh: SimplexMesh, host: HostMesh, *, free: bool = False, advise: bool = True,
    resized: bool = False,
) -> tuple[SimplexMesh, tuple[str, ...]]:
    """:func:`protect` what a mesh has beside its cells, and tell of facets inside of a region.

    Parameters
    ----------
    mesh : SimplexMesh
    host : HostMesh       that it comes from
    free : bool           whether the vertices of facets inside may move
    advise : bool         whether to tell how they may
    resized : bool        see :func:`protect`
    """
    safe = protect(mesh, host.kept, host.anchors, free=free, resized=resized)
    return safe, _note_inside(mesh, safe, host, free=free, advise=advise)


def protect(
    mesh: SimplexMesh, kept: tuple[KeptCells, ...], anchors: NDArray[Any] | None = None,
    *, free: bool = False, resized: bool = False,
) -> SimplexMesh:
    """Fix vertices and part regions so that the kept cells fit the optimised mesh as before.

    Parameters
    ----------
    mesh : SimplexMesh
    kept : tuple of KeptCells    a line or triangle on the boundary or on an interface stays
                                 anyway; for one inside the cells around are parted into more
                                 regions, of the same body; of anything else the vertices are
                                 fixed; facets between vertices that a file names, and facets
                                 and edges between those of other cells, stay with these, and where
                                 sizes change vertices of a set that are those of facets come and
                                 go, within the border of these
    anchors : (k,) int           vertices that must not be removed; none out of range counts
    free : bool                  whether the vertices of facets inside may move
    resized : bool               whether those with classes may become others

    Returns
    -------
    SimplexMesh                  the same mesh with more in `fixed`, `regions` and `anchored`; edges
                                 of lines and triangles that stay are in `stays`, lines in `lines`
                                 too, and those that may become others in `faces`

    Raises
    ------
    InvalidMeshError             a kept cell refers to a vertex that does not exist
    """
    n = len(mesh.points)
    loose: list[NDArray[np.int64]] = [np.zeros(0, dtype=np.int64)]
    inner: list[NDArray[np.int64]] = []
    stays = [mesh.stays]
    lines = [mesh.lines]
    named: list[tuple[NDArray[np.int64], NDArray[Any]]] = []
    alike: list[tuple[NDArray[np.int64], NDArray[Any]]] = []
    for kind, raw, classes, labels, _, walls in kept:
        rows = _rows_of(mesh, kind, raw)
        if rows.shape[1] > 1:
            held, exposed, _ = _hold(mesh, rows)
            inner += [rows[exposed]] if exposed.any() else []
            own = labels if classes is None else classes
            become = resized and classes is not None and _once(rows)
            if own is not None and _once(rows):
                (named if become else alike).append((rows[held & ~exposed], own[held & ~exposed]))
            if not become:
                stays.append(_edges(rows[held]))
            if rows.shape[1] == 2:
                lines.append(_edges(rows[held]))
            rows = rows[~held]
            if rows.shape[1] == 3:
                stays.append(_rims_of(mesh, rows.ravel()))
        elif kind == NAMED_VERTEX:
            stays.append(_edges(_facets_of(mesh, rows.ravel())))
        elif walls is not None:
            facets = facets_within(mesh.cells, rows[:, 0], walls)
            stays += [_rims_of(mesh, rows[:, 0]), _edges(facets)]
            exposed = _hold(mesh, facets)[1]
            inner += [facets[exposed]] if exposed.any() else []
        elif resized and kind.startswith(SET_VERTEX):
            facets, own = _facets_of(mesh, rows.ravel()), np.intersect1d(rows, mesh.cells)
            own = np.setdiff1d(own, np.concatenate(loose))
            if 2 * len(facets) > len(own) and np.isin(own, facets).all():
                named.append((facets, np.zeros(len(facets), dtype=np.int64)))
                continue
        loose.append(rows.ravel())
    anchored = _anchored(anchors, n)
    loose += [rows.ravel() for rows in inner
              if not (free and rows.shape[1] == mesh.cells.shape[1] - 1)]
    faces = _named(named, 2), _named(named, 3)
    fixed = mesh.fixed | ends_of(faces[0], n) | ends_of(_named(alike, 2), n)
    fixed[np.concatenate(loose)] = True
    lines.append(borders_of(_named(alike, 3)))
    safe = with_same_cells(mesh, fixed=fixed, stays=np.concatenate(stays), faces=faces,
                           lines=np.concatenate(lines), anchored=anchored)
    return _parted(safe, inner) if inner else safe


def _facets_of(mesh: SimplexMesh, vertices: NDArray[np.int64]) -> NDArray[np.int64]:
    """Facets of the boundary and of interfaces all of whose corners are among some vertices."""
    among = np.zeros(len(mesh.points), dtype=np.bool_)
    among[vertices] = True
    k = mesh.cells.shape[1]
    near = np.flatnonzero(among[mesh.cells].sum(axis=1) >= k - 1)
    if not near.size:
        return np.zeros((0, k - 1), dtype=np.int64)
    stay = _staying_facets(mesh, near)
    ordered = np.sort(mesh.cells[near], axis=1).astype(np.int64)
    found = np.concatenate([np.delete(ordered, i, axis=1)[stay[:, i]] for i in range(k)])
    held: NDArray[np.int64] = found[among[found].all(axis=1)]
    return held


def _rims_of(mesh: SimplexMesh, vertices: NDArray[np.int64]) -> IntArray:
    """Edges of facets of the boundary and of interfaces both of whose ends are among vertices."""
    among = np.zeros(len(mesh.points), dtype=np.bool_)
    among[vertices] = True
    near = np.flatnonzero(among[mesh.cells].sum(axis=1) >= 2)
    if not near.size:
        return np.zeros((0, 2), dtype=np.int32)
    stay = _staying_facets(mesh, near)
    facets = [np.delete(mesh.cells[near[stay[:, i]]], i, axis=1) for i in range(stay.shape[1])]
    edges = _edges(np.concatenate(facets))
    return edges[among[edges].all(axis=1)]


def _anchored(anchors: NDArray[Any] | None, n: int) -> BoolArray:
    """Mask (n,) of vertices that must not be removed."""
    out = np.zeros(n, dtype=np.bool_)
    if anchors is not None:
        out[anchors[(anchors >= 0) & (anchors < n)]] = True
    return out


def _once(rows: NDArray[np.int64]) -> bool:
    """Whether none of the rows is there twice."""
    return len(np.unique(np.sort(rows, axis=1), axis=0)) == len(rows)


def _named(given: list[tuple[NDArray[np.int64], NDArray[Any]]], size: int) -> Faces:
    """Faces of so many vertices; faces of the same classes in all groups have one label."""
    groups = [(np.sort(rows, axis=1), classes) for rows, classes in given if rows.shape[1] == size]
    if not sum(len(rows) for rows, _ in groups):
        return no_faces()[size - 2]
    every, number = np.unique(np.concatenate([rows for rows, _ in groups]), axis=0,
                              return_inverse=True)
    table = np.full((len(every), len(groups)), -1, dtype=np.int64)
    first = 0
    for i, (rows, classes) in enumerate(groups):
        table[number.ravel()[first: first + len(rows)], i] = classes
        first += len(rows)
    labels = np.unique(table, axis=0, return_inverse=True)[1].ravel()
    return Faces(every.astype(np.int32), labels.astype(np.int32))


def _parted(mesh: SimplexMesh, faces: list[NDArray[np.int64]]) -> SimplexMesh:
    """Part the regions of a mesh so that each of these faces is one of a facet between two.

    The facets among them part a region where they part its cells; elsewhere one cell that holds
    such a face is a region of its own.
    """
    n, k = len(mesh.points), mesh.cells.shape[1]
    walls = np.concatenate([np.zeros((0, k - 1), dtype=np.int64),
                            *(rows for rows in faces if rows.shape[1] == k - 1)])
    ordered = np.sort(mesh.cells, axis=1)
    facets = np.concatenate([np.sort(walls, axis=1),
                             *(np.delete(ordered, i, axis=1) for i in range(k))])
    key = row_keys(facets, n)
    wall, key = key[: len(walls)], key[len(walls):]
    order = np.argsort(key, kind="stable")
    twin = np.flatnonzero(key[order][1:] == key[order][:-1])
    twin = twin[~np.isin(key[order[twin]], wall)]
    one, other = order[twin] % len(ordered), order[twin + 1] % len(ordered)
    alike = mesh.regions[one] == mesh.regions[other]
    label = components(one[alike], other[alike], len(ordered))
    parts = with_same_cells(mesh, regions=label)
    own = np.unique(np.concatenate([_hold(parts, rows)[2] for rows in faces]))
    label[own] = label.max() + 1 + np.arange(len(own), dtype=np.int32)
    body = np.zeros(int(label.max()) + 1, dtype=np.int32)
    body[label] = mesh.bodies()
    several = _labels_at(mesh.cells, label, n) > _labels_at(mesh.cells, body[label], n)
    return with_same_cells(mesh, regions=label, body=body, anchored=mesh.anchored | several)


def _labels_at(cells: IntArray, label: NDArray[np.integer], n: int) -> NDArray[np.intp]:
    """How many labels (n,) the cells at each vertex have."""
    width = int(label.max(initial=0)) + 1
    pairs = np.unique(cells.astype(np.int64) * width + label[:, None])
    return np.bincount(pairs // width, minlength=n)


def _edges(rows: NDArray[np.int64]) -> IntArray:
    """Edges (k, 2) of lines and triangles."""
    pairs = list(combinations(range(rows.shape[1]), 2))
    return rows[:, pairs].reshape(-1, 2).astype(np.int32)


def protect_surface(
    mesh: SimplexMesh, kept: tuple[KeptCells, ...], anchors: NDArray[Any] | None = None,
    *, resized: bool = False, others: bool = False
) -> SimplexMesh:
    """Let the lines beside a curved surface be feature edges, and fix all other kept vertices.

    Parameters
    ----------
    mesh : SimplexMesh           triangles in space
    kept : tuple of KeptCells    a line that is an edge of the surface is kept as such, but its
                                 vertices may slide along it; of anything else the vertices are
                                 fixed
    anchors : (k,) int           vertices that must not be removed; none out of range counts
    resized : bool               whether those with classes may become others
    others : bool                whether vertices come and go

    Raises
    ------
    InvalidMeshError             a kept cell refers to a vertex that does not exist
    """
    n = len(mesh.points)
    pairs = np.sort(mesh.cells[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    lines, loose, stays = [mesh.lines], [np.zeros(0, dtype=np.int64)], [mesh.stays]
    named: list[tuple[NDArray[np.int64], NDArray[Any]]] = []
    alike: list[tuple[NDArray[np.int64], NDArray[Any]]] = []
    for kind, raw, classes, labels, _, walls in kept:
        rows = _rows_of(mesh, kind, raw)
        if rows.shape[1] == 2 and len(rows):
            keys = row_keys(np.concatenate([np.sort(rows, axis=1), pairs]), n)
            held = np.isin(keys[: len(rows)], keys[len(rows) :])
            lines.append(rows[held].astype(np.int32))
            own = labels if classes is None else classes
            become = resized and classes is not None and _once(rows)
            if own is not None and _once(rows):
                (named if become else alike).append((rows[held], own[held]))
            if others and not become:
                stays.append(lines[-1])
            rows = rows[~held]
        elif (kind == NAMED_VERTEX or walls is not None) and others:
            among = np.isin(pairs, rows)
            stays.append(pairs[among.all(axis=1)].astype(np.int32))
        loose.append(rows.ravel())
    faces = _named(named, 2), no_faces()[1]
    fixed = mesh.fixed | ends_of(faces[0], n) | ends_of(_named(alike, 2), n)
    fixed[np.concatenate(loose)] = True
    return replace(mesh, fixed=fixed, lines=np.concatenate(lines), stays=np.concatenate(stays),
                   faces=faces, anchored=_anchored(anchors, n))


def hold_charts(mesh: SimplexMesh, charts: NDArray[np.integer] | None) -> SimplexMesh:
    """Fix the vertices of seams of the texture, which have several texture coordinates.

    Parameters
    ----------
    mesh : SimplexMesh       a curved surface; its lines include the seams within a chart
    charts : (m,) or None    chart of every triangle
    """
    fixed = mesh.fixed.copy()
    fixed[mesh.lines.ravel()] = True
    if charts is not None:
        low = np.full(len(mesh.points), np.iinfo(np.int64).max)
        high = np.full(len(mesh.points), -1)
        for corner in mesh.cells.T:
            np.minimum.at(low, corner, charts)
            np.maximum.at(high, corner, charts)
        fixed |= low < high
    return replace(mesh, fixed=fixed)


def _rows_of(mesh: SimplexMesh, kind: str, raw: NDArray[np.integer]) -> NDArray[np.int64]:
    """Vertices of kept cells; of those of a vertex each none where most make up cells or facets."""
    _check_range(kind, raw, len(mesh.points))
    if kind != CELL_VERTEX:
        return np.asarray(raw, dtype=np.int64)
    own = np.intersect1d(raw, mesh.cells).astype(np.int64)
    among = np.zeros(len(mesh.points), dtype=np.bool_)
    among[own] = True
    whole = mesh.cells[among[mesh.cells].all(axis=1)], _facets_of(mesh, own)
    made_up = np.isin(own, np.concatenate([rows.ravel() for rows in whole]))
    return own[:0 if 2 * made_up.sum() > len(own) else None, None]


def _check_range(kind: str, raw: NDArray[np.integer], n: int) -> None:
    bad = np.flatnonzero(((raw < 0) | (raw >= n)).any(axis=1))
    if bad.size:
        msg = (f"got {counted(bad.size, f'{kind} cell')} with vertex indices out of range "
               f"(vertices {raw[bad[0]].tolist()}); the mesh has {n} vertices, expected 0 to "
               f"{n - 1}")
        raise InvalidMeshError(msg)


def _hold(
    mesh: SimplexMesh, rows: NDArray[np.int64]
) -> tuple[BoolArray, BoolArray, NDArray[np.intp]]:
    """Say which rows are faces of cells, which of them could vanish, and a cell for each of the
    latter.
    """
    n, r = len(mesh.points), rows.shape[1]
    marked = np.zeros(n, dtype=np.bool_)
    marked[rows] = True
    near = np.flatnonzero(marked[mesh.cells].sum(axis=1) >= r)
    if not near.size:
        nothing = np.zeros(len(rows), dtype=np.bool_)
        return nothing, nothing, near
    cells = mesh.cells[near]
    ordered = np.sort(cells, axis=1)
    columns = list(combinations(range(cells.shape[1]), r))
    faces = np.stack([ordered[:, c] for c in columns], axis=1)
    keys = row_keys(np.concatenate([np.sort(rows, axis=1), faces.reshape(-1, r)]), n)
    row_key, face_key = keys[: len(rows)], keys[len(rows) :]

    facet_stays = _staying_facets(mesh, near)
    face_stays = np.stack(
        [np.delete(facet_stays, c, axis=1).any(axis=1) for c in columns], axis=1
    ).ravel()
    held = np.isin(row_key, face_key)
    exposed = held & ~np.isin(row_key, face_key[face_stays])
    distinct, first = np.unique(face_key, return_index=True)
    return held, exposed, near[first[np.searchsorted(distinct, row_key[exposed])] // len(columns)]


def _staying_facets(mesh: SimplexMesh, near: NDArray[np.intp]) -> BoolArray:
    """Facets of the cells `near` with no neighbour among them, or one of another region.

    A facet whose neighbour is not in `near` counts as boundary: it holds none of the faces
    that are looked for, since its neighbour would hold them as well.
    """
    key, _ = directed_facets(mesh.cells[near], len(mesh.points))
    _, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    inverse = inverse.ravel()
    order = np.argsort(inverse, kind="stable")
    start = np.concatenate([[0], np.cumsum(count)[:-1]])
    label = np.repeat(mesh.regions[near], key.shape[1])[order]
    differ = np.minimum.reduceat(label, start) != np.maximum.reduceat(label, start)
    stays = (count == 1) | differ
    return np.asarray(stays[inverse].reshape(key.shape))


def _note_inside(
    before: SimplexMesh, after: SimplexMesh, host: HostMesh, *, free: bool, advise: bool
) -> tuple[str, ...]:
    """Tell of facets beside the cells, inside of a region, which hold vertices, or move with them.

    Parameters
    ----------
    before, after : SimplexMesh    the mesh as :func:`protect` took and gave it
    host : HostMesh                that it comes from
    free : bool                    whether they move
    advise : bool                  whether to tell how they may

    Returns
    -------
    tuple of str                   one note, or none where all are on boundary and interfaces
    """
    if not after.body.size:
        return ()
    k = before.cells.shape[1]
    count, own = 0, np.zeros(len(before.points), dtype=np.bool_)
    for _, raw, *_ in host.kept:
        if raw.shape[1] == k - 1:
            rows = np.unique(np.sort(np.asarray(raw, dtype=np.int64), axis=1), axis=0)
            rows = rows[_hold(before, rows)[1]]
            count += len(rows)
            own[rows] = True
    stays = before.fixed | ~own
    facets = _staying_facets(before, np.arange(len(before.cells)))
    ordered = np.sort(before.cells, axis=1)
    for i in range(k):
        stays[np.delete(ordered[facets[:, i]], i, axis=1)] = True
    vertices = int((after.fixed & ~stays).sum())
    if not count or not (vertices or free):
        return ()
    what, cells = ("triangle", "tetrahedra") if k == 4 else ("line", "triangles")
    one = count == 1
    told = (("remains a face of cells and moves with its vertices" if one else
             "remain faces of cells and move with their vertices") if free else
            f"stay{'s' * one} with {counted(vertices, 'vertex', 'vertices')}" + advise * (
                f"; try free='inside' to let these move where they are no "
                f"{'surface' if k == 4 else 'curve'} of yours"))
    return (host.words(f"{counted(count, what)} beside the {cells}, inside of a region, {told}"),)


def hold_places(
    mesh: SimplexMesh, host: HostMesh, *, periodic: bool, resized: bool
) -> tuple[SimplexMesh, tuple[str, ...]]:
    """Hold what may not move each by itself, and say of what and why.

    Parameters
    ----------
    mesh : SimplexMesh     a curved surface, or tetrahedra whose boundary slides
    host : HostMesh        that it comes from
    periodic : bool        whether faces that correspond to each other are held
    resized : bool         whether those that do so by chance are not

    Returns
    -------
    mesh : SimplexMesh     with more in `fixed`, `frozen` and `stays`
    notes : tuple of str
    """
    notes = []
    same = twins(mesh.points, mesh.cells)
    if same.size and not (resized and mesh.is_surface):
        mesh = hold_twins(mesh, same)
        notes.append(told_of_twins(same, HELD))
    splines = sum(len(rows) for kind, rows, *_ in host.kept if kind == SPLINE_VERTEX)
    if splines:
        stay = counted(splines, "vertex on splines stays", "vertices on splines stay")
        notes.append(f"{stay}, since Netgen takes no parameters of points there")
    disagree = mesh.is_surface and mesh.frozen.any()
    if periodic:
        mesh, count, chance = _hold_periodic(mesh, host.coupled, resized=resized)
        if count:
            advice = "" if host.linked else "; try free='periodic' to let them slide"
            stay = counted(count, "vertex of periodic faces stays",
                           "vertices of periodic faces stay")
            notes.append(f"{stay}, so that the faces still correspond{advice}")
        if chance:
            notes.append(f"opposite faces of {counted(chance, 'triangle')} match, by chance as it "
                         f"seems, and need not do so afterwards; try boundary='fixed' to keep them")
    if disagree:
        edges = disagreeing_edges(mesh)
        if len(edges):
            notes.append(f"cells disagree about the outside at {counted(len(edges), 'edge')} "
                         f"({_places(mesh, edges)}) and stay there; try {ways_out(mesh)}")
    return mesh, tuple(host.words(note) for note in notes)


def _places(mesh: SimplexMesh, edges: IntArray) -> str:
    """Vertices of the first few edges, one of each place where several hang together."""
    label = components(edges[:, 0], edges[:, 1], len(mesh.points))[edges[:, 0]]
    first = np.sort(np.unique(label, return_index=True)[1])
    told = [f"{tuple(edges[i].tolist())} around "
            f"({place_within(mesh.extent, mesh.points[edges[i]].mean(axis=0))})"
            for i in first[:NAMED]]
    return (f"{counted(len(first), 'place')}: " + ", ".join(told)
            + (", ..." if len(first) > NAMED else ""))


def _hold_periodic(
    mesh: SimplexMesh, coupled: NDArray[Any] | None, *, resized: bool
) -> tuple[SimplexMesh, int, int]:
    """Hold faces that correspond to each other, but those that do so by chance if ``resized``.

    Returns
    -------
    SimplexMesh, int, int    the mesh, vertices that are held, triangles that match by chance
    """
    held, used = np.zeros((2, len(mesh.points)), dtype=np.bool_)
    used[mesh.cells] = True
    if coupled is not None:
        held[coupled] = used[coupled]
    if mesh.is_surface:
        mesh = freeze(mesh, np.asarray(held[mesh.cells].all(axis=1)), np.flatnonzero(held))
        return with_same_cells(mesh, coupled=held), int(held.sum()), 0
    facets, chance = mesh.uneven.open, 0
    same = [facets[held[facets].all(axis=1)]]
    if facets.shape[1] == 3:
        found, others = periodic_triangles(
            mesh.points, facets, _between_labels(mesh) if resized else None)
        same.append(found)
        chance = int((~held[others].all(axis=1)).sum())
    facets = np.concatenate(same)
    held[facets] = True
    mesh = freeze(mesh, mesh.frozen, np.flatnonzero(held))
    stays = np.concatenate([mesh.stays, _edges(facets)])
    return with_same_cells(mesh, stays=stays, coupled=held), int(held.sum()), chance


def _between_labels(mesh: SimplexMesh) -> BoolArray:
    """Vertices (n,) of cells of several labels; facets inside of a body part no labels."""
    label, one = mesh.bodies()[:, None], np.zeros(len(mesh.points), dtype=np.int64)
    one[mesh.cells] = label
    between = np.zeros(len(one), dtype=np.bool_)
    between[mesh.cells[one[mesh.cells] != label]] = True
    return between
