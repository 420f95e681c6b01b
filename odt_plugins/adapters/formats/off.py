"""OFF files of text: comments, colours and texture of vertices, colours of faces, polygons."""

from __future__ import annotations

import re
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from odt_plugins.adapters.formats.change import Change, NotRewritable
from odt_plugins.adapters.formats.polygons import as_mesh
from odt_plugins.errors import MeshFileError

COLOURS = "off:colour"
"""Array of what a file has behind the coordinates of a vertex, or behind the corners of a face."""

TEXTURE = "off:texture"
"""Array of the two texture coordinates of vertices, which stand last."""

KIND = re.compile(rb"((?:ST|C|N)*)OFF$")
"""Headers of files that can be read: texture, colours and normals of vertices."""


class _Lines(NamedTuple):
    """Lines of a file with their ends, and which hold what.

    Attributes
    ----------
    lines : list of bytes
    vertices, faces : list of int    number of the line of each
    normals : int or None            first word of the normal of a vertex
    textured : bool                  whether its last two words are texture coordinates
    counts : (int, int)              line of the numbers of vertices and faces, and their first word
    """

    lines: list[bytes]
    vertices: list[int]
    faces: list[int]
    normals: int | None
    textured: bool
    counts: tuple[int, int]


def read(path: Path) -> Any:
    """Read vertices and faces; what stands behind them are arrays where all have as much.

    Raises
    ------
    MeshFileError    the file is binary, has another dimension, or ends too early
    """
    found = _lines(path.read_bytes())
    words = [_words(found.lines[i]) for i in found.vertices]
    points = np.array([w[:3] for w in words], dtype=np.bytes_).astype(np.float64)
    rows = [_words(found.lines[i]) for i in found.faces]
    sizes = [int(row[0]) for row in rows]
    faces = [[int(x) for x in row[1: 1 + size]] for row, size in zip(rows, sizes, strict=True)]
    if any(len(face) != size for face, size in zip(faces, sizes, strict=True)):
        msg = "it ends within a face"
        raise MeshFileError(msg)
    mesh, order = as_mesh(points.reshape(-1, 3), faces)
    first = 3
    if found.normals is not None:
        first = found.normals + 3
        normals = np.array([w[found.normals: first] for w in words], dtype=np.bytes_)
        mesh.point_data["Normals"] = normals.astype(np.float64).reshape(-1, 3)
    last = -2 if found.textured else None
    behind = _table([w[first:last] for w in words])
    if behind is not None:
        mesh.point_data[COLOURS] = behind
    if found.textured:
        mesh.point_data[TEXTURE] = np.array([w[-2:] for w in words], np.bytes_).astype(np.float64)
    colours = [_table([rows[i][1 + sizes[i]:] for i in chosen]) for chosen in order]
    if colours and all(part is not None for part in colours):
        mesh.cell_data[COLOURS] = colours
    return mesh


def write(path: Path, mesh: Any, binary: bool | None) -> list[str]:
    """Write a mesh, with the colours of its vertices and of its cells."""
    points = np.asarray(mesh.points, dtype=np.float64)
    colours = mesh.cell_data.get(COLOURS, [None] * len(mesh.cells))
    head = "ST" * (TEXTURE in mesh.point_data) + "C" * (COLOURS in mesh.point_data) + "OFF"
    count = sum(len(block.data) for block in mesh.cells)
    lines = [head, f"{len(points)} {count} 0"]
    told = _behind(mesh) or [[]] * len(points)
    lines += [" ".join([*map(repr, place), *words])
              for place, words in zip(points.tolist(), told, strict=True)]
    for block, values in zip(mesh.cells, colours, strict=True):
        told = _texts(values) or [[]] * len(block.data)
        lines += [" ".join([str(len(row)), *map(str, np.asarray(row).tolist()), *words])
                  for row, words in zip(block.data, told, strict=True)]
    path.write_text("\n".join(lines) + "\n")
    return []


