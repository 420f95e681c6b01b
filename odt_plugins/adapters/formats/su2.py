"""SU2's meshes: markers with their names, and all else of the file, stay as they are."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from odt_plugins.adapters.formats.change import Change, NotRewritable
from odt_plugins.adapters.formats.decks import (
    REMARKS,
    Edit,
    Row,
    as_lines,
    edited,
    expect_points,
    numbers,
    real,
    rows_of,
    unread,
)
from odt_plugins.adapters.formats.titles import CONTROL, decoded, written
from odt_plugins.errors import MeshFileError, UnsupportedMeshError

TYPES = {1: ("vertex", 1), 3: ("line", 2), 5: ("triangle", 3), 9: ("quad", 4), 10: ("tetra", 4),
         12: ("hexahedron", 8), 13: ("wedge", 6), 14: ("pyramid", 5)}
"""Types of cells and their numbers of points, by those that files have."""

TAG = "su2:tag"
"""Array of the numbers of markers, 0 of cells."""


KNOWN = ("NDIME", "NELEM", "NPOIN", "NMARK", "MARKER_TAG", "MARKER_ELEMS", "NZONE", "IZONE")
"""Words that tell of the mesh; others, such as NPERIODIC, tell of more."""

CHUNK = 8192
"""Bytes behind which meshio takes points from a wrong place, in files with other ends of lines."""


class Section(NamedTuple):
    """Rows behind a keyword: its name, its line, the marker before it, and the rows."""

    name: str
    head: Row
    marker: str
    rows: list[Row]


class Parts(NamedTuple):
    """A file, read: dimension, sections of points and cells, and the place of every row.

    Attributes
    ----------
    dim : int
    points : Section
    cells : list of Section
    blocks : list                type of every block, and its rows as (section, row)
    remarks : list of str
    others : list of str         words besides KNOWN
    """

    dim: int
    points: Section
    cells: list[Section]
    blocks: list[tuple[str, list[tuple[int, int]]]]
    remarks: list[str]
    others: list[str]


class _Pair(tuple):  # type: ignore[type-arg]
    """Type and nodes of a block, as meshio's writer takes them apart."""

    type = property(lambda self: self[0])
    data = property(lambda self: self[1])

    def __len__(self) -> int:
        return len(self[1])


def read(path: Path) -> Any:
    """Read a file of one zone.

    Returns
    -------
    meshio.Mesh      a block a type of cells, then one a type of those of markers, whose names are
                     cell sets and whose numbers are `su2:tag`

    Raises
    ------
    MeshFileError    it has several zones, or fewer rows than it says
    """
    from meshio import Mesh

    parts = _parsed(path.read_bytes())
    points = np.array([numbers(row.words[: parts.dim]) for row in parts.points.rows])
    points = points.reshape(-1, parts.dim)
    cells: list[Any] = []
    tags: list[Any] = []
    names = list(dict.fromkeys(s.marker for s in parts.cells if s.name == "MARKER_ELEMS"))
    number = _numbers(names)
    sets: dict[str, list[Any]] = {name: [] for name in names}
    for kind, own in parts.blocks:
        width = next(size for name, size in TYPES.values() if name == kind)
        rows = np.array([[int(w) for w in parts.cells[s].rows[r].words[1: width + 1]]
                         for s, r in own], dtype=np.int64).reshape(-1, width)
        expect_points(rows, len(points))
        markers = np.array([parts.cells[s].marker for s, _ in own])
        cells.append((kind, rows))
        tags.append(np.array([number.get(name, 0) for name in markers.tolist()], dtype=np.int64))
        for name in names:
            sets[name].append(np.flatnonzero(markers == name))
    mesh = Mesh(points, cells, cell_data={TAG: tags}, cell_sets=sets)
    mesh.info = unread("what is said by", parts.others)
    setattr(mesh, REMARKS, parts.remarks)
    return mesh


