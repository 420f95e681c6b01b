"""Sets of points where points were added: those within what the old points of a set make up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.decks import indices
from odt_plugins.adapters.higher_order import HigherOrder, shape_values
from odt_plugins.adapters.host import (
    CREASE,
    INSIDE,
    INTERFACE,
    OUTSIDE,
    HostMesh,
    NewVertices,
    Result,
    as_indices,
)
from odt_plugins.errors import DataNotKeptWarning, counted, warn
from odt_plugins.mesh.facets import row_keys

ZERO = 1e-9
"""Barycentric coordinates below which a point is on the opposite face."""

SMOOTH = 0.9
"""Least cosine of the angle between facets where there is no crease."""

SLACK = 0.1
"""How much further than the nearest facet one that a point is on may be, by the shortest edge."""

FINE = 4
"""Into how many flat pieces an edge of a curved facet is cut for distances from it."""


def with_added(
    members: NDArray[np.integer], host: HostMesh, result: Result, vertices: NewVertices
) -> NDArray[np.int64]:
    """Members of a point set in the result: first the old points, then those that were added.

    A point that was added is in the set where the corners of the input around it all are: those
    of a cell where most points of the set are in cells that it has as a whole, those of the facet
    on the boundary or an interface next to it where most are in such facets. Points of the set
    that are of no cell, as those of cells beside, do not count.

    Parameters
    ----------
    members : (q,) int           points of the input
    host : HostMesh              of the input
    result : Result
    vertices : NewVertices       of that result
    """
    number: NDArray[np.int64] = vertices.number[members]
    number = number[number >= 0]
    new = vertices.origin[vertices.placed] < 0
    if not len(members) or not new.any():
        return number
    n = len(vertices.number)
    inside = np.zeros(n, dtype=np.bool_)
    inside[members] = True
    placed, near = vertices.placed[new], vertices.corners[new]
    shape, corners = host.shape, host.cells.shape[1]
    cells = np.asarray(host.cells if host.nodes is None else host.nodes, dtype=np.int64)
    members = members[np.isin(members, cells)]
    walls, outer = _walls(cells, host.regions, n, shape)
    joins: NDArray[np.bool_] = np.zeros(len(placed), dtype=np.bool_)
    whole = whole_cells(members, cells, walls, n, shape)
    if len(whole):
        away = np.abs(vertices.weights[new]) > ZERO
        joins = np.asarray((inside[near] | ~away).all(axis=1) & away.any(axis=1))
        sheet = walls_of(whole, None, n, shape)
    else:
        chosen: NDArray[np.bool_] = np.asarray(inside[walls].all(axis=1))
        # Facets of an interface may have all their points on the boundary.
        if not chosen[~outer].all() and np.isin(members, walls[chosen & outer]).all():
            chosen &= outer
        sheet = walls[chosen]
        if not _filled(sheet, members, n):
            return number
    of_cells = None if host.regions is None else host.regions[result.source]
    on = np.zeros(len(result.points), dtype=np.bool_)
    on[walls_of(result.cells, of_cells, len(result.points), shape)] = True
    points, own = result.points.astype(np.float64), np.flatnonzero(on[placed])
    before = host.points.astype(np.float64)
    slack = SLACK * _shortest(points, np.asarray(result.cells))[placed[own]]
    away_from = [_nearest(points[placed[own]], near[own], facets[:, : corners - 1],
                          _pieces(before, facets, shape)) for facets in (walls, sheet)]
    joins[own] |= away_from[1] < away_from[0] + slack
    return np.concatenate([number, placed[joins]])


def with_nodes(
    mapping: Mapping[str, Any], host: HostMesh, result: Result, q: HigherOrder
) -> dict[str, Any]:
    """Sets of nodes of cells of higher order by name, with nodes of new places.

    Such a node lies in the cell of the input from which one around it comes. A set of all nodes is
    one of all again.

    Parameters
    ----------
    mapping : dict             sets of the input
    host : HostMesh            of the input
    result : Result            of the corners
    q : HigherOrder            all nodes of that result
    """
    near = np.zeros(len(q.points), dtype=np.int64)
    near[q.cells] = result.source[:, None]
    new = np.flatnonzero(q.origin < 0)
    around = np.asarray(host.nodes)[near[new]].astype(np.int32)
    vertices = NewVertices(q.origin, q.number, new, around, np.ones(around.shape))
    of_nodes = Result(q.points, q.cells, result.source)
    out = {}
    for name, members in mapping.items():
        given = indices(members)
        whole = len(np.unique(given)) == len(q.number)
        out[name] = as_indices(np.arange(len(q.points)) if whole else with_added(
            given, host, of_nodes, vertices), np.asarray(members))
    return out


def with_links(
    links: Sequence[Any], number: NDArray[np.integer], before: NDArray[Any], after: NDArray[Any]
) -> list[Any]:
    """Periodic links of a mesh of meshio, [.., .., .., pairs (q, 2) of points], in other numbers.

    Parameters
    ----------
    links : list              of the input
    number : (n,) int         point of the result for every one of the input, -1 if it went
    before, after : (n, D)    points of the input and of the result

    Returns
    -------
    list                      those all of whose points are there, and moved alike if at all

    Warns
    -----
    DataNotKeptWarning        there are others
    """
    out = []
    for *head, pairs in links:
        old = np.asarray(pairs)
        new = np.asarray(number[old.astype(np.int64)])
        moved = after[new].astype(np.float64) - before[old.astype(np.int64)]
        near = 1e-9 * np.ptp(before, axis=0).max(initial=0.0)
        if (new >= 0).all() and (np.abs(moved[:, 0] - moved[:, 1]) <= near).all():
            out.append([*head, as_indices(new, old)])
    if len(out) < len(links):
        msg = (f"{counted(len(links) - len(out), 'periodic link')} whose points went or moved "
               f"are left out; to keep them leave 'periodic' out of free")
        warn(msg, DataNotKeptWarning)
    return out


def whole_cells(
    members: NDArray[np.integer], cells: NDArray[np.integer], walls: NDArray[np.int64], n: int,
    shape: NDArray[np.int64] | None = None,
) -> NDArray[np.int64]:
    """Cells all of whose points are in a set (q,), if most of the set is there and it is a volume.

    It is none where most of the walls (w, r) that it has as a whole are of other cells, as where
    cells in the corners of a mesh have all their points on its boundary.
    """
    inside = np.zeros(n, dtype=np.bool_)
    inside[members] = True
    whole: NDArray[np.int64] = cells[inside[cells].all(axis=1)].astype(np.int64)
    own = walls[inside[walls].all(axis=1)]
    key = _keys(np.concatenate([own, _facets(whole, shape)]), n, shape)
    of_whole = np.isin(key[: len(own)], key[len(own):])
    volume = _filled(whole, members, n) and 2 * of_whole.sum() >= len(own)
    return whole if volume else whole[:0]


def of_corners(
    members: NDArray[np.integer], cells: NDArray[np.integer], walls: NDArray[np.int64], n: int,
    shape: NDArray[np.int64] | None,
) -> NDArray[np.integer]:
    """Corners of a set (q,) that walls (w, r) fill, whose other nodes follow; all of any other."""
    if shape is None:
        return members
    inside = np.zeros(n, dtype=np.bool_)
    inside[members] = True
    sheet = walls[inside[walls].all(axis=1)]
    corners = cells[:, : shape.shape[1]]
    return members[np.isin(members, corners)] if np.isin(members, sheet).all() else members


def _nearest(
    places: NDArray[np.float64], near: NDArray[np.integer], facets: NDArray[np.int64],
    pieces: list[NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Distance (k,) of every place (k, D) from the pieces of those facets (q, r) at its points
    `near` (k, c).
    """
    row, facet = _around(near, facets, int(max(facets.max(initial=0), near.max(initial=0))) + 1)
    out = np.full(len(places), np.inf)
    for piece in pieces:
        np.minimum.at(out, row, _distances(places[row], piece[facet]))
    return out


