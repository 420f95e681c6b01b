"""The promise of tetrahedra that were remeshed: what must hold where surfaces have other vertices.

Distances are not looked at here, nor whether a surface cuts through itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.figures import CellFigures, cell_figures
from odt_plugins.mesh.components import components
from odt_plugins.mesh.faces import Faces, labels_at
from odt_plugins.mesh.facets import row_keys, uneven_facets
from odt_plugins.mesh.numbering import in_old_numbers, old_numbers, removed_vertices
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.promise.faces import broken_lines
from odt_plugins.promise.good import fallen_since
from odt_plugins.promise.locked_facets import LockedFacets, facet_census
from odt_plugins.promise.region_sizes import broken_sizes
from odt_plugins.promise.volume import (
    broken_promises,
    came_and_went,
    cells_not_positive,
    changed_use,
    held_by,
    malformed_arrays,
    moved_though_held,
    overlapping_facets,
    thawed_cells,
)


def broken_by_remeshing(
    before: SimplexMesh,
    points: NDArray[np.float64],
    cells: NDArray[np.int32],
    regions: NDArray[np.int32],
    origin: NDArray[np.int64],
    keep: Sequence[str],
    metric: NDArray[np.float64],
    faces: tuple[Faces, Faces],
    *,
    slides: bool,
    threads: int = 1,
    full: int = 0,
    figures: Callable[[], CellFigures] | None = None,
) -> list[str]:
    """Say what of the promise does not hold for a mesh with other vertices.

    Parameters
    ----------
    before : SimplexMesh                of tetrahedra
    points, cells, regions : arrays     (n, 3), (m', 4), (m',): the mesh to be judged
    origin : (n,) int                   old vertex of every vertex, increasing, then -1
    keep : names of figures             none may be worse than before, see ``promise.good``
    metric : (n, k) float64              of the metric in which figures are measured, no rows where
                                        there is none
    faces : (Faces, Faces)              those that lines and triangles with labels have become
    slides : bool                       whether surfaces may have other vertices; else they are as
                                        before, bit for bit
    threads : int
    full : int                          cells to which they are filled up by good ones where figures
                                        are looked at, see ``promise.good.filled_up``
    figures : callable                  gives those of the mesh without a metric, where they may be
                                        at hand

    Returns
    -------
    list of str                         one sentence per broken promise; empty when all hold

    Notes
    -----
    Every piece of surface, between two regions or one and the outside, of each label, and every
    region has the same number of components and the same Euler characteristic as before, and the
    rim of a piece the same number of loops: so genus, rims and the adjacency of regions are the
    same.
    """
    share = max(0.0, len(points) / len(before.used) - 1.0) + 1.0
    if not slides:
        broken = broken_promises(before, points, cells, regions, (), origin=origin, insert=share,
                                 threads=threads, figures=figures)
        return broken or fallen_since(before, points, cells, metric, keep, full=full)
    broken = malformed_arrays(before, points, cells, regions, origin)
    if broken:
        return broken
    found = cell_figures(points, cells, threads) if figures is None else figures()
    numbered, together = old_numbers(origin, len(before.points))[cells], in_old_numbers(
        before.points, points, origin)
    removed = removed_vertices(origin, len(before.points))
    held = {name: mask for name, mask in held_by(before).items()
            if name not in ("boundary", "interface")}
    new, overlaps = facet_census(cells, regions, len(points), uneven_facets(cells, len(points)))
    bad = cells_not_positive(points, cells, found)
    if len(bad):
        broken.append(f"cell {bad[0]} has volume {found.volume[bad[0]]:.3g}, not positive "
                      f"({len(bad)} in all)")
    broken += came_and_went(before, numbered, removed, held, len(together))
    broken += moved_though_held(before, together, held, slides=True)
    broken += changed_use(held["unused"], numbered, removed, len(together))
    broken += overlapping_facets(overlaps)
    broken += thawed_cells(before, numbered, regions, len(together))
    broken += fallen_since(before, points, cells, metric, keep, found, full)
    old = facet_census(before.cells, before.regions, len(before.points), before.uneven)[0]
    was, now = _pieces(old, before.faces[1]), _pieces(new, faces[1])
    broken += broken_lines(before.faces[0], faces[0], cells)
    for pair in sorted(was.keys() | now.keys()):
        if was.get(pair) != now.get(pair):
            broken.append(f"the surface of {_named(pair)} has {_told(now.get(pair))}; it had "
                          f"{_told(was.get(pair))}")
    for label in np.unique(before.regions).tolist():
        a, b = (_solid(t[r == label]) for t, r in (
            (before.cells, before.regions), (cells, regions)))
        if a != b:
            broken.append(f"region {label} has {b[0]} components and Euler characteristic {b[1]}; "
                          f"it had {a[0]} and {a[1]}")
    return broken + broken_sizes(before, points, cells, regions, found)


Piece = tuple[int, int, int]
"""Components, Euler characteristic, and loops of the rim of a piece of surface."""


def _pieces(facets: LockedFacets, named: Faces) -> dict[tuple[int, int, int], Piece]:
    """What tells the pieces of surface by the regions on their sides and their labels, the outside
    and none being -1.
    """
    ordered = np.sort(facets.facets, axis=1)
    n = int(ordered.max(initial=0)) + 1
    _, first, inverse = np.unique(row_keys(ordered, n), return_index=True, return_inverse=True)
    low, high = np.full(len(first), np.iinfo(np.int64).max), np.full(len(first), -1)
    np.minimum.at(low, inverse.ravel(), facets.labels)
    np.maximum.at(high, inverse.ravel(), facets.labels)
    alone = np.zeros(len(first), bool)
    alone[inverse.ravel()[facets.boundary]] = True
    low[alone], high[alone] = -1, low[alone]
    rows = ordered[first]
    label = np.column_stack([low, high, labels_at(rows, named)])
    names, number = np.unique(label, axis=0, return_inverse=True)
    return {(int(a), int(b), int(c)): _piece(rows[number.ravel() == i])
            for i, (a, b, c) in enumerate(names.tolist())}


def _piece(rows: NDArray[Any]) -> Piece:
    used, rows = np.unique(rows, return_inverse=True)
    rows = rows.reshape(-1, 3)
    edges, count = _faces(rows, 2)
    rim = edges[count % 2 == 1]
    loops = 0
    if len(rim):
        vertices, rim = np.unique(rim, return_inverse=True)
        rim = rim.reshape(-1, 2)
        loops = int(components(rim[:, 0], rim[:, 1], len(vertices)).max()) + 1
    return (int(components(edges[:, 0], edges[:, 1], len(used)).max()) + 1,
            len(used) - len(edges) + len(rows), loops)


def _solid(rows: NDArray[Any]) -> tuple[int, int]:
    """Components, by facets, and Euler characteristic of tetrahedra."""
    if not len(rows):
        return 0, 0
    used = np.zeros(int(rows.max()) + 1, dtype=np.bool_)
    used[rows] = True
    n = int(np.count_nonzero(used))
    ordered = np.sort((np.cumsum(used, dtype=np.int32) - np.int32(1))[rows], axis=1)
    key = row_keys(np.concatenate([np.delete(ordered, i, axis=1) for i in range(4)]), n)
    order = np.argsort(key)
    key = key[order]
    same = key[1:] == key[:-1]
    order %= len(rows)
    parts = int(components(order[:-1][same], order[1:][same], len(rows)).max()) + 1
    facets = len(key) - int(np.count_nonzero(same))
    del order, same, key
    ends = np.empty((6, len(rows)), dtype=np.int64)
    for row, (i, j) in zip(ends, combinations(range(4), 2), strict=True):
        np.multiply(ordered[:, i], n, out=row, dtype=np.int64)
        row += ordered[:, j]
    key = ends.ravel()
    key.sort()
    edges = 1 + int(np.count_nonzero(key[1:] != key[:-1]))
    return parts, n - edges + facets - len(rows)


def _faces(rows: NDArray[Any], size: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Faces of so many vertices, each once, and how many rows hold each."""
    columns = list(combinations(range(rows.shape[1]), size))
    faces = np.sort(rows, axis=1)[:, columns].reshape(-1, size)
    _, first, count = np.unique(row_keys(faces, int(rows.max()) + 1), return_index=True,
                                return_counts=True)
    return faces[first], count


def _named(pair: tuple[int, int, int]) -> str:
    return (f"region {pair[1]}" if pair[0] < 0 else f"regions {pair[0]} and {pair[1]}") + (
        f" with label {pair[2]}" if pair[2] >= 0 else "")


def _told(piece: Piece | None) -> str:
    if piece is None:
        return "no facets"
    return (f"{piece[0]} components, Euler characteristic {piece[1]} and {piece[2]} loops in its "
            f"rim")
