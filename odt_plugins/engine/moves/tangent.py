"""The star of a vertex of a surface in its tangent plane: normal, axes, and F_p = sum of q^-p."""

from __future__ import annotations

import math

from odt_plugins.engine.cells.triangle import opposite_edge, triangle_in_space
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.mesh.arrays import FloatArray, IntArray


@kernel
def star_normal(
    points: FloatArray, triangles: IntArray, star: IntArray
) -> tuple[float, float, float]:
    """Unit normal of a star, (k,) triangles, area-weighted; 0 when there is none."""
    x = y = z = 0.0
    for s in range(star.shape[0]):
        c = star[s]
        _, _, _, nx, ny, nz = triangle_in_space(
            points, triangles[c, 0], triangles[c, 1], triangles[c, 2]
        )
        x += nx
        y += ny
        z += nz
    length = math.sqrt(x * x + y * y + z * z)
    if not length > 0.0:
        return 0.0, 0.0, 0.0
    return x / length, y / length, z / length


@kernel
def axis_across(nx: float, ny: float, nz: float) -> tuple[float, float, float]:
    """Unit vector at right angles to a unit vector."""
    if abs(nx) <= abs(ny) and abs(nx) <= abs(nz):
        x, y, z = 0.0, nz, -ny
    elif abs(ny) <= abs(nz):
        x, y, z = -nz, 0.0, nx
    else:
        x, y, z = ny, -nx, 0.0
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


@kernel
def set_axes(nx: float, ny: float, nz: float, e: FloatArray) -> None:
    """Make e (2, 3) orthonormal directions at right angles to a unit vector."""
    e[0, 0], e[0, 1], e[0, 2] = axis_across(nx, ny, nz)
    complete_axes(nx, ny, nz, e)


@kernel
def complete_axes(nx: float, ny: float, nz: float, e: FloatArray) -> None:
    """Make e[1] the direction across a unit vector and e[0]."""
    e[1, 0] = ny * e[0, 2] - nz * e[0, 1]
    e[1, 1] = nz * e[0, 0] - nx * e[0, 2]
    e[1, 2] = nx * e[0, 1] - ny * e[0, 0]


@kernel
def star_cost(
    points: FloatArray, triangles: IntArray, star: IntArray, vertex: int, power: float,
    e: FloatArray, derivatives: FloatArray,
) -> float:
    """Sum of q^-p over the star of a vertex, with its derivatives along two directions.

    Parameters
    ----------
    points : (n, 3) float64, triangles : (m, 3) int32
    star : (k,) int32             the triangles around it
    vertex : int
    power : float                 p
    e : (2, 3) float64            orthonormal directions
    derivatives : (5,) float64    OUT: F_1, F_2, F_11, F_12, F_22

    Returns
    -------
    float                         infinite when a triangle is flat

    Notes
    -----
    Opposite the edge w, with u and v from its ends to the vertex, log q is log B - log l1 -
    log l2 - log(l1 + l2 + |w|) + constant; B = |w|^2 |u|^2 - (u w)^2, four times the squared area,
    is a quadratic of the vertex.
    """
    derivatives[:] = 0.0
    total = 0.0
    for s in range(star.shape[0]):
        t = star[s]
        b, c = opposite_edge(triangles, t, vertex)
        uu = vv = ww = uw = 0.0
        u1 = u2 = v1 = v2 = w1 = w2 = 0.0
        for k in range(3):
            u = points[vertex, k] - points[b, k]
            v = points[vertex, k] - points[c, k]
            w = points[c, k] - points[b, k]
            uu += u * u
            vv += v * v
            ww += w * w
            uw += u * w
            u1 += u * e[0, k]
            u2 += u * e[1, k]
            v1 += v * e[0, k]
            v2 += v * e[1, k]
            w1 += w * e[0, k]
            w2 += w * e[1, k]
        square = ww * uu - uw * uw
        if not (square > 0.0 and uu > 0.0 and vv > 0.0):
            return math.inf
        l1 = math.sqrt(uu)
        l2 = math.sqrt(vv)
        perimeter = l1 + l2 + math.sqrt(ww)
        q = 4.0 * square / (perimeter * l1 * l2 * math.sqrt(ww))
        f = q**-power
        i1 = 1.0 / l1
        i2 = 1.0 / l2
        ip = 1.0 / perimeter
        ib = 2.0 / square
        # derivatives of log B
        a1 = (ww * u1 - uw * w1) * ib
        a2 = (ww * u2 - uw * w2) * ib
        a11 = (ww - w1 * w1) * ib - a1 * a1
        a12 = -w1 * w2 * ib - a1 * a2
        a22 = (ww - w2 * w2) * ib - a2 * a2
        # of the two lengths, by the cosines with the directions
        u1 *= i1
        u2 *= i1
        v1 *= i2
        v2 *= i2
        p1 = (u1 + v1) * ip
        p2 = (u2 + v2) * ip
        g1 = a1 - p1 - u1 * i1 - v1 * i2
        g2 = a2 - p2 - u2 * i1 - v2 * i2
        # -Hess log q; Hess l = (I - u u^T) / l, Hess log l = (I - 2 u u^T) / l^2
        iso = i1 * ip + i2 * ip + i1 * i1 + i2 * i2
        t1 = i1 * ip + 2.0 * i1 * i1
        t2 = i2 * ip + 2.0 * i2 * i2
        h11 = -a11 - p1 * p1 + iso - t1 * u1 * u1 - t2 * v1 * v1
        h12 = -a12 - p1 * p2 - t1 * u1 * u2 - t2 * v1 * v2
        h22 = -a22 - p2 * p2 + iso - t1 * u2 * u2 - t2 * v2 * v2
        pf = power * f
        total += f
        derivatives[0] -= pf * g1
        derivatives[1] -= pf * g2
        derivatives[2] += pf * (power * g1 * g1 + h11)
        derivatives[3] += pf * (power * g1 * g2 + h12)
        derivatives[4] += pf * (power * g2 * g2 + h22)
    return total
