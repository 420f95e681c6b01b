"""The one mesh type that the engine knows, and the checks a mesh passes on its way in."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from odt_plugins.errors import InvalidMeshError, InvalidOptionError, TangledMeshError, counted
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray, LongArray
from odt_plugins.mesh.chunks import chunks, spread
from odt_plugins.mesh.faces import Faces, no_faces
from odt_plugins.mesh.facets import UnevenFacets, directed_facets, row_keys, uneven_facets
from odt_plugins.mesh.numbers import vertex_mask

FLAT = 1e-14
"""A cell is flat when d! |volume| <= FLAT * (its extent)^d: the rounding error of that volume."""

SPAN_LIMIT = 1e40
"""Meshes must be between 1 / SPAN_LIMIT and SPAN_LIMIT long, and no cell smaller than the largest
by more: squared volumes neither overflow nor vanish then."""


class Smooth(NamedTuple):
    """The geometry that a surface was made of.

    Attributes
    ----------
    sag : float        how far the surface is from it
    put : callable     points of a mesh that it has become, those that are on it there
    """

    sag: float
    put: Callable[[Any], FloatArray]


@dataclass(frozen=True)
class SimplexMesh:
    """A valid mesh of triangles in the plane, tetrahedra in space, or triangles in space.

    The last kind, a curved surface, comes from :func:`odt_plugins.mesh.surface.surface_mesh`:
    its areas have no sign and may be zero.

    Attributes
    ----------
    points : (n, d) float64, C-contiguous    coordinates in the caller's unit, d = 2 or 3
    cells : (m, d + 1) int32, C-contiguous   vertex indices, signed volume positive
    regions : (m,) int32                     label of every cell; facets between two labels stay
    fixed : (n,) bool                        vertices that must not move (boundary not included)
    frozen : (m,) bool                       cells that must stay as they are; none by default
    stays : (k, 2) int32                     edges of the boundary that must stay edges
    lines : (l, 2) int32                     edges that count as feature edges
    anchored : (n,) bool                     vertices that may move but must not be removed, since
                                             something refers to them; none by default
    coupled : (n,) bool                      those of the fixed vertices that are so since they lie
                                             on periodic faces; none by default
    turned : int                             cells of mixed orientation that were turned on the way
                                             in
    valid_before : (points, cells) or None   of a mesh that was untangled, the valid cells it had: a
                                             figure may be as bad as with these, too
    ground : SimplexMesh or None             of a mesh whose surface has slid before, the surface
                                             that it slides on, with its feature lines; of a curved
                                             surface with the metric at its vertices
    body : (l,) int32                        body of every region; facets between regions of one
                                             body stay too, but their vertices may move. Empty where
                                             every region is a body
    faces : (Faces, Faces)                   lines and triangles on the boundary and on interfaces
                                             that may become others of their labels
    metric : (n, d (d + 1) / 2) float64      upper triangle, row by row, of log(M) / 2, M the
                                             metric at every vertex; (n, 6) on a surface; no rows
                                             where lengths are those of the coordinates
    smooth : Smooth or None                  the geometry on which vertices of the surface stay
    """

    points: FloatArray
    cells: IntArray
    regions: IntArray
    fixed: BoolArray
    frozen: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    stays: IntArray = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int32))
    lines: IntArray = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int32))
    anchored: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    coupled: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    turned: int = 0
    valid_before: tuple[FloatArray, IntArray] | None = None
    ground: SimplexMesh | None = None
    body: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int32))
    faces: tuple[Faces, Faces] = field(default_factory=no_faces)
    metric: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    smooth: Smooth | None = None

    def __post_init__(self) -> None:
        for name in ("anchored", "coupled"):
            if getattr(self, name).size != len(self.points):
                object.__setattr__(self, name, np.zeros(len(self.points), dtype=np.bool_))
        if self.frozen.size != len(self.cells):
            object.__setattr__(self, "frozen", np.zeros(len(self.cells), dtype=np.bool_))

    @property
    def dim(self) -> int:
        """Dimension d of the cells."""
        return int(self.cells.shape[1]) - 1

    @property
    def sag(self) -> float:
        """How far the surface is from the geometry that it was made of, 0 without one."""
        return 0.0 if self.smooth is None else self.smooth.sag

    @property
    def is_surface(self) -> bool:
        """Whether these are triangles in space."""
        return bool(self.points.shape[1] > self.dim)

    def bodies(self, regions: IntArray | None = None) -> IntArray:
        """Body of every cell, or of given regions (k,)."""
        regions = self.regions if regions is None else regions
        return self.body[regions] if self.body.size else regions

    @cached_property
    def uneven(self) -> UnevenFacets:
        """Facets that do not have just one cell on each side."""
        return uneven_facets(self.cells, len(self.points))

    @cached_property
    def used(self) -> LongArray:
        """Vertices (k,) that have a cell, increasing."""
        return vertices_of(self.cells)

    @cached_property
    def extent(self) -> float:
        """Length of the diagonal of the box around the vertices that have a cell."""
        return diagonal(self.points[self.used])


def simplex_mesh(
    points: ArrayLike,
    cells: ArrayLike,
    *,
    regions: ArrayLike | None = None,
    fixed: ArrayLike | None = None,
    selection: ArrayLike | None = None,
    threads: int = 1,
) -> tuple[SimplexMesh, int]:
    """Check a mesh and bring it into the form the engine works on; the input is not changed.

    Cells of mixed orientation are turned where the mesh then fits together.

    Parameters
    ----------
    points : (n, d) float32 or float64    d = 2 or 3, any unit
    cells : (m, d + 1) int                triangles in the plane or tetrahedra in space; floats
                                          that hold integers are taken too
    regions : (m,) int                    labels of any integer type, compacted to 0, 1, ...
                                          in increasing order
    fixed : (n,) bool or (k,) int         vertices that must not move
    selection : (m,) bool or (k,) int     only these cells may change; the others are frozen
    threads : int                         how many share the work

    Returns
    -------
    mesh : SimplexMesh                    every signed volume positive
    orientation : int                     -1 when every cell came with negative volume, else 1

    Raises
    ------
    InvalidMeshError                      wrong shapes, types, indices, coordinates; repeated
                                          cells; more than two cells on a facet. Unused
                                          vertices are allowed and so are boundary edges shared
                                          by several boundary facets
    TangledMeshError                      flat or overlapping cells
    InvalidOptionError                    `regions`, `fixed` or `selection` does not fit the mesh
    """
    p, t = mesh_arrays(points, cells)
    if t.shape[1] != p.shape[1] + 1:
        msg = f"got triangles with points of dimension {p.shape[1]}; expected points (n, 2)"
        raise InvalidMeshError(msg)
    check_vertices(t)
    sign, size = cell_signs(p, t, threads)
    _check_sizes(sign, size, p.shape[1])
    orientation = -1 if (sign < 0).all() else 1
    mesh = SimplexMesh(
        points=p,
        cells=reverse(t, sign < 0),
        regions=compact_labels(regions, len(t)),
        fixed=vertex_mask(fixed, len(p), "fixed", "vertices"),
        turned=int((sign < 0).sum()) if orientation == 1 else 0,
    )
    vars(mesh)["uneven"] = uneven_facets(mesh.cells, len(p), threads)
    if len(mesh.uneven.crowded):
        refuse_overlaps(mesh, sign)
    if selection is not None:
        mesh = freeze(mesh, ~vertex_mask(selection, len(t), "selection", "cells"))
    return mesh, orientation


def turned_alike(points: FloatArray, cells: IntArray) -> tuple[IntArray, int]:
    """Turn cells of mixed orientation as :func:`simplex_mesh` does; nothing is refused.

    Returns
    -------
    cells : (m, d + 1) int32    of positive volume but for flat ones, where those fit together;
                                otherwise as they were, all turned where most volumes are negative
    turned : int                how many were turned against the others
    """
    sign, _ = cell_signs(points, cells)
    negative = sign < 0
    if negative.any() and (sign > 0).any():
        alike = reverse(cells, negative)
        if not len(uneven_facets(alike[sign != 0], len(points)).crowded):
            return alike, int(negative.sum())
    return reverse(cells, np.full(len(cells), 2 * negative.sum() > len(cells))), 0


def mesh_arrays(points: ArrayLike, cells: ArrayLike) -> tuple[FloatArray, IntArray]:
    """Check shapes, types, coordinates and indices alone; new float64 and int32 arrays.

    Triangles may have points in space here, and all used vertices may lie at one place.

    Raises
    ------
    InvalidMeshError    the arrays are no mesh, whatever the shape of its cells
    """
    p = _points(points)
    t = _cells(cells, p.shape)
    _check_span(p, t)
    return p, t


def freeze(
    mesh: SimplexMesh, frozen: BoolArray, vertices: NDArray[np.integer] | None = None,
    stays: NDArray[np.integer] | None = None,
) -> SimplexMesh:
    """Add cells (m,) bool that must stay, with their vertices, and more vertices (k,) to fix.

    Edges (l, 2) of the boundary that must stay edges are added, too.
    """
    fixed = mesh.fixed.copy()
    fixed[mesh.cells[frozen].ravel()] = True
    if vertices is not None:
        fixed[vertices] = True
    edges = mesh.stays if stays is None else np.concatenate([mesh.stays, stays.astype(np.int32)])
    return with_same_cells(mesh, fixed=fixed, frozen=mesh.frozen | frozen, stays=edges)


def with_same_cells(mesh: SimplexMesh, **changes: Any) -> SimplexMesh:
    """The mesh with other values of some fields, and with what is known of its cells."""
    other = replace(mesh, **changes)
    vars(other).update((name, value) for name, value in vars(mesh).items() if name == "uneven")
    return other


def with_vertices(mesh: SimplexMesh, points: FloatArray) -> SimplexMesh:
    """Move the vertices of a mesh; vertices beyond the old number are added as free ones."""
    more = (0, len(points) - len(mesh.points))
    return replace(mesh, points=points, fixed=np.pad(mesh.fixed, more),
                   anchored=np.pad(mesh.anchored, more), coupled=np.pad(mesh.coupled, more))


def reverse(cells: NDArray[Any], which: BoolArray) -> NDArray[Any]:
    """Turn the orientation of some cells: a copy with their last two vertices exchanged."""
    out = cells.copy()
    out[which, -2], out[which, -1] = cells[which, -1], cells[which, -2]
    return out


def corner_mean(values: FloatArray, cells: IntArray, threads: int = 1) -> FloatArray:
    """Mean of values (n,) or (n, c) at the vertices of every cell, shape (m,) or (m, c)."""
    mean: FloatArray = np.empty((len(cells), *values.shape[1:]))

    def fill(part: slice) -> None:
        first, *others = cells[part].T
        total = values.take(first, axis=0)
        for corner in others:
            total += values.take(corner, axis=0)
        np.divide(total, cells.shape[1], out=mean[part])

    spread(fill, chunks(len(cells)), threads)
    return mean


def determinant(rows: FloatArray | Sequence[FloatArray] | Sequence[Sequence[float]]) -> FloatArray:
    """Determinants of matrices 2 x 2 or 3 x 3, row by row: (d, d, ...) gives (...)."""
    if len(rows) == 2:
        (a, b), (c, d) = rows
        return np.asarray(a * d - b * c)
    (ax, ay, az), (bx, by, bz), (cx, cy, cz) = rows
    return np.asarray(
        ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
    )


def barycentric(corners: FloatArray, x: FloatArray) -> FloatArray:
    """Barycentric coordinates of points in simplices by Cramer's rule, -inf in flat cells."""
    edges = np.moveaxis(corners[..., 1:, :] - corners[..., :1, :], (-2, -1), (0, 1))
    offset = np.moveaxis(x - corners[..., 0, :], -1, 0)
    volume = determinant(edges)
    with np.errstate(divide="ignore", invalid="ignore"):
        inner = np.stack([determinant([*edges[:i], offset, *edges[i + 1:]]) / volume
                          for i in range(len(edges))], axis=-1)
        found = np.concatenate([1.0 - inner.sum(axis=-1, keepdims=True), inner], axis=-1)
    found[volume == 0.0] = -np.inf
    return found


