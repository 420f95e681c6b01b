"""The surface of a tetrahedral mesh that slides: from cells to a sheet, and passes over it."""

from __future__ import annotations

import math

import numpy as np

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.extremes import Bounds, Extremes
from odt_plugins.engine.cells.geometry import boundary_facets, signed_volumes
from odt_plugins.engine.compiled.threads import pieces
from odt_plugins.engine.ground.build import earlier_ground, laid_on, make_ground, make_sheet
from odt_plugins.engine.ground.features import find_features, marked_edges
from odt_plugins.engine.ground.newton import smooth_on_ground
from odt_plugins.engine.ground.position import Body
from odt_plugins.engine.ground.sheet import LOCKED, SMOOTH, Guards, Limits, make_work
from odt_plugins.engine.policy import POLICY
from odt_plugins.engine.sliding.boundary import Skin
from odt_plugins.engine.sliding.flips import flip_boundary
from odt_plugins.engine.topology.complex import Complex
from odt_plugins.engine.topology.star import Stars, star_sum, vertex_stars
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.mesh.surface import surface_edges
from odt_plugins.options import Options


def make_skin(
    points: FloatArray, cells: IntArray, *, locked: BoolArray, envelope: float, angle: float,
    stays: IntArray, lines: IntArray, share: float = 1.0,
) -> Skin:
    """Lay the boundary of a mesh out for sliding.

    Parameters
    ----------
    points : (n, 3) float64     shared with the mesh; more columns as in ``cells.metric``
    cells : (m, 4) int32        positive
    locked : (n,) bool          vertices that must not move; no edge between two of them is flipped
    envelope : float            length
    angle : float               degrees by which the surface turns at a feature edge
    stays : (k, 2) int32        edges that must stay edges
    lines : (l, 2) int32        edges that count as feature edges
    share : float               part of the allowed change of the volume that may be used
    """
    shared, points = points, np.ascontiguousarray(points[:, :3])
    n = len(points)
    triangles = boundary_facets(cells)
    edges = surface_edges(triangles, n)
    features = find_features(
        points, triangles, edges, vertex_stars(triangles, n), angle=angle, fixed=locked,
        kept=marked_edges(edges, lines, n),
    )
    ground = make_ground(points, triangles, edges, vertex_stars(triangles, n), features.edges)
    sheet = make_sheet(points, triangles, edges, features)._replace(points=shared)
    limit = (POLICY.slide_guard * envelope) ** 2
    fan = np.full(n, -1, dtype=np.int32)
    fan[triangles] = np.arange(len(triangles), dtype=np.int32)[:, None]
    low, high = edges.vertices.T
    ends = np.sort(stays, axis=1).astype(np.int64)
    kept = locked[low] & locked[high] | np.isin(low.astype(np.int64) * n + high,
                                       ends[:, 0] * n + ends[:, 1])
    most = share * POLICY.slide_volume * float(signed_volumes(points, cells).sum())
    limits = Limits(limit, limit, math.cos(math.radians(POLICY.slide_turn)))
    return Skin(
        sheet, ground, features.lines, limits, kept,
        _budgets(points, triangles, features.kind == SMOOTH, most), most, fan,
    )


def on_earlier_ground(skin: Skin, surface: SimplexMesh, points: FloatArray) -> Skin:
    """Let a boundary slide on a surface other than itself, whose vertices are at ``points``."""
    ground = earlier_ground(surface, points)
    places = skin.sheet._replace(points=np.ascontiguousarray(skin.sheet.points[:, :3]))
    laid = laid_on(places, ground, skin.limits.distance)
    return skin._replace(ground=ground, sheet=laid._replace(points=skin.sheet.points))


def skin_features(mesh: SimplexMesh, options: Options) -> tuple[IntArray, BoolArray]:
    """Feature edges (k, 2) of the boundary of a mesh, and its vertices (n,) bool that hold."""
    n = len(mesh.points)
    triangles = boundary_facets(mesh.cells)
    edges = surface_edges(triangles, n)
    stars = vertex_stars(triangles, n)
    features = find_features(
        mesh.points, triangles, edges, stars, angle=options.feature_angle, fixed=mesh.fixed,
        kept=marked_edges(edges, mesh.lines, n),
    )
    surface = np.diff(stars.indptr) > 0
    return edges.vertices[features.edges], surface & (features.kind == LOCKED)


def _budgets(points: FloatArray, triangles: IntArray, smooth: BoolArray, most: float) -> FloatArray:
    """Budgets of the change of the volume; the vertices' own are as the areas of their stars.

    On a surface with bumps and hollows the changes cancel in part, and the vertices may have more
    together than the mesh: as much more as the volume between the smooth stars and the means of
    their rings is, in sum of absolute values, against the sum itself.
    """
    n = len(points)
    a, b, c = (points[triangles[:, i]] for i in range(3))
    area = np.cross(b - a, c - a)
    share = star_sum(np.sqrt((area * area).sum(axis=1)), triangles, n)
    count = np.maximum(np.bincount(triangles.ravel(), minlength=n), 1)[:, None]
    # every vertex of the ring lies on two triangles
    ring = 0.5 * (star_sum(a + b + c, triangles, n) / count - points)
    bump = ((points - ring) * star_sum(area, triangles, n)).sum(axis=1)[smooth]
    whole, net = float(np.abs(bump).sum()), abs(float(bump.sum()))
    volume = np.zeros((n + 1, 2))
    volume[0, 1] = most
    more = min(whole / net, POLICY.slide_cancel) if net > 0.0 else POLICY.slide_cancel
    volume[1:, 1] = POLICY.slide_unused * more * share / share.sum()
    return volume


def slide(
    mesh: Complex, skin: Skin, stars: Stars, active: BoolArray, cost: Cost, limit: Extremes,
    moved: FloatArray,
) -> int:
    """Move the active vertices of the surface once; returns how many moved.

    Parameters
    ----------
    mesh : Complex, skin : Skin
    stars : Stars            of the slots
    active : (n,) bool
    cost : Cost, limit : Extremes
    moved : (n,) float64     see ``smooth_on_ground``
    """
    order = np.flatnonzero(active & skin.movable).astype(np.int32)
    own = vertex_stars(skin.sheet.triangles, len(mesh.points))
    work = make_work(skin.ground, own.largest())
    guards = Guards(skin.ground, skin.lines, skin.limits)
    body = Body(mesh.cells, stars, skin.volume)
    moves = sum(
        int(smooth_on_ground(
            skin.sheet, guards, own, body, order[first:last], cost, limit, work, moved
        ))
        for first, last in pieces(0, len(order))
    )
    skin.sheet.check()
    return moves


def flip_skin(mesh: Complex, skin: Skin, near: BoolArray, cost: Cost, bounds: Bounds) -> int:
    """Flip edges of the surface around the cells ``near`` (used slots,); returns how many."""
    used = len(near)
    near = near & (mesh.cells[:used, 0] >= 0) & (mesh.neighbors[:used] < 0).any(axis=1)
    order = np.flatnonzero(near).astype(np.int32)
    work = make_work(skin.ground)
    flips = sum(
        int(flip_boundary(mesh.tets, order[first:last], cost, bounds, skin, work))
        for first, last in pieces(0, len(order))
    )
    skin.sheet.check()
    return flips
