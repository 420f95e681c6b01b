"""The promise of triangles that were remeshed: what must hold where their vertices are others.

Distances are not looked at here, nor whether a surface cuts through itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import counted
from odt_plugins.figures import cell_figures
from odt_plugins.mesh.components import components
from odt_plugins.mesh.faces import Faces
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.numbering import old_numbers
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.mesh.surface import Edges, opposed, surface_edges
from odt_plugins.promise.faces import broken_lines
from odt_plugins.promise.good import fallen_since
from odt_plugins.promise.region_sizes import broken_sizes
from odt_plugins.promise.volume import cells_not_positive

Shape = tuple[int, int]
"""Components and Euler characteristic."""


def broken_by_retiling(
    before: SimplexMesh,
    points: NDArray[np.float64],
    cells: NDArray[np.int32],
    regions: NDArray[np.int32],
    origin: NDArray[np.int64],
    keep: Sequence[str],
    metric: NDArray[np.float64],
    lines: Faces,
) -> list[str]:
    """Say what of the promise does not hold for triangles with other vertices.

    Parameters
    ----------
    before : SimplexMesh                triangles in the plane or in space
    points, cells, regions : arrays     (n, d), (m', 3), (m',): the mesh to be judged
    origin : (n,) int                   old vertex of every vertex, increasing, then -1
    keep : names of figures             none may be worse than before, see ``promise.good``
    metric : (n, k) float64              of the metric in which figures are measured, no rows where
                                        there is none
    lines : Faces                       those that lines with labels have become

    Returns
    -------
    list of str                         one sentence per broken promise; empty when all hold

    Notes
    -----
    The triangles of every label, the edges on the rim, those between two labels and those of more
    than two triangles have as many components and the same Euler characteristic as before.
    """
    broken = _malformed(before, points, cells, regions, origin)
    if broken:
        return broken
    number = old_numbers(origin, len(before.points))
    broken += _moved(before, points, cells, regions, origin, number)
    planar = points.shape[1] == 2
    if planar:
        bad = cells_not_positive(points, cells, cell_figures(points, cells))
        if len(bad):
            broken.append(f"triangle {bad[0]} has no positive area, {len(bad)} in all")
    else:
        flat = without_area(points, cells)
        if flat.sum() > without_area(before.points, before.cells).sum():
            broken.append(f"triangle {flat.argmax()} has no area, {flat.sum()} in all")
    old, new = (surface_edges(t, len(x)) for t, x in (
        (before.cells, before.points), (cells, points)))
    turned = [len(opposed(e)) for e in (old, new)]
    if turned[1] > turned[0]:
        broken.append(f"the triangles at {turned[1]} edges disagree about the outside, those at "
                      f"{turned[0]} did")
    was, now = _shapes(before.cells, before.regions, old), _shapes(cells, regions, new)
    for name in sorted(was.keys() | now.keys()):
        if was.get(name) != now.get(name):
            broken.append(f"{name} has the components and Euler characteristic {now.get(name)}; it "
                          f"had {was.get(name)}")
    broken += broken_lines(before.faces[0], lines, cells)
    if planar:
        broken += broken_sizes(before, points, cells, regions)
    return broken + fallen_since(before, points, cells, metric, keep)


def without_area(points: NDArray[np.float64], cells: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Mark the triangles (m,) in space with an altitude that the rounding of coordinates hides."""
    x = points[cells]
    u, v = x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]
    area = np.cross(u, v)
    longest = np.maximum(np.maximum((u**2).sum(axis=1), (v**2).sum(axis=1)),
                         ((u - v) ** 2).sum(axis=1))
    least = float(np.finfo(np.float64).eps) * float(np.abs(x).max(initial=0.0))
    return np.asarray(~((area**2).sum(axis=1) > least**2 * longest))


