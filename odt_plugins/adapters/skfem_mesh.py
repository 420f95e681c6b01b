"""Meshes of scikit-fem: MeshTri and MeshTet, MeshTri2 and MeshTet2.

Everything survives: class, named subdomains, whose interfaces stay, and named boundaries, whose
facets stay and which follow them into the new numbering, with their orientation if they have one;
where a boundary is resized they are its new facets.
Meshes of second order are optimised by their corners, see
:mod:`odt_plugins.adapters.higher_order`. Meshes of other cells, and those whose elements do not
share their vertices, such as MeshTri1DG, are refused by name.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.higher_order import check_mid_nodes, lattice, with_mid_nodes
from odt_plugins.adapters.host import (
    HostMesh,
    KeptCells,
    NewFaces,
    Result,
    as_indices,
    is_instance,
)
from odt_plugins.adapters.lengths import expect_members, from_start
from odt_plugins.adapters.regions import AUTO, Labels, region_labels
from odt_plugins.errors import InvalidMeshError, UnsupportedMeshError
from odt_plugins.mesh.faces import Faces, labels_at

ORDERS = {"MeshTri1": 1, "MeshTet1": 1, "MeshTri2": 2, "MeshTet2": 2}

INSTEAD = {"Tri1DG": "MeshTri(mesh.p, mesh.dofs.element_dofs).remove_duplicate_nodes()",
           "Quad": "mesh.to_meshtri()", "Hex": "mesh.to_meshtet()", "Wedge": "mesh.to_meshtet()"}
"""What makes a mesh of triangles or tetrahedra, by a part of the name of a class."""


def matches(mesh: object) -> bool:
    """Say whether this is a mesh of scikit-fem."""
    return is_instance(mesh, "skfem", "Mesh")


def read(mesh: Any, regions: str | Sequence[str] | None = None) -> HostMesh:
    """Take the arrays out of a mesh.

    Parameters
    ----------
    mesh : skfem.Mesh
    regions : names, "auto" or None
                               of subdomains; "auto" takes all of them

    Raises
    ------
    UnsupportedMeshError       cells other than triangles and tetrahedra, or none
    InvalidMeshError           a subdomain or boundary is neither indices nor a mask
    InvalidOptionError         there is no subdomain of that name
    """
    # That of scikit-fem, of which a class of the caller's is made.
    kind = next(base.__name__ for base in type(mesh).__mro__ if base.__module__[:5] == "skfem")
    order = ORDERS.get(kind)
    if order is None:
        known = "MeshTri, MeshTet, MeshTri2 or MeshTet2"
        advice = next((f", try {call}" for name, call in INSTEAD.items() if name in kind), "")
        msg = f"got a {kind}; expected {known}{advice}"
        raise UnsupportedMeshError(msg)
    if not mesh.t.shape[1]:
        msg = f"got a {kind} without elements; expected at least one"
        raise UnsupportedMeshError(msg)
    corners = np.ascontiguousarray(mesh.t.T)
    points = np.ascontiguousarray(mesh.doflocs.T)
    nodes = corners
    if order == 2:
        nodes = np.ascontiguousarray(mesh.dofs.element_dofs.T)
        check_mid_nodes(nodes, len(points), lattice(corners.shape[1] - 1, 2))
    kept = [KeptCells("boundary facet", mesh.facets[:, facets].T,
                      np.zeros(len(facets), dtype=np.int64))
            for facets in (_chosen(facets, mesh.facets.shape[1], f"boundary {name!r}")
                           for name, facets in (mesh.boundaries or {}).items())]
    labels = _labels(mesh, regions, corners)
    return HostMesh(points, corners, *labels, kept=tuple(kept), source=mesh, layout=nodes,
                    higher_order=order == 2, words=in_words,
                    nodes=nodes if order == 2 else None,
                    shape=lattice(corners.shape[1] - 1, 2) if order == 2 else None, whole=True)


def write(result: Result, host: HostMesh) -> Any:
    """Make a mesh of the same class."""
    mesh = host.source
    places, cells = result.points, result.cells
    number = np.arange(len(places))
    if host.higher_order:
        # Vertices come first in scikit-fem, then a node for every edge in the order of its own.
        d = host.cells.shape[1]
        nodes: Any = result
        if cells.shape[1] == d:
            nodes = with_mid_nodes(result, host.points, host.layout, np.zeros(0, dtype=np.int64),
                                   lattice(d - 1, 2))
        corners = np.unique(nodes.cells[:, :d])
        number = np.full(len(nodes.points), -1)
        number[corners] = np.arange(len(corners))
        cells = number[nodes.cells[:, :d]].astype(cells.dtype)
        out = replace(mesh, doflocs=nodes.points.T.copy(), t=cells.T.copy())
        place = np.array(out.doflocs)
        place[:, : len(corners)] = nodes.points[corners].T
        place[:, out.dofs.element_dofs[d:].T.ravel()] = nodes.points[nodes.cells[:, d:].ravel()].T
        places = place.T
    out = replace(mesh, doflocs=places.T.copy(), t=cells.T.copy(), _boundaries=None,
                  _subdomains=None)
    subdomains, boundaries = mesh.subdomains, mesh.boundaries
    inside = {name: _members(mesh, name) for name in subdomains or {}}
    if subdomains is not None:
        subdomains = {name: _as_given(mask[result.source], subdomains[name])
                      for name, mask in inside.items()}
    if boundaries is not None:
        masks = np.array([*inside.values(), np.zeros(mesh.t.shape[1], dtype=np.bool_)])
        labels = np.unique(masks, axis=1, return_inverse=True)[1].ravel()
        boundaries = {
            name: _moved_facets(mesh, out, facets, _renumbered(
                result.faces_of(i, host.kept[i].rows), number, host.kept[i].rows.shape[1]),
                (labels, labels[result.source]))
            for i, (name, facets) in enumerate(boundaries.items())}
    return replace(out, _subdomains=subdomains, _boundaries=boundaries)


def _renumbered(faces: NewFaces, number: NDArray[Any], corners: int) -> NewFaces:
    """Renumber the corners of faces."""
    return faces._replace(rows=number[faces.rows[:, :corners]])


def in_words(text: str) -> str:
    """Put an error message into scikit-fem's words."""
    text = text.replace("merging vertices at the same place", "mesh.remove_duplicate_nodes()")
    return re.sub(r"\bcell(s?)\b", r"element\1", text)


