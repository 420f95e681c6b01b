"""Gradients that drive whole-mesh steps, (4.11) and (4.19), in one pass over the cells."""

from __future__ import annotations

from typing import Literal

import numpy as np

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.topology.stencil import Topology
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray


@kernel
def _add_pulls(
    points: FloatArray,
    cells: IntArray,
    rho: FloatArray,
    barycentric: BoolArray,
    out: FloatArray,
) -> None:
    """Add rho_tau |tau| (x_i - c_tau) of every cell to its vertices.

    Offsets are taken from x_0. With the other corners a, b, e and det = d! |tau|,
    c - x_0 = moment / (2 det): |tau| cancels the division, so flat cells do no harm.
    """
    m, k = cells.shape
    d = k - 1
    for t in range(m):
        o = cells[t, 0]
        j = cells[t, 1]
        n = cells[t, 2]
        central = barycentric[o] or barycentric[j] or barycentric[n]
        ax, ay = points[j, 0] - points[o, 0], points[j, 1] - points[o, 1]
        bx, by = points[n, 0] - points[o, 0], points[n, 1] - points[o, 1]
        aa = ax * ax + ay * ay
        bb = bx * bx + by * by
        if d == 2:
            scale = 0.5 * rho[t]
            det = ax * by - ay * bx
            if central:
                cx, cy = det * (ax + bx) / 3.0, det * (ay + by) / 3.0
            else:
                cx, cy = 0.5 * (aa * by - bb * ay), 0.5 * (bb * ax - aa * bx)
            cz = 0.0
        else:
            last = cells[t, 3]
            central = central or barycentric[last]
            az, bz = points[j, 2] - points[o, 2], points[n, 2] - points[o, 2]
            ex, ey = points[last, 0] - points[o, 0], points[last, 1] - points[o, 1]
            ez = points[last, 2] - points[o, 2]
            aa += az * az
            bb += bz * bz
            ee = ex * ex + ey * ey + ez * ez
            px, py, pz = by * ez - bz * ey, bz * ex - bx * ez, bx * ey - by * ex
            qx, qy, qz = ey * az - ez * ay, ez * ax - ex * az, ex * ay - ey * ax
            rx, ry, rz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            scale = rho[t] / 6.0
            det = ax * px + ay * py + az * pz
            if central:
                cx = 0.25 * det * (ax + bx + ex)
                cy = 0.25 * det * (ay + by + ey)
                cz = 0.25 * det * (az + bz + ez)
            else:
                cx = 0.5 * (aa * px + bb * qx + ee * rx)
                cy = 0.5 * (aa * py + bb * qy + ee * ry)
                cz = 0.5 * (aa * pz + bb * qz + ee * rz)
        for corner in range(k):
            v = cells[t, corner]
            out[v, 0] += scale * (det * (points[v, 0] - points[o, 0]) - cx)
            out[v, 1] += scale * (det * (points[v, 1] - points[o, 1]) - cy)
            if d == 3:
                out[v, 2] += scale * (det * (points[v, 2] - points[o, 2]) - cz)


def step_gradient(
    points: FloatArray,
    topology: Topology,
    rho_tau: FloatArray,
    method: Literal["odt", "cpt"],
    boundary_rule: bool,
) -> FloatArray:
    """Gradient that drives a step: (4.11) for "odt", (4.19) for "cpt".

    With the boundary rule of Section 4.2.1 boundary elements use barycenters in "odt" too.

    Parameters
    ----------
    points : (n, d) float64
    topology : Topology
    rho_tau : (m,) float64          density of every cell
    method : {"odt", "cpt"}
    boundary_rule : bool

    Returns
    -------
    (n, d) float64                  2/(d + 1) sum_tau (x_i - c_tau) rho_tau |tau|
    """
    if method == "odt" and boundary_rule:
        barycentric = topology.is_boundary
    else:
        barycentric = np.full(len(points), method == "cpt")
    out = np.zeros_like(points)
    rho_tau = np.ascontiguousarray(rho_tau, dtype=np.float64)
    _add_pulls(points, topology.cells, rho_tau, barycentric, out)
    out *= 2.0 / topology.cells.shape[1]
    return out
