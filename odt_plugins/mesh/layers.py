"""Cells that are stretched alike with their neighbours: boundary layers, plates, shocks.

The implied metric of a cell is the one in which all its edges have length 1; its inverse is, but
for a factor, the sum of e e^T over the edges e. The part without trace of the logarithm of that
inverse is the shape of the cell: 0 where it is regular, with the stretching directions as its
eigenvectors and the logarithms of the squared lengths as eigenvalues. Shapes of slivers point in
many directions and cancel out in the mean around a vertex; those of a layer do not, since its cells
are well shaped in that mean.
"""

from __future__ import annotations

import math
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.chunks import chunks, spread
from odt_plugins.mesh.components import components
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.simplex import SimplexMesh, cell_signs, determinant, freeze
from odt_plugins.mesh.symmetric import eigen, logarithms

ALIKE = 0.75
"""Largest distance of the shape of a cell from the mean, as a part of the size of that mean."""
SEVERAL = {2: 40, 3: 150}
"""Fewest cells of a layer, connected through facets, by dimension."""
FEW = 0.01
"""Largest part of the cells of a mesh with layers that may be inverted or flat: more of them
stretch many others."""
TOUCHED = 0.1
"""Largest part of the cells of a layer that may be beside inverted or flat ones."""

SAME_SIDE = 0.1
"""Cosine above which normals point the same way."""


class Stretch(NamedTuple):
    """What makes a vertex one of a layer.

    Attributes
    ----------
    ratio : float    least of the longest by the shortest length of the mean metric around it
    spread : float   largest root mean square of distances of the shapes from their mean, as a part
                     of the size of the mean
    """

    ratio: float
    spread: float


CORE = Stretch(4.0, 0.5)
"""What every layer has somewhere."""
FADING = Stretch(2.5, 0.65)
"""How far a layer goes from there."""


def keep_layers(
    mesh: SimplexMesh, threads: int = 1, start: SimplexMesh | None = None,
    source: IntArray | None = None,
) -> tuple[SimplexMesh, int]:
    """Freeze the cells of coherent layers.

    Parameters
    ----------
    mesh : SimplexMesh    a curved surface, whose needles may be alike too, comes back as it is
    threads : int         how many share the work
    start : SimplexMesh   what the mesh was before it was untangled: only layers that it had count
    source : (m,) int     cell of `start` that every cell comes from

    Returns
    -------
    mesh : SimplexMesh    with more in `fixed` and `frozen`, or the same object
    kept : int            how many cells were not frozen before
    """
    if mesh.is_surface:
        return mesh, 0
    if start is None or source is None:
        found = layer_cells(mesh.points, mesh.cells, mesh.bodies(), threads)
    else:
        found = _left_of_layers(mesh, threads, start, source)
    found &= ~mesh.frozen
    return (freeze(mesh, found) if found.any() else mesh), int(found.sum())


def layer_cells(
    points: FloatArray, cells: IntArray, regions: IntArray | None = None, threads: int = 1
) -> BoolArray:
    """Mark the cells (m,) of coherent layers.

    A vertex is one of a layer where at least half of the cells around are stretched, their mean is,
    and their shapes are near that mean. A cell belongs to a layer if its shape is near the mean at
    one of its vertices, and many such cells hang together; so does a stretched cell between
    vertices of such cells, as at corners of a wall.  Cells that fill a surface without vertices
    inside belong to none.

    Parameters
    ----------
    points : (n, d) float64, d = 2 or 3    in any unit
    cells : (m, d + 1) int32               of positive volume
    regions : (m,) int32                   labels; cells of one label have means of their own
    threads : int                          how many share the work
    """
    found = np.zeros(len(cells), dtype=np.bool_)
    parts = spread(lambda part: regularity(points, cells[part]), chunks(len(cells)), threads)
    regular = np.concatenate(parts)
    places, k = _places(len(points), cells, regions)
    core = _alike(points, cells, places, k, regular, CORE, threads)
    core = core[_many(cells[core], len(points))]
    if core.size:
        through = ~_between_walls(points, cells, places, k)
        core = core[through[core]]
        core = core[_many(cells[core], len(points))]
    if not core.size:
        return found
    whole = _alike(points, cells, places, k, regular, FADING, threads)
    whole = np.union1d(core, whole[through[whole]])
    label = _clusters(cells[whole], len(points))
    found[whole[np.isin(label, label[np.searchsorted(whole, core)])]] = True
    inside = np.zeros(len(points), dtype=np.bool_)
    inside[cells[found]] = True
    stretched = regular < most_regular(FADING.ratio, cells.shape[1] - 1)
    return found | (stretched & through & inside[cells].all(axis=1))


