"""PLY files, of text or binary: every element and property stays, of any number and name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.change import Change, NotRewritable
from odt_plugins.adapters.formats.ply_tables import (
    TYPES,
    Element,
    Property,
    Table,
    changed_header,
    decoded,
    encoded,
    header,
    parsed,
)
from odt_plugins.adapters.formats.polygons import as_mesh
from odt_plugins.errors import MeshFileError

PLACE, NORMAL = ("x", "y", "z"), ("nx", "ny", "nz")
CORNERS, ENDS = ("vertex_indices", "vertex_index"), ("vertex1", "vertex2")
"""Names of the properties that are no arrays."""

NORMALS = "Normals"
"""Array of the normals of vertices or of faces."""

TEXTURE = "texcoord"
"""Array of the texture coordinates of the corners of faces."""

COLOURS = ("red", "green", "blue", "alpha")

WIDE = 2**31
"""Least number that is no integer of four bytes, the widest that PLY has."""


def read(path: Path) -> Any:
    """Read vertices, faces and edges with all their properties.

    Returns
    -------
    meshio.Mesh      faces of three corners first; edges are lines

    Raises
    ------
    MeshFileError    the file ends too early, or says something that PLY does not know
    """
    from meshio import CellBlock

    data = path.read_bytes()
    kind, elements, start = parsed(data)
    tables, _ = decoded(data, kind, elements, start)
    vertex = tables.get("vertex")
    if vertex is None or any(name not in vertex for name in PLACE):
        msg = "it has no vertices with x, y and z"
        raise MeshFileError(msg)
    points = np.stack([vertex[name] for name in PLACE], axis=1)
    face = tables.get("face", {})
    corners = face.get(_corners(face), np.zeros((0, 3), dtype=np.int64))
    mesh, order = as_mesh(points, corners)
    mesh.point_data = _arrays(vertex, PLACE)
    mesh.cell_data = {name: [values[rows] for rows in order]
                      for name, values in _arrays(face, CORNERS).items() if order}
    edge = tables.get("edge", {})
    if all(name in edge for name in ENDS) and len(edge[ENDS[0]]):
        mesh.cells.append(CellBlock("line", np.stack([edge[n] for n in ENDS], 1).astype(np.int64)))
        for name, values in mesh.cell_data.items():
            empty = np.zeros((len(edge[ENDS[0]]), *values[0].shape[1:]), values[0].dtype)
            values.append(np.asarray(edge[name]) if name in edge else empty)
    return mesh


def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Replace places, normals, changed triangles and arrays; all else stays as it is."""
    data = source.read_bytes()
    kind, elements, start = parsed(data)
    tables, spans = decoded(data, kind, elements, start)
    if change.renumbered:
        return _with_others(data, target, change)
    triangle = [i for i, block in enumerate(change.after.cells) if block.type == "triangle"]
    face = tables["face"]
    _, order = as_mesh(np.asarray(change.before.points), face[_corners(face)])
    rows = np.arange(len(face[_corners(face)]))
    for i in triangle:
        if len(change.cells[i]) != len(order[i]):
            msg = "triangles came or went"
            raise NotRewritable(msg)
        rows[order[i]] = order[i][change.cells[i]]
    new = {name: _taken(values, rows) for name, values in face.items()}
    corners = new[_corners(face)]
    for i in triangle:
        cells = np.asarray(change.after.cells[i].data)
        if isinstance(corners, list):
            for row, cell in zip(order[i].tolist(), cells, strict=True):
                corners[row] = cell
        else:
            corners[order[i]] = cells
        _put(new, {name: values[i] for name, values in change.after.cell_data.items()}, order[i])
    points = np.asarray(change.after.points)
    same = np.arange(len(points))
    vertex = {name: _taken(values, same) for name, values in tables["vertex"].items()}
    _put(vertex, dict(zip(PLACE, points.T, strict=False)), same)
    _put(vertex, change.after.point_data, same)
    replaced = {"vertex": (vertex, same), "face": (new, rows)}
    pieces = [data[:start]]
    for element in elements:
        span = data[slice(*spans[element.name])]
        if element.name in replaced:
            table, of = replaced[element.name]
            span = encoded(kind, element, table, tables[element.name], of, span)
        pieces.append(span)
    target.write_bytes(b"".join([*pieces, data[spans[elements[-1].name][1]:]]))
    return []


