"""Volumes of regions stay: smooth vertices that slid go out by a part of their heights.

A vertex that slides into a face of the surface is no corner of it any more, so convex parts lose
volume.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.geometry import boundary_facets, signed_volumes
from odt_plugins.engine.ground.envelope import distances
from odt_plugins.engine.ground.features import find_features, marked_edges
from odt_plugins.engine.ground.sheet import SMOOTH
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.record.figures import cell_shapes
from odt_plugins.engine.run.judge import TOLERANCE, envelope_length
from odt_plugins.engine.run.outcome import Outcome
from odt_plugins.engine.topology.star import star_sum, vertex_stars
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray, LongArray
from odt_plugins.mesh.numbering import new_numbers
from odt_plugins.mesh.seen import as_seen
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.mesh.surface import surface_edges
from odt_plugins.options import Options

REACH = 0.9
"""Part of its envelope within which a surface slides; the rest is for going out."""

HIGHER = 0.5
"""Largest part of its height by which a vertex goes out."""

MOST = 4.0
"""Largest part of the allowed change of the volume that a surface loses or gains as it slides."""

SURE = 0.8
"""Part of what smooth vertices can give back that counts."""

NEARLY = 1e-3
"""Part of what regions lacked that they may still lack."""

STEPS = 3
"""Corrections of the part of the heights, of which volumes are no linear function."""

TURNS = 4
"""Most times that vertices of cells stay which would be worse than the worst around."""

WORSE = np.array([-1.0, 1.0, -1.0, -1.0])
"""Signs for which the figures of :func:`cell_shapes` are larger the worse they are."""


class Heights(NamedTuple):
    """Smooth vertices of a boundary above the middles of their neighbours.

    Attributes
    ----------
    vertices : (k,) int64
    way : (k, 3) float64    their heights, along the mean normals of their triangles
    gain : (k,) float64     volume for the whole height
    """

    vertices: LongArray
    way: FloatArray
    gain: FloatArray

    def most(self, reach: float) -> FloatArray:
        """Largest parts (k,) of the heights, for ways of at most the length `reach`."""
        long = np.sqrt((self.way * self.way).sum(axis=1))
        most = np.divide(reach, long, out=np.full(len(long), HIGHER), where=long > 0.0)
        return np.minimum(HIGHER, most)


class Volumes(NamedTuple):
    """Volumes that regions are to have.

    Attributes
    ----------
    cells : (m, 4) int32
    own : (m,) int64         number of the region of every cell
    goal : (r,) float64
    """

    cells: IntArray
    own: LongArray
    goal: FloatArray

    def lacking(self, points: FloatArray) -> FloatArray:
        """Volumes (r,) that regions lack where vertices are at these points."""
        now = np.bincount(self.own, signed_volumes(points, self.cells), len(self.goal))
        return np.asarray(self.goal - now)


def volume_share(mesh: SimplexMesh, options: Options, locked: BoolArray, least: float) -> float:
    """Part of the allowed change of the volume that may be lost, since it can be given back.

    All of it may be lost in one region, which then has to give it back.

    Parameters
    ----------
    mesh : SimplexMesh     before its boundary slides
    options : Options
    locked : (n,) bool     vertices that must not move
    least : float          the part where nothing can be given back
    """
    found = _heights(mesh.points, mesh.cells, ~locked, mesh.lines, options.feature_angle)
    if not len(found.vertices):
        return least
    own = np.unique(mesh.bodies(), return_inverse=True)[1]
    at = _regions_of(found, mesh.cells, own, len(mesh.points))
    allowed = POLICY.slide_volume * np.bincount(own, signed_volumes(mesh.points, mesh.cells))
    more = np.abs(np.bincount(at, found.most(_reach(mesh, options)) * found.gain, len(allowed)))
    one = (least * allowed + SURE * more)[at].min()
    return max(least, min(MOST, float(one / allowed.sum())))


def with_volumes(
    mesh: SimplexMesh, outcome: Outcome, options: Options, goal: SimplexMesh
) -> Outcome:
    """Give regions the volumes that they are to have, as far as vertices may go.

    Parameters
    ----------
    mesh : SimplexMesh
    outcome : Outcome     of the mesh, whose boundary slid
    goal : SimplexMesh    whose regions have these volumes

    Returns
    -------
    Outcome               all of a region went out by one part of their heights, so that what is
                          flat stays flat; no cell at these vertices passes the extremes that those
                          had; the same where a region is gone
    """
    origin = np.arange(len(outcome.points)) if outcome.origin is None else outcome.origin
    slid = (origin >= 0) & (outcome.points != mesh.points[origin]).any(axis=1)
    labels, own = np.unique(goal.bodies(outcome.regions), return_inverse=True)
    if not slid.any() or not np.array_equal(labels, np.unique(goal.bodies())):
        return outcome
    wanted = np.bincount(
        np.searchsorted(labels, goal.bodies()), signed_volumes(goal.points, goal.cells))
    volumes = Volumes(outcome.cells, own, wanted.astype(np.float64))
    lines = new_numbers(origin, len(mesh.points))[mesh.lines].astype(np.int32)
    found = _heights(outcome.points, outcome.cells, slid, lines, options.feature_angle)
    points = _restored(outcome, volumes, found, found.most(_reach(mesh, options)))
    lacked = volumes.lacking(outcome.points)
    if (np.abs(volumes.lacking(points)) > NEARLY * np.abs(lacked)).any():
        points = _restored(outcome, volumes, found, found.most(_left(mesh, outcome, options)))
    return replace(outcome, points=points)


def _reach(mesh: SimplexMesh, options: Options) -> float:
    """Length by which a vertex may go out in any case."""
    return (1.0 - REACH) * envelope_length(mesh, options)


def _left(mesh: SimplexMesh, outcome: Outcome, options: Options) -> float:
    """Length by which it may go out as far as the surface slid."""
    least, length = _reach(mesh, options), envelope_length(mesh, options)
    if mesh.ground is not None:
        return least
    both = distances((outcome.points, boundary_facets(outcome.cells)),
                     (mesh.points, boundary_facets(mesh.cells)), TOLERANCE * length)
    far = max(both.forward_upper, both.backward_upper)
    return max(least, (1.0 - 2.0 * TOLERANCE) * length - far)


def _heights(
    points: FloatArray, cells: IntArray, may: BoolArray, lines: IntArray, angle: float
) -> Heights:
    """Heights of the smooth ones of the vertices (n,) that may move."""
    n, triangles = len(points), boundary_facets(cells)
    edges, stars = surface_edges(triangles, n), vertex_stars(triangles, n)
    features = find_features(points, triangles, edges, stars, angle=angle, fixed=~may,
                             kept=marked_edges(edges, lines, n))
    free = np.flatnonzero(features.kind == SMOOTH)
    a, b, c = (points[triangles[:, i]] for i in range(3))
    area = star_sum(np.cross(b - a, c - a), triangles, n)[free]
    # every vertex of the ring lies on two triangles
    ring = star_sum(a + b + c, triangles, n)[free] / np.diff(stars.indptr)[free, None]
    height = ((points[free] - 0.5 * (ring - points[free])) * area).sum(axis=1)
    squared = (area * area).sum(axis=1)
    part = np.divide(height, squared, out=np.zeros(len(free)), where=squared > 0.0)
    return Heights(free, part[:, None] * area, height / 6.0)


def _regions_of(found: Heights, cells: IntArray, own: LongArray, n: int) -> LongArray:
    """Number of the region that each of these vertices lies in."""
    region = np.zeros(n, dtype=np.intp)
    region[cells] = own[:, None]
    return region[found.vertices]


def _restored(outcome: Outcome, volumes: Volumes, found: Heights, most: FloatArray) -> FloatArray:
    """Points where vertices went out; where cells would be spoiled they stay."""
    touched = outcome.cells[np.isin(outcome.cells, found.vertices).any(axis=1)]
    if not len(touched):
        return outcome.points

    def shapes(points: FloatArray) -> FloatArray:
        return WORSE * cell_shapes(*as_seen(points, touched, outcome.metric))

    worst = shapes(outcome.points).max(axis=0)
    for _ in range(TURNS):
        points = _gone_out(outcome.points, volumes, found, most)
        spoiled = (shapes(points) > worst).any(axis=1)
        if not spoiled.any():
            return points
        most = np.where(np.isin(found.vertices, touched[spoiled]), 0.0, most)
    return outcome.points


def _gone_out(start: FloatArray, volumes: Volumes, found: Heights, most: FloatArray) -> FloatArray:
    """Points where vertices went out, or in where regions have gained, until these have their
    volumes: of a region all that help, by one part of their heights.
    """
    points, lacks = start.copy(), volumes.lacking(start)
    at = _regions_of(found, volumes.cells, volumes.own, len(points))
    most = np.where(found.gain * lacks[at] > 0.0, most, 0.0)
    gain = np.bincount(at, np.where(most > 0.0, found.gain, 0.0), len(lacks))
    share = np.zeros(len(lacks))
    for _ in range(STEPS):
        share += np.divide(lacks, gain, out=np.zeros(len(lacks)), where=gain != 0.0)
        part = np.clip(share[at], 0.0, most)
        points[found.vertices] = start[found.vertices] + part[:, None] * found.way
        lacks = volumes.lacking(points)
    return points