def regularity(points: FloatArray, cells: IntArray) -> FloatArray:
    """Product of the eigenvalues of the inverse implied metric, of mean 1.

    Returns
    -------
    (m,) float64    1 for regular cells, 0 for flat ones
    """
    d = cells.shape[1] - 1
    corners = [points.take(corner, axis=0) for corner in cells.T]
    squares = np.zeros(len(cells))
    for a, b in combinations(corners, 2):
        squares += np.einsum("ij,ij->i", b - a, b - a)
    content = np.abs(determinant([(corner - corners[0]).T for corner in corners[1:]]))
    mean = squares / (0.5 * d * (d + 1))
    share = content / mean
    share *= content / mean * (2.0**d / (d + 1))
    return np.asarray(share if d == 2 else share / mean)


def most_regular(ratio: float, d: int) -> float:
    """Largest regularity of a cell in d dimensions whose longest by shortest length is `ratio`."""
    high = ratio**2
    values = np.array([1.0, *[0.5 * (1.0 + high)] * (d - 2), high])
    return float((values / values.mean()).prod())


def shapes(inverse: FloatArray) -> FloatArray:
    """Parts without trace of the logarithms of symmetric matrices (m, d, d), of the same shape."""
    values, axes = eigen(inverse)
    least = np.finfo(np.float64).eps * values.max(axis=1, keepdims=True)
    logs = logarithms(np.maximum(values, least))
    logs -= logs.mean(axis=1, keepdims=True)
    return np.asarray(np.einsum("mik,mjk->mij", axes * logs[:, None, :], axes))


def edge_products(points: FloatArray, cells: IntArray) -> FloatArray:
    """Sums (m, d, d) of e e^T over the edges e of cells."""
    d = points.shape[1]
    total = np.zeros((len(cells), d, d))
    for a, b in combinations(cells.T, 2):
        edge = points[b] - points[a]
        total += edge[:, :, None] * edge[:, None, :]
    return total


def inverse_metrics(points: FloatArray, cells: IntArray) -> FloatArray:
    """Inverse implied metrics (m, d, d) of cells, each of trace 1."""
    inverse = edge_products(points, cells)
    inverse /= np.trace(inverse, axis1=1, axis2=2)[:, None, None]
    return inverse


def _left_of_layers(
    mesh: SimplexMesh, threads: int, start: SimplexMesh, source: IntArray
) -> BoolArray:
    """Cells of a mesh that are just as they were in a layer of the tangled one."""
    x, cells = start.points, start.cells
    valid = cell_signs(x, cells, threads)[0] > 0
    layer = np.zeros(len(cells), dtype=np.bool_)
    if (~valid).sum() > FEW * len(cells):
        return layer[source]
    layer[valid] = layer_cells(x, cells[valid], start.bodies()[valid], threads)
    bad = np.zeros(len(x), dtype=np.bool_)
    bad[cells[~valid]] = True
    rows = np.flatnonzero(layer)
    label = _clusters(cells[rows], len(x))
    touching = np.bincount(label, bad[cells[rows]].any(axis=1))
    layer[rows] = (touching <= TOUCHED * np.bincount(label))[label]
    stays = np.zeros(len(mesh.points), dtype=np.bool_)
    stays[: len(x)] = (mesh.points[: len(x)] == x).all(axis=1)
    same = (np.sort(mesh.cells, axis=1) == np.sort(cells[source], axis=1)).all(axis=1)
    return np.asarray(layer[source] & same & stays[mesh.cells].all(axis=1))


def _places(n: int, cells: IntArray, regions: IntArray | None) -> tuple[NDArray[np.int64], int]:
    """Number of the vertex of every corner (m, d + 1), one for every region there, and how many."""
    places = cells.astype(np.int64)
    if regions is None or not regions.any():
        return places, n
    label = np.zeros(n, dtype=regions.dtype)
    label[cells] = regions[:, None]
    several = np.zeros(n, dtype=np.bool_)
    several[cells[label[cells] != regions[:, None]]] = True
    mixed = several[cells]
    keys = places + n * regions[:, None].astype(np.int64)
    distinct, number = np.unique(keys[mixed], return_inverse=True)
    places[mixed] = n + number.ravel()
    return places, n + len(distinct)


