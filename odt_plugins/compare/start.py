"""Start meshes of a comparison: read from files, stored with the package, or made on the fly."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import InvalidOptionError, counted
from odt_plugins.figures import volumes
from odt_plugins.generate import clouds
from odt_plugins.generate.clouds import SEED
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.plane import PlaneFrame, plane_frame
from odt_plugins.mesh.simplex import compact_labels, mesh_arrays, reverse, simplex_mesh

Kind = Literal["tets", "planar", "surface"]

Named = TypeVar("Named", bound=Any)

STORED = {
    "bunny": "TetWild's mesh of the Stanford bunny",
    "bone": "TetWild's mesh of a bone",
    "cgal-bunny": "CGAL's Delaunay refinement of the bunny, not optimised",
    "bunny-surface": "surface of the bunny",
    "bone-surface": "surface of the bone",
}


@dataclass(frozen=True)
class StartMesh:
    """The mesh from which every contestant starts.

    Attributes
    ----------
    name : str
    kind : str                     "tets", "planar" or "surface"
    points : (n, d) float64        every vertex is used; d = 2 when planar
    cells : (m, k) int32           positive volumes; triangles of a surface as they came
    origin : str                   where it comes from, for the report
    regions : (m,) int32 or None   labels 0, 1, ...; None where all cells are of one region
    sha256 : str                   of the file, or of the arrays of a mesh made on the fly
    frame : PlaneFrame or None     of triangles in a plane in space
    """

    name: str
    kind: Kind
    points: FloatArray
    cells: IntArray
    origin: str = ""
    regions: IntArray | None = None
    sha256: str = ""
    frame: PlaneFrame | None = None

    @property
    def n_regions(self) -> int:
        """Number of regions."""
        return 1 if self.regions is None else int(self.regions.max()) + 1

    @property
    def about(self) -> str:
        """Where it comes from, and its size, in words."""
        size = [counted(len(self.points), "vertex", "vertices"), counted(len(self.cells), "cell")]
        size += [f"{self.n_regions} regions"] if self.regions is not None else []
        return ", ".join([*([self.origin] if self.origin else []), *size])


def make_start(
    name: str, points: FloatArray, cells: IntArray, origin: str = "",
    regions: NDArray[np.integer] | None = None,
) -> StartMesh:
    """Make a start mesh of arrays: check, orient and leave out unused vertices.

    Raises
    ------
    InvalidMeshError    the mesh is broken
    """
    p, t = mesh_arrays(points, cells)
    labels = compact_labels(regions, len(t))
    kind: Kind = "tets" if t.shape[1] == 4 else "planar"
    frame = None
    if p.shape[1] == 3 and t.shape[1] == 3:
        frame = plane_frame(p, t)
        if frame is None:
            kind = "surface"
        else:
            p = frame.to_plane(p)
    if kind != "surface":
        t = simplex_mesh(p, t)[0].cells
        negative = volumes(p, t) < 0
        t = reverse(t, negative) if negative.any() else t
    used, inverse = np.unique(t, return_inverse=True)
    compact = np.ascontiguousarray(inverse.reshape(t.shape), dtype=np.int32)
    p = np.ascontiguousarray(p[used])
    digest = hashlib.sha256(p.tobytes() + compact.tobytes()).hexdigest()
    return StartMesh(name, kind, p, compact, origin, labels if labels.any() else None, digest,
                     frame)


def read_start(path: Path) -> StartMesh:
    """Read a start mesh from a file of any format of meshio.

    Raises
    ------
    MeshFileError, InvalidMeshError, UnsupportedMeshError
    """
    from odt_plugins.adapters import files as mesh_files
    from odt_plugins.adapters.regions import AUTO
    host = mesh_files.read(path, AUTO)
    start = make_start(path.stem, host.points, host.cells, str(path), host.regions)
    return replace(start, sha256=hashlib.sha256(path.read_bytes()).hexdigest())


def stored(name: str) -> StartMesh:
    """Read one of the meshes stored with the package, by its name in STORED."""
    with as_file(files("odt_plugins.compare") / "data" / f"{name}.vtu") as path:
        return replace(read_start(path), name=name, origin=STORED[name])


def plain_name(name: str) -> str:
    """A name for files: what these should not have is a "-"."""
    return re.sub(r"[^\w.+-]+", "-", name).strip("-")


def distinct(named: Iterable[Named]) -> list[Named]:
    """The same meshes or results; a name that a file before has already has a number behind it."""
    out: dict[str, Named] = {}
    for one in named:
        name, count = one.name, 1
        while plain_name(name) in out:
            count += 1
            name = f"{one.name}-{count}"
        out[plain_name(name)] = replace(one, name=name)
    return list(out.values())


def reordered(start: StartMesh, seed: int) -> StartMesh:
    """The same mesh, its vertices and cells in random order."""
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(start.points))
    number = np.empty(len(order), dtype=np.int32)
    number[order] = np.arange(len(order))
    shuffled = rng.permutation(len(start.cells))
    regions = None if start.regions is None else start.regions[shuffled]
    return replace(start, points=start.points[order], cells=number[start.cells][shuffled],
                   regions=regions)


def suite(name: str) -> list[StartMesh]:
    """Give the start meshes of a suite.

    Parameters
    ----------
    name : str    "standard" (modest meshes of every kind), "large" (up to a million
                  tetrahedra) or "tiny" (for tests)

    Raises
    ------
    InvalidOptionError    no such suite
    """
    if name == "standard":
        return [stored("bunny"), stored("bone"), stored("cgal-bunny"), ball(2000),
                plate(4000), stored("bunny-surface"), stored("bone-surface")]
    if name == "large":
        bunny = stored("bunny")
        fine = replace(make_start("bunny-fine", *refine(bunny.points, bunny.cells)),
                       origin="the bunny, every tetrahedron cut into eight")
        return [fine, ball(165_000), plate(500_000)]
    if name == "tiny":
        return [ball(60), plate(60)]
    msg = f"got suite={name!r}; expected one of 'standard', 'large', 'tiny'"
    raise InvalidOptionError(msg)


def ball(n: int, seed: int = SEED) -> StartMesh:
    """Give :func:`odt_plugins.generate.clouds.ball` as a start mesh."""
    points, cells = clouds.ball(n, seed)
    return make_start(f"ball-{_short(len(cells))}", points, cells,
                      f"Delaunay mesh of {len(points)} seeded random points in a ball")


def pebble(n: int, seed: int = SEED) -> StartMesh:
    """Give :func:`odt_plugins.generate.clouds.pebble` as a start mesh."""
    points, cells = clouds.pebble(n, seed)
    return make_start(f"pebble-{_short(len(cells))}", points, cells,
                      f"{n} seeded random points on a smooth surface")


def plate(n: int, seed: int = SEED) -> StartMesh:
    """Give :func:`odt_plugins.generate.clouds.plate` as a start mesh."""
    points, cells = clouds.plate(n, seed)
    return make_start(f"plate-{_short(len(cells))}", points, cells,
                      "graded Delaunay mesh of seeded random points in a square with a hole")


def refine(points: FloatArray, cells: NDArray[np.integer]) -> tuple[FloatArray, IntArray]:
    """Cut every simplex at its edge midpoints: 4 triangles, or 8 tetrahedra.

    Parameters
    ----------
    points : (n, d) float64
    cells : (m, d + 1) int

    Returns
    -------
    points, cells         the midpoints follow the old vertices

    Notes
    -----
    The octahedron within a tetrahedron is cut along its shortest diagonal; a fixed one makes the
    shapes worse with every level.
    """
    k = cells.shape[1]
    local = [(i, j) for i in range(k) for j in range(i + 1, k)]
    pairs = np.sort(np.concatenate([cells[:, list(e)] for e in local]), axis=1)
    edges, inverse = np.unique(pairs, axis=0, return_inverse=True)
    middle = inverse.reshape(len(local), len(cells)) + len(points)
    new_points = np.concatenate([points, points[edges].mean(axis=1)])
    at = {e: middle[i] for i, e in enumerate(local)}
    corner = [[cells[:, i], *(at[min(i, j), max(i, j)] for j in range(k) if j != i)]
              for i in range(k)]
    children = [np.stack(c, axis=1) for c in corner]
    if k == 3:
        children.append(np.stack([at[0, 1], at[0, 2], at[1, 2]], axis=1))
    else:
        children += _octahedron(new_points, at)
    fine = np.concatenate(children).astype(np.int32)
    negative = volumes(new_points, fine) < 0
    return new_points, np.ascontiguousarray(reverse(fine, negative))


def _octahedron(
    points: FloatArray, at: dict[tuple[int, int], NDArray[np.integer]]
) -> list[NDArray[np.integer]]:
    """Four tetrahedra around the shortest of the three diagonals."""
    rings = (((0, 1), (2, 3), ((0, 2), (0, 3), (1, 3), (1, 2))),
             ((0, 2), (1, 3), ((0, 1), (0, 3), (2, 3), (1, 2))),
             ((0, 3), (1, 2), ((0, 1), (0, 2), (2, 3), (1, 3))))
    length = np.stack([((points[at[a]] - points[at[b]]) ** 2).sum(axis=1) for a, b, _ in rings])
    shortest = length.argmin(axis=0)
    out = []
    for which, (a, b, ring) in enumerate(rings):
        rows = shortest == which
        out += [np.stack([at[a], at[b], at[ring[i]], at[ring[(i + 1) % 4]]], axis=1)[rows]
                for i in range(4)]
    return out


def _short(m: int) -> str:
    return f"{m / 1e6:.1f}M" if m >= 1e6 else f"{round(m / 1000)}k" if m >= 1000 else str(m)
