"""Hard start meshes: clustered, stretched, thin, needle-like, sliver-ridden, cut up, far away."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from measure.meshes import kuhn_lattice
from odt_plugins.figures import volumes
from odt_plugins.generate.clouds import SEED
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.simplex import reverse

FLAT = 1e-9
"""Delaunay cells below this part of the mean volume are left out: rounding of flat ones."""

Rng = np.random.Generator
Cloud = Callable[[Rng, int, int], FloatArray]
Made = tuple[FloatArray, IntArray, IntArray | None]


@dataclass(frozen=True)
class HardMesh:
    """A start mesh with a name.

    Attributes
    ----------
    name : str
    points : (n, d) float64, cells : (m, d + 1) int32, positive
    regions : (m,) int32 or None
    """

    name: str
    points: FloatArray
    cells: IntArray
    regions: IntArray | None = None


def _ball(rng: Rng, d: int, n: int) -> FloatArray:
    x = rng.normal(size=(n, d))
    radius = rng.random(n) ** (1 / d)
    radius[: round(n ** ((d - 1) / d))] = 1.0
    scaled: FloatArray = x * (radius / np.linalg.norm(x, axis=1))[:, None]
    return scaled


def _clustered(rng: Rng, d: int, n: int) -> FloatArray:
    centers, part = rng.random((6, d)), n // 6
    return np.vstack([c + 10.0 ** rng.uniform(-4, -1) * rng.normal(size=(part, d))
                      for c in centers])


def _dense_spot(rng: Rng, d: int, n: int) -> FloatArray:
    return np.vstack([rng.random((n // 3, d)), 0.5 + 1e-3 * rng.random((n - n // 3, d))])


def _stretched(rng: Rng, d: int, n: int) -> FloatArray:
    return rng.normal(size=(n, d)) * 10.0 ** np.arange(d)


def _flattened(factor: float) -> Cloud:
    def cloud(rng: Rng, d: int, n: int) -> FloatArray:
        points = rng.random((n, d))
        points[:, -1] *= factor
        return points
    return cloud


def _needle(rng: Rng, d: int, n: int) -> FloatArray:
    points = rng.random((n, d))
    points[:, 1:] *= 0.02 * points[:, :1]
    return points


def _graded(rng: Rng, d: int, n: int) -> FloatArray:
    return rng.random((n, d)) ** 3


def _sheared(rng: Rng, d: int, n: int) -> FloatArray:
    points = rng.random((n, d))
    points[:, 0] += 5.0 * points[:, -1]
    return points


def _helix(rng: Rng, d: int, n: int) -> FloatArray:
    turn = 20.0 * np.sort(rng.random(n // 8))
    line = np.stack([np.cos(turn), np.sin(turn), 0.2 * turn], axis=1)[:, :d] * (0.1 * turn)[:, None]
    return np.vstack([line, rng.uniform(-2.5, 2.5, (n - n // 8, d))])


def _dust(rng: Rng, d: int, n: int) -> FloatArray:
    """Cantor dust: gaps of every size."""
    digits = 2.0 * rng.integers(0, 2, (n, d, 9))
    dust: FloatArray = (digits / 3.0 ** np.arange(1, 10)).sum(axis=2)
    return dust + 1e-6 * rng.random((n, d))


def _shells(rng: Rng, d: int, n: int) -> FloatArray:
    points = rng.normal(size=(n, d))
    points /= np.linalg.norm(points, axis=1)[:, None]
    return np.vstack([points[n // 4:], 0.5 * points[: n // 4]])


def _almost_lattice(rng: Rng, d: int, n: int) -> FloatArray:
    axis = np.arange(float(round(n ** (1 / d))))
    points = np.stack(np.meshgrid(*[axis] * d), axis=-1).reshape(-1, d)
    return points + 1e-3 * rng.uniform(-1, 1, points.shape)


CLOUDS: dict[str, Cloud] = {
    "ball": _ball, "clusters": _clustered, "dense spot": _dense_spot, "stretched": _stretched,
    "thin plate": _flattened(0.02), "very thin plate": _flattened(1e-4), "needles": _needle,
    "graded": _graded, "sheared": _sheared, "helix": _helix, "dust": _dust, "shells": _shells,
    "almost a lattice": _almost_lattice,
}
"""Points whose Delaunay mesh is taken, in the plane and in space: (generator, d, n) -> points."""


def delaunay(points: FloatArray) -> tuple[FloatArray, IntArray]:
    """Positive Delaunay cells of points; flat cells and points of none are left out."""
    from scipy.spatial import Delaunay

    cells = Delaunay(points).simplices
    size = volumes(points, cells)
    cells = reverse(cells, size < 0)[np.abs(size) > FLAT * np.abs(size).mean()]
    return _compact(points, cells)


def _compact(points: FloatArray, cells: NDArray[np.integer]) -> tuple[FloatArray, IntArray]:
    used, inverse = np.unique(cells, return_inverse=True)
    compact = np.ascontiguousarray(inverse.reshape(cells.shape), dtype=np.int32)
    return np.ascontiguousarray(points[used]), compact


def cut_out(points: FloatArray, cells: IntArray) -> tuple[FloatArray, IntArray]:
    """A ring, or a thick torus: of the cells around the origin those near a circle."""
    center = points[cells].mean(axis=1)
    around = np.sqrt((center[:, :2] ** 2).sum(axis=1)) - 0.6
    away = np.sqrt(around**2 + (center[:, 2:] ** 2).sum(axis=1))
    return _compact(points, cells[away < 0.3])


def pressed(points: FloatArray, cells: IntArray, rng: Rng, angle: float) -> FloatArray:
    """Press some inner vertices towards the opposite facet of one of their cells.

    Parameters
    ----------
    angle : float      what is left of their height, over it: about the sine of the least angle
    """
    points = points.copy()
    facets, count = np.unique(np.sort(np.concatenate(
        [np.delete(cells, k, axis=1) for k in range(cells.shape[1])]), axis=1),
        axis=0, return_counts=True)
    inside = np.ones(len(points), dtype=bool)
    inside[facets[count == 1]] = False
    stars: list[list[int]] = [[] for _ in points]
    for c, cell in enumerate(cells.tolist()):
        for v in cell:
            stars[v].append(c)
    for c in rng.permutation(len(cells))[: max(len(cells) // 30, 20)]:
        corner = cells[c][inside[cells[c]]]
        if not corner.size:
            continue
        v = corner[0]
        base = points[cells[c][cells[c] != v]].mean(axis=0)
        old = points[v].copy()
        points[v] = base + angle * (old - base)
        if volumes(points, cells[stars[v]]).min() <= 0.0:
            points[v] = old
    return points


def lattice(d: int, n: int) -> tuple[FloatArray, IntArray]:
    """Cubes cut into six tetrahedra, or squares cut into two triangles; about n vertices."""
    side = max(round(n ** (1 / d)) - 1, 3)
    if d == 3:
        return kuhn_lattice(side)
    axis = np.arange(side + 1)
    points = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    low = points[(points < side).all(axis=1)] @ [side + 1, 1]
    cells = np.concatenate([low[:, None] + step for step in ([0, side + 1, side + 2],
                                                             [0, side + 2, 1])])
    return points.astype(np.float64), np.ascontiguousarray(cells, dtype=np.int32)


def shaken(rng: Rng, d: int, n: int, reach: float = 0.2) -> tuple[FloatArray, IntArray]:
    """Lattice with its inner vertices moved at random."""
    points, cells = lattice(d, n)
    inside = ((points > 0) & (points < points.max())).all(axis=1)
    points[inside] += reach * rng.uniform(-1, 1, (int(inside.sum()), d))
    return points, cells


def layers(rng: Rng, d: int, n: int) -> tuple[FloatArray, IntArray]:
    """Shaken lattice squeezed towards one side, as in a boundary layer, 1000 times at the most."""
    points, cells = shaken(rng, d, n, 0.1)
    height = points[:, -1] / points.max()
    points[:, -1] = points.max() * (1000.0**height - 1.0) / 999.0
    return points, cells


def _labels(points: FloatArray, cells: IntArray, kind: str, rng: Rng) -> IntArray:
    center = points[cells].mean(axis=1)
    if kind == "random":
        return rng.integers(0, 3, len(cells)).astype(np.int32)
    span = np.ptp(points, axis=0)
    box = np.floor(4.0 * (center - points.min(axis=0)) / span).astype(np.int32)
    return np.asarray(box[:, 0] if kind == "slabs" else box.sum(axis=1) % 2, dtype=np.int32)


def hard_meshes(n: int, dims: tuple[int, ...] = (3, 2), seed: int = SEED) -> Iterator[HardMesh]:
    """Make all hard meshes, one after the other.

    Parameters
    ----------
    n : int       about so many vertices each
    dims : ints   3 for space, 2 for the plane
    seed : int
    """
    for d in dims:
        where = "space" if d == 3 else "plane"
        for name, cloud in CLOUDS.items():
            rng = np.random.default_rng(seed)
            yield HardMesh(f"{name}, {where}", *delaunay(cloud(rng, d, n)))
        rng = np.random.default_rng(seed)
        yield HardMesh(f"ring, {where}", *cut_out(*delaunay(_ball(rng, d, n))))
        points, cells = shaken(rng, d, n)
        for angle in (1e-2, 2e-4):
            flat = pressed(points, cells, np.random.default_rng(seed), angle)
            yield HardMesh(f"slivers of {np.degrees(angle):.2g} degrees, {where}", flat, cells)
        yield HardMesh(f"layers, {where}", *layers(rng, d, n))
        for kind in ("slabs", "checkerboard", "random"):
            yield HardMesh(f"regions, {kind}, {where}", points, cells,
                           _labels(points, cells, kind, rng))
        for scale in (1e-9, 1e9):
            yield HardMesh(f"lattice times {scale:g}, {where}", points * scale, cells)
        yield HardMesh(f"lattice shifted by 1e6, {where}", points + 1e6, cells)
