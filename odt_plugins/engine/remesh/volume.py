"""Tetrahedra of other sizes: rounds of split, collapse, flips and moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from odt_plugins.engine.cells.content import cells_of_sizes
from odt_plugins.engine.cells.extremes import FREELY as ANY
from odt_plugins.engine.cells.extremes import Bounds
from odt_plugins.engine.compiled.threads import pieces
from odt_plugins.engine.finish.phases import Phase
from odt_plugins.engine.finish.volume import finish
from odt_plugins.engine.moves.passes import measures
from odt_plugins.engine.odt.density import Density
from odt_plugins.engine.odt.rounds import Log, smooth
from odt_plugins.engine.remesh.body import (
    FREELY,
    INSIDE,
    LINE,
    PATCH,
    Body,
    Guard,
    Scratch,
    with_room,
)
from odt_plugins.engine.remesh.collapse import collapse_edges
from odt_plugins.engine.remesh.flip import flip_patches
from odt_plugins.engine.remesh.lay_out import SPARE, edges_beyond
from odt_plugins.engine.remesh.relax import relax_surface
from odt_plugins.engine.remesh.relent import reached_sizes, relented
from odt_plugins.engine.remesh.simplices import make_simplices
from odt_plugins.engine.remesh.sizes import unique_edges
from odt_plugins.engine.remesh.split import split_edges
from odt_plugins.engine.topology.complex import make_complex
from odt_plugins.engine.topology.star import star_sum
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.chunks import Pool
from odt_plugins.options import Options

ROUNDS = 6
"""Most rounds of all operations."""

PASSES = 6
"""Most passes of splits, and of collapses, in a round."""

STEADY = 0.5
"""Rounds in a metric end with one that changed more than this part of what the one before did: what
splits make collapses take away again."""

SETTLED = 2.5e-3
"""Part of the cells: rounds without a metric end with one of fewer splits and collapses."""

LONG, SHORT = 4.0 / 3.0, 4.0 / 5.0
"""Edges longer, or shorter, than so many times their size are cut or vanish."""

COARSER = 1.5
"""Limit of a round by that of the next, on the way from coarse to fine."""

SWEEPS = 3
"""Sweeps over the surface in a round, and rounds of ODT inside."""

FLAT = 1e-10
"""Part by which vector areas around a vertex add up to less than areas do where all is flat."""

FEW = 2e-3
"""Passes end with one that changed less than this part of the edges that were looked at."""

OFF = 0.2
"""Part of the envelope by which a patch goes out at most in one sweep, to bring volumes back."""

RELENTING = 2
"""Round after which sizes may give way."""

SLIVER = 0.1
"""Largest radius ratio of a tetrahedron that stage 2 improves between rounds, without a metric."""

SLIVERS = Phase(2.0, 0.0, 2, 1, name="slivers")
"""Phase of stage 2 at slivers; its share is their part of the cells."""

FREE_BOUNDS = Bounds(ANY, ANY)


@dataclass
class Resizing:
    """A body on its way.

    Attributes
    ----------
    body : Body, guard : Guard, scratch : Scratch
    field : Density                lengths on the input
    walk : (n,) int32              cell of the input at every vertex
    log : Log
    own : (k,) float64             sizes that the input has
    growth : float                 see Wish
    stuck : float                  part of the vertices of the surface up to which it may stay finer
                                   without sizes that give way
    most : float                   cells, about, beyond which they do not
    crowded : float                cells from which on none are split
    firm : bool                    whether sizes that gave way would change nothing
    """

    body: Body
    guard: Guard
    scratch: Scratch
    field: Density
    walk: IntArray
    log: Log
    own: FloatArray
    growth: float
    stuck: float
    most: float
    crowded: float
    firm: bool = True

    def sizes(self, pool: Pool | None) -> None:
        """Take the sizes of the field at the places where vertices are now."""
        n = int(self.body.used[0])
        known = len(self.walk)
        walk = np.concatenate([self.walk, np.zeros(n - known, dtype=np.int32)])
        for v in range(known, n):
            walk[v] = walk[self.body.parent[v]]
        points = np.ascontiguousarray(self.body.points[:n])
        self.body.size[:n] = self.field.at(points, pool, walk)
        self.field.resample(points, pool, walk)
        self.body.points[:n] = points
        self.walk = walk

    def relent(self) -> None:
        """Make sizes smaller where the surface stays finer, if too much of it does.

        Those of a metric stay.
        """
        if self.field.metric.size:
            return
        reached = reached_sizes(self.body)
        stuck = np.count_nonzero(np.isfinite(reached))
        surface = np.unique(self.body.triangles.rows[self.body.triangles.live()])
        if stuck > self.stuck * len(surface):
            self.stuck = 0.0
            field = relented(self.field, self.body, reached, self.own, self.growth)
            if cells_of_sizes(field.nodes[:, :3], field.cells, field.nodes[:, 3]) <= self.most:
                self.field = field
        self.firm = not (self.stuck and stuck)


def resize(work: Resizing, slides: bool, pool: Pool | None, tick: Callable[[float], None],
           threads: int, *, coarse: bool = False) -> bool:
    """Split and collapse edges until they have their sizes, and move vertices in between.

    Parameters
    ----------
    coarse : bool    whether rounds of ever lower limits come first: slivers vanish with the short
                     edges of a coarse mesh, which cuts in halves would make more of

    Returns
    -------
    bool             False where cells are too flat to be cut and ``coarse`` rounds are to be tried
    """
    work.sizes(pool)
    limits = _coarser(work) if coarse else []
    rounds = range(-len(limits), ROUNDS)
    before = np.inf
    for k in rounds:
        limit = limits[k] if k < 0 else LONG
        splits = _split(work, pool, limit)
        gone = _collapse(work, limit)
        work.log.add("splits", splits)
        work.log.add("collapses", gone)
        tick((k + 0.4 - rounds[0]) / len(rounds))
        if slides:
            work.log.add("boundary flips", _flip(work))
            for _ in range(SWEEPS):
                _relax(work)
        _smooth(work, pool, threads)
        if k == RELENTING:
            work.relent()
        work.sizes(pool)
        tick((k + 1.0 - rounds[0]) / len(rounds))
        if k == 0 and not coarse and _jammed(work):
            return False
        changed = splits + gone
        if k >= 0 and _settled(work, k, changed, before):
            break
        before = changed
    _collapse(work)
    return True


def _coarser(work: Resizing) -> list[float]:
    """Limits from that of the longest edge down to LONG, which comes after them."""
    limits: list[float] = []
    limit = COARSER * LONG
    while len(edges_beyond(work.body, limit, longer=True)):
        limits.insert(0, limit)
        limit *= COARSER
    return limits


def _jammed(work: Resizing) -> bool:
    """Whether edges stay twice too long, as cells around them are too flat to be cut."""
    body = work.body
    edges = edges_beyond(body, 2.0 * LONG, longer=True)
    free = (body.hold[edges] == FREELY).any(axis=1)
    return not work.field.metric.size and free.sum() > FEW * len(body.tets.live())


def _settled(work: Resizing, k: int, changed: int, before: float) -> bool:
    """Whether round k is the last, of so many splits and collapses, where k - 1 had ``before``."""
    if work.field.metric.size:
        return changed > STEADY * before
    return k > RELENTING and changed < SETTLED * len(work.body.tets.live())


def _split(work: Resizing, pool: Pool | None, longest: float) -> int:
    """Split long edges; in a metric edges that became short vanish between the passes."""
    total = 0
    for limit in [*_halved(work), *PASSES * [longest]]:
        if len(work.body.tets.live()) > work.crowded:
            break
        edges = edges_beyond(work.body, limit, longer=True)
        done = np.zeros(1, dtype=np.int32)
        for first, last in pieces(0, len(edges)):
            while first < last:
                first += int(split_edges(
                    work.body, work.guard, edges[first:last], limit, work.scratch, done))
                if first < last:
                    left = last - first
                    work.body, work.scratch, work.guard = with_room(
                        work.body, work.scratch, work.guard, left, 8 * left + 4096)
        work.sizes(pool)
        total += int(done[0])
        if limit == longest and done[0] <= FEW * len(edges):
            break
        if work.field.metric.size:
            work.log.add("collapses", _collapse(work, limit))
    return total


def _halved(work: Resizing) -> list[float]:
    """Limits that come before LONG, each half the one before; none where there is no metric.

    Halves of the edges across a layer are shorter along the layer as well. So edges that became too
    short there vanish before the next halving, while those across may still be long.
    """
    limits = [LONG]
    if work.field.metric.size:
        while len(edges_beyond(work.body, 2.0 * limits[0], longer=True)):
            limits.insert(0, 2.0 * limits[0])
    return limits[:-1]


def _collapse(work: Resizing, longest: float = LONG) -> int:
    """Let short edges vanish; after the first pass those alone near which cells have changed."""
    body, total = work.body, 0
    n = int(body.used[0])
    near = np.ones(n, dtype=np.bool_)
    others = np.zeros((0, 2), dtype=np.int32)
    for _ in range(PASSES):
        edges = edges_beyond(body, SHORT, longer=False, near=near)
        count = len(edges) + len(others)
        rows, points = body.tets.rows.copy(), body.points[:n].copy()
        done = sum(
            int(collapse_edges(body, work.guard, edges[first:last], (SHORT, longest),
                               work.scratch))
            for first, last in pieces(0, len(edges)))
        total += done
        if done <= FEW * count:
            break
        moved = (points != body.points[:n]).any(axis=1)
        changed = (rows != body.tets.rows).any(axis=1) | moved[rows].any(axis=1)
        near = np.zeros(n, dtype=np.bool_)
        near[rows[changed]] = True
        others = np.concatenate([edges, others])
        others = others[~near[others].any(axis=1)]
    return total


def _flip(work: Resizing) -> int:
    rows = work.body.triangles.rows[work.body.triangles.live()]
    edges = unique_edges(rows)
    return sum(int(flip_patches(work.body, work.guard, edges[first:last], work.scratch))
               for first, last in pieces(0, len(edges)))


def _relax(work: Resizing) -> int:
    n = int(work.body.used[0])
    kind = work.body.kind[:n]
    order = np.flatnonzero((kind == PATCH) | (kind == LINE)).astype(np.int32)
    most, (flat, share) = OFF * float(work.guard.limits[0]), _flat(work)
    offset = work.guard.offsets()
    offset = np.clip(np.divide(offset, share, out=np.zeros(len(offset)), where=share > 0.0),
                     -most, most)
    return sum(
        int(relax_surface(work.body, work.guard, here[first:last], out, work.scratch))
        for here, out in ((order[flat[order]], 0.0 * offset), (order[~flat[order]], offset))
        for first, last in pieces(0, len(here)))


def _flat(work: Resizing) -> tuple[BoolArray, FloatArray]:
    """Vertices (n,) of patches around which these are flat, and parts (patches,) that are not."""
    body, n, count = work.body, int(work.body.used[0]), len(work.guard.area)
    live = body.triangles.live()
    rows, tag = body.triangles.rows[live], body.triangles.tag[live]
    a, b, c = (body.points[rows[:, i], :3] for i in range(3))
    normal = np.cross(b - a, c - a)
    area = np.sqrt((normal * normal).sum(axis=1))
    around = star_sum(normal, rows, n)
    flat = (body.kind[:n] == PATCH) & (
        np.sqrt((around * around).sum(axis=1)) >= (1.0 - FLAT) * star_sum(area, rows, n))
    whole = np.bincount(tag, area, count)
    bent = np.bincount(tag, area * (~flat[rows]).mean(axis=1), count)
    return flat, np.divide(bent, whole, out=np.zeros(count), where=whole > 0.0)


def arrays_of(body: Body) -> tuple[FloatArray, IntArray, IntArray]:
    """Points (n, 3), gone vertices among them, cells and the numbers of their regions."""
    n = int(body.used[0])
    live = body.tets.live()
    return body.points[:n].copy(), body.tets.rows[live], body.tets.tag[live]


def _smooth(work: Resizing, pool: Pool | None, threads: int) -> None:
    """Run rounds of ODT and flips inside, then improve slivers, beside which no edge is resized."""
    points, cells, regions = arrays_of(work.body)
    n = len(points)
    kind = work.body.kind[:n]
    locked = (kind != INSIDE) | (work.body.hold[:n] != FREELY)
    mesh = make_complex(points, cells, regions, locked, kind != INSIDE)
    density = replace(work.field, power=-5.0, start=work.walk)
    options = Options(smoothing={"rounds": SWEEPS, "connectivity": "flips"}, threads=threads)
    mesh, _ = smooth(mesh, density, options, FREE_BOUNDS, Log(), lambda _: None, None, pool)
    few = float((measures(mesh, SLIVERS.objective, pool) < SLIVER).sum()) / mesh.count()
    if few and not work.field.metric.size:
        finish(mesh, (replace(SLIVERS, share=few),), FREE_BOUNDS, pool, threads)
    work.body.points[:n] = mesh.points
    cells, regions = mesh.mesh_arrays()
    work.body = work.body._replace(tets=make_simplices(
        cells, regions, np.zeros(len(cells), np.bool_), len(work.body.points),
        int(SPARE * len(cells)) + 64))
