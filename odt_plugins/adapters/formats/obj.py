"""Wavefront OBJ files: groups, materials, colours of vertices, texture coordinates of corners."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.change import Change, NotRewritable
from odt_plugins.adapters.formats.polygons import as_mesh
from odt_plugins.errors import MeshFileError

TEXTURE = "texcoord"
"""Array (m, 6) of the texture coordinates of the corners of triangles, 0 of those without."""

NORMALS, COLOURS = "Normals", "obj:colour"
"""Arrays of vertices."""

STATES = (b"o", b"g", b"usemtl")
"""Lines that say what the faces behind them belong to."""

SMOOTH = 40.0
"""Degrees up to which triangles share a normal where the file has several for a vertex."""


class _Lines(NamedTuple):
    """Lines of a file with their ends, and what stands on which.

    Attributes
    ----------
    lines : list of bytes        long lines that go on with a backslash as one
    vertices, texture, normals, faces, wires : list of int    numbers of the lines of each, `wires`
                                 those of lines through vertices
    ends : list                  of each of `wires` its vertices
    corners : list               of every face its words, as three numbers from 0 on; -1 for none
    state : list of int          number of the group, object and material of every face
    names : list of str          of these
    alone : dict of lists        vertices that are points, by the numbers of their lines
    """

    lines: list[bytes]
    vertices: list[int]
    texture: list[int]
    normals: list[int]
    faces: list[int]
    wires: list[int]
    ends: list[list[int]]
    corners: list[list[tuple[int, int, int]]]
    state: list[int]
    names: list[str]
    alone: dict[int, list[int]]


def read(path: Path) -> Any:
    """Read vertices, faces, lines and points; what faces belong to are sets where it differs.

    Raises
    ------
    MeshFileError    a line is broken, or refers to something that is not there
    """
    from meshio import CellBlock

    found = _lines(path.read_bytes())
    words = [found.lines[i].partition(b"#")[0].split()[1:] for i in found.vertices]
    try:
        points = np.array([w[:3] for w in words], dtype=np.bytes_).astype(np.float64)
        uv = np.array([found.lines[i].split()[1:3] for i in found.texture], dtype=np.bytes_)
        normals = np.array([found.lines[i].split()[1:4] for i in found.normals], dtype=np.bytes_)
        uv, normals = uv.astype(np.float64), normals.astype(np.float64)
    except ValueError as exc:
        msg = "a vertex, a normal or a texture coordinate has too few numbers, or none"
        raise MeshFileError(msg) from exc
    mesh, order = as_mesh(points.reshape(-1, 3), [[c[0] for c in f] for f in found.corners])
    if words and all(len(w) in (6, 7) for w in words):
        colours = np.array([w[-3:] if len(w) == 6 else w[3:6] for w in words], dtype=np.bytes_)
        mesh.point_data[COLOURS] = colours.astype(np.float64)
    for i, rows in enumerate(order):
        part = np.array([[c[1] for c in found.corners[j]] for j in rows.tolist()])
        if mesh.cells[i].type == "triangle" and uv.ndim == 2:
            has = (part >= 0).all(axis=1)
            if has.any():
                mesh.cell_data[TEXTURE] = [np.zeros((len(own), 6)) for own in order]
                mesh.cell_data[TEXTURE][i][has] = uv[part[has]].reshape(-1, 6)
    at = _of_vertices(found, len(points))
    if at is not None and normals.ndim == 2:
        mesh.point_data[NORMALS] = normals[at]
    state = np.array(found.state, dtype=np.int64)
    kinds = np.unique(state)
    if len(kinds) > 1:
        mesh.cell_sets = {found.names[k]: [np.flatnonzero(state[rows] == k) for rows in order]
                          for k in kinds.tolist()}
    pairs = np.array([pair for ends in found.ends for pair in pairwise(ends)], dtype=np.int64)
    alone = np.array([v for row in found.alone.values() for v in row], dtype=np.int64)
    for kind, size, rows in (("line", 2, pairs), ("vertex", 1, alone)):
        if not len(rows):
            continue
        mesh.cells.append(CellBlock(kind, rows.reshape(-1, size)))
        for values in mesh.cell_data.values():
            values.append(np.zeros((len(rows), 6)))
        for members in mesh.cell_sets.values():
            members.append(np.zeros(0, dtype=np.int64))
    return mesh


def write(path: Path, mesh: Any, binary: bool | None) -> list[str]:
    """Write a mesh by meshio, and the colours of its vertices behind their places."""
    import meshio

    meshio.write(path, mesh, file_format="obj")
    colours = mesh.point_data.get(COLOURS)
    if colours is not None:
        lines = path.read_bytes().splitlines(keepends=True)
        at = [i for i, line in enumerate(lines) if line.startswith(b"v ")]
        for i, colour in zip(at, np.asarray(colours).tolist(), strict=True):
            lines[i] = b"%s %s\n" % (lines[i].strip(), b" ".join(b"%r" % x for x in colour))
        path.write_bytes(b"".join(lines))
    return []


def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Replace vertices that moved, triangles that changed, and what their corners refer to."""
    found = _lines(source.read_bytes())
    if change.renumbered:
        target.write_bytes(b"".join(_with_others(found, change)))
        return []
    lines = list(found.lines)
    points = np.asarray(change.after.points)
    moved = change.moved
    was, now = (np.asarray(mesh.point_data.get(COLOURS, points[:, :0]))
                for mesh in (change.before, change.after))
    other = (was != now).any(axis=1) if was.shape == now.shape else np.zeros(len(points), np.bool_)
    for v in np.flatnonzero(moved | other).tolist():
        lines[found.vertices[v]] = _placed(lines[found.vertices[v]], points[v].tolist(),
                                           now[v].tolist() if other[v] else [])
    _, order = as_mesh(np.asarray(change.before.points), [[c[0] for c in f] for f in found.corners])
    block = next(i for i, b in enumerate(change.after.cells) if b.type == "triangle")
    rows, cells = change.cells[block], np.asarray(change.after.cells[block].data)
    if len(rows) != len(order[block]):
        msg = "triangles came or went"
        raise NotRewritable(msg)
    fresh = change.exchanged(block)
    corners = [list(face) for face in found.corners]
    sources = np.arange(len(corners))
    sources[order[block]] = order[block][rows]
    changed = np.zeros(len(corners), dtype=np.bool_)
    changed[order[block]] = fresh
    texture = _texture(found, change, block)
    for k, face in enumerate(order[block].tolist()):
        old = found.corners[int(sources[face])]
        if changed[face]:
            corners[face] = [(int(v), -1, -1) for v in cells[k]]
        else:
            corners[face] = list(old)
    if texture is not None:
        numbers, values = texture
        for k, face in enumerate(order[block].tolist()):
            named = [(v, int(t), n) for (v, _, n), t in zip(corners[face], numbers[k], strict=True)]
            changed[face] |= named != corners[face]
            corners[face] = named
        _put_texture(lines, found, values)
    if found.normals and (moved.any() or fresh.any()):
        has = np.array([all(c[2] >= 0 for c in found.corners[i]) for i in sources.tolist()])
        every = [[c[0] for c in face] for face in corners]
        of, normals = _normals(points, every, _of_vertices(found, len(points)) is not None)
        for face, new in enumerate(of):
            if has[face]:
                corners[face] = [(v, t, n) for (v, t, _), n in
                                 zip(corners[face], new.tolist(), strict=True)]
                changed[face] = True
        _listed(lines, found.normals, [_line(b"vn", row) for row in normals])
    texts, end = [found.lines[found.faces[i]] for i in sources.tolist()], _end(found.lines[0])
    for face, at in enumerate(found.faces):
        lines[at] = _face(corners[face]) + end if changed[face] else texts[face]
    target.write_bytes(b"".join(lines))
    return []


