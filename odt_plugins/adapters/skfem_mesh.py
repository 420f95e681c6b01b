"""Meshes of scikit-fem: MeshTri and MeshTet, MeshTri2 and MeshTet2.

Everything survives: class, named subdomains, whose interfaces stay, and named boundaries, whose
facets stay and which follow them into the new numbering, with their orientation if they have one.
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

from odt_plugins.adapters.higher_order import (
    check_mid_nodes,
    lattice,
    with_mid_nodes,
)
from odt_plugins.adapters.host import HostMesh, KeptCells, Result, is_instance
from odt_plugins.adapters.regions import AUTO, Labels, region_labels
from odt_plugins.errors import UnsupportedMeshError
from odt_plugins.mesh.facets import row_keys

ORDERS = {"MeshTri1": 1, "MeshTet1": 1, "MeshTri2": 2, "MeshTet2": 2}


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
    InvalidOptionError         there is no subdomain of that name
    """
    # That of scikit-fem, of which a class of the caller's is made.
    kind = next(base.__name__ for base in type(mesh).__mro__ if base.__module__[:5] == "skfem")
    order = ORDERS.get(kind)
    if order is None:
        msg = (f"got a {kind}; expected MeshTri, MeshTet, MeshTri2 or MeshTet2, try "
               f"mesh.to_meshtri() or mesh.to_meshtet() of quadrilaterals and hexahedra")
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
    kept = [KeptCells("boundary facet", mesh.facets[:, np.asarray(facets)].T)
            for facets in (mesh.boundaries or {}).values() if len(facets)]
    labels = _labels(mesh, regions, corners)
    return HostMesh(points, corners, *labels, kept=tuple(kept), source=mesh, layout=nodes,
                    higher_order=order == 2, words=in_words,
                    nodes=nodes if order == 2 else None,
                    shape=lattice(corners.shape[1] - 1, 2) if order == 2 else None)


def write(result: Result, host: HostMesh) -> Any:
    """Make a mesh of the same class."""
    mesh, number = host.source, np.arange(len(host.points))
    if result.vertices is not None:
        number = result.vertices.number
    places, cells = result.points, result.cells
    if host.higher_order:
        shape = lattice(cells.shape[1] - 1, 2)
        q = with_mid_nodes(result, host.points, host.layout, np.zeros(0, dtype=np.int64), shape)
        # Vertices come first in scikit-fem, then a node for every edge in the order of its own.
        d, first = cells.shape[1], int(cells.max()) + 1
        out = replace(mesh, doflocs=q.points.T.copy(), t=cells.T.copy())
        place = np.array(out.doflocs)
        place[:, :first] = result.points[:first].T
        place[:, out.dofs.element_dofs[d:].T.ravel()] = q.points[q.cells[:, d:].ravel()].T
        places = place.T
    out = replace(mesh, doflocs=places.T.copy(), t=cells.T.copy(), _boundaries=None,
                  _subdomains=None)
    subdomains, boundaries = mesh.subdomains, mesh.boundaries
    if subdomains is not None:
        inside = {name: _members(mesh, name) for name in subdomains}
        subdomains = {name: np.flatnonzero(mask[result.source]).astype(subdomains[name].dtype)
                      for name, mask in inside.items()}
    if boundaries is not None:
        boundaries = {name: _moved_facets(mesh, out, facets, number)
                      for name, facets in boundaries.items()}
    return replace(out, _subdomains=subdomains, _boundaries=boundaries)


def in_words(text: str) -> str:
    """Put an error message into scikit-fem's words."""
    text = text.replace("merging vertices at the same place", "mesh.remove_duplicate_nodes()")
    return re.sub(r"\bcell(s?)\b", r"element\1", text)


def _members(mesh: Any, name: str) -> NDArray[np.bool_]:
    """Which elements (m,) are in a subdomain."""
    inside = np.zeros(mesh.t.shape[1], dtype=np.bool_)
    inside[np.asarray(mesh.subdomains[name])] = True
    return inside


def _labels(mesh: Any, regions: str | Sequence[str] | None, cells: NDArray[Any]) -> Labels:
    arrays = {name: _members(mesh, name).astype(np.int64) for name in mesh.subdomains or {}}
    if regions == AUTO:
        regions = [name for name, inside in arrays.items() if inside.min() != inside.max()]
        regions = regions or None
    return region_labels(arrays, regions, cells)


def _moved_facets(
    old: Any, new: Any, facets: NDArray[Any], number: NDArray[Any]
) -> NDArray[Any]:
    """The same facets in the numbering of another mesh, with their orientation if they have one.

    Parameters
    ----------
    old, new : skfem.Mesh
    facets : (q,) int      of the old mesh, all of which are still there
    number : (n,) int      vertex of the new mesh for every old one
    """
    rows = np.sort(number[old.facets[:, np.asarray(facets)].T], axis=1)
    there = np.sort(new.facets.T, axis=1).astype(np.int64)
    key = row_keys(np.concatenate([rows, there]), int(there.max()) + 1)
    order = np.argsort(key[len(rows):], kind="stable")
    found = order[np.searchsorted(key[len(rows):], key[:len(rows)], sorter=order)]
    found = found.astype(np.asarray(facets).dtype)
    sides = getattr(facets, "ori", None)
    if sides is None:
        return found
    before, after = _sides(old, np.asarray(facets)), _sides(new, found)
    turned = before[np.asarray(sides), np.arange(len(found))] != after[0]
    return type(facets)(found, turned.astype(np.asarray(sides).dtype))


def _sides(mesh: Any, facets: NDArray[Any]) -> NDArray[np.bool_]:
    """On which side (2, q) of its facet each of the two elements there lies, or would lie."""
    corners = mesh.facets[:, facets]
    elements = mesh.f2t[:, facets]
    outer = elements[1] < 0
    opposite = mesh.t[:, elements].sum(axis=0) - corners.sum(axis=0)
    opposite[1, outer] = opposite[0, outer]
    order = np.argsort(corners, axis=0)
    corners = np.take_along_axis(corners, order, axis=0)
    x = mesh.doflocs
    along = x[:, corners[1]] - x[:, corners[0]]
    if len(corners) == 2:
        normal = np.stack([along[1], -along[0]])
    else:
        normal = np.cross(along, x[:, corners[2]] - x[:, corners[0]], axis=0)
    side = np.stack([(normal * (x[:, tip] - x[:, corners[0]])).sum(axis=0) > 0.0
                     for tip in opposite])
    side[1, outer] = ~side[0, outer]
    return np.asarray(side)
