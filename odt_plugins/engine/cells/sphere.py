"""Circumspheres of tetrahedra: which facets are not locally Delaunay (Section 3.1)."""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.corner import corner_normals
from odt_plugins.engine.cells.metric import has_metric, seen_edges, tet_root, through
from odt_plugins.engine.cells.rows import (
    AX,
    AY,
    AZ,
    BX,
    BY,
    BZ,
    CHUNK,
    CX,
    CY,
    CZ,
    GX,
    GY,
    GZ,
    ROWS,
    XX,
    Q,
    gather_edges,
)
from odt_plugins.engine.compiled.kernel import allocating_kernel, inlined_kernel, kernel
from odt_plugins.engine.topology.active import PENDING
from odt_plugins.mesh.arrays import ByteArray, FloatArray, IntArray

ROUNDING = 1e-9
"""A point is on the sphere when the test is below this part of (longest edge)^5."""


@kernel
def circumsphere(
    points: FloatArray, i: int, j: int, k: int, l: int
) -> tuple[float, float, float, float, float]:
    """Sphere of tetrahedron (i, j, k, l), as :func:`inside_sphere` wants it.

    Returns
    -------
    det : float            six times the volume
    gx, gy, gz : float     2 det (centre - x_i)
    size : float           longest squared edge at x_i
    """
    return sphere_of_edges(*seen_edges(points, i, j, k, l))


@inlined_kernel
def sphere_of_edges(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float, cx: float, cy: float,
    cz: float,
) -> tuple[float, float, float, float, float]:
    """As :func:`circumsphere`, from the edges at x_i."""
    aa = ax * ax + ay * ay + az * az
    bb = bx * bx + by * by + bz * bz
    cc = cx * cx + cy * cy + cz * cz
    px, py, pz, qx, qy, qz, rx, ry, rz = corner_normals(
        ax, ay, az, bx, by, bz, cx, cy, cz
    )
    gx = aa * px + bb * qx + cc * rx
    gy = aa * py + bb * qy + cc * ry
    gz = aa * pz + bb * qz + cc * rz
    return ax * px + ay * py + az * pz, gx, gy, gz, max(max(aa, bb), cc)


@kernel
def inside_sphere(
    points: FloatArray, cells: IntArray, c: int, v: int, det: float, gx: float, gy: float,
    gz: float, size: float,
) -> bool:
    """Whether point v is inside the :func:`circumsphere` of cell c, by more than rounding.

    With y = x_v - x_i that is |y|^2 < 2 y . (centre - x_i).
    """
    i = cells[c, 0]
    x = points[v, 0] - points[i, 0]
    y = points[v, 1] - points[i, 1]
    z = points[v, 2] - points[i, 2]
    if has_metric(points):
        root = tet_root(points, i, cells[c, 1], cells[c, 2], cells[c, 3])
        x, y, z = through(root, x, y, z)
    square = x * x + y * y + z * z
    test = det * square - (gx * x + gy * y + gz * z)
    if not test < 0.0:
        return False
    size = max(size, square)
    return test < -ROUNDING * size * size * np.sqrt(size)


@kernel
def apex_across(cells: IntArray, c: int, f: int, across: int) -> np.int32:
    """Vertex of the cell across facet f of cell c that is not on the facet.

    All others of the two cells' vertices but cells[c, f] are there twice, so they cancel.
    """
    return np.int32(
        cells[c, 0] ^ cells[c, 1] ^ cells[c, 2] ^ cells[c, 3] ^ cells[c, f]
        ^ cells[across, 0] ^ cells[across, 1] ^ cells[across, 2] ^ cells[across, 3]
    )


@kernel
def _sphere_rows(count: int, rows: FloatArray) -> None:
    """Write the spheres of :func:`circumsphere` from the rows of ``gather_edges``."""
    for s in range(count):
        det, gx, gy, gz, size = sphere_of_edges(
            rows[AX + s], rows[AY + s], rows[AZ + s], rows[BX + s], rows[BY + s], rows[BZ + s],
            rows[CX + s], rows[CY + s], rows[CZ + s],
        )
        rows[Q + s], rows[GX + s], rows[GY + s], rows[GZ + s] = det, gx, gy, gz
        rows[XX + s] = size


@allocating_kernel
def mark_non_delaunay(
    points: FloatArray, cells: IntArray, neighbors: IntArray, regions: IntArray,
    status: ByteArray, start: int, stop: int,
) -> int:
    """Make the cells of slots start to stop pending that have a facet that is not Delaunay.

    Of the two cells at a facet the one in the lower slot is taken.  Returns their number.
    """
    rows = np.empty(ROWS)
    slots, facets = np.empty(CHUNK, np.int32), np.empty(4 * CHUNK, np.int64)
    found = 0
    for first in range(start, stop, CHUNK):
        count = min(CHUNK, stop - first)
        for s in range(count):
            slots[s] = first + s
        gather_edges(points, cells, slots, 0, count, rows)
        _sphere_rows(count, rows)
        n_facets = 0
        for c in range(first, first + count):
            last = c if cells[c, 0] >= 0 else cells.shape[0]
            for f in range(4):
                facets[n_facets] = 4 * c + f
                n_facets += neighbors[c, f] > last
        marked = -1
        for m in range(n_facets):
            c, f = facets[m] >> 2, facets[m] & 3
            across = neighbors[c, f]
            if c == marked or regions[across] != regions[c]:
                continue
            v = apex_across(cells, c, f, across)
            u = c - first
            if inside_sphere(
                points, cells, c, v, rows[Q + u], rows[GX + u], rows[GY + u],
                rows[GZ + u], rows[XX + u],
            ):
                status[c] = PENDING
                marked = c
                found += 1
    return found
