"""MEDIT files of text, .mesh: what is required stays, and so do sections that nobody knows.

Solutions beside them, which may be metrics, are point arrays.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from odt_plugins.adapters.formats import medit_solution
from odt_plugins.adapters.formats.change import Change, NotRewritable
from odt_plugins.adapters.formats.decks import edited, unread
from odt_plugins.errors import MeshFileError

CELLS = {"Edges": ("line", 2), "Triangles": ("triangle", 3), "Quadrilaterals": ("quad", 4),
         "Tetrahedra": ("tetra", 4), "Prisms": ("wedge", 6), "Pyramids": ("pyramid", 5),
         "Hexahedra": ("hexahedron", 8), "Hexaedra": ("hexahedron", 8)}
"""Sections of cells: their type and number of corners."""

CODES = {"line": 5, "triangle": 6, "quad": 7, "tetra": 8, "wedge": 9, "hexahedron": 10,
         "pyramid": 49}
"""Keywords of sections of cells in binary files, by their type."""

VERTICES, END = 4, 54
"""Other keywords of binary files."""

MOST = 2**31 - 1
"""Largest number in binary files of version 2, and most bytes of one."""

REF = "medit:ref"
"""Array of the references of vertices and of cells."""

REQUIRED = "medit:required"
"""Set of the vertices that are required, or of a required edge, triangle or tetrahedron."""

AT_VERTICES = ("Corners", "RequiredVertices")
"""Sections of numbers of vertices."""

RIDGES = "Ridges"
"""Section of edges that are ridges, and so are those that they become."""

AT_CELLS = {RIDGES: "Edges"} | {f"Required{name}": name for name in CELLS}
"""Sections of numbers of cells, and the section of these."""

SCALARS = ("MeshVersionFormatted", "Dimension")


class _Section(NamedTuple):
    """A section: its name, its number of entries, and its words from `start` to `stop`.

    Attributes
    ----------
    name : str
    size : int          -1 of those that have one number only
    start, stop : int   words behind the number
    """

    name: str
    size: int
    start: int
    stop: int


def read(path: Path) -> Any:
    """Read vertices and cells with their references; coordinates in double precision.

    Returns
    -------
    meshio.Mesh      with a point set of what is required

    Raises
    ------
    MeshFileError    a section has fewer numbers than it says
    """
    import meshio

    if path.suffix.lower() == ".meshb":
        binary: Any = meshio.medit.read
        return _with_solutions(path, binary(path))
    words, sections = _parsed(path.read_bytes())
    texts = [word[0] for word in words]
    if not any(section.name == "Vertices" for section in sections):
        msg = "it ends before its vertices"
        raise MeshFileError(msg)
    dim = next((int(texts[s.start - 1]) for s in sections if s.name == "Dimension"), 0)
    points, refs = np.zeros((0, 3)), np.zeros(0, dtype=np.int64)
    blocks: list[Any] = []
    cell_refs: list[Any] = []
    rows: dict[str, Any] = {}
    for section in sections:
        if section.name == "Vertices":
            table = _table(texts, section, dim + 1)
            points, refs = table[:, :dim], table[:, dim].astype(np.int64)
        elif section.name in CELLS:
            kind, width = CELLS[section.name]
            table = _table(texts, section, width + 1).astype(np.int64)
            rows[section.name] = table[:, :width] - 1
            blocks.append((kind, table[:, :width] - 1))
            cell_refs.append(table[:, -1])
    required = [_table(texts, s, 1).astype(np.int64).ravel() - 1 for s in sections
                if s.name == "RequiredVertices"]
    for section in sections:
        of = section.name.removeprefix("Required")
        if of != section.name and of in rows:
            required.append(rows[of][_table(texts, section, 1).astype(np.int64).ravel() - 1])
    sets: dict[str, Any] = {}
    if required:
        sets[REQUIRED] = np.unique(np.concatenate([r.ravel() for r in required]))
    for _, cells in blocks:
        bad = cells[(cells < 0) | (cells >= len(points))]
        if bad.size:
            msg = f"a cell refers to vertex {bad[0] + 1} of {len(points)}"
            raise MeshFileError(msg)
    mesh = meshio.Mesh(points, blocks, {REF: refs}, {REF: cell_refs}, point_sets=sets, info=unread(
        "the sections", (s.name for s in sections if s.size > 0 and s.name not in (
            *CELLS, "Vertices"))))
    return _with_solutions(path, mesh)


def _with_solutions(path: Path, mesh: Any) -> Any:
    """The mesh with the solutions beside its file as point arrays."""
    mesh.point_data |= medit_solution.read(path, *mesh.points.shape)
    return mesh


def write(path: Path, mesh: Any, binary: bool | None = None) -> list[str]:
    """Write a mesh by meshio, and its solutions beside it."""
    import meshio

    bare = mesh.copy()
    bare.point_data = {name: values for name, values in mesh.point_data.items() if name == REF}
    packed = _packed(bare) if path.suffix.lower() == ".meshb" else None
    if packed is None:
        meshio.write(path, bare, file_format="medit")
    else:
        path.write_bytes(packed)
    medit_solution.write(path, mesh.points.shape[1], mesh.point_data)
    return []


def _packed(mesh: Any) -> bytes | None:
    """A binary file of version 2, as every tool reads it; None of what does not go into one.

    A section is its code, where the next one starts, its number of entries and these.
    """
    n, dim = mesh.points.shape
    refs = [mesh.point_data.get(REF, np.ones(n, dtype=np.int32)), *mesh.cell_data.get(
        REF, [np.ones(len(block.data), dtype=np.int32) for block in mesh.cells])]
    good = all(values.dtype.kind in "iu" and np.abs(values, dtype=np.float64).max(initial=0) <= MOST
               for values in refs)
    size = 8 * n * (dim + 1) + 4 * sum(block.data.size + len(block.data) for block in mesh.cells)
    if not good or size > MOST // 2 or {block.type for block in mesh.cells} - {*CODES}:
        return None
    rows = np.zeros(n, dtype=[("x", "<f8", (dim,)), ("ref", "<i4")])
    rows["x"], rows["ref"] = mesh.points, refs[0]
    sections: list[tuple[int, Any]] = [(VERTICES, rows)]
    for block, ref in zip(mesh.cells, refs[1:], strict=True):
        sections.append((CODES[block.type], np.column_stack([block.data + 1, ref]).astype("<i4")))
    parts = [struct.pack("<iiiii", 1, 2, 3, 20, dim)]
    at = 20
    for code, table in sections:
        at += 12 + table.nbytes
        parts += [struct.pack("<iii", code, at, len(table)), table.tobytes()]
    return b"".join([*parts, struct.pack("<ii", END, 0)])


def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Replace the places of vertices that moved, and the optimised cells with their references.

    Numbers of corners, of ridges and of what is required follow. Where vertices came or went,
    sections that are not known are left out.

    Raises
    ------
    NotRewritable    it is binary, or its cells of one kind are in several sections
    """
    if ".meshb" in (source.suffix.lower(), target.suffix.lower()):
        raise NotRewritable
    data = source.read_bytes()
    words, sections = _parsed(data)
    names = [section.name for section in sections if section.size]
    more = {*names} - {*CELLS, *SCALARS, *AT_VERTICES, *AT_CELLS, "Vertices"}
    more = more if change.renumbered else set()
    edits: list[tuple[int, int, bytes]] = []
    lost: list[str] = []
    block = 0
    for section in sections:
        if section.name in more:
            edits.append(_cut(data, words, section))
        if section.name in AT_VERTICES and section.size and change.renumbered:
            now = change.number[_numbers(words, section)]
            edits += _listed(data, words, section, now[now >= 0])
            lost += _gone(section, int((now < 0).sum()))
        if section.name == "Vertices" and change.renumbered:
            edits += _vertices(data, words, section, change)
        elif section.name == "Vertices":
            points = np.asarray(change.after.points)
            width = (section.stop - section.start) // max(section.size, 1)
            for v in np.flatnonzero(change.moved).tolist():
                for i, x in enumerate(points[v].tolist()):
                    _, start, stop = words[section.start + width * v + i]
                    edits.append((start, stop, repr(x).encode()))
        if section.name not in CELLS:
            continue
        rows, cells = change.cells[block], np.asarray(change.after.cells[block].data)
        fresh = change.exchanged(block)
        same = len(rows) == section.size and np.array_equal(rows, np.arange(section.size))
        if fresh.any() or not same or change.renumbered:
            told = [other for other in sections
                    if other.size > 0 and AT_CELLS.get(other.name) == section.name]
            if told and names.count(section.name) > 1:
                msg = f"it has several sections {section.name}, which were exchanged"
                raise NotRewritable(msg)
            for other in told:
                was = _numbers(words, other)
                stays = np.isin(rows, was) & ~(fresh & (other.name != RIDGES))
                edits += _listed(data, words, other, np.flatnonzero(stays))
                lost += _gone(other, (other.name != RIDGES) * len(np.setdiff1d(was, rows[stays])))
            edits += _cells(data, words, section, cells, np.asarray(
                change.after.cell_data[REF][block]), keep=same)
        block += 1
    target.write_bytes(edited(data, edits))
    medit_solution.write(target, np.shape(change.after.points)[1], change.after.point_data)
    if "Normals" in {*names} - more and change.moved[_with_normals(words, sections)].any():
        lost.append("the normals, which are those of before")
    return lost + ([f"the sections {', '.join(sorted(more))}"] if more else [])


