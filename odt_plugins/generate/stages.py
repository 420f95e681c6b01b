"""The stages of odtmesh2d: settle, relax, refine, repair. Vertices in pfix come first and stay."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from odt_plugins.engine.cells.elementary import power
from odt_plugins.engine.cells.geometry import boundary_vertices, signed_volumes
from odt_plugins.engine.finish.phases import Phase
from odt_plugins.engine.finish.plane import finish2d
from odt_plugins.engine.moves.flips2d import lawson_flips
from odt_plugins.engine.odt.global_step import global_step
from odt_plugins.engine.odt.sweeps import gauss_seidel_sweep
from odt_plugins.engine.odt.total_energy import total_energy
from odt_plugins.engine.topology.adjacency import cell_neighbors
from odt_plugins.engine.topology.order import curve_order
from odt_plugins.engine.topology.star import vertex_stars
from odt_plugins.engine.topology.stencil import make_topology
from odt_plugins.engine.topology.triangles import Triangles
from odt_plugins.errors import place_within
from odt_plugins.figures import radius_ratio
from odt_plugins.generate.domain import Domain
from odt_plugins.generate.refine2d import refine_triangles
from odt_plugins.generate.rim import Rim, make_rim, move_rim, respaced, spaced
from odt_plugins.generate.truss import edges_of, triangulate
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray

EXPONENT = 3.0
"""r in rho = h^-r. In the plane 3 gives more even meshes than 2 and better shapes than d + 2 = 4,
and it is what the paper's tables are made with."""

SQUASHED = 0.35
"""Inner points nearer to the boundary than this part of their size are taken out."""

UNCOVERED = 0.6
"""A point of the domain deeper than this part of its size belongs into a triangle."""

ASTRAY = 0.1
"""An inner edge whose middle is outside by this part of its length passes over a hole."""

BULGE = 0.35
"""A boundary edge whose middle is off the boundary by this part of its length is too coarse."""

BAD = 0.8
"""Radius ratio below which triangles are repaired."""

REPAIR = (8.0, 10, 2)
"""Power, rounds and sweeps of the repair, see ``Phase``."""

REPEATS = 3
SLIDES = (0.2, 0.1, 0.05, 0.02)
"""How often the repair is repeated, and the parts of an edge that boundary vertices then slide."""


class TooCoarseError(Exception):
    """The mesh does not resolve the domain; the message says where."""


@dataclass
class Mesh:
    """A mesh under construction.

    Attributes
    ----------
    points : (n, 2) float64
    cells : (m, 3) int32      positive
    fixed : int               the first so many vertices stay
    """

    points: FloatArray
    cells: IntArray
    fixed: int

    def held(self) -> BoolArray:
        """Vertices that stay, (n,)."""
        mask = np.zeros(len(self.points), dtype=np.bool_)
        mask[: self.fixed] = True
        return mask

    def rim(self) -> Rim:
        """Boundary in chains.

        Raises
        ------
        TooCoarseError    two parts of the domain touch in a vertex
        """
        rim = make_rim(self.cells, self.held())
        if rim is None:
            msg = "parts of the mesh touch in a single vertex"
            raise TooCoarseError(msg)
        return rim


def settle(points: FloatArray, domain: Domain, fixed: int, scale: float) -> Mesh:
    """Make a mesh of smoothed points: its boundary on fd = 0, no triangle squashed against it.

    Parameters
    ----------
    points : (n, 2) float64
    domain : Domain
    fixed : int              the first so many points stay
    scale : float            wanted edge length over fh

    Raises
    ------
    TooCoarseError           a fixed point is in no triangle
    """
    points = points.copy()
    for _ in range(6):
        cells = triangulate(points, domain, scale)
        rim = np.flatnonzero(boundary_vertices(cells, len(points)))
        rim = rim[rim >= fixed]
        points[rim] = domain.project(points[rim])
        cells = triangulate(points, domain, scale)
        keep = np.zeros(len(points), dtype=np.bool_)
        keep[cells] = True
        inner = keep & ~boundary_vertices(cells, len(points))
        depth = -domain.distance(points[inner])
        keep[inner] = depth > SQUASHED * scale * domain.size(points[inner])
        keep[:fixed] = True
        if keep.all():
            break
        points = points[keep]
    cells = triangulate(points, domain, scale)
    missing = np.setdiff1d(np.arange(fixed), cells)
    if missing.size:
        x, y = points[missing[0]]
        msg = f"no triangle has the fixed point ({x:.6g}, {y:.6g})"
        raise TooCoarseError(msg)
    used, number = np.unique(cells, return_inverse=True)
    return Mesh(points[used], np.asarray(number, dtype=np.int32).reshape(-1, 3), fixed)


