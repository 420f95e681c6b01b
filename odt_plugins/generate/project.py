"""Vertices on the boundary of a tetrahedral mesh moved onto a surface, no cell tangled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import cos, radians
from typing import NamedTuple

import numpy as np

from odt_plugins.engine.cells.geometry import boundary_facets, signed_volumes
from odt_plugins.engine.ground.envelope import within
from odt_plugins.engine.ground.features import find_features
from odt_plugins.engine.ground.reference import Reference, make_reference
from odt_plugins.engine.record.figures import cell_shapes
from odt_plugins.engine.topology.star import vertex_stars
from odt_plugins.errors import InvalidMeshError, counted
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.simplex import vertices_of
from odt_plugins.mesh.surface import surface_edges

BARE = 0.8
"""Part of the envelope beyond which a vertex of the surface that is far from the mesh gets one."""

HALVINGS = 4
"""A move is tried whole, halved this often, and then not at all."""

PASSES = 4
"""A vertex that was held back may go on when its neighbours are there."""

LEAST_QUALITY = 0.2
LEAST_ANGLE = 13.0
"""Radius ratio, and dihedral angle in degrees, below which no move may bring a cell, nor further
below."""

CLOSE = 2.0
"""A vertex of a feature line goes to the lines of the surface when they are no further than this
multiple of its distance from the surface, beyond the envelope."""

THERE = 1e-6
"""Part of the envelope below which a vertex is on the surface and stays where it is."""


@dataclass(frozen=True)
class Target:
    """A closed surface to project to.

    Attributes
    ----------
    reference : Reference        its triangles
    lines : Reference or None    its feature edges, as triangles of two corners
    angle : float                degrees by which it turns there
    """

    reference: Reference
    lines: Reference | None
    angle: float

    @property
    def volume(self) -> float:
        """Volume inside the surface, of the sign of its orientation."""
        a, b, c = (self.reference.points[self.reference.triangles[:, i]] for i in range(3))
        a, b, c = (x - self.reference.origin for x in (a, b, c))
        return float((a * np.cross(b, c)).sum()) / 6.0


class Projected(NamedTuple):
    """A mesh whose boundary was moved.

    Attributes
    ----------
    points : (n, 3) float64
    asked : int                  vertices that were to move
    short : int                  those of them that could not go all the way
    """

    points: FloatArray
    asked: int
    short: int


def make_target(points: FloatArray, triangles: IntArray, angle: float) -> Target:
    """Lay a surface out to project to.

    Parameters
    ----------
    points : (n, 3) float64, triangles : (m, 3) int32
    angle : float                degrees by which the surface turns at a feature edge

    Raises
    ------
    InvalidMeshError             it is not closed
    """
    n = len(points)
    edges = surface_edges(triangles, n)
    rim = np.flatnonzero(edges.degree & 1)
    if rim.size:
        a, b = edges.vertices[rim[0]].tolist()
        verb = "belongs" if rim.size == 1 else "belong"
        msg = (f"the surface is not closed: {counted(rim.size, 'edge')} (first: between vertices "
               f"{a} and {b}) {verb} to an odd number of triangles; expected two at every edge, "
               "try closing its holes")
        raise InvalidMeshError(msg)
    features = find_features(
        points, triangles, edges, vertex_stars(triangles, n), angle=angle,
        fixed=np.zeros(n, dtype=np.bool_),
    )
    lines = edges.vertices[features.edges]
    return Target(
        make_reference(points, triangles),
        make_reference(points, lines[:, [0, 1, 1]]) if len(lines) else None,
        angle,
    )


def project(
    points: FloatArray, cells: IntArray, held: BoolArray, target: Target, envelope: float,
    dtype: np.dtype[np.floating], *, last: bool = True,
) -> Projected:
    """Move the boundary vertices of a mesh to the closest points of a surface.

    Parameters
    ----------
    points : (n, 3) float64, cells : (m, 4) int32    positive
    held : (n,) bool             vertices that must not move
    target : Target
    envelope : float             length; boundary facets within it stay so
    dtype : dtype                the coordinates are of this type afterwards
    last : bool                  whether vertices of the surface that are further than BARE of the
                                 envelope from the mesh get a vertex of it, which costs quality
                                 while cells are large

    Returns
    -------
    Projected                    every volume positive, no cell of a worse radius ratio or dihedral
                                 angle than LEAST_QUALITY and LEAST_ANGLE unless it was so before,
                                 and then no worse than before

    Notes
    -----
    Moves alpha (foot - x) with alpha = 1, 1/2, ... and at last 0, halved for all vertices of a
    cell or facet that does not agree, until all agree. Vertices on feature lines move to the lines
    of the surface; where such lines end or branch they stay.
    """
    facets = boundary_facets(cells)
    free, goal = _feet(points, facets, held, target, envelope)
    goal = goal.astype(dtype).astype(np.float64)
    there = ((goal - points[free]) ** 2).sum(axis=1) <= (THERE * envelope) ** 2
    goal[there] = points[free[there]]
    moved = partial(_moved, cells=cells, facets=facets, free=free, target=target,
                    length=envelope, dtype=dtype)
    points = _until_still(points, partial(moved, goal=goal))
    short = int((goal != points[free]).any(axis=1).sum())
    if last:
        points = _until_still(
            points, lambda x: moved(x, goal=_peaks(x, facets, free, target, envelope)))
    return Projected(points, int((~there).sum()), short)


def _until_still(points: FloatArray, after: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Points after PASSES passes, or after the first that moves none of them."""
    for _ in range(PASSES):
        before, points = points, after(points)
        if np.array_equal(before, points):
            break
    return points