def _numbers(words: list[tuple[bytes, int, int]], section: _Section) -> Any:
    """Vertices or cells (n,) that a section lists."""
    return np.array([int(word[0]) for word in words[section.start: section.stop]]) - 1


def _with_normals(words: list[tuple[bytes, int, int]], sections: list[_Section]) -> Any:
    """Vertices that have normals; all where it is others that have them."""
    at = [section for section in sections if section.name == "NormalAtVertices"]
    return _numbers(words, at[0])[::2] if at else slice(None)


def _listed(
    data: bytes, words: list[tuple[bytes, int, int]], section: _Section, now: Any
) -> list[tuple[int, int, bytes]]:
    """What replaces the numbers of vertices or cells in a section."""
    if np.array_equal(np.sort(now), np.sort(_numbers(words, section))):
        return []
    span = words[section.start: section.stop]
    end = b"\r\n" if b"\r\n" in data else b"\n"
    _, start, stop = words[section.start - 1]
    return [(start, stop, str(len(now)).encode()),
            (span[0][1], span[-1][2], end.join(str(i + 1).encode() for i in now.tolist()))]


def _gone(section: _Section, count: int) -> list[str]:
    """What is lost of a section whose vertices or cells went."""
    return [f"{count} of the {section.name}, which went"] if count else []


