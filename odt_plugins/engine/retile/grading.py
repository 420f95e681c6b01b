"""Sizes that change little from vertex to vertex, and fit what stays as it is."""

from __future__ import annotations

from bisect import bisect_left

import numpy as np

from odt_plugins.engine.cells.content import cells_of_sizes
from odt_plugins.engine.ground.features import Features
from odt_plugins.engine.retile.tracks import Tracks
from odt_plugins.engine.topology.growth import grown_along
from odt_plugins.mesh.arrays import FloatArray, IntArray

GROWTH, FALL = 0.3, 1.0
"""Most by which the size changes over a length of 1, and by how much it falls from edges that stay
long."""

MANY = 100
"""Largest number of tracks shorter than the sizes at their ends of a surface that is not rough."""

MOST_GIVEN, MOST_GIVEN_ROUGH = 10, 2
"""Largest multiple of the triangles that are expected, or of those there are, for which sizes give
way to tracks and to short edges; the second is that of a rough surface."""

SHORTENED = (0.0, *(2.0**-k for k in range(16, -1, -1)))
"""Parts of a size that tracks count as at least; the least for which not too many come is taken."""

LEAST = 1e-6
"""Smallest part of a size that edges which stay, or are between vertices at one place, leave."""


def fitted(
    points: FloatArray, triangles: IntArray, edges: IntArray, sizes: FloatArray,
    features: Features, tracks: Tracks,
) -> tuple[FloatArray, float]:
    """Sizes near what stays, where that makes not too many triangles, and how many are too many."""
    ends = features.lines.nodes[np.stack([tracks.start, tracks.stop])]
    long = tracks.arc[tracks.stop] - tracks.arc[tracks.start]
    short = ~tracks.held & (ends[0] != ends[1]) & (long < sizes[ends].min(axis=0))
    rough = short.sum() > MANY
    most = (MOST_GIVEN_ROUGH if rough else MOST_GIVEN) * max(
        len(triangles), cells_of_sizes(points, triangles, sizes))

    def few(least: float) -> bool:
        found = fitting(points, edges, sizes, features, tracks, least)
        return cells_of_sizes(points, triangles, found) <= most

    least = SHORTENED[bisect_left(SHORTENED[:-1], True, key=few)]
    found = fitting(points, edges, sizes, features, tracks, least)
    return found, most if rough or least > 0.0 else np.inf


def fitting(
    points: FloatArray, edges: IntArray, sizes: FloatArray, features: Features, tracks: Tracks,
    least: float = 0.0,
) -> FloatArray:
    """Sizes (n,) near what stays: as long as edges that are held, no longer than a track.

    Tracks count as no shorter than a part ``least`` of the size at their ends.
    """
    nodes = features.lines.nodes
    out = sizes.astype(np.float64)
    total, count = np.zeros(len(out)), np.zeros(len(out))
    for start, stop, held in zip(tracks.start, tracks.stop, tracks.held, strict=True):
        ends = nodes[[start, stop]]
        if held:
            step = np.diff(tracks.arc[start : stop + 1])
            for k in (nodes[start:stop], nodes[start + 1 : stop + 1]):
                np.add.at(total, k, step)
                np.add.at(count, k, 1.0)
        elif ends[0] != ends[1]:
            long = np.maximum(tracks.arc[stop] - tracks.arc[start], least * sizes[ends])
            out[ends] = np.minimum(out[ends], long)
    on = count > 0
    out[on] = total[on] / count[on]
    if (out == sizes).all():
        return out
    longer = on & (out > sizes)
    out = grown_along(points, edges, np.maximum(out, LEAST * sizes), GROWTH)
    if longer.any():
        # the largest sizes spread down from where they are held
        top = 2.0 * max(out.max(), (total[longer] / count[longer]).max())
        below = np.full(len(out), top)
        below[longer] = top - (total[longer] / count[longer])
        out = np.maximum(out, top - grown_along(points, edges, below, FALL))
    return out
