"""The table of measures: number -> value, gradient and Hessian of a cell, for each dimension.

Every kernel calls it; a further measure is a file with its formulas and one line in each function
here. A measure m is 1 for the regular simplex, with the exception of STEP, and not positive for
one that is inverted.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.corner import Edges, corner_edges
from odt_plugins.engine.cells.cost import SHIFT, Cost, is_energy, quality_cost
from odt_plugins.engine.cells.dihedral import (
    dihedral_terms,
    tet_dihedral,
    triangle_angle,
    triangle_angle_terms,
)
from odt_plugins.engine.cells.extremes import Extremes, worse
from odt_plugins.engine.cells.mean_ratio import (
    mean_ratio_terms,
    tet_mean_ratio,
    triangle_mean_ratio,
    triangle_mean_ratio_terms,
)
from odt_plugins.engine.cells.metric import (
    add_seen_terms,
    edges_through,
    has_metric,
    seen_edges,
    tet_root,
)
from odt_plugins.engine.cells.packed import add_square
from odt_plugins.engine.cells.rows import (
    CHUNK,
    ROWS,
    Q,
    add_star_terms,
    dihedral_rows,
    gather_corners,
    gather_edges,
    quality_rows,
)
from odt_plugins.engine.cells.step import (
    step_terms,
    tet_altitude,
    tet_step,
    triangle_step,
    triangle_step_terms,
)
from odt_plugins.engine.cells.tetrahedron import (
    edges_quality,
    opposite_vertices,
    tet_cosines,
    tet_energy,
    tet_quality,
)
from odt_plugins.engine.cells.triangle import (
    MovingTriangle,
    moving_triangle,
    opposite_edge,
    squares,
    triangle_extremes,
    triangle_quality,
    triangle_quality_terms,
)
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.mesh.arrays import FloatArray, IntArray

QUALITY = 1
MEAN_RATIO = 2
DIHEDRAL = 3
STEP = 4
"""The measures m: radius ratio, a power of the mean ratio, softened smallest angle, time step."""

MEASURES = {"radius_ratio": QUALITY, "amips": MEAN_RATIO, "min_dihedral": DIHEDRAL,
            "time_step": STEP}
"""The measure of every objective."""

NO_CELL = 2.0
"""Measure of a free slot, beyond that of any cell."""


@kernel
def tet_measure(points: FloatArray, i: int, j: int, k: int, l: int, objective: int) -> float:
    """Measure of tetrahedron (i, j, k, l); not positive if inverted."""
    if objective == QUALITY:
        return tet_quality(points, i, j, k, l)
    edges = seen_edges(points, i, j, k, l)
    if objective == MEAN_RATIO:
        return tet_mean_ratio(edges)
    if objective == STEP:
        return tet_step(edges)
    return tet_dihedral(edges)


@kernel
def _tet_terms(edges: Edges, objective: int, out: FloatArray) -> bool:
    """Write a measure m, gradient and Hessian of log m in the corner of the edges, see ``packed``.

    False when the cell is not positive.  Those of the radius ratio are in ``rows``.
    """
    if objective == MEAN_RATIO:
        return mean_ratio_terms(edges, out)
    if objective == STEP:
        return step_terms(edges, out)
    return dihedral_terms(edges, out)


@kernel
def triangle_measure(points: FloatArray, a: int, b: int, c: int, objective: int) -> float:
    """Measure of one triangle; not positive when flat or, in the plane, not counterclockwise."""
    uu, vv, ww, square = squares(points, a, b, c)
    if objective == QUALITY:
        return triangle_quality(uu, vv, ww, square)
    if not square > 0.0:
        return -1.0
    if objective == MEAN_RATIO:
        return triangle_mean_ratio(uu, vv, ww, square)
    if objective == STEP:
        return triangle_step(uu, vv, ww, square)
    return triangle_angle(uu, vv, ww, square)


@kernel
def _triangle_terms(
    t: MovingTriangle, objective: int
) -> tuple[float, float, float, float, float, float]:
    """Measure m of a positive triangle, gradient of log m, minus its Hessian [xx xy yy]."""
    if objective == QUALITY:
        return triangle_quality_terms(t)
    if objective == MEAN_RATIO:
        return triangle_mean_ratio_terms(t)
    if objective == STEP:
        return triangle_step_terms(t)
    return triangle_angle_terms(t)


@kernel
def triangle_state(
    points: FloatArray, a: int, b: int, c: int, objective: int
) -> tuple[float, Extremes]:
    """Measure of one triangle, and its extremes."""
    found = triangle_extremes(points, a, b, c)
    if objective == QUALITY:
        return found.quality, found
    return triangle_measure(points, a, b, c, objective), found


@kernel
def tet_cost(points: FloatArray, i: int, j: int, k: int, l: int, cost: Cost) -> float:
    """Cost of tetrahedron (i, j, k, l): ODT energy or that of its measure; infinite if inverted."""
    if cost.objective == QUALITY:
        m = tet_quality(points, i, j, k, l)
    elif is_energy(cost.objective):
        return tet_energy(seen_edges(points, i, j, k, l))
    else:
        m = tet_measure(points, i, j, k, l, cost.objective)
    if m <= 1e-9:
        return np.inf
    return quality_cost(m, cost.power)


@kernel
def cell_cost(points: FloatArray, cells: IntArray, c: int, cost: Cost) -> float:
    """:func:`tet_cost` of cell c."""
    return tet_cost(points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3], cost)


@kernel
def tet_shape(points: FloatArray, i: int, j: int, k: int, l: int) -> Extremes:
    """Radius ratio of a tetrahedron, largest and smallest cosine of its dihedral angles."""
    edges = seen_edges(points, i, j, k, l)
    large, small = tet_cosines(edges)
    return Extremes(edges_quality(edges), large, small)


@kernel
def cell_extremes(points: FloatArray, cells: IntArray, c: int) -> Extremes:
    """:func:`tet_shape` of cell c."""
    return tet_shape(points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3])


@kernel
def cell_altitude(points: FloatArray, cells: IntArray, c: int) -> float:
    """Least altitude of tetrahedron c; negative if inverted."""
    return tet_altitude(
        seen_edges(points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3])
    )


@kernel
def cell_measures(points: FloatArray, cells: IntArray, objective: int, m: FloatArray) -> None:
    """Write the measure of every triangle or tetrahedron."""
    for c in range(cells.shape[0]):
        i, j, k = cells[c, 0], cells[c, 1], cells[c, 2]
        if cells.shape[1] == 3:
            m[c] = triangle_measure(points, i, j, k, objective)
        else:
            m[c] = tet_measure(points, i, j, k, cells[c, 3], objective)


@allocating_kernel
def slot_measures(
    points: FloatArray, cells: IntArray, slots: IntArray, objective: int, m: FloatArray,
    start: int, stop: int,
) -> None:
    """Write the measures of the tetrahedra in slots[start:stop], NO_CELL for a free slot."""
    rows = np.empty(ROWS)
    for first in range(start, stop, CHUNK):
        count = min(CHUNK, stop - first)
        if objective in (QUALITY, DIHEDRAL):
            gather_edges(points, cells, slots, first, count, rows)
            if objective == QUALITY:
                quality_rows(0.0, 0.0, 0.0, count, rows)
            else:
                dihedral_rows(count, rows)
        for s in range(first, first + count):
            c = slots[s]
            if cells[c, 0] < 0:
                m[s] = NO_CELL
            elif objective in (QUALITY, DIHEDRAL):
                m[s] = rows[Q + s - first]
            else:
                m[s] = tet_measure(
                    points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3], objective
                )


class Room(NamedTuple):
    """Room for the star of a vertex of tetrahedra; made by :func:`make_room`.

    Attributes
    ----------
    star : (10,) float64    sum over the cells of a star, packed as in ``packed``
    cell : (10,) float64    measure of one of them, packed in the same way
    seen : (10,) float64    cost of one of them as it is seen, packed in the same way
    rows : (ROWS,) float64  the cells of a star side by side, see ``rows``
    """

    star: FloatArray
    cell: FloatArray
    seen: FloatArray
    rows: FloatArray


@allocating_kernel
def make_room() -> Room:
    """Room for one thread."""
    return Room(np.empty(10), np.empty(10), np.empty(10), np.empty(ROWS))


@kernel
def star_terms(
    points: FloatArray, cells: IntArray, indices: IntArray, start: int, stop: int, v: int,
    cost: Cost, room: Room,
) -> bool:
    """Write the cost of the cells indices[start:stop], gradient and Hessian in x_v to room.star.

    Of the radius ratio the cells stay in ``room.rows`` if there are no more than CHUNK.  False when
    a cell is not positive.
    """
    out, power = room.star, cost.power
    out[:] = 0.0
    if cost.objective == QUALITY and not has_metric(points):
        for first in range(start, stop, CHUNK):
            last = min(stop, first + CHUNK)
            gather_corners(points, cells, indices, first, last, v, room.rows)
            if not add_star_terms(
                points[v, 0], points[v, 1], points[v, 2], last - first, power, room.rows, out
            ):
                return False
        return True
    for s in range(start, stop):
        i, j, k = opposite_vertices(cells, indices[s], v)
        edges = corner_edges(points, v, i, j, k)
        if not has_metric(points):
            if not _add_cell_terms(edges, cost, room, out):
                return False
            continue
        root = tet_root(points, v, i, j, k)
        room.seen[:] = 0.0
        if not _add_cell_terms(edges_through(root, edges), cost, room, room.seen):
            return False
        add_seen_terms(room.seen, root, out)
    return True


@kernel
def _add_cell_terms(edges: Edges, cost: Cost, room: Room, out: FloatArray) -> bool:
    """Add the cost of a cell by its edges at a corner, gradient and Hessian in that corner."""
    terms, power = room.cell, cost.power
    if cost.objective == QUALITY:
        for k in range(9):
            room.rows[CHUNK * k] = edges[k]
        return add_star_terms(0.0, 0.0, 0.0, 1, power, room.rows, out)
    if not _tet_terms(edges, cost.objective, terms):
        return False
    m = terms[0]
    f = quality_cost(m, power)
    share = m / (m + SHIFT)
    pf = power * f * share
    pp = pf * ((power + 1.0) * share - 1.0)
    out[0] += f
    for a in range(1, 10):
        out[a] -= pf * terms[a]
    add_square(out, pp, terms[1], terms[2], terms[3])
    return True


@kernel
def star_state(
    points: FloatArray, cells: IntArray, indices: IntArray, start: int, stop: int, cost: Cost,
    limit: float, sure: float,
) -> tuple[float, Extremes]:
    """Cost and extremes of the cells indices[start:stop].

    Parameters
    ----------
    limit : float    a sum of costs above it is given up
    sure : float     the angles of cells from this radius ratio on are not asked for

    Returns
    -------
    total : float          sum of the costs; infinite above the limit or if inverted
    extremes : Extremes
    """
    total = 0.0
    found = Extremes(1.0, -1.0, 1.0)
    for s in range(start, stop):
        c = indices[s]
        edges = seen_edges(points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3])
        q = edges_quality(edges)
        if q <= 1e-9:
            return np.inf, found
        if cost.objective == QUALITY:
            total += quality_cost(q, cost.power)
        else:
            total += cell_cost(points, cells, c, cost)
        if total >= limit:
            return np.inf, found
        large, small = -1.0, 1.0
        if q < sure:
            large, small = tet_cosines(edges)
        found = worse(found, Extremes(q, large, small))
    return total, found


@kernel
def moved_state(
    points: FloatArray, cells: IntArray, indices: IntArray, start: int, stop: int, v: int,
    cost: Cost, limit: float, sure: float, rows: FloatArray,
) -> tuple[float, Extremes]:
    """As :func:`star_state` after :func:`star_terms`, since when only v has moved."""
    count = stop - start
    if cost.objective != QUALITY or count > CHUNK or has_metric(points):
        return star_state(points, cells, indices, start, stop, cost, limit, sure)
    quality_rows(points[v, 0], points[v, 1], points[v, 2], count, rows)
    total = 0.0
    found = Extremes(1.0, -1.0, 1.0)
    for s in range(count):
        q = rows[Q + s]
        if q <= 1e-9:
            return np.inf, found
        total += quality_cost(q, cost.power)
    if total >= limit:
        return np.inf, found
    for s in range(count):
        q = rows[Q + s]
        large, small = -1.0, 1.0
        if q < sure:
            c = indices[start + s]
            large, small = tet_cosines(
                seen_edges(points, cells[c, 0], cells[c, 1], cells[c, 2], cells[c, 3])
            )
        found = worse(found, Extremes(q, large, small))
    return total, found


@kernel
def star_terms_2d(
    points: FloatArray, cells: IntArray, star: IntArray, vertex: int, cost: Cost,
    axes: FloatArray, derivatives: FloatArray,
) -> float:
    """Sum of m^-p over the star of a vertex, with gradient and Hessian along two directions.

    Parameters
    ----------
    points : (n, d) float64       d = 2, or 3 for a vertex in its tangent plane
    cells : (m, 3) int32          in the plane counterclockwise
    star : (k,) int32             the cells around it
    vertex : int
    cost : Cost                   measure m, and p
    axes : (2, d) float64         orthonormal directions
    derivatives : (5,) float64    OUT: F_1, F_2, F_11, F_12, F_22

    Returns
    -------
    float                         infinite when a triangle is not positive
    """
    power = cost.power
    derivatives[:] = 0.0
    total = 0.0
    for s in range(star.shape[0]):
        i, j = opposite_edge(cells, star[s], vertex)
        t = moving_triangle(points, vertex, i, j, axes)
        if not (t.square > 0.0 and t.uu > 0.0 and t.vv > 0.0):
            return np.inf
        m, g1, g2, h11, h12, h22 = _triangle_terms(t, cost.objective)
        if has_metric(points):
            a, b, c, d = t.r11, t.r12, t.r21, t.r22
            g1, g2 = a * g1 + b * g2, c * g1 + d * g2
            k11, k12, k21, k22 = (
                a * h11 + b * h12, a * h12 + b * h22, c * h11 + d * h12, c * h12 + d * h22)
            h11, h12, h22 = a * k11 + b * k12, a * k21 + b * k22, c * k21 + d * k22
        f = m**-power
        pf = power * f
        total += f
        derivatives[0] -= pf * g1
        derivatives[1] -= pf * g2
        derivatives[2] += pf * (power * g1 * g1 + h11)
        derivatives[3] += pf * (power * g1 * g2 + h12)
        derivatives[4] += pf * (power * g2 * g2 + h22)
    return total


@kernel
def star_state_2d(
    points: FloatArray, cells: IntArray, star: IntArray, cost: Cost
) -> tuple[float, Extremes]:
    """Sum of m^-p over some triangles, and their extremes; infinite where one is not positive."""
    total = 0.0
    found = Extremes(1.0, -1.0, 1.0)
    for s in range(star.shape[0]):
        t = star[s]
        m, own = triangle_state(points, cells[t, 0], cells[t, 1], cells[t, 2], cost.objective)
        total += m**-cost.power if m > 0.0 else np.inf
        found = worse(found, own)
    return total, found
