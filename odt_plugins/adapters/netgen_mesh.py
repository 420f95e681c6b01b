"""netgen.meshing.Mesh and ngsolve.Mesh.

Everything survives: domains with their materials, names of boundaries, edges and points, face
descriptors, elements of lower dimension, periodic identifications, the geometry. Elements of
different domains never mix. A curved mesh is curved anew on its geometry, in its order. Points of a
surface that slide or come do so on the faces and edges of the geometry, not on their triangles.
Lost are the levels of refinement, and of
ngsolve.Mesh a deformation and absorbing layers: a warning names them. Elements of second order
(Netgen's `SecondOrder`), and others than triangles and tetrahedra, are refused by name.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.host import (
    SPLINE_VERTEX,
    Geometry,
    HostMesh,
    KeptCells,
    NewFaces,
    Result,
    each_once,
    is_instance,
    middles,
)
from odt_plugins.adapters.regions import region_labels
from odt_plugins.errors import (
    DataNotKeptWarning,
    InvalidMeshError,
    UnsupportedMeshError,
    counted,
    warn,
)
from odt_plugins.mesh.faces import Faces, ends_of

TRIANGLE, TETRAHEDRON, SECOND = 10, 20, (12, 21)
"""Netgen's numbers of element types, those of second order last."""

OVER = 1.25
"""How many times too far from its chord a parabola by Netgen is in the middle, where all that it is
to pass through is one place: the best fit of a bubble to a constant."""

IntArray = NDArray[np.int64]


