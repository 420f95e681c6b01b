"""Edge flips of a surface, in place: to intrinsic Delaunay (Section 3.1), or to a better shape.

One queue of edges drives both, as in the plane; an edge keeps its number when it is flipped.
"""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.cells.cost import Cost, is_energy
from odt_plugins.engine.cells.extremes import Extremes, keeps, worse
from odt_plugins.engine.cells.metric import Root, has_metric, tet_root, through
from odt_plugins.engine.cells.triangle import NO_ROOT, offset, triangle_in_space
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.compiled.threads import PIECE
from odt_plugins.engine.ground.pair import edge_is_free, flip_back, keeps_normals
from odt_plugins.engine.ground.sheet import (
    SMOOTH,
    Guards,
    Sheet,
    Work,
    claim,
    cover,
    joined,
    make_work,
)
from odt_plugins.engine.moves.flips2d import (
    GAIN,
    Queue,
    first_waiting,
    flip,
    make_queue,
    queue_around,
    shapes_improve,
    work_off,
)
from odt_plugins.engine.topology.lookup import place_in
from odt_plugins.mesh.arrays import BoolArray, FloatArray

LOCKED_FLOOR = 0.3
"""Least radius ratio of a new triangle without a movable vertex, which smoothing cannot help."""


def flip_edges(
    sheet: Sheet, guards: Guards, cost: Cost, bounds: Extremes, seeds: BoolArray,
    changed: BoolArray,
) -> int:
    """Flip edges, in place, as long as it pays.

    Parameters
    ----------
    sheet : Sheet, guards : Guards
    cost : Cost              the energy flips where opposite angles exceed 180 degrees and the ODT
                             energy of the pair falls; the measures where the sum of m^-p falls
    bounds : Extremes        a flip that passes one of them and is worse there than the pair it
                             replaces is refused
    seeds : (m,) bool        the first edges looked at are those of these triangles
    changed : (m,) bool      set, in place, where a triangle was replaced

    Returns
    -------
    int                      number of flips
    """
    waits = np.zeros(len(sheet.edges.cell), dtype=np.bool_)
    waits[sheet.edges.of_cell[seeds]] = True
    waits[sheet.locked] = False
    queue = make_queue(waits)
    waits |= sheet.locked
    work = make_work(guards.ground)
    flips = work_off(queue, lambda: _flip_some(
        sheet, guards, cost, bounds, queue, PIECE, work, changed
    ))
    sheet.check()
    return flips


@kernel
def _flip_some(
    sheet: Sheet, guards: Guards, cost: Cost, bounds: Extremes, queue: Queue, most: int,
    work: Work, changed: BoolArray,
) -> int:
    """Visit at most ``most`` edges; after a flip the four edges around it are looked at again."""
    ground, limits = guards.ground, guards.limits
    cells, neighbors, edges = sheet.triangles, sheet.neighbors, sheet.edges
    pair = work.cells
    flips = 0
    for _ in range(min(queue.ends[1], most)):
        e = first_waiting(queue)
        t = edges.cell[e]
        i = place_in(edges.of_cell, t, e)
        s = neighbors[t, i]
        if s < 0:
            continue
        j = place_in(edges.of_cell, s, e)
        a, b, c = cells[t, i], cells[t, (i + 1) % 3], cells[t, (i + 2) % 3]
        d = cells[s, j]
        if not _pays(sheet, a, b, c, d, cost, bounds):
            continue
        if not edge_is_free(sheet, t, a, s, d) or not keeps_normals(
            sheet, ground, a, b, c, d, limits.cosine
        ):
            continue
        if not joined(sheet, ground, a, d, limits.distance):
            continue
        flip(cells, neighbors, edges, t, i, s, j)
        pair[0] = t
        pair[1] = s
        number = claim(sheet, ground, 2, limits.distance, work)
        if number < 0:
            flip_back(sheet, t, s, e)
            continue
        cover(sheet, 2, number, work)
        changed[t] = True
        changed[s] = True
        flips += 1
        queue_around(edges, t, s, queue)
    return flips


