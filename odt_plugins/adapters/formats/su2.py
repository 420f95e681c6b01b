"""Files of SU2: markers keep their names, and all but places and exchanged cells stays as it is."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from odt_plugins.adapters.formats.change import Change, NotRewritable
from odt_plugins.errors import MeshFileError

TYPES = {3: ("line", 2), 5: ("triangle", 3), 9: ("quad", 4), 10: ("tetra", 4),
         12: ("hexahedron", 8), 13: ("wedge", 6), 14: ("pyramid", 5)}
"""Types of cells by their numbers, and numbers of nodes."""

TAG = "su2:tag"
"""Array of the numbers of markers, 0 of the cells of the volume."""


class _Part(NamedTuple):
    """Points, cells or the cells of a marker: what their number is, and where their lines are.

    Attributes
    ----------
    name : str              NPOIN, NELEM or MARKER_ELEMS
    tag : str               of the marker, empty for others
    at : (int, int)         where the number of lines stands
    lines : list of (int, int)
    """

    name: str
    tag: str
    at: tuple[int, int]
    lines: list[tuple[int, int]]


def read(path: Path) -> Any:
    """Read points and cells; those of each marker with a name are a cell set.

    Returns
    -------
    meshio.Mesh      blocks of the cells by type, and of those of all markers by type

    Raises
    ------
    MeshFileError    it has fewer lines than it says, or cells of an unknown type
    """
    from meshio import Mesh

    data = path.read_bytes()
    dim, parts = _parsed(data)
    points = np.zeros((0, dim))
    names: list[str] = []
    numbers: list[int] = []
    blocks: dict[tuple[bool, str], list[Any]] = {}
    for part in parts:
        if part.name == "NPOIN":
            rows = [data[start:stop].split()[:dim] for start, stop in part.lines]
            points = np.array([[float(re.sub(rb"[dD]", b"e", word)) for word in row]
                               for row in rows]).reshape(-1, dim)
            continue
        mark = 0
        if part.name == "MARKER_ELEMS":
            whole = re.fullmatch(r"[+-]?\d+", part.tag)
            mark = int(part.tag) if whole else max([0, *numbers]) + 1
            numbers.append(mark)
            names.append("" if whole else part.tag)
        for kind, nodes in _cells(data, part):
            blocks.setdefault((part.name != "NELEM", kind), []).append((nodes, mark))
    cells: list[Any] = [(kind, np.array([row for row, _ in rows], dtype=np.int64))
             for (_, kind), rows in blocks.items()]
    for kind, own in cells:
        bad = own[(own < 0) | (own >= len(points))]
        if bad.size:
            msg = f"a {kind} refers to point {bad[0]} of {len(points)}"
            raise MeshFileError(msg)
    tags = [np.array([mark for _, mark in rows], dtype=np.int32) for rows in blocks.values()]
    sets: Any = {
        name: [np.flatnonzero((own == mark) & of_markers) for own, (of_markers, _) in
               zip(tags, blocks, strict=True)]
        for name, mark in zip(names, numbers, strict=True) if name}
    arrays: Any = {TAG: tags}
    return Mesh(points, cells, cell_data=arrays, cell_sets=sets)


def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Replace the coordinates of points that moved, and the lines of cells that were exchanged.

    Raises
    ------
    NotRewritable    points came or went, or the markers are other ones
    """
    before, after = change.before, change.after
    if change.renumbered:
        msg = "points came or went, to which other sections may refer"
        raise NotRewritable(msg)
    same = set(before.cell_sets) == set(after.cell_sets) and TAG in after.cell_data and all(
        np.array_equal(old[rows], new) for old, rows, new in
        zip(before.cell_data[TAG], change.cells, after.cell_data[TAG], strict=True))
    if not same:
        msg = "its markers are other ones than those of the file"
        raise NotRewritable(msg)
    data = source.read_bytes()
    dim, parts = _parsed(data)
    edits: list[tuple[int, int, bytes]] = []
    moved, points = change.moved, np.asarray(after.points)
    place: dict[tuple[bool, str], int] = {}
    homes: dict[tuple[bool, str], int] = {}
    for part in parts:
        if part.name == "NPOIN":
            for v in np.flatnonzero(moved).tolist():
                words = re.compile(rb"\S+").finditer(data, *part.lines[v])
                edits += [(*next(words).span(), repr(x).encode())
                          for x in points[v, :dim].tolist()]
            continue
        lines = []
        for (start, stop), (kind, _) in zip(part.lines, _cells(data, part), strict=True):
            key = (part.name != "NELEM", kind)
            i = homes.setdefault(key, len(homes))
            row = place.get(key, 0)
            place[key] = row + 1
            lines.append((data[start:stop], i, row))
        edits += _exchanged(data, part, lines, change)
    out, at = [], 0
    for start, stop, text in sorted(edits):
        out += [data[at:start], text]
        at = stop
    target.write_bytes(b"".join([*out, data[at:]]))
    return []