def _between_walls(
    points: FloatArray, cells: IntArray, places: NDArray[np.int64], k: int
) -> BoolArray:
    """Cells (m,) with all corners on the boundary that are no part of a thin plate.

    A plate is thin along the normals of its boundary, which point to both sides. What fills a
    surface without vertices inside is thin along normals that point to one side or, in space, long
    along those of all corners.
    """
    d = points.shape[1]
    facets = _facets(places).reshape(-1, d)
    _, first, count = np.unique(
        row_keys(np.sort(facets, axis=1), k), return_index=True, return_counts=True)
    lone = first[count == 1]
    vertex = np.zeros(k, dtype=np.int64)
    vertex[places] = cells
    corners = points[vertex[facets[lone]]]
    edges = np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0)
    normal = np.cross(*edges) if d == 3 else edges[0][:, ::-1] * (1.0, -1.0)
    inwards = ((points[cells.ravel()[lone]] - corners[:, 0]) * normal).sum(axis=1)
    normal *= -np.sign(inwards)[:, None]
    out = np.stack([_sums(facets[lone], column, k) for column in normal.T], axis=1)
    size = np.sqrt((out**2).sum(axis=1))
    out[size > 0.0] /= size[size > 0.0, None]
    between: BoolArray = (size[places] > 0.0).all(axis=1)
    at = out[places[between]]
    along = np.einsum("mci,mij,mcj->mc", at, shapes(inverse_metrics(points, cells[between])), at)
    alike = np.ones(len(at), dtype=np.bool_)
    for a, b in combinations(range(d + 1), 2):
        alike &= (at[:, a] * at[:, b]).sum(axis=1) > SAME_SIDE
    between[between] = alike | ((d == 3) & (along > 0.0).all(axis=1))
    return between


def _alike(
    points: FloatArray, cells: IntArray, places: NDArray[np.int64], k: int, regular: FloatArray,
    stretch: Stretch, threads: int,
) -> NDArray[np.intp]:
    """Cells whose shape is near the mean around one of their vertices, if that is in a layer."""
    d = points.shape[1]
    bound = most_regular(stretch.ratio, d)
    total = _sums(places, None, k)
    active = 2 * _sums(places[regular < bound], None, k) >= np.maximum(total, 1)
    near = np.flatnonzero(active[places].any(axis=1))
    if not near.size:
        return near
    inverse = inverse_metrics(points, cells[near])
    at = np.flatnonzero(active)
    common = _means(places[near], inverse, at, k).reshape(-1, d, d)
    active[at] = d**d * determinant(np.moveaxis(common, 0, -1)) < 0.5 * (1.0 + bound)
    inner = active[places[near]].any(axis=1)
    if not inner.any():
        return near[inner]
    near, inverse = near[inner], inverse[inner]
    parts = spread(lambda part: shapes(inverse[part]), chunks(len(near)), threads)
    shape = np.concatenate(parts).reshape(-1, d * d)
    rows, at = places[near], np.flatnonzero(active)
    means = np.zeros((k, d * d))
    means[at] = _means(rows, shape, at, k)
    size = (means**2).sum(axis=1)
    off = _means(rows, (shape**2).sum(axis=1), at, k)[:, 0] - size[at]
    values, _ = eigen(means[at].reshape(-1, d, d))
    longest = np.ptp(values, axis=1) >= 2.0 * math.log(stretch.ratio)
    active[at] = longest & (off <= stretch.spread**2 * size[at])
    alike = np.zeros(len(near), dtype=np.bool_)
    for corner in rows.T:
        apart = ((shape - means[corner]) ** 2).sum(axis=1)
        alike |= active[corner] & (apart <= ALIKE**2 * size[corner])
    return near[alike]


def _sums(rows: NDArray[np.int64], values: FloatArray | None, k: int) -> FloatArray:
    """Sums of values (m,), or numbers, of the rows (m, c) that hold each of k places."""
    return np.asarray(sum(np.bincount(column, values, k) for column in rows.T), dtype=np.float64)


def _means(rows: NDArray[np.int64], values: FloatArray, at: NDArray[np.intp], k: int) -> FloatArray:
    """Means of values (m, ...) over the rows that hold the places `at`, (len(at), ...) flat."""
    flat = values.reshape(len(values), -1)
    sums = [_sums(rows, column, k)[at] for column in flat.T]
    return np.stack(sums, axis=1) / _sums(rows, None, k)[at, None]


def _clusters(cells: IntArray, n: int) -> NDArray[np.int32]:
    """Number of the part, connected through facets, that every cell belongs to."""
    width = cells.shape[1]
    key = row_keys(_facets(np.sort(cells, axis=1)).reshape(-1, width - 1), n)
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(np.diff(key[order]) == 0)
    return components(order[same] // width, order[same + 1] // width, len(cells))


def _facets(cells: NDArray[Any]) -> NDArray[Any]:
    """Facets (m, d + 1, d) of cells, number i opposite corner i."""
    return np.stack([np.delete(cells, i, axis=1) for i in range(cells.shape[1])], axis=1)


def _many(cells: IntArray, n: int) -> BoolArray:
    """Which cells hang together with many others."""
    if len(cells) < SEVERAL[cells.shape[1] - 1]:
        return np.zeros(len(cells), dtype=np.bool_)
    label = _clusters(cells, n)
    return np.asarray(np.bincount(label)[label] >= SEVERAL[cells.shape[1] - 1])