@kernel
def _pays(
    sheet: Sheet, a: int, b: int, c: int, d: int, cost: Cost, bounds: Extremes
) -> bool:
    """Whether (a, b, d) and (a, d, c) are to be preferred to (a, b, c) and (d, c, b)."""
    p = sheet.points
    if not is_energy(cost.objective):
        return shapes_improve(p, a, b, c, d, cost, bounds)
    # both pairs are seen alike, through the mean of the four vertices
    root = tet_root(p, a, b, c, d) if has_metric(p) else NO_ROOT
    if not _wide(p, a, b, c, d, root):
        return False
    q1, large1, small1, x1, y1, z1 = triangle_in_space(p, a, b, c)
    q2, large2, small2, x2, y2, z2 = triangle_in_space(p, d, c, b)
    q3, large3, small3, x3, y3, z3 = triangle_in_space(p, a, b, d)
    q4, large4, small4, x4, y4, z4 = triangle_in_space(p, a, d, c)
    before = worse(Extremes(q1, large1, small1), Extremes(q2, large2, small2))
    after = worse(Extremes(q3, large3, small3), Extremes(q4, large4, small4))
    if not after.quality > 0.0 or not keeps(after, worse(bounds, before)):
        return False
    kind = sheet.kind
    if kind[a] != SMOOTH and kind[d] != SMOOTH and (kind[b] != SMOOTH or kind[c] != SMOOTH):
        worst = 1.0
        if kind[b] != SMOOTH:
            worst = min(worst, q3)
        if kind[c] != SMOOTH:
            worst = min(worst, q4)
        if worst < LOCKED_FLOOR and worst < before.quality:
            return False
    # energy (2.2): area times the sum of squared edges
    if has_metric(p):
        x1, y1, z1 = _seen_area(p, a, b, c, root)
        x2, y2, z2 = _seen_area(p, d, c, b, root)
        x3, y3, z3 = _seen_area(p, a, b, d, root)
        x4, y4, z4 = _seen_area(p, a, d, c, root)
    ab, ca = _squared(p, a, b, root), _squared(p, c, a, root)
    bd, dc = _squared(p, b, d, root), _squared(p, d, c, root)
    bc, ad = _squared(p, b, c, root), _squared(p, a, d, root)
    energy = _norm(x1, y1, z1) * (ab + ca + bc) + _norm(x2, y2, z2) * (bd + dc + bc)
    then = _norm(x3, y3, z3) * (ab + bd + ad) + _norm(x4, y4, z4) * (dc + ca + ad)
    return then < (1.0 - GAIN) * energy


@kernel
def _wide(p: FloatArray, a: int, b: int, c: int, d: int, root: Root) -> bool:
    """Whether the angles at a and d, opposite to the edge bc, exceed 180 degrees together."""
    ab, ac, bc = _squared(p, a, b, root), _squared(p, a, c, root), _squared(p, b, c, root)
    db, dc = _squared(p, d, b, root), _squared(p, d, c, root)
    at_a = (ab + ac - bc) / math.sqrt(ab * ac) if ab > 0.0 and ac > 0.0 else 0.0
    at_d = (db + dc - bc) / math.sqrt(db * dc) if db > 0.0 and dc > 0.0 else 0.0
    return at_a + at_d < -GAIN


@kernel
def _squared(p: FloatArray, a: int, b: int, root: Root) -> float:
    x, y, z = offset(p, a, b)
    if has_metric(p):
        x, y, z = through(root, x, y, z)
    return x * x + y * y + z * z


@kernel
def _seen_area(
    p: FloatArray, a: int, b: int, c: int, root: Root
) -> tuple[float, float, float]:
    """Twice the area vector of a triangle that is seen through S."""
    ux, uy, uz = offset(p, a, b)
    vx, vy, vz = offset(p, a, c)
    ux, uy, uz = through(root, ux, uy, uz)
    vx, vy, vz = through(root, vx, vy, vz)
    return uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@kernel
def _norm(x: float, y: float, z: float) -> float:
    return math.sqrt(x * x + y * y + z * z)
