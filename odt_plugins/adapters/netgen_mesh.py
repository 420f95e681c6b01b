"""netgen.meshing.Mesh and ngsolve.Mesh.

Everything survives: domains with their materials, names of boundaries, edges and points, face
descriptors, elements of lower dimension, periodic identifications, the geometry. Elements of
different domains never mix. A curved mesh is curved anew on its geometry, in its order. Points of a
surface that slide do so on the faces of the geometry, not on their triangles; those on its edges
stay, since Netgen keeps where they lie there. Lost are the levels of refinement, and of
ngsolve.Mesh a deformation and absorbing layers: a warning names them. Elements of second order
(Netgen's `SecondOrder`), and others than triangles and tetrahedra, are refused by name.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.host import Geometry, HostMesh, KeptCells, Result, is_instance
from odt_plugins.adapters.regions import region_labels
from odt_plugins.errors import (
    DataNotKeptWarning,
    InvalidMeshError,
    UnsupportedMeshError,
    counted,
    warn,
)

TRIANGLE, TETRAHEDRON = 10, 20
"""Netgen's numbers of element types."""


def matches(mesh: object) -> bool:
    """Say whether this is a mesh of Netgen or NGSolve."""
    return is_instance(mesh, "netgen", "Mesh") or is_instance(mesh, "ngsolve", "Mesh")


def read(mesh: Any, regions: str | Sequence[str] | None = None) -> HostMesh:
    """Take the tetrahedra, or the triangles if there are none.

    Parameters
    ----------
    mesh : netgen.meshing.Mesh or ngsolve.Mesh
    regions : "auto" or None    or "material", the numbers of the domains

    Raises
    ------
    InvalidMeshError            there are no elements
    UnsupportedMeshError        other elements, or points that are in no element
    InvalidOptionError          other regions are named
    """
    inner = _inner(mesh)
    dim = 3 if len(inner.Elements3D()) else 2
    if dim == 2 and not len(inner.Elements2D()):
        msg = (f"the mesh has no elements ({len(inner.Points())} points); expected tetrahedra or "
               f"triangles, try mesh.GenerateVolumeMesh()")
        raise InvalidMeshError(msg)
    points, table = np.array(inner.Coordinates(), dtype=np.float64), _elements(inner, dim)
    cells = np.array(table["nodes"], dtype=np.int64) - 1
    kept = [KeptCells("point element", _points_of(inner))]
    if dim == 3 and len(inner.Elements2D()):
        faces = np.array(_elements(inner, 2)["nodes"], dtype=np.int64) - 1
        kept.append(KeptCells("surface element", faces))
    if len(inner.Elements1D()):
        edges = np.array(inner.Elements1D().NumPy()["nodes"][:, :2], dtype=np.int64) - 1
        kept.append(KeptCells("edge element", edges))
        if has_geometry(inner):
            kept.append(KeptCells("point of an edge", edges.reshape(-1, 1)))
    used = np.zeros(len(points) + 1, dtype=np.bool_)
    used[cells] = True
    for part in kept:
        used[part.rows] = True
    lost = np.flatnonzero(~used[:-1])
    if lost.size:
        msg = (f"got {counted(lost.size, 'point')} in no element (first: point {lost[0]}); "
               f"expected none, try mesh.Compress()")
        raise UnsupportedMeshError(msg)
    labels = np.array(table["index"], dtype=np.int64)
    return HostMesh(
        points, cells, *region_labels({"material": labels}, regions, cells), kept=tuple(kept),
        source=mesh, layout=labels, words=in_words,
        blocks=labels - labels.min() if labels.min() != labels.max() else None,
        geometry=_geometry(inner, points) if points.shape[1] == 3 else None,
        coupled=_coupled(inner),
    )