def _peaks(
    points: FloatArray, facets: IntArray, free: IntArray, target: Target, envelope: float
) -> FloatArray:
    """New places (k, 3) of the vertices ``free`` next to vertices of the surface that lie bare.

    Such a vertex, a peak or the bottom of a notch, is far from the mesh though all vertices of the
    mesh are on the surface; its nearest vertex of the mesh goes there.
    """
    goal = points[free]
    corners = vertices_of(target.reference.triangles)
    peaks = target.reference.points[corners]
    distance, facet, _ = make_reference(points, facets).closest(peaks)
    bare = np.flatnonzero(distance > BARE * envelope)
    bare = bare[np.argsort(distance[bare], kind="stable")]
    around = facets[facet[bare]]
    away = ((points[around] - peaks[bare][:, None]) ** 2).sum(axis=2)
    nearest = around[np.arange(len(bare)), away.argmin(axis=1)]
    number = np.full(len(points), -1)
    number[free] = np.arange(len(free))
    movable = number[nearest] >= 0
    goal[number[nearest[movable]]] = peaks[bare[movable]]
    return goal


def _moved(
    points: FloatArray, *, cells: IntArray, facets: IntArray, free: IntArray, goal: FloatArray,
    target: Target, length: float, dtype: np.dtype[np.floating],
) -> FloatArray:
    """Points after a pass of moves to the goal, each as far as its cells and facets agree."""
    alpha = np.zeros(len(points))
    alpha[free] = 1.0
    step = np.zeros_like(points)
    step[free] = goal - points[free]
    alpha[(step == 0.0).all(axis=1)] = 0.0
    least = 0.5**HALVINGS
    if not (alpha > 0.0).any():
        return points
    near = (alpha[cells] > 0.0).any(axis=1)
    active, skin = cells[near], facets[(alpha[facets] > 0.0).any(axis=1)]
    before = cell_shapes(points, active)
    inside = within(target.reference, points, skin, length)
    end = np.array(points)
    end[free] = goal
    while (alpha > 0.0).any():
        new = points.copy()
        moving = alpha > 0.0
        new[moving] = (points + alpha[:, None] * step)[moving].astype(dtype)
        whole = alpha == 1.0
        new[whole] = end[whole]
        bad = _worse(new, active, before)
        slow = np.zeros(len(points), dtype=np.bool_)
        slow[active[bad]] = True
        if not bad.any():
            left = inside & ~within(target.reference, new, skin, length)
            slow[skin[left]] = True
        slow &= moving
        if not slow.any():
            return new
        alpha[slow] *= 0.5
        alpha[alpha < least] = 0.0
    return points


def _worse(points: FloatArray, cells: IntArray, before: FloatArray) -> BoolArray:
    """Cells (m,) that are not positive, or bad and worse than before."""
    now = cell_shapes(points, cells)
    quality = np.minimum(before[:, 0], LEAST_QUALITY)
    sharpest = np.maximum(before[:, 1], cos(radians(LEAST_ANGLE)))
    flattest = np.minimum(before[:, 2], -cos(radians(LEAST_ANGLE)))
    good = signed_volumes(points, cells) > 0.0
    good &= (now[:, 0] >= quality) & (now[:, 1] <= sharpest) & (now[:, 2] >= flattest)
    return np.asarray(~good)


def _feet(
    points: FloatArray, facets: IntArray, held: BoolArray, target: Target, envelope: float
) -> tuple[IntArray, FloatArray]:
    """Boundary vertices that may move, and where they belong."""
    n = len(points)
    edges = surface_edges(facets, n)
    features = find_features(
        points, facets, edges, vertex_stars(facets, n), angle=target.angle,
        fixed=np.zeros(n, dtype=np.bool_),
    )
    degree = np.bincount(edges.vertices[features.edges].ravel(), minlength=n)
    on_boundary = np.zeros(n, dtype=np.bool_)
    on_boundary[facets] = True
    free = np.flatnonzero(on_boundary & ~held & ~features.pinched)
    distance, _, goal = target.reference.closest(points[free])
    if target.lines is not None:
        on_line = np.flatnonzero(degree[free] > 0)
        far, _, foot = target.lines.closest(points[free[on_line]])
        sharp = far <= CLOSE * distance[on_line] + envelope
        goal[on_line[sharp]] = foot[sharp]
        corner = on_line[sharp & (degree[free[on_line]] != 2)]
        goal[corner] = points[free[corner]]
    return free.astype(np.int32), goal