def _exchanged(
    data: bytes, part: _Part, lines: list[tuple[bytes, int, int]], change: Change
) -> list[tuple[int, int, bytes]]:
    """What replaces the lines of a part: every line is followed by those that come from it.

    Lines that end with their number get new ones.
    """
    blocks = sorted({i for _, i, _ in lines})
    whole = {i: np.array_equal(change.cells[i], np.arange(len(change.before.cells[i].data)))
             and not change.exchanged(i).any() for i in blocks}
    if all(whole.values()):
        return []
    order = {i: np.argsort(change.cells[i], kind="stable") for i in blocks}
    ranked = {i: change.cells[i][order[i]] for i in blocks}
    fresh = {i: change.exchanged(i) for i in blocks}
    out: list[bytes] = []
    numbered = all(line.split()[-1] == str(k).encode() for k, (line, _, _) in enumerate(lines))
    for line, i, row in lines:
        words, cells = line.split(), np.asarray(change.after.cells[i].data)
        low, high = np.searchsorted(ranked[i], [row, row + 1]).tolist()
        for k in order[i][low:high].tolist():
            nodes = [str(v).encode() for v in cells[k].tolist()]
            text = b" ".join([words[0], *nodes, *words[1 + len(nodes):]]) if fresh[i][k] else line
            if numbered and text.split()[-1] != str(len(out)).encode():
                text = re.sub(rb"\S+\Z", str(len(out)).encode(), text)
            out.append(text)
    end = b"\r\n" if b"\r\n" in data else b"\n"
    return [(*part.at, str(len(out)).encode()),
            (part.lines[0][0], part.lines[-1][1], end.join(out))]


def _cells(data: bytes, part: _Part) -> list[tuple[str, list[int]]]:
    """Type and nodes of every line of cells.

    Raises
    ------
    MeshFileError    a type is unknown, or a line has fewer nodes
    """
    out = []
    for start, stop in part.lines:
        words = data[start:stop].split()
        kind, size = TYPES.get(int(words[0]), ("", 0))
        if not kind or len(words) <= size:
            msg = f"{part.name} has the line {data[start:stop][:40].decode('latin-1')!r}"
            raise MeshFileError(msg)
        out.append((kind, [int(word) for word in words[1: 1 + size]]))
    return out


def _parsed(data: bytes) -> tuple[int, list[_Part]]:
    """Number of dimensions, and all points and cells.

    Raises
    ------
    MeshFileError    it has several zones, fewer lines than it says, or no dimension
    """
    dim, tag = 0, ""
    parts: list[_Part] = []
    waiting = 0
    for found in re.finditer(rb"[^\r\n]+", data):
        text = found[0].partition(b"%")[0]
        start = found.start()
        if not text.strip():
            continue
        if waiting and b"=" not in text:
            parts[-1].lines.append((start, start + len(text.rstrip())))
            waiting -= 1
            continue
        if waiting:
            break
        name, _, value = text.partition(b"=")
        key, word = name.strip().upper().decode("latin-1"), value.strip().decode("latin-1")
        if key == "NDIME":
            dim = int(word)
        elif key == "NZONE" and int(word) > 1:
            msg = f"it has {word} zones, expected one"
            raise MeshFileError(msg)
        elif key == "MARKER_TAG":
            tag = word
        elif key in ("NPOIN", "NELEM", "MARKER_ELEMS"):
            number = re.compile(rb"\d+").search(data, start + len(name), found.end())
            if number is None:
                msg = f"{key} does not say how many it has"
                raise MeshFileError(msg)
            waiting = int(number[0])
            parts.append(_Part(key, tag if key == "MARKER_ELEMS" else "", number.span(), []))
    if waiting:
        held = len(parts[-1].lines)
        msg = f"it declares {held + waiting} lines for {parts[-1].name} and holds {held}"
        raise MeshFileError(msg)
    if dim not in (2, 3):
        msg = f"it has NDIME {dim}, expected 2 or 3"
        raise MeshFileError(msg)
    return dim, parts
