"""The promise, judged by slow code that shares nothing with the package.

Signs of volumes are exact, figures are those of the slow twins (``reference``) in long doubles.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
import reference
import surface_meshes

from odt_plugins.options import Options

SLACK = 1e-12
"""Relative rounding of a figure that the promise allows."""

LOWER_IS_BETTER = ("max_angle", "share_below_20")

VOLUME = 3e-3
"""Largest relative change of the volume when the boundary slides."""

FLAT = 3e-14
"""Cells with less than this of their extent^d may be flat to the package, whose bound is a third;
its figures are then those of the other cells, and not judged."""

OFF_PLANE = 3e-6
"""Part of the extent by which triangles may be off the plane they are said to lie in: where they
are thinner, their side is not judged.  The package's bound is a third."""

GROWTH = 0.5
"""Share of vertices that may be added where none is given."""

ANY = 1000
"""Share of vertices that may be added where there may be any number, the largest allowed."""

Facet = tuple[int, ...]


class Broken(AssertionError):
    """A promise was broken; the arguments say which."""

    def __init__(self, faults: list[str]) -> None:
        super().__init__("; ".join(faults))


class Mesh(NamedTuple):
    """Points and cells in the caller's own types, and labels (m,) when there are any."""

    points: np.ndarray
    cells: np.ndarray
    labels: np.ndarray | None = None


def broken(before: Mesh, after: Mesh, options: Options, *, curved: bool = False) -> list[str]:
    """Say what a result does not keep of what is promised.

    Parameters
    ----------
    before, after : Mesh    labels of the result may be unknown (None): then only the places of
                            the interfaces are looked at
    options : Options       of the run; ``fixed``, ``selection``, ``keep``, ``boundary``,
                            ``envelope``, ``reference``, ``metric``, ``insert`` and ``repair`` count
    curved : bool           whether these are triangles in space that lie in no plane

    Returns
    -------
    list of str             one sentence per fault
    """
    before, after = (m._replace(cells=m.cells.astype(np.int64)) for m in (before, after))
    faults = _malformed(before, after, options)
    if faults:
        return faults
    if curved and is_soup(before) and not _soup(before, after, options):
        return []
    slides = options.boundary == "slide"
    plane = slides and not curved and before.cells.shape[1] == 3
    held = _held(before, options, curved=curved or plane)
    if options.insert and not curved:
        names = _names(before.points, after.points)
        lost = _lost(*names, held)
        if lost:
            faults.append(f"held vertex {lost[0]} is not among the vertices, {len(lost)} in all")
    else:
        names = (np.arange(len(before.points)),) * 2
        faults += _moved(before, after, held)
        faults += _used(before, after)
    old = before._replace(cells=names[0][before.cells])
    new = after._replace(cells=names[1][after.cells])
    faults += _frozen(old, new, options)
    if curved or not (tangled(before) or _has_flat(before)):
        faults += _figures(before, after, options)
    if curved:
        return faults + _surface(before, after, options)
    faults += _orientation(before, after, options)
    if plane:
        return faults + _volume(before, after, slides=True) + _in_plane(before, after, options)
    faults += _facets(before, after, names, slides=slides)
    faults += _volume(before, after, slides=slides)
    if slides:
        faults += _slid(before, after, options)
    return faults


