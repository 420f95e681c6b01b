"""Local mesh smoothing, Section 4.2: one vertex at a time (Gauss-Seidel) or all at once (Jacobi).

A vertex moves to the weighted mean of the centres of its star, by alpha = 1, 1/2, 1/4, ... of the
way: the largest step that leaves every cell of the star a sound volume.
"""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any, Literal, NamedTuple

import numpy as np

from odt_plugins.engine.cells.corner import Edges, corner_normals, six_volumes
from odt_plugins.engine.cells.elementary import power
from odt_plugins.engine.cells.geometry import signed_volumes
from odt_plugins.engine.cells.metric import (
    edges_through,
    exponential,
    product,
    root_volume,
    solved,
    through,
)
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.compiled.threads import run_ranges, thread_pool
from odt_plugins.engine.topology.coloring import run_chunks
from odt_plugins.engine.topology.star import Stars, star_sum
from odt_plugins.engine.topology.stencil import Topology
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray

Center = Literal["odt", "cpt", "laplacian"]

HALVINGS = 8
"""alpha is not tried below 2^-HALVINGS; the vertex then stays (Section 4.2.1)."""

THIN = 1e-3
"""No move may leave a cell below this part of the star's mean volume, unless one was already."""

ROUNDING = 1e-13
"""Volumes below this part of (longest edge)^d are rounding errors: never accepted."""


class StepStats(NamedTuple):
    """What a position step did.

    Attributes
    ----------
    moved : int         vertices that changed place
    max_move : float    longest move relative to the cells of the vertex's star: their mean volume
                        to the power 1/d
    reduced : int       vertices whose alpha is below 1, those that stayed for it included
    alpha : float       step length of the whole step; 1 for sweeps, 0 when nothing was accepted
    """

    moved: int
    max_move: float
    reduced: int
    alpha: float = 1.0


CHUNK = 64
"""Cells of a star that are worked on at a time: their numbers lie in rows of this length."""

AX, AY, AZ, BX, BY, BZ, EX, EY, EZ, RHO, DET, GX, GY, GZ, OX, OY, OZ, LONG = (
    CHUNK * row for row in range(18)
)
"""Where the rows begin: corners a, b, e of the cells and density; det, its gradient, moment and
squared longest edge."""

XX, XY, XZ, YY, YZ, ZZ = AX, AY, AZ, BX, BY, BZ
"""Rows of S, which take the place of corners that are read."""


@kernel
def _plane_chunk(
    nodes: FloatArray, cells: IntArray, indices: IntArray, first: int, count: int, i: int,
    rows: FloatArray,
) -> None:
    """Fill the rows for triangles indices[first:first + count] around vertex i."""
    x, y = nodes[i, 0], nodes[i, 1]
    for s in range(count):
        c = indices[first + s]
        at = (cells[c, 1] == i) + 2 * (cells[c, 2] == i)
        j = cells[c, (at + 1) % 3]
        k = cells[c, (at + 2) % 3]
        ax, ay = nodes[j, 0] - x, nodes[j, 1] - y
        bx, by = nodes[k, 0] - x, nodes[k, 1] - y
        aa = ax * ax + ay * ay
        bb = bx * bx + by * by
        rho = abs(nodes[i, 3]) + abs(nodes[j, 3]) + abs(nodes[k, 3])
        rows[DET + s] = ax * by - ay * bx
        rows[GX + s], rows[GY + s], rows[GZ + s] = ay - by, bx - ax, 0.0
        rows[LONG + s] = max(aa, bb)
        if min(nodes[i, 3], nodes[j, 3], nodes[k, 3]) < 0.0:
            rows[RHO + s] = -rho
            rows[OX + s], rows[OY + s] = (ax + bx) / 3.0, (ay + by) / 3.0
        else:
            rows[RHO + s] = rho
            rows[OX + s], rows[OY + s] = aa * by - bb * ay, bb * ax - aa * bx
        rows[OZ + s] = 0.0


