"""open3d meshes: legacy TriangleMesh and TetraMesh, tensor t.geometry.TriangleMesh.

Everything survives: class, dtype and device, vertex colours, texture coordinates, materials,
textures, every attribute of a tensor mesh. Normals and the adjacency list are computed anew if
they were there and the mesh changed; those of a TetraMesh stay, since only on the boundary do they
mean something. Faces of different materials or charts of the texture never
mix. Tensor meshes on another device are optimised on the CPU and copied back, with a warning.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.fields import dense, sampled
from odt_plugins.adapters.host import HostMesh, KeptCells, Result, is_instance
from odt_plugins.adapters.lengths import expect_one_each
from odt_plugins.adapters.regions import region_labels
from odt_plugins.adapters.wedges import carried, charts, slid
from odt_plugins.errors import InvalidMeshError, ODTWarning, UnsupportedMeshError, warn

REMEDIES = (
    (r"merging vertices at the same place",
     ("remove_duplicated_vertices()", "to_legacy().remove_duplicated_vertices()")),
    (r"(?<=try )removing the cells that overlap", ("remove_non_manifold_edges()",)),
    (r"(?<=try )removing repeated cells",
     ("remove_duplicated_triangles()", "remove_duplicated_tetras()")),
    (r"(?<=different vertices, try )removing such cells",
     ("remove_degenerate_triangles()", "remove_degenerate_tetras()")),
)
"""What error messages advise, and the methods of open3d that do it, on one class or another."""


def matches(mesh: object) -> bool:
    """Say whether this is a TriangleMesh or a TetraMesh of open3d."""
    return is_instance(mesh, "open3d", "TriangleMesh") or is_instance(mesh, "open3d", "TetraMesh")


def is_tensor(mesh: object) -> bool:
    """Say whether a mesh belongs to open3d.t.geometry."""
    return any(".t.geometry" in base.__module__ for base in type(mesh).__mro__)


def read(mesh: Any, regions: str | Sequence[str] | None = None) -> HostMesh:
    """Take the arrays out of an open3d mesh.

    Parameters
    ----------
    mesh : open3d.geometry.TriangleMesh, open3d.geometry.TetraMesh or
        open3d.t.geometry.TriangleMesh
    regions : names, "auto" or None
                               of triangle attributes of region labels, such as the material ids

    Raises
    ------
    UnsupportedMeshError       the mesh has no triangles or tetrahedra
    InvalidMeshError           texture coordinates or material ids of the wrong length
    InvalidOptionError         there is no attribute of that name
    """
    if is_instance(mesh, "open3d", "TetraMesh"):
        _require(len(mesh.tetras), len(mesh.vertices), "TetraMesh", "tetrahedra")
        return HostMesh(
            points=np.array(mesh.vertices),
            cells=np.array(mesh.tetras),
            regions=region_labels({}, regions, np.array(mesh.tetras)).values,
            source=mesh,
            fields=sampled({"vertex_colors": np.array(mesh.vertex_colors)}
                           if mesh.has_vertex_colors() else {}),
            follows=False,
            words=partial(in_words, mesh=mesh),
        )
    return _read_tensor(mesh, regions) if is_tensor(mesh) else _read_legacy(mesh, regions)


def write(result: Result, host: HostMesh) -> Any:
    """Copy the caller's mesh and exchange its vertices, its cells and their data."""
    same = np.array_equal(result.cells, host.cells) and np.array_equal(result.points, host.points)
    if is_tensor(host.source):
        return _write_tensor(result, host, same)
    from open3d.utility import Vector3dVector, Vector4iVector

    out = type(host.source)(host.source)
    if same:
        return out
    out.vertices = Vector3dVector(result.points)
    if is_instance(out, "open3d", "TetraMesh"):
        out.tetras = Vector4iVector(result.cells)
        if result.vertices is not None:
            mesh = host.source
            for name in ("vertex_normals", "vertex_colors"):
                values = np.asarray(getattr(mesh, name))
                if len(values):
                    field = name in host.fields
                    setattr(out, name, Vector3dVector(
                        result.vertices.carried(values, name, field=field)))
        return out
    return _write_triangles(out, result, host)


