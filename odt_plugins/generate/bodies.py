"""Closed components of a surface: which there are, which way they face, what lies inside them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from odt_plugins.engine.ground.reference import make_reference
from odt_plugins.mesh.arrays import BoolArray, FloatArray, IntArray
from odt_plugins.mesh.components import components
from odt_plugins.mesh.simplex import reverse
from odt_plugins.mesh.soup import first_there
from odt_plugins.mesh.surface import surface_edges, to_turn

HALF = 0.5
"""Winding number from which a point counts as inside."""

ASKED = 100
"""Most faces of a component by which it is decided what it lies in."""


class Bodies(NamedTuple):
    """Components of a surface, connected across the edges of two faces of a solid.

    Attributes
    ----------
    faces : (m, 3) int32         vertices, one number for each place where that closes more
    of_face : (m,) int32         component of every face
    closed : (k,) bool           whether all edges of a component are of two of its faces; no
                                 component of faces with a place twice is
    volume : (k,) float64        signed volume inside, positive where normals point outward; 0 for
                                 components that are not closed
    low, high : (k, 3) float64   corners of the bounding boxes
    """

    faces: IntArray
    of_face: IntArray
    closed: BoolArray
    volume: FloatArray
    low: FloatArray
    high: FloatArray


def find_bodies(points: FloatArray, faces: IntArray) -> Bodies:
    """Find the components of a surface and which of them are closed.

    Parameters
    ----------
    points : (n, 3) float64
    faces : (m, 3) int32       at least one
    """
    number = first_there(points)
    merged = number[faces].astype(np.int32)
    own, welded = _parts(points, faces), _parts(points, merged)
    return max(own, welded, key=lambda found: int(found.closed[found.of_face].sum()))


def outward(points: FloatArray, faces: IntArray) -> BoolArray:
    """Tell which faces to turn so that neighbours agree and closed components face outward.

    A component inside another one keeps its way relative to the outermost around it, so that
    hollows stay hollow.

    Parameters
    ----------
    points : (n, 3) float64
    faces : (m, 3) int32       at least one

    Returns
    -------
    (m,) bool                  all False for neighbours on a surface of one side
    """
    turned = np.zeros(len(faces), dtype=np.bool_)
    merged = find_bodies(points, faces).faces
    proper = ~_pinched(merged)
    found = to_turn(merged[proper], surface_edges(merged[proper], len(points)))
    if found is None:
        return turned
    turned[proper] = found
    agreeing = reverse(faces, turned)
    bodies = find_bodies(points, agreeing)
    inward = bodies.volume[_outermost(points, agreeing, bodies)] < 0.0
    return np.asarray(turned ^ inward[bodies.of_face])


def body_labels(x: FloatArray, points: FloatArray, faces: IntArray, reach: float) -> IntArray:
    """Number the closed components that points lie in.

    Parameters
    ----------
    x : (q, 3) float64
    points : (n, 3) float64, faces : (m, 3) int32    a surface whose bodies face outward
    reach : float                                    distance within which a point in no body
                                                     belongs to the closest one

    Returns
    -------
    (q,) int32        number from 1 of the smallest outward component around a point, in the order
                      of the faces; 0 where there is none
    """
    bodies = find_bodies(points, faces)
    solid = np.flatnonzero(bodies.closed & (bodies.volume > 0.0))
    label = np.zeros(len(x), dtype=np.int32)
    first = np.unique(bodies.of_face, return_index=True)[1]
    rank = np.empty(len(first), dtype=np.int32)
    rank[solid[np.argsort(first[solid])]] = np.arange(1, len(solid) + 1)
    for body in solid[np.argsort(-bodies.volume[solid], kind="stable")]:
        near = np.flatnonzero(((x >= bodies.low[body]) & (x <= bodies.high[body])).all(axis=1))
        own = bodies.faces[bodies.of_face == body]
        label[near[winding(points, own, x[near]) >= HALF]] = rank[body]
    left = np.flatnonzero(label == 0)
    held = np.flatnonzero(np.isin(bodies.of_face, solid))
    if len(left) and len(held):
        distance, face, _ = make_reference(points, faces[held]).closest(x[left])
        close = distance <= reach
        label[left[close]] = rank[bodies.of_face[held[face[close]]]]
    return label


def winding(points: FloatArray, faces: IntArray, x: FloatArray) -> FloatArray:
    """Winding numbers (q,) of a surface (n, 3), (m, 3) about points (q, 3)."""
    from igl import fast_winding_number

    if not len(x):
        return np.empty(0)
    return np.asarray(fast_winding_number(
        np.ascontiguousarray(points, dtype=np.float64),
        np.ascontiguousarray(faces, dtype=np.int64), np.ascontiguousarray(x, dtype=np.float64)))


def _parts(points: FloatArray, faces: IntArray) -> Bodies:
    proper = np.flatnonzero(~_pinched(faces))
    neighbors = _neighbors(points, faces[proper])
    face, corner = np.nonzero(neighbors >= 0)
    of_face = components(proper[face], proper[neighbors[face, corner]], len(faces))
    k = int(of_face.max()) + 1
    closed = np.zeros(k, dtype=np.bool_)
    closed[of_face[proper]] = True
    closed[of_face[proper[(neighbors < 0).any(axis=1)]]] = False
    low, high = np.full((k, 3), np.inf), np.full((k, 3), -np.inf)
    corners = points[faces]
    np.minimum.at(low, of_face, corners.min(axis=1))
    np.maximum.at(high, of_face, corners.max(axis=1))
    a, b, c = (corners - low[of_face][:, None]).swapaxes(0, 1)
    volume = np.bincount(of_face, (a * np.cross(b, c)).sum(axis=1) / 6.0, minlength=k)
    return Bodies(faces, of_face, closed, np.where(closed, volume, 0.0), low, high)


def _neighbors(points: FloatArray, faces: IntArray) -> IntArray:
    """Face across every edge (m, 3), opposite to a corner; -1 for none, or several.

    Where solids touch along an edge, each of its faces has the one across the same solid.
    """
    edges = surface_edges(faces, len(points))
    cell, corner = np.nonzero(edges.degree[edges.of_cell] > 2)
    if not len(cell):
        return edges.neighbors
    # around an edge from its smaller vertex on, a solid ends at a face that runs the same way
    ends = edges.forward[cell, corner]
    edge, first, of = np.unique(edges.of_cell[cell, corner], return_index=True, return_inverse=True)
    low, high = points[edges.vertices[edge]].swapaxes(0, 1)
    along, u = (high - low)[of], points[faces[cell, corner]] - low[of]
    upright = np.cross(along, u)
    cosine = (upright * upright[first][of]).sum(axis=1)
    sine = (u * upright[first][of]).sum(axis=1) * np.sqrt((along**2).sum(axis=1))
    part = cosine / np.maximum(np.abs(cosine) + np.abs(sine), np.finfo(float).tiny)
    turn = np.round(np.where(sine < 0.0, 3.0 + part, 1.0 - part), 6) % 4.0
    order = np.lexsort((~ends, turn, of))
    cell, corner, ends, of = cell[order], corner[order], ends[order], of[order]
    start = np.searchsorted(of, np.arange(len(edge)))
    size = np.diff(np.append(start, len(of)))
    follows = np.arange(len(of)) + 1
    follows[start + size - 1] = start
    odd = np.bincount(of[ends == ends[follows]], minlength=len(edge)) > 0
    begins = np.flatnonzero(~ends & ~odd[of])
    out = edges.neighbors.copy()
    for one, other in ((begins, follows[begins]), (follows[begins], begins)):
        out[cell[one], corner[one]] = cell[other]
    return out


def _pinched(faces: IntArray) -> BoolArray:
    """Whether faces have a vertex twice."""
    return np.asarray((faces == np.roll(faces, 1, axis=1)).any(axis=1))


def _outermost(points: FloatArray, faces: IntArray, bodies: Bodies) -> IntArray:
    """Largest closed component (k,) that every closed one lies in, itself where there is none."""
    root = np.arange(len(bodies.closed), dtype=np.int32)
    order = np.flatnonzero(bodies.closed)
    order = order[np.argsort(-np.abs(bodies.volume[order]), kind="stable")]
    for rank, body in enumerate(order):
        larger = order[:rank]
        around = larger[((bodies.low[larger] <= bodies.low[body])
                         & (bodies.high[larger] >= bodies.high[body])).all(axis=1)]
        if not len(around):
            continue
        own = np.flatnonzero(bodies.of_face == body)
        x = points[faces[own[:: max(1, len(own) // ASKED)]]].mean(axis=1)
        for other in around:
            w = winding(points, faces[bodies.of_face == other], x)
            if (np.abs(w) >= HALF).all():
                root[body] = other
                break
    return root
