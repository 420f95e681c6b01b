"""Values on a new mesh with the integrals that they have on the old one, region by region.

Cells take the mean of the old values over what they have in common with old cells of their region.
A vertex i has the interpolated value, and what the interpolated field v misses of the old one u
around it:

    v_i + (integral of phi_i (u - v)) / (integral of phi_i),

where phi_i is 1 in vertex i, 0 in all others, and linear in every cell. The sum over all vertices
has the integral of u, since the functions phi_i have the sum 1; linear fields stay what they are,
and so does every vertex around which no cell changed. P. E. Farrell et al., Conservative
interpolation between unstructured meshes via supermesh construction, CMAME 198 (2009), solves for
the projection in L2 instead, of which this is the first step from v.

Where a boundary moved, a region is larger or smaller than before, and of a vertex between regions
neither has all that is missed. What is left of each region is made up for by the values in it,
each in proportion to its own size: signs and zeros stay.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.carrying.sources import nearest_of, surrounding_cells
from odt_plugins.figures import volumes
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.simplex import SimplexMesh, compact_labels, corner_mean

THIN = 0.9
"""Part of a new cell of which less is covered by old ones where the search begins anew."""

SAME = 1e-13
"""Relative difference of integrals up to which they are the same."""

TIMES = 3
"""How often the rest of the integrals is made up for, since sums are rounded."""


class After(NamedTuple):
    """The new mesh.

    Attributes
    ----------
    points, cells : (n', d) float64, (m', d + 1) int32   as of the old one
    source : (m',) int                                   old cell from which each would take data
    origin : (n',) int                                   old vertex of each, -1 for those added
    """

    points: FloatArray
    cells: IntArray
    source: NDArray[np.integer[Any]]
    origin: NDArray[np.integer[Any]]


class _Columns(NamedTuple):
    """Arrays side by side, as numbers: (k, c) float64, and which columns are of which."""

    values: FloatArray
    names: dict[str, slice]


def conserved(
    before: SimplexMesh, after: After, of_cells: Mapping[str, NDArray[Any]],
    of_points: Mapping[str, tuple[NDArray[Any], NDArray[Any]]], threads: int = 1,
) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[Any]]]:
    """Carry values to a new mesh so that their integrals over every region stay.

    Parameters
    ----------
    before : SimplexMesh
    after : After
    of_cells : dict of (m, ...)                   floating-point numbers for the old cells
    of_points : dict of (n, ...) and (n', ...)    for the old vertices, and for the new ones as they
                                                  are interpolated
    threads : int

    Returns
    -------
    dict of (m', ...), dict of (n', ...)          the same arrays, in their types, without those
                                                  that are not finite. On a curved surface cells
                                                  have the value of their source and vertices the
                                                  interpolated one, but for the share of it that
                                                  makes up for the integral
    """
    cells = _columns(of_cells, len(before.cells))
    of_points = {name: pair for name, pair in of_points.items()
                 if all(np.isfinite(values).all() for values in pair)}
    old, new = (_columns({name: pair[i] for name, pair in of_points.items()}, count)
                for i, count in enumerate((len(before.points), len(after.points))))
    if not cells.names and not new.names:
        return {}, {}
    unit, units = _units(cells.values), _units(np.concatenate([old.values, new.values]))
    cells, old, new = (part._replace(values=np.ldexp(part.values, -power))
                       for part, power in ((cells, unit), (old, units), (new, units)))
    label = compact_labels(before.bodies(), len(before.cells)).astype(np.int64)
    here = label[after.source]
    changed = _changed(before, after)
    values, fields = cells.values[after.source], new.values
    sizes = tuple(np.abs(volumes(*mesh)) for mesh in (
        (before.points, before.cells), (after.points, after.cells)))
    if not before.is_surface and changed.size:
        covered, means, missed = _overlaps(before, after, changed, (cells, old, new), threads)
        found = covered > 0.0
        values[changed[found]] += means[found] / covered[found, None]
        missed *= sizes[1][changed, None, None]
        k = after.cells.shape[1]
        lumped = _sums(after.cells.ravel(), np.repeat(sizes[1] / k, k), len(after.points))
        for b in range(fields.shape[1]):
            lot = _sums(after.cells[changed].ravel(), missed[:, :, b].ravel(), len(fields))
            fields[:, b] += np.divide(lot, lumped, out=np.zeros(len(lot)), where=lot != 0.0)
    may = np.zeros(len(after.cells), dtype=np.bool_)
    may[changed] = True
    _make_up_cells(values, cells.values, sizes, (label, here), may)
    _make_up_points(fields, old.values, sizes, (before.cells, after.cells), (label, here), may)
    values, fields = np.ldexp(values, unit), np.ldexp(fields, units)
    return (_arrays(values, cells.names, of_cells),
            _arrays(fields, new.names, {name: pair[0] for name, pair in of_points.items()}))


def _kind(values: NDArray[Any]) -> type[Any]:
    """Numbers of one or two columns that the values become."""
    return np.complex128 if values.dtype.kind == "c" else np.float64


def _columns(arrays: Mapping[str, NDArray[Any]], count: int) -> _Columns:
    """Those that are finite and not empty, complex ones as two numbers each."""
    parts, names, last = [], {}, 0
    for name, values in arrays.items():
        wide = values.reshape(len(values), -1)
        wide = np.ascontiguousarray(wide, dtype=_kind(wide))
        part = wide.view(np.float64)
        if part.shape[1] and np.isfinite(part).all():
            parts.append(part)
            names[name] = slice(last, last + part.shape[1])
            last += part.shape[1]
    parts.append(np.zeros((count, 0)))
    return _Columns(np.ascontiguousarray(np.concatenate(parts, axis=1)), names)


def _units(values: FloatArray) -> NDArray[np.int32]:
    """Powers of two (c,) by which columns are about 1 at most, so that no sum is out of range."""
    return np.asarray(np.frexp(np.abs(values).max(axis=0, initial=0.0))[1], dtype=np.int32)


def _arrays(
    values: FloatArray, names: dict[str, slice], like: Mapping[str, NDArray[Any]]
) -> dict[str, NDArray[Any]]:
    """Columns as arrays of the types and shapes that others have."""
    out = {}
    for name, where in names.items():
        part = np.ascontiguousarray(values[:, where]).view(_kind(like[name]))
        out[name] = part.reshape(-1, *like[name].shape[1:]).astype(like[name].dtype)
    return out


def _changed(before: SimplexMesh, after: After) -> IntArray:
    """New cells that are no old ones, in the same place."""
    moved = after.origin < 0
    moved |= (after.points != before.points[after.origin]).any(axis=1)
    rows = np.sort(after.origin[after.cells], axis=1)
    same = (rows == np.sort(before.cells[after.source], axis=1)).all(axis=1)
    return np.flatnonzero(~same | moved[after.cells].any(axis=1)).astype(np.int32)


def _sums(where: NDArray[Any], values: FloatArray, count: int) -> FloatArray:
    """Sums (count,) of the values that go to the same place."""
    out: Any = np.bincount(where, values, count)
    return np.asarray(out, dtype=np.float64)


def _overlaps(
    before: SimplexMesh, after: After, rows: IntArray,
    columns: tuple[_Columns, _Columns, _Columns], threads: int,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What :class:`odt_plugins.engine.topology.overlap.Sums` holds, of some new cells."""
    from odt_plugins.engine.compiled.threads import run_pieces, thread_pool, worth
    from odt_plugins.engine.topology.adjacency import cell_neighbors
    from odt_plugins.engine.topology.overlap import Sampled, Sums, make_room, overlaps

    of_cells, old, new = (part.values for part in columns)
    there = Sampled(before.points, before.cells, of_cells, old)
    here = Sampled(after.points, after.cells, of_cells[:0], new)
    neighbors = cell_neighbors(before.cells)
    bodies = before.bodies()
    neighbors[bodies[:, None] != bodies[neighbors]] = -1
    first = np.asarray(after.source)[rows].astype(np.int32)
    x = corner_mean(after.points, after.cells[rows], threads)
    around = surrounding_cells(before, x, first, threads)[0]
    found = Sums(np.zeros(len(rows)), np.zeros((len(rows), of_cells.shape[1])),
                 np.zeros((len(rows), before.dim + 1, new.shape[1])))

    def fill(chosen: IntArray, seeds: IntArray) -> None:
        with thread_pool(worth(threads, len(chosen))) as pool:
            def work(start: int, stop: int) -> None:
                part = chosen[start:stop]
                sums = Sums(*(np.zeros((len(part), *values.shape[1:])) for values in found))
                room = make_room(len(before.cells), before.dim)
                overlaps(there, neighbors, here, rows[part], seeds[start:stop], room, sums)
                for whole, values in zip(found, sums, strict=True):
                    whole[part] = values

            run_pieces(pool, len(chosen), work)

    fill(np.arange(len(rows), dtype=np.int32), np.stack([first, around], axis=1))
    thin = np.flatnonzero(found.covered < THIN).astype(np.int32)
    if thin.size:
        near = nearest_of(before, x[thin], bodies[first[thin]], threads)
        fill(thin, np.concatenate([np.stack([first, around], axis=1)[thin], near], axis=1))
    return found.covered, found.of_cells, found.of_points


def _make_up_cells(
    values: FloatArray, old: FloatArray, sizes: tuple[FloatArray, ...],
    labels: tuple[NDArray[np.int64], NDArray[np.int64]], may: BoolArray,
) -> None:
    """Change values of the cells in `may` until regions have their old integrals."""
    count = int(labels[0].max()) + 1
    for a in range(values.shape[1]):
        want = _sums(labels[0], sizes[0] * old[:, a], count)
        lot = _sums(labels[0], sizes[0] * np.abs(old[:, a]), count)
        for _ in range(TIMES):
            gap = want - _sums(labels[1], sizes[1] * values[:, a], count)
            gap[np.abs(gap) <= SAME * lot] = 0.0
            if not gap.any():
                break
            weight = np.where(may, np.abs(values[:, a]), 0.0)
            total = _sums(labels[1], sizes[1] * weight, count)
            bare = (total <= np.abs(gap))[labels[1]]
            weight[bare] = may[bare]
            total = _sums(labels[1], sizes[1] * weight, count)
            rate = np.divide(gap, total, out=np.zeros(count), where=total > 0.0)
            values[:, a] += rate[labels[1]] * weight


def _make_up_points(
    values: FloatArray, old: FloatArray, sizes: tuple[FloatArray, ...],
    cells: tuple[IntArray, IntArray], labels: tuple[NDArray[np.int64], NDArray[np.int64]],
    may: BoolArray,
) -> None:
    """Give vertices of cells that `may` change what the integrals over the regions lack."""
    n, k, count = len(values), cells[0].shape[1], int(labels[0].max()) + 1
    key, inverse = np.unique(np.repeat(labels[1], k) * n + cells[1].ravel(), return_inverse=True)
    region, vertex = key // n, key % n
    part = _sums(inverse, np.repeat(sizes[1] / k, k), len(key))
    lumped = _sums(vertex, part, n)
    free = np.zeros(n, dtype=np.bool_)
    free[cells[1][may]] = True
    for b in range(values.shape[1]):
        corners = old[:, b][cells[0]]
        want = _sums(labels[0], sizes[0] * corners.mean(axis=1), count)
        lot = _sums(labels[0], sizes[0] * np.abs(corners).mean(axis=1), count)
        close = SAME * lot + SAME**1.25 * lot.sum()
        for attempt in range(2 * TIMES):
            gap = want - _sums(region, part * values[vertex, b], count)
            if (np.abs(gap) <= close).all():
                break
            weight = np.where(free, np.abs(values[:, b]), 0.0)
            if attempt >= TIMES or not weight.any():
                weight = free * max(float(np.abs(values[:, b]).max()), float(np.abs(gap).max()))
            rate = np.divide(weight, lumped, out=np.zeros(n), where=lumped > 0.0)
            share = _solved((region, vertex, part), rate, gap, close)
            values[:, b] += rate * _sums(vertex, part * share[region], n)


def _solved(
    rows: tuple[NDArray[np.int64], NDArray[np.int64], FloatArray], rate: FloatArray,
    gap: FloatArray, close: FloatArray,
) -> FloatArray:
    """Solve C W C^T x = gap by conjugate gradients, C sparse (r, n), W the diagonal of `rate`."""
    region, vertex, part = rows
    count, n = len(gap), len(rate)
    diagonal = _sums(region, part * part * rate[vertex], count)
    scale = np.divide(1.0, diagonal, out=np.zeros(count), where=diagonal > 0.0)
    x, rest = np.zeros(count), gap.copy()
    way = scale * rest
    energy = float(np.sum(rest * way))
    for _ in range(2 * count + 10):
        if energy <= 0.0 or (np.abs(rest) <= 0.1 * close).all():
            break
        flow = rate * _sums(vertex, part * way[region], n)
        image = _sums(region, part * flow[vertex], count)
        step = energy / float(np.sum(way * image))
        x += step * way
        rest -= step * image
        before, energy = energy, float(np.sum(rest * scale * rest))
        way = scale * rest + (energy / before) * way
    return x
