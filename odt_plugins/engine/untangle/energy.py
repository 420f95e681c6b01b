"""The regularised distortion of cells that may be inverted, with its gradient.

J is the Jacobian of the map from a reference cell to a cell, and with t = tr(J^T J)

    E = t / chi^(2/d) + weight (det(J)^2 + 1) / chi,   chi = (det(J) + sqrt(eps^2 + det(J)^2)) / 2.

chi is positive for every cell and tends to max(det(J), 0) as eps does to 0: then E is finite for
cells of positive volume only.

References
----------
V. Garanzha, I. Kaporin, L. Kudryavtseva, F. Protais, N. Ray, D. Sokolov, Foldover-free maps in 50
lines of code, ACM Trans. Graph. 40 (2021), doi:10.1145/3450626.3459847, (3) to (5).
J. M. Escobar, E. Rodriguez, R. Montenegro, G. Montero, J. M. Gonzalez-Yuste, Simultaneous
untangling and smoothing of tetrahedral meshes, CMAME 192 (2003) 2775-2787.
"""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.cells.corner import corner_edges, corner_normals
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.compiled.threads import run_ranges
from odt_plugins.engine.topology.star import OffsetArray, vertex_stars
from odt_plugins.mesh.arrays import FloatArray, IntArray, LongArray
from odt_plugins.mesh.chunks import Pool
from odt_plugins.mesh.simplex import determinant

REGULAR = {
    2: np.array([[1.0, 0.5], [0.0, math.sqrt(0.75)]]),
    3: np.array([[1.0, 0.5, 0.5], [0.0, math.sqrt(0.75), math.sqrt(1 / 12)],
                 [0.0, 0.0, math.sqrt(2 / 3)]]),
}
"""Edges at a vertex of the regular simplex with edges of length 1, one a column."""


WEIGHT = 1.0
"""Weight of the second term, which holds the volume of a cell near that of its reference."""


@kernel
def _parts(det: float, t: float, eps: float, d: int) -> tuple[float, float, float]:
    """E of a cell, its derivative in t, and that in det(J)."""
    root = math.sqrt(eps * eps + det * det)
    chi = 0.5 * (det + root) if det > 0.0 else 0.5 * eps * eps / (root - det)
    scale = 1.0 / chi if d == 2 else chi ** (-2.0 / 3.0)
    size = (det * det + 1.0) / chi
    # the derivative of chi is chi / root
    by_det = -2.0 / d * t * scale / root + WEIGHT * (2.0 * det / chi - size / root)
    return t * scale + WEIGHT * size, scale, by_det


@kernel
def _plane_terms(
    points: FloatArray, cells: IntArray, inverse: FloatArray, eps: float, energy: FloatArray,
    slope: FloatArray, dets: FloatArray, start: int, stop: int,
) -> None:
    """E, its derivatives in the vertices and det(J) of triangles start to stop."""
    for c in range(start, stop):
        i, j, k = cells[c, 0], cells[c, 1], cells[c, 2]
        ax, ay = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
        bx, by = points[k, 0] - points[i, 0], points[k, 1] - points[i, 1]
        s = inverse[c]
        # columns u, v of J = [a b] S
        ux, uy = s[0, 0] * ax + s[1, 0] * bx, s[0, 0] * ay + s[1, 0] * by
        vx, vy = s[0, 1] * ax + s[1, 1] * bx, s[0, 1] * ay + s[1, 1] * by
        det = ux * vy - uy * vx
        t = ux * ux + uy * uy + vx * vx + vy * vy
        energy[c], scale, by_det = _parts(det, t, eps, 2)
        dets[c] = det
        # dE/dJ = 2 scale J + by_det cof(J), and dE/d[a b] = dE/dJ S^T
        gx, gy = 2.0 * scale * ux + by_det * vy, 2.0 * scale * uy - by_det * vx
        hx, hy = 2.0 * scale * vx - by_det * uy, 2.0 * scale * vy + by_det * ux
        g = slope[c]
        for a in range(2):
            g[a + 1, 0] = s[a, 0] * gx + s[a, 1] * hx
            g[a + 1, 1] = s[a, 0] * gy + s[a, 1] * hy
        for x in range(2):
            g[0, x] = -g[1, x] - g[2, x]


