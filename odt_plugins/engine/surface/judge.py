"""The promise for surfaces, as the engine and the hosts ask for it: with the envelope."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odt_plugins.engine.ground.crossings import crossed_facets
from odt_plugins.engine.ground.envelope import distances, uncovered, within
from odt_plugins.engine.ground.reference import make_reference
from odt_plugins.engine.topology.order import morton_keys
from odt_plugins.errors import counted
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.facets import row_keys
from odt_plugins.mesh.seen import NO_METRIC
from odt_plugins.mesh.simplex import SimplexMesh
from odt_plugins.mesh.surface import surface_edges
from odt_plugins.options import Options
from odt_plugins.promise.surface import bad_places, broken_surface_promises, new_folds

TOLERANCE = 0.02
"""Distances are bounded to this part of the envelope."""

REFINEMENTS = 3
"""How often the tolerance is made smaller by that factor for surfaces that are that close."""


class Kept(NamedTuple):
    """What of a surface is kept, in the caller's numbering and unit.

    Attributes
    ----------
    diagonal : float            of the bounding box of all triangles
    envelope : float            length
    lines : (k, 2) int32        feature edges
    locked : (n,) bool          vertices that do not move
    corners : int               locked vertices where features end, branch or bend
    on_lines : int              vertices that slide along a feature line
    """

    diagonal: float
    envelope: float
    lines: IntArray
    locked: BoolArray
    corners: int
    on_lines: int


class Distance(NamedTuple):
    """Certified distances between the surfaces before and after.

    Attributes
    ----------
    forward : float                 no point of the new surface is further from the old one
    backward : float                no point of the old surface is further from the new one
    """

    forward: float
    backward: float


def faults(
    mesh: SimplexMesh, kept: Kept, points: FloatArray, cells: IntArray, regions: IntArray,
    options: Options, metric: FloatArray = NO_METRIC,
) -> tuple[list[str], Distance]:
    """Say what of the promise does not hold for a surface, and how far it is from the input.

    Parameters
    ----------
    mesh : SimplexMesh         the input
    kept : Kept
    points, cells, regions     the surface to be judged
    options : Options
    metric : (n, k) float64    of the metric in which figures are measured, no rows without one
    """
    broken = broken_surface_promises(
        mesh, points, cells, regions, tuple(options.keep), lines=kept.lines, held=kept.locked,
        envelope=kept.envelope, metric=metric,
    )
    distance = Distance(0.0, 0.0)
    if not broken:
        distance = measured(mesh, kept, points, cells)
        furthest = max(distance)
        if not furthest <= kept.envelope:
            broken.append(
                f"the surface is up to {furthest:.3g} from the input, beyond the envelope of "
                f"{kept.envelope:.3g}"
            )
        cut = len(_newly_cut(mesh, points, cells))
        if cut:
            verb = "goes" if cut == 1 else "go"
            broken.append(f"{counted(cut, 'triangle')} of the result {verb} through other "
                          f"triangles, which none of the input did there")
    return broken, distance


def _newly_cut(mesh: SimplexMesh, points: FloatArray, cells: IntArray) -> IntArray:
    """Triangles (k, 2) that cross others away from where the input crosses itself, with the others.

    The other one may lie where the input crosses itself.
    """
    other = crossed_facets(points, cells)
    cut = np.flatnonzero(other >= 0)
    if cut.size:
        before = crossed_facets(mesh.points, mesh.cells) >= 0
        near = np.zeros(len(points), dtype=np.bool_)
        near[mesh.cells[before]] = True
        centers = points[cells[cut]].mean(axis=1)
        _, face, _ = make_reference(mesh.points, mesh.cells).closest(centers)
        cut = cut[~near[mesh.cells[face]].any(axis=1)]
    return np.stack([cut, other[cut]], axis=1).astype(np.int32)


def _newly_folded(
    mesh: SimplexMesh, points: FloatArray, cells: IntArray, envelope: float
) -> BoolArray:
    """Mark the vertices, (n,), of new flat triangles and beside new edges that fold back."""
    n = len(points)
    mask = np.zeros(n, dtype=np.bool_)
    old, new = surface_edges(mesh.cells, n), surface_edges(cells, n)
    (was, _), (flat, _) = (bad_places(*args) for args in (
        (mesh.points, mesh.cells, old), (points, cells, new)))
    keys = row_keys(np.sort(np.concatenate([mesh.cells[was], cells[flat]]), axis=1), n)
    flat[flat] = ~np.isin(keys[was.sum():], keys[: was.sum()])
    fresh = new_folds(mesh.points, mesh.cells, old, points, cells, new, envelope)
    mask[cells[flat | fresh[new.of_cell].any(axis=1)]] = True
    return mask


def measured(mesh: SimplexMesh, kept: Kept, points: FloatArray, cells: IntArray) -> Distance:
    """Bound the distances both ways; neither is said to leave the envelope when it does not."""
    # neighbours in space next to each other in memory: several times as fast on large surfaces
    used = mesh.used
    rank = np.empty(len(mesh.points), dtype=np.int32)
    order = used[np.argsort(morton_keys(mesh.points[used]), kind="stable")]
    rank[order] = np.arange(len(order), dtype=np.int32)
    old, new = (
        make_reference(x[order], t[np.argsort(t.min(axis=1), kind="stable")])
        for x, t in ((mesh.points, rank[mesh.cells]), (points, rank[cells]))
    )
    tolerance = TOLERANCE * kept.envelope
    for _ in range(REFINEMENTS):
        both = distances(new, old, tolerance)
        if max(both.forward_upper, both.backward_upper) > 2.0 * tolerance:
            break
        tolerance *= TOLERANCE
    forward, backward = both.forward_upper, both.backward_upper
    if forward > kept.envelope and within(old, new.points, new.triangles, kept.envelope).all():
        forward = kept.envelope
    if backward > kept.envelope and not uncovered(
        old, new.points, new.triangles, kept.envelope, new
    ).triangles.size:
        backward = kept.envelope
    return Distance(forward, backward)


def feet_on(points: FloatArray, triangles: IntArray, x: FloatArray) -> tuple[IntArray, FloatArray]:
    """Triangle and barycentric coordinates of the places of a surface closest to points x (k, 3).

    Returns
    -------
    face : (k,) int32, weights : (k, 3) float64    not negative, sum 1
    """
    _, face, foot = make_reference(points, triangles).closest(x)
    weights = np.maximum(barycentric(points, triangles[face], foot), 0.0)
    return face, weights / weights.sum(axis=1)[:, None]


def values_on(
    points: FloatArray, triangles: IntArray, values: FloatArray, x: FloatArray
) -> FloatArray:
    """Values (n,) at the vertices of a surface, at its places closest to points x (k, 3)."""
    face, weights = feet_on(points, triangles, x)
    return (values[triangles[face]] * weights).sum(axis=1)


def barycentric(points: FloatArray, triangles: IntArray, x: FloatArray) -> FloatArray:
    """Barycentric coordinates (k, 3) of points x (k, 3) put onto the planes of triangles (k, 3).

    Those of a point far outside of a thin triangle are large, and (1, 0, 0) on a flat one.
    """
    a, b, c = (points[triangles[:, i]] for i in range(3))
    u, v, p = b - a, c - a, x - a
    uu, uv, vv = (u * u).sum(axis=1), (u * v).sum(axis=1), (v * v).sum(axis=1)
    up, vp = (u * p).sum(axis=1), (v * p).sum(axis=1)
    det = uu * vv - uv * uv
    flat = ~(det > 0.0)
    det[flat] = 1.0
    s = np.where(flat, 0.0, (vv * up - uv * vp) / det)
    t = np.where(flat, 0.0, (uu * vp - uv * up) / det)
    return np.stack([1.0 - s - t, s, t], axis=1)


def outside(mesh: SimplexMesh, kept: Kept, points: FloatArray, cells: IntArray) -> BoolArray:
    """Mark the vertices, (n,), near which a surface may break the promise.

    They are those around what may have left the envelope, cuts through the surface, folds back or
    has no area, where the input does not.
    """
    old = make_reference(mesh.points, mesh.cells)
    far = ~within(old, points, cells, kept.envelope)
    near = uncovered(old, points, cells, kept.envelope)
    mask = np.zeros(len(points), dtype=np.bool_)
    mask[cells[far]] = True
    mask[mesh.cells[near.triangles]] = True
    mask[cells[_newly_cut(mesh, points, cells).ravel()]] = True
    mask |= _newly_folded(mesh, points, cells, kept.envelope)
    if far.any():
        _, face, _ = old.closest(points[cells[far]].mean(axis=1))
        mask[mesh.cells[face]] = True
    return mask
