"""Lloyd's step towards a centroidal Voronoi tessellation, for comparison (Remark 4.8)."""

from __future__ import annotations

import math
from itertools import combinations, permutations

import numpy as np

from odt_plugins.engine.cells.geometry import circumcenters
from odt_plugins.engine.odt.global_step import frozen_density
from odt_plugins.engine.odt.sweeps import StepStats, guarded_move, move_stats
from odt_plugins.engine.topology.stencil import Topology
from odt_plugins.mesh.arrays import FloatArray, IntArray


def _facet_circumcenters(points: FloatArray, corners: IntArray) -> FloatArray:
    """Circumcenters of triangles in space, (m, 3) corners."""
    a = points[corners[:, 1]] - points[corners[:, 0]]
    b = points[corners[:, 2]] - points[corners[:, 0]]
    normal = np.cross(a, b)
    aa, bb = (a**2).sum(axis=1)[:, None], (b**2).sum(axis=1)[:, None]
    numerator = np.cross(aa * b - bb * a, normal)
    offset = numerator / (2.0 * (normal**2).sum(axis=1)[:, None])
    return points[corners[:, 0]] + offset


def _determinants(rows: FloatArray) -> FloatArray:
    """Determinants of (m, d, d) matrices."""
    a, b = rows[:, 0], rows[:, 1]
    if rows.shape[1] == 2:
        return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return np.einsum("mi,mi->m", np.cross(a, b), rows[:, 2])


def dual_cells(
    points: FloatArray, cells: IntArray, rho_tau: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Mass and centroid of the cell dual to every vertex.

    Parameters
    ----------
    points : (n, d) float64
    cells : (m, d + 1) int32    positive
    rho_tau : (m,) float64      density, constant on cells

    Returns
    -------
    mass : (n,) float64
    offset : (n, d) float64     mass times (centroid - x_i)

    Notes
    -----
    Every cell gives each of its vertices the signed simplices x_i, midpoint of an edge,
    circumcenter of a facet (d = 3), circumcenter of the cell. Around an interior vertex of a
    Delaunay mesh they add up to its Voronoi region exactly; if the mesh is not Delaunay they are
    the signed dual cell. The region of a vertex near the boundary is not clipped by it, and on
    each piece rho is that of the cell, though pieces may lie outside it.
    """
    n, d = points.shape
    mass = np.zeros(n)
    offset = np.zeros((n, d))
    center = circumcenters(points, cells)
    facets = combinations(range(4), 3) if d == 3 else ()
    facet_center = {f: _facet_circumcenters(points, cells[:, f]) for f in facets}
    for order in permutations(range(d + 1)):
        sign = math.prod(np.sign(b - a) for a, b in combinations(order, 2))
        corners = cells[:, list(order)]
        x = points[corners[:, 0]]
        chain = [0.5 * (points[corners[:, 1]] - x)]
        if d == 3:
            a, b, c = sorted(order[:3])
            chain.append(facet_center[a, b, c] - x)
        chain.append(center - x)
        steps = np.stack(chain, axis=1)
        part = sign * rho_tau * _determinants(steps) / (2.0 if d == 2 else 6.0)
        mass += np.bincount(corners[:, 0], part, minlength=n)
        moment = part[:, None] * steps.sum(axis=1) / (d + 1)
        for axis in range(d):
            offset[:, axis] += np.bincount(corners[:, 0], moment[:, axis], minlength=n)
    return mass, offset


def cvt_step(
    points: FloatArray,
    topology: Topology,
    rho: FloatArray | None = None,
    *,
    inverse_volume: bool = False,
    omega: float = 1.0,
) -> tuple[FloatArray, StepStats]:
    """Move every movable vertex to the centroid of its dual cell, all at once (Remark 4.8).

    Parameters
    ----------
    points : (n, d) float64         not changed
    topology : Topology             cells of positive volume, Delaunay if Voronoi is meant
    rho : (n,) float64, optional    density at the vertices; its mean over a cell is rho_tau
    inverse_volume : bool           rho_tau = 1/|tau| (4.22)
    omega : float                   relaxation

    Returns
    -------
    points : (n, d) float64         every cell has a positive volume
    stats : StepStats

    Notes
    -----
    A vertex whose dual cell has no positive mass, or a centroid farther away than the longest edge
    of its star, stays. See :func:`dual_cells` for what is exact.
    """
    cells = topology.cells
    rho_tau = frozen_density(points, cells, rho, inverse_volume)
    mass, offset = dual_cells(points, cells, rho_tau)
    x = points[cells]
    longest = ((x[:, :, None] - x[:, None, :]) ** 2).sum(axis=3).max(axis=(1, 2))
    reach = np.zeros(len(points))
    np.maximum.at(reach, cells, np.sqrt(longest)[:, None])
    sound = mass > 0.0
    move = np.zeros_like(points)
    move[sound] = omega * offset[sound] / mass[sound, None]
    move[np.linalg.norm(move, axis=1) > reach] = 0.0
    new, reduced = guarded_move(points, topology, move)
    return new, move_stats(points, new, topology, reduced, 1.0)