def vertices_of(cells: NDArray[np.integer]) -> LongArray:
    """Vertices (k,) that cells, or facets, (m, j) have, increasing."""
    named = cells.astype(np.intp)
    used = np.zeros(int(named.max(initial=-1)) + 1, dtype=np.bool_)
    used[named] = True
    return np.flatnonzero(used)


def diagonal(points: FloatArray) -> float:
    """Length of the diagonal of the bounding box of points (n, d)."""
    return math.dist(points.min(axis=0), points.max(axis=0))


def _points(points: ArrayLike) -> FloatArray:
    raw = np.asarray(points)
    if raw.dtype.kind != "f" or raw.dtype.itemsize not in (4, 8):
        msg = (f"points have dtype {raw.dtype}; expected float64 or float32, "
               f"try numpy.asarray(points, dtype=float)")
        raise InvalidMeshError(msg)
    if raw.ndim != 2 or raw.shape[1] not in (2, 3):
        msg = f"points have shape {raw.shape}; expected (n, 2) or (n, 3), one row per vertex"
        raise InvalidMeshError(msg)
    if len(raw) >= 1 << 31:
        msg = f"the mesh has {len(raw)} vertices; expected fewer than 2^31, try cutting it up"
        raise InvalidMeshError(msg)
    finite = np.isfinite(raw)
    if not finite.all():
        bad = np.flatnonzero(~finite.all(axis=1))
        msg = (f"got {_where(bad, 'point')} with NaN or infinite coordinates; expected finite "
               f"numbers, try removing or repairing those vertices")
        raise InvalidMeshError(msg)
    return np.array(raw, dtype=np.float64, order="C")


