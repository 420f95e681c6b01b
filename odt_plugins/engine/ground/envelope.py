"""Whether a surface lies within an envelope around another, and how far two surfaces are apart."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.engine.compiled.threads import pieces
from odt_plugins.engine.ground.closest import Ground, closest_on_triangle
from odt_plugins.engine.ground.overlay import Work, height_over, make_overlay_work
from odt_plugins.engine.ground.reference import Reference, make_reference
from odt_plugins.engine.ground.triangle_within import faces_near, triangle_within
from odt_plugins.engine.topology.star import Stars
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray

INSET = 0.01
"""Part of the tolerance by which a triangle is shrunk before the heights under it are looked at."""

LEAST_PARTS = 100_000
"""Parts into which triangles may be cut for one distance, whatever their number."""

PARTS_A_TRIANGLE = 16
"""Further parts for every triangle."""


@kernel
def _within(
    points: FloatArray, triangles: IntArray, feet: IntArray, far: FloatArray, surface: Ground,
    envelope: float, work: Work, out: BoolArray,
) -> None:
    three = work.feet
    for c in range(triangles.shape[0]):
        i, j, k = triangles[c, 0], triangles[c, 1], triangles[c, 2]
        if not (far[i] <= envelope and far[j] <= envelope and far[k] <= envelope):
            continue
        three[0], three[1], three[2] = feet[i], feet[j], feet[k]
        out[c] = triangle_within(points, i, j, k, three, surface, envelope, work)


@kernel
def _near(
    points: FloatArray, triangles: IntArray, chosen: IntArray, feet: IntArray, surface: Ground,
    reach: float, work: Work, start: int, stop: int, near: Stars,
) -> None:
    """Count the triangles of the surface near chosen[start:stop]; write them when there is room."""
    indptr, indices = near
    three = work.feet
    for r in range(start, stop):
        i, j, k = triangles[chosen[r], 0], triangles[chosen[r], 1], triangles[chosen[r], 2]
        three[0], three[1], three[2] = feet[i], feet[j], feet[k]
        count = faces_near(points, i, j, k, three, surface, reach, work)
        if indices.shape[0] > 0:
            for f in range(count):
                indices[indptr[r] + f] = work.faces[f]
        indptr[r + 1] = indptr[r] + count


def _from_vertices(
    reference: Reference, points: FloatArray, triangles: IntArray
) -> tuple[FloatArray, IntArray]:
    """Distance of the vertices of triangles, and the nearest triangle; 0 for all other points."""
    used = np.unique(triangles)
    distance, face = np.zeros(len(points)), np.zeros(len(points), dtype=np.int32)
    distance[used], face[used], _ = reference.closest(points[used])
    return distance, face


def within(
    reference: Reference, points: FloatArray, triangles: IntArray, envelope: float
) -> BoolArray:
    """Say which triangles are certainly within an envelope around a surface.

    Parameters
    ----------
    reference : Reference
    points : (n, 3) float64
    triangles : (m, 3) int32
    envelope : float            length, not negative

    Returns
    -------
    (m,) bool                   True only if every point of the triangle is within ``envelope``
    """
    points = np.ascontiguousarray(points, dtype=np.float64)
    triangles = np.ascontiguousarray(triangles, dtype=np.int32)
    out = np.zeros(len(triangles), dtype=np.bool_)
    distance, face = _from_vertices(reference, points, triangles)
    work = make_overlay_work()
    for first, last in pieces(0, len(triangles), costly=True):
        _within(
            points, triangles[first:last], face, distance, reference.surface, float(envelope),
            work, out[first:last],
        )
    return out


class Uncovered(NamedTuple):
    """Triangles of the reference that are not certainly within the envelope of the result.

    Attributes
    ----------
    triangles : (k,) int32     of the reference, ascending
    near : Stars               row i: triangles of the result whose boxes are within the envelope
                               of the box of triangles[i], those with the feet of its corners first
    """

    triangles: IntArray
    near: Stars


def uncovered(
    reference: Reference, points: FloatArray, triangles: IntArray, envelope: float,
    result: Reference | None = None,
) -> Uncovered:
    """Find the parts of the reference that the result may have left.

    Parameters
    ----------
    reference : Reference
    points : (n, 3) float64     the result
    triangles : (m, 3) int32
    envelope : float            length, not negative
    result : Reference          of these points and triangles, when already made

    Returns
    -------
    Uncovered                   no triangles when every point of the reference is within
                                ``envelope`` of the result
    """
    result = make_reference(points, triangles) if result is None else result
    distance, feet = _from_vertices(result, reference.points, reference.triangles)
    work = make_overlay_work()
    sure = np.zeros(len(reference.triangles), dtype=np.bool_)
    for first, last in pieces(0, len(sure), costly=True):
        _within(
            reference.points, reference.triangles[first:last], feet, distance, result.surface,
            float(envelope), work, sure[first:last],
        )
    chosen = np.flatnonzero(~sure).astype(np.int32)
    indptr = np.zeros(len(chosen) + 1, dtype=np.int64)
    indices = np.empty(0, dtype=np.int32)
    for _ in range(2):
        for first, last in pieces(0, len(chosen), costly=True):
            _near(
                reference.points, reference.triangles, chosen, feet, result.surface,
                float(envelope), work, first, last, Stars(indptr, indices),
            )
        indices = np.empty(int(indptr[-1]), dtype=np.int32) if not indices.size else indices
    return Uncovered(chosen, Stars(indptr, indices))


class OneSided(NamedTuple):
    """Certified bounds of the one-sided Hausdorff distance.

    Attributes
    ----------
    upper : float    no point of the first surface is further from the second
    lower : float    some point of it is as far
    """

    upper: float
    lower: float


class TwoSided(NamedTuple):
    """Certified bounds of both one-sided Hausdorff distances.

    Attributes
    ----------
    forward_upper, forward_lower : float      from the first surface to the second
    backward_upper, backward_lower : float    from the second surface to the first
    """

    forward_upper: float
    forward_lower: float
    backward_upper: float
    backward_lower: float


@kernel
def _upper(
    points: FloatArray, triangles: IntArray, feet: IntArray, far: FloatArray, surface: Ground,
    shrink: float, work: Work, out: FloatArray,
) -> None:
    """Bound the distance of every triangle by the heights under it, or by one triangle."""
    p, t = surface.points, surface.triangles
    for c in range(triangles.shape[0]):
        best = np.inf
        for i in range(3):
            face = feet[triangles[c, i]]
            worst = 0.0
            for j in range(3):
                v = triangles[c, j]
                d = closest_on_triangle(
                    points[v, 0], points[v, 1], points[v, 2],
                    p, t[face, 0], t[face, 1], t[face, 2],
                )[0]
                worst = max(worst, d)
            best = min(best, np.sqrt(worst))
        low = max(far[triangles[c, 0]], far[triangles[c, 1]], far[triangles[c, 2]])
        if best > low:
            i, j, k = triangles[c, 0], triangles[c, 1], triangles[c, 2]
            best = min(best, height_over(points, i, j, k, feet[i], surface, shrink, best, work))
        out[c] = best


def one_sided(
    reference: Reference, points: FloatArray, triangles: IntArray, tolerance: float
) -> OneSided:
    """Bound the largest distance of a surface from a reference.

    Parameters
    ----------
    reference : Reference
    points : (n, 3) float64
    triangles : (m, 3) int32
    tolerance : float           length by which the bounds may differ

    Returns
    -------
    OneSided

    Notes
    -----
    Branch and bound: a triangle whose upper bound is above the largest distance found, by more
    than the tolerance, is cut into four until nothing is left or there were too many, whereupon the
    upper bound is what is left. Then needles are cut across as well, and the better bounds count.
    """
    found = _searched(reference, points, triangles, tolerance, False)
    if found.upper > found.lower + tolerance and _needles(_squared_sides(points, triangles)).any():
        again = _searched(reference, points, triangles, tolerance, True)
        found = OneSided(min(found.upper, again.upper), max(found.lower, again.lower))
    return found


def _searched(
    reference: Reference, points: FloatArray, triangles: IntArray, tolerance: float, across: bool
) -> OneSided:
    """Bound as :func:`one_sided`, needles cut across or into four as other triangles."""
    points = np.ascontiguousarray(points, dtype=np.float64)
    triangles = np.ascontiguousarray(triangles, dtype=np.int32)
    distance, feet = _from_vertices(reference, points, triangles)
    lower = float(distance.max(initial=0.0))
    upper = 0.0
    work = make_overlay_work()
    budget = LEAST_PARTS + PARTS_A_TRIANGLE * len(triangles)
    while len(triangles):
        bound = np.empty(len(triangles))
        for first, last in pieces(0, len(triangles), costly=True):
            _upper(
                points, triangles[first:last], feet, distance, reference.surface,
                INSET * tolerance, work, bound[first:last],
            )
        corners = points[triangles]
        center = corners.mean(axis=1)
        radius = np.sqrt(((corners - center[:, None]) ** 2).sum(axis=2).max(axis=1))
        bound = np.minimum(bound, distance[triangles].max(axis=1) + radius)
        open_ = bound > lower + tolerance
        if open_.any():
            middle = reference.closest(center[open_])[0]
            lower = max(lower, float(middle.max()))
            bound[open_] = np.minimum(bound[open_], middle + radius[open_])
            open_ = bound > lower + tolerance
        upper = max(upper, float(bound[~open_].max(initial=0.0)))
        if budget < 0:
            upper = max(upper, float(bound[open_].max(initial=0.0)))
            break
        points, triangles = _cut(points, triangles[open_], across)
        budget -= len(triangles)
        if len(triangles):
            distance, feet, _ = reference.closest(points)
            lower = max(lower, float(distance.max()))
    return OneSided(max(upper, lower), lower)


def _squared_sides(points: FloatArray, triangles: IntArray) -> FloatArray:
    """Squares of the sides (m, 3), each in the place of the corner across."""
    x = points[triangles]
    return np.asarray(((x[:, [1, 2, 0]] - x[:, [2, 0, 1]]) ** 2).sum(axis=2))


def _needles(squares: FloatArray) -> BoolArray:
    """Mark the triangles (m,) with a side less than half as long as another."""
    return np.asarray(squares.min(axis=1) < 0.25 * squares.max(axis=1))


def _cut(
    points: FloatArray, triangles: IntArray, across: bool
) -> tuple[FloatArray, IntArray]:
    """Cut every triangle into four, with points of its own, and lines (a, b, b) into two.

    ``across``: needles are cut into two as well, across the longest side. Four parts would be as
    thin, and many more than the places that are left to look at.
    """
    m = len(triangles)
    x, squares = points[triangles], _squared_sides(points, triangles)
    line = (squares.min(axis=1) == 0.0) & (squares.max(axis=1) > 0.0)
    thin = line | _needles(squares) if across else line
    turn = (np.where(thin, np.argmax(squares, axis=1), 0)[:, None] + [0, 1, 2]) % 3
    a, b, c = (x[np.arange(m), turn[:, i]] for i in range(3))
    split = np.stack([a, b, c, 0.5 * (b + c), 0.5 * (c + a), 0.5 * (a + b)], axis=1)
    rows = np.array([[0, 5, 4], [1, 3, 5], [2, 4, 3], [3, 4, 5]], dtype=np.int32)
    first = 6 * np.arange(m, dtype=np.int32)[:, None, None]
    two = np.array([[0, 1, 3], [0, 3, 2]], dtype=np.int32)
    ends = np.array([[0, 1, 3], [3, 3, 2]], dtype=np.int32)
    halves = first[thin] + np.where(line[thin, None, None], ends, two)
    cells = (first[~thin] + rows).reshape(-1, 3)
    return split.reshape(-1, 3), np.concatenate([cells, halves.reshape(-1, 3)])


def distances(
    a: Reference | tuple[FloatArray, IntArray],
    b: Reference | tuple[FloatArray, IntArray],
    tolerance: float,
) -> TwoSided:
    """Bound how far two surfaces are apart, both ways.

    Parameters
    ----------
    a, b : ((n, 3) float64, (m, 3) int32)    points and triangles; or a Reference, made before
    tolerance : float                        length by which the bounds may differ, above 0; where
                                             the surfaces are so far apart that this would cost
                                             too much, they differ by more, and still hold

    Returns
    -------
    TwoSided

    Raises
    ------
    InvalidMeshError                         a surface without triangles
    """
    first = a if isinstance(a, Reference) else make_reference(*a)
    second = b if isinstance(b, Reference) else make_reference(*b)
    forward = one_sided(second, first.points, first.triangles, tolerance)
    backward = one_sided(first, second.points, second.triangles, tolerance)
    return TwoSided(forward.upper, forward.lower, backward.upper, backward.lower)
