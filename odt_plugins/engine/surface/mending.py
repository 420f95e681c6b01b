"""A surface that breaks its promise at a few places goes back to the input there, and only there.

The edges that both triangulations have cut the surface into patches; each is filled by triangles of
the input and by as many of the result, so one may take the place of the other.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import cell_shapes, figures
from odt_plugins.engine.record.memory import Memory, State
from odt_plugins.engine.run.outcome import Leaving
from odt_plugins.engine.run.work import Start
from odt_plugins.engine.surface.judge import Kept, outside
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.components import components
from odt_plugins.mesh.surface import Edges, surface_edges
from odt_plugins.options import Options


class Pieces(NamedTuple):
    """Triangles in space with their labels.

    Attributes
    ----------
    points : (n, 3) float64     more columns as in ``cells.metric``
    cells : (m, 3) int32
    regions : (m,) int32
    """

    points: FloatArray
    cells: IntArray
    regions: IntArray


def patches(old: IntArray, new: IntArray, n: int) -> tuple[IntArray, IntArray]:
    """Number the patches of two triangulations of the same ``n`` vertices.

    Returns
    -------
    (m,) int32, (m,) int32    patch of every triangle of the one and of the other; each patch has
                              as many of both
    """
    m = len(old)
    both = surface_edges(old, n), surface_edges(new, n)
    shared = np.intersect1d(_keys(both[0], n), _keys(both[1], n))
    # a triangle is tied to the edges that one triangulation has, and to its side of common ones
    sides, rows = [], []
    for edges, first in zip(both, (0, m), strict=True):
        key = _keys(edges, n)[edges.of_cell]
        side = np.where(np.isin(key, shared), 1 + edges.forward, 0)
        sides.append((3 * key + side).ravel())
        rows.append(first + np.repeat(np.arange(m), 3))
    names, column = np.unique(np.concatenate(sides), return_inverse=True)
    label = components(np.concatenate(rows), 2 * m + column, 2 * m + len(names))
    one, two = label[:m].copy(), label[m : 2 * m].copy()
    count = int(label.max()) + 1
    uneven = np.bincount(one, minlength=count) != np.bincount(two, minlength=count)
    one[uneven[one]], two[uneven[two]] = count, count
    return one, two


def mended(
    old: Pieces, new: Pieces, bad: Callable[[Pieces], BoolArray], trials: int
) -> Pieces | None:
    """Bring a surface back to the input around its bad places, ring by ring.

    Parameters
    ----------
    old, new : Pieces    input and result, with the same vertices
    bad : callable       vertices, (n,) bool, near which a surface breaks its promise; none at last
    trials : int         how often more of the surface goes back

    Returns
    -------
    Pieces or None       a surface without bad places, when there is one
    """
    n = len(old.points)
    was, now = patches(old.cells, new.cells, n)
    back = np.zeros(n, dtype=np.bool_)
    surface, found = new, bad(new)
    for trial in range(trials):
        if not found.any():
            return surface
        for _ in range(trial // 2):
            for cells in (old.cells, surface.cells):
                found[cells[found[cells].any(axis=1)]] = True
        back |= found
        surface = _returned(old, new, was, now, back)
        found = bad(surface)
    return None if found.any() else surface


def _returned(old: Pieces, new: Pieces, was: IntArray, now: IntArray, back: BoolArray) -> Pieces:
    """The result with the patches at some vertices, (n,) bool, as they were.

    The vertices of these patches join the others, in place.
    """
    chosen = np.zeros(max(int(was.max()), int(now.max())) + 1, dtype=np.bool_)
    chosen[was[back[old.cells].all(axis=1)]] = True
    chosen[now[back[new.cells].all(axis=1)]] = True
    source, target = np.flatnonzero(chosen[was]), np.flatnonzero(chosen[now])
    back[old.cells[source]] = True
    points, cells, regions = new.points.copy(), new.cells.copy(), new.regions.copy()
    points[back] = old.points[back]
    cells[target], regions[target] = old.cells[source], old.regions[source]
    return Pieces(points, cells, regions)


def _keys(edges: Edges, n: int) -> NDArray[np.int64]:
    low, high = edges.vertices[:, 0].astype(np.int64), edges.vertices[:, 1]
    return np.asarray(low * n + high)


def mended_state(
    start: Start, kept: Kept, options: Options, leaving: Leaving, memory: Memory
) -> State | None:
    """The best state of a memory, brought back to the input where it breaks the promise.

    None where the rest is no better than the input.
    """
    keep, best = tuple(options.keep), memory.states[0]

    def state(surface: Pieces) -> State:
        return State(*surface, figures(surface.points, surface.cells), "mended")

    def bad(surface: Pieces) -> BoolArray:
        now = state(surface)
        placed = leaving(start.placed(now))
        found = outside(start.mesh, kept, placed.points, placed.cells)[start.frame.vertices]
        if now.figures.worse_than(memory.before, keep):
            passed = memory.before.passed_by(cell_shapes(surface.points, surface.cells), keep)
            found[surface.cells[passed]] = True
        return found

    surface = mended(
        Pieces(start.seen, start.cells, start.regions),
        Pieces(best.points, best.cells, best.regions), bad, POLICY.surface_mendings,
    )
    if surface is None:
        return None
    found = state(surface)
    if found.figures.worse_than(memory.before, keep):
        return None
    return found if found.figures.score > memory.before.score else None