def evened(mesh: Mesh, domain: Domain, scale: float) -> tuple[FloatArray, int]:
    """Points for another truss: boundary vertices as far apart as the inner ones, which follow.

    Returns
    -------
    points : (n', 2) float64    fixed ones, those of the boundary, the others
    held : int                  how many of them are to stay
    """
    rim = mesh.rim()
    outer = np.zeros(len(mesh.points), dtype=np.bool_)
    outer[rim.vertices] = True
    bars = edges_of(mesh.cells)
    bars = bars[~outer[bars].any(axis=1)]
    unit = scale
    if len(bars):
        ends = mesh.points[bars]
        length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        unit = float((length / domain.size(ends.mean(axis=1))).mean())
    new = respaced(mesh.points, rim, domain, unit)
    inner = ~outer
    inner[: mesh.fixed] = False
    old = mesh.points[inner]
    free = -domain.distance(old) > 0.5 * unit * domain.size(old)
    return np.concatenate([mesh.points[: mesh.fixed], new, old[free]]), mesh.fixed + len(new)


def check_cover(mesh: Mesh, domain: Domain, scale: float, samples: FloatArray) -> None:
    """Refuse a Delaunay mesh with samples of the domain, (k, 2), in none of its triangles."""
    from scipy.spatial import Delaunay, QhullError

    samples = samples[-domain.distance(samples) > 0.0]
    deep = -domain.distance(samples) > UNCOVERED * scale * domain.size(samples)
    samples = samples[deep]
    try:
        hull = Delaunay(mesh.points)
    except QhullError as exc:
        msg = "all points are on a line"
        raise TooCoarseError(msg) from exc
    inside = set(map(tuple, np.sort(mesh.cells, axis=1).tolist()))
    kept = np.array([tuple(row) in inside for row in np.sort(hull.simplices, axis=1).tolist()])
    found = hull.find_simplex(samples)
    out = np.flatnonzero((found < 0) | ~kept[found])
    if out.size:
        x, y = samples[out[0]]
        msg = f"the point ({x:.6g}, {y:.6g}) of the domain is in no triangle"
        raise TooCoarseError(msg)


def check_edges(mesh: Mesh, domain: Domain) -> None:
    """Refuse a mesh with inner edges outside the domain or boundary edges far from fd = 0."""
    points, cells, ends = refine_triangles(mesh.points, mesh.cells)
    on_rim = boundary_vertices(cells, len(points))[len(mesh.points):]
    mesh.rim()
    _check_middles(points[len(mesh.points):], mesh.points[ends], on_rim, domain)


def _check_middles(middle: FloatArray, ends: FloatArray, on_rim: BoolArray, domain: Domain) -> None:
    off = domain.distance(middle) / np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    for bad, what in ((on_rim & (np.abs(off) > BULGE), "is far from the boundary"),
                      (~on_rim & (off > ASTRAY), "leaves the domain")):
        if bad.any():
            place = place_within(domain.diagonal, middle[int(np.argmax(bad))], 6)
            msg = f"the edge at ({place}) {what}"
            raise TooCoarseError(msg)


def density(points: FloatArray, domain: Domain, mean: float) -> FloatArray:
    """Density h^-r at points, (n,), with the sizes relative to their mean."""
    return power(domain.size(points) / mean, -EXPONENT)


def relax(mesh: Mesh, domain: Domain, rounds: int, *, globally: bool = False) -> None:
    """Rounds of ODT in place: the boundary spaced by size, all others moved, edges flipped.

    Parameters
    ----------
    mesh : Mesh
    domain : Domain
    rounds : int
    globally : bool    the global step (4.27) instead of a Gauss-Seidel sweep (4.13)

    References
    ----------
    CMAME 200 (2011) 967-984, Section 5.3, ``odtmeshopt``.
    """
    regions = np.zeros(len(mesh.cells), dtype=np.int32)
    for _ in range(rounds):
        rim = mesh.rim()
        target = spaced(mesh.points, rim, domain)
        mesh.points = move_rim(mesh.points, mesh.cells, rim, target, domain)
        outer = np.zeros(len(mesh.points), dtype=np.bool_)
        outer[rim.vertices] = True
        topology = make_topology(mesh.cells, ~outer & ~mesh.held(), outer)
        size = domain.size(mesh.points)
        mean = float(size.mean())
        rho = power(size / mean, -EXPONENT)
        if globally:
            mesh.points, _ = global_step(
                mesh.points, topology, rho, objective=partial(_energy, mesh.cells, domain, mean)
            )
        else:
            mesh.points, _ = gauss_seidel_sweep(mesh.points, topology, rho)
        lawson_flips(mesh.points, mesh.cells, cell_neighbors(mesh.cells), regions)


def _energy(cells: IntArray, domain: Domain, mean: float, points: FloatArray) -> float:
    """ODT energy with the density where the points are; infinite if one leaves the domain."""
    return total_energy(points, cells, density(points, domain, mean), None)


