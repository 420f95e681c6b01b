"""Vertices of a surface move to the mean centre of their star (Section 4.2), tangentially."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.cells.metric import has_metric, hat_root, product, solved, through
from odt_plugins.engine.cells.triangle import opposite_edge
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.ground.position import NO_COST, Body, Step, along_line, try_move
from odt_plugins.engine.ground.sheet import LOCKED, Guards, Sheet, Work
from odt_plugins.engine.moves.tangent import star_normal
from odt_plugins.engine.topology.star import Stars
from odt_plugins.mesh.arrays import FloatArray, IntArray

ODT, CPT, LAPLACIAN, GIVEN = 0, 1, 2, 3
"""Where a vertex is to go: mean circumcentre (4.13), mean barycentre (4.20), mean neighbour (4.21),
or by a given vector."""

SLENDER = 1e-12
"""A triangle whose squared sine at the vertex is below this has no circumcentre."""


class Target(NamedTuple):
    """Where vertices are to go.

    Attributes
    ----------
    centre : int              ODT, CPT, LAPLACIAN or GIVEN; triangles with a vertex on a feature
                              line count by their barycentre (Section 4.2.1)
    rho : (n,) float64        density at the vertices
    equal_weights : bool      density (4.22)
    omega : float             first alpha
    vectors : (n, 3) float64  by which to move, for GIVEN; otherwise NOWHERE
    """

    centre: int
    rho: FloatArray
    equal_weights: bool
    omega: float
    vectors: FloatArray


NOWHERE = np.zeros((0, 3))
"""Vectors for a target that takes none."""


@kernel
def star_centre(
    sheet: Sheet, stars: Stars, vertex: int, target: Target
) -> tuple[float, float, float]:
    """Vector to the weighted mean of the centres of a star (4.13), (4.20) or (4.21).

    In a metric circumcentres are those of the triangles as they are seen, and weights are areas as
    they are seen times M, see ``odt.sweeps``.
    """
    p, t = sheet.points, sheet.triangles
    indptr, indices = stars
    rho = target.rho
    x, y, z = p[vertex, 0], p[vertex, 1], p[vertex, 2]
    seen = has_metric(p) and target.centre != LAPLACIAN
    xx = xy = xz = yy = yz = zz = 0.0
    tx = ty = tz = weight = 0.0
    for s in range(indptr[vertex], indptr[vertex + 1]):
        c = indices[s]
        b, d = opposite_edge(t, c, vertex)
        ux, uy, uz = p[b, 0] - x, p[b, 1] - y, p[b, 2] - z
        vx, vy, vz = p[d, 0] - x, p[d, 1] - y, p[d, 2] - z
        uu = ux * ux + uy * uy + uz * uz
        vv = vx * vx + vy * vy + vz * vz
        uv = ux * vx + uy * vy + uz * vz
        # square of twice the area
        square = uu * vv - uv * uv
        if seen:
            root = hat_root(p, vertex, b, d)
            ax, ay, az = through(root, ux, uy, uz)
            bx, by, bz = through(root, vx, vy, vz)
            uu = ax * ax + ay * ay + az * az
            vv = bx * bx + by * by + bz * bz
            uv = ax * bx + ay * by + az * bz
            square = uu * vv - uv * uv
        if target.centre == LAPLACIAN:
            share, left, right = 1.0, 0.5, 0.5
        elif not square > SLENDER * uu * vv:
            continue
        else:
            share = 1.0
            if not target.equal_weights:
                share = math.sqrt(square) * (rho[vertex] + rho[b] + rho[d])
            left = right = 1.0 / 3.0
            if target.centre == ODT and sheet.kind[vertex] + sheet.kind[b] + sheet.kind[d] == 0:
                left = 0.5 * vv * (uu - uv) / square
                right = 0.5 * uu * (vv - uv) / square
        ax, ay, az = left * ux + right * vx, left * uy + right * vy, left * uz + right * vz
        if seen:
            metric = product(root, root)
            ax, ay, az = through(metric, ax, ay, az)
            bx, by, bz, cx, cy, cz = metric
            xx, xy, xz = xx + share * bx, xy + share * by, xz + share * bz
            yy, yz, zz = yy + share * cx, yz + share * cy, zz + share * cz
        weight += share
        tx, ty, tz = tx + share * ax, ty + share * ay, tz + share * az
    if not weight > 0.0:
        return 0.0, 0.0, 0.0
    if seen:
        return solved((xx, xy, xz, yy, yz, zz), tx, ty, tz)
    return tx / weight, ty / weight, tz / weight


@kernel
def move_vertices(
    sheet: Sheet, guards: Guards, body: Body, order: IntArray, start: int, stop: int,
    target: Target, bounds: Extremes, work: Work, moved: FloatArray,
) -> int:
    """Move every vertex of order[start:stop] to the mean centre of its star, in place.

    Parameters
    ----------
    sheet : Sheet, guards : Guards
    body : Body               the sheet
    order : (k,) int32        vertices; those of one call share no triangle
    start, stop : int
    target : Target
    bounds : Extremes         a move that passes one of them and makes the star worse there is
                              shortened
    work : Work               of this thread
    moved : (n,) float64      OUT: length of the move

    Returns
    -------
    int                       number of vertices moved
    """
    p, omega, vectors, stars = sheet.points, target.omega, target.vectors, body.stars
    count = 0
    for o in range(start, stop):
        v = order[o]
        moved[v] = 0.0
        if sheet.kind[v] == LOCKED or stars.indptr[v] == stars.indptr[v + 1]:
            continue
        if target.centre == GIVEN:
            dx, dy, dz = vectors[v, 0], vectors[v, 1], vectors[v, 2]
        else:
            dx, dy, dz = star_centre(sheet, stars, v, target)
        star = stars.indices[stars.indptr[v] : stars.indptr[v + 1]]
        nx, ny, nz = star_normal(p, sheet.triangles, star)
        up = dx * nx + dy * ny + dz * nz
        dx, dy, dz = omega * (dx - up * nx), omega * (dy - up * ny), omega * (dz - up * nz)
        if not dx * dx + dy * dy + dz * dz > 0.0:
            continue
        x, y, z = p[v, 0], p[v, 1], p[v, 2]
        step = Step(dx, dy, dz, along_line(sheet, guards.lines, v, dx, dy, dz), 0.0, 0.0)
        if try_move(sheet, guards, stars, body, v, step, NO_COST, bounds, work)[0]:
            moved[v] = math.sqrt((p[v, 0] - x) ** 2 + (p[v, 1] - y) ** 2 + (p[v, 2] - z) ** 2)
            count += 1
    return count


@kernel
def star_centres(sheet: Sheet, stars: Stars, target: Target, vectors: FloatArray) -> None:
    """Vectors (n, 3) to the mean centres of all stars as they are now."""
    for v in range(len(sheet.points)):
        x, y, z = star_centre(sheet, stars, v, target)
        vectors[v, 0], vectors[v, 1], vectors[v, 2] = x, y, z
