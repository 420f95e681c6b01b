"""Compound moves on a surface: the descent knows no guards, what comes of it must pass all of them.

Vertices move in the tangent planes of their stars; only when the move pays are they put back on
the ground and the touched triangles compared with it.
"""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.extremes import Extremes, keeps
from odt_plugins.engine.compiled.kernel import allocating_kernel, kernel
from odt_plugins.engine.ground.closest import walk
from odt_plugins.engine.ground.pair import edge_is_free
from odt_plugins.engine.ground.sheet import (
    Guards,
    Sheet,
    Work,
    claim,
    cover,
    joined,
    normal_cosine,
)
from odt_plugins.engine.moves.compound2d import (
    GAIN,
    MOST_TOUCHED,
    MOVED,
    TOUCHED,
    ForcedFlip,
    Scratch,
    force,
    forced_flip,
    keep_forced,
    make_scratch,
    standing,
    take_back,
    touched_shape,
)
from odt_plugins.engine.moves.flips2d import Rule
from odt_plugins.engine.topology.lookup import is_in
from odt_plugins.engine.topology.triangles import Triangles
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray


@allocating_kernel
def compound_pass(
    sheet: Sheet, guards: Guards, mesh: Triangles, order: IntArray, rule: Rule, tried: BoolArray,
    excess: FloatArray, work: Work,
) -> int:
    """Try compound moves at the triangles of ``order``, see :func:`compound_pass_2d`.

    Parameters
    ----------
    sheet : Sheet, guards : Guards
    mesh : Triangles    of the sheet
    order, rule, tried, excess
    work : Work         room for the touched triangles

    Returns
    -------
    int                 number of compound moves that stayed
    """
    scratch = make_scratch(3)
    edges = sheet.edges
    taken = 0
    for o in range(order.shape[0]):
        bad = order[o]
        if tried[bad]:
            continue
        tried[bad] = True
        own, limit = standing(mesh, bad, rule)
        for op in range(9):
            forced = forced_flip(mesh, edges, bad, op, rule, excess)
            if not forced.loss < np.inf or not _may_flip(sheet, forced):
                continue
            gain = force(mesh, edges, forced, own, rule, scratch)
            if gain > GAIN * own:
                for m in range(scratch.counts[MOVED]):
                    scratch.feet[m] = sheet.foot[scratch.moved[m]]
                number = _lands(sheet, guards, mesh, gain - GAIN * own, limit, rule, scratch, work)
                if number >= 0:
                    cover(sheet, scratch.counts[TOUCHED], number, work)
                    keep_forced(mesh, forced, excess, tried, scratch)
                    taken += 1
                    break
                for m in range(scratch.counts[MOVED]):
                    sheet.foot[scratch.moved[m]] = scratch.feet[m]
            take_back(mesh, edges, forced, scratch)
    return taken


@kernel
def _may_flip(sheet: Sheet, forced: ForcedFlip) -> bool:
    """Whether the edge is no feature, and the new one not there yet."""
    t, i, s, j, _ = forced
    if sheet.locked[sheet.edges.of_cell[t, i]]:
        return False
    return edge_is_free(sheet, t, sheet.triangles[t, i], s, sheet.triangles[s, j])


@kernel
def _lands(
    sheet: Sheet, guards: Guards, mesh: Triangles, reserve: float, limit: Extremes, rule: Rule,
    scratch: Scratch, work: Work,
) -> int:
    """Put the moved vertices on the ground and ask all guards; rows of the pool of claim, or -1.

    Parameters
    ----------
    reserve : float      by how much F_p may grow when the vertices are put on the ground
    limit : Extremes     that no touched triangle passes
    """
    ground, _, limits = guards
    p, t = sheet.points, sheet.triangles
    count = scratch.counts[TOUCHED]
    if count == MOST_TOUCHED:
        return -1
    before, _ = touched_shape(mesh, rule.cost, scratch)
    for m in range(scratch.counts[MOVED]):
        v = scratch.moved[m]
        _, face, x, y, z = walk(p[v, 0], p[v, 1], p[v, 2], sheet.foot[v], ground, False)
        p[v, 0], p[v, 1], p[v, 2] = x, y, z
        sheet.foot[v] = face
    after, found = touched_shape(mesh, rule.cost, scratch)
    if not after - before < reserve or not keeps(found, limit):
        return -1
    for m in range(count):
        c = scratch.touched[m]
        work.cells[m] = c
        if normal_cosine(sheet, ground, t[c, 0], t[c, 1], t[c, 2]) < limits.cosine:
            return -1
    for m in range(count):
        c = work.cells[m]
        for i in range(3):
            near = sheet.neighbors[c, i]
            if sheet.locked[sheet.edges.of_cell[c, i]] or (
                near < c and is_in(near, work.cells, count)
            ):
                continue
            if not joined(sheet, ground, t[c, (i + 1) % 3], t[c, (i + 2) % 3], limits.distance):
                return -1
    return claim(sheet, ground, count, limits.distance, work)
