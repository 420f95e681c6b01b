"""Other sizes for triangles: resized until the promise holds, within the envelope, and judged."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from functools import partial
from hashlib import sha256
from typing import Any, NamedTuple

import numpy as np

from odt_plugins.engine.cells.extremes import Extremes
from odt_plugins.engine.ground.crossings import crossed_facets
from odt_plugins.engine.ground.envelope import distances, uncovered, within
from odt_plugins.engine.ground.features import find_features
from odt_plugins.engine.ground.reference import make_reference
from odt_plugins.engine.ground.sheet import LINE, LOCKED
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import cell_shapes, figures
from odt_plugins.engine.record.memory import State
from odt_plugins.engine.record.relaxed import relaxed, spoiling
from odt_plugins.engine.retile.areas import labels_beside
from odt_plugins.engine.retile.net import Net
from odt_plugins.engine.retile.surface import Base, resize
from odt_plugins.engine.run.outcome import Leaving, Outcome, unchanged
from odt_plugins.engine.run.work import extremes
from odt_plugins.engine.surface.driver import (
    SurfaceOutcome,
    SurfaceStart,
    surface_outcome,
    surface_start,
)
from odt_plugins.engine.surface.in_plane import IN_PLANE, in_space, metric_in_space
from odt_plugins.engine.surface.judge import TOLERANCE, Distance, Kept
from odt_plugins.engine.topology.star import vertex_stars
from odt_plugins.errors import counted
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray, LongArray
from odt_plugins.mesh.faces import Faces, joined, labels_at, renumbered, without
from odt_plugins.mesh.facets import uneven_facets
from odt_plugins.mesh.numbering import new_numbers
from odt_plugins.mesh.seen import as_seen
from odt_plugins.mesh.simplex import SimplexMesh, freeze
from odt_plugins.mesh.surface import Edges, surface_edges
from odt_plugins.options import Options
from odt_plugins.progress import silent
from odt_plugins.promise.good import GOOD, fallen_since, filled_up
from odt_plugins.promise.region_sizes import other_sizes
from odt_plugins.promise.retiled import broken_by_retiling, without_area
from odt_plugins.promise.surface import FOLD, bad_places

ATTEMPTS = 5
"""Runs. In space the second and third have less and less of the envelope around the places where
the one before broke the promise; then triangles of the input stay there, or the poor ones alone if
that were all. In the plane they do at once, but for regions whose area is another, which first get
less of the envelope."""

FLAT = 64 * float(np.finfo(np.float64).eps)
"""Least altitude of a triangle that a split makes, as a part of the largest coordinate."""

NARROWER, NARROWED = 0.3, 2
"""Part of the envelope that is left there each time, and how often it is narrowed in space."""


TURNED = 20.0
"""Degrees by which a surface may turn more at a crease, as its edges are other chords of it."""


class Judged(NamedTuple):
    """What a mesh breaks of the promise, near which of its vertices, and how far it is.

    `unlike` are the triangles of the input, in the plane, around regions whose area is another.
    """

    broken: list[str]
    bad: FloatArray
    distance: Distance
    unlike: BoolArray


class Made(NamedTuple):
    """What is to be judged, the vertices of the input that it has, and its slots of triangles."""

    outcome: Outcome
    origin: LongArray
    slots: int


def retile(
    mesh: SimplexMesh, sizes: FloatArray, options: Options, leaving: Leaving,
    most: float = math.inf, base: SimplexMesh | None = None, full: int = 0,
    done: dict[bytes, Made] | None = None,
) -> Outcome:
    """Give triangles in the plane or in space other sizes.

    Parameters
    ----------
    mesh : SimplexMesh
    sizes : (n,) float64     length that edges are to have at the vertices, of the base if given
    options : Options        `envelope`, `feature_angle`, `boundary` and `keep` count
    leaving : callable       applied to every mesh before it is judged
    most : float             triangles from which on no edges are split, and none is resized anew
    base : SimplexMesh       the mesh with more vertices, behind its own, as it is to be resized: no
                             triangles of it stay, the input is returned instead
    full : int               triangles to which they are filled up by good ones where figures are
                             looked at, see ``promise.good.filled_up``
    done : dict              what was made of the mesh so far, which is judged anew; grows

    Returns
    -------
    Outcome                  a mesh that keeps the promise as it leaves, at worst the input itself
    """
    if mesh.frozen.all():
        return leaving(unchanged(mesh, "no triangle may change"))
    clock = time.perf_counter()
    length = options.envelope * mesh.extent
    base = mesh if base is None else base
    part = np.ones(len(base.cells))
    held = base
    old = make_reference(in_space(base.points), base.cells)
    bounds = _bounds(mesh, tuple(options.keep))
    before: list[str] = []
    done, made = {} if done is None else done, 0
    report = options.progress or silent
    report("resizing", 0.0)
    for attempt in range(ATTEMPTS):
        key = sha256(b"".join(map(np.ndarray.tobytes, (sizes, part, held.frozen)))).digest()
        if key not in done:
            done[key] = _resized(mesh, held, sizes, part, bounds, options, leaving, most)
        outcome, origin, slots = done[key]
        judged = _judged(mesh, outcome, origin, length, options, full)
        if not judged.broken:
            return _told(outcome, origin, judged, before, clock)
        before = before or judged.broken
        made += slots
        if not (len(judged.bad) or judged.unlike.any()) or made > most:
            break
        near = np.zeros(len(base.points), dtype=np.bool_)
        near[base.cells[old.closest(in_space(judged.bad))[1]]] = True
        near[base.cells[near[base.cells].any(axis=1)]] = True
        spoiled = near[base.cells].any(axis=1)
        if attempt < NARROWED and mesh.is_surface:
            part[spoiled] *= NARROWER
            continue
        if base is not mesh:
            break
        if attempt < ATTEMPTS - 2:
            part[judged.unlike] *= NARROWER
        else:
            spoiled |= judged.unlike
        if (held.frozen | spoiled).all():
            spoiled = _poor(base) & ~held.frozen
            if not spoiled.any():
                break
        held = freeze(held, held.frozen | spoiled)
        if held.frozen.all():
            break
    report("finishing", 1.0)
    outcome = leaving(unchanged(mesh, "no other sizes kept the promise"))
    return replace(outcome, fallback=f"the input is returned, since {'; '.join(before)}")


def _resized(
    mesh: SimplexMesh, held: SimplexMesh, sizes: FloatArray, part: FloatArray, bounds: Extremes,
    options: Options, leaving: Leaving, most: float,
) -> Made:
    """What other sizes make of triangles within a part (m,) of the envelope around each."""
    start = surface_start(held)
    frame, length = start.frame, options.envelope * mesh.extent
    reach = POLICY.surface_guard * (length - mesh.sag) * frame.scale * part[frame.active]
    unit = 1.0 if len(mesh.metric) else frame.scale
    net, marks = resize(_base(start, options), sizes[frame.vertices] * unit, reach, bounds,
                        feature_angle=options.feature_angle, most=most,
                        tick=partial(options.progress or silent, "resizing"))
    n, m = net.count[0], net.count[1]
    points = np.ascontiguousarray(net.points[:n, _columns(mesh)])
    cells, labels = net.triangles[:m].copy(), net.labels[:m].copy()
    state = State(points, cells, labels, figures(points, cells), "resized")
    placed = start.placed(state)
    if placed.origin is None:
        placed = replace(placed, origin=np.arange(len(placed.points)))
    origin: Any = placed.origin
    faces = _lines_of(held, start, marks, net, origin), mesh.faces[1]
    origin = np.where(origin < len(mesh.points), origin, -1)
    return Made(leaving(replace(placed, origin=origin, faces=faces)), origin, len(net.triangles))


def _poor(mesh: SimplexMesh) -> BoolArray:
    """Mark the triangles (m,) whose radius ratio is not good enough for other sizes."""
    shapes = cell_shapes(*as_seen(mesh.points, mesh.cells, mesh.metric))
    return np.asarray(shapes[:, 0] < GOOD[3]["min_quality"])


def _lines_of(
    mesh: SimplexMesh, start: SurfaceStart, marks: IntArray, net: Net, origin: LongArray
) -> Faces:
    """Lines with labels that those of a mesh have become: edges on the same tracks."""
    old, n = mesh.faces[0], len(start.points)
    edges = start.frame.vertices[start.edges.vertices]
    own = marks >= 0
    label = np.full(int(marks.max(initial=-1)) + 2, -1, dtype=np.int32)
    label[marks[own]] = labels_at(edges[own], old)
    number = np.empty(int(net.count[0]), dtype=np.int32)
    outer = new_numbers(origin, len(mesh.points))
    number[:n] = outer[start.frame.vertices]
    triangles = net.triangles[: net.count[1]]
    new = n + np.flatnonzero(np.bincount(triangles.ravel(), minlength=len(number))[n:])
    number[new] = len(origin) - len(new) + np.arange(len(new), dtype=np.int32)
    ends = number[triangles[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2)]
    found = label[net.marks[: net.count[1]].ravel()]
    rows, first = np.unique(np.sort(ends[found >= 0], axis=1), axis=0, return_index=True)
    return joined(renumbered(without(old, edges), outer), Faces(rows, found[found >= 0][first]))


def _told(
    outcome: Outcome, origin: LongArray, judged: Judged, before: list[str], clock: float
) -> Outcome:
    """An outcome with what is said of it."""
    why = None
    if before:
        why = f"some places stay nearer to the input or as they were, since {'; '.join(before)}"
    outcome = SurfaceOutcome(**vars(outcome), distance=judged.distance)
    return replace(outcome, origin=origin, times={"resizing": time.perf_counter() - clock},
                   stop_reason="edges are as long as the envelope and the features allow",
                   fallback=why)


def with_kept(mesh: SimplexMesh, outcome: Outcome, options: Options) -> SurfaceOutcome:
    """An outcome of a curved surface with what was kept of it while it was given other sizes."""
    start = surface_start(mesh)
    base, vertices = _base(start, options), start.frame.vertices
    features = find_features(
        base.points, base.triangles, base.edges, vertex_stars(base.triangles, len(base.points)),
        angle=options.feature_angle, fixed=base.fixed, kept=base.kept, slack=math.inf,
    )
    on_line = (features.kind == LINE) & (options.boundary == "slide")
    locked = np.ones(len(mesh.points), dtype=np.bool_)
    locked[vertices] = (features.kind == LOCKED) | ((features.kind == LINE) & ~on_line)
    kept = Kept(mesh.extent, options.envelope * mesh.extent,
                vertices[base.edges.vertices[features.edges]], locked, features.corners,
                int(on_line.sum()))
    distance = getattr(outcome, "distance", None) or Distance(0.0, 0.0)
    return surface_outcome(outcome, kept, distance)


def _bounds(mesh: SimplexMesh, keep: tuple[str, ...]) -> Extremes:
    """Extremes that triangles must keep: those of the input, or what is good enough."""
    before = figures(*as_seen(mesh.points, mesh.cells, mesh.metric))
    return extremes(relaxed(before, keep, 3), keep).cells


def _columns(mesh: SimplexMesh) -> list[int]:
    """Columns of the points of a net that hold the coordinates of a mesh, then its metric."""
    if mesh.is_surface:
        return list(range(9 if len(mesh.metric) else 3))
    return [0, 1, *(3 + k for k in IN_PLANE if len(mesh.metric))]


def _base(start: SurfaceStart, options: Options) -> Base:
    """The triangles that may change, in space."""
    mesh, edges = start.mesh, start.edges
    fixed = start.fixed | mesh.anchored[start.frame.vertices]
    frozen = surface_edges(mesh.cells[mesh.frozen], len(mesh.points)).vertices
    n = len(start.points)
    key = edges.vertices[:, 0].astype(np.int64) * n + edges.vertices[:, 1]
    stays = np.sort(np.concatenate([start.pairs(frozen), start.pairs(mesh.stays)]), axis=1)
    held = np.isin(key, stays[:, 0].astype(np.int64) * n + stays[:, 1])
    kept = start.kept | held
    if options.boundary == "fixed":
        held = np.ones(len(key), dtype=np.bool_)
    thin = FLAT * float(np.abs(mesh.points[mesh.used]).max()) * start.frame.scale
    return Base(in_space(start.points), start.cells, start.regions, edges, fixed, kept, held,
                metric_in_space(start.metric), thin)


def _judged(
    mesh: SimplexMesh, outcome: Outcome, origin: LongArray, length: float, options: Options,
    full: int,
) -> Judged:
    """Hold a mesh against the promise."""
    points, cells = outcome.points, outcome.cells
    keep = tuple(options.keep)
    metric = outcome.metric
    broken = broken_by_retiling(mesh, points, cells, outcome.regions, origin,
                                () if full else keep, metric, outcome.faces[0])
    if full and not broken:
        broken = fallen_since(mesh, points, cells, metric, keep, full=full)
    bad = np.zeros(len(points), dtype=np.bool_)
    if broken:
        bounds = relaxed(figures(*as_seen(mesh.points, mesh.cells, mesh.metric)), keep, 3)
        seen = as_seen(points, cells, metric)
        whole = filled_up(*seen, full) if full else seen
        bad[cells[spoiling(bounds, figures(*whole), cell_shapes(*seen), keep)]] = True
        if mesh.is_surface:
            bad[cells[without_area(points, cells)]] = True
    x, y = in_space(mesh.points), in_space(points)
    old, new = surface_edges(mesh.cells, len(x)), surface_edges(cells, len(y))
    was = old.vertices[bad_places(x, mesh.cells, old, FOLD - TURNED)[1]]
    now = new.vertices[bad_places(y, cells, new)[1]]
    if len(now):
        fresh = now
        if len(was):
            known = make_reference(x, was[:, [0, 1, 1]])
            away = [known.closest(y[now[:, i]])[0] for i in range(2)]
            fresh = now[~(np.maximum(*away) <= length)]
        if len(fresh):
            broken.append(f"the surface folds back at {counted(len(fresh), 'edge')}")
            bad[fresh] = True
    far, near = [0.0, 0.0], points[:0]
    pairs = _lines(mesh.regions, old), _lines(outcome.regions, new)
    surfaces = [(pairs[0][name], pairs[1].get(name, cells[:0])) for name in pairs[0]]
    surfaces += [(lines.rows[lines.labels == label][:, [0, 1, 1]],
                  now.rows[now.labels == label][:, [0, 1, 1]])
                 for lines, now in [(mesh.faces[0], outcome.faces[0])]
                 for label in np.unique(lines.labels).tolist()]
    if mesh.is_surface:
        surfaces.append((mesh.cells, cells))
    for was, now in surfaces:
        if not len(now):
            continue
        one, two = make_reference(x, was), make_reference(y, now)
        both = distances(two, one, TOLERANCE * length)
        forward, backward = both.forward_upper, both.backward_upper
        if forward > length:
            sure = within(one, y, now, length)
            bad[now[~sure]] = True
            forward = length if sure.all() else forward
        if backward > length:
            left = uncovered(one, y, now, length, two).triangles
            near = np.concatenate([near, mesh.points[np.unique(was[left])]])
            backward = length if not left.size else backward
        far = [max(far[0], forward), max(far[1], backward)]
    if max(far) > length:
        broken.append(f"the result is up to {max(far):.3g} from the input, beyond the envelope of "
                      f"{length:.3g}")
    cut = newly_crossed(_shell(y, cells, new, mesh), _shell(x, mesh.cells, old, mesh), length)
    if len(cut):
        count = counted(len(cut), "vertex", "vertices")
        broken.append(f"the result cuts through itself at {count}")
        bad[cut] = True
    unlike = np.zeros(len(mesh.cells), dtype=np.bool_)
    if broken and not mesh.is_surface:
        others = other_sizes(mesh, points, cells, outcome.regions)
        unlike = _around(mesh, [label for label, *_ in others])
    return Judged(broken, np.concatenate([points[bad], near]), Distance(*far), unlike)


def _around(mesh: SimplexMesh, labels: list[int]) -> BoolArray:
    """Mark the triangles (m,) at the rims of regions."""
    rim = np.zeros(len(mesh.points), dtype=np.bool_)
    for label in labels:
        rim[uneven_facets(mesh.cells[mesh.bodies() == label], len(mesh.points)).open] = True
    return np.asarray(rim[mesh.cells].any(axis=1))


def _lines(regions: IntArray, edges: Edges) -> dict[tuple[int, ...], IntArray]:
    """Rims, seams and borders as triangles without area, by the labels at them and their degree."""
    low, high = labels_beside(regions, edges)
    border = np.flatnonzero((edges.degree != 2) | (low != high))
    rows = np.stack([np.minimum(edges.degree, 3), low, high], axis=1)[border]
    names, number = np.unique(rows, axis=0, return_inverse=True)
    return {tuple(name): edges.vertices[border[number.ravel() == i]][:, [0, 1, 1]]
            for i, name in enumerate(names.tolist())}


class Shell(NamedTuple):
    """Points (n, 2) or (n, 3), and what of a mesh must not cross: edges of a rim, or triangles."""

    points: FloatArray
    facets: IntArray

    def crossed(self) -> IntArray:
        """Facets that cross others, as triangles (k, 3), those of an edge without area."""
        if not len(self.facets):
            return np.zeros((0, 3), dtype=np.int32)
        rows: IntArray = self.facets[crossed_facets(self.points, self.facets) >= 0]
        return rows if rows.shape[1] == 3 else rows[:, [0, 1, 1]]


def _shell(points: FloatArray, cells: IntArray, edges: Edges, like: SimplexMesh) -> Shell:
    """What of triangles must not cross."""
    if like.is_surface:
        return Shell(points, cells)
    return Shell(np.ascontiguousarray(points[:, :2]), edges.vertices[edges.degree == 1])


def newly_crossed(now: Shell, before: Shell, length: float) -> IntArray:
    """Vertices of facets that cross others, further than a length from all that did before."""
    crossed = now.crossed()
    if not len(crossed):
        return crossed.ravel()
    known = before.crossed()
    if len(known):
        corners = in_space(now.points)[crossed]
        middle = corners.mean(axis=1)
        size = np.sqrt(((corners - middle[:, None]) ** 2).sum(axis=2).max(axis=1))
        away = make_reference(in_space(before.points), known).closest(middle)[0]
        crossed = crossed[away > length + size]
    return np.unique(crossed)
