"""Sizes that change little from vertex to vertex, and fit what stays as it is."""

from __future__ import annotations

import numpy as np

from odt_plugins.engine.ground.features import Features
from odt_plugins.engine.retile.tracks import Tracks
from odt_plugins.engine.topology.growth import grown_along
from odt_plugins.mesh.arrays import FloatArray, IntArray

GROWTH, FALL = 0.3, 1.0
"""Most by which the size changes over a length of 1, and by how much it falls from edges that stay
long."""

LEAST = 1e-6
"""Smallest part of a size that edges which stay, or are between vertices at one place, leave."""


def fitting(
    points: FloatArray, edges: IntArray, sizes: FloatArray, features: Features, tracks: Tracks
) -> FloatArray:
    """Sizes (n,) near what stays: as long as edges that are held, no longer than a track."""
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
            out[ends] = np.minimum(out[ends], tracks.arc[stop] - tracks.arc[start])
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
