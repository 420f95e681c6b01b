"""Quadratic triangles and tetrahedra: the corners are optimised, the mid-nodes follow their edges.

A mid-node whose edge is still there keeps its offset from the middle of that edge, so nodes on a
curved boundary stay bit for bit. Every edge gets exactly one mid-node: a new edge takes the index
of a mid-node whose edge has gone, or one at the end; mid-nodes that are left over are removed, and
the indices above them close up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.host import Result, interpolated
from odt_plugins.errors import DataNotKeptWarning, InvalidMeshError, ODTWarning, warn
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.simplex import barycentric, determinant

EDGES = {
    6: np.array([[0, 1], [1, 2], [2, 0]]),
    10: np.array([[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]]),
}
"""Corners at the ends of the edges on which the mid-nodes 3, 4, 5 or 4, ..., 9 lie, as in VTK."""

CORNERS = {3: 2, 6: 3, 10: 4}
"""Corners of a quadratic line, triangle and tetrahedron by their number of nodes."""


@dataclass(frozen=True)
class Quadratic:
    """Quadratic cells after the corners were optimised.

    Attributes
    ----------
    points : (n', D)             all nodes, in the caller's dtype
    cells : (m', 6 or 10)        indices of the new nodes, in the caller's dtype
    origin : (n',) int           old node of every node; -1 at mid-nodes of new edges
    ends : (n', 2) int           new nodes at the ends of the edge of every mid-node of a new edge,
                                 elsewhere the node itself
    number : (n,) int            new index of every old node, -1 if it is gone
    gone : (g,) int              old mid-nodes whose edges have gone
    gone_ends : (g, 2) int       old nodes at the ends of these edges
    """

    points: NDArray[Any]
    cells: NDArray[Any]
    origin: NDArray[np.int64]
    ends: NDArray[np.int64]
    number: NDArray[np.int64]
    gone: NDArray[np.int64]
    gone_ends: NDArray[np.int64]


def check_mid_nodes(rows: NDArray[Any], n: int) -> None:
    """Refuse quadratic cells whose mid-nodes are not one for every edge.

    Parameters
    ----------
    rows : (m, 6 or 10) int    nodes of the cells, mid-nodes after the corners
    n : int                    number of nodes

    Raises
    ------
    InvalidMeshError           indices out of range, two mid-nodes on one edge, one on two edges
    """
    bad = np.flatnonzero(((rows < 0) | (rows >= n)).any(axis=1))
    if bad.size:
        msg = (
            f"got {bad.size} quadratic cells with node indices out of range (first: cell "
            f"{bad[0]}); expected 0 to {n - 1} for {n} nodes"
        )
        raise InvalidMeshError(msg)
    edge, mid = _edges(rows)
    key = row_keys(edge, n)
    for one, other, what in ((key, mid, "edges with more than one mid-node"),
                             (mid, key, "mid-nodes that lie on more than one edge")):
        order = np.argsort(one, kind="stable")
        twin = one[order][1:] == one[order][:-1]
        wrong = np.flatnonzero(twin & (other[order][1:] != other[order][:-1]))
        if wrong.size:
            first = order[wrong[0]]
            count = len(np.unique(one[order[wrong]]))
            msg = (
                f"got {count} {what} (first: node {mid[first]} on the edge "
                f"{edge[first].tolist()}); expected one mid-node for every edge, try merging "
                f"nodes at the same place"
            )
            raise InvalidMeshError(msg)
    is_corner = np.zeros(n, dtype=np.bool_)
    is_corner[rows[:, : CORNERS[rows.shape[1]]]] = True
    wrong = np.unique(mid[is_corner[mid]])
    if wrong.size:
        msg = (
            f"got {wrong.size} mid-nodes that are corners of other cells (first: node "
            f"{wrong[0]}); expected corners and mid-nodes to be different nodes"
        )
        raise InvalidMeshError(msg)


def with_mid_nodes(
    result: Result, points: NDArray[Any], rows: NDArray[Any], kept: NDArray[Any]
) -> Quadratic:
    """Put mid-nodes on all edges of optimised corner cells.

    Parameters
    ----------
    result : Result          corners after optimisation: points (n, D), cells (m', d + 1)
    points : (n, D)          all nodes of the input
    rows : (m, 6 or 10)      nodes of the input cells
    kept : (k,) int          nodes of other cells, which stay even where their edge is gone

    Returns
    -------
    Quadratic
    """
    n, k = len(points), rows.shape[1]
    edge, mid = _edges(rows)
    corner = result.cells.astype(np.int64)
    wanted = np.sort(corner[:, EDGES[k]].reshape(-1, 2), axis=1)
    keys = row_keys(np.concatenate([edge, wanted]), n)
    old_key, first = np.unique(keys[: len(edge)], return_index=True)
    old_edge, old_mid = edge[first], mid[first]
    new_key, new_first, inverse = np.unique(
        keys[len(edge) :], return_index=True, return_inverse=True)
    place = np.minimum(np.searchsorted(old_key, new_key), len(old_key) - 1)
    stays = old_key[place] == new_key

    lost = np.ones(len(old_key), dtype=np.bool_)
    lost[place[stays]] = False
    gone, gone_ends = old_mid[lost], old_edge[lost]
    free = np.setdiff1d(gone, kept)
    fresh = np.flatnonzero(~stays)
    taken = np.concatenate([free[: len(fresh)], n + np.arange(max(len(fresh) - len(free), 0))])
    node = np.empty(len(new_key), dtype=np.int64)
    node[stays], node[fresh] = old_mid[place[stays]], taken

    total = max(n, n + len(fresh) - len(free))
    out = np.zeros((total, points.shape[1]))
    out[:n] = points
    used = np.unique(corner)
    out[used] = result.points[used]
    ends = wanted[new_first]
    _follow(out, points, result.points, node[stays], ends[stays])
    out[taken] = 0.5 * (out[ends[fresh, 0]] + out[ends[fresh, 1]])

    there = np.ones(total, dtype=np.bool_)
    there[free[len(fresh) :]] = False
    number = np.where(there, np.cumsum(there) - 1, -1)
    origin = np.arange(total)
    origin[taken] = -1
    pair = np.repeat(np.arange(total)[:, None], 2, axis=1)
    pair[taken] = ends[fresh]
    cells = np.concatenate([corner, node[inverse.reshape(len(corner), -1)]], axis=1)
    old_number = number[:n].copy()
    old_number[gone] = np.where(np.isin(gone, kept), number[gone], -1)
    return Quadratic(
        points=out[there].astype(points.dtype),
        cells=number[cells].astype(rows.dtype),
        origin=origin[there],
        ends=number[pair[there]],
        number=old_number,
        gone=gone,
        gone_ends=gone_ends,
    )


def _edges(rows: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Sorted corners (e, 2) of every edge of every cell, and its mid-node (e,)."""
    wide = rows.astype(np.int64)
    edge = np.sort(wide[:, EDGES[rows.shape[1]]].reshape(-1, 2), axis=1)
    return edge, wide[:, CORNERS[rows.shape[1]] :].ravel()


def _follow(
    out: NDArray[np.float64],
    before: NDArray[Any],
    after: NDArray[Any],
    node: NDArray[np.int64],
    ends: NDArray[np.int64],
) -> None:
    """Move the mid-nodes of edges that are still there, where an end has moved."""
    moved = (before[ends] != after[ends]).any(axis=(1, 2))
    node, (a, b) = node[moved], ends[moved].T
    shift = np.asarray(after, dtype=np.float64) - np.asarray(before, dtype=np.float64)
    out[node] += 0.5 * (shift[a] + shift[b])


class Placed(NamedTuple):
    """Nodes that moved or are new, and where they lie in the input.

    Attributes
    ----------
    node : (k,) int            of the result
    cell : (k, 6 or 10) int    nodes of the input cell around each
    weights : (k, d + 1)       its barycentric coordinates with respect to the corners of that cell
    middle : (k, e, d + 1)     those of the mid-nodes of that cell
    """

    node: NDArray[np.intp]
    cell: NDArray[Any]
    weights: NDArray[np.float64]
    middle: NDArray[np.float64]


def placed_nodes(
    q: Quadratic, result: Result, points: NDArray[Any], rows: NDArray[Any]
) -> Placed | None:
    """Locate the nodes that moved or are new, unless fields stay with their nodes.

    Parameters
    ----------
    q, result : the nodes after :func:`with_mid_nodes`, and its argument
    points, rows : (n, D), (m, 6 or 10)    all nodes and the cells of the input
    """
    node = np.flatnonzero((q.origin < 0) | (q.points != points[q.origin]).any(axis=1))
    if result.locate is None or not node.size:
        return None
    near = np.zeros(len(q.points), dtype=np.int32)
    near[q.cells] = result.source[:, None]
    which, weights = result.locate(q.points[node].astype(np.float64), near[node])
    x = np.asarray(points, dtype=np.float64)[rows[which]]
    x = x - x[:, :1]
    c = CORNERS[rows.shape[1]]
    if x.shape[2] > c - 1:
        x = np.einsum("kid,kjd->kij", x, x[:, 1:c])
    edges = rows.shape[1] - c
    middle = barycentric(np.repeat(x[:, None, :c], edges, axis=1), x[:, c:])
    return Placed(node, rows[which], weights, middle)


def _at_places(values: NDArray[Any], placed: Placed) -> NDArray[Any]:
    """The field of the input at nodes (k, ...): linear between corners, and its mid-nodes' bubbles.

    A mid-node adds 4 w_a w_b times what its value differs from that of the linear function at its
    place: linear fields are exact in curved cells too, quadratic ones where edges are straight.
    """
    k, c = placed.cell.shape[1], placed.weights.shape[1]
    wide = values[placed.cell].astype(np.result_type(values, np.float64))
    a, b = EDGES[k].T
    bubble = 4.0 * placed.weights[:, a] * placed.weights[:, b]
    more = wide[:, c:] - np.einsum("kec,kc...->ke...", placed.middle, wide[:, :c])
    straight = interpolated(wide[:, :c], placed.weights)
    return np.asarray(straight + np.einsum("ke,ke...->k...", bubble, more))


def carried_point_data(
    name: str, values: NDArray[Any], q: Quadratic, placed: Placed | None = None
) -> NDArray[Any]:
    """Point data after :func:`with_mid_nodes`.

    Parameters
    ----------
    name : str            for the warning
    values : (n, ...)     of the input nodes
    q : Quadratic
    placed : Placed       of a field: it takes its values at these nodes

    Returns
    -------
    (n', ...)             nodes that are still there keep their value; the mid-node of a new edge
                          takes the mean of the ends, or for data other than floating-point numbers
                          the value of the end of lower index

    Warns
    -----
    DataNotKeptWarning    the value of a mid-node whose edge has gone was not what interpolation
                          on that edge gives
    """
    out = values[np.maximum(q.origin, 0)]
    if placed is not None:
        out[placed.node] = _at_places(values, placed)
        return out
    new = np.flatnonzero(q.origin < 0)
    a, b = (values[q.origin[q.ends[new, i]]] for i in (0, 1))
    out[new] = _between(a, b)
    expected = _between(values[q.gone_ends[:, 0]], values[q.gone_ends[:, 1]])
    off = expected != values[q.gone]
    if values.dtype.kind in "fc":
        size = np.abs(values).max() if values.size else 0.0
        off &= np.abs(expected - values[q.gone]) > 8 * np.finfo(values.dtype).eps * size
    lost = np.flatnonzero(off.any(axis=tuple(range(1, off.ndim))) & (q.number[q.gone] < 0))
    if lost.size:
        msg = (
            f"point data {name!r} of {lost.size} mid-nodes (first: node {q.gone[lost[0]]}) are "
            f"not kept: their edges were flipped away; try connectivity='none', finish=False"
        )
        warn(msg, DataNotKeptWarning)
    return out


def _between(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    if a.dtype.kind not in "fc":
        return a
    mean: NDArray[Any] = ((a.astype(np.result_type(a, np.float64)) + b) / 2).astype(a.dtype)
    return mean


def warn_of_folds(before: NDArray[Any], rows: NDArray[Any], q: Quadratic) -> None:
    """Warn when curved cells came to overlap themselves between their corners.

    The promise holds for the corners; a strongly curved boundary can reach through a straight
    neighbour. Cells are told by the sign of the Jacobian at all nodes.
    """
    bad = np.flatnonzero(_folded(q.points, q.cells))
    if bad.size and not _folded(before, rows).any():
        msg = (
            f"{bad.size} quadratic cells (first: cell {bad[0]}) have a Jacobian of changing sign; "
            f"expected none as in the input, try a selection without the cells at the curved "
            f"boundary"
        )
        warn(msg, ODTWarning)


def _folded(points: NDArray[Any], rows: NDArray[Any]) -> NDArray[np.bool_]:
    """Cells whose Jacobian determinant is not of one sign at their nodes."""
    k = rows.shape[1]
    gradient = _shape_gradients(k)
    x = np.asarray(points, dtype=np.float64)[rows]
    jacobian = np.einsum("qkd,mkx->mqdx", gradient, x)
    if jacobian.shape[2] == jacobian.shape[3]:
        det = determinant(np.moveaxis(jacobian, (2, 3), (0, 1)))
    else:
        normal = np.cross(jacobian[:, :, 0], jacobian[:, :, 1])
        det = (normal * normal.sum(axis=1, keepdims=True)).sum(axis=2)
    folded: NDArray[np.bool_] = (det.min(axis=1) <= 0.0) & (det.max(axis=1) >= 0.0)
    return folded


def _shape_gradients(k: int) -> NDArray[np.float64]:
    """Gradients (k, k, d) of the quadratic shape functions at the nodes, reference coordinates."""
    d = CORNERS[k] - 1
    corner = np.eye(d + 1)
    nodes = np.concatenate([corner, 0.5 * corner[EDGES[k]].sum(axis=1)])
    slope = np.concatenate([-np.ones((1, d)), np.eye(d)])
    at_corners = (4.0 * nodes[:, :, None] - 1.0) * slope
    a, b = EDGES[k].T
    on_edges = 4.0 * (nodes[:, a, None] * slope[b] + nodes[:, b, None] * slope[a])
    return np.concatenate([at_corners, on_edges], axis=1)


def renumbered(mapping: Mapping[str, Any], q: Quadratic) -> dict[str, Any]:
    """Sets of nodes by name in the new numbering.

    Warns
    -----
    DataNotKeptWarning    a node of a set is gone
    """
    out = {}
    for name, members in mapping.items():
        raw = np.asarray(members)
        new = q.number[raw]
        out[name] = new[new >= 0].astype(raw.dtype)
        if (new < 0).any():
            msg = (
                f"point set {name!r} loses {int((new < 0).sum())} mid-nodes whose edges were "
                f"flipped away; try connectivity='none', finish=False"
            )
            warn(msg, DataNotKeptWarning)
    return out
