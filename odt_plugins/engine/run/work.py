"""A run on its way: the input in the engine's numbers, and what its stages share."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odt_plugins.engine.cells.extremes import Bounds, Extremes
from odt_plugins.engine.cells.geometry import boundary_vertices, interface_vertices
from odt_plugins.engine.finish.phases import Phase, without_flips
from odt_plugins.engine.finish.volume import finish
from odt_plugins.engine.odt.density import Density, make_density
from odt_plugins.engine.odt.rounds import Log
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import Figures, cell_shapes, figures
from odt_plugins.engine.record.memory import Beside, Memory, State
from odt_plugins.engine.run.judge import envelope_length, slides
from odt_plugins.engine.run.outcome import Outcome
from odt_plugins.engine.run.sizes import inner_density
from odt_plugins.engine.run.within import Within
from odt_plugins.engine.topology.adjacency import cell_neighbors
from odt_plugins.engine.topology.complex import Complex, make_complex
from odt_plugins.engine.topology.frame import Frame, make_frame
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.chunks import Pool
from odt_plugins.mesh.numbering import new_numbers
from odt_plugins.mesh.seen import as_seen, in_unit
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.options import Options

if TYPE_CHECKING:
    from odt_plugins.engine.sliding.boundary import Skin



@dataclass(frozen=True)
class Start:
    """The input without its frozen cells, in inner numbering and coordinates.

    Attributes
    ----------
    mesh : SimplexMesh              as the caller gave it
    frame : Frame
    points : (k, D) float64
    cells : (m1, d + 1) int32, regions : (m1,) int32
    metric : (k, D (D + 1) / 2) float64    see SimplexMesh, for inner coordinates; (k, 0) without
    """

    mesh: SimplexMesh
    frame: Frame
    points: FloatArray
    cells: IntArray
    regions: IntArray
    metric: FloatArray

    @property
    def seen(self) -> FloatArray:
        """Points with the metric behind the coordinates, as kernels take them; a copy."""
        return np.column_stack([self.points, self.metric])

    @property
    def number(self) -> IntArray:
        """Inner number of every vertex of the caller's, (n,); -1 of those that are not inside."""
        number = np.full(len(self.mesh.points), -1, dtype=np.int32)
        number[self.frame.vertices] = np.arange(len(self.points), dtype=np.int32)
        return number

    def pairs(self, edges: IntArray) -> IntArray:
        """Inner numbers of the caller's edges (q, 2); without those that are not inside."""
        inner = self.number[edges]
        return inner[(inner >= 0).all(axis=1)]

    def placed(self, state: State) -> Outcome:
        """A state in the caller's numbering, with the frozen cells.

        A vertex that did not move keeps its bits. Vertices keep their index, or their order when
        some have gone; new ones stand at the end.
        """
        mesh, frame = self.mesh, self.frame
        points = mesh.points.copy()
        n, d = self.points.shape
        there, metric = state.points[:, :d], mesh.metric.copy()
        moved = (there[:n] != self.points).any(axis=1)
        points[frame.vertices[moved]] = frame.outside(there[:n][moved])
        if len(metric):
            metric[frame.vertices[moved]] = in_unit(state.points[:n, d:][moved], 1.0 / frame.scale)
        regions = np.concatenate([mesh.regions[mesh.frozen], state.regions])
        used = np.zeros(len(state.points), dtype=np.bool_)
        used[state.cells] = True
        new = n + np.flatnonzero(used[n:])
        if used[:n].all() and not len(new):
            cells = np.concatenate([mesh.cells[mesh.frozen], frame.vertices[state.cells]])
            return Outcome(points, np.ascontiguousarray(cells), regions, metric=metric)
        left = np.ones(len(points), dtype=np.bool_)
        left[frame.vertices[~used[:n]]] = False
        kept = np.flatnonzero(left)
        origin = np.concatenate([kept, np.full(len(new), -1, dtype=np.int64)])
        outer = new_numbers(origin, len(points))
        inner = np.full(len(state.points), -1, dtype=np.int32)
        inner[:n] = outer[frame.vertices]
        inner[new] = len(kept) + np.arange(len(new))
        cells = np.concatenate([outer[mesh.cells[mesh.frozen]], inner[state.cells]])
        points = np.concatenate([points[kept], frame.outside(there[new])])
        if len(metric):
            more = in_unit(state.points[new, d:], 1.0 / frame.scale)
            metric = np.concatenate([metric[kept], more])
        return Outcome(points, np.ascontiguousarray(cells), regions, origin=origin, metric=metric)