def _cells(cells: ArrayLike, shape: tuple[int, ...]) -> IntArray:
    n, d = shape
    raw = np.asarray(cells)
    if raw.size == 0:
        msg = f"the mesh has no cells ({n} vertices); expected at least one triangle or tetrahedron"
        raise InvalidMeshError(msg)
    if raw.ndim != 2 or not 3 <= raw.shape[1] <= d + 1:
        tetrahedra = " or (m, 4) for tetrahedra" if d == 3 else ""
        msg = (f"cells have shape {raw.shape} for points of dimension {d}; expected (m, 3) for "
               f"triangles{tetrahedra}, one row of vertex indices per cell")
        raise InvalidMeshError(msg)
    if raw.dtype.kind == "f":
        bad = np.flatnonzero((raw != np.floor(raw)).any(axis=1) | ~np.isfinite(raw).all(axis=1))
        if bad.size:
            msg = (f"got {_where(bad, 'cell')} with vertex indices that are not integers (dtype "
                   f"{raw.dtype}); expected an integer type")
            raise InvalidMeshError(msg)
    elif raw.dtype.kind not in "iu":
        msg = f"cells have dtype {raw.dtype}; expected an integer type, try cells.astype('int32')"
        raise InvalidMeshError(msg)
    if raw.min() < 0 or raw.max() >= n:
        outside = (raw < 0) | (raw >= n)
        bad = np.flatnonzero(outside.any(axis=1))
        vertex = int(raw[bad[0]][outside[bad[0]]][0])
        msg = (f"got {_where(bad, 'cell')} with vertex indices out of range (vertex {vertex}); "
               f"expected 0 to {n - 1} for {n} vertices, counted from zero")
        raise InvalidMeshError(msg)
    return np.array(raw, dtype=np.int32, order="C")