def _cut(
    data: bytes, words: list[tuple[bytes, int, int]], section: _Section
) -> tuple[int, int, bytes]:
    """What takes a section away."""
    stop = words[section.stop - 1][2]
    while data[stop: stop + 1] in (b"\r", b"\n"):
        stop += 1
    return words[section.start - 2][1], stop, b""


def _vertices(
    data: bytes, words: list[tuple[bytes, int, int]], section: _Section, change: Change
) -> list[tuple[int, int, bytes]]:
    """Edits for the section of vertices; vertices that did not move keep their text."""
    end = b"\r\n" if b"\r\n" in data else b"\n"
    span = words[section.start: section.stop]
    width = len(span) // section.size
    moved, points = change.moved.tolist(), np.asarray(change.after.points).tolist()
    refs = np.asarray(change.after.point_data[REF]).astype(np.int64).tolist()
    lines = []
    for i, v in enumerate(change.points.tolist()):
        if moved[i]:
            lines.append(" ".join([*map(repr, points[i]), str(refs[i])]).encode())
        else:
            lines.append(b" ".join(word[0] for word in span[width * v: width * (v + 1)]))
    _, start, stop = words[section.start - 1]
    return [(start, stop, str(len(lines)).encode()), (span[0][1], span[-1][2], end.join(lines))]


def _cells(
    data: bytes, words: list[tuple[bytes, int, int]], section: _Section, cells: Any, refs: Any, *,
    keep: bool,
) -> list[tuple[int, int, bytes]]:
    """What replaces the words of a section of cells; of as many cells only what differs."""
    table = np.column_stack([cells + 1, refs]).astype(np.int64)
    span = words[section.start: section.stop]
    if keep:
        flat = [str(x).encode() for x in table.ravel().tolist()]
        return [(start, stop, new) for (old, start, stop), new in zip(span, flat, strict=True)
                if old != new]
    end = b"\r\n" if b"\r\n" in data else b"\n"
    body = end.join(" ".join(map(str, row)).encode() for row in table.tolist())
    _, start, stop = words[section.start - 1]
    return [(start, stop, str(len(table)).encode()), (span[0][1], span[-1][2], body)]


def _parsed(data: bytes) -> tuple[list[tuple[bytes, int, int]], list[_Section]]:
    """Words of a file with where they start and stop, comments left out, and its sections."""
    words = [(found[0], *found.span()) for found in re.finditer(rb"#[^\r\n]*|[^\s#]+", data)
             if not found[0].startswith(b"#")]
    heads = [i for i, word in enumerate(words) if word[0][:1].isalpha()]
    sections = []
    for i, stop in zip(heads, [*heads[1:], len(words)], strict=True):
        name = words[i][0].decode("ascii", "replace")
        if i + 1 >= stop:
            continue
        try:
            size = int(words[i + 1][0])
        except ValueError as exc:
            msg = f"{name} does not say how many it has"
            raise MeshFileError(msg) from exc
        sections.append(_Section(name, -1 if name in SCALARS else size, i + 2, stop))
    return words, sections


def _table(texts: list[bytes], section: _Section, width: int) -> Any:
    """Numbers (n, width) of a section."""
    found = texts[section.start: section.stop]
    if len(found) != section.size * width:
        msg = (f"it ends within {section.name}, which has {len(found)} numbers of "
               f"{section.size * width}")
        raise MeshFileError(msg)
    plain = [word.replace(b"D", b"e").replace(b"d", b"e") for word in found]
    return np.array(plain, dtype=np.bytes_).astype(np.float64).reshape(-1, width)