def _malformed(
    before: SimplexMesh, points: Any, cells: Any, regions: Any, origin: Any
) -> list[str]:
    n = len(points)
    if not (points.ndim == 2 and points.shape[1] == before.points.shape[1]
            and cells.shape == (len(cells), 3) and regions.shape == (len(cells),)
            and origin.shape == (n,)):
        return [f"arrays have shapes {points.shape}, {cells.shape}, {regions.shape}, "
                f"{origin.shape}"]
    if not np.isfinite(points).all():
        return ["some vertices are not finite"]
    if len(cells) == 0 or cells.min() < 0 or cells.max() >= n:
        return [f"triangles name vertices beyond {n}"]
    if (cells == cells[:, [1, 2, 0]]).any():
        return ["some triangles have a vertex twice"]
    keys = row_keys(np.sort(cells, axis=1), n)
    if len(np.unique(keys)) < len(keys):
        return ["some triangles are there twice"]
    kept = origin >= 0
    if (np.diff(origin[kept]) <= 0).any() or kept[np.count_nonzero(kept):].any():
        return ["vertices lost their order"]
    return []


def _moved(
    before: SimplexMesh, points: Any, cells: Any, regions: Any, origin: Any, number: Any
) -> list[str]:
    """Look for vertices and triangles that had to stay."""
    n = len(before.points)
    used = np.zeros(n, dtype=np.bool_)
    used[before.cells] = True
    held = before.fixed | before.anchored | ~used
    held[before.cells[before.frozen]] = True
    new = np.full(n, -1, dtype=np.int64)
    kept = np.flatnonzero(origin >= 0)
    new[origin[kept]] = kept
    lost = np.flatnonzero(held & (new < 0))
    if len(lost):
        return [f"vertex {lost[0]} is gone, which is held, {len(lost)} in all"]
    stays = np.flatnonzero(held & ~before.anchored | held & before.fixed)
    a, b = (np.ascontiguousarray(x, np.float64).view(np.int64)
            for x in (before.points[stays], points[new[stays]]))
    bad = stays[(a != b).any(axis=1)]
    sentences = [f"vertex {bad[0]} moved, which is held, {len(bad)} in all"] if len(bad) else []
    if before.frozen.any():
        # new vertices have numbers beyond those of the input
        rows = [np.column_stack([np.sort(c, axis=1), r]) for c, r in (
            (before.cells[before.frozen], before.regions[before.frozen]), (number[cells], regions))]
        size = int(max(number.max() + 1, n, regions.max() + 1, before.regions.max() + 1))
        keys = row_keys(np.concatenate(rows), size)
        gone = ~np.isin(keys[: len(rows[0])], keys[len(rows[0]) :])
        if gone.any():
            are = counted(int(gone.sum()), "frozen triangle is", "frozen triangles are")
            sentences.append(f"{are} gone")
    return sentences


def _shapes(cells: Any, regions: Any, edges: Edges) -> dict[str, Shape]:
    """Components and Euler characteristic of what makes the topology of labelled triangles."""
    shapes = {}
    for label in np.unique(regions).tolist():
        rows = cells[regions == label]
        pairs = surface_edges(rows, int(rows.max()) + 1).vertices
        graph = _graph(pairs)
        shapes[f"label {label}"] = graph[0], graph[1] + len(rows)
    low = np.full(len(edges.degree), np.iinfo(np.int64).max)
    high = np.full(len(edges.degree), -1, dtype=np.int64)
    labels = np.repeat(np.asarray(regions, dtype=np.int64), 3)
    np.minimum.at(low, edges.of_cell.ravel(), labels)
    np.maximum.at(high, edges.of_cell.ravel(), labels)
    key = row_keys(np.stack([np.minimum(edges.degree, 3), low, high], axis=1),
                   int(max(high.max(), 3)) + 1)
    border = (edges.degree != 2) | (low != high)
    for value in np.unique(key[border]).tolist():
        rows = np.flatnonzero(border & (key == value))
        degree, a, b = int(edges.degree[rows[0]]), int(low[rows[0]]), int(high[rows[0]])
        name = f"the rim of label {a}" if degree == 1 else f"the border of labels {a} and {b}"
        if degree > 2:
            name = f"the seam of labels {a} to {b}"
        shapes[name] = _graph(edges.vertices[rows])
    return shapes


def _graph(pairs: Any) -> Shape:
    """Components, and vertices less edges."""
    used, rows = np.unique(pairs, return_inverse=True)
    rows = rows.reshape(-1, 2)
    count = int(components(rows[:, 0], rows[:, 1], len(used)).max()) + 1
    return count, len(used) - len(rows)