def in_words(text: str, mesh: Any) -> str:
    """Put an error message into open3d's words, with advice that this mesh can follow."""
    for advice, calls in REMEDIES:
        call = next((call for call in calls if hasattr(mesh, call.partition("(")[0])), None)
        if call:
            text = re.sub(advice, f"mesh.{call}", text)
    names = ("tetrahedron", "tetrahedra") if is_instance(mesh, "open3d", "TetraMesh") else (
        "triangle", "triangles")
    return re.sub(r"\bcell(s?)\b", lambda found: names[bool(found[1])], text)


def _read_legacy(mesh: Any, regions: str | Sequence[str] | None) -> HostMesh:
    n, m = len(mesh.vertices), len(mesh.triangles)
    _require(m, n, "TriangleMesh", "triangles")
    cells = np.array(mesh.triangles)
    uv = _wedges(mesh.triangle_uvs, m, "triangle_uvs") if mesh.has_triangle_uvs() else None
    arrays = {}
    if mesh.has_triangle_material_ids():
        name = "triangle_material_ids"
        arrays[name] = expect_one_each(name, np.array(mesh.triangle_material_ids), m, "triangle")
    colors = {"vertex_colors": np.array(mesh.vertex_colors)} if mesh.has_vertex_colors() else {}
    host = _host(mesh, np.array(mesh.vertices), cells, uv, arrays, regions)
    return replace(host, fields=sampled(colors))


def _read_tensor(mesh: Any, regions: str | Sequence[str] | None) -> HostMesh:
    if "positions" not in mesh.vertex or "indices" not in mesh.triangle:
        n = len(mesh.vertex["positions"]) if "positions" in mesh.vertex else 0
        _require(0, n, "t.geometry.TriangleMesh", "triangles")
    if not mesh.is_cpu:
        msg = (f"the mesh lies on {mesh.device}; it is copied to the CPU, optimised there and "
               f"copied back")
        warn(msg, ODTWarning)
    points = np.array(mesh.vertex["positions"].cpu().numpy())
    cells = np.array(mesh.triangle["indices"].cpu().numpy())
    m = len(cells)
    _require(m, len(points), "t.geometry.TriangleMesh", "triangles")
    arrays = {
        name: expect_one_each(f"triangle.{name}", np.array(values.cpu().numpy()), m, "triangle")
        for name, values in mesh.triangle.items()
        if name != "indices"
    }
    uv = arrays.get("texture_uvs")
    uv = None if uv is None else _wedges(uv.reshape(-1, 2), m, "triangle.texture_uvs")
    host = _host(mesh, points, cells, uv, arrays, regions)
    data = _point_data(mesh)
    texture = data.get("texture_uvs") if uv is None else uv
    return replace(host, fields=sampled(data, ("texture_uvs",)), texture=texture)


def _host(
    mesh: Any,
    points: NDArray[Any],
    cells: NDArray[Any],
    uv: NDArray[Any] | None,
    arrays: dict[str, NDArray[Any]],
    regions: str | Sequence[str] | None,
) -> HostMesh:
    """Put together what both classes of triangle meshes have."""
    labels = region_labels(arrays, regions, cells)
    blocks: NDArray[np.int64] | None = None
    kept: tuple[KeptCells, ...] = ()
    # indices out of range are named by the checks that every mesh passes
    if uv is not None and cells.min() >= 0 and cells.max() < len(points):
        blocks, seams = charts(uv, cells)
        kept = (seams,) if len(seams.rows) else ()
    return HostMesh(points, cells, *labels, blocks, kept, source=mesh, layout=uv,
                    follows=False, words=partial(in_words, mesh=mesh), texture=uv,
                    densities=dense(arrays, ("texture_uvs",)))


