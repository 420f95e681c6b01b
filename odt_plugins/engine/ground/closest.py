"""The point of a triangle, and of a surface near a known triangle, that is closest to a point."""

from __future__ import annotations

from typing import NamedTuple

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.topology.star import OffsetArray
from odt_plugins.mesh.arrays import FloatArray, IntArray

STEPS = 256
"""Most triangles that one walk visits."""

CLOSER = 1.0 - 1e-14
"""A walk goes on while the squared distance falls below this part of it."""


FLAT = 1e-9
"""A triangle is flat when its squared double area is below this part of its edges to the fourth."""


class Ground(NamedTuple):
    """The input surface, as the kernels see it.

    Attributes
    ----------
    points : (n, 3) float64
    triangles : (m, 3) int32       degenerate ones are allowed
    neighbors : (m, 3) int32       triangle across the edge opposite to a corner; -1 at the boundary
                                   and at edges of more than two triangles
    indptr : (n + 1,) int64, indices : (3 m,) int32     stars
    normals : (m, 3) float64       unit normals, averaged with the neighbours on the same side
                                   of every feature edge
    """

    points: FloatArray
    triangles: IntArray
    neighbors: IntArray
    indptr: OffsetArray
    indices: IntArray
    normals: FloatArray


@kernel
def closest_on_triangle(
    px: float, py: float, pz: float, points: FloatArray, a: int, b: int, c: int
) -> tuple[float, int, float, float, float]:
    """Closest point of the triangle (a, b, c), which may be degenerate.

    Returns
    -------
    squared distance : float
    where : int                  0 inside, 1 + i on the edge opposite to corner i, 4 + i at corner i
    x, y, z : float

    References
    ----------
    C. Ericson, Real-Time Collision Detection (2005), Section 5.1.5: the Voronoi regions of the
    corners, the edges and the face. On a flat triangle rounding confuses the regions, so the
    closest point of its three edges counts where it is closer.
    """
    ax, ay, az = points[a, 0], points[a, 1], points[a, 2]
    ux, uy, uz = points[b, 0] - ax, points[b, 1] - ay, points[b, 2] - az
    vx, vy, vz = points[c, 0] - ax, points[c, 1] - ay, points[c, 2] - az
    px -= ax
    py -= ay
    pz -= az
    up = ux * px + uy * py + uz * pz
    vp = vx * px + vy * py + vz * pz
    uu = ux * ux + uy * uy + uz * uz
    vv = vx * vx + vy * vy + vz * vz
    uv = ux * vx + uy * vy + uz * vz
    # scalar products of the edges from a with the offsets from b and from c
    up_b, vp_b = up - uu, vp - uv
    up_c, vp_c = up - uv, vp - vv
    s = 0.0
    t = 0.0
    across_a = up_b * vp_c - up_c * vp_b
    across_b = up_c * vp - up * vp_c
    across_c = up * vp_b - up_b * vp
    if up <= 0.0 and vp <= 0.0:
        where = 4
    elif up_b >= 0.0 and vp_b <= up_b:
        where = 5
        s = 1.0
    elif vp_c >= 0.0 and up_c <= vp_c:
        where = 6
        t = 1.0
    elif across_c <= 0.0 and up >= 0.0 and up_b <= 0.0:
        where = 3
        s = up / (up - up_b) if up > up_b else 0.0
    elif across_b <= 0.0 and vp >= 0.0 and vp_c <= 0.0:
        where = 2
        t = vp / (vp - vp_c) if vp > vp_c else 0.0
    elif across_a <= 0.0 and vp_b >= up_b and up_c >= vp_c:
        where = 1
        share = (vp_b - up_b) + (up_c - vp_c)
        t = (vp_b - up_b) / share if share > 0.0 else 0.0
        s = 1.0 - t
    else:
        where = 0
        total = across_a + across_b + across_c
        if total > 0.0:
            s = across_b / total
            t = across_c / total
    x = s * ux + t * vx
    y = s * uy + t * vy
    z = s * uz + t * vz
    best = (px - x) ** 2 + (py - y) ** 2 + (pz - z) ** 2
    if uu * vv - uv * uv <= FLAT * (uu + vv) ** 2:
        for i in range(3):
            jx, jy, jz, kx, ky, kz = ux, uy, uz, vx, vy, vz
            if i == 1:
                jx, jy, jz, kx, ky, kz = vx, vy, vz, 0.0, 0.0, 0.0
            elif i == 2:
                jx, jy, jz, kx, ky, kz = 0.0, 0.0, 0.0, ux, uy, uz
            kx -= jx
            ky -= jy
            kz -= jz
            length = kx * kx + ky * ky + kz * kz
            w = 0.0
            if length > 0.0:
                w = ((px - jx) * kx + (py - jy) * ky + (pz - jz) * kz) / length
                w = min(max(w, 0.0), 1.0)
            jx += w * kx
            jy += w * ky
            jz += w * kz
            d = (px - jx) ** 2 + (py - jy) ** 2 + (pz - jz) ** 2
            if d < best:
                best, x, y, z = d, jx, jy, jz
                where = 1 + i
                if w == 0.0:
                    where = 4 + (i + 1) % 3
                elif w == 1.0:
                    where = 4 + (i + 2) % 3
    return best, where, ax + x, ay + y, az + z


@kernel
def walk(
    px: float, py: float, pz: float, face: int, ground: Ground, thorough: bool
) -> tuple[float, int, float, float, float]:
    """Walk over the ground from one triangle to another as long as the distance falls.

    Parameters
    ----------
    px, py, pz : float     the point
    face : int             triangle to start from
    ground : Ground
    thorough : bool        look at the whole ring of a triangle before the walk ends there: on the
                           hollow side several triangles of one fan hold a local minimum

    Returns
    -------
    squared distance : float
    face : int             where the walk ended
    x, y, z : float        the point of that triangle that is closest; no triangle across the edge
                           or around the corner on which it lies is closer, and if ``thorough``
                           none that shares a corner with its own: in general the sheet of the
                           surface that the start lies on
    """
    best, where, x, y, z = _on(ground, face, px, py, pz)
    for _ in range(STEPS):
        found = -1
        if 0 < where < 4:
            near = ground.neighbors[face, where - 1]
            if near >= 0:
                d, w, cx, cy, cz = _on(ground, near, px, py, pz)
                if d < CLOSER * best:
                    found, best, where, x, y, z = near, d, w, cx, cy, cz
        if found < 0 and (thorough or where > 3):
            at = where - 4
            for i in range(3):
                if not thorough and i != at:
                    continue
                corner = ground.triangles[face, i]
                for s in range(ground.indptr[corner], ground.indptr[corner + 1]):
                    near = ground.indices[s]
                    if near != face:
                        d, w, cx, cy, cz = _on(ground, near, px, py, pz)
                        if d < CLOSER * best:
                            found, best, where, x, y, z = near, d, w, cx, cy, cz
        if found < 0:
            break
        face = found
    return best, face, x, y, z


@kernel
def _on(
    ground: Ground, face: int, px: float, py: float, pz: float
) -> tuple[float, int, float, float, float]:
    """Closest point of one triangle of the ground."""
    t = ground.triangles
    return closest_on_triangle(px, py, pz, ground.points, t[face, 0], t[face, 1], t[face, 2])
