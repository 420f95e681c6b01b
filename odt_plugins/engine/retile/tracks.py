"""Feature lines, rims and borders between labels as they were: what their vertices run along.

A track is a chain of edges of the input between two locked vertices. An edge of the sheet that lies
on one stands for the part between two places, known by arc length, and is close to that part when
all vertices of the input between them are close to the edge: their feet on it divide it into
pieces, over each of which both are straight.
"""

from __future__ import annotations

from typing import NamedTuple

from odt_plugins.engine.cells.triangle import offset
from odt_plugins.engine.compiled.kernel import kernel
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray


class Tracks(NamedTuple):
    """Chains of edges, one after the other.

    Attributes
    ----------
    points : (k, 3) float64      vertices in order
    arc : (k,) float64           arc length, growing along all chains
    face : (k,) int32            triangle of the ground at the edge from here to the next
    start, stop : (c,) int32     first and last vertex of a chain
    held : (c,) bool             chains that stay as they are
    reach : (c,) float64         length by which the edges may leave a chain
    """

    points: FloatArray
    arc: FloatArray
    face: IntArray
    start: IntArray
    stop: IntArray
    held: BoolArray
    reach: FloatArray


@kernel
def _slot(tracks: Tracks, chain: int, place: float) -> int:
    """The last vertex of a chain, but its end, that is not behind a place."""
    low, high = tracks.start[chain], tracks.stop[chain] - 1
    for _ in range(64):
        if low >= high:
            break
        middle = (low + high + 1) // 2
        if tracks.arc[middle] <= place:
            low = middle
        else:
            high = middle - 1
    return low


@kernel
def on_track(
    tracks: Tracks, chain: int, place: float
) -> tuple[float, float, float, int]:
    """Point of a chain at a place, and a triangle of the ground there."""
    k = _slot(tracks, chain, place)
    span = tracks.arc[k + 1] - tracks.arc[k]
    w = min(max((place - tracks.arc[k]) / span, 0.0), 1.0) if span > 0.0 else 0.0
    p = tracks.points
    return (
        p[k, 0] + w * (p[k + 1, 0] - p[k, 0]),
        p[k, 1] + w * (p[k + 1, 1] - p[k, 1]),
        p[k, 2] + w * (p[k + 1, 2] - p[k, 2]),
        tracks.face[k],
    )


@kernel
def track_is_near(
    tracks: Tracks, chain: int, low: float, high: float, points: FloatArray, a: int, b: int
) -> bool:
    """Whether the edge ab and the part of a chain between two places are close to each other."""
    if not low < high:
        return False
    limit = tracks.reach[chain] ** 2
    ux, uy, uz = offset(points, a, b)
    uu = ux * ux + uy * uy + uz * uz
    if not uu > 0.0:
        return False
    for k in range(_slot(tracks, chain, low) + 1, tracks.stop[chain]):
        if tracks.arc[k] >= high:
            break
        x = tracks.points[k, 0] - points[a, 0]
        y = tracks.points[k, 1] - points[a, 1]
        z = tracks.points[k, 2] - points[a, 2]
        w = min(max((ux * x + uy * y + uz * z) / uu, 0.0), 1.0)
        if (x - w * ux) ** 2 + (y - w * uy) ** 2 + (z - w * uz) ** 2 > limit:
            return False
    return True