def broken_by_sizes(before: Mesh, after: Mesh, options: Options, *, curved: bool) -> list[str]:
    """Say what a mesh of other sizes does not keep of what is promised, see :func:`broken`.

    Of the figures those are looked at that ``keep`` names, and no edge is of more triangles.
    """
    before, after = (m._replace(cells=m.cells.astype(np.int64)) for m in (before, after))
    free = replace(options, metric=None, insert=ANY, keep=())
    if options.boundary == "fixed" and not curved:
        faults = broken(before, after, free)
        return faults or _figures(before, after, options)
    faults = _malformed(before, after, free)
    if faults:
        return faults
    faults += _figures(before, after, options)
    rims = [np.array([f for f, labels in _owners(m).items() if len(labels) == 1])
            for m in (before, after)]
    skins = [m.cells if curved else rim for m, rim in zip((before, after), rims, strict=True)]
    if curved:
        worst = [max(map(len, _owners(m).values())) for m in (before, after)]
        if worst[1] > worst[0]:
            faults.append(f"an edge is of {worst[1]} triangles, none was of more than {worst[0]}")
        flat = [int((~(reference.areas(m.points, m.cells) > 0)).sum()) for m in (before, after)]
        if flat[1] > flat[0]:
            faults.append(f"{flat[1]} triangles have no area, {flat[0]} had")
    else:
        faults += _orientation(before, after, free)
        same_way = _overlaps(after.cells)
        if same_way:
            faults.append(f"facet {same_way[0]} has two cells on one side, {len(same_way)} in all")
        faults += _volume(before, after, slides=True)
    kinds = {"mesh": [before.cells, after.cells], "boundary": rims}
    sewn = [places(m.points)[m.cells] for m in (before, after)]
    if all(len({*row}) == len(row) for rows in sewn for row in rows.tolist()):
        kinds = ({} if is_soup(before) else kinds) | {"mesh that is sewn up": sewn}
    for what, (was, now) in kinds.items():
        if euler(was) != euler(now):
            faults.append(f"the Euler number of the {what} is {euler(now)}, it was {euler(was)}")
    return faults + _beyond_of(before, skins[0], after, skins[1], free)


def euler(rows: np.ndarray) -> int:
    """Vertices less edges and so on of simplices."""
    size = rows.shape[-1] if len(rows) else 0
    return sum((-1) ** (k + 1) * len({face for row in np.sort(rows, axis=-1).tolist()
                                      for face in combinations(row, k)})
               for k in range(1, size + 1))


def places(points: np.ndarray) -> np.ndarray:
    """First vertex with the coordinates of every vertex, (n,)."""
    known: dict[tuple[float, ...], int] = {}
    return np.array([known.setdefault(tuple(x), i) for i, x in enumerate(points.tolist())])


def is_soup(mesh: Mesh) -> bool:
    """Most edges are of one triangle; of most of them that is no longer so at equal places."""
    torn, whole = (surface_meshes.edge_set(cells) for cells in (
        mesh.cells, places(mesh.points)[mesh.cells]))
    single, left = (sum(count == 1 for count in found.values()) for found in (torn, whole))
    return 2 * single > len(torn) and 2 * (single - left) > single


def _soup(before: Mesh, after: Mesh, options: Options) -> list[str]:
    """Vertices of a soup are together where they were, and as one they keep what is promised."""
    place = places(before.points)
    n = len(place)
    apart = np.flatnonzero((after.points != after.points[place]).any(axis=1))
    if len(apart):
        return [f"vertex {apart[0]} is not where vertex {place[apart[0]]} is, as it was"]
    first, number = np.unique(place, return_inverse=True)
    if options.fixed is not None:
        fixed = np.bincount(number, _mask(options.fixed, n)) > 0
        options = replace(options, fixed=fixed)
    whole = [m._replace(points=m.points[first], cells=number[m.cells]) for m in (before, after)]
    return broken(whole[0], whole[1], options, curved=True)


def _malformed(before: Mesh, after: Mesh, options: Options) -> list[str]:
    n, m = len(after.points), len(after.cells)
    if after.points.ndim != 2 or after.points.shape[1] != before.points.shape[1]:
        return [f"points have shape {after.points.shape}, they had {before.points.shape}"]
    if n != len(before.points) and not options.insert:
        return [f"there are {n} points, there were {len(before.points)}"]
    was = len(np.unique(before.cells))
    share = GROWTH if options.insert is True else options.insert
    if len(np.unique(after.cells)) > was + share * was:
        return [f"{len(np.unique(after.cells))} vertices are in use, {was} were"]
    if after.cells.ndim != 2 or after.cells.shape[1] != before.cells.shape[1] or not m:
        return [f"cells have shape {after.cells.shape}, they had {before.cells.shape}"]
    if after.cells.min() < 0 or after.cells.max() >= n:
        return [f"cells name vertices up to {after.cells.max()}, there are {n}"]
    if not np.isfinite(after.points[np.unique(after.cells)]).all():
        return ["a vertex is not finite"]
    if after.labels is not None and len(after.labels) != m:
        return [f"there are {len(after.labels)} labels for {m} cells"]
    return []


def _mask(value: object, count: int) -> np.ndarray:
    """A mask of what an option names; mid-nodes of quadratic cells come after all corners."""
    raw = np.asarray(value)
    if raw.dtype == bool:
        return raw[:count]
    mask = np.zeros(count, dtype=bool)
    mask[[i for i in raw.tolist() if i < count]] = True
    return mask