def _members(mesh: Any, name: str) -> NDArray[np.bool_]:
    """Which elements (m,) are in a subdomain."""
    inside = np.zeros(mesh.t.shape[1], dtype=np.bool_)
    inside[_chosen(mesh.subdomains[name], len(inside), f"subdomain {name!r}")] = True
    return inside


def _chosen(members: Any, count: int, what: str) -> NDArray[Any]:
    """Indices of members that are given so, or by a mask.

    Raises
    ------
    InvalidMeshError    they are neither
    """
    try:
        given = np.ravel(members)
    except ValueError as exc:
        msg = f"{what} has rows of several lengths; expected indices or a mask"
        raise InvalidMeshError(msg) from exc
    given = given if given.size else given.astype(np.int64)
    if given.dtype.kind not in "biu":
        msg = f"{what} has numbers of dtype {given.dtype}; expected indices or a mask"
        raise InvalidMeshError(msg)
    if given.dtype == np.bool_:
        expect_members(f"{what} has {{}}", given, count)
        return np.flatnonzero(given)
    given = from_start(given, count)
    expect_members(f"{what} has {{}}", given, count)
    return given


def _as_given(mask: NDArray[np.bool_], old: Any) -> NDArray[Any]:
    """Members in the form of old ones: a mask, or indices."""
    like = np.asarray(old)
    return mask if like.dtype == np.bool_ else as_indices(np.flatnonzero(mask), like)


def _labels(mesh: Any, regions: str | Sequence[str] | None, cells: NDArray[Any]) -> Labels:
    arrays = {name: _members(mesh, name).astype(np.int64) for name in mesh.subdomains or {}}
    if regions == AUTO:
        regions = [name for name, inside in arrays.items() if inside.min() != inside.max()]
        regions = regions or None
    return region_labels(arrays, regions, cells)


def _moved_facets(
    old: Any, new: Any, facets: NDArray[Any], now: NewFaces,
    labels: tuple[NDArray[np.intp], NDArray[np.intp]],
) -> NDArray[Any]:
    """Facets in the numbering of another mesh, with their orientation if they have one.

    They point out of elements with the labels of those that the old ones point out of, between
    elements of one label in the direction of the old ones. Those of the outer boundary that point
    into the mesh still do.

    Parameters
    ----------
    old, new : skfem.Mesh
    facets : (q,) int    of the old mesh
    now : NewFaces       what they have become
    labels : (m,), (m',) int    of the elements of both meshes
    """
    there = np.sort(new.facets.T, axis=1).astype(np.int32)
    found = labels_at(now.rows, Faces(there, np.arange(len(there), dtype=np.int32)))
    if np.asarray(facets).dtype == np.bool_:
        return np.isin(np.arange(len(there)), found)
    found = as_indices(found, np.asarray(facets))
    kind, sides = type(facets), getattr(facets, "ori", None)
    if sides is None:
        return found
    facets, side = np.asarray(facets), np.asarray(sides).astype(np.int64)
    was = _outward(old, facets, side)[:, now.source]
    turned = (was * _outward(new, found, np.zeros_like(found))).sum(axis=0) < 0.0
    behind, before = old.f2t[side, facets], old.f2t[1 - side, facets]
    # There is no element beyond the outer boundary, where facets may point into the mesh.
    own, others = np.where(behind >= 0, labels[0][behind], -1), labels[0][before[before >= 0]]
    beyond, inward = new.f2t[1, found] < 0, behind < 0
    first, second = np.where(new.f2t[:, found] >= 0, labels[1][new.f2t[:, found]], -1)
    near = own[now.source]
    turned = np.where((first != second) & ((first == near) | (second == near)), second == near,
                      turned)
    turned = np.where(beyond, inward[now.source], turned)
    # Labels on one side of all of them tell the side where another subdomain parts that one.
    own = own[~inward]
    score = (np.isin([second, first], np.setdiff1d(own, others)).astype(np.int64)
             + np.isin([first, second], np.setdiff1d(others, own)))
    turned = np.where(score[0] == score[1], turned, score[0] > score[1])
    turned &= ~beyond | inward.any()
    return kind(found, turned.astype(np.asarray(sides).dtype))


def _outward(mesh: Any, facets: NDArray[Any], sides: NDArray[np.int64]) -> NDArray[np.float64]:
    """Normals (d, q) of facets out of the element on one of their sides, or that would be there."""
    corners, elements = mesh.facets[:, facets], mesh.f2t[:, facets]
    tip = mesh.t[:, elements[0]].sum(axis=0) - corners.sum(axis=0)
    x = mesh.doflocs
    along = x[:, corners[1]] - x[:, corners[0]]
    if len(corners) == 2:
        normal = np.stack([along[1], -along[0]])
    else:
        normal = np.cross(along, x[:, corners[2]] - x[:, corners[0]], axis=0)
    inward = (normal * (x[:, tip] - x[:, corners[0]])).sum(axis=0) > 0.0
    return np.asarray(np.where(inward == (sides == 0), -normal, normal))
