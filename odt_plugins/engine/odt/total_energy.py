"""The ODT energy of a whole mesh in one pass, for the rounds of the driver."""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.corner import six_volumes
from odt_plugins.engine.cells.metric import has_metric, seen_edges
from odt_plugins.engine.cells.triangle import squares as edge_squares
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.compiled.threads import run_ranges
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.chunks import Pool


@kernel
def _sum_energy(points: FloatArray, cells: IntArray, rho: FloatArray, of_cells: bool) -> float:
    """Sum (2.2) over the cells; rho is that of cells, or of vertices, whose mean is taken.

    The squares of all edges sum up to (d + 1) sum |e|^2 - |sum e|^2 over the edges e at a corner.
    """
    m, k = cells.shape
    d = k - 1
    total = 0.0
    for c in range(m):
        if cells[c, 0] < 0:
            continue
        weight = k * rho[c] if of_cells else 0.0
        if not of_cells:
            for a in range(k):
                weight += rho[cells[c, a]]
        o, i, j = cells[c, 0], cells[c, 1], cells[c, 2]
        if d == 2 and has_metric(points):
            uu, vv, ww, square = edge_squares(points, o, i, j)
            volume = 0.5 * np.sqrt(abs(square))
            squares = uu + vv + ww
        elif d == 2:
            ax, ay = points[i, 0] - points[o, 0], points[i, 1] - points[o, 1]
            bx, by = points[j, 0] - points[o, 0], points[j, 1] - points[o, 1]
            volume = 0.5 * (ax * by - ay * bx)
            squares = 3.0 * (ax * ax + ay * ay + bx * bx + by * by)
            squares -= (ax + bx) ** 2 + (ay + by) ** 2
        else:
            ax, ay, az, bx, by, bz, ex, ey, ez = seen_edges(points, o, i, j, cells[c, 3])
            volume = six_volumes(ax, ay, az, bx, by, bz, ex, ey, ez) / 6.0
            squares = 4.0 * (
                ax * ax + ay * ay + az * az + bx * bx + by * by + bz * bz
                + ex * ex + ey * ey + ez * ez
            )
            squares -= (ax + bx + ex) ** 2 + (ay + by + ey) ** 2 + (az + bz + ez) ** 2
        total += volume * squares * weight / k
    return total / ((d + 1) * (d + 2))


def total_energy(
    points: FloatArray, cells: IntArray, rho: FloatArray, pool: Pool | None = None
) -> float:
    """ODT energy (2.2) with the mean of the vertex densities on every cell.

    Parameters
    ----------
    points : (n, d) float64
    cells : (m, d + 1) int32    a row that starts with -1 is a free slot and is left out
    rho : (n,) float64          density at the vertices
    pool                     see ``threads.run_ranges``

    Returns
    -------
    float                    equal to ``energy(points, cells, cell_density(cells, rho))``
    """
    def work(start: int, stop: int) -> float:
        return float(_sum_energy(points, cells[start:stop], rho, False))

    return sum(run_ranges(pool, len(cells), work))


def frozen_energy(points: FloatArray, cells: IntArray, rho_tau: FloatArray) -> float:
    """ODT energy (2.2) with a density that belongs to the cells.

    Parameters
    ----------
    points : (n, d) float64, cells : (m, d + 1) int32
    rho_tau : (m,) float64   density of every cell

    Returns
    -------
    float                    equal to ``energy(points, cells, rho_tau)``
    """
    return float(_sum_energy(points, cells, rho_tau, True))
