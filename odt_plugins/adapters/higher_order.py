"""Triangles and tetrahedra of higher order: the corners are optimised, the other nodes follow.

Every node but a corner has its place by whole barycentric weights among the corners of an edge, a
face or a cell. Where that edge, face or cell is still there and no corner of it has moved, the node
stays bit for bit, as all nodes on a boundary do. Where a corner has moved, the nodes keep their
offset from the straight edge or face. Nodes of new places are put on it; in faces of cubic cells
they follow the edges. A place has exactly one node: those of new edges take the indices of
nodes whose edges have gone, or indices at the end; nodes that are left over are removed, and the
indices above them close up.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.colours import in_kind, varies
from odt_plugins.adapters.host import Result, as_indices, interpolated
from odt_plugins.errors import DataNotKeptWarning, InvalidMeshError, warn
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.simplex import barycentric

Lattice = NDArray[np.int64]
"""Whole barycentric weights (k, d + 1) of the nodes of a cell, corners first; each sums to p."""

EDGES = {"vtk": ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)),
         "gmsh": ((0, 1), (1, 2), (2, 0), (3, 0), (3, 2), (3, 1))}
FACES = {"vtk": ((0, 1, 3), (2, 3, 1), (0, 3, 2), (0, 2, 1)),
         "gmsh": ((0, 2, 1), (0, 1, 3), (0, 3, 2), (3, 1, 2))}
"""Edges and faces of a tetrahedron in the order in which VTK and Gmsh number the nodes on them,
from the first corner on; the first three edges are those of a triangle."""

HIGHER = {"line3": (1, 2), "triangle6": (2, 2), "tetra10": (3, 2), "line4": (1, 3),
          "triangle10": (2, 3), "tetra20": (3, 3), "line5": (1, 4), "triangle15": (2, 4),
          "tetra35": (3, 4), "line6": (1, 5), "triangle21": (2, 5), "tetra56": (3, 5)}
"""Dimension and order of simplices with nodes between their corners, by their names in meshio.
The nodes of quadratic ones are ordered as VTK orders them, those of others as Gmsh does."""

LAGRANGE = {"VTK_LAGRANGE_CURVE": 1, "VTK_LAGRANGE_TRIANGLE": 2, "VTK_LAGRANGE_TETRAHEDRON": 3}
"""Dimension of simplices of VTK's whose order is told by their number of nodes."""

ROUNDING = 1e-12
"""Nodes that are off a straight edge by less of the extent of a cell are on it."""

ORDERS = {2: "quadratic", 3: "cubic", 4: "quartic", 5: "quintic"}


@cache
def lattice(dim: int, order: int, host: str = "vtk") -> Lattice:
    """Where the nodes (k, dim + 1) of a simplex lie: corners, edges, faces, inside.

    Parameters
    ----------
    dim : int      1, 2 or 3
    order : int    p; the nodes inside a face or cell are those of one of order p - 3 or p - 4
    host : str     "vtk" or "gmsh"
    """
    if order <= 0:
        return np.zeros((1 + order if order > -1 else 0, dim + 1), dtype=np.int64)
    parts = [order * np.eye(dim + 1, dtype=np.int64)]
    step = np.arange(1, order)
    for a, b in EDGES[host][: (0, 1, 3, 6)[dim]]:
        on_edge = np.zeros((order - 1, dim + 1), dtype=np.int64)
        on_edge[:, a], on_edge[:, b] = order - step, step
        parts.append(on_edge)
    if dim == 3:
        inside = lattice(2, order - 3, host) + 1
        for face in FACES[host]:
            on_face = np.zeros((len(inside), 4), dtype=np.int64)
            on_face[:, face] = inside
            parts.append(on_face)
    if dim > 1:
        parts.append(lattice(dim, order - dim - 1, host) + 1)
    return np.concatenate(parts)


def order_of(dim: int, nodes: int) -> int:
    """Order of a simplex with so many nodes.

    Raises
    ------
    InvalidMeshError    there is none
    """
    for order in range(1, 20):
        if len(lattice(dim, order)) == nodes:
            return order
    kind = {1: "line", 2: "triangle", 3: "tetrahedron"}[dim]
    msg = f"got a {kind} of {nodes} nodes; expected those of one order, such as {dim + 1}"
    raise InvalidMeshError(msg)