def _labels(mesh: Mesh) -> np.ndarray:
    if mesh.labels is None:
        return np.zeros(len(mesh.cells), dtype=int)
    return np.asarray(mesh.labels).reshape(-1).astype(int)


def _owners(mesh: Mesh) -> dict[Facet, list[int]]:
    """Labels of the cells of every facet, sorted."""
    owners: dict[Facet, list[int]] = {}
    for label, row in zip(_labels(mesh).tolist(), mesh.cells.tolist(), strict=True):
        for facet in combinations(sorted(row), len(row) - 1):
            owners.setdefault(facet, []).append(label)
    return {facet: sorted(labels) for facet, labels in owners.items()}


def _locked(owners: dict[Facet, list[int]]) -> Iterator[tuple[Facet, bool]]:
    """Facets that stay, and whether they are on the boundary."""
    for facet, labels in owners.items():
        if len(labels) != 2 or labels[0] != labels[1]:
            yield facet, len(labels) == 1


def _held(mesh: Mesh, options: Options, *, curved: bool) -> np.ndarray:
    """Mark the vertices that must be where they were, (n,)."""
    n, m = len(mesh.points), len(mesh.cells)
    held = np.ones(n, dtype=bool)
    held[mesh.cells] = False
    if options.fixed is not None:
        held |= _mask(options.fixed, n)
    if options.selection is not None:
        held[mesh.cells[~_mask(options.selection, m)]] = True
    slides = options.boundary == "slide"
    if not curved:
        for facet, rim in _locked(_owners(mesh)):
            if not (rim and slides):
                held[list(facet)] = True
    return held


def _bits(points: np.ndarray) -> list[bytes]:
    return [row.tobytes() for row in np.ascontiguousarray(points)]


def _moved(old: Mesh, new: Mesh, held: np.ndarray) -> list[str]:
    a, b = _bits(old.points), _bits(new.points)
    bad = [i for i in np.flatnonzero(held).tolist() if a[i] != b[i]]
    return [f"held vertex {bad[0]} moved, {len(bad)} in all"] if bad else []


def _used(old: Mesh, new: Mesh) -> list[str]:
    other = np.setxor1d(old.cells, new.cells)
    return [f"vertex {other[0]} came into use or out of it, {len(other)} in all"] \
        if len(other) else []