def check_vertices(t: IntArray) -> None:
    """Refuse cells with a vertex twice."""
    same = np.zeros(len(t), dtype=np.bool_)
    for i, j in combinations(range(t.shape[1]), 2):
        same |= t[:, i] == t[:, j]
    bad = np.flatnonzero(same)
    if bad.size:
        msg = (f"got {_where(bad, 'cell')} with a vertex used twice; expected {t.shape[1]} "
               "different vertices, try removing such cells")
        raise InvalidMeshError(msg)


def _check_span(p: FloatArray, t: IntArray) -> None:
    used = np.zeros(len(p), dtype=np.bool_)
    used[t.ravel()] = True
    half = 0.5 * p[used]  # the difference of two finite numbers may be none
    span = float(np.ptp(half, axis=0).max())
    if span != 0.0 and not 0.5 / SPAN_LIMIT < span < 0.5 * SPAN_LIMIT:
        msg = (f"the mesh is {2.0 * span:.1e} long; expected between {1 / SPAN_LIMIT:.0e} and "
               f"{SPAN_LIMIT:.0e}, try scaling it")
        raise InvalidMeshError(msg)


def cell_signs(p: FloatArray, t: IntArray, threads: int = 1) -> tuple[NDArray[np.int8], FloatArray]:
    """Sign of every signed volume, (m,) int8, 0 where it is flat, and the extents of the cells.

    A sign other than 0 is exact: FLAT is above the bounds of the rounding error, (3 + 16 u) u and
    (7 + 56 u) u with u = 2^-53, times at most d! extent^d.

    References
    ----------
    J. R. Shewchuk, Adaptive precision floating-point arithmetic and fast robust geometric
    predicates, Discrete Comput. Geom. 18 (1997) 305-363, Sections 4.3 and 4.4.
    """
    sign = np.zeros(len(t), dtype=np.int8)
    size = np.empty(len(t))
    axes = np.ascontiguousarray(p.T)

    def measure(part: slice) -> None:
        corner = axes.take(t[part].T, axis=1)
        size[part] = (corner.max(axis=1) - corner.min(axis=1)).max(axis=0)
        det = determinant((corner[:, 1:] - corner[:, :1]).swapaxes(0, 1))
        sign[part] = np.sign(det) * (np.abs(det) > FLAT * math.prod([size[part]] * p.shape[1]))

    spread(measure, chunks(len(t)), threads)
    return sign, size