def _with_others(data: bytes, target: Path, change: Change) -> list[str]:
    """Write rows of other vertices and faces; what else names such rows is lost.

    Returns
    -------
    list of str    what is lost
    """
    kind, elements, start = parsed(data)
    tables, spans = decoded(data, kind, elements, start)
    after, face = change.after, tables["face"]
    _, order = as_mesh(np.asarray(change.before.points), face[_corners(face)])
    parts = {"vertex": [change.points],
             "face": [rows[of] for rows, of in zip(order, change.cells, strict=False)]}
    blocks = {"face": [np.asarray(block.data) for block in after.cells[: len(order)]]}
    arrays = {"vertex": dict(zip(PLACE, np.asarray(after.points).T, strict=False)) | {
                  name: np.asarray(values) for name, values in after.point_data.items()},
              "face": {name: np.concatenate(values[: len(order)])
                       for name, values in after.cell_data.items()}}
    if len(after.cells) > len(order):
        parts["edge"], ends = [change.cells[-1]], np.asarray(after.cells[-1].data)
        arrays["edge"] = {name: values[-1] for name, values in after.cell_data.items()}
        arrays["edge"] |= dict(zip(ENDS, ends.T, strict=True))
    lost, kept, pieces = [], [], []
    for element in elements:
        name, was = element.name, data[slice(*spans[element.name])]
        if name not in parts:
            if element.size and any(_names_rows(p) for p in element.properties):
                lost.append(f"the element {name!r}, which names vertices or faces of before")
                continue
            kept.append(element)
            pieces.append(was)
            continue
        rows = np.concatenate(parts[name])
        old = tables[name]
        table = {key: _taken(values, rows) for key, values in old.items()}
        _put(table, arrays[name], slice(None))
        if name in blocks:
            corners: Any = [row for block in blocks[name] for row in block]
            table[_corners(old)] = np.array(corners) if len(
                {len(row) for row in corners}) == 1 else corners
        gone = [p.name for p in element.properties if _stale(
            p.name, old[p.name], arrays[name], fresh=bool((rows < 0).any()))]
        lost += [f"the property {key!r} of the element {name!r}" for key in gone]
        now = Element(name, len(rows), tuple(
            _wide_enough(p, table[p.name]) for p in element.properties if p.name not in gone))
        kept.append(now)
        pieces.append(encoded(kind, now, table) if gone else
                      encoded(kind, now, table, old, rows, was))
    head = changed_header(data[:start], kept)
    target.write_bytes(b"".join([head, *pieces, data[spans[elements[-1].name][1]:]]))
    return lost


def _names_rows(of: Property) -> bool:
    """Whether a property holds numbers of vertices or faces, by its name and type."""
    return TYPES[of.type][0] in "iu" and any(word in of.name for word in ("vert", "face"))


def _stale(name: str, values: Any, arrays: dict[str, Any], *, fresh: bool) -> bool:
    """Whether a property says nothing of rows that are new, or is texture of other corners."""
    if name == TEXTURE:
        return name not in arrays
    known = name in arrays or (name in NORMAL and NORMALS in arrays)
    return fresh and (isinstance(values, list) or not known)


def _wide_enough(of: Property, values: Any) -> Property:
    """A property of rows' numbers, in a type that holds them."""
    if not _names_rows(of) or not len(values):
        return of
    greatest = max(int(row.max(initial=0)) for row in values)
    return of if greatest <= np.iinfo(TYPES[of.type]).max else of._replace(type="int")