def _names(old: np.ndarray, new: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number the vertices of both meshes by their places: numbers may change with insertion."""
    number: dict[bytes, int] = {}
    return tuple(np.array([number.setdefault(bits, len(number)) for bits in _bits(points)])
                 for points in (old, new))  # type: ignore[return-value]


def _lost(old: np.ndarray, new: np.ndarray, held: np.ndarray) -> list[int]:
    """Held vertices that do not follow each other in the result as they do in the input."""
    there, j, lost = new.tolist(), 0, []
    for i in np.flatnonzero(held).tolist():
        try:
            j = there.index(old[i], j) + 1
        except ValueError:
            lost.append(i)
    return lost


def _frozen(old: Mesh, new: Mesh, options: Options) -> list[str]:
    if options.selection is None:
        return []
    frozen = ~_mask(options.selection, len(old.cells))
    there = {tuple(sorted(row)) for row in new.cells.tolist()}
    gone = [row for row in old.cells[frozen].tolist() if tuple(sorted(row)) not in there]
    return [f"cell {gone[0]} outside of the selection is gone, {len(gone)} in all"] if gone else []


def _figures(before: Mesh, after: Mesh, options: Options) -> list[str]:
    """Compare the figures to keep; what double precision cannot tell is no fault.

    In a metric that is the same everywhere they are those of an affine image; in others unknown.
    Cells that become valid may have small angles where the input has none to count.
    """
    faults: list[str] = []
    if options.metric is not None:
        metric = np.asarray(options.metric)
        if metric.ndim != 3 or metric.shape[2] != before.points.shape[1] or (
                metric != metric[:1]).any():
            return faults
        root = np.linalg.cholesky(metric[0])
        before, after = (m._replace(points=m.points @ root) for m in (before, after))
    (a, b), (rough_a, rough_b) = (
        [reference.figures(m.points, m.cells, kind) for m in (before, after)]
        for kind in (np.longdouble, np.float64))
    for name in options.keep:
        doubt = 8 * (abs(a[name] - rough_a[name]) + abs(b[name] - rough_b[name]))
        worse = a[name] - b[name]
        worse = -worse if name in LOWER_IS_BETTER else worse
        untangled = name == "share_below_20" and not a["min_quality"] > 0
        if not worse <= SLACK * abs(a[name]) + doubt and not untangled:
            faults.append(f"{name} went from {a[name]:.15g} to {b[name]:.15g}")
    return faults


def _flat(mesh: Mesh, like: Mesh | None = None) -> np.ndarray:
    """Points as the volumes need them: of triangles in a plane in space two coordinates.

    These are the same ones as of the mesh ``like``.
    """
    points = np.asarray(mesh.points)
    d = mesh.cells.shape[1] - 1
    if points.shape[1] == d:
        return points
    like = mesh if like is None else like
    x = like.points[like.cells].astype(np.longdouble)
    size = np.abs(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])).sum(axis=0)
    return points[:, np.delete(np.arange(3), int(np.argmax(size)))]


def _orientation(before: Mesh, after: Mesh, options: Options) -> list[str]:
    """All cells have positive volume, or all negative where all of the input have."""
    signs = reference.exact_signs(_flat(before), before.cells)
    flat = _flat(after, before)
    now = reference.exact_signs(flat, after.cells)
    sure = _lie_in_the_plane(after)
    if before.points.shape[1] > before.cells.shape[1] - 1 or tangled(before):
        wanted = now[np.argmax(sure)]
    else:
        wanted = -1 if (signs < 0).all() else 1
    bad = np.flatnonzero(sure & (now != wanted))
    return [f"cell {bad[0]} is flat or inverted, {len(bad)} in all"] if len(bad) else []


def _facets(
    old: Mesh, new: Mesh, names: tuple[np.ndarray, np.ndarray], *, slides: bool
) -> list[str]:
    """No facet is of more than two cells, and those that stay are there with their labels."""
    was, now = _owners(old), _owners(new)
    faults = []
    crowded = [facet for facet, labels in now.items() if len(labels) > 2]
    if crowded:
        faults.append(f"facet {crowded[0]} is of more than two cells, {len(crowded)} in all")
    same_way = _overlaps(new.cells)
    if same_way:
        faults.append(f"facet {same_way[0]} has two cells on one side, {len(same_way)} in all")
    if new.labels is None and old.labels is not None:
        # Where the labels of the result are not known: the places of those that stay.
        every, fresh = _named(now, names[1]), Counter(
            {k: 1 for k in _named({f: [0] * len(x) for f, x in now.items() if len(x) == 1},
                                  names[1])})
        rim = _named({f: [0] for f, rim in _locked(was) if rim}, names[0])
        stay = _named({f: was[f] for f, rim in _locked(was) if not (rim and slides)}, names[0])
        places = {facet for facet, _ in every}
        gone = [facet for facet, _ in stay if facet not in places]
        new_ones = [] if slides else list(fresh - rim)
    else:
        a, b = (_named({f: x[f] for f, rim in _locked(x) if not (rim and slides)}, name)
                for x, name in zip((was, now), names, strict=True))
        gone, new_ones = list(a - b), list(b - a)
    for what, found in (("gone or has other labels", gone), ("new", new_ones)):
        if found:
            faults.append(f"facet {found[0]} is {what}, {len(found)} in all")
    return faults


def _named(
    owners: dict[Facet, list[int]], name: np.ndarray
) -> Counter[tuple[Facet, tuple[int, ...]]]:
    """Facets by the names of their vertices, with their labels."""
    return Counter((tuple(sorted(name[list(facet)].tolist())), tuple(labels))
                   for facet, labels in owners.items())


def _overlaps(cells: np.ndarray) -> list[Facet]:
    """Facets that two positive cells have the same way round."""
    seen: Counter[tuple[Facet, bool]] = Counter()
    for row in cells.tolist():
        for i in range(len(row)):
            facet = row[:i] + row[i + 1 :]
            odd = sum(a > b for a, b in combinations(facet, 2)) + i
            seen[tuple(sorted(facet)), odd % 2 == 1] += 1
    return [facet for (facet, _), count in seen.items() if count > 1]


def tangled(mesh: Mesh) -> bool:
    """Whether cells are flat, or overlap when all of them are turned to positive volume."""
    signs = reference.exact_signs(_flat(mesh), mesh.cells)
    turned = mesh.cells.copy()
    turned[signs < 0, :2] = mesh.cells[signs < 0, 1::-1]
    return bool((signs == 0).any()) or bool(_overlaps(turned))


def _lie_in_the_plane(mesh: Mesh) -> np.ndarray:
    """All cells but triangles in space thinner than their vertices may be off the plane."""
    points, cells = np.asarray(mesh.points, dtype=np.float64), mesh.cells
    if points.shape[1] == cells.shape[1] - 1:
        return np.ones(len(cells), dtype=bool)
    x = points[cells]
    longest = np.linalg.norm(x - np.roll(x, 1, axis=1), axis=2).max(axis=1)
    off = OFF_PLANE * np.linalg.norm(np.ptp(x.reshape(-1, 3), axis=0))
    return np.asarray(reference.areas(points, cells) > off * longest)


def _has_flat(mesh: Mesh) -> bool:
    """Whether cells are flat by the measure of the package, which untangles these."""
    points = np.asarray(_flat(mesh))
    extent = np.ptp(points[mesh.cells].astype(np.longdouble), axis=1).max(axis=1)
    volume = np.abs(reference.determinants(points, mesh.cells))
    return bool((volume <= FLAT * extent ** points.shape[1]).any())


def _volume(before: Mesh, after: Mesh, *, slides: bool) -> list[str]:
    """Every label has its volume; a slid mesh nearly its own.

    That of a tangled mesh follows from its facets, which are compared as well.
    """
    if tangled(before):
        return []
    sums = []
    axes = _flat(before), _flat(after, before)
    for mesh, points in zip((before, after), axes, strict=True):
        size = np.abs(reference.determinants(points, mesh.cells))
        known = before.labels is not None and after.labels is not None and not slides
        labels = _labels(mesh) if known else np.zeros(len(size), dtype=int)
        sums.append({label: size[labels == label].sum() for label in np.unique(labels).tolist()})
    a, b = sums
    if set(a) != set(b):
        return [f"there are labels {sorted(b)}, there were {sorted(a)}"]
    x = np.asarray(axes[0], dtype=np.longdouble)[np.unique(before.cells)]
    extent = np.prod(np.ptp(x, axis=0)) + np.ptp(x) ** x.shape[1] * 1e-3
    rounding = 1e-13 if after.points.dtype.itemsize >= 8 else 1e-4
    slack = VOLUME * 1.001 if slides else 0.0
    return [f"the volume of label {k} went from {a[k]:.15g} to {b[k]:.15g}" for k in a
            if not abs(a[k] - b[k]) <= slack * a[k] + rounding * (a[k] + extent)]


def _edges(triangles: list[Facet]) -> Counter[Facet]:
    return Counter(pair for t in triangles for pair in combinations(sorted(t), 2))


def _slid(before: Mesh, after: Mesh, options: Options) -> list[str]:
    """A boundary that slid is within the envelope and has its vertices and its topology."""
    a, b = ([f for f, labels in _owners(m).items() if len(labels) == 1] for m in (before, after))
    faults = []
    if not options.insert and {v for f in a for v in f} != {v for f in b for v in f}:
        faults.append("a vertex left or joined the boundary")
    x, y = _edges(a), _edges(b)
    if len(a) != len(b) or len(x) != len(y):
        faults.append(f"the boundary has {len(b)} triangles and {len(y)} edges, it had {len(a)} "
                      f"and {len(x)}")
    odd = [Counter(c for c in e.values() if c != 2) for e in (x, y)]
    if odd[0] != odd[1]:
        faults.append("other numbers of triangles meet in edges of the boundary")
    ground = before if options.reference is None else Mesh(*options.reference)
    skin = [f for f, labels in _owners(ground).items() if len(labels) == 1]
    return faults + beyond(ground.points, np.array(skin), after.points, np.array(b), options,
                         ground.cells)


def _rim(mesh: Mesh) -> np.ndarray:
    """Facets of one cell alone, or of cells of two labels."""
    return np.array([f for f, _ in _locked(_owners(mesh))])


def _in_plane(before: Mesh, after: Mesh, options: Options) -> list[str]:
    """Lines that slid in a plane have their edges, and are within the envelope."""
    first = before if options.reference is None else Mesh(*options.reference)
    ground, old, new = (m._replace(points=np.pad(m.points, ((0, 0), (0, 3 - m.points.shape[1]))))
                        for m in (first, before, after))
    faults = _triangles(old, new)
    # The labels of a reference are unknown.
    if options.reference is not None:
        new = new._replace(labels=None)
    return faults + _beyond_of(ground, _rim(ground), new, _rim(new), options)


def _beyond_of(
    old: Mesh, old_rows: np.ndarray, new: Mesh, new_rows: np.ndarray, options: Options
) -> list[str]:
    """Samples of triangles, or of edges, are within the envelope of the others."""
    x, y = (np.pad(m.points, ((0, 0), (0, 3 - m.points.shape[1]))) for m in (old, new))
    # An edge is a triangle that has one end twice.
    a, b = (rows[:, np.arange(3) % rows.shape[1]] for rows in (old_rows, new_rows))
    return beyond(x, a, y, b, options, old.cells)


def beyond(
    old: np.ndarray, old_cells: np.ndarray, new: np.ndarray, new_cells: np.ndarray,
    options: Options, used: np.ndarray,
) -> list[str]:
    """Samples of each surface are within the envelope of the other."""
    corners = np.asarray(old, dtype=np.float64)[np.unique(used)]
    origin, size = corners.mean(axis=0), surface_meshes.diagonal(corners)
    p, q = ((np.asarray(x, dtype=np.float64) - origin) / size for x in (old, new))
    away = max(surface_meshes.two_sided(p, old_cells, q, new_cells, 2))
    # The rounding of coordinates that lie far from the origin.
    doubt = 1e-14 * (1.0 + np.abs(corners).max() / size)
    return [] if away <= options.envelope * (1 + 1e-9) + doubt else [
        f"the surface is {away:.3g} of its diagonal from the input, the envelope is "
        f"{options.envelope:.3g}"]


def _surface(old: Mesh, new: Mesh, options: Options) -> list[str]:
    """A curved surface has its triangles as :func:`_triangles` says and is in the envelope."""
    ground = old if options.reference is None else Mesh(*options.reference)
    return _triangles(old, new) + beyond(
        ground.points, ground.cells, new.points, new.cells, options, ground.cells)


def _triangles(old: Mesh, new: Mesh) -> list[str]:
    """As many triangles have the topology, rims, label borders and sides that they had."""
    faults = []
    if len(old.cells) != len(new.cells):
        return [f"there are {len(new.cells)} triangles, there were {len(old.cells)}"]
    if surface_meshes.topology(old.cells) != surface_meshes.topology(new.cells):
        faults.append("the topology is another one")
    x, y = ({e: c for e, c in surface_meshes.edge_set(m.cells).items() if c != 2}
            for m in (old, new))
    if x != y:
        faults.append("other edges than before are not of two triangles")
    if old.labels is None or new.labels is not None:
        if Counter(_labels(old).tolist()) != Counter(_labels(new).tolist()):
            faults.append("labels have other numbers of triangles")
        a, b = ({e for e, labels in _owners(m).items() if len(labels) == 2
                 and labels[0] != labels[1]} for m in (old, new))
        if a != b:
            faults.append("other edges than before lie between labels")
    ways = Counter((t[i], t[(i + 1) % 3]) for t in new.cells.tolist() for i in range(3))
    degree = surface_meshes.edge_set(new.cells)
    were = Counter((t[i], t[(i + 1) % 3]) for t in old.cells.tolist() for i in range(3))
    turned = [e for e, c in degree.items()
              if c == 2 and ways[e] != 1 and {were[e], were[e[::-1]]} != {0, 2}]
    if turned:
        faults.append(f"the triangles at edge {turned[0]} disagree about the outside, "
                      f"{len(turned)} in all")
    if len({tuple(sorted(t)) for t in new.cells.tolist()}) < len(new.cells):
        faults.append("a triangle is there twice")
    flat = [int((reference.areas(m.points, m.cells) == 0).sum())
            for m in (old, new)]
    if flat[1] > flat[0]:
        faults.append(f"{flat[1]} triangles have no area, {flat[0]} had none")
    return faults