def _with_others(found: _Lines, change: Change) -> list[bytes]:
    """Lines of a file with new vertices; each face stands where its source face stood.

    Raises
    ------
    NotRewritable    a point went
    """
    after = change.after
    _, order = as_mesh(np.asarray(change.before.points), [[c[0] for c in f] for f in found.corners])
    texture = _texture(found, change, 0)
    sources = [rows[of].tolist() for rows, of in zip(order, change.cells, strict=False)]
    corners = [row for block, _ in zip(after.cells, order, strict=False)
               for row in np.asarray(block.data).tolist()]
    numbers = [[c[1] for c in found.corners[i]] for rows in sources for i in rows]
    values = [[float(x) for x in found.lines[i].split()[1:]] for i in found.texture]
    if texture is not None:
        numbers[: len(sources[0])], values = texture[0].tolist(), texture[1]
    used = sorted({t for row in numbers for t in row if t >= 0})
    number = {t: i for i, t in enumerate(used)} | {-1: -1}
    points = np.asarray(after.points)
    lines = list(found.lines)
    of: Any = [[-1] * len(row) for row in corners]
    if found.normals:
        of, normals = _normals(points, corners,
                               _of_vertices(found, len(change.before.points)) is not None)
        _listed(lines, found.normals, [_line(b"vn", row) for row in normals])
    rest = np.asarray(after.point_data.get(COLOURS, points[:, :0]))
    end = _end(lines[0])
    _listed(lines, found.vertices, [
        b" ".join([b"v", *(repr(x).encode() for x in [*place, *more])])
        for place, more in zip(points.tolist(), rest.tolist(), strict=True)])
    if used:
        _put_texture(lines, found, [values[t] for t in used])
    faces: list[list[bytes]] = [[] for _ in found.faces]
    every = (i for rows in sources for i in rows)
    for source, row, marks, normal in zip(every, corners, numbers, of, strict=True):
        words = list(zip(row, (number[t] for t in marks), normal, strict=True))
        faces[source].append(_face(words) + end)
    for at, texts in zip(found.faces, faces, strict=True):
        lines[at] = b"".join(texts)
    if found.ends:
        of_pair = [at for at, ends in zip(found.wires, found.ends, strict=True) for _ in ends[1:]]
        wires: dict[int, list[bytes]] = {at: [] for at in found.wires}
        for pair, source in zip(np.asarray(after.cells[len(order)].data).tolist(),
                                change.cells[len(order)].tolist(), strict=True):
            wires[of_pair[source]].append(b"l %d %d" % (pair[0] + 1, pair[1] + 1) + end)
        for at, texts in wires.items():
            lines[at] = b"".join(texts)
    for at, row in found.alone.items():
        there = change.number[row]
        if (there < 0).any():
            msg = "vertices went that are points"
            raise NotRewritable(msg)
        lines[at] = b" ".join([b"p", *(b"%d" % (v + 1) for v in there.tolist())]) + end
    return lines