def make_start(mesh: SimplexMesh) -> Start:
    """Number the cells that may change along a curve, and scale them."""
    frame, cells = make_frame(mesh)
    metric = mesh.metric if len(mesh.metric) else np.zeros((len(mesh.points), 0))
    return Start(
        mesh, frame, frame.inside(mesh.points[frame.vertices]), cells,
        np.ascontiguousarray(mesh.regions[frame.active]),
        in_unit(metric[frame.vertices], frame.scale),
    )


@dataclass(frozen=True)
class Work:
    """What the stages of one run share.

    Attributes
    ----------
    start : Start                   the input in inner numbering
    options : Options
    locked, boundary : (k,) bool    vertices that may not move; on the boundary or an interface
    density : Density
    before : Figures                of the input
    bounds : Bounds                 extremes that no new cell may pass
    memory : Memory                 the best states so far
    log : Log
    within : Within                 how the mesh lies within a larger one, in inner numbering
    pool : Pool or None
    """

    start: Start
    options: Options
    locked: BoolArray
    boundary: BoolArray
    density: Density
    before: Figures
    bounds: Bounds
    memory: Memory
    log: Log
    within: Within
    pool: Pool | None

    @property
    def slides(self) -> bool:
        """Whether the boundary may move."""
        return slides(self.start.mesh, self.options)

    def slots(self, neighbors: IntArray | None = None) -> Complex:
        """The input as a complex of its own, whose boundary slides if it may."""
        return _slots(self.start, self.options, self.locked, self.boundary, self.within, neighbors)

    def settle(self, mesh: Complex, phases: tuple[Phase, ...], bounds: Bounds) -> None:
        """Run phases of stage 2 on a complex within bounds."""
        settle(mesh, phases, bounds, self.log, self.pool, self.options.threads, self.within.part)
        self.density.resample(mesh.points, self.pool)


def begin(
    mesh: SimplexMesh, options: Options, within: Within, pool: Pool | None
) -> tuple[Work, Complex]:
    """Number, lock, measure: what a run begins with, and the input as its first complex."""
    clock = time.perf_counter()
    log = Log(without=within.without, flips=options.smoothing.connectivity != "none")
    neighbors = cell_neighbors(mesh.cells, pool=pool)
    locked, boundary = locked_vertices(mesh, neighbors)
    start = make_start(mesh)
    frame, points, cells = start.frame, start.seen, start.cells
    locked = np.ascontiguousarray(locked[frame.vertices])
    boundary = np.ascontiguousarray(boundary[frame.vertices])
    first = _slots(start, options, locked, boundary, within, frame.inner_neighbors(neighbors))
    del neighbors
    before = _figures_before(start, options, within, pool)
    within = within.numbered(frame.vertices)
    memory = Memory(before, tuple(options.keep), options.objective, by_score=options.finish,
                    aside=None if within.whole is None else within.cut, pool=pool,
                    beside=_beside(start, within, pool))
    m = first.used
    density = make_density(inner_density(mesh, options, frame), options.smoothing.exponent,
                           first.points,
                           first.cells[:m], first.neighbors[:m].copy())
    log.times["prepare"] = time.perf_counter() - clock
    bounds = extremes(before, tuple(options.keep))
    if within.fresh is not None:
        bounds = _as_good_as_before(bounds, points, cells[~within.fresh[cells].any(axis=1)])
    if first.skin is not None:
        within = within._replace(cut=None)
    return Work(start, options, locked, boundary, density, before, bounds, memory, log, within,
                pool), first


def _slots(
    start: Start, options: Options, locked: BoolArray, boundary: BoolArray, within: Within,
    neighbors: IntArray | None,
) -> Complex:
    points = start.seen
    skin = _skin(start, options, points, within) if slides(start.mesh, options) else None
    return make_complex(points, start.cells, start.regions, locked, boundary, skin, neighbors)


