"""Sizes by curvature: chords as far from the surface as the envelope allows."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from odt_plugins.engine.cells.tensors import eigenvalues, of_eigenvalues
from odt_plugins.engine.ground.features import Features, find_features, label_borders, marked_edges
from odt_plugins.engine.ground.sheet import LINE
from odt_plugins.engine.remesh.lay_out import surface_of
from odt_plugins.engine.remesh.resolve import resolved
from odt_plugins.engine.remesh.sizes import FINER, Sizes, check_count, local_sizes, wanted_sizes
from odt_plugins.engine.remesh.wish import Wish
from odt_plugins.engine.run.judge import envelope_length
from odt_plugins.engine.surface.curvature import (
    AVERAGES,
    ENTRIES,
    shape_operators,
    vertex_curvature,
)
from odt_plugins.engine.topology.star import star_sum, vertex_stars
from odt_plugins.errors import counted, place_within
from odt_plugins.mesh.arrays import FloatArray, IntArray
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.mesh.surface import disagreeing_edges, surface_edges
from odt_plugins.options import Options

PART = 0.5
"""Part of the envelope for the height of an edge of its size; longer edges and the finishing have
the rest."""

MOST = 1.2
"""Multiple of the chords that the envelope allows up to which sizes of surfaces are kept."""

THIN = 2.0
"""Multiple of the altitudes of triangles up to which their edges are lengths of the input."""

NARROWEST = 1e-3
"""Least width of a tip of needles, see :func:`_own_sizes`."""

PLANE = 1.0 - 1e-9
"""Square of the mean of unit normals from which on these are parallel."""

LONGEST = 0.1
"""Largest size, as a part of the diagonal, where nothing is curved."""


def sizes_as_wished(mesh: SimplexMesh, options: Options, wish: Wish) -> tuple[SimplexMesh, Sizes]:
    """Sizes that are asked for, and the mesh at whose vertices they are.

    Those of a surface are as long as the envelope allows. The mesh has more vertices where sizes
    need them, on surfaces and for callables, see :func:`..remesh.resolve.resolved`.
    """
    length, angle = envelope_length(mesh, options), options.feature_angle
    given = curvature_sizes(mesh, length, angle) if wish.curved else options.density
    sizes = wanted_sizes(mesh, wish, given)
    at = given if wish.given and callable(given) else None
    most = np.full(len(mesh.points), np.inf)
    if mesh.is_surface and not len(mesh.metric):
        most = given if wish.curved else longest_sizes(mesh, length, angle)
        if wish.curved:
            longest = LONGEST * mesh.extent
            sizes = replace(sizes, asked=np.maximum(most, longest))
        else:
            sizes = within_chords(mesh, sizes, most)
    elif at is None:
        return mesh, sizes
    if options.boundary == "fixed":
        return mesh, sizes
    base, sizes = resolved(mesh, sizes, most, at, wish.most_cells)
    check_count(sizes.cells, wish)
    return base, sizes


def curvature_sizes(mesh: SimplexMesh, envelope: float, angle: float) -> FloatArray:
    """Sizes (n,) as long as an envelope allows, see :func:`chords`, and LONGEST at most.

    None is smaller than those of the input, or than twice the envelope. Where needles meet in a tip
    the surface is ever more curved towards it.
    """
    longest = LONGEST * mesh.extent
    own, width = _own_sizes(mesh)
    found = np.minimum(width * chords(mesh, envelope, angle), longest)
    return np.maximum(found, np.maximum(own, 2.0 * envelope))


def _own_sizes(mesh: SimplexMesh) -> tuple[FloatArray, FloatArray]:
    """Sizes (n,) of the input, and how wide triangles are at every vertex, 1 but at tips.

    Needles of CAD have no long edges: sizes of a surface are THIN times its altitudes at most.
    Where needles meet in a tip they are ever thinner: a vertex whose widest corner is of an angle
    phi below 30 degrees has the width w = 2 sin(phi), and the altitudes count w^2 times. No tip is
    where all is in one plane.
    """
    own = local_sizes(mesh)
    if not mesh.is_surface:
        return own, np.ones(len(own))
    x = mesh.points[mesh.cells]
    sides = x - x[:, [1, 2, 0]]
    squares = (sides * sides).sum(axis=2)
    along = -(sides * sides[:, [2, 0, 1]]).sum(axis=2)
    normal = np.cross(sides[:, 0], sides[:, 1])
    double = np.sqrt((normal * normal).sum(axis=1))[:, None]
    n = len(mesh.points)
    count = np.bincount(mesh.cells.ravel(), minlength=n)
    total = star_sum(_ratio(double[:, 0], np.sqrt(squares.max(axis=1))), mesh.cells, n)
    altitude = np.divide(total, count, out=np.full(n, np.inf), where=count > 0)
    corner = np.minimum(2.0 * _ratio(double, np.sqrt(squares * squares[:, [2, 0, 1]])), 1.0)
    widest = np.where(count > 0, NARROWEST, 1.0)
    np.maximum.at(widest, mesh.cells, np.where(along > 0.0, corner, 1.0))
    mean = star_sum(_ratio(normal, np.repeat(double, 3, axis=1)), mesh.cells, n)
    width = np.where((mean * mean).sum(axis=1) < PLANE * count * count, widest, 1.0)
    return np.minimum(own, THIN * altitude * width * width), width


def _ratio(above: FloatArray, below: FloatArray) -> FloatArray:
    """Quotients of lengths; 0 where both are 0."""
    return np.divide(above, below, out=np.zeros(below.shape), where=below > 0.0)


def longest_sizes(mesh: SimplexMesh, envelope: float, angle: float) -> FloatArray:
    """Sizes (n,) of a surface up to which edges come in all directions.

    MOST times its :func:`chords`, or those of the input, or twice the envelope: longer edges would
    come in the direction alone in which the surface is less curved.
    """
    own, width = _own_sizes(mesh)
    most = MOST * width * chords(mesh, envelope, angle)
    return np.maximum(most, np.maximum(own, 2.0 * envelope))


def within_chords(mesh: SimplexMesh, sizes: Sizes, most: FloatArray) -> Sizes:
    """Sizes of a surface no longer than ``most`` (n,), see :func:`longest_sizes`; says where."""
    used = mesh.used
    finer = used[sizes.values[used] > FINER * most[used]]
    if not len(finer):
        return sizes
    ratio = sizes.values[finer] / most[finer]
    place = place_within(mesh.extent, mesh.points[finer[np.argmax(ratio)]])
    note = (f"sizes are smaller than asked for at {counted(len(finer), 'vertex', 'vertices')} of "
            f"the input, {np.median(ratio):.2g} times in the middle and {ratio.max():.2g} times at "
            f"most, near ({place}): the envelope allows no longer edges")
    found = sizes.below(mesh, most)
    return replace(found, notes=(*found.notes, note))


def chords(mesh: SimplexMesh, envelope: float, angle: float) -> FloatArray:
    """Sizes (n,) as long as an envelope allows, inf where nothing is curved.

    Parameters
    ----------
    mesh : SimplexMesh    of any kind
    envelope : float      length
    angle : float         degrees by which a surface turns at a feature edge

    Notes
    -----
    A chord of length h is kappa h^2 / 8 from an arc of curvature kappa, which is that of the
    boundary, of interfaces, and of feature lines; for surfaces sqrt(kappa_1^2 + kappa_2^2), with
    which triangles of a sphere are as near to it as the chords of a cylinder. Triangles at edges
    where neighbours disagree about the outside, which stay, are left out.
    """
    points, triangles, neighbors, features = _smooth_pieces(mesh, angle)
    curvature = np.maximum(
        vertex_curvature(points, triangles, neighbors), line_curvature(points, features))
    sizes = np.full(len(points), np.inf)
    curved = curvature > 0.0
    sizes[curved] = np.sqrt(8.0 * PART * envelope / curvature[curved])
    return sizes


def chord_metric(mesh: SimplexMesh, envelope: float, angle: float) -> FloatArray:
    """Metric (n, 3, 3) in which chords have length 1 that are as long as an envelope allows.

    Parameters
    ----------
    mesh : SimplexMesh    of tetrahedra, or of triangles in space
    envelope : float      length
    angle : float         degrees by which a surface turns at a feature edge

    Notes
    -----
    |S| / (8 PART envelope), S the shape operator of the boundary and of interfaces: kappa h^2 / 8
    is the height of an arc over a chord of length h, see :func:`chords`, in every direction. Not
    definite, and 0 where nothing is curved.
    """
    points, triangles, neighbors, _ = _smooth_pieces(mesh, angle)
    entries, area = shape_operators(points, triangles, neighbors)
    operator = np.zeros((len(points), 3, 3))
    for entry, (j, k) in enumerate(ENTRIES):
        operator[:, j, k] = operator[:, k, j] = np.divide(
            entries[:, entry], area, out=np.zeros(len(points)), where=area > 0.0)
    values, axes = eigenvalues(operator)
    return of_eigenvalues(np.abs(values) / (8.0 * PART * envelope), axes)


def _smooth_pieces(
    mesh: SimplexMesh, angle: float
) -> tuple[FloatArray, IntArray, IntArray, Features]:
    """Points (n, 3), triangles of surfaces and their neighbours, -1 at features, and these."""
    n = len(mesh.points)
    points = np.ascontiguousarray(np.pad(mesh.points, ((0, 0), (0, 3 - mesh.points.shape[1]))))
    triangles, patch = mesh.cells, mesh.regions
    if mesh.dim == 3:
        triangles, patch, _ = surface_of(mesh.cells, mesh.regions, mesh.faces[1])
    elif mesh.is_surface:
        turned = np.zeros(n, dtype=np.bool_)
        turned[disagreeing_edges(mesh)] = True
        agree = ~turned[triangles].any(axis=1)
        triangles, patch = triangles[agree], patch[agree]
    edges = surface_edges(triangles, n)
    features = find_features(
        points, triangles, edges, vertex_stars(triangles, n), angle=angle,
        fixed=np.zeros(n, dtype=np.bool_), slack=math.inf,
        kept=label_borders(edges, patch) | marked_edges(
            edges, np.concatenate([mesh.stays, mesh.lines]), n))
    apart = features.edges[edges.of_cell]
    return points, triangles, np.where(apart, -1, edges.neighbors), features


def line_curvature(points: FloatArray, features: Features) -> FloatArray:
    """Curvature (n,) of feature lines at their vertices, averaged along them; 0 elsewhere.

    The unit tangents of the edges at a vertex differ by the curvature times the mean of their
    lengths: equal for the vertices of a circle.
    """
    nodes = features.lines.nodes
    out = np.zeros(len(points))
    if len(nodes) < 3:
        return out
    step = points[nodes[1:]] - points[nodes[:-1]]
    length = np.sqrt((step * step).sum(axis=1))
    tangent = np.divide(step, length[:, None], out=np.zeros_like(step), where=length[:, None] > 0.0)
    inner = features.kind[nodes[1:-1]] == LINE
    turn, share = np.zeros((len(nodes), 3)), np.zeros(len(nodes))
    turn[1:-1][inner] = (tangent[1:] - tangent[:-1])[inner]
    share[1:-1][inner] = 0.5 * (length[1:] + length[:-1])[inner]
    for _ in range(AVERAGES):
        for values in (turn, share):
            values[1:-1] = np.where(
                inner.reshape(-1, *[1] * (values.ndim - 1)),
                values[:-2] + values[1:-1] + values[2:], 0.0)
    size = np.sqrt((turn * turn).sum(axis=1))
    found = np.divide(size, share, out=np.zeros(len(nodes)), where=share > 0.0)
    np.maximum.at(out, nodes, found)
    return out
