"""Radius ratio, energy and angles of one tetrahedron, from the edges at its first vertex."""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.cells.corner import (
    Edges,
    corner_normals,
    opposite_edges,
    six_volumes,
)
from odt_plugins.engine.cells.dihedral import six_cosines
from odt_plugins.engine.cells.metric import seen_edges
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.mesh.arrays import FloatArray, IntArray


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
def edges_quality(edges: Edges) -> float:
    """Radius ratio 3 r/R (Section 5) of a tetrahedron; negative if inverted.

    With g_a the inward face normals of length twice the area, V = det/6 and H the Heron form of
    the products of opposite edges, 24 V R = sqrt(H), so 3 r/R = 12 det^2 / (sum |g_a| sqrt(H)).
    """
    ax, ay, az, bx, by, bz, cx, cy, cz = edges
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
def tet_energy(edges: Edges) -> float:
    """20 times the ODT energy (2.2) of a tetrahedron; infinite if not positive."""
    ax, ay, az, bx, by, bz, cx, cy, cz = edges
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
def tet_cosines(edges: Edges) -> tuple[float, float]:
    """Largest and smallest cosine of the six dihedral angles: (of the smallest, of the largest)."""
    _, c01, c02, c03, c12, c13, c23 = six_cosines(edges)
    return (
        max(max(max(c01, c02), max(c03, c12)), max(c13, c23)),
        min(min(min(c01, c02), min(c03, c12)), min(c13, c23)),
    )


@kernel
def tet_quality(points: FloatArray, i: int, j: int, k: int, l: int) -> float:
    """:func:`edges_quality` of tetrahedron (i, j, k, l)."""
    return edges_quality(seen_edges(points, i, j, k, l))