def write(path: Path, mesh: Any, binary: bool | None) -> list[str]:
    """Write a mesh by meshio, with markers called as groups of their numbers are.

    SU2 takes no blanks in names, and remarks start with a percent sign.
    """
    import meshio

    del binary
    mesh = _as_written(mesh)
    meshio.write(path, mesh, file_format="su2")
    dim = mesh.points.shape[1]
    given = {name: int(value[0]) for name, value in mesh.field_data.items()
             if value[1] == dim - 1 and name.replace("%", " ").strip()}
    titles = written(given, f"[%\\s]+|{CONTROL}")
    names = {number: titles[name] for name, number in given.items()}
    data = path.read_text(encoding="utf-8")
    data = re.sub(r"(?m)^(MARKER_TAG= )(-?\d+)$",
                  lambda tag: tag[1] + names.get(int(tag[2]), tag[2]), data)
    path.write_text(data, encoding="utf-8", newline="\n")
    return []


def _as_written(mesh: Any) -> Any:
    """A mesh whose points and blocks have the form in which meshio's writer uses them."""
    mesh = mesh.copy()
    flat = mesh.points.shape[1] == 3 and not mesh.points[:, 2].any()
    solid = any(block.dim == 3 for block in mesh.cells)
    if mesh.points.shape[1] == 3 and not flat and not solid:
        msg = "it holds no triangles in space, only those of the plane z = 0"
        raise UnsupportedMeshError(msg)
    if flat and not solid:
        mesh.points = mesh.points[:, :2]
    mesh.cells = [_Pair((block.type, block.data)) for block in mesh.cells]
    return mesh


