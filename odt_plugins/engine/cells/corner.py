"""The three edges a, b, c at a corner of a tetrahedron, and their products.

All measures of a tetrahedron are functions of these edges, or of what ``metric`` makes of them.
"""

from __future__ import annotations

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.mesh.arrays import FloatArray

Edges = tuple[float, float, float, float, float, float, float, float, float]
"""(a, b, c), one coordinate after another."""


@kernel
def corner_edges(
    points: FloatArray, i: int, j: int, k: int, l: int
) -> Edges:
    """Edges a = x_j - x_i, b = x_k - x_i and c = x_l - x_i, one coordinate after another."""
    x = points[i, 0]
    y = points[i, 1]
    z = points[i, 2]
    return (
        points[j, 0] - x, points[j, 1] - y, points[j, 2] - z,
        points[k, 0] - x, points[k, 1] - y, points[k, 2] - z,
        points[l, 0] - x, points[l, 1] - y, points[l, 2] - z,
    )


@kernel
def corner_normals(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float, cx: float, cy: float,
    cz: float,
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Normals b x c, c x a and a x b of the faces at the corner, inward, twice their areas long.

    Their sum is minus that of the opposite face.
    """
    return (
        by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx,
        cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax,
        ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx,
    )


@kernel
def opposite_edges(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float, cx: float, cy: float,
    cz: float,
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Edges b - c, c - a and a - b of the face opposite to the corner; each opposite to a, b, c."""
    return bx - cx, by - cy, bz - cz, cx - ax, cy - ay, cz - az, ax - bx, ay - by, az - bz


@kernel
def six_volumes(
    ax: float, ay: float, az: float, bx: float, by: float, bz: float, cx: float, cy: float,
    cz: float,
) -> float:
    """Six times the signed volume, a . (b x c)."""
    return ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