@kernel
def _space_terms(
    points: FloatArray, cells: IntArray, inverse: FloatArray, eps: float, energy: FloatArray,
    slope: FloatArray, dets: FloatArray, start: int, stop: int,
) -> None:
    """E, its derivatives in the vertices and det(J) of tetrahedra start to stop."""
    for c in range(start, stop):
        ax, ay, az, bx, by, bz, cx, cy, cz = corner_edges(
            points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3])
        s = inverse[c]
        # columns u, v, w of J = [a b c] S
        ux = s[0, 0] * ax + s[1, 0] * bx + s[2, 0] * cx
        uy = s[0, 0] * ay + s[1, 0] * by + s[2, 0] * cy
        uz = s[0, 0] * az + s[1, 0] * bz + s[2, 0] * cz
        vx = s[0, 1] * ax + s[1, 1] * bx + s[2, 1] * cx
        vy = s[0, 1] * ay + s[1, 1] * by + s[2, 1] * cy
        vz = s[0, 1] * az + s[1, 1] * bz + s[2, 1] * cz
        wx = s[0, 2] * ax + s[1, 2] * bx + s[2, 2] * cx
        wy = s[0, 2] * ay + s[1, 2] * by + s[2, 2] * cy
        wz = s[0, 2] * az + s[1, 2] * bz + s[2, 2] * cz
        px, py, pz, qx, qy, qz, rx, ry, rz = corner_normals(ux, uy, uz, vx, vy, vz, wx, wy, wz)
        det = ux * px + uy * py + uz * pz
        t = (ux * ux + uy * uy + uz * uz + vx * vx + vy * vy + vz * vz
             + wx * wx + wy * wy + wz * wz)
        energy[c], scale, by_det = _parts(det, t, eps, 3)
        dets[c] = det
        # dE/dJ = 2 scale J + by_det cof(J), and dE/d[a b c] = dE/dJ S^T
        f = 2.0 * scale
        gx, gy, gz = f * ux + by_det * px, f * uy + by_det * py, f * uz + by_det * pz
        hx, hy, hz = f * vx + by_det * qx, f * vy + by_det * qy, f * vz + by_det * qz
        kx, ky, kz = f * wx + by_det * rx, f * wy + by_det * ry, f * wz + by_det * rz
        g = slope[c]
        for a in range(3):
            g[a + 1, 0] = s[a, 0] * gx + s[a, 1] * hx + s[a, 2] * kx
            g[a + 1, 1] = s[a, 0] * gy + s[a, 1] * hy + s[a, 2] * ky
            g[a + 1, 2] = s[a, 0] * gz + s[a, 1] * hz + s[a, 2] * kz
        for x in range(3):
            g[0, x] = -g[1, x] - g[2, x] - g[3, x]


@kernel
def _gather(
    cells: IntArray, slope: FloatArray, free: LongArray, indptr: OffsetArray, indices: IntArray,
    out: FloatArray, start: int, stop: int,
) -> None:
    """Add up the derivatives of all cells at free vertices start to stop, in order of the cells."""
    for a in range(start, stop):
        v = free[a]
        out[a, :] = 0.0
        for s in range(indptr[v], indptr[v + 1]):
            c = indices[s]
            for k in range(cells.shape[1]):
                if cells[c, k] == v:
                    for x in range(out.shape[1]):
                        out[a, x] += slope[c, k, x]


class Distortion:
    """The sum of E over cells as a function of the places of the free vertices.

    Parameters
    ----------
    points : (n, d) float64            places of all vertices; a copy is moved
    cells : (m, d + 1) int32
    free : (k,) int64                  vertices that move
    reference : (m, d, d) float64      edges of the reference cell of every cell at its first
                                       vertex, one a column; det > 0
    pool : Pool, optional
        shares the work; no value depends on it

    Attributes
    ----------
    dets : (m,) float64                det(J) of every cell at the last place that was asked for
    calls : int                        how often the sum was computed
    """

    def __init__(
        self, points: FloatArray, cells: IntArray, free: LongArray, reference: FloatArray,
        pool: Pool | None = None,
    ) -> None:
        m, d = len(cells), points.shape[1]
        self.points, self.cells, self.free, self.pool = points.copy(), cells, free, pool
        self.inverse = np.ascontiguousarray(inverses(reference))
        self.stars = vertex_stars(cells, len(points), pool)
        self.energy, self.dets, self.slope = np.empty(m), np.empty(m), np.empty((m, d + 1, d))
        self.terms = _plane_terms if d == 2 else _space_terms
        self.calls = 0

    def __call__(self, x: FloatArray, eps: float) -> tuple[float, FloatArray]:
        """Sum and gradient (k, d) with the free vertices at x (k, d)."""
        self.calls += 1
        self.points[self.free] = x
        run_ranges(self.pool, len(self.cells), lambda *part: self.terms(
            self.points, self.cells, self.inverse, eps, self.energy, self.slope, self.dets, *part))
        out = np.empty_like(x)
        run_ranges(self.pool, len(x), lambda *part: _gather(
            self.cells, self.slope, self.free, *self.stars, out, *part))
        return float(self.energy.sum()), out


def inverses(matrices: FloatArray) -> FloatArray:
    """Inverses of matrices (m, d, d), d = 2 or 3, by cofactors."""
    a = np.moveaxis(matrices, 0, -1)
    if len(a) == 2:
        adjoint = np.array([[a[1, 1], -a[0, 1]], [-a[1, 0], a[0, 0]]])
    else:
        u, v, w = a[:, 0], a[:, 1], a[:, 2]
        adjoint = np.array([np.cross(v, w, axis=0), np.cross(w, u, axis=0), np.cross(u, v, axis=0)])
    return np.asarray(np.moveaxis(adjoint / determinant(a), -1, 0))