@kernel
def _space_chunk(
    nodes: FloatArray, cells: IntArray, indices: IntArray, first: int, count: int, i: int,
    rows: FloatArray,
) -> None:
    """Fill the rows for tetrahedra indices[first:first + count] around vertex i.

    The second loop does without indirect addresses, so the compiler takes several cells at once.
    """
    x, y, z, own = nodes[i, 0], nodes[i, 1], nodes[i, 2], nodes[i, 3]
    for s in range(count):
        c = indices[first + s]
        at = (cells[c, 1] == i) + 2 * (cells[c, 2] == i) + 3 * (cells[c, 3] == i)
        odd = at & 1
        j = cells[c, (at + 1) & 3]
        k = cells[c, (at + 2 + odd) & 3]
        n = cells[c, (at + 3 - odd) & 3]
        rows[AX + s], rows[AY + s], rows[AZ + s] = nodes[j, 0], nodes[j, 1], nodes[j, 2]
        rows[BX + s], rows[BY + s], rows[BZ + s] = nodes[k, 0], nodes[k, 1], nodes[k, 2]
        rows[EX + s], rows[EY + s], rows[EZ + s] = nodes[n, 0], nodes[n, 1], nodes[n, 2]
        rho = abs(own) + abs(nodes[j, 3]) + abs(nodes[k, 3]) + abs(nodes[n, 3])
        central = min(min(own, nodes[j, 3]), min(nodes[k, 3], nodes[n, 3])) < 0.0
        rows[RHO + s] = -rho if central else rho
    for s in range(count):
        ax, ay, az = rows[AX + s] - x, rows[AY + s] - y, rows[AZ + s] - z
        bx, by, bz = rows[BX + s] - x, rows[BY + s] - y, rows[BZ + s] - z
        ex, ey, ez = rows[EX + s] - x, rows[EY + s] - y, rows[EZ + s] - z
        aa = ax * ax + ay * ay + az * az
        bb = bx * bx + by * by + bz * bz
        ee = ex * ex + ey * ey + ez * ez
        px, py, pz = by * ez - bz * ey, bz * ex - bx * ez, bx * ey - by * ex
        qx, qy, qz = ey * az - ez * ay, ez * ax - ex * az, ex * ay - ey * ax
        rx, ry, rz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        rows[DET + s] = ax * px + ay * py + az * pz
        rows[GX + s], rows[GY + s] = -(px + qx + rx), -(py + qy + ry)
        rows[GZ + s] = -(pz + qz + rz)
        rows[LONG + s] = max(aa, bb, ee)
        central = rows[RHO + s] < 0.0
        rows[OX + s] = 0.25 * (ax + bx + ex) if central else aa * px + bb * qx + ee * rx
        rows[OY + s] = 0.25 * (ay + by + ey) if central else aa * py + bb * qy + ee * ry
        rows[OZ + s] = 0.25 * (az + bz + ez) if central else aa * pz + bb * qz + ee * rz