def _lines(data: bytes) -> _Lines:
    raw = data.splitlines(keepends=True)
    lines: list[bytes] = []
    for line in raw:
        if lines and lines[-1].rstrip().endswith(b"\\"):
            lines[-1] = lines[-1].rstrip()[:-1] + b" " + line
        else:
            lines.append(line)
    out = _Lines(lines, [], [], [], [], [], [], [], [], [], {})
    known: dict[tuple[bytes, ...], int] = {}
    current = dict.fromkeys(STATES, b"")
    for i, line in enumerate(lines):
        words = line.partition(b"#")[0].split()
        if not words:
            continue
        head = words[0]
        if head == b"v":
            out.vertices.append(i)
        elif head == b"vt":
            out.texture.append(i)
        elif head == b"vn":
            out.normals.append(i)
        elif head in current:
            current[head] = b" ".join(words[1:])
        elif head in (b"f", b"l", b"p"):
            counts = (len(out.vertices), len(out.texture), len(out.normals))
            corners = [_corner(word, counts) for word in words[1:]]
            if head == b"p":
                out.alone[i] = [c[0] for c in corners]
                continue
            if head == b"l":
                out.ends.append([c[0] for c in corners])
                out.wires.append(i)
                continue
            key = tuple(current.values())
            if key not in known:
                known[key] = len(known)
            out.faces.append(i)
            out.corners.append(corners)
            out.state.append(known[key])
    _expect_there(out)
    columns = [{key[i] for key in known} for i in range(len(STATES))]
    for key in known:
        parts = [text.decode(errors="replace") for text, column in zip(key, columns, strict=True)
                 if len(column) > 1 and text]
        out.names.append(" ".join(dict.fromkeys(parts)) or "none")
    return out


