"""Sizes give way where the surface stays finer: what the envelope or a feature forbids to be coarse
is finer, and so is what lies under it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from odt_plugins.engine.odt.density import Density
from odt_plugins.engine.remesh.body import Body
from odt_plugins.engine.remesh.sizes import grown, lengths_of, unique_edges
from odt_plugins.mesh.arrays import FloatArray

STUCK = 0.65
"""Multiple of the size at a vertex of the surface below which the mean of the edges there shows
that none of them can collapse."""

REACHED = 1.1
"""Multiple of that mean which is the size then."""


def reached_sizes(body: Body) -> FloatArray:
    """Sizes (n,) that edges of the surface have at its vertices where it is stuck; else inf.

    The mean at a vertex is averaged with those of its neighbours.
    """
    edges = unique_edges(body.triangles.rows[body.triangles.live()])
    n = int(body.used[0])
    length = lengths_of(body.points, edges)
    count = np.bincount(edges.ravel(), minlength=n)
    mean = np.repeat(length, 2)
    for _ in range(2):
        total = np.bincount(edges.ravel(), mean, minlength=n)
        mean = np.divide(total, count, out=np.full(n, np.inf), where=count > 0)
        mean, at_ends = mean[edges[:, ::-1]].ravel(), mean
    mean = at_ends
    return np.where(mean < STUCK * body.size[:n], REACHED * mean, np.inf)


def relented(
    field: Density, body: Body, reached: FloatArray, least: FloatArray, growth: float
) -> Density:
    """The largest sizes of a field on the input that are none longer than those reached.

    Parameters
    ----------
    field : Density         its values are sizes
    body : Body
    reached : (n,) float64  from :func:`reached_sizes`; counts at the nearest vertex of the input
    least : (k,) float64    sizes at the vertices of the input below which none gives way
    growth : float          see Wish
    """
    from scipy.spatial import cKDTree

    stuck = np.flatnonzero(np.isfinite(reached))
    nodes = field.nodes.copy()
    near = cKDTree(nodes[:, :3]).query(body.points[stuck])[1]
    np.minimum.at(nodes[:, 3], near, np.maximum(reached[stuck], least[near]))
    nodes[:, 3] = grown(
        np.ascontiguousarray(nodes[:, :3]), unique_edges(field.cells), nodes[:, 3], growth)
    return replace(field, nodes=nodes)
