"""Newton smoothing of one vertex at a time for F_p = sum over its star of m^-p, of triangles.

In the plane, or in the tangent plane of a vertex in space; see ``measures.star_terms_2d``.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Extremes, keeps, worse
from odt_plugins.engine.cells.measures import star_state_2d, star_terms_2d
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.moves.plane_step import seen_plane_step
from odt_plugins.engine.moves.tangent import set_axes, star_normal
from odt_plugins.engine.topology.star import Stars
from odt_plugins.mesh.arrays import FloatArray, IntArray

HALVINGS = 8
"""Step lengths alpha = 1, 1/2, 1/4, ... tried for one vertex."""
DECREASE = 1e-10
"""Least relative decrease of F_p over the star for which a vertex moves."""
ARMIJO = 1e-4
"""Part of the decrease that the slope predicts which a step must reach."""


@kernel
def newton_step_2d(
    points: FloatArray, cells: IntArray, star: IntArray, v: int, cost: Cost, axes: FloatArray,
    on_a_line: bool, derivatives: FloatArray,
) -> tuple[float, float, float, float, float]:
    """The step for which F_p over the star falls fastest, by its Hessian made positive definite.

    Parameters as for :func:`odt_plugins.engine.cells.measures.star_terms_2d`, and

    Parameters
    ----------
    on_a_line : bool      only the first of the axes is free

    Returns
    -------
    before, slope : float    F_p, and its derivative along the step; the slope is 0 without a step
    dx, dy, dz : float       the step; dz is dy in the plane
    """
    last = axes.shape[1] - 1
    before = star_terms_2d(points, cells, star, v, cost, axes, derivatives)
    if not before < np.inf:
        return before, 0.0, 0.0, 0.0, 0.0
    g1, g2 = derivatives[0], derivatives[1]
    d1, d2 = seen_plane_step(
        points, v, axes, g1, g2, derivatives[2], derivatives[3], derivatives[4], on_a_line)
    return (
        before, g1 * d1 + g2 * d2, d1 * axes[0, 0] + d2 * axes[1, 0],
        d1 * axes[0, 1] + d2 * axes[1, 1], d1 * axes[0, last] + d2 * axes[1, last],
    )


@kernel
def newton_vertex_2d(
    points: FloatArray, cells: IntArray, star: IntArray, v: int, kind: Cost, bounds: Extremes,
    derivatives: FloatArray, axes: FloatArray,
) -> tuple[float, float]:
    """One guarded Newton step on F_p for vertex v, in place; in space in its tangent plane.

    Parameters as for :func:`newton_step_2d` and :func:`smooth_vertices_2d`, and

    Parameters
    ----------
    axes : (2, d) float64    orthonormal directions of the plane; OUT where d = 3

    Returns
    -------
    before, after : float    F_p over the star, the same when the vertex stays

    Notes
    -----
    The Hessian is made positive definite by a shift; alpha = 1, 1/2, 1/4, ... until F_p decreases
    strictly with every area positive.
    """
    dim = axes.shape[1]
    if dim == 3:
        set_axes(*star_normal(points, cells, star), axes)
    cost, slope, dx, dy, dz = newton_step_2d(
        points, cells, star, v, kind, axes, False, derivatives
    )
    if not -slope > DECREASE * cost:
        return cost, cost
    x, y, z = points[v, 0], points[v, 1], points[v, dim - 1]
    alpha = 1.0
    for _ in range(HALVINGS):
        _put(points, dim, v, x + alpha * dx, y + alpha * dy, z + alpha * dz)
        there, found = star_state_2d(points, cells, star, kind)
        if there <= cost + ARMIJO * alpha * slope and there < (1.0 - DECREASE) * cost:
            if keeps(found, bounds):
                return cost, there
            _put(points, dim, v, x, y, z)
            _, here = star_state_2d(points, cells, star, kind)
            if keeps(found, worse(bounds, here)):
                _put(points, dim, v, x + alpha * dx, y + alpha * dy, z + alpha * dz)
                return cost, there
        alpha *= 0.5
    _put(points, dim, v, x, y, z)
    return cost, cost


@kernel
def _put(points: FloatArray, dim: int, v: int, x: float, y: float, z: float) -> None:
    """Put vertex v at (x, y), or (x, y, z) in space; y and z are the same in the plane."""
    points[v, dim - 1] = z
    points[v, 0] = x
    points[v, 1] = y


@allocating_kernel
def smooth_vertices_2d(
    points: FloatArray, cells: IntArray, stars: Stars, order: IntArray, start: int, stop: int,
    kind: Cost, bounds: Extremes, moved: FloatArray,
) -> int:
    """One :func:`newton_vertex_2d` for every vertex of order[start:stop], in place.

    Parameters
    ----------
    points : (n, 2) float64         changed in place
    cells : (m, 3) int32            counterclockwise
    stars : Stars
    order : (k,) int32              vertices, moved one after another
    start, stop : int
    kind : Cost                     measure m, see ``triangle_measure``, and p > 0
    bounds : Extremes               a step that passes one of them and makes the star worse there
                                    is shortened
    moved : (n,) float64            OUT: relative decrease of F_p over the star, 0 if it stays

    Returns
    -------
    int                             number of vertices moved
    """
    derivatives = np.empty(5)
    axes = np.eye(2)
    count = 0
    for o in range(start, stop):
        v = order[o]
        moved[v] = 0.0
        first, last = stars.indptr[v], stars.indptr[v + 1]
        if first == last:
            continue
        before, after = newton_vertex_2d(
            points, cells, stars.indices[first:last], v, kind, bounds, derivatives, axes
        )
        if after < before:
            moved[v] = 1.0 - after / before
        if moved[v] > 0.0:
            count += 1
    return count
