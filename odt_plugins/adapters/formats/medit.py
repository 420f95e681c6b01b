"""MEDIT files of text, .mesh: what is required stays, and so do sections that nobody knows.

Solutions beside them, which may be metrics, are point arrays.
"""

from __future__ import annotations

import re
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

REF = "medit:ref"
"""Array of the references of vertices and of cells."""

REQUIRED = "medit:required"
"""Set of the vertices that are required, or of a required edge, triangle or tetrahedron."""

AT_VERTICES = ("Corners", "RequiredVertices")
"""Sections of numbers of vertices."""

AT_CELLS = {"Ridges": "Edges"} | {f"Required{name}": name for name in CELLS}
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
    mesh.point_data |= medit_solution.read(path, len(mesh.points))
    return mesh


def write(path: Path, mesh: Any, binary: bool | None = None) -> list[str]:
    """Write a mesh by meshio, and its solutions beside it."""
    import meshio

    bare = mesh.copy()
    bare.point_data = {name: values for name, values in mesh.point_data.items() if name == REF}
    meshio.write(path, bare, file_format="medit")
    medit_solution.write(path, mesh.points.shape[1], mesh.point_data)
    return []


def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Replace the places of vertices that moved, and the optimised cells with their references.

    Raises
    ------
    NotRewritable    it is binary, what sections refer to was exchanged or went, or vertices came or
                     went and it has sections that are not known
    """
    if ".meshb" in (source.suffix.lower(), target.suffix.lower()):
        raise NotRewritable
    data = source.read_bytes()
    words, sections = _parsed(data)
    names = {section.name for section in sections if section.size}
    more = names - {*CELLS, *SCALARS, *AT_VERTICES, *AT_CELLS, "Vertices"}
    if change.renumbered and more:
        msg = f"vertices came or went, and it has {', '.join(sorted(more))}"
        raise NotRewritable(msg)
    edits: list[tuple[int, int, bytes]] = []
    block = 0
    for section in sections:
        if section.name in AT_VERTICES and change.renumbered:
            edits += _numbers(words, section, change)
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
            told = sorted(name for name in names if AT_CELLS.get(name) == section.name)
            if told and not same:
                msg = f"{section.name.lower()} were exchanged, and it has {', '.join(told)}"
                raise NotRewritable(msg)
            edits += _cells(data, words, section, cells, np.asarray(
                change.after.cell_data[REF][block]), keep=same)
        block += 1
    target.write_bytes(edited(data, edits))
    medit_solution.write(target, np.shape(change.after.points)[1], change.after.point_data)
    stale = "Normals" in names and bool(change.moved.any())
    return ["the normals, which are those of before"] if stale else []


def _numbers(
    words: list[tuple[bytes, int, int]], section: _Section, change: Change
) -> list[tuple[int, int, bytes]]:
    """What replaces numbers of vertices.

    Raises
    ------
    NotRewritable    one of them went
    """
    edits, number = [], change.number
    for word, start, stop in words[section.start: section.stop]:
        v = int(number[int(word) - 1])
        if v < 0:
            msg = f"a vertex of {section.name} went"
            raise NotRewritable(msg)
        edits.append((start, stop, str(v + 1).encode()))
    return edits


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