def _figures_before(start: Start, options: Options, within: Within, pool: Pool | None) -> Figures:
    """Figures that no state may fall below: of the input, of the larger mesh, of what was valid."""
    mesh, whole = start.mesh, within.whole
    before = figures(start.seen, start.cells, options.objective, pool)
    before = before if whole is None else before.with_extremes_of(whole)
    if mesh.valid_before is None:
        return before
    places, valid = mesh.valid_before
    return before.or_worse(figures(start.frame.inside(places), valid, options.objective))


def _beside(start: Start, within: Within, pool: Pool | None) -> Beside | None:
    """The cells that stay; None where none does, or a larger mesh or a tangled one is judged."""
    mesh = start.mesh
    if within.whole is not None or mesh.valid_before is not None or not mesh.frozen.any():
        return None
    held = as_seen(mesh.points, mesh.cells[mesh.frozen], mesh.metric)
    return Beside(cell_shapes(*held, pool), cell_shapes(start.seen, start.cells, pool))


def locked_vertices(mesh: SimplexMesh, neighbors: IntArray) -> tuple[BoolArray, BoolArray]:
    """Vertices that may not move, and those on the boundary or on an interface, (n,) each.

    A vertex of a frozen cell may not move either.
    """
    boundary = boundary_vertices(mesh.cells, len(mesh.points), mesh.bodies(), neighbors)
    locked = boundary | mesh.fixed
    locked[mesh.cells[mesh.frozen]] = True
    return locked, boundary


def extremes(before: Figures, keep: tuple[str, ...]) -> Bounds:
    """Extremes that no new cell may pass: those of the input, where they are to be kept."""
    quality = float(before.min_quality) if "min_quality" in keep else 0.0
    large = float(before.cos_min_angle) if "min_angle" in keep else 1.0
    small = float(before.cos_max_angle) if "max_angle" in keep else -1.0
    low, high = (math.cos(math.radians(angle)) for angle in POLICY.locked_angles)
    locked = Extremes(POLICY.locked_quality, min(large, low), max(small, high))
    return Bounds(Extremes(quality, large, small), locked)


def settle(
    mesh: Complex, phases: tuple[Phase, ...], bounds: Bounds, log: Log,
    pool: Pool | None, threads: int, part: float,
) -> None:
    """Run phases of stage 2 that are not left out, and count.

    A guard is a share of the cells divided by ``part``, see :class:`Within`.
    """
    phases = tuple(
        replace(phase, guard=min(1.0, phase.guard / part)) if phase.guard else phase
        for phase in phases if phase.name not in log.without
    )
    if not log.flips:
        phases = tuple(map(without_flips, phases))
    flips, moves = finish(mesh, phases, bounds, pool, threads)
    log.add("quality flips", flips)
    log.add("vertex moves", moves)


def _as_good_as_before(bounds: Bounds, points: FloatArray, cells: IntArray) -> Bounds:
    """Hold cells without a movable vertex to the 1 % quantile of cells that were optimised before.

    Most of them are at a cut and were as good as others: no later round will see them again.
    """
    if not len(cells):
        return bounds
    quality = max(bounds.locked.quality, figures(points, cells).p1_quality)
    return bounds._replace(locked=bounds.locked._replace(quality=quality))


def _skin(start: Start, options: Options, points: FloatArray, within: Within) -> Skin:
    """The boundary as it may slide; interfaces, fixed vertices and frozen cells hold it."""
    from odt_plugins.engine.run.volumes import REACH, volume_share
    from odt_plugins.engine.sliding.skin import make_skin, on_earlier_ground

    mesh, frame = start.mesh, start.frame
    locked = mesh.fixed | interface_vertices(mesh.cells, len(mesh.points), mesh.bodies())
    locked[mesh.cells[mesh.frozen]] = True
    share, envelope = within.share, envelope_length(mesh, options) * frame.scale
    if within.whole is None:
        share, envelope = volume_share(mesh, options, locked, share), REACH * envelope
    skin = make_skin(
        points, start.cells, locked=locked[frame.vertices], envelope=envelope,
        angle=options.feature_angle, stays=start.pairs(mesh.stays), lines=start.pairs(mesh.lines),
        share=share,
    )
    if mesh.ground is None:
        return skin
    return on_earlier_ground(skin, mesh.ground, frame.inside(mesh.ground.points))
