"""Scalar measures of one tetrahedron, for the kernels that move vertices and flip."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.corner import (
    corner_edges,
    corner_normals,
    opposite_edges,
    six_volumes,
)
from odt_plugins.engine.cells.dihedral import six_cosines, tet_dihedral
from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.cells.mean_ratio import tet_mean_ratio
from odt_plugins.engine.cells.step import tet_step
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.mesh.arrays import FloatArray, IntArray

ENERGY = 0
QUALITY = 1
MEAN_RATIO = 2
DIHEDRAL = 3
STEP = 4
"""What a cell costs: the ODT energy, or (1/m)^p with one of the cell measures m."""


class Cost(NamedTuple):
    """What a cell costs.

    Attributes
    ----------
    objective : int    ENERGY, or the measure m in the cost
    power : float      exponent p of that cost; without meaning for the energy
    """

    objective: int
    power: float


SHIFT = 0.005
"""Cells much flatter than this are no longer worth their neighbours: the cost levels off there."""


@kernel
def quality_cost(q: float, power: float) -> float:
    """Cost ((1 + s)/(q + s))^power of a cell with the measure q, s = SHIFT; 1 for the best.

    The powers in use need no general power function.
    """
    q = (q + SHIFT) / (1.0 + SHIFT)
    if power == 0.5:
        return 1.0 / math.sqrt(q)
    if power == 1.0:
        return 1.0 / q
    square = 1.0 / (q * q)
    if power == 2.0:
        return square
    if power == 4.0:
        return square * square
    if power == 8.0:
        square *= square
        return square * square
    return q**-power


@kernel
def opposite_vertices(cells: IntArray, c: int, v: int) -> tuple[int, int, int]:
    """The other three vertices of cell c, such that (v, i, j, k) is positive."""
    if cells[c, 0] == v:
        return cells[c, 1], cells[c, 2], cells[c, 3]
    if cells[c, 1] == v:
        return cells[c, 0], cells[c, 3], cells[c, 2]
    if cells[c, 2] == v:
        return cells[c, 0], cells[c, 1], cells[c, 3]
    return cells[c, 0], cells[c, 2], cells[c, 1]


@kernel
def tet_quality(points: FloatArray, i: int, j: int, k: int, l: int) -> float:
    """Radius ratio 3 r/R (Section 5) of tetrahedron (i, j, k, l); negative if inverted.

    With g_a the inward face normals of length twice the area, V = det/6 and H the Heron form of
    the products of opposite edges, 24 V R = sqrt(H), so 3 r/R = 12 det^2 / (sum |g_a| sqrt(H)).
    """
    ax, ay, az, bx, by, bz, cx, cy, cz = corner_edges(points, i, j, k, l)
    g1x, g1y, g1z, g2x, g2y, g2z, g3x, g3y, g3z = corner_normals(
        ax, ay, az, bx, by, bz, cx, cy, cz
    )
    det = ax * g1x + ay * g1y + az * g1z
    g0x = g1x + g2x + g3x
    g0y = g1y + g2y + g3y
    g0z = g1z + g2z + g3z
    s = (
        math.sqrt(g0x * g0x + g0y * g0y + g0z * g0z)
        + math.sqrt(g1x * g1x + g1y * g1y + g1z * g1z)
        + math.sqrt(g2x * g2x + g2y * g2y + g2z * g2z)
        + math.sqrt(g3x * g3x + g3y * g3y + g3z * g3z)
    )
    ux, uy, uz, vx, vy, vz, wx, wy, wz = opposite_edges(ax, ay, az, bx, by, bz, cx, cy, cz)
    p1 = math.sqrt((ax * ax + ay * ay + az * az) * (ux * ux + uy * uy + uz * uz))
    p2 = math.sqrt((bx * bx + by * by + bz * bz) * (vx * vx + vy * vy + vz * vz))
    p3 = math.sqrt((cx * cx + cy * cy + cz * cz) * (wx * wx + wy * wy + wz * wz))
    h = (p1 + p2 + p3) * (p1 + p2 - p3) * (p2 + p3 - p1) * (p3 + p1 - p2)
    if not (h > 0.0 and s > 0.0):
        return -1.0 if det <= 0.0 else 0.0
    q = 12.0 * det * det / (s * math.sqrt(h))
    return q if det > 0.0 else -q


@kernel
def tet_energy(points: FloatArray, i: int, j: int, k: int, l: int) -> float:
    """20 times the ODT energy (2.2) of tetrahedron (i, j, k, l); infinite if not positive."""
    ax, ay, az, bx, by, bz, cx, cy, cz = corner_edges(points, i, j, k, l)
    det = six_volumes(ax, ay, az, bx, by, bz, cx, cy, cz)
    aa = ax * ax + ay * ay + az * az
    bb = bx * bx + by * by + bz * bz
    cc = cx * cx + cy * cy + cz * cz
    mixed = ax * bx + ay * by + az * bz + bx * cx + by * cy + bz * cz + cx * ax + cy * ay + cz * az
    t = 3.0 * (aa + bb + cc) - 2.0 * mixed
    if not det > 1e-10 * t * math.sqrt(t):
        return np.inf
    return det * t / 6.0


@kernel
def tet_cosines(points: FloatArray, i: int, j: int, k: int, l: int) -> tuple[float, float]:
    """Largest and smallest cosine of the six dihedral angles: (of the smallest, of the largest)."""
    _, c01, c02, c03, c12, c13, c23 = six_cosines(points, i, j, k, l)
    return (
        max(max(max(c01, c02), max(c03, c12)), max(c13, c23)),
        min(min(min(c01, c02), min(c03, c12)), min(c13, c23)),
    )


@kernel
def tet_measure(points: FloatArray, i: int, j: int, k: int, l: int, objective: int) -> float:
    """Measure of one cell for an objective that is not the energy; not positive if inverted."""
    if objective == QUALITY:
        return tet_quality(points, i, j, k, l)
    if objective == MEAN_RATIO:
        return tet_mean_ratio(points, i, j, k, l)
    if objective == STEP:
        return tet_step(points, i, j, k, l)
    return tet_dihedral(points, i, j, k, l)


@kernel
def tet_cost(points: FloatArray, i: int, j: int, k: int, l: int, cost: Cost) -> float:
    """Cost of tetrahedron (i, j, k, l): ODT energy or that of its measure; infinite if inverted."""
    if cost.objective == QUALITY:
        m = tet_quality(points, i, j, k, l)
    elif cost.objective == ENERGY:
        return tet_energy(points, i, j, k, l)
    else:
        m = tet_measure(points, i, j, k, l, cost.objective)
    if m <= 1e-9:
        return np.inf
    return quality_cost(m, cost.power)


@kernel
def cell_cost(points: FloatArray, cells: IntArray, c: int, cost: Cost) -> float:
    """:func:`tet_cost` of cell c."""
    return tet_cost(points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3], cost)


@kernel
def cell_extremes(points: FloatArray, cells: IntArray, c: int) -> Extremes:
    """Radius ratio of cell c, largest and smallest cosine of its dihedral angles."""
    i, j, k, l = cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3]
    large, small = tet_cosines(points, i, j, k, l)
    return Extremes(tet_quality(points, i, j, k, l), large, small)
