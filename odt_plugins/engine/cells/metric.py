"""The metric's door: edges of a cell as they are seen through it.

Rows of points are the coordinates alone, or the coordinates and behind them the upper triangle of
S = M^(1/2), the root of the metric at the vertex. M is half the Hessian of the convex function u of
the energy (after Definition 2.5): for u = |x|^2, the isotropic case, there are no further columns
and edges are what they are. Otherwise an edge e of a cell is seen as S e with the mean of S at the
vertices of the cell; where M is constant, its length is sqrt(e . M e), and every measure is that of
the affine image. In the plane the columns are S_xx, S_xy, S_yy, in space S_xx, S_xy, S_xz, S_yy,
S_yz, S_zz. The mean of S is that of inverse lengths along every direction.
"""

from __future__ import annotations

from odt_plugins.engine.cells.corner import Edges, corner_edges
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.mesh.arrays import FloatArray

Root = tuple[float, float, float, float, float, float]
"""S_xx, S_xy, S_xz, S_yy, S_yz, S_zz; in the plane those with z are 0."""


@kernel
def has_metric(points: FloatArray) -> bool:
    """Whether the rows hold a metric behind the coordinates."""
    return points.shape[1] > 3


@kernel
def in_space(points: FloatArray) -> bool:
    """Whether the coordinates are three."""
    return points.shape[1] == 3 or points.shape[1] == 9


@kernel
def vertex_root(points: FloatArray, i: int) -> Root:
    """S at a vertex."""
    if points.shape[1] == 5:
        return points[i, 2], points[i, 3], 0.0, points[i, 4], 0.0, 0.0
    return (points[i, 3], points[i, 4], points[i, 5], points[i, 6], points[i, 7], points[i, 8])


@kernel
def _sum(one: Root, two: Root) -> Root:
    a, b, c, d, e, f = one
    p, q, r, s, t, u = two
    return a + p, b + q, c + r, d + s, e + t, f + u


@kernel
def tet_root(points: FloatArray, i: int, j: int, k: int, l: int) -> Root:
    """Mean of S at the vertices of a tetrahedron."""
    one, two = _sum(vertex_root(points, i), vertex_root(points, j)), vertex_root(points, k)
    a, b, c, d, e, f = _sum(_sum(one, two), vertex_root(points, l))
    return 0.25 * a, 0.25 * b, 0.25 * c, 0.25 * d, 0.25 * e, 0.25 * f


@kernel
def triangle_root(points: FloatArray, i: int, j: int, k: int) -> Root:
    """Mean of S at the vertices of a triangle."""
    one = _sum(vertex_root(points, i), vertex_root(points, j))
    a, b, c, d, e, f = _sum(one, vertex_root(points, k))
    return a / 3.0, b / 3.0, c / 3.0, d / 3.0, e / 3.0, f / 3.0


@kernel
def through(root: Root, x: float, y: float, z: float) -> tuple[float, float, float]:
    """S (x, y, z)."""
    a, b, c, d, e, f = root
    return a * x + b * y + c * z, b * x + d * y + e * z, c * x + e * y + f * z


@kernel
def root_volume(root: Root) -> float:
    """Determinant of S in space: how many times as large volumes are seen."""
    a, b, c, d, e, f = root
    return a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)


@kernel
def seen_edges(points: FloatArray, i: int, j: int, k: int, l: int) -> Edges:
    """The edges of :func:`corner_edges` as they are seen."""
    edges = corner_edges(points, i, j, k, l)
    if not has_metric(points):
        return edges
    return edges_through(tet_root(points, i, j, k, l), edges)


@kernel
def edges_through(root: Root, edges: Edges) -> Edges:
    """S a, S b and S c."""
    ax, ay, az, bx, by, bz, cx, cy, cz = edges
    ax, ay, az = through(root, ax, ay, az)
    bx, by, bz = through(root, bx, by, bz)
    cx, cy, cz = through(root, cx, cy, cz)
    return ax, ay, az, bx, by, bz, cx, cy, cz


@kernel
def add_seen_terms(terms: FloatArray, root: Root, out: FloatArray) -> None:
    """Add a function of S x with its derivatives, packed as in ``packed``, as one of x.

    The gradient is S g, the Hessian S H S.
    """
    gx, gy, gz = through(root, terms[1], terms[2], terms[3])
    out[0] += terms[0]
    out[1] += gx
    out[2] += gy
    out[3] += gz
    # rows of H S
    ax, ay, az = through(root, terms[4], terms[5], terms[6])
    bx, by, bz = through(root, terms[5], terms[7], terms[8])
    cx, cy, cz = through(root, terms[6], terms[8], terms[9])
    xx, xy, xz = through(root, ax, bx, cx)
    _, yy, yz = through(root, ay, by, cy)
    _, _, zz = through(root, az, bz, cz)
    out[4] += xx
    out[5] += xy
    out[6] += xz
    out[7] += yy
    out[8] += yz
    out[9] += zz


@kernel
def seen_square(points: FloatArray, i: int, j: int) -> float:
    """Squared length of an edge in space, seen through the mean of S at its ends."""
    x = points[j, 0] - points[i, 0]
    y = points[j, 1] - points[i, 1]
    z = points[j, 2] - points[i, 2]
    if has_metric(points):
        ax, ay, az = through(vertex_root(points, i), x, y, z)
        bx, by, bz = through(vertex_root(points, j), x, y, z)
        x, y, z = 0.5 * (ax + bx), 0.5 * (ay + by), 0.5 * (az + bz)
    return x * x + y * y + z * z