class Places(NamedTuple):
    """Where nodes lie.

    Attributes
    ----------
    corners : (k, s) int64      corners of the edge, face or cell, ascending; where there are fewer
                                than s the first one again, with the weight 0
    weights : (k, s) float64    barycentric coordinates there
    key : (k,) int64            equal for equal places; comparable within one call only
    """

    corners: NDArray[np.int64]
    weights: NDArray[np.float64]
    key: NDArray[np.int64]


@dataclass(frozen=True)
class HigherOrder:
    """Cells of higher order after the corners were optimised.

    Attributes
    ----------
    points : (n', D)             all nodes, in the caller's dtype
    cells : (m', k)              indices of the new nodes, in the caller's dtype
    origin : (n',) int           old node of every node; -1 at nodes of new places
    corners : (n', s) int        new nodes among which a node of a new place lies
    weights : (n', s)            its barycentric coordinates there
    number : (n,) int            new index of every old node, -1 if it is gone
    gone : (g,) int              old nodes whose places have gone
    gone_places : Places         where they were, by old nodes
    shape : (k, d + 1) int       lattice of a cell
    inside : (g,) bool, (n',) bool    nodes that have gone, and all, that no facet of one cell has
    """

    points: NDArray[Any]
    cells: NDArray[Any]
    origin: NDArray[np.int64]
    corners: NDArray[np.int64]
    weights: NDArray[np.float64]
    number: NDArray[np.int64]
    gone: NDArray[np.int64]
    gone_places: Places
    shape: Lattice
    inside: tuple[NDArray[np.bool_], NDArray[np.bool_]]


def check_mid_nodes(rows: NDArray[Any], n: int, shape: Lattice) -> None:
    """Refuse cells of higher order whose nodes are not one for every place.

    Parameters
    ----------
    rows : (m, k) int         nodes of the cells
    n : int                   number of nodes
    shape : (k, d + 1) int    lattice of a cell

    Raises
    ------
    InvalidMeshError           indices out of range, two nodes on one place, one on two
    """
    order, corners = int(shape[0, 0]), shape.shape[1]
    bad = np.flatnonzero(((rows < 0) | (rows >= n)).any(axis=1))
    if bad.size:
        msg = (f"got {bad.size} {_name(order)} cells with node indices out of range (first: cell "
               f"{bad[0]}); expected 0 to {n - 1} for {n} nodes")
        raise InvalidMeshError(msg)
    wide = rows.astype(np.int64)
    places, mid = _places(wide[:, :corners], shape, n), wide[:, corners:].ravel()
    what = ("edge", "edges") if order == 2 else ("place", "places of an edge, face or cell")
    for one, other, text in ((places.key, mid, f"{what[1]} with more than one mid-node"),
                             (mid, places.key, f"mid-nodes that lie on more than one {what[0]}")):
        by_one = np.argsort(one, kind="stable")
        twin = one[by_one][1:] == one[by_one][:-1]
        wrong = np.flatnonzero(twin & (other[by_one][1:] != other[by_one][:-1]))
        if wrong.size:
            first = by_one[wrong[0]]
            count = len(np.unique(one[by_one[wrong]]))
            around = np.unique(places.corners[first]).tolist()
            msg = (f"got {count} {text} (first: node {mid[first]} on the edge or face {around}); "
                   f"expected one mid-node for every {what[0]}, try merging nodes at the same "
                   "place")
            raise InvalidMeshError(msg)
    is_corner = np.zeros(n, dtype=np.bool_)
    is_corner[rows[:, :corners]] = True
    wrong = np.unique(mid[is_corner[mid]])
    if wrong.size:
        msg = (f"got {wrong.size} mid-nodes that are corners of other cells (first: node "
               f"{wrong[0]}); expected corners and mid-nodes to be different nodes")
        raise InvalidMeshError(msg)


def _name(order: int) -> str:
    return ORDERS.get(order, f"order-{order}")