class Layout(NamedTuple):
    """What :func:`write` needs to know of a mesh.

    Attributes
    ----------
    labels : (m,) int    number of the domain of every element
    faces, edges : tuple of (int, (k,) int)    of elements beside these, the numbers of parts of the
                         kept cells, and which elements each holds
    """

    labels: IntArray
    faces: tuple[tuple[int, IntArray], ...]
    edges: tuple[tuple[int, IntArray], ...]


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
    faces, edges = _faces_of(inner), _edges_of(inner)
    places: list[tuple[tuple[int, IntArray], ...]] = []
    for kind, (rows, classes) in (("surface element", faces), ("edge element", edges)):
        groups = each_once(KeptCells(kind, rows, classes)) if dim == 3 or rows.shape[1] == 2 else []
        if _on_splines(inner):
            groups = [(cells._replace(classes=None), own) for cells, own in groups]
        places.append(tuple((len(kept) + i, own) for i, (_, own) in enumerate(groups)))
        kept += [cells for cells, _ in groups]
    if _on_splines(inner):
        kept.append(KeptCells(SPLINE_VERTEX, np.unique(edges[0])[:, None]))
    elif has_geometry(inner) and len(edges[0]):
        own = places[1][0][1]
        lines = Faces(edges[0][own].astype(np.int32), edges[1][own].astype(np.int32))
        kept.append(KeptCells("end of an edge", np.flatnonzero(
            ends_of(lines, len(points)))[:, None]))
    used = np.zeros(len(points) + 1, dtype=np.bool_)
    used[cells] = True
    for part in kept:
        used[part.rows] = True
    lost = np.flatnonzero(~used[:-1])
    if lost.size:
        msg = (f"got {counted(lost.size, 'point')} in no element (first: point {lost[0]}); "
               f"expected none, try mesh.Compress()")
        raise UnsupportedMeshError(msg)
    labels, coupled = np.array(table["index"], dtype=np.int64), _coupled(inner)
    return HostMesh(
        points, cells, *region_labels({"material": labels}, regions, cells), kept=tuple(kept),
        source=mesh, layout=Layout(labels, *places), words=in_words,
        blocks=labels - labels.min() if labels.min() != labels.max() else None,
        geometry=None if _on_splines(inner) else _geometry(inner, points, faces, edges),
        coupled=coupled, linked=coupled is not None,
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


def _faces_of(mesh: Any) -> tuple[IntArray, IntArray]:
    """Points (q, 3) and face (q,), from 1 on, of the surface elements."""
    if not len(mesh.Elements2D()):
        return np.zeros((0, 3), dtype=np.int64), np.zeros(0, dtype=np.int64)
    table = _elements(mesh, 2)
    return np.array(table["nodes"], dtype=np.int64) - 1, np.array(table["index"], dtype=np.int64)


def _edges_of(mesh: Any) -> tuple[IntArray, IntArray]:
    """Points (q, 2) and edge (q,), above the numbers of all faces, of the edge elements."""
    if not len(mesh.Elements1D()):
        return np.zeros((0, 2), dtype=np.int64), np.zeros(0, dtype=np.int64)
    table = mesh.Elements1D().NumPy()
    number = np.unique(table["index"], return_inverse=True)[1].ravel()
    return (np.array(table["nodes"][:, :2], dtype=np.int64) - 1,
            mesh.GetNFaceDescriptors() + 1 + number.astype(np.int64))


def _on_splines(mesh: Any) -> bool:
    """Say whether edges are on splines of the plane, which Netgen knows by parameters alone."""
    return type(mesh.GetGeometry()).__name__ == "SplineGeometry"


def _geometry(
    mesh: Any, points: NDArray[np.float64], faces: tuple[IntArray, IntArray],
    edges: tuple[IntArray, IntArray],
) -> Geometry | None:
    """The faces and edges of the geometry, if there is one."""
    if not (has_geometry(mesh) and len(faces[0])):
        return None
    on = np.full(len(points), -1, dtype=np.int64)
    for rows, number in (faces, edges):
        on[rows] = number[:, None]
    segments = dict(zip(edges[1].tolist(), mesh.Elements1D(), strict=True))

    def closest(of: IntArray, places: NDArray[np.float64]) -> NDArray[np.float64]:
        out = places if mesh.dim == 2 else _put_on(mesh, of, places)
        here = np.isin(of, edges[1])
        if here.any():
            out = out.copy()
            out[here] = _put_on_edges(mesh, [segments[k] for k in of[here].tolist()], out[here])
        return out

    def sag() -> float:
        most = 0.0
        for rows, number in (faces, edges):
            middle = middles(points[rows])
            there = closest(np.tile(number, len(middle) // max(len(rows), 1)), middle)
            most = max(most, float(np.linalg.norm(there - middle, axis=1).max(initial=0.0)))
        return most

    return Geometry(closest, sag, on, np.unique(edges[0]), faces[1])


def _put_on(mesh: Any, face: NDArray[np.int64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Places (k, 3) nearest to given ones on the faces (k,) of the geometry, from 1 on.

    Netgen projects the corners of surface elements that are added to a mesh.
    """
    from netgen.meshing import FaceDescriptor, Mesh

    out = places.copy()
    on = np.flatnonzero((face > 0) & (face <= mesh.GetNFaceDescriptors()))
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


def _put_on_edges(
    mesh: Any, segments: list[Any], places: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Places (k, D) nearest to given ones on the edges of the geometry that segments (k,) are of.

    Netgen curves edges that are as long as nothing: all of their points are the one that is sought.
    """
    from netgen.meshing import FaceDescriptor, Mesh

    k, dim = places.shape
    scratch = Mesh(dim)
    scratch.SetGeometry(mesh.GetGeometry())
    scratch.Add(FaceDescriptor(surfnr=mesh.FaceDescriptor(1).surfnr, domin=1, domout=0, bc=1))
    for descriptor in mesh.EdgeDescriptors() if hasattr(mesh, "EdgeDescriptors") else ():
        scratch.Add(descriptor)
    points = np.repeat(places, 3, axis=0)
    points[2::3, 0] += max(float(np.ptp(places)), 1.0)
    scratch.AddPoints(points)
    corners = np.arange(3 * k, dtype=np.int32).reshape(-1, 3)
    _add_segments(scratch, segments, corners[:, :2] + 1)
    scratch.AddElements(dim=2, index=1, data=corners, base=0)
    scratch.Curve(2)
    middle = np.zeros((k, 1, dim))
    scratch.CalcElementMapping(np.array([[0.5, 0.5]]), middle)
    return np.asarray(places + (middle[:, 0] - places) / OVER)


def _add_segments(mesh: Any, segments: list[Any], rows: NDArray[Any]) -> None:
    """Add edge elements like others, between points (k, 2), from 1 on."""
    from netgen.meshing import Mesh

    copies = Mesh(mesh.dim)
    for segment in segments:
        copies.Add(segment)
    if segments:
        copies.Elements1D().NumPy()["nodes"][:, :2] = rows
    for segment in copies.Elements1D():
        mesh.Add(segment)


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
        found = int(table["type"][bad[0]])
        better = "Split2Tets()" if dim == 3 else "GenerateMesh() without quad_dominated"
        better = "Curve(2) in the place of SecondOrder()" if found in SECOND else better
        msg = (f"got {counted(bad.size, 'element')} of Netgen's type {found} (first: element "
               f"{bad[0]}); expected linear {name} only, try {better}")
        raise UnsupportedMeshError(msg)
    return table


def _points_of(mesh: Any) -> NDArray[np.int64]:
    """Points (q, 1) of the elements of dimension 0."""
    rows = [[int(vertex.nr) - 1 for vertex in element.vertices] for element in mesh.Elements0D()]
    return np.array(rows, dtype=np.int64).reshape(-1, 1)


def _fill(out: Any, result: Result, host: HostMesh) -> None:
    """Write points and elements into a copy of the mesh.

    Elements take the places of old ones; those that are too many are deleted, and go by `Compress`
    in the order of those before them, as points that are in no element do.
    """
    n, dim = len(host.points), host.cells.shape[1] - 1
    layout: Layout = host.layout
    origin = np.arange(n)
    if result.vertices is not None:
        origin = result.vertices.origin
    fresh = origin < 0
    if fresh.any():
        out.AddPoints(np.ascontiguousarray(result.points[fresh]))
    number = origin.copy()
    number[fresh] = n + np.arange(int(fresh.sum()))
    out.Coordinates()[number] = result.points
    rows, labels = number[result.cells] + 1, layout.labels[result.source]
    table = _elements(out, dim)
    old = len(table)
    table["nodes"][: len(rows)] = rows[:old]
    table["index"][: len(rows)] = labels[:old]
    if dim == 3:
        table["nodes"][len(rows):] = 0
    del table
    _add_elements(out, dim, rows[old:], labels[old:])
    if dim == 2:
        _delete_faces(out, range(len(rows), old))
    faces = _followed(result, host, layout.faces)
    if result.faces and faces is not None:
        index = np.array(out.Elements2D().NumPy()["index"])[faces.source]
        _exchange_faces(out, number[faces.rows] + 1, index, faces.source)
    lines = _followed(result, host, layout.edges)
    if result.faces and lines is not None:
        segments = list(_inner(host.source).Elements1D())
        _add_segments(out, [segments[i] for i in lines.source.tolist()], number[lines.rows] + 1)
        out.Elements1D().NumPy()["nodes"][: len(segments)] = 0
    out.Coordinates()[number] = result.points
    out.Compress()
    elements = out.Elements3D() if dim == 3 else out.Elements2D()
    found = len(elements), len(out.Points())
    if found != (len(rows), len(result.points)):
        msg = f"Netgen made {found} elements and points of {(len(rows), len(result.points))}"
        raise InvalidMeshError(msg)


def _followed(
    result: Result, host: HostMesh, parts: tuple[tuple[int, IntArray], ...]
) -> NewFaces | None:
    """What the elements beside the others have become, None where there are none."""
    if not parts:
        return None
    new = [result.faces_of(number, host.kept[number].rows) for number, _ in parts]
    source = np.concatenate([own[now.source] for now, (_, own) in zip(new, parts, strict=True)])
    order = np.argsort(source, kind="stable")
    return NewFaces(np.concatenate([now.rows for now in new])[order], source[order])


def _add_elements(mesh: Any, dim: int, rows: IntArray, labels: IntArray, **options: Any) -> None:
    """Add elements of points (k, dim + 1), from 1 on, with labels (k,), in their order."""
    ends = np.flatnonzero(np.diff(labels)) + 1
    for part in np.split(np.arange(len(rows)), ends) if len(rows) else ():
        mesh.AddElements(dim=dim, index=int(labels[part[0]]),
                         data=np.ascontiguousarray(rows[part], dtype=np.int32), base=1, **options)


def _exchange_faces(mesh: Any, rows: IntArray, labels: IntArray, source: NDArray[Any]) -> None:
    """Let the surface elements be others, each with the mark for refinement of one of before."""
    old = len(mesh.Elements2D())
    marks = np.array(_elements(mesh, 2)["refine"])
    project = mesh.dim == 3 and has_geometry(mesh)
    _add_elements(mesh, 2, rows, labels, **({"project_geometry": True} if project else {}))
    _elements(mesh, 2)["refine"][old:] = marks[source]
    _delete_faces(mesh, range(old))


def _delete_faces(mesh: Any, numbers: range) -> None:
    """Let surface elements go with `Compress`."""
    from netgen.meshing import ElementId2D

    for i in numbers:
        mesh.DeleteSurfaceElement(ElementId2D(i))


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