def write(result: Result, host: HostMesh) -> Any:
    """Copy the caller's mesh and exchange its points and elements.

    Warns
    -----
    DataNotKeptWarning    levels of refinement, or a deformation or absorbing layers of
                          ngsolve.Mesh, are lost
    """
    inner = _inner(host.source)
    order = max(int(inner.GetCurveOrder()), 1)
    out = inner.Copy()
    _fill(out, result, host)
    _identify(out, inner, result, host)
    if order > 1:
        out.Curve(order)
    wraps = is_instance(host.source, "ngsolve", "Mesh")
    lost = [name for name, there in (
        ("levels of refinement", len(inner.parentelements) > 0),
        ("the deformation", wraps and host.source.deformation is not None),
        ("absorbing layers", wraps and any(
            trafo is not None for trafo in host.source.GetPMLTrafos())),
    ) if there]
    if lost:
        warn(f"{' and '.join(lost)} of the mesh are not kept", DataNotKeptWarning)
    return type(host.source)(out) if wraps else out


def in_words(text: str) -> str:
    """Put an error message into Netgen's words."""
    return re.sub(r"\bcell(s?)\b", r"element\1", text)


def _coupled(mesh: Any) -> NDArray[np.int64] | None:
    """Points that are identified with others, if there are any."""
    pairs = [[one.nr - 1, other.nr - 1] for one, other, _ in mesh.GetIdentifications()]
    return np.unique(np.array(pairs, dtype=np.int64)) if pairs else None


def has_geometry(mesh: Any) -> bool:
    """Say whether a mesh of Netgen knows the geometry that it is made of."""
    return type(mesh.GetGeometry()).__name__ not in ("NetgenGeometry", "NoneType")


def _geometry(mesh: Any, points: NDArray[np.float64]) -> Geometry | None:
    """The faces of the geometry, if there is one."""
    if not (has_geometry(mesh) and len(mesh.Elements2D())):
        return None
    table = _elements(mesh, 2)
    faces = np.array(table["nodes"], dtype=np.int64) - 1
    index = np.array(table["index"], dtype=np.int64)
    face = np.zeros(len(points), dtype=np.int64)
    face[faces] = index[:, None]
    edges = np.zeros((0, 2), dtype=np.int64)
    if len(mesh.Elements1D()):
        edges = np.array(mesh.Elements1D().NumPy()["nodes"][:, :2], dtype=np.int64) - 1
    face[edges] = 0

    def closest(vertices: NDArray[Any], places: NDArray[np.float64]) -> NDArray[np.float64]:
        return _put_on(mesh, np.where(vertices < 0, 0, face[vertices]), places)

    def sag() -> float:
        x = points[faces]
        middle = np.concatenate([x.mean(axis=1), *(
            0.5 * (x[:, a] + x[:, b]) for a, b in ((0, 1), (1, 2), (2, 0)))])
        there = _put_on(mesh, np.tile(index, 4), middle)
        return float(np.linalg.norm(there - middle, axis=1).max())

    return Geometry(closest, sag, np.unique(edges))