@kernel
def _seen_chunk(
    nodes: FloatArray, cells: IntArray, indices: IntArray, first: int, count: int, i: int,
    rows: FloatArray,
) -> None:
    """Let cells have the circumcenters and the weights W = |tau| det(S) M that a metric gives them.

    S and M = S S are those of the mean of the logarithms that the hat function of vertex i weighs.
    M goes into the rows of corners. The moment is 2 det M (c - x_i), c the centre of the image back
    through S^-1, or M (c - x_i) of a barycenter.
    """
    d = cells.shape[1] - 1
    for s in range(count):
        c = indices[first + s]
        j, k = np.int64(-1), np.int64(-1)
        l = np.int64(-1)
        a = b = e = f = g = h = 0.0
        for r in range(d + 1):
            v = cells[c, r]
            t = 2.0
            if v != i:
                j, k, l, t = v, j, k, 1.0
            if d == 2:
                a, b, f = a + t * nodes[v, 4], b + t * nodes[v, 5], f + t * nodes[v, 6]
            else:
                a, b, e = a + t * nodes[v, 4], b + t * nodes[v, 5], e + t * nodes[v, 6]
                f, g, h = f + t * nodes[v, 7], g + t * nodes[v, 8], h + t * nodes[v, 9]
        w = 1.0 / (d + 2)
        root = exponential((w * a, w * b, w * e, w * f, w * g, w * h))
        size = root_volume(root)
        rows[RHO + s] *= size
        metric = product(root, root)
        xx, xy, xz, yy, yz, zz = metric
        rows[XX + s], rows[XY + s], rows[XZ + s] = xx, xy, xz
        rows[YY + s], rows[YZ + s], rows[ZZ + s] = yy, yz, zz
        if rows[RHO + s] < 0.0:
            ox, oy, oz = rows[OX + s], rows[OY + s], rows[OZ + s]
            rows[OX + s], rows[OY + s], rows[OZ + s] = through(metric, ox, oy, oz)
            continue
        x, y, z = nodes[i, 0], nodes[i, 1], nodes[i, 2]
        edges = edges_through(root, (
            nodes[j, 0] - x, nodes[j, 1] - y, nodes[j, 2] - z,
            nodes[k, 0] - x, nodes[k, 1] - y, nodes[k, 2] - z,
            nodes[l, 0] - x, nodes[l, 1] - y, nodes[l, 2] - z) if d == 3 else (
            nodes[j, 0] - x, nodes[j, 1] - y, 0.0, nodes[k, 0] - x, nodes[k, 1] - y, 0.0,
            0.0, 0.0, 1.0))
        ox, oy, oz = through(root, *_twice_moment(edges, d))
        # of a positive cell
        scale = (1.0 if six_volumes(*edges) * rows[DET + s] > 0.0 else -1.0) / size
        rows[OX + s], rows[OY + s], rows[OZ + s] = scale * ox, scale * oy, scale * oz


@kernel
def _twice_moment(edges: Edges, d: int) -> tuple[float, float, float]:
    """2 det (centre - x_i) of a simplex with these edges at x_i; in the plane of the first two."""
    ax, ay, az, bx, by, bz, ex, ey, ez = edges
    aa = ax * ax + ay * ay + az * az
    bb = bx * bx + by * by + bz * bz
    if d == 2:
        return aa * by - bb * ay, bb * ax - aa * bx, 0.0
    ee = ex * ex + ey * ey + ez * ez
    px, py, pz, qx, qy, qz, rx, ry, rz = corner_normals(ax, ay, az, bx, by, bz, ex, ey, ez)
    return (aa * px + bb * qx + ee * rx, aa * py + bb * qy + ee * ry, aa * pz + bb * qz + ee * rz)


class Pull(NamedTuple):
    """What vertices are drawn by.

    Attributes
    ----------
    equal_weights : bool    every cell counts the same (4.22)
    neighbors : Stars       of the vertices, when these draw (4.21), otherwise empty
    omega : float           first alpha
    largest_star : int      most cells around a vertex
    """

    equal_weights: bool
    neighbors: Stars
    omega: float
    largest_star: int


NO_NEIGHBORS = Stars(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int32))


