"""Netgen's files, .vol: identifications, segments, descriptors and geometry stay as they are."""

from __future__ import annotations

import gzip
import re
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.change import Change, NotRewritable
from odt_plugins.adapters.formats.decks import edited, unread
from odt_plugins.adapters.formats.titles import plain, titled
from odt_plugins.errors import MeshFileError
from odt_plugins.mesh.facets import row_keys

NODES = {"triangle": 3, "triangle6": 6, "quad": 4, "tetra": 4, "tetra10": 10}
"""Numbers of nodes of types of cells that may be optimised, and of quadrilaterals."""

ORDERS = {"tetra": [0, 2, 1, 3], "triangle6": [0, 1, 2, 4, 5, 3],
          "tetra10": [0, 2, 1, 3, 6, 4, 7, 5, 9, 8]}
"""Places of the nodes of cells in files, where a reader gives them in another order."""

SURFACE, VOLUME = rb"surfaceelements(?:gi|uv)?", rb"volumeelements"

KNOWN = (rb"dimension|geomtype|points|facedescriptors|materials|bcnames|cd[23]names|"
         rb"identifications|" + SURFACE
         + b"|" + VOLUME)
"""Sections of which a mesh holds what they say."""

NAMES = (b"materials", b"bcnames", b"cd2names", b"cd3names")
"""Sections of names of cells, their sides, and the sides of these."""

UNNAMED = "default"
"""Name of what has none."""

HEAD = {SURFACE: 5, VOLUME: 2}
"""Words of a row before its nodes; the last one is the number of these."""


class _Row(NamedTuple):
    """A row of a section: where it starts and stops, its words, and where these do."""

    start: int
    stop: int
    words: list[bytes]
    spans: list[tuple[int, int]]


def expect_end(path: Path) -> None:
    """See whether a file has its last word; what follows is the geometry.

    Raises
    ------
    MeshFileError    it has not
    """
    if not re.search(rb"(?m)^endmesh\s*$", _content(path)):
        msg = "it ends before its last line, endmesh"
        raise MeshFileError(msg)


def identified(path: Path) -> NDArray[np.int64] | None:
    """Points that a file says to correspond to others, as those of periodic faces; None of none."""
    section = _section(_content(path), rb"identifications")
    if section is None:
        return None
    data, at, count = section
    words = re.compile(rb"\S+").finditer(data, at)
    numbers = [int(next(words)[0]) for _ in range(3 * count)]
    return np.unique(np.array(numbers, dtype=np.int64).reshape(-1, 3)[:, :2]) - 1


def names(path: Path) -> dict[str, NDArray[np.int64]]:
    """Numbers and dimensions of materials and boundary conditions that have names."""
    data = _content(path)
    head = re.search(rb"(?m)^[ \t]*dimension\s+(\d)", data)
    found = []
    for behind, name in enumerate(NAMES):
        section = _section(data, name)
        lines = data[section[1]:].splitlines()[: section[2]] if section else []
        for line in lines:
            number, *text = line.decode("utf-8", "replace").split(None, 1) or [""]
            if text and text[0].strip() != UNNAMED and number.isdigit():
                found.append((text[0].strip(), int(head[1] if head else 3) - behind, int(number)))
    return titled(found)


def write(path: Path, mesh: Any, binary: bool | None) -> list[str]:
    """Write a mesh by meshio, with the names that it has, and the domains beside triangles."""
    import meshio

    meshio.write(path, mesh, file_format="netgen")
    data, end, rest = _content(path).rpartition(b"endmesh")
    for name in NAMES:
        data = re.sub(rb"\n" + name + rb"\n\d+\n(?:\d+[^\n]*\n)*", b"", data)
    dim = mesh.points.shape[1]
    for behind, name in enumerate(NAMES):
        own = {int(value[0]): plain(title, mesh.field_data)
               for title, value in mesh.field_data.items() if value[1] == dim - behind}
        lines = [f"{k} {own.get(k, UNNAMED)}\n" for k in range(1, max(own, default=0) + 1)]
        if lines:
            data += b"\n%s\n%d\n%s" % (name, len(lines), "".join(lines).encode())
    if dim == 3:
        data = _with_domains(data, np.asarray(mesh.points))
    whole = data + b"\n" + end + rest
    path.write_bytes(gzip.compress(whole) if path.suffix.lower() == ".gz" else whole)
    return []


