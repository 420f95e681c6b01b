"""Quadratic cells whose vertices come and go: as linear ones, and back.

The corners are remeshed; every edge then has its node in the middle, or where the curved surface
is. The node of an edge that is still there is the one that it had, bit for bit where its corners
did not move.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.higher_order import shape_values
from odt_plugins.adapters.host import HostMesh, KeptCells, NewFaces, NewVertices, Result, as_indices
from odt_plugins.adapters.point_sets import depths
from odt_plugins.errors import UnsupportedMeshError
from odt_plugins.mesh.bernstein import jacobian_bounds
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.numbers import vertex_mask
from odt_plugins.mesh.simplex import barycentric

STRAIGHT = 1e-3
"""Largest distance of a node from the middle of its edge, in lengths of the edge, for which the
edge is straight."""

POOR = 0.3
"""Scaled Jacobian from which on cells are good enough for edges not to be flatter."""

ROUNDS = 30
"""How often the place of a node within curved cells is corrected at most."""

CLOSE = 1e-9
"""Distance, in lengths of an edge, within which a place in a curved cell is the one looked for."""

ASTRAY = 100.0
"""Square of a distance, in that of the nearest place found, beyond which none is looked for."""


def held(host: HostMesh, fixed: Any = None) -> HostMesh:
    """The same mesh of higher order; where a node that stays is between corners, these stay too.

    Parameters
    ----------
    host : HostMesh
    fixed : (n,) bool, or indices    nodes that are to stay beside those that the mesh keeps
    """
    nodes, shape = np.asarray(host.nodes, dtype=np.int64), np.asarray(host.shape)
    corners = shape.shape[1]
    stays = vertex_mask(fixed, len(host.points), "fixed", "vertices")
    stays[_alone(host)] = True
    alone = stays[nodes[:, corners:]]
    kept: list[KeptCells] = []
    for k in np.flatnonzero(alone.any(axis=0)).tolist():
        rows = nodes[alone[:, k]][:, np.flatnonzero(shape[corners + k])]
        kept.append(KeptCells("corner", rows.reshape(-1, 1)))
        facets = [rows] if rows.shape[1] < corners else [
            np.delete(rows, i, axis=1) for i in range(corners)]
        kept += [KeptCells("edge" if facet.shape[1] == 2 else "face", facet)
                 for facet in facets if facet.shape[1] > 1]
    return replace(host, kept=(*host.kept, *kept)) if kept else host


class BentEdges(NamedTuple):
    """Edges (k, 2) of a surface by their ends, and places (k, D) of their nodes."""

    ends: NDArray[Any]
    places: NDArray[np.float64]


class Edges(NamedTuple):
    """Edges of quadratic cells, each once: ends (k, 2), ascending, and node (k,)."""

    ends: NDArray[np.int64]
    node: NDArray[np.int64]


def linear(host: HostMesh) -> HostMesh:
    """The same mesh of the corners alone.

    Raises
    ------
    UnsupportedMeshError    cells that are not quadratic, or a toolkit that does not take them back
    """
    if host.nodes is None or host.shape is None or int(host.shape[0, 0]) != 2 or not host.whole:
        msg = ("got cells of higher order; expected linear ones, or quadratic ones with a node on "
               "every edge, whose vertices come and go")
        raise UnsupportedMeshError(msg)
    return replace(host, higher_order=False, nodes=None, shape=None, settle=None)


def curved_edges(host: HostMesh) -> Edges:
    """Edges whose nodes are off their middles."""
    edges, points = _edges(host), np.asarray(host.points, dtype=np.float64)
    a, b = (points[end] for end in edges.ends.T)
    off = ((points[edges.node] - 0.5 * (a + b)) ** 2).sum(axis=1)
    curved = off > STRAIGHT**2 * ((b - a) ** 2).sum(axis=1)
    return Edges(edges.ends[curved], edges.node[curved])


def elevated(
    result: Result, host: HostMesh, locate: Callable[[NDArray[Any], NDArray[Any]], Any],
    curved: BentEdges | None = None,
) -> tuple[Result, int]:
    """Put a node on every edge of the result of :func:`linear`.

    Parameters
    ----------
    result : Result      of the corners; nodes of before are vertices that no cell has
    host : HostMesh      with all nodes
    locate : callable    input cells around places near some input cells, and coordinates there
    curved : BentEdges   of the result, where nodes are not in the middle; none of straight edges

    Returns
    -------
    result : Result
    flatter : int        edges of the curved surface that are flatter lest cells be poor
    """
    n, rows = len(host.points), np.asarray(result.cells, dtype=np.int64)
    shape: Any = host.shape
    nodes: Any = host.nodes
    pairs = _pairs(shape)
    vertices = result.vertices
    number = np.arange(n) if vertices is None else vertices.number
    origin = np.arange(n) if vertices is None else vertices.origin
    points = np.asarray(result.points)
    old = _edges(host)
    old = Edges(np.sort(number[old.ends], axis=1), old.node)
    alive = (old.ends >= 0).all(axis=1)
    ends = np.sort(rows[:, pairs].reshape(-1, 2), axis=1)
    key = row_keys(np.concatenate([ends, old.ends[alive]]), len(points))
    _, first, inverse = np.unique(key[: len(ends)], return_index=True, return_inverse=True)
    ends = ends[first]
    known = key[len(rows) * len(pairs):]
    order = np.argsort(known)
    stays = np.isin(key[first], known)
    node = np.full(len(ends), -1, dtype=np.int64)
    node[stays] = old.node[alive][order][np.searchsorted(known[order], key[first][stays])]

    there = np.ones(len(points), dtype=np.bool_)
    gone = np.setdiff1d(old.node, np.concatenate([node[stays], _alone(host)]))
    there[number[gone]] = False
    index = np.where(there, np.cumsum(there) - 1, -1)
    middle = 0.5 * (points[ends[:, 0]].astype(np.float64) + points[ends[:, 1]])
    shifted = (origin[ends] < 0).any(axis=1) | (
        points[ends] != np.asarray(host.points)[origin[ends]]).any(axis=(1, 2))
    out = np.concatenate([points[there], middle[~stays].astype(points.dtype)])
    at = np.empty(len(ends), dtype=np.int64)
    at[stays] = index[number[node[stays]]]
    at[~stays] = there.sum() + np.arange((~stays).sum())
    out[at[stays & shifted]] = middle[stays & shifted]
    cells = np.concatenate([index[rows], at[inverse.reshape(len(rows), -1)]], axis=1)
    flatter = 0
    if curved is not None:
        key = row_keys(np.concatenate([ends, np.sort(curved.ends, axis=1)]), len(points))
        order = np.argsort(key[: len(ends)])
        which = order[np.searchsorted(key[: len(ends)][order], key[len(ends):])]
        new = (~stays | shifted)[which]
        least = jacobian_bounds(np.asarray(host.points)[nodes], shape).scaled.min()
        out[at[which[new]]] = curved.places[new].astype(points.dtype)
        flatter = _unfold(out, cells, shape, at[~stays | shifted], min(least, POOR))

    origin = np.concatenate([origin[there], np.full((~stays).sum(), -1)])
    number = np.where(number < 0, -1, index[number])
    new = origin < 0
    if result.locate is not None:
        new = new | (out != np.asarray(host.points)[origin]).any(axis=1)
    near = np.zeros(len(out), dtype=np.int32)
    near[cells] = result.source[:, None]
    placed = np.flatnonzero(new)
    x = out[placed].astype(np.float64)
    which, weights = locate(x, near[placed])
    if curved is not None:
        which, weights = _in_curved(host, x, which, weights, locate)
    both = (depths(np.asarray(host.points), nodes, host.regions, shape),
            depths(out, cells, None if host.regions is None else host.regions[result.source],
                   shape)[placed])
    followed = NewVertices(origin, number, placed, nodes[which].astype(np.int32),
                           shape_values(shape, weights), depths=lambda: both)
    number_of = dict(zip(map(tuple, ends.tolist()), at.tolist(), strict=True))
    faces = tuple(faces and NewFaces(_with_middles(faces.rows, index, number_of), faces.source)
                  for faces in result.faces)
    return result._replace(points=out, cells=as_indices(cells, result.cells), vertices=followed,
                           locate=None, faces=faces), flatter


def _in_curved(
    host: HostMesh, x: NDArray[np.float64], cell: NDArray[Any], weights: NDArray[np.float64],
    locate: Callable[[NDArray[Any], NDArray[Any]], Any],
) -> tuple[NDArray[Any], NDArray[np.float64]]:
    """Curved cells (k,) around places x (k, D), and coordinates there, from those in flat ones."""
    nodes, shape = np.asarray(host.nodes), np.asarray(host.shape)
    points = np.asarray(host.points, dtype=np.float64)
    off, out = np.full(len(x), np.inf), (cell.copy(), weights.copy())
    left = np.arange(len(x))
    for _ in range(ROUNDS):
        if not len(left):
            break
        around = points[nodes[cell]]
        away = x[left] - _places(shape, weights, around)
        size = (away * away).sum(axis=1)
        closer = size < off[left]
        off[left[closer]] = size[closer]
        out[0][left[closer]], out[1][left[closer]] = cell[closer], weights[closer]
        edge = ((around[:, 1] - around[:, 0]) ** 2).sum(axis=1)
        open_ = (size > CLOSE * CLOSE * edge) & (size <= ASTRAY * off[left])
        flat = (weights[:, :, None] * around[:, : weights.shape[1]]).sum(axis=1)
        aim = _aimed(shape, weights, around, x[left]) - flat
        good = closer & ((aim * aim).sum(axis=1) <= edge)
        left, near = left[open_], cell[open_].astype(np.int32)
        cell, weights = locate((flat + np.where(good[:, None], aim, away))[open_], near)
    return out


def _aimed(
    shape: NDArray[np.int64], weights: NDArray[np.float64], around: NDArray[np.float64],
    x: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Places in flat cells whose places in curved ones are x, to first order around weights.

    Of a quadratic map y the tangent at w has 4 y((w + e) / 2) - 2 y(w) - y(e) at the corner e. On
    triangles in space the places are those nearest to x.
    """
    k = weights.shape[1]
    corners, there = around[:, :k], _places(shape, weights, around)
    tangent = np.stack([
        4.0 * _places(shape, 0.5 * (weights + np.eye(k)[i]), around) - 2.0 * there - corners[:, i]
        for i in range(k)], axis=1) - x[:, None]
    along = np.einsum("qid,qjd->qij", tangent, tangent[:, 1:] - tangent[:, :1])
    found = barycentric(along, np.zeros((len(x), k - 1)))
    found[~np.isfinite(found).all(axis=1)] = np.inf
    with np.errstate(invalid="ignore"):
        out: NDArray[np.float64] = (found[:, :, None] * corners).sum(axis=1)
    return out


