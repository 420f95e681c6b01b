"""PLY files of MeshLab, the only way into it for a selection and for several textures."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.host import Result
from odt_plugins.adapters.wedges import carried, slid

SELECTED = 0x20
"""Bit of a selected vertex or face in the property `flags` of MeshLab's PLY files."""

WITHIN = 0x1C0000
"""Bits of the edges of a face that are within a polygon, in that property."""

VERTEX_SCALAR, FACE_SCALAR = "vertex scalar", "face scalar"
VERTEX_COLOUR = "vertex color"
"""Names of MeshLab's own scalars and colours among custom attributes."""

Columns = list[tuple[str, str, Any]]
"""Title in the header (none for the length of a list), numpy dtype and values of each column."""


def encode(
    mesh: Any,
    result: Result,
    textures: Iterable[str] = (),
    numbers: NDArray[np.int32] | None = None,
) -> bytes:
    """Binary PLY file of a mesh with new points and faces and the data that MeshLab reads.

    Parameters
    ----------
    mesh : pymeshlab.Mesh          whose data are carried
    result : Result                new points and faces
    textures : names               files of the textures, relative to that of the mesh
    numbers : (m,) int32 or None   place in `textures` of that of every old face
    """
    n, m, source = len(result.points), len(result.cells), result.source
    header = ["ply", "format binary_little_endian 1.0"]
    header += [f"comment TextureFile {name}" for name in textures]

    vertex: Columns = [
        (f"double {axis}", "<f8", column)
        for axis, column in zip("xyz", result.points.T, strict=True)
    ]
    def of_vertices(values: NDArray[Any], name: str = "", *, field: bool = False) -> NDArray[Any]:
        moved = result.vertices
        return values if moved is None else moved.carried(values, name, field=field)

    selected = of_vertices(np.asarray(mesh.vertex_selection_array()))
    vertex.append(("int flags", "<i4", SELECTED * selected))
    if mesh.has_vertex_color():
        vertex += _colours(of_vertices(in_bytes(mesh.vertex_color_matrix()), field=True))
    if mesh.has_vertex_scalar():
        scalars = of_vertices(mesh.vertex_scalar_array(), VERTEX_SCALAR, field=True)
        vertex.append(("double quality", "<f8", scalars))
    if mesh.has_vertex_tex_coord():
        uv = slid(mesh.vertex_tex_coord_matrix(), mesh.face_matrix(), result.feet)
        vertex += [("float texture_u", "<f4", uv[:, 0]), ("float texture_v", "<f4", uv[:, 1])]
    body = _element(header, "vertex", n, vertex)

    face: Columns = [
        ("", "u1", np.full(m, 3)),
        ("list uchar int vertex_indices", "(3,)<i4", result.cells),
        ("int flags", "<i4", SELECTED * mesh.face_selection_array()[source]),
    ]
    if mesh.has_wedge_tex_coord():
        uv = carried(mesh.wedge_tex_coord_matrix().reshape(-1, 3, 2), mesh.face_matrix(), result)
        face += [("", "u1", np.full(m, 6)),
                 ("list uchar float texcoord", "(6,)<f4", uv.reshape(-1, 6))]
        if numbers is not None:
            under = source if result.feet is None else result.feet.under
            face.append(("int texnumber", "<i4", numbers[under]))
    if mesh.has_face_color():
        face += _colours(in_bytes(mesh.face_color_matrix()[source]))
    if mesh.has_face_scalar():
        scalars = result.carried(mesh.face_scalar_array(), FACE_SCALAR)
        face.append(("double quality", "<f8", scalars))
    body += _element(header, "face", m, face)

    edges = mesh.edge_matrix()
    if result.vertices is not None and result.vertices.renumbered:
        edges = result.vertices.number[edges]
    if len(edges):
        ends = [(f"int vertex{i + 1}", "<i4", edges[:, i]) for i in (0, 1)]
        body += _element(header, "edge", len(edges), ends)
    return "\n".join([*header, "end_header", ""]).encode() + body


def texture_numbers(file: bytes, n: int, m: int) -> tuple[list[str], NDArray[np.int32]]:
    """Textures that MeshLab has written into a binary PLY file without any other data.

    Parameters
    ----------
    file : bytes     of vertex coordinates in double precision and wedge texture coordinates
    n, m : int       number of vertices and faces

    Returns
    -------
    names : list of str       files of the textures
    numbers : (m,) int32      place among them of that of every face
    """
    header, _, body = file.partition(b"end_header\n")
    mark = b"comment TextureFile "
    names = [line.removeprefix(mark).decode() for line in header.splitlines()
             if line.startswith(mark)]
    row = np.dtype([("vertices", "V13"), ("wedges", "V25"), ("number", "<i4")])
    rows = np.frombuffer(body, row, count=m, offset=24 * n)
    return names, rows["number"].astype(np.int32)


def in_polygons(file: bytes, n: int, m: int) -> bool:
    """Whether any edge is within a polygon of n vertices and m faces in a binary PLY file.

    Parameters
    ----------
    file : bytes     of vertex coordinates in double precision and flags of faces, by MeshLab
    n, m : int       number of vertices and faces
    """
    row = np.dtype([("vertices", "V13"), ("flags", "<i4")])
    rows = np.frombuffer(file.partition(b"end_header\n")[2], row, count=m, offset=24 * n)
    return bool((rows["flags"] & WITHIN).any())


def _element(header: list[str], name: str, count: int, columns: Columns) -> bytes:
    """Lay columns side by side in binary rows and name them in the header."""
    header.append(f"element {name} {count}")
    header += [f"property {title}" for title, _, _ in columns if title]
    rows = np.zeros(count, dtype=[(f"f{i}", kind) for i, (_, kind, _) in enumerate(columns)])
    for i, (_, _, values) in enumerate(columns):
        rows[f"f{i}"] = values
    return rows.tobytes()


def in_bytes(rgba: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Colours (k, 4) as MeshLab holds them, from its numbers up to 1."""
    return np.rint(rgba * 255.0).astype(np.uint8)


def _colours(rgba: NDArray[np.uint8]) -> Columns:
    names = ("red", "green", "blue", "alpha")
    return [(f"uchar {name}", "u1", column) for name, column in zip(names, rgba.T, strict=True)]
