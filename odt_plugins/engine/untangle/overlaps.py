"""Facets that must stay though they cross or overlap others: no places of vertices mend those."""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.ground.crossings import crossed_facets
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.simplex import SimplexMesh, barycentric, determinant
from odt_plugins.promise.locked_facets import locked_facets

ROUNDING = 1e-12
"""Volume below which vertices lie in a plane, as a part of a power of the longest edge."""


class Overlaps(NamedTuple):
    """Facets of the boundary and of interfaces that cross others, or lie on a neighbour.

    Attributes
    ----------
    facets : (k, d) int32    their vertices
    others : (k, d) int32    for each, one that it crosses or lies on
    places : (k, d) float64  a point where they do
    """

    facets: IntArray
    others: IntArray
    places: FloatArray


def overlaps(mesh: SimplexMesh, near: BoolArray) -> Overlaps:
    """Find the facets that must stay and cross others, or overlap neighbours.

    Parameters
    ----------
    mesh : SimplexMesh
    near : (n,) bool      vertices of cells that nothing makes valid; the two sides of a crack
                          elsewhere are no overlap
    """
    points, n = mesh.points, len(mesh.points)
    facets = locked_facets(mesh.cells, mesh.bodies(), n).facets
    facets = np.unique(np.sort(facets, axis=1), axis=0).astype(np.int32)
    other = crossed_facets(points, facets)
    first, second = _folded(points, facets, near)
    free = other[first] < 0
    other[first[free]] = second[free]
    hit = np.flatnonzero(other >= 0)
    one, two = facets[hit], facets[other[hit]]
    return Overlaps(one, two, _meeting(points, one, two))


def _meeting(points: FloatArray, one: IntArray, two: IntArray) -> FloatArray:
    """A point (k, d) of both: where an edge of one meets the other, or among common vertices."""
    common = (one[:, :, None] == two[:, None]).any(axis=2).astype(np.float64)
    common /= np.maximum(common.sum(axis=1), 1.0)[:, None]
    places = (common[:, :, None] * points[one]).sum(axis=1)
    for ends, facet in ((one, two), (two, one)):
        corners = points[facet]
        sides = corners[:, 1:] - corners[:, :1]
        across = (sides[:, 0, ::-1] * [-1.0, 1.0] if points.shape[1] == 2
                  else np.cross(sides[:, 0], sides[:, 1]))
        simplex = np.concatenate([corners, corners[:, :1] + across[:, None]], axis=1)
        for i, j in combinations(range(points.shape[1]), 2):
            u, v = points[ends[:, i]], points[ends[:, j]]
            above, below = (((x - corners[:, 0]) * across).sum(axis=1) for x in (u, v))
            through = above * below < 0.0
            part = np.divide(above, above - below, out=np.zeros_like(above), where=through)
            x = u + part[:, None] * (v - u)
            through &= (barycentric(simplex, x)[:, :-1] > 0.0).all(axis=1)
            places[through] = x[through]
    return places


def _folded(points: FloatArray, facets: IntArray, near: BoolArray) -> tuple[IntArray, IntArray]:
    """Pairs of facets, by number, that share all but one vertex and lie on each other."""
    k, d = facets.shape
    shared = np.concatenate([np.delete(facets, i, axis=1) for i in range(d)])
    apart = facets.T.ravel()
    order = np.argsort(row_keys(shared, len(points)), kind="stable")
    next_to = (shared[order[1:]] == shared[order[:-1]]).all(axis=1)
    next_to &= near[shared[order[1:]]].all(axis=1)
    a, b = order[:-1][next_to], order[1:][next_to]
    base = points[shared[a, 0]]
    sides = [points[apart[x]] - base for x in (a, b)]
    edges = [*(points[shared[a, i]] - base for i in range(1, d - 1)), *sides]
    longest = np.sqrt(np.max([(e * e).sum(axis=1) for e in edges], axis=0, initial=0.0))
    size = np.abs(determinant([e.T for e in edges]))
    for along in edges[: d - 2]:
        length = np.sqrt((along * along).sum(axis=1))
        unit = along / np.where(length > 0.0, length, 1.0)[:, None]
        sides = [s - (s * unit).sum(axis=1)[:, None] * unit for s in sides]
    on = (size <= ROUNDING * longest**d) & ((sides[0] * sides[1]).sum(axis=1) > 0.0)
    pairs = np.concatenate([np.column_stack([a, b])[on], np.column_stack([b, a])[on]]) % k
    return pairs[:, 0], pairs[:, 1]
