"""The boundary of a mesh under construction: its chains of vertices, spaced by size on fd = 0."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from odt_plugins.engine.cells.geometry import boundary_facets, signed_volumes
from odt_plugins.generate.domain import Domain
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray

HALVINGS = 6
"""A move of the boundary that folds a triangle is halved so often before it is given up."""

THIN = 0.2
"""No move of the boundary leaves a triangle below this part of its area."""


@dataclass(frozen=True)
class Rim:
    """Boundary of a triangle mesh as chains of vertices, counterclockwise around the domain.

    Attributes
    ----------
    chains : list of (k,) int arrays    from corner to corner, or closed: then the last is the first
    vertices : (b,) int                 all boundary vertices
    free : list of bool                 whether each chain is closed and passes no corner
    """

    chains: list[IntArray]
    vertices: IntArray
    free: list[bool]


def make_rim(cells: IntArray, corners: BoolArray) -> Rim | None:
    """Follow the boundary; None when some vertex is not passed exactly once.

    Parameters
    ----------
    cells : (m, 3) int32     positive
    corners : (n,) bool      vertices at which chains end
    """
    facets = boundary_facets(cells)
    starts, count = np.unique(facets[:, 0], return_counts=True)
    if not len(facets) or count.max() > 1:
        return None
    following = np.full(len(corners), -1, dtype=np.int32)
    following[facets[:, 0]] = facets[:, 1]
    after = following.tolist()
    seen = np.zeros(len(corners), dtype=np.bool_)
    is_corner = corners.tolist()
    chains = []
    for first in [*starts[corners[starts]].tolist(), *starts[~corners[starts]].tolist()]:
        if seen[first]:
            continue
        chain = [first, after[first]]
        while chain[-1] != first and not is_corner[chain[-1]]:
            chain.append(after[chain[-1]])
        chains.append(np.array(chain, dtype=np.int32))
        seen[chain[:-1]] = True
    free = [bool(chain[0] == chain[-1]) and not is_corner[chain[0]] for chain in chains]
    return Rim(chains, starts.astype(np.int32), free)


def spaced(points: FloatArray, rim: Rim, domain: Domain) -> FloatArray:
    """Where boundary vertices belong: at lengths in proportion to the sizes along every chain.

    Returns
    -------
    (n, 2) float64    other points and the ends of chains as they are; the others on fd = 0
    """
    out = points.copy()
    moved = []
    for chain, free in zip(rim.chains, rim.free, strict=True):
        ids = chain[:-1] if free else chain[1:-1]
        out[ids] = _evenly(points[chain], free, domain, len(chain) - 1)
        moved.append(ids)
    ids = np.concatenate(moved)
    out[ids] = domain.project(out[ids])
    return out


def respaced(points: FloatArray, rim: Rim, domain: Domain, unit: float) -> FloatArray:
    """Make new boundary vertices, about ``unit`` times fh apart, without the ends of chains.

    Returns
    -------
    (b, 2) float64    on fd = 0
    """
    new = []
    for chain, free in zip(rim.chains, rim.free, strict=True):
        metric = _metric(points[chain], domain)[-1] / unit
        least = 3 if chain[0] == chain[-1] else 1
        new.append(_evenly(points[chain], free, domain, max(round(metric), least)))
    return domain.project(np.concatenate(new))


def _metric(x: FloatArray, domain: Domain) -> FloatArray:
    """Length in units of the size up to every point of a chain, (k,)."""
    length = np.linalg.norm(np.diff(x, axis=0), axis=1)
    size = domain.size(x)
    return np.concatenate([[0.0], np.cumsum(2.0 * length / (size[1:] + size[:-1]))])


def _evenly(x: FloatArray, free: bool, domain: Domain, count: int) -> FloatArray:
    """Points that cut a chain into ``count`` parts of one length in units of the size."""
    at = _metric(x, domain)
    wanted = np.linspace(0.0, at[-1], count + 1)
    if free:
        wanted = wanted[:-1]
        if count == len(x) - 1:
            wanted = np.mod(wanted + (at[:-1] - wanted).mean(), at[-1])
    else:
        wanted = wanted[1:-1]
    return np.column_stack([np.interp(wanted, at, x[:, k]) for k in range(2)])


def move_rim(points: FloatArray, cells: IntArray, rim: Rim, target: FloatArray,
             domain: Domain) -> FloatArray:
    """Move boundary vertices towards their places, halving the way where a triangle would fold.

    Returns
    -------
    (n, 2) float64    on fd = 0 where they moved; every triangle stays positive
    """
    wanted = np.zeros(len(points), dtype=np.bool_)
    wanted[rim.vertices] = (target[rim.vertices] != points[rim.vertices]).any(axis=1)
    near = cells[wanted[cells].any(axis=1)]
    floor = THIN * signed_volumes(points, near)
    share = np.where(wanted, 1.0, 0.0)
    new = np.where(wanted[:, None], target, points)
    least = 0.5**HALVINGS
    while True:
        bad = np.unique(near[~(signed_volumes(new, near) >= floor)])
        bad = bad[share[bad] > 0.0]
        if not bad.size:
            return new
        share[bad] = np.where(share[bad] > least, 0.5 * share[bad], 0.0)
        new[bad] = points[bad] + share[bad, None] * (target - points)[bad]
        part = bad[share[bad] > 0.0]
        new[part] = domain.project(new[part])