def _with_domains(data: bytes, points: NDArray[Any]) -> bytes:
    """A file whose triangles tell the materials behind them and before them, 0 of none."""
    if _section(data, SURFACE) is None or _section(data, VOLUME) is None:
        return data
    rows = [row for row in _rows(data, SURFACE)[0] if row.words[4] in (b"3", b"6")]
    bodies = [row for row in _rows(data, VOLUME)[0] if row.words[1] in (b"4", b"10")]
    faces = np.array([row.words[5:8] for row in rows], np.bytes_).astype(np.int64).reshape(-1, 3)
    cells = np.array([row.words[2:6] for row in bodies], np.bytes_).astype(np.int64)
    faces, cells = faces - 1, cells.reshape(-1, 4) - 1
    label = np.tile(np.array([row.words[0] for row in bodies], np.bytes_).astype(np.int64), 4)
    sides = np.concatenate([np.delete(cells, k, axis=1) for k in range(4)])
    key = row_keys(np.sort(np.concatenate([faces, sides]), axis=1), len(points))
    wanted, first, which = np.unique(key[: len(faces)], return_index=True, return_inverse=True)
    hit = np.isin(key[len(faces):], wanted)
    at = np.searchsorted(wanted, key[len(faces):][hit])
    normal = _normals(points, faces)
    tip, base = points[cells.T.ravel()[hit]], points[faces[first[at], 0]]
    before = ((tip - base) * normal[first[at]]).sum(axis=1) > 0
    found = np.zeros((len(wanted), 2), dtype=np.int64)
    found[at, before.astype(np.int64)] = label[hit]
    turned = (normal * normal[first[which]]).sum(axis=1) < 0
    edits = []
    for row, pair, turn in zip(rows, found[which].tolist(), turned, strict=True):
        told = pair[::-1] if turn else pair
        edits += [(*row.spans[k], str(told[k - 2]).encode()) for k in (2, 3)]
    return edited(data, edits)


