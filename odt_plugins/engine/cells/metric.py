"""The metric's door: edges of a cell as they are seen through it.

Rows of points are the coordinates alone, or the coordinates and behind them the upper triangle of
L = log(M) / 2, of the metric at the vertex. M is half the Hessian of the convex function u of the
energy (after Definition 2.5): for u = |x|^2, the isotropic case, there are no further columns and
edges are what they are. Otherwise an edge e of a cell is seen as S e, S the exponential of the mean
of L at the vertices of the cell, which is the root of the log-Euclidean mean of M. Where M is
constant the length is sqrt(e . M e), and every measure is that of the affine image. In the plane
the columns are L_xx, L_xy, L_yy, in space L_xx, L_xy, L_xz, L_yy, L_yz, L_zz.

References
----------
V. Arsigny et al., Log-Euclidean metrics, Magn. Reson. Med. 56 (2006) 411-421.
C. Moler, C. Van Loan, Nineteen dubious ways to compute the exponential of a matrix, SIAM Rev. 45
(2003) 3-49: scaling and squaring.
"""

from __future__ import annotations

from odt_plugins.engine.cells.corner import Edges, corner_edges
from odt_plugins.engine.compiled.kernel import apart_kernel, kernel
from odt_plugins.mesh.arrays import FloatArray

SMALL = 0.125
"""Size of a matrix up to which eight terms of the series give its exponential to rounding."""

HALVINGS = 12
"""Most halvings on the way there."""

Root = tuple[float, float, float, float, float, float]
"""S_xx, S_xy, S_xz, S_yy, S_yz, S_zz; in the plane S_zz is 1, for a z that is 0."""


@kernel
def has_metric(points: FloatArray) -> bool:
    """Whether the rows hold a metric behind the coordinates."""
    return points.shape[1] > 3


@kernel
def in_space(points: FloatArray) -> bool:
    """Whether the coordinates are three."""
    return points.shape[1] == 3 or points.shape[1] == 9


@kernel
def _row(points: FloatArray, i: int) -> Root:
    """Log S at a vertex."""
    if points.shape[1] == 5:
        return points[i, 2], points[i, 3], 0.0, points[i, 4], 0.0, 0.0
    return (points[i, 3], points[i, 4], points[i, 5], points[i, 6], points[i, 7], points[i, 8])


@kernel
def _sum(one: Root, two: Root) -> Root:
    a, b, c, d, e, f = one
    p, q, r, s, t, u = two
    return a + p, b + q, c + r, d + s, e + t, f + u


@kernel
def _times(w: float, one: Root) -> Root:
    a, b, c, d, e, f = one
    return w * a, w * b, w * c, w * d, w * e, w * f


@kernel
def product(one: Root, two: Root) -> Root:
    """Product of symmetric matrices that commute."""
    a, b, c, d, e, f = one
    p, q, r, s, t, u = two
    return (a * p + b * q + c * r, a * q + b * s + c * t, a * r + b * t + c * u,
            b * q + d * s + e * t, b * r + d * t + e * u, c * r + e * t + f * u)


@apart_kernel
def exponential(log: Root) -> Root:
    """Exponential of a symmetric matrix, by (exp(L / 2^k))^(2^k) and eight terms of the series."""
    a, b, c, d, e, f = log
    size = max(max(abs(a), abs(d)), abs(f)) + abs(b) + abs(c) + abs(e)
    halvings, scale = 0, 1.0
    for _ in range(HALVINGS):
        if size * scale > SMALL:
            scale *= 0.5
            halvings += 1
    x = _times(scale, log)
    xx = product(x, x)
    xxx = product(xx, x)
    high = _sum(_sum(_times(1.0 / 120.0, x), _times(1.0 / 720.0, xx)),
                _sum(_times(1.0 / 5040.0, xxx), _times(1.0 / 40320.0, product(xx, xx))))
    p, q, r, s, t, u = high
    high = product(product(xx, xx), (p + 1.0 / 24.0, q, r, s + 1.0 / 24.0, t, u + 1.0 / 24.0))
    p, q, r, s, t, u = _sum(_sum(x, _times(0.5, xx)), _sum(_times(1.0 / 6.0, xxx), high))
    out = (p + 1.0, q, r, s + 1.0, t, u + 1.0)
    for _ in range(halvings):
        out = product(out, out)
    return out


@apart_kernel
def vertex_root(points: FloatArray, i: int) -> Root:
    """S at a vertex."""
    return exponential(_row(points, i))


@apart_kernel
def inverse_root(points: FloatArray, i: int) -> Root:
    """S^-1 at a vertex."""
    return exponential(_times(-1.0, _row(points, i)))


@apart_kernel
def edge_root(points: FloatArray, i: int, j: int) -> Root:
    """S of an edge."""
    return exponential(_times(0.5, _sum(_row(points, i), _row(points, j))))


@apart_kernel
def tet_root(points: FloatArray, i: int, j: int, k: int, l: int) -> Root:
    """S of a tetrahedron."""
    one, two = _sum(_row(points, i), _row(points, j)), _sum(_row(points, k), _row(points, l))
    return exponential(_times(0.25, _sum(one, two)))


@apart_kernel
def triangle_root(points: FloatArray, i: int, j: int, k: int) -> Root:
    """S of a triangle."""
    one = _sum(_sum(_row(points, i), _row(points, j)), _row(points, k))
    return exponential(_times(1.0 / 3.0, one))


@apart_kernel
def hat_root(points: FloatArray, i: int, j: int, k: int) -> Root:
    """S of a triangle as the hat function of its vertex i weighs it."""
    one = _sum(_times(2.0, _row(points, i)), _sum(_row(points, j), _row(points, k)))
    return exponential(_times(0.25, one))


@kernel
def through(root: Root, x: float, y: float, z: float) -> tuple[float, float, float]:
    """S (x, y, z)."""
    a, b, c, d, e, f = root
    return a * x + b * y + c * z, b * x + d * y + e * z, c * x + e * y + f * z


@kernel
def solved(root: Root, x: float, y: float, z: float) -> tuple[float, float, float]:
    """S^-1 (x, y, z), by cofactors; S is positive definite."""
    a, b, c, d, e, f = root
    xx, xy, xz = d * f - e * e, c * e - b * f, b * e - c * d
    yy, yz, zz = a * f - c * c, b * c - a * e, a * d - b * b
    det = a * xx + b * xy + c * xz
    return ((xx * x + xy * y + xz * z) / det, (xy * x + yy * y + yz * z) / det,
            (xz * x + yz * y + zz * z) / det)


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


@apart_kernel
def edges_through(root: Root, edges: Edges) -> Edges:
    """S a, S b and S c."""
    ax, ay, az, bx, by, bz, cx, cy, cz = edges
    ax, ay, az = through(root, ax, ay, az)
    bx, by, bz = through(root, bx, by, bz)
    cx, cy, cz = through(root, cx, cy, cz)
    return ax, ay, az, bx, by, bz, cx, cy, cz


@apart_kernel
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
    """Squared length of an edge in space, as it is seen."""
    x = points[j, 0] - points[i, 0]
    y = points[j, 1] - points[i, 1]
    z = points[j, 2] - points[i, 2]
    if has_metric(points):
        x, y, z = through(edge_root(points, i, j), x, y, z)
    return x * x + y * y + z * z