def _corner(word: bytes, counts: tuple[int, int, int]) -> tuple[int, int, int]:
    """Numbers of vertex, texture and normal that a corner names, from 0 on; -1 for none."""
    parts = word.split(b"/")
    try:
        given = [int(part) if part else 0 for part in parts]
    except ValueError as exc:
        msg = f"a face has the corner {word[:30]!r}"
        raise MeshFileError(msg) from exc
    given += [0] * (3 - len(given))
    a, b, c = (x - 1 if x > 0 else count + x if x < 0 else -1
               for x, count in zip(given, counts, strict=False))
    return a, b, c


def _expect_there(found: _Lines) -> None:
    flat = [c for face in found.corners for c in face]
    flat += [(v, -1, -1) for ends in (*found.ends, *found.alone.values()) for v in ends]
    table = np.array(flat, dtype=np.int64).reshape(-1, 3)
    for i, what in enumerate(("vertices", "texture", "normals")):
        size = len(getattr(found, what))
        bad = table[(table[:, i] >= size) | (table[:, i] < (0 if i == 0 else -1)), i]
        if bad.size:
            msg = f"a face refers to number {bad[0] + 1} of {size} {what}"
            raise MeshFileError(msg)


def _of_vertices(found: _Lines, count: int) -> NDArray[np.int64] | None:
    """The normal of every vertex, (n,); None where some have several or none."""
    out = np.full(count, -1, dtype=np.int64)
    values = [b" ".join(found.lines[i].split()[1:4]) for i in found.normals]
    for face in found.corners:
        for v, _, n in face:
            if n < 0 or (out[v] >= 0 and values[out[v]] != values[n]):
                return None
            out[v] = n
    return out if count and out.min() >= 0 else None


def _texture(
    found: _Lines, change: Change, block: int
) -> tuple[NDArray[np.int64], list[list[float]]] | None:
    """Numbers (m', 3) of the texture coordinates of corners, and all of these, new ones last.

    Triangles that come from one without texture have none, -1, if others in the file have some.
    """
    if TEXTURE not in change.after.cell_data:
        return None
    old = [[float(x) for x in found.lines[i].split()[1:]] for i in found.texture]
    known = {tuple(row[:2]): i for i, row in reversed(list(enumerate(old)))}
    faces = [i for i, face in enumerate(found.corners) if len(face) == 3]
    bare = np.array([bool(old) and any(c[1] < 0 for c in found.corners[i]) for i in faces])
    has = ~bare[change.cells[block]]
    wanted = np.asarray(change.after.cell_data[TEXTURE][block])[has].reshape(-1, 2).tolist()
    numbers = [known.setdefault((u, v), len(known) + len(old)) for u, v in wanted]
    fresh = {i: key for key, i in known.items() if i >= len(old)}
    place = {i: len(old) + k for k, i in enumerate(sorted(fresh))}
    values = old + [list(fresh[i]) for i in sorted(fresh)]
    out = np.full((len(has), 3), -1, dtype=np.int64)
    out[has] = np.array([place.get(i, i) for i in numbers], dtype=np.int64).reshape(-1, 3)
    return out, values