def _put_on(
    mesh: Any, face: NDArray[np.int64], places: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Places (k, 3) nearest to given ones on the faces (k,) of the geometry, from 1 on.

    Netgen projects the corners of surface elements that are added to a mesh.
    """
    from netgen.meshing import FaceDescriptor, Mesh

    out = places.copy()
    on = np.flatnonzero(face > 0)
    if not on.size:
        return out
    scratch = Mesh(3)
    scratch.SetGeometry(mesh.GetGeometry())
    for number in range(1, mesh.GetNFaceDescriptors() + 1):
        own = mesh.FaceDescriptor(number)
        scratch.Add(FaceDescriptor(surfnr=own.surfnr, domin=own.domin, domout=own.domout,
                                   bc=own.bc))
    scratch.AddPoints(np.ascontiguousarray(places[on]))
    for number in np.unique(face[on]).tolist():
        rows = np.repeat(np.flatnonzero(face[on] == number)[:, None], 3, axis=1)
        scratch.AddElements(dim=2, index=number, data=rows.astype(np.int32), base=0,
                            project_geometry=True)
    out[on] = scratch.Coordinates()
    return out


def _inner(mesh: Any) -> Any:
    """The mesh of Netgen within one of NGSolve."""
    return mesh.ngmesh if is_instance(mesh, "ngsolve", "Mesh") else mesh


def _elements(mesh: Any, dim: int) -> Any:
    """Table of the elements of a dimension, whose columns are written through.

    Raises
    ------
    UnsupportedMeshError    they are no triangles or tetrahedra of first order
    """
    table = (mesh.Elements3D() if dim == 3 else mesh.Elements2D()).NumPy()
    kind, name = (TETRAHEDRON, "tetrahedra") if dim == 3 else (TRIANGLE, "triangles")
    bad = np.flatnonzero(table["type"] != kind)
    if bad.size:
        msg = (f"got {counted(bad.size, 'element')} of Netgen's type {table['type'][bad[0]]} "
               f"(first: element {bad[0]}); expected linear {name} only, and Curve(2) in the "
               f"place of SecondOrder()")
        raise UnsupportedMeshError(msg)
    return table


def _points_of(mesh: Any) -> NDArray[np.int64]:
    """Points (q, 1) of the elements of dimension 0."""
    rows = [[int(vertex.nr) - 1 for vertex in element.vertices] for element in mesh.Elements0D()]
    return np.array(rows, dtype=np.int64).reshape(-1, 1)


def _fill(out: Any, result: Result, host: HostMesh) -> None:
    """Write points and elements into a copy of the mesh.

    Elements take the places of old ones; those that are too many get no points, which Netgen takes
    for deleted, and go with `Compress`, as points that are in no element do.
    """
    n, dim = len(host.points), host.cells.shape[1] - 1
    origin = np.arange(n)
    if result.vertices is not None:
        origin = result.vertices.origin
    fresh = origin < 0
    if fresh.any():
        out.AddPoints(np.ascontiguousarray(result.points[fresh]))
    number = origin.copy()
    number[fresh] = n + np.arange(int(fresh.sum()))
    places = out.Coordinates()
    places[number] = result.points
    rows = (number[result.cells] + 1).astype(np.int32)
    labels = host.layout[result.source]
    table = _elements(out, dim)
    old = len(table)
    table["nodes"][: len(rows)] = rows[:old]
    table["index"][: len(rows)] = labels[:old]
    table["nodes"][len(rows):] = 0
    del table, places
    ends = np.flatnonzero(np.diff(labels[old:])) + 1
    for part in np.split(np.arange(old, len(rows)), ends) if len(rows) > old else ():
        out.AddElements(dim=dim, index=int(labels[part[0]]), data=np.ascontiguousarray(rows[part]),
                        base=1)
    if dim == 3 and (len(rows) < old or (~fresh).sum() < n):
        out.Compress()
    elements = out.Elements3D() if dim == 3 else out.Elements2D()
    found = len(elements), len(out.Points())
    if found != (len(rows), len(result.points)):
        msg = f"Netgen made {found} elements and points of {(len(rows), len(result.points))}"
        raise InvalidMeshError(msg)


def _identify(out: Any, source: Any, result: Result, host: HostMesh) -> None:
    """Identify the same points, which Netgen's copy does not; they are on the boundary.

    Raises
    ------
    UnsupportedMeshError    they moved, and no longer correspond
    """
    number = np.arange(len(host.points)) if result.vertices is None else result.vertices.number
    for one, other, which in source.GetIdentifications():
        old = np.array([one.nr - 1, other.nr - 1])
        if not np.array_equal(result.points[number[old]], host.points[old]):
            msg = (f"got identified points, such as {old[0]} and {old[1]}, that would no longer "
                   f"correspond; expected none that move, try leaving 'periodic' out of free")
            raise UnsupportedMeshError(msg)
        pair = (type(p)(int(number[p.nr - 1]) + 1) for p in (one, other))
        out.AddPointIdentification(*pair, which, source.GetIdentificationType(which))