def _check_sizes(sign: NDArray[np.int8], size: FloatArray, d: int) -> None:
    """Refuse flat cells, and cells that are too small beside the largest."""
    small = np.flatnonzero((size > 0.0) & (size < size.max() / SPAN_LIMIT))
    if small.size:
        msg = (f"got {_where(small, 'cell')} of {len(sign)} smaller than {1 / SPAN_LIMIT:.0e} of "
               "the largest; expected sizes closer together, try removing such cells")
        raise InvalidMeshError(msg)
    bad = np.flatnonzero(sign == 0)
    if bad.size:
        name = "area" if d == 2 else "volume"
        msg = (f"got {_where(bad, 'cell')} of {len(sign)} with zero {name} relative to their size; "
               f"expected every {name} different from zero, try removing such cells")
        raise TangledMeshError(msg, bad)


def refuse_repeated(t: IntArray, n: int) -> None:
    """Refuse cells, of n vertices, with the same vertices as an earlier one."""
    _, first, inverse = np.unique(
        row_keys(np.sort(t, axis=1), n), return_index=True, return_inverse=True)
    repeated = np.flatnonzero(first[inverse] != np.arange(len(t)))
    if repeated.size:
        msg = (f"got {_where(repeated, 'cell')} with the same vertices as an earlier cell (cell "
               f"{first[inverse[repeated[0]]]}); expected each cell once, try removing repeated "
               "cells")
        raise InvalidMeshError(msg)


def refuse_overlaps(mesh: SimplexMesh, sign: NDArray[np.int8]) -> None:
    """Say where two cells are on the same side of a facet; three on one always hold such a pair.

    ``sign`` (m,) are the signs of the volumes with which the cells came.
    """
    t, n = mesh.cells, len(mesh.points)
    refuse_repeated(t, n)
    key, side = directed_facets(t, n)
    noun = "edge" if t.shape[1] == 3 else "face"
    _, inverse, count = np.unique(key, return_inverse=True, return_counts=True)
    crowded = np.flatnonzero((count[inverse] > 2).reshape(key.shape).any(axis=1))
    if crowded.size:
        column = int(np.flatnonzero(count[inverse].reshape(key.shape)[crowded[0]] > 2)[0])
        vertices = np.delete(np.sort(t[crowded[0]]), column).tolist()
        n_crowded = int((count > 2).sum())
        verb = "belongs" if n_crowded == 1 else "belong"
        msg = (f"{counted(n_crowded, noun)} {verb} to more than two cells (non-manifold), the "
               f"first of cell {crowded[0]} with vertices {vertices}; expected at most two, try "
               "removing the cells that overlap")
        raise InvalidMeshError(msg)
    _, inverse, count = np.unique(key * 2 + side, return_inverse=True, return_counts=True)
    bad = np.flatnonzero((count[inverse] > 1).reshape(key.shape).any(axis=1))
    turned = ""
    if mesh.turned:
        odd = np.flatnonzero(sign == (-1 if 2 * mesh.turned <= len(t) else 1))
        name = "area" if t.shape[1] == 3 else "volume"
        turned = (f", also after turning {_where(odd, 'cell')} of {len(t)} like the others "
                  f"(negative against positive {name})")
    msg = (f"got {_where(bad, 'cell')} overlapping a neighbour{turned}: both lie on the same side "
           f"of a common {noun}; expected one on each side, try removing or untangling those cells")
    raise TangledMeshError(msg, bad)


def compact_labels(regions: ArrayLike | None, m: int) -> IntArray:
    """Number labels (m,) or (m, 1), whole numbers or texts, from 0 on in increasing order."""
    if regions is None:
        return np.zeros(m, dtype=np.int32)
    raw = np.asarray(regions)
    raw = raw[:, 0] if raw.shape == (m, 1) else raw
    if raw.shape != (m,):
        msg = f"regions have shape {raw.shape}; expected ({m},), one label per cell"
        raise InvalidOptionError(msg)
    if raw.dtype.kind == "O" and all(isinstance(label, str) for label in raw.tolist()):
        raw = raw.astype(str)
    if raw.dtype.kind not in "iubU" and not (
        raw.dtype.kind == "f" and np.isfinite(raw).all() and (raw == np.floor(raw)).all()
    ):
        gaps = raw.dtype.kind == "f" and bool(np.isnan(raw).any())
        better = "numpy.nan_to_num(regions, nan=-1)" if gaps else "regions"
        msg = (f"regions have dtype {raw.dtype}{' and NaN' * gaps}; expected whole numbers or "
               f"texts, try {better}.astype(int)")
        raise InvalidOptionError(msg)
    return np.unique(raw, return_inverse=True)[1].astype(np.int32)


def _where(indices: NDArray[np.integer], noun: str) -> str:
    """Say how many there are and which is the first: "3 cells (first: cell 7)"."""
    return f"{counted(len(indices), noun)} (first: {noun} {indices[0]})"