def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Replace the vertices that moved and the triangles that changed; all else stays as it is."""
    found = _lines(source.read_bytes())
    if change.renumbered:
        return _with_others(found, target, change)
    lines = list(found.lines)
    points, moved = np.asarray(change.after.points), change.moved
    for v in np.flatnonzero(moved).tolist():
        at = found.vertices[v]
        lines[at] = _replaced(lines[at], range(3), [repr(x) for x in points[v].tolist()])
    if found.normals is not None:
        for v, normal in enumerate(np.asarray(change.after.point_data["Normals"]).tolist()):
            at = found.vertices[v]
            span = range(found.normals, found.normals + 3)
            lines[at] = _replaced(lines[at], span, [f"{x:.9g}" for x in normal])
    first = 3 if found.normals is None else found.normals + 3
    old, new = _behind(change.before), _behind(change.after)
    for at, was, now in zip(found.vertices, old, new, strict=False):
        if was != now:
            lines[at] = _replaced(lines[at], range(first, first + len(now)), now)
    order = _order(found, change)
    for i, block in enumerate(change.after.cells):
        if block.type != "triangle":
            continue
        here = [found.faces[row] for row in np.asarray(order[i])[change.cells[i]]]
        texts = [found.lines[at] for at in here]
        slots = [found.faces[row] for row in order[i]]
        if len(texts) != len(slots):
            msg = "triangles came or went"
            raise NotRewritable(msg)
        fresh = change.exchanged(i)
        for k, (at, text) in enumerate(zip(slots, texts, strict=True)):
            lines[at] = _replaced(text, range(1, 4), map(str, block.data[k].tolist())) if (
                fresh[k]) else text
    target.write_bytes(b"".join(lines))
    return []


def _with_others(found: _Lines, target: Path, change: Change) -> list[str]:
    """Write lines of other vertices and faces; comments and what stands behind them stay.

    Returns
    -------
    list of str    what is lost
    """
    before, after, lines = change.before, change.after, list(found.lines)
    end = b"\r\n" if lines[0].endswith(b"\r\n") else b"\n"
    points, moved = np.asarray(after.points).tolist(), change.moved.tolist()
    first = 3 if found.normals is None else found.normals + 3
    normals = None if found.normals is None else np.asarray(after.point_data["Normals"]).tolist()
    texts, old = _behind(after), _behind(before)
    vertices = []
    for v, source in enumerate(change.points.tolist()):
        line = lines[found.vertices[source]] if source >= 0 else b""
        new = [repr(x) for x in points[v]] if moved[v] else []
        new += [f"{x:.9g}" for x in normals[v]] if normals is not None else []
        which = [*range(0 if moved[v] else 3, first)]
        if texts and (source < 0 or not old or texts[v] != old[source]):
            new += texts[v]
            which += range(first, first + len(texts[v]))
        vertices.append(_ended(_replaced(line, which, new), end) if source >= 0
                        else " ".join(new).encode() + end)
    faces = []
    colours = after.cell_data.get(COLOURS, [None] * len(after.cells))
    others = before.cell_data.get(COLOURS, [None] * len(after.cells))
    for i, (rows, block) in enumerate(zip(_order(found, change), after.cells, strict=True)):
        texts, old = _texts(colours[i]), _texts(others[i])
        for k, (row, corners) in enumerate(zip(change.cells[i].tolist(), block.data.tolist(),
                                               strict=True)):
            new = [str(v) for v in corners]
            if texts and old and texts[k] != old[row]:
                new += texts[k]
            line = _replaced(lines[found.faces[rows[row]]], range(1, 1 + len(new)), new)
            faces.append(_ended(line, end))
    behind = any(len(_words(lines[at])) > first for at in found.vertices)
    lost = not _behind(before) and behind and bool((change.points < 0).any())
    at, word = found.counts
    counts = [str(len(vertices)), str(len(faces)), "0"][: len(_words(lines[at])) - word]
    lines[at] = _replaced(lines[at], range(word, word + len(counts)), counts)
    for slots, new_lines in ((found.vertices, vertices), (found.faces, faces)):
        for slot in slots:
            lines[slot] = b""
        lines[slots[0]] = b"".join(new_lines)
    target.write_bytes(b"".join(lines))
    return ["what stands behind some vertices, at new ones"] if lost else []


def _order(found: _Lines, change: Change) -> list[Any]:
    """Faces of every block of the mesh of a file."""
    rows = [_words(found.lines[at]) for at in found.faces]
    faces = [[int(x) for x in row[1: 1 + int(row[0])]] for row in rows]
    return as_mesh(np.asarray(change.before.points), faces)[1]


def _behind(mesh: Any) -> list[list[str]]:
    """What stands behind the places and normals of vertices as words; none of no array."""
    found = [_texts(mesh.point_data[name]) for name in (COLOURS, TEXTURE)
             if name in mesh.point_data]
    return [[*chain(*parts)] for parts in zip(*found, strict=True)]


def _texts(values: Any) -> list[list[str]]:
    """Numbers of every row as words; none of no array."""
    return [] if values is None else [
        list(map(repr, np.atleast_1d(row).tolist())) for row in np.asarray(values)]


def _ended(line: bytes, end: bytes) -> bytes:
    return line if line.endswith(b"\n") else line + end


def _lines(data: bytes) -> _Lines:
    lines = data.splitlines(keepends=True)
    full = [i for i, line in enumerate(lines) if _words(line)]
    head = _words(lines[full[0]]) if full else []
    kind = KIND.match(head[0]) if head else None
    if kind is None or head[1:2] == [b"BINARY"]:
        words = repr(b" ".join(head)[:20]) if head else "nothing"
        msg = (f"it begins with {words}; expected OFF, or COFF, NOFF and the like "
               f"of text")
        raise MeshFileError(msg)
    start = 1
    counts = head[1:]
    if not counts:
        counts, start = (_words(lines[full[1]]) if len(full) > 1 else []), 2
    try:
        n, m = int(counts[0]), int(counts[1])
    except (ValueError, IndexError) as exc:
        msg = "it does not say how many vertices and faces it has"
        raise MeshFileError(msg) from exc
    rest = full[start:]
    if len(rest) < n + m:
        msg = f"it has {len(rest)} lines for {n} vertices and {m} faces"
        raise MeshFileError(msg)
    at = (full[start - 1], 1 if start == 1 else 0)
    has = b"N" in kind[1] and all(len(_words(lines[i])) > 5 for i in rest[:n])
    least = (6 if has else 3) + 2
    textured = b"ST" in kind[1] and all(len(_words(lines[i])) >= least for i in rest[:n])
    return _Lines(lines, rest[:n], rest[n: n + m], 3 if has else None, textured, at)


def _words(line: bytes) -> list[bytes]:
    return line.partition(b"#")[0].split()


def _table(rows: list[list[bytes]]) -> Any:
    """Numbers (n, k) where all rows have k > 0 words, colours as bytes; None otherwise."""
    width = {len(row) for row in rows}
    if len(width) != 1 or width == {0}:
        return None
    numbers = np.array(rows, dtype=np.bytes_).astype(np.float64)
    whole = all(b"." not in word and b"e" not in word for row in rows for word in row)
    bytes_of = whole and len(rows[0]) in (3, 4) and 0 <= numbers.min() and numbers.max() <= 255
    return numbers.astype(np.uint8 if bytes_of else np.int64) if whole else numbers


def _replaced(line: bytes, which: Any, texts: Any) -> bytes:
    """A line with other words at some places."""
    spans = [found.span() for found in re.finditer(rb"[^\s#]+", line.partition(b"#")[0])]
    out = line
    for i, text in reversed(list(zip(which, texts, strict=True))):
        start, end = spans[i]
        out = out[:start] + text.encode() + out[end:]
    return out