@allocating_kernel
def _move_vertices(
    nodes: FloatArray, out: FloatArray, cells: IntArray, stars: Stars, pull: Pull,
    order: IntArray, start: int, stop: int,
) -> tuple[int, float, int]:
    """Move order[start:stop] from nodes to out, which may be the same array.

    A row of ``nodes`` (n, 4) holds a vertex and its density, negative where a cell with that
    vertex is represented by its barycenter; then the metric, see ``cells.metric``, if there is one.
    Returns the vertices moved, the longest relative move
    and the vertices of reduced alpha.

    Offsets are taken from x_i. With a = x_1 - x_i, ... the other corners in positive order,
    det = d! |tau| and c - x_i = moment / (2 det): weights |tau| cancel the division, so flat cells
    do no harm. det is linear in x_i, so one gradient a cell decides every alpha.
    """
    indptr, indices = stars
    equal_weights, omega = pull.equal_weights, pull.omega
    row_start, row_vertices = pull.neighbors
    d = cells.shape[1] - 1
    factorial = 2.0 if d == 2 else 6.0
    laplacian = row_start.shape[0] > 0
    rows = np.empty(18 * CHUNK)
    cell = np.empty((4, pull.largest_star))
    moved = 0
    reduced = 0
    longest = 0.0
    for position in range(start, stop):
        i = order[position]
        x, y, z = nodes[i, 0], nodes[i, 1], nodes[i, 2]
        first = indptr[i]
        count = indptr[i + 1] - first
        tx = ty = tz = weight = 0.0
        xx = xy = xz = yy = yz = zz = 0.0
        total = 0.0
        lowest = np.inf
        edge_max = 0.0
        for done in range(0, count, CHUNK):
            length = min(count - done, CHUNK)
            if d == 2:
                _plane_chunk(nodes, cells, indices, first + done, length, i, rows)
            else:
                _space_chunk(nodes, cells, indices, first + done, length, i, rows)
            if nodes.shape[1] > 4:
                _seen_chunk(nodes, cells, indices, first + done, length, i, rows)
            for s in range(length):
                det, rho = rows[DET + s], rows[RHO + s]
                share = 1.0 if equal_weights else det * abs(rho)
                if rho < 0.0:
                    scale = share
                else:
                    scale = 0.5 / det if equal_weights else 0.5 * rho
                tx += scale * rows[OX + s]
                ty += scale * rows[OY + s]
                tz += scale * rows[OZ + s]
                weight += share
                if nodes.shape[1] > 4:
                    xx, xy, xz = (xx + share * rows[XX + s], xy + share * rows[XY + s],
                                  xz + share * rows[XZ + s])
                    yy, yz, zz = (yy + share * rows[YY + s], yz + share * rows[YZ + s],
                                  zz + share * rows[ZZ + s])
                total += det
                lowest = min(lowest, det)
                edge_max = max(edge_max, rows[LONG + s])
                at = done + s
                cell[0, at], cell[1, at] = det, rows[GX + s]
                cell[2, at], cell[3, at] = rows[GY + s], rows[GZ + s]
        if nodes.shape[1] > 4:
            tx, ty, tz = solved((xx, xy, xz, yy, yz, zz), tx, ty, tz)
            weight = 1.0
        if laplacian:
            tx = ty = tz = 0.0
            weight = float(row_start[i + 1] - row_start[i])
            for s in range(row_start[i], row_start[i + 1]):
                j = row_vertices[s]
                tx += nodes[j, 0] - x
                ty += nodes[j, 1] - y
                tz += nodes[j, 2] - z
        noise = ROUNDING * edge_max * (np.sqrt(edge_max) if d == 3 else 1.0)
        floor = max(min(lowest, THIN * total / count), noise)
        alpha = omega / weight
        accepted = False
        mx = my = mz = 0.0
        for halving in range(HALVINGS + 1):
            mx = (x + alpha * tx) - x
            my = (y + alpha * ty) - y
            mz = (z + alpha * tz) - z
            thin = 0
            for s in range(count):
                volume = cell[0, s] + (cell[1, s] * mx + cell[2, s] * my + cell[3, s] * mz)
                thin += 0 if volume >= floor else 1
            accepted = thin == 0
            if accepted:
                break
            if halving == 0:
                reduced += 1
            alpha *= 0.5
        if not accepted:
            mx = my = mz = 0.0
        out[i, 0], out[i, 1], out[i, 2] = x + mx, y + my, z + mz
        square = mx * mx + my * my + mz * mz
        if square > 0.0:
            moved += 1
            power = square if d == 2 else square * np.sqrt(square)
            longest = max(longest, power * factorial * count / total)
    return moved, longest ** (1.0 / d), reduced