def _places(
    shape: NDArray[np.int64], weights: NDArray[np.float64], around: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Places (q, D) of barycentric coordinates in curved cells, of nodes (q, k, D)."""
    out: NDArray[np.float64] = (shape_values(shape, weights)[:, :, None] * around).sum(axis=1)
    return out


def _unfold(
    points: NDArray[Any], cells: NDArray[np.int64], shape: NDArray[np.int64],
    new: NDArray[np.int64], least: float,
) -> int:
    """Flatten new edges of cells whose scaled Jacobian is below ``least``, all of folded cells.

    The way of a node from the middle is halved some times, and then it is in the middle. Returns
    how many edges are flatter.
    """
    pairs, corners = _pairs(shape), shape.shape[1]
    flatter: set[int] = set()
    for share in (0.5, 0.5, 0.5, 0.0, 0.0):
        bounds = jacobian_bounds(points[cells], shape)
        poor = ~bounds.valid | (bounds.scaled < least)
        node, first = np.unique(cells[poor, corners:], return_index=True)
        ends = cells[poor][:, pairs].reshape(-1, 2)[first]
        move = np.isin(node, new) | np.isin(node, cells[~bounds.valid])
        node, ends = node[move], ends[move]
        if not len(node):
            break
        middle = 0.5 * (points[ends[:, 0]] + points[ends[:, 1]].astype(np.float64))
        places = (middle + share * (points[node] - middle)).astype(points.dtype)
        flatter |= set(node[(points[node] != places).any(axis=1)].tolist())
        points[node] = places
    return len(flatter)


def _with_middles(
    rows: NDArray[np.int64], index: NDArray[np.int64], number_of: dict[Any, int]
) -> NDArray[np.int64]:
    """Lines or triangles of the corners with the nodes of their edges behind.

    Those of edges that no cell has are -1.
    """
    pairs = [(0, 1), (1, 2), (2, 0)] if rows.shape[1] == 3 else [(0, 1)]
    ends = np.sort(rows[:, pairs], axis=2)
    middles = [[number_of.get(tuple(edge), -1) for edge in edges] for edges in ends.tolist()]
    return np.concatenate([index[rows], np.array(middles, dtype=np.int64).reshape(
        len(rows), len(pairs))], axis=1)


def _pairs(shape: NDArray[np.int64]) -> NDArray[np.int64]:
    """Corners (e, 2) around every node between them."""
    return np.array([np.flatnonzero(weights) for weights in shape[shape.shape[1]:]])


def _edges(host: HostMesh) -> Edges:
    """Edges of all cells."""
    nodes, shape = np.asarray(host.nodes, dtype=np.int64), np.asarray(host.shape)
    corners = shape.shape[1]
    node, first = np.unique(nodes[:, corners:].ravel(), return_index=True)
    return Edges(np.sort(nodes[:, _pairs(shape)].reshape(-1, 2)[first], axis=1), node)


def _alone(host: HostMesh) -> NDArray[np.int64]:
    """Nodes that must stay, whatever else does."""
    own = [np.asarray(rows, dtype=np.int64).ravel() for _, rows, *_ in host.kept
           if rows.shape[1] == 1]
    return np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *own]))
