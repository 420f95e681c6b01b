"""Boundary and interfaces of a mesh, and how far they are from those of another one."""

from __future__ import annotations

from math import inf
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.compare.start import StartMesh
from odt_plugins.errors import MissingDependencyError
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.promise.locked_facets import locked_facets

ROUNDING = 1e-12
"""Distance, as a fraction of the diagonal, up to which a boundary counts as kept to rounding."""


class BoundaryChange(NamedTuple):
    """What became of the boundary and the interfaces; of all triangles, for a surface.

    Attributes
    ----------
    verdict : str                       "identical" (the same facets, bit for bit), "same place"
                                        (other facets, or to rounding) or "moved"
    outward : float or None             largest distance from the result to the start ...
    inward : float or None              ... and back, as fractions of the diagonal of the start
    """

    verdict: str
    outward: float | None
    inward: float | None

    @property
    def reach(self) -> float:
        """The larger of both distances, infinite where no boundary is left."""
        if self.outward is None or self.inward is None:
            return inf
        return max(self.outward, self.inward)


class Patches(NamedTuple):
    """Facets that must stay, each once: those on the boundary and between two regions.

    Attributes
    ----------
    facets : (k, d) int32        outward from the region `inside`
    inside : (k,) int32          label of the cell on the one side ...
    outside : (k,) int32         ... and on the other, -1 on the boundary
    """

    facets: IntArray
    inside: IntArray
    outside: IntArray


def labels_of(mesh: StartMesh) -> IntArray:
    """Labels (m,) of the cells, all 0 where a mesh has no regions."""
    return np.zeros(len(mesh.cells), np.int32) if mesh.regions is None else mesh.regions


def patches(mesh: StartMesh) -> Patches:
    """Give the boundary and the interfaces of a mesh, for tools that want to be told of them."""
    found = locked_facets(mesh.cells, labels_of(mesh), len(mesh.points))
    rim = found.boundary
    # Both sides of an interface facet follow each other.
    inner, labels = found.facets[~rim][::2], found.labels[~rim]
    facets = np.concatenate([found.facets[rim], inner])
    inside = np.concatenate([found.labels[rim], labels[::2]])
    outside = np.concatenate([np.full(rim.sum(), -1), labels[1::2]])
    return Patches(facets.astype(np.int32), inside.astype(np.int32), outside.astype(np.int32))


def held_vertices(mesh: StartMesh) -> BoolArray:
    """Mark (n,) the vertices on boundary and interfaces; of a surface, on interfaces only."""
    held = np.zeros(len(mesh.points), dtype=np.bool_)
    if mesh.kind != "surface":
        held[patches(mesh).facets] = True
        return held
    labels, lowest = labels_of(mesh), np.full(len(mesh.points), np.iinfo(np.int32).max)
    np.minimum.at(lowest, mesh.cells, labels[:, None])
    held[mesh.cells[lowest[mesh.cells] < labels[:, None]]] = True
    return held


def hull_facets(mesh: StartMesh) -> NDArray[Any]:
    """Boundary triangles of tetrahedra, boundary edges of triangles, outward."""
    labels = np.zeros(len(mesh.cells), dtype=np.int32)
    return locked_facets(mesh.cells, labels, len(mesh.points)).facets


def shell(mesh: StartMesh) -> NDArray[Any]:
    """What must keep its place: hull and interfaces, or every triangle of a surface."""
    return mesh.cells if mesh.kind == "surface" else patches(mesh).facets


def compare_boundaries(before: StartMesh, after: StartMesh) -> BoundaryChange:
    """Compare boundaries by their coordinates, whatever the numbering.

    Raises
    ------
    MissingDependencyError    pyvista is not installed and the boundaries are not identical

    Notes
    -----
    The distance is taken from vertices, edge midpoints and barycentres of the one to the facets
    of the other.
    """
    old, new = shell(before), shell(after)
    a, b = _signature(before.points, old), _signature(after.points, new)
    if a.shape == b.shape and np.array_equal(a, b):
        return BoundaryChange("identical", 0.0, 0.0)
    if not len(new):
        return BoundaryChange("moved", None, None)
    used = before.points[np.unique(old)]
    diagonal = float(np.linalg.norm(used.max(axis=0) - used.min(axis=0)))
    outward = _reach(after.points, new, before.points, old) / diagonal
    inward = _reach(before.points, old, after.points, new) / diagonal
    kept = max(outward, inward) <= ROUNDING
    return BoundaryChange("same place" if kept else "moved", outward, inward)


def _signature(points: FloatArray, facets: NDArray[Any]) -> NDArray[Any]:
    """Facets as sorted rows of the bits of their sorted corners."""
    order = np.lexsort(points.T[::-1])
    rank = np.empty(len(points), dtype=np.int64)
    rank[order] = np.arange(len(points))
    corners = np.sort(rank[facets], axis=1)
    width = facets.shape[1] * points.shape[1]
    x = np.ascontiguousarray(points[order][corners].reshape(len(facets), width) + 0.0)
    bits = x.view(np.int64)
    return np.asarray(bits[np.lexsort(bits.T)])


def _reach(
    points: FloatArray, facets: NDArray[Any], target: FloatArray, others: NDArray[Any]
) -> float:
    """Largest distance of samples of some facets to others."""
    corner = points[facets]
    samples = [points[np.unique(facets)], corner.mean(axis=1)]
    if facets.shape[1] == 3:
        samples += [0.5 * (corner[:, i] + corner[:, j]) for i, j in ((0, 1), (1, 2), (0, 2))]
    x = np.concatenate(samples)
    if facets.shape[1] == 2:
        return float(_to_segments(x, target[others]).max())
    return float(_to_triangles(x, target, others).max())


def _to_segments(x: FloatArray, segments: FloatArray) -> FloatArray:
    """Distance of points (n, 2) to the nearest of segments (s, 2, 2)."""
    a, edge = segments[:, 0], segments[:, 1] - segments[:, 0]
    length = np.maximum((edge**2).sum(axis=1), np.finfo(float).tiny)
    out = np.empty(len(x))
    for start in range(0, len(x), 256):
        offset = x[start:start + 256, None] - a
        share = np.clip((offset * edge).sum(axis=2) / length, 0.0, 1.0)
        away = offset - share[..., None] * edge
        out[start:start + 256] = np.sqrt((away**2).sum(axis=2).min(axis=1))
    return out


def _to_triangles(x: FloatArray, points: FloatArray, triangles: NDArray[Any]) -> FloatArray:
    """Distance of points (n, 3) to the nearest triangle, by VTK's cell locator."""
    try:
        import pyvista
    except ImportError as exc:
        msg = ("measuring how far a surface moved needs pyvista, not installed here; try "
               'pip install "odt-plugins[compare]"')
        raise MissingDependencyError(msg) from exc
    rows = np.column_stack([np.full(len(triangles), 3), triangles])
    surface: Any = pyvista.PolyData(np.ascontiguousarray(points), rows.ravel())
    _, nearest = surface.find_closest_cell(x, return_closest_point=True)
    return np.asarray(np.linalg.norm(x - nearest, axis=1))