def _normals(points: NDArray[Any], faces: NDArray[np.int64]) -> NDArray[Any]:
    a, b, c = (points[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def besides(path: Path) -> dict[str, list[str]]:
    """What a file says that its mesh does not hold, as :func:`decks.unread` tells it."""
    text, _, more = _content(path).partition(b"endmesh")
    found = re.findall(rb"(?m)^[ \t]*([a-z_]\w*)[ \t]*\r?\n\s*[1-9]\d*\s", text)
    names = {name.decode() for name in found if not re.fullmatch(KNOWN, name)}
    return unread("the sections", names | ({"of the geometry"} if more.strip() else set()))


def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Replace the places of points that moved, and the rows of cells that were exchanged.

    Raises
    ------
    NotRewritable    points came or went, or the file has cells that are curved
    """
    if change.renumbered:
        msg = "points came or went, to which other sections may refer"
        raise NotRewritable(msg)
    data = _content(source)
    edits = _moved(data, change)
    lost: list[str] = []
    for of in (SURFACE, VOLUME):
        kinds = [kind for kind in NODES if (kind[:3] == "tet") == (of == VOLUME)]
        own = [i for i, block in enumerate(change.before.cells) if block.type in kinds and (
            change.exchanged(i).any() or not np.array_equal(
                change.cells[i], np.arange(len(block.data))))]
        if not own:
            continue
        if _section(data, rb"curvedelements") is not None:
            msg = "it has curved elements, and cells were exchanged"
            raise NotRewritable(msg)
        edits += _exchanged(data, change, of, {change.before.cells[i].type for i in own})
    if edits and _section(data, rb"surfaceelementsuv") is not None:
        flat = [block.data for block in change.after.cells if block.type in ("triangle", "quad")]
        if flat and change.moved[np.concatenate([np.ravel(rows) for rows in flat])].any():
            lost.append("the parameters of corners of triangles that moved (those of before there)")
    whole = edited(data, edits)
    target.write_bytes(gzip.compress(whole) if target.suffix.lower() == ".gz" else whole)
    return lost


def _content(path: Path) -> bytes:
    data = path.read_bytes()
    return gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data


def _section(data: bytes, name: bytes) -> tuple[bytes, int, int] | None:
    """The file, where the rows of a section begin, and their number; None where there is none."""
    head = re.search(rb"(?:^|\n)[ \t]*(?:" + name + rb")[ \t]*\r?\n\s*(\d+)\s", data)
    return None if head is None else (data, head.end(), int(head[1]))


def _moved(data: bytes, change: Change) -> list[tuple[int, int, bytes]]:
    """What replaces the coordinates of points that moved."""
    section = _section(data, rb"points")
    if section is None or section[2] != len(change.before.points):
        msg = "it has another number of points than were read"
        raise NotRewritable(msg)
    _, at, count = section
    words = re.compile(rb"\S+").finditer(data, at)
    first = re.compile(rb"[^\r\n]*\S").search(data, at)
    width = 3 if first is None else len(first[0].split())
    points, moved = np.asarray(change.after.points), change.moved
    edits = []
    for v in range(count):
        spans = [next(words).span() for _ in range(width)]
        if moved[v]:
            edits += [(start, stop, repr(x).encode()) for (start, stop), x in
                      zip(spans, points[v].tolist(), strict=False)]
    return edits


def _rows(data: bytes, name: bytes) -> tuple[list[_Row], int, int]:
    """Rows of a section of elements, where its number begins, and where it ends."""
    section = _section(data, name)
    if section is None:
        msg = "it has none of the cells that were read"
        raise NotRewritable(msg)
    _, at, count = section
    head = HEAD[name]
    kind = re.search(rb"(?:^|\n)[ \t]*(" + name + rb")[ \t]*\r?\n", data)
    extra = {b"gi": 1, b"uv": 2}.get(kind[1][-2:] if kind else b"", 0)
    words = re.compile(rb"\S+").finditer(data, at)
    rows = []
    for _ in range(count):
        found = [next(words) for _ in range(head)]
        nodes = int(found[-1][0])
        found += [next(words) for _ in range(nodes * (1 + extra))]
        rows.append(_Row(found[0].start(), found[-1].end(), [word[0] for word in found],
                         [word.span() for word in found]))
    number = re.compile(rb"\d+\s$").search(data, 0, at)
    return rows, number.start() if number else at, rows[-1].stop if rows else at


def _exchanged(
    data: bytes, change: Change, name: bytes, kinds: set[str]
) -> list[tuple[int, int, bytes]]:
    """What replaces the rows of a section: every row is followed by those that come from it."""
    rows, number, stop = _rows(data, name)
    head = HEAD[name]
    lines: dict[int, list[bytes]] = {}
    corners = _corners(rows, head)
    for kind in sorted(kinds):
        size = NODES[kind]
        own = [r for r, row in enumerate(rows) if int(row.words[head - 1]) == size]
        table = np.array([[int(w) for w in rows[r].words[head: head + size]] for r in own]) - 1
        blocks = [i for i, block in enumerate(change.before.cells) if block.type == kind]
        before = np.concatenate([change.before.cells[i].data for i in blocks])
        order = next((p for p in (list(range(size)), ORDERS.get(kind, []))
                      if len(p) == size and table.shape == before.shape
                      and np.array_equal(before[:, p], table)), None)
        if order is None:
            msg = f"its rows of type {kind} are in another order than were read"
            raise NotRewritable(msg)
        for r in own:
            lines[r] = []
        start = 0
        for i in blocks:
            after, fresh = np.asarray(change.after.cells[i].data)[:, order], change.exchanged(i)
            for c, r in enumerate((change.cells[i] + start).tolist()):
                row = rows[own[r]]
                lines[own[r]].append(
                    _with_nodes(data, row, head, (after[c] + 1).tolist(), corners) if fresh[c]
                    else data[row.start: row.stop])
            start += len(change.before.cells[i].data)
    gaps = [data[one.stop: two.start] for one, two in pairwise(rows)]
    gaps = [*gaps[:1], *gaps]
    out = [(gap, text) for r, (row, gap) in enumerate(zip(rows, gaps or [b""], strict=True))
           for text in lines.get(r, [data[row.start: row.stop]])]
    digits = len(str(len(rows)))
    body = b"".join(part for pair in out for part in pair)[len(out[0][0]) if out else 0:]
    return [(number, number + digits, str(len(out)).encode()), (rows[0].start, stop, body)]


def _corners(rows: list[_Row], head: int) -> dict[tuple[bytes, int], list[bytes]]:
    """What rows tell of a node behind their nodes, by their surface and the node."""
    out: dict[tuple[bytes, int], list[bytes]] = {}
    for row in rows:
        size = int(row.words[head - 1])
        more = row.words[head + size:]
        width = len(more) // size
        for k, node in enumerate(row.words[head: head + size] if width else ()):
            out.setdefault((row.words[0], int(node)), more[k * width: (k + 1) * width])
    return out


def _with_nodes(
    data: bytes, row: _Row, head: int, nodes: list[int], corners: dict[tuple[bytes, int], Any]
) -> bytes:
    """A row with other nodes, and what other rows of its surface tell of these."""
    size = len(nodes)
    words = list(row.words)
    words[head: head + size] = [str(node).encode() for node in nodes]
    width = (len(words) - head - size) // size
    for k, node in enumerate(nodes if width else ()):
        at = head + size + k * width
        words[at: at + width] = corners.get((row.words[0], node), words[at: at + width])
    out = []
    for k, word in enumerate(words):
        out += [data[row.spans[k - 1][1]: row.spans[k][0]] if k else b"", word]
    return b"".join(out)