def _normals(
    points: NDArray[Any], faces: list[list[int]], of_vertices: bool
) -> tuple[list[NDArray[np.int64]], NDArray[np.float64]]:
    """Numbers of the normals of the corners of every face, and the normals.

    Normals are means over the faces around a vertex, weighted by area: over all, or over those
    whose own normal is within SMOOTH degrees.
    """
    areas = np.zeros((len(faces), 3))
    for i, face in enumerate(faces):
        p = points[face].astype(np.float64)
        areas[i] = np.cross(p[1:-1] - p[0], p[2:] - p[0]).sum(axis=0)
    size = np.array([len(face) for face in faces])
    vertex = np.concatenate([np.zeros(0, np.int64), *map(np.asarray, faces)]).astype(np.int64)
    owner = np.repeat(np.arange(len(faces)), size)
    unit = _unit(areas)
    if of_vertices:
        sums = np.stack([np.bincount(vertex, a[owner], len(points)) for a in areas.T], axis=1)
        return np.split(vertex, np.cumsum(size)[:-1]), _unit(sums)
    around: dict[int, list[int]] = {}
    for v, i in zip(vertex.tolist(), owner.tolist(), strict=True):
        around.setdefault(v, []).append(i)
    least = math.cos(math.radians(SMOOTH))
    known: dict[tuple[float, ...], int] = {}
    numbers = []
    for v, i in zip(vertex.tolist(), owner.tolist(), strict=True):
        near = np.array(around[v])
        near = near[(unit[near] * unit[i]).sum(axis=1) >= least]
        mean = _unit(areas[near].sum(axis=0)[None])[0].round(9) + 0.0
        numbers.append(known.setdefault(tuple(mean.tolist()), len(known)))
    return np.split(np.array(numbers, dtype=np.int64), np.cumsum(size)[:-1]), np.array(list(known))


def _unit(vectors: NDArray[Any]) -> NDArray[np.float64]:
    length = np.linalg.norm(vectors, axis=1)[:, None]
    out = np.zeros(vectors.shape)
    np.divide(vectors, length, out=out, where=length > 0.0)
    return out


def _listed(lines: list[bytes], at: list[int], new: list[bytes]) -> None:
    """Put a list in place of the one whose lines are given, where it differs."""
    if [lines[i].split() for i in at] == [line.split() for line in new]:
        return
    end = _end(lines[at[0]])
    for i in at:
        lines[i] = b""
    lines[at[0]] = b"".join(line + end for line in new)


def _put_texture(lines: list[bytes], found: _Lines, values: list[list[float]]) -> None:
    """Put texture coordinates in place of those of the file, or behind its vertices."""
    new = [_line(b"vt", row) for row in values]
    if found.texture:
        _listed(lines, found.texture, new)
    else:
        end = _end(lines[0])
        lines[found.vertices[-1]] += b"".join(line + end for line in new)


def _line(head: bytes, numbers: Any) -> bytes:
    return head + b" " + b" ".join(f"{float(x):.9g}".encode() for x in numbers)


def _end(line: bytes) -> bytes:
    return b"\r\n" if line.endswith(b"\r\n") else b"\n"


def _placed(line: bytes, place: list[float], colour: list[float]) -> bytes:
    words = line.partition(b"#")[0].split()
    rest = words[4 + len(colour):]
    return b" ".join([words[0], *(repr(x).encode() for x in [*place, *colour]), *rest]) + _end(line)


def _face(corners: Sequence[Sequence[int]]) -> bytes:
    words = []
    for v, t, n in corners:
        word = str(v + 1)
        if t >= 0 or n >= 0:
            word += f"/{t + 1 if t >= 0 else ''}"
        if n >= 0:
            word += f"/{n + 1}"
        words.append(word)
    return f"f {' '.join(words)}".encode()
