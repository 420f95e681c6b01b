"""Delaunay connectivity through Qhull (Section 3.2) without losing the domain.

Qhull triangulates the convex hull of the vertices and knows neither the boundary of the mesh
nor its regions.  The facets that the current mesh and the Delaunay mesh share cut space into
pieces; a piece of one and a piece of the other with the same directed facets around them fill
the same space, so each such pair can be exchanged on its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.cells.elementary import power
from odt_plugins.engine.cells.extremes import FREELY, Extremes
from odt_plugins.engine.record.figures import cell_shapes
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.components import components
from odt_plugins.mesh.facets import directed_facets
from odt_plugins.mesh.simplex import determinant, vertices_of

IndexArray = NDArray[np.int64]

FLAT = 1e-11
"""A cell is flat when its volume is below this times the d-th power of its longest edge."""
VOLUME_TOLERANCE = 1e-9
"""Two pieces fill the same space when their volumes agree to this relative difference."""
ENERGY_TOLERANCE = 1e-12
"""Relative fall below which an energy counts as unchanged: ties of cospherical vertices."""
COSPHERICAL = 1e-12
"""Part of its size up to which a lifted determinant is taken for that of cospherical vertices."""


@dataclass(frozen=True)
class ExchangeStats:
    """What one call of :func:`delaunay_exchange` found and did.

    Attributes
    ----------
    pieces : int            pieces of the current mesh
    unchanged : int         pieces that are one cell of both meshes
    exchanged : int         pieces that were exchanged
    missing_facet : int     left alone: a boundary facet is no Delaunay facet, or no counterpart
    several_regions : int   left alone: more than one region label inside
    hidden_vertex : int     left alone: the Delaunay piece does not use every vertex
    flat : int              left alone: a Delaunay cell is flat
    volume : int            left alone: the two volumes differ
    energy : int            left alone: the energy does not fall
    guard : int             left alone: a cell of fixed vertices would be too bad
    failure : str           Qhull's complaint when it gave no triangulation, else empty
    """

    pieces: int = 0
    unchanged: int = 0
    exchanged: int = 0
    missing_facet: int = 0
    several_regions: int = 0
    hidden_vertex: int = 0
    flat: int = 0
    volume: int = 0
    energy: int = 0
    guard: int = 0
    failure: str = ""


def delaunay_exchange(
    points: FloatArray,
    cells: IntArray,
    regions: IntArray,
    fixed: BoolArray | None = None,
    *,
    limit: Extremes = FREELY,
) -> tuple[IntArray, IntArray, ExchangeStats]:
    """Exchange every piece of a mesh that the Delaunay triangulation of its vertices improves.

    A piece is exchanged when its counterpart is found, has one region label, uses the same
    vertices, has no flat cell and the same volume, and when the ODT energy strictly falls; by
    Remark 2.4 the uniform density decides for every density.  Every boundary and interface
    facet and every vertex in use stay.  When Qhull fails the mesh is returned as it is.

    Parameters
    ----------
    points : (n, d) float64      coordinates, d = 2 or 3
    cells : (m, d + 1) int32     vertex indices, signed volumes positive
    regions : (m,) int32         region labels
    fixed : (n,) bool            vertices that never move; None switches the guard off
    limit : Extremes             for new cells of fixed vertices, see Notes

    Returns
    -------
    cells : (m', d + 1) int32    kept cells in their order, then the new ones
    regions : (m',) int32
    stats : ExchangeStats

    Notes
    -----
    The guard: smoothing can never repair a cell whose vertices are all fixed.  The radius ratio of
    the worst such cell of the new piece must be at least that of the worst such cell of the old
    piece; where the old piece has none, at least that of its worst cell and of ``limit``, because
    a bad cell with a movable vertex is temporary and the new one is not.  Angles of such new cells
    pass ``limit`` no further than those of such cells of the old piece do.

    References
    ----------
    L. Chen, M. Holst, CMAME 200 (2011) 967-984, Section 3.2, Theorem 2.3, Lemma 2.7.
    """
    from scipy.spatial import Delaunay, QhullError

    used = vertices_of(cells)
    to_used = np.full(len(points), -1, dtype=np.int64)
    to_used[used] = np.arange(len(used))
    low, high = points[used].min(axis=0), points[used].max(axis=0)
    scale = float((high - low).max())
    local = (points[used] - 0.5 * (low + high)) / scale
    old = to_used[cells]
    old_volume, old_energy, _ = _measures(local, old)
    try:
        new = Delaunay(local).simplices.astype(np.int64)
    except (QhullError, ValueError) as error:
        failure = (str(error).strip().splitlines() or [type(error).__name__])[0]
        return cells.copy(), regions.copy(), ExchangeStats(failure=failure)
    new_volume, new_energy, new_flat = _measures(local, new)
    turned = new_volume < 0.0
    new[turned, :2] = new[turned, 1::-1]
    new_volume, new_energy = np.abs(new_volume), np.abs(new_energy)

    old_piece, new_piece, partner = _matching_pieces(old, new, len(used))
    n_old, n_new = len(partner), int(new_piece.max()) + 1
    old_count = np.bincount(old_piece, minlength=n_old)
    new_count = np.bincount(new_piece, minlength=n_new)
    matched = partner >= 0
    same = matched & (old_count == 1) & (new_count[partner] == 1)
    refused: dict[str, Any] = {}
    open_ = ~same

    def refuse(name: str, bad: BoolArray) -> None:
        refused[name] = int((open_ & bad).sum())
        open_[bad] = False

    def per_old(values: FloatArray | BoolArray) -> FloatArray:
        return np.bincount(old_piece, values.astype(np.float64), n_old).astype(np.float64)

    def per_new(values: FloatArray | BoolArray) -> FloatArray:
        return np.bincount(new_piece, values.astype(np.float64), n_new).astype(np.float64)[partner]

    refuse("missing_facet", ~matched)
    label = np.empty(n_old, dtype=np.int32)
    label[old_piece] = regions
    refuse("several_regions", per_old(regions != label[old_piece]) > 0)
    refuse("flat", per_new(new_flat) > 0)

    owner = np.full(n_new, -1, dtype=np.int64)
    owner[partner[open_]] = np.flatnonzero(open_)
    from_cells, from_piece = _rows(old, old_piece, open_)
    to_cells, to_piece = _rows(new, owner[new_piece], open_)
    refuse("hidden_vertex", _vertices_differ(from_cells, from_piece, to_cells, to_piece,
                                             len(used), n_old))
    volume = per_old(old_volume)
    refuse("volume", np.abs(per_new(new_volume) - volume) > VOLUME_TOLERANCE * volume)
    energy, energy_there = per_old(old_energy), per_new(new_energy)
    refuse("energy", energy_there >= (1.0 - ENERGY_TOLERANCE) * energy)
    if fixed is not None:
        is_fixed = fixed[used]
        worst, stuck = _worst(local, from_cells, from_piece, is_fixed, n_old)
        _, stuck_there = _worst(local, to_cells, to_piece, is_fixed, n_old)
        held = np.array([limit.quality, -limit.large, limit.small])
        needed = np.minimum(stuck, held)
        needed[:, 0] = np.where(np.isfinite(stuck[:, 0]), stuck[:, 0],
                                np.maximum(worst[:, 0], limit.quality))
        refuse("guard", (stuck_there < needed).any(axis=1))

    take = open_[to_piece]
    keep = ~open_[old_piece]
    result = np.concatenate([cells[keep], used[to_cells[take]].astype(np.int32)])
    labels = np.concatenate([regions[keep], label[to_piece[take]]])
    return result, labels, ExchangeStats(
        pieces=n_old, unchanged=int(same.sum()), exchanged=int(open_.sum()), **refused)


def non_delaunay_facets(points: FloatArray, cells: IntArray, neighbors: IntArray) -> IntArray:
    """List the interior facets that are not locally Delaunay (Definition 2.1, Section 3.1).

    Parameters
    ----------
    points : (n, d) float64         coordinates, d = 2 or 3
    cells : (m, d + 1) int32        signed volumes positive
    neighbors : (m, d + 1) int32    cell across the facet opposite each vertex, -1 at the boundary

    Returns
    -------
    (k, 2) int32                    cell and local index of the opposite vertex, one row a facet

    Notes
    -----
    With the far vertex x of the neighbour as origin, det(x_i - x, |x_i - x|^2) is, up to sign,
    proportional to the volume between the two liftings of the pair to the paraboloid. It is
    expanded along the last column.
    """
    dim = points.shape[1]
    owner, side = np.nonzero(neighbors > np.arange(len(cells))[:, None])
    other = neighbors[owner, side]
    back = np.argmax(neighbors[other] == owner[:, None], axis=1)
    origin = points[cells[other, back]]
    edges = points[cells[owner]] - origin[:, None, :]
    height = (edges**2).sum(axis=2)
    size = np.sqrt(np.prod(height, axis=1) * height.max(axis=1))
    rows = edges.transpose(1, 2, 0)
    inside = np.zeros(len(owner))
    for i in range(dim + 1):
        inside += (-1) ** i * height[:, i] * determinant(np.delete(rows, i, axis=0))
    bad = inside > COSPHERICAL * size
    return np.stack([owner[bad], side[bad]], axis=1).astype(np.int32)


def _measures(points: FloatArray, cells: IndexArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Signed volumes, energies (2.2) with the sign of the volume, and which cells are flat."""
    dim = points.shape[1]
    corners = points[cells]
    edges = corners[:, 1:] - corners[:, :1]
    volume = determinant(edges.transpose(1, 2, 0)) / (2.0 if dim == 2 else 6.0)
    total = np.zeros(len(cells))
    longest = np.zeros(len(cells))
    for i in range(dim):
        for j in range(i + 1, dim + 1):
            squared = ((corners[:, i] - corners[:, j]) ** 2).sum(axis=1)
            total += squared
            np.maximum(longest, squared, out=longest)
    energy = volume * total / ((dim + 1) * (dim + 2))
    return volume, energy, np.abs(volume) <= FLAT * power(longest, dim / 2)


def _matching_pieces(
    old: IndexArray, new: IndexArray, n: int
) -> tuple[IndexArray, IndexArray, IndexArray]:
    """Piece of every old cell, of every new cell, and the new piece of every old one or -1."""
    keys, side = directed_facets(np.concatenate([old, new]), n)
    found, inverse = np.unique(keys, return_inverse=True)
    ids, m = inverse.reshape(keys.shape), len(old)
    old_at = np.full((len(found), 2), -1, dtype=np.int64)
    new_at = np.full((len(found), 2), -1, dtype=np.int64)
    old_at[ids[:m], side[:m]] = np.arange(m)[:, None]
    new_at[ids[m:], side[m:]] = np.arange(len(new))[:, None]
    has_old, has_new = old_at >= 0, new_at >= 0
    shared = has_old.any(axis=1) & has_new.any(axis=1)
    old_links = old_at[has_old.all(axis=1) & ~shared]
    new_links = new_at[has_new.all(axis=1) & ~shared]
    old_piece = components(old_links[:, 0], old_links[:, 1], len(old)).astype(np.int64)
    new_piece = components(new_links[:, 0], new_links[:, 1], len(new)).astype(np.int64)
    n_old, n_new = int(old_piece.max()) + 1, int(new_piece.max()) + 1

    # open: a facet of one cell that the other mesh lacks, or a side that only one mesh fills
    lone_old = has_old & ~has_new & np.asarray(shared | ~has_old.all(axis=1))[:, None]
    lone_new = has_new & ~has_old & np.asarray(shared | ~has_new.all(axis=1))[:, None]
    old_open = np.zeros(n_old, dtype=np.bool_)
    new_open = np.zeros(n_new, dtype=np.bool_)
    old_open[old_piece[old_at[lone_old]]] = True
    new_open[new_piece[new_at[lone_new]]] = True
    both = has_old & has_new
    here, there = old_piece[old_at[both]], new_piece[new_at[both]]
    partner = np.full(n_old, -1, dtype=np.int64)
    backward = np.full(n_new, -1, dtype=np.int64)
    partner[here] = there
    backward[there] = here
    old_open[here[partner[here] != there]] = True
    new_open[there[backward[there] != here]] = True
    partner[old_open | (partner < 0)] = -1
    closed = partner >= 0
    partner[closed] = np.where(new_open[partner[closed]], -1, partner[closed])
    return old_piece, new_piece, partner


def _rows(cells: IndexArray, piece: IndexArray, wanted: BoolArray) -> tuple[IndexArray, IndexArray]:
    """Cells whose piece is wanted (a piece of -1 is not), with their piece."""
    rows = (piece >= 0) & wanted[piece]
    return cells[rows], piece[rows]


def _vertices_differ(
    here: IndexArray, here_piece: IndexArray, there: IndexArray, there_piece: IndexArray,
    n: int, n_pieces: int,
) -> BoolArray:
    """Pieces whose two sets of cells do not use the same vertices."""
    ours = np.unique(here_piece[:, None] * n + here)
    theirs = np.unique(there_piece[:, None] * n + there)
    odd = np.setxor1d(ours, theirs, assume_unique=True) // n
    differ = np.zeros(n_pieces, dtype=np.bool_)
    differ[odd] = True
    return differ


def _worst(
    points: FloatArray, cells: IndexArray, piece: IndexArray, fixed: BoolArray, n_pieces: int
) -> tuple[FloatArray, FloatArray]:
    """Worst shapes in every piece: of all cells, and of cells whose vertices are fixed.

    Columns: radius ratio, minus the cosine of the smallest angle, cosine of the largest; less is
    worse.
    """
    shapes = cell_shapes(points, cells.astype(np.int32))[:, :3] * (1.0, -1.0, 1.0)
    worst = np.full((2, n_pieces, 3), np.inf)
    np.minimum.at(worst[0], piece, shapes)
    stuck = fixed[cells].all(axis=1)
    np.minimum.at(worst[1], piece[stuck], shapes[stuck])
    return worst[0], worst[1]
