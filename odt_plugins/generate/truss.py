"""The coarse start: points of a lattice thinned by size, moved by the forces of a truss.

References
----------
P.-O. Persson, G. Strang, A simple mesh generator in MATLAB, SIAM Review 46 (2004) 329-345,
doi:10.1137/S0036144503429121.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from odt_plugins.errors import InvalidOptionError
from odt_plugins.generate.distance import Distance
from odt_plugins.generate.domain import Domain, fixed_points, make_domain
from odt_plugins.generate.sizes import Size
from odt_plugins.mesh.arrays import FloatArray, IntArray

PRESSURE = 1.2
"""Bars want to be this much longer than their share of the sizes, which keeps them pushing."""

TIME_STEP = 0.2
"""Part of the forces by which points move in a step."""

MOVED = 0.1
"""Part of its size that some point moves before the points are connected anew."""

CROWDED = 2.0
"""A bar shorter than its wanted length by this factor loses an end point ..."""

THINNING = 30
"""... every so many steps."""

INSIDE = 1e-3
"""Triangles count whose centroid is inside by this part of its size."""

FLAT = 0.1
"""Triangles of boundary vertices below this radius ratio belong to no mesh."""


def lattice(domain: Domain, spacing: float) -> FloatArray:
    """Points of the triangular lattice in the bounding box, (n, 2)."""
    xs = np.arange(domain.low[0], domain.high[0] + 1e-9 * spacing, spacing)
    ys = np.arange(domain.low[1], domain.high[1] + 1e-9 * spacing, spacing * math.sqrt(0.75))
    x, y = np.meshgrid(xs, ys)
    x[1::2] += 0.5 * spacing
    return np.column_stack([x.ravel(), y.ravel()])


def initial_points(
    domain: Domain, spacing: float, least: float, fixed: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """Place points (n, 2) so dense as the sizes ask, the fixed ones first.

    Parameters
    ----------
    domain : Domain
    spacing : float            distance of neighbours where fh is ``least``
    least : float
    fixed : (f, 2) float64
    rng : numpy Generator      decides which points of the lattice stay where sizes are larger
    """
    points = lattice(domain, spacing)
    points = points[domain.distance(points) < INSIDE * spacing]
    if not len(points):
        return fixed.copy()
    size = domain.size(points)
    points = points[rng.random(len(points)) < (least / size) ** 2]
    if len(fixed) and len(points):
        from scipy.spatial import cKDTree

        near = cKDTree(fixed).query(points)[0]
        points = points[near > 0.5 * spacing * domain.size(points) / least]
    return np.concatenate([fixed, points])


def triangulate(points: FloatArray, domain: Domain, scale: float) -> IntArray:
    """Delaunay triangles inside the domain, positive.

    Parameters
    ----------
    points : (n, 2) float64
    domain : Domain
    scale : float             wanted edge length over fh

    Returns
    -------
    (m, 3) int32              none that has its three vertices on the boundary and is flat
    """
    from scipy.spatial import Delaunay, QhullError

    if len(points) < 3:
        return np.empty((0, 3), dtype=np.int32)
    try:
        cells = Delaunay(points).simplices
    except QhullError:
        return np.empty((0, 3), dtype=np.int32)
    centre = points[cells].mean(axis=1)
    depth = -domain.distance(centre)
    cells, centre, depth = cells[depth > 0.0], centre[depth > 0.0], depth[depth > 0.0]
    inside = depth > INSIDE * scale * domain.size(centre)
    a, b, c = (points[cells[:, k]] for k in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    cells = np.where((area < 0)[:, None], cells[:, [0, 2, 1]], cells)
    sides = [np.linalg.norm(u - v, axis=1) for u, v in ((a, b), (b, c), (c, a))]
    ratio = 16.0 * area**2 / np.maximum(sum(sides) * np.prod(sides, axis=0), 1e-300)
    outer = domain.distance(points) > -INSIDE * scale * domain.size(points)
    flat = (ratio < FLAT) & outer[cells].all(axis=1)
    return np.ascontiguousarray(cells[inside & ~flat], dtype=np.int32)


def truss_smoothing(
    points: FloatArray, domain: Domain, fixed: int, scale: float, steps: int,
    tolerance: float = 0.0,
) -> FloatArray:
    """Move points towards an equilibrium of bars that only push (``distmeshsmoothing``).

    Parameters
    ----------
    points : (n, 2) float64
    domain : Domain
    fixed : int              the first so many points stay
    scale : float            wanted edge length over fh
    steps : int
    tolerance : float        stop when no inner point moves by this part of its size

    Returns
    -------
    (n', 2) float64          points where bars were much too short are left out
    """
    points = points.copy()
    connected = np.full_like(points, np.inf)
    bars = np.empty((0, 2), dtype=np.int32)
    for step in range(steps):
        size = scale * domain.size(points)
        if (np.linalg.norm(points - connected, axis=1) > MOVED * size).any():
            connected = points.copy()
            bars = edges_of(triangulate(points, domain, scale))
        if not len(bars):
            break
        bar = points[bars[:, 0]] - points[bars[:, 1]]
        length = np.maximum(np.linalg.norm(bar, axis=1), 1e-12 * domain.diagonal)
        wanted = domain.size(0.5 * (points[bars[:, 0]] + points[bars[:, 1]]))
        wanted *= PRESSURE * math.sqrt((length**2).sum() / (wanted**2).sum())
        if step % THINNING == THINNING - 1 and step < steps - 1:
            crowded = bars[wanted > CROWDED * length].max(axis=1)
            crowded = np.unique(crowded[crowded >= fixed])
            if len(crowded):
                points = np.delete(points, crowded, axis=0)
                connected = np.full_like(points, np.inf)
                continue
        push = (np.maximum(wanted - length, 0.0) / length)[:, None] * bar
        move = np.zeros_like(points)
        for k in range(2):
            move[:, k] = np.bincount(bars[:, 0], push[:, k], len(points))
            move[:, k] -= np.bincount(bars[:, 1], push[:, k], len(points))
        move[:fixed] = 0.0
        points += TIME_STEP * move
        out = np.flatnonzero(domain.distance(points) > 0.0)
        out = out[out >= fixed]
        points[out] = domain.project(points[out])
        if tolerance > 0.0:
            inner = domain.distance(points) < -INSIDE * size
            far = TIME_STEP * np.linalg.norm(move, axis=1)
            if not (far[inner] > tolerance * size[inner]).any():
                break
    return points


def edges_of(cells: IntArray) -> IntArray:
    """Edges of triangles, each once, (e, 2)."""
    if not len(cells):
        return np.empty((0, 2), dtype=np.int32)
    pairs = np.sort(np.concatenate([cells[:, [0, 1]], cells[:, [1, 2]], cells[:, [2, 0]]]), axis=1)
    n = int(cells.max()) + 1
    key = np.unique(pairs[:, 0].astype(np.int64) * n + pairs[:, 1])
    return np.column_stack(np.divmod(key, n)).astype(np.int32)


def distmesh2d(
    fd: Distance,
    fh: Size,
    h0: float,
    bbox: ArrayLike,
    pfix: ArrayLike | None = None,
    *,
    seed: int = 2011,
    steps: int = 1000,
    tolerance: float = 1e-3,
) -> tuple[FloatArray, IntArray]:
    """Mesh a domain by the truss alone, as Persson and Strang do: the yardstick of odtmesh2d.

    Parameters
    ----------
    fd, fh, h0, bbox, pfix, seed    as for odtmesh2d
    steps : int                     most steps of the truss
    tolerance : float               it stops when no inner point moves by this part of its size

    Returns
    -------
    points : (n, 2) float64         not all on fd = 0 that are on the boundary of the mesh
    cells : (m, 3) int32            counterclockwise; flat ones may remain

    Raises
    ------
    InvalidOptionError              bad input, or no triangle is inside
    """
    domain = make_domain(fd, fh, bbox)
    fixed = fixed_points(pfix, domain, h0)
    inside = lattice(domain, h0)
    inside = np.concatenate([inside[domain.distance(inside) < 0.0], fixed])
    cells = np.empty((0, 3), dtype=np.int32)
    if len(inside):
        least = float(domain.size(inside).min())
        points = initial_points(domain, h0, least, fixed, np.random.default_rng(seed))
        points = truss_smoothing(points, domain, len(fixed), h0 / least, steps, tolerance)
        cells = triangulate(points, domain, h0 / least)
    if not len(cells):
        msg = f"got h0={h0:g}, for which no triangle is inside; try a smaller h0="
        raise InvalidOptionError(msg)
    return points, cells