def with_mid_nodes(
    result: Result, points: NDArray[Any], rows: NDArray[Any], kept: NDArray[Any], shape: Lattice
) -> HigherOrder:
    """Put nodes on all places of optimised corner cells.

    Parameters
    ----------
    result : Result           corners after optimisation: points (n, D), cells (m', d + 1)
    points : (n, D)           all nodes of the input
    rows : (m, k)             nodes of the input cells
    kept : (k,) int           nodes of other cells, which stay even where their place is gone
    shape : (k, d + 1) int    lattice of a cell
    """
    n, d = len(points), shape.shape[1]
    wide, corner = rows.astype(np.int64), result.cells.astype(np.int64)
    places = _places(np.concatenate([wide[:, :d], corner]), shape, n)
    mid = wide[:, d:].ravel()
    old_key, first = np.unique(places.key[: len(mid)], return_index=True)
    old_mid = mid[first]
    new_key, new_first, inverse = np.unique(
        places.key[len(mid) :], return_index=True, return_inverse=True)
    new_first += len(mid)
    place = np.minimum(np.searchsorted(old_key, new_key), len(old_key) - 1)
    stays = old_key[place] == new_key

    lost = np.ones(len(old_key), dtype=np.bool_)
    lost[place[stays]] = False
    gone = old_mid[lost]
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
    around, weights = places.corners[new_first], places.weights[new_first]
    _follow(out, points, result.points, node[stays], (around[stays], weights[stays]))
    out[taken] = _mean(out, around[fresh], weights[fresh])
    is_new = np.zeros(total, dtype=np.bool_)
    is_new[taken] = True
    _bend(out, np.concatenate([corner, node[inverse.reshape(len(corner), -1)]], axis=1), is_new,
          shape)

    there = np.ones(total, dtype=np.bool_)
    there[free[len(fresh) :]] = False
    number = np.where(there, np.cumsum(there) - 1, -1)
    origin = np.arange(total)
    origin[taken] = -1
    beside = np.repeat(np.arange(total)[:, None], around.shape[1], axis=1)
    beside[taken] = around[fresh]
    share = np.zeros(beside.shape)
    share[:, 0] = 1.0
    share[taken] = weights[fresh]
    cells = np.concatenate([corner, node[inverse.reshape(len(corner), -1)]], axis=1)
    old_number = number[:n].copy()
    old_number[gone] = np.where(np.isin(gone, kept), number[gone], -1)
    return HigherOrder(
        points=out[there].astype(points.dtype),
        cells=as_indices(number[cells], rows),
        origin=origin[there],
        corners=number[beside[there]],
        weights=share[there],
        number=old_number,
        gone=gone,
        gone_places=Places(places.corners[first][lost], places.weights[first][lost],
                           old_key[lost]),
        shape=shape,
        inside=(_inside(wide, n, shape)[gone], _inside(cells, total, shape)[there]),
    )


def _inside(cells: NDArray[np.int64], count: int, shape: Lattice) -> NDArray[np.bool_]:
    """Which nodes are on no facet that one cell alone has."""
    d = shape.shape[1]
    facets = [np.sort(np.delete(cells[:, :d], i, axis=1), axis=1) for i in range(d)]
    _, which, size = np.unique(row_keys(np.concatenate(facets), count), return_inverse=True,
                               return_counts=True)
    out = np.ones(count, dtype=np.bool_)
    for i, alone in enumerate(np.split(size[which.ravel()] == 1, d)):
        out[cells[alone][:, shape[:, i] == 0]] = False
    return out


def _places(corners: NDArray[np.int64], shape: Lattice, n: int) -> Places:
    """Where the nodes behind the corners of every cell lie, cell by cell."""
    order, inner = int(shape[0, 0]), shape[shape.shape[1] :]
    width = int((inner > 0).sum(axis=1).max())
    chosen = np.argsort(inner == 0, axis=1, kind="stable")[:, :width]
    weights = np.broadcast_to(np.take_along_axis(inner, chosen, axis=1),
                              (len(corners), *chosen.shape)).reshape(-1, width)
    around = corners[:, chosen].reshape(-1, width)
    # The corners that count come first, ascending.
    by_index = np.argsort(np.where(weights > 0, around, n), axis=1, kind="stable")
    around = np.take_along_axis(around, by_index, axis=1)
    weights = np.take_along_axis(weights, by_index, axis=1)
    around = np.where(weights > 0, around, around[:, :1])
    code = (weights * (order + 1) ** np.arange(width)).sum(axis=1)
    base = max(n, (order + 1) ** width)
    key = row_keys(np.concatenate([around, code[:, None]], axis=1), base)
    return Places(around, weights / order, key)