def write(path: Path, mesh: Any, binary: bool | None) -> list[str]:
    """Write a mesh: faces with their arrays, lines as edges, colours of bytes as such."""
    lost: list[str] = []
    points = np.zeros((len(mesh.points), 3), dtype=np.asarray(mesh.points).dtype)
    points[:, : np.shape(mesh.points)[1]] = mesh.points
    vertex: Table = dict(zip(PLACE, points.T, strict=True))
    vertex |= _columns(mesh.point_data, "point data", lost)
    flat = [i for i, block in enumerate(mesh.cells)
            if block.type in ("triangle", "quad", "polygon") and len(block.data)]
    ends = [np.asarray(block.data) for block in mesh.cells if block.type == "line"]
    lost += sorted({f"cells of type {block.type}" for i, block in enumerate(mesh.cells)
                    if i not in flat and block.type != "line" and len(block.data)})
    blocks = [np.asarray(mesh.cells[i].data) for i in flat]
    corners: Any = [row for block in blocks for row in block]
    if len({block.shape[1] for block in blocks}) == 1:
        corners = np.concatenate(blocks)
    arrays = {name: np.concatenate([np.asarray(values[i]) for i in flat])
              for name, values in mesh.cell_data.items() if flat}
    face: Table = {CORNERS[0]: corners} | _columns(arrays, "cell data", lost)
    tables = {"vertex": vertex, "face": face}
    if ends:
        tables["edge"] = dict(zip(ENDS, np.concatenate(ends).T, strict=True))
    elements = [Element(name, len(next(iter(table.values()))), tuple(
        Property(key, _type(np.concatenate(values) if isinstance(values, list) else values),
                 "uchar" if isinstance(values, list) or values.ndim > 1 else None)
        for key, values in table.items())) for name, table in tables.items()]
    kind = "ascii" if binary is False else "binary_little_endian"
    body = [encoded(kind, element, tables[element.name]) for element in elements]
    path.write_bytes(b"".join([header(kind, elements), *body]))
    return lost


def _corners(face: Table) -> str:
    return next((name for name in CORNERS if name in face), CORNERS[0])


def _arrays(table: Table, but: tuple[str, ...]) -> dict[str, NDArray[Any]]:
    """Properties as arrays: the normal as one, lists that are all as long as rows."""
    out = {name: values for name, values in table.items()
           if name not in but and not isinstance(values, list)}
    if all(name in out for name in NORMAL):
        normal = np.stack([out.pop(name) for name in NORMAL], axis=1)
        out[NORMALS] = normal
    return out


def _columns(arrays: dict[str, Any], what: str, lost: list[str]) -> Table:
    """Arrays as properties: vectors of three are normals, and colours where they are bytes."""
    out: Table = {}
    for name, given in arrays.items():
        values = np.asarray(given)
        width = values.shape[1] if values.ndim == 2 else 0
        if values.ndim == 1 and values.dtype.kind in "biuf":
            out[name.replace(" ", "_")] = values
        elif name == NORMALS and width == 3:
            out |= dict(zip(NORMAL, values.T, strict=True))
        elif values.dtype == np.uint8 and width in (3, 4) and COLOURS[0] not in arrays:
            out |= dict(zip(COLOURS, values.T, strict=False))
        elif name == TEXTURE and width == 6:
            out[name] = values
        else:
            lost.append(f"{what} {name!r}")
    return out


def _type(values: NDArray[Any]) -> str:
    """Name in PLY of the type that holds the values of an array; most readers know no wider one."""
    kind, size = values.dtype.kind, values.dtype.itemsize
    if kind in "iu" and size == 8 and values.size and (
            -WIDE <= values.min() and values.max() < WIDE):
        return "int"
    if kind == "f":
        return "float" if size <= 4 else "double"
    if kind == "b" or values.dtype == np.uint8:
        return "uchar"
    found = {(dtype[0], int(dtype[1])): name for name, dtype in reversed(TYPES.items())}
    return found.get((kind, size), "int")


def _taken(values: Any, rows: NDArray[Any]) -> Any:
    if isinstance(values, list):
        return [values[i] for i in rows.tolist()]
    return values[rows].copy()


def _put(table: Table, arrays: dict[str, Any], rows: Any) -> None:
    """Write arrays into the properties of the same names, in their types."""
    for name, given in arrays.items():
        values = np.asarray(given)
        names = NORMAL if name == NORMALS else (name,)
        for i, key in enumerate(names):
            own = table.get(key)
            part = values[:, i] if len(names) > 1 else values
            if isinstance(own, np.ndarray) and own[rows].shape == part.shape:
                own[rows] = part.astype(own.dtype)
