"""The promise: what every output of the optimiser must keep, checked in numpy alone.

This file is the judge of the engine and shares no kernel with it. It compares a mesh with the
mesh it came from and says in plain sentences what does not hold.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import change
from odt_plugins.figures import (
    CellFigures,
    QualitySummary,
    cell_figures,
    measured,
    summarize,
)
from odt_plugins.mesh.chunks import chunks, spread
from odt_plugins.mesh.exact import exact_sign, whole_numbers
from odt_plugins.mesh.facets import row_keys, sorted_columns, uneven_facets
from odt_plugins.mesh.numbering import in_old_numbers, most_vertices, old_numbers, removed_vertices
from odt_plugins.mesh.seen import NO_METRIC, as_seen
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.options import KEPT
from odt_plugins.promise.locked_facets import LockedFacets, facet_census

SLACK = 1e-12
"""Relative slack for a figure that must not get worse: the rounding of a mean, no more."""

LOWER_IS_BETTER = frozenset({"max_angle", "mean_amips", "max_amips", "below_5", "below_10",
                             "below_20", "share_below_20", "inverted", "uniformity"})

ROUNDING = 1e-13
"""Bound of the rounding of a volume relative to R^d, R the circumradius: no edge is above 2 R."""

VOLUME = 3e-3
"""Largest relative change of the volume when the boundary slides."""

def broken_promises(
    before: SimplexMesh,
    points: NDArray[np.float64],
    cells: NDArray[np.int32],
    regions: NDArray[np.int32],
    keep: Sequence[str] = KEPT,
    *,
    slides: bool = False,
    origin: NDArray[np.int64] | None = None,
    insert: bool | float = True,
    threads: int = 1,
    metric: NDArray[np.float64] = NO_METRIC,
    figures: Callable[[], CellFigures] | None = None,
) -> list[str]:
    """Say what of the promise does not hold for an optimised mesh.

    Parameters
    ----------
    before : SimplexMesh                the valid mesh the optimiser started from
    points, cells, regions : arrays     (n, d), (m', d + 1), (m',): the mesh to be judged
    keep : names of figures             of :class:`QualitySummary`; none may be worse than
                                        before by more than 1e-12 of its size
    slides : bool                       whether the boundary may move and be flipped: then its
                                        vertices, topology and labels must be as before, and the
                                        volume nearly; distances are not looked at
    origin : (n',) int                  where vertices may come and go: the old vertex of every
                                        new one, increasing, then -1 for those that were added
    insert : bool or float              how many may come then, see ``numbering.most_vertices``
    threads : int                       how many share the work
    metric : (n, k) float64              of the metric in which figures are measured, no rows where
                                        there is none
    figures : callable                  gives those of the mesh without a metric, where they may be
                                        at hand

    Returns
    -------
    list of str                         one sentence per broken promise; empty when all hold

    Notes
    -----
    With every cell positive, no directed facet twice and the directed boundary facets as before,
    every place of the old domain is covered exactly once: the mapping degree says so. The
    volume of every region is compared all the same.
    """
    broken = malformed_arrays(before, points, cells, regions, origin)
    if broken:
        return broken
    found = cell_figures(points, cells, threads) if figures is None else figures()
    seen = as_seen(points, cells, metric)
    locked = _locked_before(before, before.regions)
    held = held_by(before, locked)
    removed = np.zeros(0, dtype=np.int64)
    if origin is not None:
        removed = removed_vertices(origin, len(before.points))
        points = in_old_numbers(before.points, points, origin)
        cells = old_numbers(origin, len(before.points))[cells]
        most = most_vertices(len(before.used), insert)
        broken += came_and_went(before, cells, removed, held, most)
    now_locked, overlaps = facet_census(
        cells, regions, len(points), uneven_facets(cells, len(points), threads)
    )
    bad = cells_not_positive(points, cells, found)
    if len(bad):
        broken.append(f"cell {bad[0]} has {_size(before)} {found.volume[bad[0]]:.3g}, "
                      f"not positive ({len(bad)} in all)")
    broken += moved_though_held(before, points, held, slides=slides)
    broken += changed_use(held["unused"], cells, removed, len(points))
    broken += overlapping_facets(overlaps)
    broken += _torn(locked, now_locked, slides=slides)
    if slides:
        broken += _resewn(locked, now_locked, held, len(points))
    broken += _volume_changed(before, points, cells, regions, slides=slides, threads=threads)
    broken += thawed_cells(before, cells, regions, len(points))
    if keep:
        old = measured(before, threads).summary
        now = summarize(*seen, None if len(metric) else found)
        if before.valid_before is not None:
            valid = summarize(*before.valid_before)
            keep = [name for name in keep if worse_figures(valid, now, (name,))]
        broken += worse_figures(old, now, keep)
    return broken


def cells_not_positive(
    points: NDArray[np.float64], cells: NDArray[np.int32], figures: CellFigures
) -> NDArray[np.intp]:
    """Cells without positive volume, exactly where rounding may have made the sign."""
    d = points.shape[1]
    with np.errstate(invalid="ignore"):
        doubtful = ~(figures.volume > ROUNDING * figures.circumradius**d)
    bad = [i for i in np.flatnonzero(doubtful) if exact_sign(*whole_numbers(points[cells[i]])) <= 0]
    return np.array(bad, dtype=np.intp)


def worse_figures(
    old: QualitySummary, new: QualitySummary, keep: Sequence[str] = KEPT
) -> list[str]:
    """Say which of the figures ``keep`` got worse from ``old`` to ``new``."""
    sentences = []
    for name in keep:
        a, b = float(getattr(old, name)), float(getattr(new, name))
        slack = SLACK * abs(a)
        if name in LOWER_IS_BETTER:
            worse, verb = not b <= a + slack, "rose"
        else:
            worse, verb = not b >= a - slack, "fell"
        if worse:
            sentences.append(f"{name} {verb} {change(a, b)}")
    return sentences


def held_vertices(mesh: SimplexMesh) -> NDArray[np.bool_]:
    """Say which vertices must stay bit for bit: (n,) bool, unused vertices included."""
    return np.asarray(np.logical_or.reduce(list(held_by(mesh).values())))


def held_by(mesh: SimplexMesh, locked: LockedFacets | None = None) -> dict[str, NDArray[np.bool_]]:
    """Say which vertices must stay, (n,) bool each, by the reason why.

    The reasons are boundary, interface (between bodies), fixed, frozen and unused; a vertex may
    have several. ``locked`` are the facets between regions, when they are at hand.
    """
    n = len(mesh.points)
    if locked is None or mesh.body.size:
        locked = _locked_before(mesh, mesh.bodies())
    held = {"boundary": np.zeros(n, bool), "interface": np.zeros(n, bool),
            "fixed": mesh.fixed, "frozen": np.zeros(n, bool), "unused": np.ones(n, bool)}
    held["boundary"][locked.facets[locked.boundary]] = True
    held["interface"][locked.facets[~locked.boundary]] = True
    held["frozen"][mesh.cells[mesh.frozen]] = True
    held["unused"][mesh.cells] = False
    return held


def _locked_before(mesh: SimplexMesh, labels: NDArray[np.int32]) -> LockedFacets:
    """Locked facets of a valid mesh, whose uneven facets are known, for labels (m,)."""
    return facet_census(mesh.cells, labels, len(mesh.points), mesh.uneven)[0]


def malformed_arrays(
    before: SimplexMesh, points: Any, cells: Any, regions: Any, origin: Any
) -> list[str]:
    """Look for arrays that make no mesh: shapes, numbers that are not finite, wrong indices."""
    n, d = before.points.shape
    if origin is not None:
        kept = origin[origin >= 0]
        ordered = np.array_equal(origin[: len(kept)], kept) and (np.diff(kept) > 0).all()
        if origin.shape != points.shape[:1] or not ordered or (kept >= n).any():
            return [f"the origin of {len(points)} vertices names no vertices in their order"]
        n = len(origin)
    if points.shape != (n, d):
        return [f"points have shape {points.shape}, they had {(n, d)}"]
    if cells.ndim != 2 or cells.shape[1] != d + 1 or not len(cells):
        return [f"cells have shape {cells.shape}, expected some of {d + 1} vertices"]
    if regions.shape != (len(cells),):
        return [f"regions have shape {regions.shape} for {len(cells)} cells"]
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        return [f"vertex {bad[0]} is not finite, {len(bad)} in all"]
    if cells.min() < 0 or cells.max() >= n:
        return [f"cells name vertices from {cells.min()} to {cells.max()}, there are {n}"]
    return []


def moved_though_held(
    before: SimplexMesh, points: NDArray[np.float64], held: dict[str, NDArray[np.bool_]],
    *, slides: bool,
) -> list[str]:
    """Compare the coordinates of all vertices that are held, bit for bit."""
    old, new = (np.ascontiguousarray(p, np.float64).view(np.int64)
                for p in (before.points, points[: len(before.points)]))
    differs = (old != new).any(axis=1)
    sentences = []
    for name, mask in held.items():
        bad = np.flatnonzero(mask & differs)
        if len(bad) and not (slides and name == "boundary"):
            sentences.append(f"{name} vertex {bad[0]} moved, {len(bad)} in all")
    return sentences


def came_and_went(
    before: SimplexMesh, cells: NDArray[np.int32], removed: NDArray[np.int64],
    held: dict[str, NDArray[np.bool_]], most: int,
) -> list[str]:
    """Check that only movable vertices were removed, and that not too many were added."""
    sentences = []
    for name, mask in [*held.items(), ("anchored", before.anchored)]:
        bad = removed[mask[removed]]
        if len(bad):
            sentences.append(f"{name} vertex {bad[0]} was removed, {len(bad)} in all")
    was, now = (len(np.unique(t)) for t in (before.cells, cells))
    if now > most:
        sentences.append(f"{now} vertices are used, {was} were; expected at most {most}")
    return sentences


def changed_use(
    unused: NDArray[np.bool_], cells: NDArray[np.int32], removed: NDArray[np.int64], n_points: int
) -> list[str]:
    """Look for vertices that came into use or out of it, and added ones without use."""
    n = len(unused)
    was = ~unused
    was[removed] = False
    now = np.zeros(n_points, bool)
    now[cells] = True
    fresh = n + np.flatnonzero(~now[n:])
    now = now[:n]
    lost, gained = np.flatnonzero(was & ~now), np.flatnonzero(now & ~was)
    sentences = []
    if len(lost):
        sentences.append(f"vertex {lost[0]} is no longer used, {len(lost)} in all")
    if len(gained):
        sentences.append(f"vertex {gained[0]} was unused and is used, {len(gained)} in all")
    if len(fresh):
        sentences.append(f"added vertex {fresh[0]} is not used, {len(fresh)} in all")
    return sentences


def overlapping_facets(facets: NDArray[Any]) -> list[str]:
    """Tell of the facets that two cells claim from the same side."""
    if not len(facets):
        return []
    first = tuple(int(v) for v in facets[0])
    return [f"facet {first} has two cells on one side, {len(facets)} such facets"]


def _torn(old: LockedFacets, new: LockedFacets, *, slides: bool) -> list[str]:
    """Check boundary and interface facets with their labels."""
    sentences = []
    for name, side in (("boundary", True), ("interface", False)):
        if side and slides:
            continue
        a, b = (_signature(f, f.boundary == side) for f in (old, new))
        if np.array_equal(a, b):
            continue
        gone, fresh = _not_in(a, b), _not_in(b, a)
        if len(gone):
            sentences.append(f"{name} facet {_tuple(gone[0])} is gone, {len(gone)} in all")
        if len(fresh):
            sentences.append(f"{name} facet {_tuple(fresh[0])} is new, {len(fresh)} in all")
        if not len(gone) and not len(fresh):
            sentences.append(f"{name} facets appear in other numbers than before")
    return sentences


def _resewn(
    old: LockedFacets, new: LockedFacets, held: dict[str, NDArray[np.bool_]], n: int
) -> list[str]:
    """Check that a boundary that slid has the vertices, edges and labels it had, but for flips.

    The same vertices, as many facets and edges, and as many facets at every edge that is not of
    two: then the Euler number and every place where the boundary touches itself are the same.
    """
    a, b = old.facets[old.boundary], new.facets[new.boundary]
    sentences = []
    if not np.array_equal(np.unique(a), np.unique(b)):
        lost = np.setxor1d(a, b)
        sentences.append(f"vertex {lost[0]} left or joined the boundary, {len(lost)} in all")
    labels = np.union1d(old.labels, new.labels)
    was, now = (
        np.bincount(np.searchsorted(labels, f.labels[f.boundary]), minlength=len(labels))
        for f in (old, new)
    )
    if not np.array_equal(was, now):
        sentences.append(f"the boundary has {len(b)} facets, by region {now.tolist()}; it had "
                         f"{len(a)}, {was.tolist()}")
    (old_edges, old_count), (new_edges, new_count) = (_edge_census(f, n) for f in (a, b))
    old_odd, new_odd = old_edges[old_count != 2], new_edges[new_count != 2]
    if len(old_edges) != len(new_edges) or not np.array_equal(old_odd, new_odd):
        sentences.append(f"the boundary has {len(new_edges)} edges, {len(new_odd)} of them not of "
                         f"two facets; it had {len(old_edges)}, {len(old_odd)}")
    stays = np.logical_or.reduce([mask for name, mask in held.items() if name != "boundary"])
    whole = stays[a].all(axis=1)
    keys = row_keys(np.sort(np.concatenate([a[whole], b]), axis=1), n)
    gone = ~np.isin(keys[: whole.sum()], keys[whole.sum() :])
    if gone.any():
        sentences.append(f"boundary facet {tuple(a[whole][gone][0].tolist())} of vertices that "
                         f"must stay is gone, {int(gone.sum())} in all")
    return sentences


def _edge_census(facets: NDArray[Any], n: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Key of every edge of triangles, and how many hold it."""
    pairs = np.sort(facets[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return np.unique(pairs[:, 0].astype(np.int64) * n + pairs[:, 1], return_counts=True)


def _volume_changed(
    before: SimplexMesh, points: Any, cells: Any, regions: Any, *, slides: bool, threads: int
) -> list[str]:
    """Compare the volume of every body within the rounding of its own sum.

    When the boundary slides, the volume of all of them within VOLUME of it.
    """
    was, regions = before.bodies(), before.bodies(regions)
    labels = was[:1]
    if (was != labels).any() or (regions != labels).any():
        labels = np.union1d(was, regions)
    old, size = _volume_per_label(before.points, before.cells, was, labels, threads)
    new, other = _volume_per_label(points, cells, regions, labels, threads)
    if slides:
        a, b = old.sum(), new.sum()
        if abs(b - a) <= VOLUME * a:
            return []
        return [f"the volume went {change(a, b)}"]
    bad = np.flatnonzero(~(np.abs(new - old) <= 1e-13 * (size + other)))
    return [f"the {_size(before)} of region {labels[i]} went from {old[i]:.15g} to {new[i]:.15g}"
            for i in bad]


def _size(mesh: SimplexMesh) -> str:
    """What the size of a cell is called."""
    return "area" if mesh.dim == 2 else "volume"


def _volume_per_label(
    points: Any, cells: Any, regions: Any, labels: Any, threads: int
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Volume of each label, and the sum of products of edge lengths that bounds its rounding.

    ``labels`` ascend, and all those of ``regions`` are among them.
    """
    d = points.shape[1]
    det, size = np.empty(len(cells)), np.empty(len(cells))
    axes = np.ascontiguousarray(points.T)

    def measure(part: slice) -> None:
        corner = axes.take(cells[part].T, axis=1)
        edges = (corner[:, 1:] - corner[:, :1]).swapaxes(0, 1)
        if d == 2:
            (ax, ay), (bx, by) = edges
            det[part] = ax * by - ay * bx
        else:
            (ax, ay, az), (bx, by, bz), (cx, cy, cz) = edges
            det[part] = (ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz)
                         + az * (bx * cy - by * cx))
        size[part] = np.prod(np.abs(edges).max(axis=1), axis=0)

    spread(measure, chunks(len(cells)), threads)
    groups: Any = [slice(None)]
    if len(labels) > 1:
        order = np.argsort(regions, kind="stable")
        groups = np.split(order, np.searchsorted(regions[order], labels, side="right"))[:-1]
    volume, rounding = (np.array([x[g].sum() for g in groups]) for x in (det, size))
    return volume / (2 if d == 2 else 6), rounding


def thawed_cells(
    before: SimplexMesh, cells: NDArray[Any], regions: NDArray[Any], n: int
) -> list[str]:
    """Look every frozen cell up, with its label."""
    frozen = before.frozen
    if not frozen.any():
        return []
    old = np.sort(before.cells[frozen], axis=1)
    touched = np.zeros(n, bool)
    touched[old] = True
    near = np.flatnonzero(touched[cells].all(axis=1))
    new = np.sort(cells[near], axis=1)
    labels = np.union1d(before.regions, regions)
    label = np.searchsorted(labels, np.concatenate([before.regions[frozen], regions[near]]))
    keys = row_keys(np.column_stack([np.concatenate([old, new]), label]), max(n, len(labels)))
    gone = np.flatnonzero(~np.isin(keys[:len(old)], keys[len(old):]))
    if not len(gone):
        return []
    index = np.flatnonzero(frozen)[gone[0]]
    return [f"frozen cell {index} is gone, {len(gone)} in all"]


def _signature(f: LockedFacets, mask: NDArray[np.bool_]) -> NDArray[Any]:
    """Directed facets (sorted vertices, parity) with their labels, in the order of the census."""
    columns, odd = sorted_columns(f.facets[mask])
    return np.column_stack([*columns, odd, f.labels[mask]]).astype(np.int64)


def _not_in(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    known = {tuple(row) for row in b.tolist()}
    return np.array([row for row in a.tolist() if tuple(row) not in known])


def _tuple(row: NDArray[Any]) -> tuple[int, ...]:
    return tuple(int(v) for v in row[:-2])