def _pieces(
    points: NDArray[np.float64], facets: NDArray[np.int64], shape: NDArray[np.int64] | None
) -> list[NDArray[np.float64]]:
    """Corners (q, r, D) of the flat pieces of facets; one each where all of them are flat."""
    if shape is None:
        return [points[facets]]
    own = _facet_nodes(shape)[0][1]
    corners = own.shape[1]
    flat = points[facets[:, :corners]]
    middle = np.einsum("kc,qcx->qkx", own / own[0, 0], flat)
    if np.allclose(points[facets], middle, rtol=0.0, atol=ZERO * np.ptp(points)):
        return [flat]
    steps = np.arange(FINE + 1)
    at = np.stack(np.meshgrid(*[steps] * (corners - 1), indexing="ij"), axis=-1)
    at = at.reshape(-1, corners - 1)
    weights = np.column_stack([FINE - at.sum(axis=1), at]) / FINE
    bent = np.einsum("kc,qcx->qkx", shape_values(own, weights), points[facets])
    if corners == 2:
        return [bent[:, [i, i + 1]] for i in range(FINE)]
    wide = FINE + 1
    first = [wide * i + j for i in range(FINE) for j in range(FINE - i)]
    return [*(bent[:, [k, k + wide, k + 1]] for k in first),
            *(bent[:, [k + wide, k + wide + 1, k + 1]] for k in first
              if k // wide + k % wide < FINE - 1)]


def _around(
    near: NDArray[np.integer], walls: NDArray[np.int64], n: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pairs of a row (k, c) of points and a wall (q, r) that has some of them."""
    order = np.argsort(walls, axis=None, kind="stable")
    first = np.searchsorted(walls.ravel()[order], np.arange(n + 1))
    start, size = first[near].ravel(), (first[near + 1] - first[near]).ravel()
    row = np.repeat(np.arange(near.size), size)
    place = np.arange(len(row)) + (start - np.cumsum(size) + size)[row]
    return row // near.shape[1], order[place] // walls.shape[1]


def _distances(points: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances (k,) of points (k, D) from lines or triangles (k, r, D)."""
    out = np.full(len(points), np.inf)
    for i, j in combinations(range(corners.shape[1]), 2):
        along, to = corners[:, j] - corners[:, i], points - corners[:, i]
        length = np.maximum((along * along).sum(axis=1), np.finfo(np.float64).tiny)
        share = np.clip((to * along).sum(axis=1) / length, 0.0, 1.0)
        off = to - share[:, None] * along
        out = np.minimum(out, (off * off).sum(axis=1))
    if corners.shape[1] == 3:
        sides = np.roll(corners, -1, axis=1) - corners
        normal = np.cross(sides[:, 0], sides[:, 1])
        turned = np.cross(sides, points[:, None] - corners)
        over = (np.einsum("kij,kj->ki", turned, normal) > 0.0).all(axis=1)
        height = ((points - corners[:, 0]) * normal).sum(axis=1)[over]
        out[over] = height * height / (normal * normal).sum(axis=1)[over]
    return np.asarray(np.sqrt(out))


def _shortest(points: NDArray[np.float64], cells: NDArray[np.integer]) -> NDArray[np.float64]:
    """Length (n,) of the shortest line to another point of its cells, at every point."""
    out = np.full(len(points), np.inf)
    for i, j in combinations(range(cells.shape[1]), 2):
        along = points[cells[:, i]] - points[cells[:, j]]
        length = (along * along).sum(axis=1)
        np.minimum.at(out, cells[:, i], length)
        np.minimum.at(out, cells[:, j], length)
    return np.asarray(np.sqrt(out))


def _filled(rows: NDArray[np.integer], members: NDArray[np.integer], n: int) -> bool:
    """Whether most members are corners of these rows."""
    corner = np.zeros(n, dtype=np.bool_)
    corner[rows] = True
    return bool(2 * corner[members].sum() > len(members))


def _facets(cells: NDArray[np.integer], shape: NDArray[np.int64] | None) -> NDArray[np.int64]:
    """Facets of cells (m, k) with all their nodes in one order, those of every side together."""
    weights = np.eye(cells.shape[1], dtype=np.int64) if shape is None else shape
    return np.concatenate([cells[:, nodes] for nodes, _ in _facet_nodes(weights)]).astype(np.int64)


def _facet_nodes(
    shape: NDArray[np.int64]
) -> list[tuple[NDArray[np.intp], NDArray[np.int64]]]:
    """Nodes of every side of a cell, corners first, and their weights, which are alike for all."""
    out = []
    for i in range(shape.shape[1]):
        nodes = np.flatnonzero(shape[:, i] == 0)
        own = np.delete(shape[nodes], i, axis=1)
        order = np.lexsort((*-own.T[::-1], (own > 0).sum(axis=1) > 1))
        out.append((nodes[order], own[order]))
    return out


def _keys(facets: NDArray[np.int64], n: int, shape: NDArray[np.int64] | None) -> NDArray[np.int64]:
    """Numbers of facets, equal where the corners are."""
    corners = facets.shape[1] if shape is None else shape.shape[1] - 1
    return row_keys(np.sort(facets[:, :corners], axis=1), n)


def depths(
    points: NDArray[np.floating], cells: NDArray[np.integer],
    labels: NDArray[np.integer] | None, shape: NDArray[np.int64] | None = None,
) -> NDArray[np.int8]:
    """How far inside (n,) points are; those of no cell, as of cells beside, are outside."""
    n = len(points)
    out = np.full(n, OUTSIDE, dtype=np.int8)
    out[cells] = INSIDE
    walls, outer = _walls(cells, labels, n, shape)
    out[walls] = INTERFACE
    walls = walls[outer]
    out[walls] = OUTSIDE
    corners = cells.shape[1] if shape is None else shape.shape[1]
    places = points[walls[:, : corners - 1]].astype(np.float64)
    ways = places[:, 1:] - places[:, :1]
    normal = ways[:, 0] if corners == 3 else np.cross(ways[:, 0], ways[:, 1])
    size = np.sqrt((normal**2).sum(axis=1, keepdims=True))
    normal = np.divide(normal, size, out=np.zeros_like(normal), where=size > 0.0)
    one = np.zeros(n, dtype=np.int64)
    one[walls] = np.arange(len(walls))[:, None]
    along = np.abs((normal[:, None] * normal[one[walls]]).sum(axis=2))
    out[walls[along < SMOOTH]] = CREASE
    return out


def walls_of(
    cells: NDArray[np.integer], labels: NDArray[np.integer] | None, n: int,
    shape: NDArray[np.int64] | None = None,
) -> NDArray[np.int64]:
    """Facets of one cell alone, or of two of different labels, with all their nodes.

    Of cells (m, k) of higher order `shape` (k, d + 1) are the weights of the nodes.
    """
    return _walls(cells, labels, n, shape)[0]


def _walls(
    cells: NDArray[np.integer], labels: NDArray[np.integer] | None, n: int,
    shape: NDArray[np.int64] | None,
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The facets of :func:`walls_of`, and which of them are of one cell alone."""
    facets = _facets(cells, shape)
    _, first, inverse, count = np.unique(
        _keys(facets, n, shape), return_index=True, return_inverse=True, return_counts=True)
    differ = np.zeros(len(first), dtype=np.bool_)
    if labels is not None:
        inverse = inverse.ravel()
        label = np.tile(labels.ravel(), len(facets) // max(len(cells), 1))
        differ[inverse[label != label[first[inverse]]]] = True
    chosen = (count == 1) | differ
    return np.asarray(facets[first[chosen]]), count[chosen] == 1