def _write_triangles(out: Any, result: Result, host: HostMesh) -> Any:
    from open3d.utility import IntVector, Vector2dVector, Vector3dVector, Vector3iVector

    mesh, nowhere = host.source, Vector3dVector()
    out.triangles = Vector3iVector(result.cells)
    if host.layout is not None:
        uv = carried(host.layout, host.cells, result)
        out.triangle_uvs = Vector2dVector(uv.reshape(-1, 2))
    if mesh.has_triangle_material_ids():
        out.triangle_material_ids = IntVector(np.array(mesh.triangle_material_ids)[result.source])
    if host.fields and result.vertices is not None:
        out.vertex_colors = Vector3dVector(
            result.vertices.carried(np.array(mesh.vertex_colors), "vertex_colors"))
    out.triangle_normals, out.vertex_normals = nowhere, nowhere
    if mesh.has_triangle_normals():
        out.compute_triangle_normals()
    if mesh.has_vertex_normals():
        out.compute_vertex_normals()
    if not mesh.has_triangle_normals():
        out.triangle_normals = nowhere
    if mesh.has_adjacency_list():
        out.compute_adjacency_list()
    return out


def _write_tensor(result: Result, host: HostMesh, same: bool) -> Any:
    """Fill a clone; open3d's clone() shares no memory but forgets the material."""
    from open3d.core import Tensor

    mesh = host.source
    out = mesh.clone()
    out.material = mesh.material
    if same:
        return out
    moved = result.vertices
    data = {} if moved is None else {
        name: moved.carried(values, name, field=name in host.fields)
        for name, values in _point_data(mesh).items()
        if name in host.fields or moved.renumbered}
    if "texture_uvs" in mesh.vertex and result.feet is not None:
        data["texture_uvs"] = slid(_point_data(mesh)["texture_uvs"], host.cells, result.feet)
    for values, arrays in ((out.vertex, data | {"positions": result.points}),
                           (out.triangle, _triangle_data(result, host))):
        for name, array in arrays.items():
            tensor: Any = Tensor.from_numpy(np.ascontiguousarray(array)).clone()
            values[name] = tensor if mesh.is_cpu else tensor.to(mesh.device)
    _renew_normals(out, mesh)
    return out


def _point_data(mesh: Any) -> dict[str, NDArray[Any]]:
    """Attributes of the vertices of a tensor mesh but their places."""
    return {name: expect_one_each(f"vertex.{name}", np.array(values.cpu().numpy()),
                                  len(mesh.vertex["positions"]), "vertex", "vertices")
            for name, values in mesh.vertex.items() if name != "positions"}


def _triangle_data(result: Result, host: HostMesh) -> dict[str, NDArray[Any]]:
    data = {"indices": result.cells}
    for name, values in host.source.triangle.items():
        if name == "texture_uvs":
            data[name] = carried(host.layout, host.cells, result)
        elif name not in ("indices", "normals"):
            data[name] = result.carried(np.array(values.cpu().numpy()), name)
    return data


def _renew_normals(out: Any, mesh: Any) -> None:
    """Compute anew the normals that the caller's mesh has, in the dtype they have there.

    open3d warns of missing vertex normals when it computes those of the triangles.
    """
    from open3d.utility import VerbosityContextManager, VerbosityLevel

    with_faces, with_vertices = "normals" in mesh.triangle, "normals" in mesh.vertex
    for values, there in ((out.triangle, with_faces), (out.vertex, with_vertices)):
        if there:
            del values["normals"]
    with VerbosityContextManager(VerbosityLevel.Error):
        if with_vertices:
            out.compute_vertex_normals()
        elif with_faces:
            out.compute_triangle_normals()
    if with_vertices:
        out.vertex["normals"] = out.vertex["normals"].to(mesh.vertex["normals"].dtype)
    if with_faces:
        out.triangle["normals"] = out.triangle["normals"].to(mesh.triangle["normals"].dtype)
    elif "normals" in out.triangle:
        del out.triangle["normals"]


def _require(m: int, n: int, kind: str, what: str) -> None:
    if not m:
        msg = f"got a {kind} without {what} ({n} vertices); expected at least one"
        raise UnsupportedMeshError(msg)


def _wedges(values: Any, m: int, name: str) -> NDArray[Any]:
    uv = np.array(values)
    if len(uv) != 3 * m:
        msg = f"{name} has {len(uv)} entries for {m} triangles; expected three a triangle"
        raise InvalidMeshError(msg)
    return uv.reshape(m, 3, 2)