def _sweep(
    points: FloatArray, topology: Topology, rho: FloatArray | None, pull: Pull,
    barycentric: BoolArray | bool, threads: int, together: bool = False,
) -> tuple[FloatArray, StepStats]:
    """Run the kernel over blocks of vertices.

    Parameters
    ----------
    barycentric : (n,) bool, or one for all    vertices whose cells count by their barycenters
    together : bool                            no vertex sees the move of another
    """
    n, d = len(points), topology.cells.shape[1] - 1
    nodes, new = np.zeros((n, 4 + points.shape[1] - d)), points.copy()
    density = np.ones(n) if rho is None else rho
    by_barycenters = np.full(n, barycentric) if isinstance(barycentric, bool) else barycentric
    coloring = topology.coloring.of_one_colour() if together else topology.coloring

    def fill(start: int, stop: int) -> None:
        part = nodes[start:stop]
        part[:, :d], part[:, 4:] = points[start:stop, :d], points[start:stop, d:]
        part[:, 3] = density[start:stop]
        np.negative(part[:, 3], out=part[:, 3], where=by_barycenters[start:stop])

    def run(start: int, stop: int) -> Any:
        return _move_vertices(
            nodes, out, topology.cells, topology.stars, pull, coloring.order, start, stop
        )

    def take(start: int, stop: int) -> None:
        new[start:stop, :d] = out[start:stop, :d]

    with nullcontext(topology.pool) if topology.pool else thread_pool(threads) as pool:
        run_ranges(pool, n, fill)
        out = nodes.copy() if together else nodes
        results = run_chunks(pool, threads, coloring, run)
        run_ranges(pool, n, take)
    moved, longest, reduced = zip((0, 0.0, 0), *results, strict=True)
    return new, StepStats(sum(moved), max(longest), sum(reduced))


def _pull(
    topology: Topology, method: Center, inverse_volume: bool, omega: float, boundary_rule: bool
) -> tuple[Pull, BoolArray | bool]:
    """What draws the vertices, and those whose cells count by their barycenters."""
    neighbors = topology.neighbors if method == "laplacian" else NO_NEIGHBORS
    pull = Pull(bool(inverse_volume), neighbors, float(omega), topology.largest_star)
    return pull, topology.is_boundary if method == "odt" and boundary_rule else method != "odt"


def gauss_seidel_sweep(
    points: FloatArray,
    topology: Topology,
    rho: FloatArray | None = None,
    *,
    method: Center = "odt",
    inverse_volume: bool = False,
    omega: float = 1.0,
    boundary_rule: bool = True,
    threads: int = 1,
) -> tuple[FloatArray, StepStats]:
    """Move every movable vertex once, block after block, to the mean centre of its star.

    Parameters
    ----------
    points : (n, d) float64         not changed
    topology : Topology             cells of positive volume, movable vertices, boundary
    rho : (n,) float64, optional    density at the vertices; its mean over a cell is rho_tau
    method : {"odt", "cpt", "laplacian"}
                                    circumcenters (4.13), barycenters (4.20), neighbours (4.21)
    inverse_volume : bool           every cell counts the same, rho_tau = 1/|tau| (4.22); like rho
                                    it means nothing to "laplacian"
    omega : float                   relaxation, the first alpha
    boundary_rule : bool            barycenters for cells that touch the boundary (Section 4.2.1)
    threads : int                   worker threads; the result does not depend on it, bit for bit

    Returns
    -------
    points : (n, d) float64         every cell has a positive volume
    stats : StepStats

    References
    ----------
    CMAME 200 (2011) 967-984, Section 4.1.3, (4.12), (4.13), Section 4.2.1, (4.20), (4.21), (4.22).
    (4.18) is (4.20) with alpha = 1 and the integrals by one point.
    """
    pull, barycentric = _pull(topology, method, inverse_volume, omega, boundary_rule)
    return _sweep(points, topology, rho, pull, barycentric, threads)