def refine(mesh: Mesh, domain: Domain) -> Mesh:
    """Cut every triangle into four, new boundary vertices on fd = 0.

    Raises
    ------
    TooCoarseError    an edge leaves the domain or is far from its boundary, a triangle folds
    """
    points, cells, ends = refine_triangles(mesh.points, mesh.cells)
    on_rim = boundary_vertices(cells, len(points))[len(mesh.points):]
    new = np.arange(len(mesh.points), len(points))
    _check_middles(points[new], mesh.points[ends], on_rim, domain)
    points[new[on_rim]] = domain.project(points[new[on_rim]])
    folded = np.flatnonzero(signed_volumes(points, cells) <= 0.0)
    if folded.size:
        place = place_within(domain.diagonal, points[cells[folded[0]]].mean(axis=0), 6)
        msg = f"the boundary at ({place}) bends too much for its edges"
        raise TooCoarseError(msg)
    vertices, order = curve_order(points, cells)
    vertices = np.concatenate([np.arange(mesh.fixed), vertices[vertices >= mesh.fixed]])
    rank = np.empty(len(points), dtype=np.int32)
    rank[vertices] = np.arange(len(points))
    return Mesh(points[vertices], np.ascontiguousarray(rank[cells[order]]), mesh.fixed)


def finish(mesh: Mesh, phases: tuple[Phase, ...], near: BoolArray | None = None) -> None:
    """Improve the quality in place, the boundary as it is; only the vertices ``near`` move."""
    free = ~boundary_vertices(mesh.cells, len(mesh.points)) & ~mesh.held()
    regions = np.zeros(len(mesh.cells), dtype=np.int32)
    touched: BoolArray | None = None
    if near is not None:
        free &= near
        touched = np.asarray(near[mesh.cells].any(axis=1))
    mesh.points, mesh.cells = mesh.points.copy(), mesh.cells.copy()
    finish2d(
        Triangles(mesh.points, mesh.cells, cell_neighbors(mesh.cells), regions), free,
        movable_cells=touched, phases=phases,
    )


def repair(mesh: Mesh, domain: Domain) -> None:
    """Improve the triangles below BAD in place; other vertices stay, and so even sizes do."""
    power, rounds, sweeps = REPAIR
    for rings in range(REPEATS):
        bad = radius_ratio(mesh.points, mesh.cells) < BAD
        if not bad.any():
            break
        near = np.zeros(len(mesh.points), dtype=np.bool_)
        near[mesh.cells[bad]] = True
        for _ in range(rings):
            near[mesh.cells[near[mesh.cells].any(axis=1)]] = True
        finish(mesh, (Phase(power, float(bad.mean()), rounds, sweeps),), near)
        slide_worst(mesh, domain)


def slide_worst(mesh: Mesh, domain: Domain) -> None:
    """Move boundary vertices of triangles below BAD along fd = 0, in place, if the worst gains."""
    quality = radius_ratio(mesh.points, mesh.cells)
    bad = np.flatnonzero(quality < BAD)
    bad = bad[np.argsort(quality[bad], kind="stable")]
    beside = {}
    for chain in mesh.rim().chains:
        inner = zip(chain[:-2].tolist(), chain[1:-1].tolist(), chain[2:].tolist(), strict=True)
        beside.update({v: (before, after) for before, v, after in inner})
        if chain[0] == chain[-1] and chain[0] >= mesh.fixed:
            beside[int(chain[0])] = (int(chain[-2]), int(chain[1]))
    stars = vertex_stars(mesh.cells, len(mesh.points))
    touched = np.zeros(len(mesh.points), dtype=np.bool_)
    movers: list[int] = []
    around: list[IntArray] = []
    for v in mesh.cells[bad].ravel().tolist():
        star = stars.indices[stars.indptr[v]:stars.indptr[v + 1]]
        if v in beside and not touched[v] and not touched[mesh.cells[star]].any():
            touched[mesh.cells[star]] = True
            movers.append(v)
            around.append(star)
    if not movers:
        return
    start = np.cumsum([0, *map(len, around[:-1])])
    cells = mesh.cells[np.concatenate(around)]
    worst = np.minimum.reduceat(radius_ratio(mesh.points, cells), start)
    ends = np.array([beside[v] for v in movers])
    for share in SLIDES:
        for side in range(2):
            trial = mesh.points.copy()
            x = mesh.points[movers]
            trial[movers] = domain.project(x + share * (mesh.points[ends[:, side]] - x))
            now = np.minimum.reduceat(radius_ratio(trial, cells), start)
            better = np.flatnonzero(now > worst)
            chosen = np.array(movers)[better]
            mesh.points[chosen] = trial[chosen]
            worst[better] = now[better]


Watch = Callable[[str, FloatArray, IntArray], object]
"""Is told the stage, the points and the cells of a mesh under construction."""