def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Replace points that moved, came or went, and the rows of cells that have other points.

    Raises
    ------
    NotRewritable    points came or went, and the file tells that some belong to other parts
    """
    data = source.read_bytes()
    parts = _parsed(data)
    places: Any = np.asarray(change.after.points).tolist()
    edits: list[Edit] = [
        as_lines(data, parts.points.rows[v], [dict(enumerate(map(real, places[v])))])
        for v in np.flatnonzero(change.moved).tolist()] if not change.renumbered else _points(
            data, parts, change)
    words: dict[tuple[int, int], list[dict[int, Any]]] = {}
    for b, (_, own) in enumerate(parts.blocks):
        fresh, rows = change.exchanged(b), change.cells[b]
        same = np.array_equal(rows, np.arange(len(own)))
        if not (change.renumbered or fresh.any()) and same:
            continue
        words |= {place: [] for place in own}
        after: Any = np.asarray(change.after.cells[b].data).tolist()
        for i, r in enumerate(rows.tolist()):
            words[own[r]].append(dict(enumerate(after[i], 1)))
    for s, section in enumerate(parts.cells):
        count = 0
        for r, row in enumerate(section.rows):
            lines = words.get((s, r), [{}])
            size = TYPES[int(row.words[0])][1]
            for line in lines:
                if len(row.words) > size + 1 and count != r:
                    line[size + 1] = count
                count += 1
            edit = as_lines(data, row, lines)
            if edit[2] != data[row.start: row.stop]:
                edits.append(edit)
        if count != len(section.rows):
            edits.append(_counted(data, section.head, count))
    out = edited(data, edits)
    lost = []
    if b"\r" in out and parts.points.head.stop > CHUNK:
        out = out.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        lost.append("ends of lines other than plain ones, with which meshio misreads points that "
                    "stand behind cells")
    target.write_bytes(out)
    return lost


def _points(data: bytes, parts: Parts, change: Change) -> list[Edit]:
    """What replaces points of which some came or went."""
    section = parts.points
    if len(data[section.head.start: section.head.stop].partition(b"=")[2].split()) > 1:
        msg = "points came or went, and it tells how many are of other parts"
        raise NotRewritable(msg)
    places: Any = np.asarray(change.after.points).tolist()
    moved, lines = change.moved, []
    for v, (r, place) in enumerate(zip(change.points.tolist(), places, strict=True)):
        row = section.rows[r]
        words: dict[int, Any] = dict(enumerate(map(real, place))) if moved[v] else {}
        if len(row.words) > parts.dim:
            words[parts.dim] = v
        line = as_lines(data, row, [words])[2]
        lines.append(line if line.endswith((b"\n", b"\r")) else line + b"\n")
    return [(section.rows[0].start, section.rows[-1].stop, b"".join(lines)),
            _counted(data, section.head, len(lines))]


def _counted(data: bytes, head: Row, count: int) -> Edit:
    """The line of a keyword with another number of rows."""
    key, _, rest = data[head.start: head.stop].partition(b"=")
    return head.start, head.stop, key + b"=" + rest.replace(rest.split()[0], str(count).encode(), 1)


def _numbers(names: list[str]) -> dict[str, int]:
    """Number markers: a name that is a number is its own, any other follows the one before."""
    out: dict[str, int] = {}
    last = 0
    for name in names:
        last = int(name) if name.lstrip("-").isdigit() else last + 1
        out[name] = last
    return out


def _parsed(data: bytes) -> Parts:
    dim, marker, most = 0, "", -1
    sections: list[Section] = []
    remarks: list[str] = []
    stated: list[int] = []
    others: list[str] = []
    for row in rows_of(data, b"%"):
        text = decoded(data[row.start: row.stop].partition(b"%")[0])
        if "=" not in text:
            if sections and len(sections[-1].rows) < stated[-1]:
                sections[-1].rows.append(row)
            elif not (row.words[0].lstrip(b"-").isdigit() or len(row.words) > 1):
                remarks.append(f"could not parse line {' '.join(text.split())}")
            continue
        name, _, value = text.partition("=")
        name, value = name.strip().upper(), value.strip()
        others += [name] if name not in KNOWN else []
        if name in ("NPOIN", "NELEM", "MARKER_ELEMS"):
            sections.append(Section(name, row, marker if name[0] == "M" else "", []))
            stated.append(int(value.split()[0]))
        elif name == "NDIME":
            dim = int(value)
        elif name == "NMARK":
            most = int(value)
        elif name == "MARKER_TAG":
            marker = value
        elif name == "NZONE" and int(value) > 1:
            msg = f"it has {value} zones, expected one, try a file for each zone"
            raise MeshFileError(msg)
    points = [s for s in sections if s.name == "NPOIN"]
    markers = sum(s.name == "MARKER_ELEMS" for s in sections)
    if most not in (-1, markers):
        msg = f"it declares {most} markers and holds {markers}"
        raise MeshFileError(msg)
    if dim not in (2, 3) or len(points) != 1:
        msg = f"it ends before its points, or has NDIME= {dim}"
        raise MeshFileError(msg)
    for section, count in zip(sections, stated, strict=True):
        if len(section.rows) != count or any(len(r.words) < dim for r in points[0].rows):
            msg = f"it declares {count} rows of {section.name} and holds {len(section.rows)}"
            raise MeshFileError(msg)
    cells = [s for s in sections if s.name != "NPOIN"]
    found: dict[tuple[bool, str], list[tuple[int, int]]] = {}
    for s, section in enumerate(cells):
        for r, row in enumerate(section.rows):
            kind, size = TYPES.get(int(row.words[0]), ("", -1))
            if size < 0:
                msg = f"it has cells of type {int(row.words[0])}, which is not known"
                raise MeshFileError(msg)
            if len(row.words) <= size:
                msg = f"a row of {section.name} ends before its {size} points"
                raise MeshFileError(msg)
            found.setdefault((section.name != "NELEM", kind), []).append((s, r))
    order = {kind: k for k, (kind, _) in enumerate(TYPES.values())}
    blocks = sorted(found.items(), key=lambda item: (item[0][0], order[item[0][1]]))
    return Parts(dim, points[0], cells, [(kind, own) for (_, kind), own in blocks], remarks,
                 others)