def jacobi_sweep(
    points: FloatArray,
    topology: Topology,
    rho: FloatArray | None = None,
    *,
    method: Center = "odt",
    inverse_volume: bool = False,
    omega: float = 0.8,
    boundary_rule: bool = True,
    threads: int = 1,
) -> tuple[FloatArray, StepStats]:
    """Move all movable vertices at once, each by what the old positions ask (Section 4.1.2).

    Parameters and results as in :func:`gauss_seidel_sweep`. Neighbours that move together may
    spoil a cell that each alone would not: their steps are then halved. On lattices the full step
    omega = 1 is the limit of stability, so the default is below it.
    """
    old = np.ascontiguousarray(points, dtype=np.float64)
    pull, barycentric = _pull(topology, method, inverse_volume, omega, boundary_rule)
    target, stats = _sweep(old, topology, rho, pull, barycentric, threads, together=True)
    new, reduced = guarded_move(old, topology, target - old)
    return new, move_stats(old, new, topology, stats.reduced + reduced, 1.0)


def guarded_move(
    points: FloatArray, topology: Topology, displacement: FloatArray
) -> tuple[FloatArray, int]:
    """Move all vertices together, halving the steps around cells that would fold.

    Parameters
    ----------
    points : (n, d) float64          cells of positive volume
    topology : Topology
    displacement : (n, d) float64    wanted moves; vertices that may not move are left alone

    Returns
    -------
    points : (n, d) float64          no cell gets below THIN of the mean volume around it
    reduced : int                    vertices whose step was shortened or dropped
    """
    cells = topology.cells
    old = signed_volumes(points, cells)
    floor = np.minimum(old, THIN * _mean_star_volumes(points, topology)[cells].mean(axis=1))
    share = topology.movable.astype(np.float64)
    moved = np.where(topology.movable[:, None], displacement, 0.0)
    unchecked = np.arange(len(cells))
    new = points + moved
    cut = np.zeros(len(points), dtype=np.bool_)
    lowest = 0.5**HALVINGS
    while unchecked.size:
        volumes = signed_volumes(new, cells[unchecked])
        bad = unchecked[~(volumes >= floor[unchecked])]
        hit = np.unique(cells[bad])
        hit = hit[share[hit] > 0.0]
        if not hit.size:
            break
        cut[hit] = True
        share[hit] = np.where(share[hit] > lowest, 0.5 * share[hit], 0.0)
        new[hit] = points[hit] + share[hit, None] * moved[hit]
        changed = np.zeros(len(points), dtype=np.bool_)
        changed[hit] = True
        unchecked = np.flatnonzero(changed[cells].any(axis=1))
    return new, int(cut.sum())


def _mean_star_volumes(points: FloatArray, topology: Topology) -> FloatArray:
    volumes = signed_volumes(points, topology.cells)
    count = np.maximum(np.diff(topology.stars.indptr), 1)
    means: FloatArray = star_sum(volumes, topology.cells, len(points)) / count
    return means


def move_stats(
    points: FloatArray, new: FloatArray, topology: Topology, reduced: int, alpha: float
) -> StepStats:
    """Describe a step of all vertices from points to new; alpha is 0 if none moved."""
    moved = np.flatnonzero(np.any(new != points, axis=1))
    if not moved.size:
        return StepStats(0, 0.0, reduced, 0.0)
    size = power(_mean_star_volumes(points, topology)[moved], 1 / (topology.cells.shape[1] - 1))
    longest = float((np.linalg.norm(new[moved] - points[moved], axis=1) / size).max())
    return StepStats(int(moved.size), longest, reduced, alpha)
