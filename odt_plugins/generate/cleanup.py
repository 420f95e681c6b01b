"""Vertices that belong to too few triangles are taken out (``cleanup``, Section 5.3)."""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.cells.geometry import boundary_vertices, signed_volumes
from odt_plugins.engine.topology.star import vertex_stars
from odt_plugins.figures import radius_ratio
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray

GOOD = 0.65
"""New triangles replace better ones never, equal ones when they are as good as this."""

LOSS = 0.08
"""Most that a new triangle at the boundary may leave out, as a part of its area."""

LEAST = 0.4
"""With ``always`` a boundary vertex of two triangles goes when the new one is better than this."""


def clean_up(
    points: FloatArray, cells: IntArray, keep: BoolArray, *, always: bool = False
) -> tuple[FloatArray, IntArray, IntArray]:
    """Remove boundary vertices of two triangles and inner ones of three or four.

    Boundary vertices of three bad triangles go as well.

    Parameters
    ----------
    points : (n, 2) float64
    cells : (m, 3) int32        positive
    keep : (n,) bool            vertices that stay
    always : bool               take out boundary vertices even if the new triangle is worse, when
                                the inner vertex has more than four: on a mesh that is refined
                                often, the two triangles get wider and wider along the boundary,
                                while an inner vertex of few triangles does little harm

    Returns
    -------
    points : (n', 2) float64
    cells : (m', 3) int32       positive
    old : (n',) int64           former index of every vertex

    References
    ----------
    CMAME 200 (2011) 967-984, Section 5.3, step 5.
    """
    rim = boundary_vertices(cells, len(points))
    stars = vertex_stars(cells, len(points))
    count = np.diff(stars.indptr)
    few = ~keep & np.where(rim, (count == 2) | (count == 3), (count == 3) | (count == 4))
    quality = radius_ratio(points, cells)
    touched = np.zeros(len(points), dtype=np.bool_)
    gone = np.zeros(len(cells), dtype=np.bool_)
    new: list[tuple[int, ...]] = []
    for v in np.flatnonzero(few).tolist():
        around = stars.indices[stars.indptr[v]:stars.indptr[v + 1]]
        star = cells[around]
        if touched[star].any():
            continue
        worst = quality[around].min()
        ring = _ring(v, star)
        best = _filling(points, ring)
        if rim[v] and best is not None:
            new_area = signed_volumes(points, np.array(best[1], dtype=np.int32)).sum()
            old_area = signed_volumes(points, star).sum()
            if abs(old_area - new_area) > LOSS * new_area:
                continue
            if count[v] == 3 and worst > GOOD:
                continue
            if always and len(ring) == 3 and best[0] > LEAST and count[ring[1]] > 4:
                worst = 0.0
        if best is None or best[0] < worst or (best[0] < GOOD and best[0] <= worst):
            continue
        touched[star] = True
        gone[around] = True
        new += best[1]
    kept = np.concatenate([cells[~gone], np.array(new, dtype=np.int32).reshape(-1, 3)])
    used, number = np.unique(kept, return_inverse=True)
    return points[used], np.asarray(number, dtype=np.int32).reshape(-1, 3), used


def _ring(v: int, star: IntArray) -> list[int]:
    """Vertices around v in order, from one end to the other or once around."""
    after = {}
    for cell in star.tolist():
        k = cell.index(v)
        after[cell[(k + 1) % 3]] = cell[(k + 2) % 3]
    first = next(iter(set(after) - set(after.values())), next(iter(after)))
    ring = [first]
    while ring[-1] in after and len(ring) <= len(star):
        ring.append(after[ring[-1]])
    return ring[:-1] if ring[0] == ring[-1] else ring


def _filling(points: FloatArray, ring: list[int]) -> tuple[float, list[tuple[int, ...]]] | None:
    """The best triangulation of a ring of three or four vertices, with its least radius ratio."""
    if len(ring) == 3:
        choices = [[tuple(ring)]]
    elif len(ring) == 4:
        a, b, c, d = ring
        choices = [[(a, b, c), (a, c, d)], [(a, b, d), (b, c, d)]]
    else:
        return None
    found = radius_ratio(points, np.array(choices).reshape(-1, 3)).reshape(len(choices), -1)
    least, cells = max(zip(found.min(axis=1).tolist(), choices, strict=True))
    return (least, cells) if least > 0.0 else None