def _mean(
    values: NDArray[Any], corners: NDArray[np.int64], weights: NDArray[np.float64]
) -> NDArray[Any]:
    """Weighted sums (k, ...) of values (n, ...) at corners (k, s)."""
    shares = weights.reshape(*weights.shape, *(1,) * (values.ndim - 1))
    terms = shares * values[corners]
    total = terms[:, 0]
    for i in range(1, terms.shape[1]):
        total = total + terms[:, i]
    return np.asarray(total)


def _follow(
    out: NDArray[np.float64],
    before: NDArray[Any],
    after: NDArray[Any],
    node: NDArray[np.int64],
    places: tuple[NDArray[np.int64], NDArray[np.float64]],
) -> None:
    """Move the nodes of places that are still there, where a corner has moved."""
    moved = (before[places[0]] != after[places[0]]).any(axis=(1, 2))
    node, corners, weights = node[moved], places[0][moved], places[1][moved]
    shift = np.asarray(after, dtype=np.float64) - np.asarray(before, dtype=np.float64)
    out[node] += _mean(shift, corners, weights)


def _bend(
    out: NDArray[np.float64], rows: NDArray[np.int64], is_new: NDArray[np.bool_], shape: Lattice
) -> None:
    """Move the new nodes in faces of cubic cells as the edges of the face are bent.

    A quarter of the offsets of the six nodes on edges keeps quadratic maps exact.
    """
    if shape[0, 0] != 3:
        return
    for face in np.flatnonzero((shape > 0).sum(axis=1) == 3):
        edges = np.flatnonzero(((shape > 0).sum(axis=1) == 2)
                               & (shape[:, shape[face] == 0] == 0).all(axis=1))
        new = rows[is_new[rows[:, face]]]
        straight = np.einsum("ec,mcx->mex", shape[edges] / 3, out[new[:, : shape.shape[1]]])
        offset = out[new[:, edges]] - straight
        extent = np.ptp(out[new[:, : shape.shape[1]]], axis=1).max(axis=1)
        bent = np.abs(offset).max(axis=(1, 2)) > ROUNDING * extent
        middle = _mean(out, new[bent, : shape.shape[1]],
                       np.repeat(shape[face][None] / 3, bent.sum(), axis=0))
        out[new[bent, face]] = middle + offset[bent].sum(axis=1) / 4


class Placed(NamedTuple):
    """Nodes that moved or are new, and where they lie in the input.

    Attributes
    ----------
    node : (q,) int            of the result
    cell : (q, k) int          nodes of the input cell around each
    weights : (q, d + 1)       its barycentric coordinates with respect to the corners of that cell
    middle : (q, e, d + 1)     those of the nodes between the corners of that cell
    share : (q, e)             values of their shape functions there
    """

    node: NDArray[np.intp]
    cell: NDArray[Any]
    weights: NDArray[np.float64]
    middle: NDArray[np.float64]
    share: NDArray[np.float64]


def placed_nodes(
    q: HigherOrder, result: Result, points: NDArray[Any], rows: NDArray[Any]
) -> Placed | None:
    """Locate the nodes that moved or are new, unless fields stay with their nodes.

    Parameters
    ----------
    q, result : the nodes after :func:`with_mid_nodes`, and its argument
    points, rows : (n, D), (m, k)    all nodes and the cells of the input
    """
    node = np.flatnonzero((q.origin < 0) | (q.points != points[q.origin]).any(axis=1))
    if result.locate is None or not node.size:
        return None
    near = np.zeros(len(q.points), dtype=np.int32)
    near[q.cells] = result.source[:, None]
    which, weights = result.locate(q.points[node].astype(np.float64), near[node])
    x = np.asarray(points, dtype=np.float64)[rows[which]]
    x = x - x[:, :1]
    c = q.shape.shape[1]
    if x.shape[2] > c - 1:
        x = np.einsum("kid,kjd->kij", x, x[:, 1:c])
    between = rows.shape[1] - c
    middle = barycentric(np.repeat(x[:, None, :c], between, axis=1), x[:, c:])
    return Placed(node, rows[which], weights, middle, shape_values(q.shape, weights)[:, c:])


