"""The promise for curved surfaces, checked in numpy alone; distances are measured elsewhere.

Like :mod:`odt_plugins.promise.volume` this file shares no kernel with the optimiser.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import counted
from odt_plugins.figures import measured, summarize
from odt_plugins.mesh.components import components
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.seen import NO_METRIC, as_seen
from odt_plugins.mesh.simplex import SimplexMesh, vertices_of
from odt_plugins.mesh.surface import Edges, opposed, surface_edges
from odt_plugins.options import KEPT
from odt_plugins.promise.volume import worse_figures

FOLD = 120.0
"""Degrees by which the surface turns at an edge where it folds back on itself."""

ROUNDED = 5.0
"""Degrees by which an edge of the input may turn less and still be a fold that is known."""


def broken_surface_promises(
    before: SimplexMesh,
    points: NDArray[np.float64],
    cells: NDArray[np.int32],
    regions: NDArray[np.int32],
    keep: Sequence[str] = KEPT,
    *,
    lines: NDArray[np.integer] | None = None,
    held: NDArray[np.bool_] | None = None,
    envelope: float = math.inf,
    metric: NDArray[np.float64] = NO_METRIC,
) -> list[str]:
    """Say what of the promise does not hold for an optimised surface, its distance apart.

    Parameters
    ----------
    before : SimplexMesh                the triangles in space that the optimiser started from
    points, cells, regions : arrays     (n, 3), (m', 3), (m',): the surface to be judged
    keep : names of figures             none may be worse than before
    lines : (k, 2) int, optional        feature edges, which must still be edges
    held : (n,) bool, optional          corners and other vertices that must not have moved
    envelope : float                    length; folds lie no further from those of the input
    metric : (n, k) float64             of the metric in which figures are measured, no rows where
                                        there is none

    Returns
    -------
    list of str                         one sentence per broken promise; empty when all hold

    Notes
    -----
    The same vertices in use, as many triangles of every label, as many edges, the same edges where
    not two triangles meet, neighbours that agree about the outside, as many fans around every
    vertex and the same connected pieces: then the topology is the same.
    """
    broken = _malformed(before, points, cells, regions)
    if broken:
        return broken
    n = len(points)
    fixed = before.fixed.copy()
    if held is not None:
        fixed |= held
    fixed[before.cells[before.frozen]] = True
    used = np.zeros(n, dtype=np.bool_)
    used[before.cells] = True
    broken += _moved(before.points, points, fixed | ~used)
    if not np.array_equal(vertices_of(cells), np.flatnonzero(used)):
        lost = np.setxor1d(cells, np.flatnonzero(used))
        broken.append(f"vertex {lost[0]} came into use or out of it, {len(lost)} in all")
    old, new = surface_edges(before.cells, n), surface_edges(cells, n)
    broken += _torn(before, old, regions, new, lines)
    broken += _resewn(before.cells, old, cells, new, n)
    broken += _thawed(before, cells, regions)
    broken += _folded(before.points, before.cells, old, points, cells, new, envelope)
    if keep:
        was = measured(before).summary
        broken += worse_figures(was, summarize(*as_seen(points, cells, metric)), keep)
    return broken


def _malformed(before: SimplexMesh, points: Any, cells: Any, regions: Any) -> list[str]:
    n, m = len(before.points), len(before.cells)
    if points.shape != (n, 3):
        return [f"points have shape {points.shape}, they had {(n, 3)}"]
    if cells.shape != (m, 3):
        return [f"triangles have shape {cells.shape}, they had {(m, 3)}"]
    labels = np.union1d(before.regions, regions)
    counts = [np.bincount(np.searchsorted(labels, r), minlength=len(labels))
              for r in (before.regions, regions)]
    if not np.array_equal(counts[0], counts[1]):
        return [f"labels have {counts[1].tolist()} triangles, they had {counts[0].tolist()}"]
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        return [f"vertex {bad[0]} is not finite, {len(bad)} in all"]
    if cells.min() < 0 or cells.max() >= n:
        return [f"triangles name vertices from {cells.min()} to {cells.max()}, there are {n}"]
    same = (cells[:, [0, 1, 2]] == cells[:, [1, 2, 0]]).any(axis=1)
    if same.any():
        return [f"triangle {np.flatnonzero(same)[0]} has a vertex twice, {int(same.sum())} in all"]
    return []


def _moved(old: Any, new: Any, held: NDArray[np.bool_]) -> list[str]:
    a, b = (np.ascontiguousarray(p, np.float64).view(np.int64) for p in (old, new))
    bad = np.flatnonzero(held & (a != b).any(axis=1))
    return [f"vertex {bad[0]} moved, which is held, {len(bad)} in all"] if len(bad) else []


def _keys(pairs: NDArray[Any], n: int) -> NDArray[np.int64]:
    low, high = pairs.min(axis=1).astype(np.int64), pairs.max(axis=1)
    return np.asarray(low * n + high)


def _torn(
    before: SimplexMesh, old: Edges, regions: NDArray[Any], new: Edges, lines: NDArray[Any] | None
) -> list[str]:
    """Compare the edges that must stay: rims, where several sheets meet, label borders, lines."""
    n = len(before.points)
    sentences = []
    a, b = ((_keys(e.vertices[e.degree != 2], n), e.degree[e.degree != 2]) for e in (old, new))
    if not (np.array_equal(a[0], b[0]) and np.array_equal(a[1], b[1])):
        sentences.append(f"{len(b[0])} edges are not of two triangles, {len(a[0])} were, or others")
    borders = [_keys(_border(e, r), n) for e, r in ((old, before.regions), (new, regions))]
    if not np.array_equal(borders[0], borders[1]):
        sentences.append(f"{len(borders[1])} edges lie between labels, {len(borders[0])} did, or "
                         f"others")
    if lines is not None and len(lines):
        gone = ~np.isin(_keys(np.asarray(lines), n), _keys(new.vertices, n))
        if gone.any():
            first = tuple(np.asarray(lines)[gone][0].tolist())
            sentences.append(f"feature edge {first} is gone, {int(gone.sum())} in all")
    return sentences


def _border(edges: Edges, regions: NDArray[Any]) -> NDArray[Any]:
    """Edges of two triangles of different labels, in order."""
    differs = (edges.neighbors >= 0) & (regions[edges.neighbors] != regions[:, None])
    mask = np.zeros(len(edges.degree), dtype=np.bool_)
    mask[edges.of_cell[differs]] = True
    return np.asarray(edges.vertices[mask])


def _resewn(
    old_cells: NDArray[Any], old: Edges, cells: NDArray[Any], new: Edges, n: int
) -> list[str]:
    """Compare what is left of the topology."""
    sentences = []
    if len(old.degree) != len(new.degree):
        sentences.append(f"there are {len(new.degree)} edges, there were {len(old.degree)}")
    was, now = (_keys(e.vertices[opposed(e)], n) for e in (old, new))
    turned = opposed(new)[~np.isin(now, was)]
    if len(turned):
        first = tuple(new.vertices[turned[0]].tolist())
        sentences.append(f"the triangles at edge {first} disagree about the outside, "
                         f"{counted(len(turned), 'such edge')}")
    keys = row_keys(np.sort(cells, axis=1), n)
    repeated = len(keys) - len(np.unique(keys))
    if repeated:
        sentences.append(f"{counted(repeated, 'triangle is', 'triangles are')} there twice")
    differs = np.flatnonzero(_fans(old_cells, old, n) != _fans(cells, new, n))
    if len(differs):
        sentences.append(f"the triangles around vertex {differs[0]} form another number of fans, "
                         f"{counted(len(differs), 'such vertex', 'such vertices')}")
    if not np.array_equal(_pieces(old, n), _pieces(new, n)):
        sentences.append("the connected pieces have other vertices than before")
    return sentences


def _first_members(rows: NDArray[Any], columns: NDArray[Any], size: int) -> NDArray[np.int32]:
    """Connected components, numbered by their first member."""
    label = components(rows, columns, size)
    first = np.empty(int(label.max(initial=-1)) + 1, dtype=np.int32)
    first[label[::-1]] = np.arange(size - 1, -1, -1, dtype=np.int32)
    return first[label]


def _pieces(edges: Edges, n: int) -> NDArray[np.int32]:
    """First vertex of the connected piece of every vertex, (n,)."""
    return _first_members(edges.vertices[:, 0], edges.vertices[:, 1], n)


def _fans(cells: NDArray[Any], edges: Edges, n: int) -> NDArray[np.int64]:
    """Into how many fans the triangles around every vertex fall, (n,)."""
    cell, corner = np.nonzero(edges.neighbors > np.arange(len(cells))[:, None])
    other = edges.neighbors[cell, corner]
    rows, columns = [], []
    for step in (1, 2):
        at = (corner + step) % 3
        vertex = cells[cell, at]
        rows.append(3 * cell + at)
        columns.append(3 * other + np.argmax(cells[other] == vertex[:, None], axis=1))
    label = _first_members(np.concatenate(rows), np.concatenate(columns), cells.size)
    first = label == np.arange(len(label))
    return np.bincount(cells.ravel()[first], minlength=n)


def _thawed(before: SimplexMesh, cells: NDArray[Any], regions: NDArray[Any]) -> list[str]:
    """Look every frozen triangle up, with its label."""
    if not before.frozen.any():
        return []
    n = max(len(before.points), int(before.regions.max()) + 1, int(regions.max()) + 1)
    rows = [np.column_stack([np.sort(c, axis=1), r])
            for c, r in ((before.cells[before.frozen], before.regions[before.frozen]),
                         (cells, regions))]
    keys = row_keys(np.concatenate(rows), n)
    gone = ~np.isin(keys[: len(rows[0])], keys[len(rows[0]) :])
    if not gone.any():
        return []
    first = np.flatnonzero(before.frozen)[np.flatnonzero(gone)[0]]
    return [f"frozen triangle {first} is gone, {int(gone.sum())} in all"]


def _folded(
    old_points: Any, old_cells: Any, old: Edges, points: Any, cells: Any, new: Edges,
    envelope: float,
) -> list[str]:
    """Count flat triangles, which only get fewer, and look for folds where the input has none."""
    flat, flat_now = (int(bad_places(*args)[0].sum())
                      for args in ((old_points, old_cells, old), (points, cells, new)))
    sentences = []
    if flat_now > flat:
        have = counted(flat_now, "triangle has", "triangles have")
        sentences.append(f"{have} no area, {flat} had none")
    fresh = np.flatnonzero(new_folds(old_points, old_cells, old, points, cells, new, envelope))
    if len(fresh):
        first = tuple(new.vertices[fresh[0]].tolist())
        sentences.append(f"the surface folds back at edge {first}, where the input does not, "
                         f"{counted(len(fresh), 'such edge')}")
    return sentences


def new_folds(
    old_points: NDArray[np.float64], old_cells: NDArray[np.int32], old: Edges,
    points: NDArray[np.float64], cells: NDArray[np.int32], new: Edges, envelope: float = math.inf,
) -> NDArray[np.bool_]:
    """Mark the edges (e,) at which a surface folds back where the input does not.

    The input does at edges to which both ends are nearer than half the length of the edge, and than
    the envelope; rounding decides nothing, since ROUNDED degrees less suffice there.
    """
    _, folds = bad_places(points, cells, new)
    if not folds.any():
        return folds
    _, known = bad_places(old_points, old_cells, old, FOLD - ROUNDED)
    ends = points[new.vertices]
    reach = np.minimum(0.5 * np.sqrt(((ends[:, 1] - ends[:, 0]) ** 2).sum(axis=1)), envelope)
    moved = np.sqrt(((points - old_points) ** 2).sum(axis=1))[new.vertices].max(axis=1)
    n = len(points)
    there = np.isin(_keys(new.vertices, n), _keys(old.vertices[known], n)) & (moved <= reach)
    start, end = (old_points[old.vertices[known, i]] for i in range(2))
    out: NDArray[np.bool_] = folds & ~there
    for edge in np.flatnonzero(out).tolist():
        away = [_distances(x, start, end).min(initial=np.inf) for x in ends[edge]]
        out[edge] = max(away) > reach[edge]
    return out


def _distances(
    x: NDArray[np.float64], start: NDArray[np.float64], end: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Distances (k,) of a point (3,) from segments."""
    along = end - start
    square = (along * along).sum(axis=1)
    share = np.divide(((x - start) * along).sum(axis=1), square, out=np.zeros(len(start)),
                      where=square > 0.0)
    foot = start + np.clip(share, 0.0, 1.0)[:, None] * along
    return np.asarray(np.sqrt(((x - foot) ** 2).sum(axis=1)))


def bad_places(
    points: NDArray[np.float64], cells: NDArray[np.int32], edges: Edges, fold: float = FOLD
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Mark flat triangles (m,), and edges (e,) at which a surface turns by more than `fold`.

    The neighbours of a flat triangle over two of its edges are compared with each other.
    """
    a, b, c = (points[cells[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    length = np.sqrt((normal * normal).sum(axis=1))
    unit = np.divide(normal, length[:, None], out=np.zeros_like(normal), where=length[:, None] > 0)
    limit = math.cos(math.radians(fold))
    folds = np.zeros(len(edges.degree), dtype=np.bool_)
    for i in range(3):
        near = edges.neighbors[:, i]
        once = np.flatnonzero(near > np.arange(len(cells)))
        sharp = (unit[once] * unit[near[once]]).sum(axis=1) < limit
        folds[edges.of_cell[once[sharp], i]] = True
    flat = ~(length > 0)
    row = np.flatnonzero(flat)
    for i in range(3):
        j = (i + 1) % 3
        one, two = edges.neighbors[row, i], edges.neighbors[row, j]
        back = (one >= 0) & (two >= 0) & ((unit[one] * unit[two]).sum(axis=1) < limit)
        folds[edges.of_cell[row[back], i]] = True
    return flat, folds