def _at_places(values: NDArray[Any], placed: Placed) -> NDArray[Any]:
    """The field of the input at nodes (q, ...): linear between corners, and what others add.

    A node between the corners adds its shape function times what its value differs from that of
    the linear function at its place: linear fields are exact in curved cells too, polynomials of
    the order of the cells where edges are straight.
    """
    c = placed.weights.shape[1]
    wide = values[placed.cell].astype(np.result_type(values, np.float64))
    more = wide[:, c:] - np.einsum("kec,kc...->ke...", placed.middle, wide[:, :c])
    straight = interpolated(wide[:, :c], placed.weights)
    found = straight + np.einsum("ke,ke...->k...", placed.share, more)
    return in_kind(found, values)


def carried_point_data(
    name: str, values: NDArray[Any], q: HigherOrder, placed: Placed | None = None
) -> NDArray[Any]:
    """Point data after :func:`with_mid_nodes`.

    Parameters
    ----------
    name : str            for the warning
    values : (n, ...)     of the input nodes
    q : HigherOrder
    placed : Placed       of a field: it takes its values at these nodes

    Returns
    -------
    (n', ...)             nodes that are still there keep their value; the node of a new place takes
                          the linear interpolation of its corners, or for data other than
                          floating-point numbers and colours the value of the nearest, of lowest
                          index, or inside that of the nodes whose places have gone there, if
                          several had the same

    Warns
    -----
    DataNotKeptWarning    the value of a node whose place has gone was not what interpolation
                          gives there
    """
    out = values[np.maximum(q.origin, 0)]
    if placed is not None:
        out[placed.node] = _at_places(values, placed)
        return out
    new = np.flatnonzero(q.origin < 0)
    between = _between if varies(name, values) else _nearest
    out[new] = between(values, q.origin[q.corners[new]], q.weights[new])
    expected = between(values, q.gone_places.corners, q.gone_places.weights)
    inner = values[q.gone[q.inside[0]]]
    if between is _nearest and len(inner) > 1 and (inner == inner[0]).all():
        out[new[q.inside[1][new]]] = expected[q.inside[0]] = inner[0]
    off = expected != values[q.gone]
    if values.dtype.kind in "fc":
        size = np.abs(values).max() if values.size else 0.0
        off &= np.abs(expected - values[q.gone]) > 8 * np.finfo(values.dtype).eps * size
    lost = np.flatnonzero(off.any(axis=tuple(range(1, off.ndim))) & (q.number[q.gone] < 0))
    if lost.size:
        msg = (f"point data {name!r} of {lost.size} mid-nodes (first: node {q.gone[lost[0]]}) are "
               f"not kept: their edges were flipped away; try "
               f"smoothing={{'connectivity': 'none'}}, finish=False")
        warn(msg, DataNotKeptWarning)
    return out


def _between(
    values: NDArray[Any], corners: NDArray[np.int64], weights: NDArray[np.float64]
) -> NDArray[Any]:
    wide = values.astype(np.result_type(values, np.float64), copy=False)
    mean: NDArray[Any] = in_kind(_mean(wide, corners, weights), values).astype(values.dtype)
    return mean


def _nearest(
    values: NDArray[Any], corners: NDArray[np.int64], weights: NDArray[np.float64]
) -> NDArray[Any]:
    there: NDArray[Any] = values[corners[np.arange(len(corners)), weights.argmax(axis=1)]]
    return there


def shape_values(shape: Lattice, weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shape functions (q, k) of all nodes at barycentric coordinates (q, d + 1).

    That of the node a is the product over the corners i of P(p l_i; a_i), with the barycentric
    coordinates l and P(x; a) = x (x - 1) ... (x - a + 1) / a!.
    """
    order = int(shape[0, 0])
    at = np.ones((order + 1, *weights.shape))
    for a in range(order):
        at[a + 1] = at[a] * (order * weights - a) / (a + 1)
    out: NDArray[np.float64] = np.stack(
        [np.prod([at[a, :, i] for i, a in enumerate(node)], axis=0) for node in shape.tolist()],
        axis=1)
    return out
