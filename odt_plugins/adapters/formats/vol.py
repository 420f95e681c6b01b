"""Netgen's files, .vol: descriptors, names and geometry stay as they are, cells and points do not.

What is told of a corner of a triangle, or of an end of a segment, is its place on the surface or
along the edge; those that are new or moved are where the triangle, or the segment, that they come
from has them.
"""

from __future__ import annotations

import gzip
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.change import Change, NotRewritable
from odt_plugins.adapters.formats.decks import HELD, Edit, edited, unread
from odt_plugins.adapters.formats.titles import CONTROL, plain, titled, written
from odt_plugins.adapters.formats.vol_tables import (
    SURFACE,
    VOLUME,
    Row,
    Rows,
    content,
    elements,
    lines_of,
    number_before,
    section,
    segments,
    table,
)
from odt_plugins.errors import MeshFileError
from odt_plugins.mesh.facets import row_keys

NODES = {"triangle": 3, "triangle6": 6, "quad": 4, "tetra": 4, "tetra10": 10}
"""Numbers of nodes of types of cells that may be optimised, and of quadrilaterals."""

ORDERS = {"tetra": [0, 2, 1, 3], "triangle6": [0, 1, 2, 4, 5, 3],
          "tetra10": [0, 2, 1, 3, 6, 4, 7, 5, 9, 8]}
"""Places of the nodes of cells in files, where a reader gives them in another order."""

KNOWN = (rb"dimension|geomtype|points|facedescriptors|materials|bcnames|cd[23]names|"
         rb"identifications|" + SURFACE + b"|" + VOLUME)
"""Sections of which a mesh holds what they say."""

NAMES = (b"materials", b"bcnames", b"cd2names", b"cd3names")
"""Sections of names of cells, their sides, and the sides of these."""

INDEX = "netgen:index"
"""Cell data of the numbers of materials, boundary conditions and edges."""

LINEAR = ("vertex", "line", "triangle", "quad", "tetra")
"""Cells beside which lines are read."""

LINES = ("line", "line3")
"""Types of the cells that segments are."""

MIDDLES = {"triangle6": [[0, 1, 3], [1, 2, 4], [2, 0, 5]],
           "tetra10": [[0, 1, 4], [1, 2, 5], [2, 0, 6], [0, 3, 7], [1, 3, 8], [2, 3, 9]]}
"""Ends and nodes of the edges of cells of second order, beside which lines are read, too."""

UNNAMED = "default"
"""Name of what has none."""

FOLLOWED = (rb"dimension|geomtype|facedescriptors|edgedescriptors|materials|bcnames|cd[23]names|"
            rb"identificationtypes|identificationnames|face_colours|face_transparencies|points|"
            rb"pointelements|identifications|curvedelements|" + SURFACE + b"|" + VOLUME)
"""Sections that can be told of other points."""

SEGMENTED = rb"|edgesegments(?:gi[23]?)?"
"""Sections that are known in the forms of :data:`vol_tables.SEGMENTS`."""

CURVED = re.compile(rb"(?m)^curvedelements(?:\s+(?:[-+.\deE]+|[ft]))+\s+(?=endmesh)")
"""Section of how edges and faces are curved, by numbers that depend on all cells."""

KEPT = {rb"pointelements": (2, 1), rb"identifications": (3, 2)}
"""Sections of points that stay: words of a row, and how many of these are points."""


def expect_end(path: Path) -> None:
    """See whether a file has its last word; what follows is the geometry.

    Raises
    ------
    MeshFileError    it has not
    """
    if not re.search(rb"(?m)^endmesh\s*$", content(path)):
        msg = "it ends before its last line, endmesh"
        raise MeshFileError(msg)


def identified(data: bytes) -> NDArray[np.int64] | None:
    """Points that a file says to correspond to others, as those of periodic faces; None of none."""
    size, named = KEPT[rb"identifications"]
    rows = table(data, rb"identifications", size).rows
    numbers = [int(word) - 1 for row in rows for word in row.words[:named]]
    return np.unique(numbers) if rows else None


def names(data: bytes) -> dict[str, NDArray[np.int64]]:
    """Numbers and dimensions of materials and boundary conditions that have names."""
    head = re.search(rb"(?m)^[ \t]*dimension\s+(\d)", data)
    found = []
    for behind, name in enumerate(NAMES):
        found_at = section(data, name)
        lines = data[found_at[0]:].split(b"\n", found_at[1])[:-1] if found_at else []
        for line in lines:
            number, *text = line.decode("utf-8", "replace").split(None, 1) or [""]
            if text and text[0].strip() != UNNAMED and number.isdigit():
                found.append((text[0].strip(), int(head[1] if head else 3) - behind, int(number)))
    return titled(found)


def write(path: Path, mesh: Any, binary: bool | None) -> list[str]:
    """Write a mesh by meshio, and the names that it has, and the domains beside triangles."""
    import meshio

    cells: Any = [("line", block.data[:, :2]) if block.type in LINES else block
                  for block in mesh.cells]
    meshio.write(path, meshio.Mesh(mesh.points, cells, cell_data=mesh.cell_data),
                 file_format="netgen")
    data, end, rest = content(path).rpartition(b"endmesh")
    for name in NAMES:
        data = re.sub(rb"\n" + name + rb"\n\d+\n(?:\d+[^\n]*\n)*", b"", data)
    dim = mesh.points.shape[1]
    known = written((plain(title, mesh.field_data) for title in mesh.field_data), CONTROL)
    for behind, name in enumerate(NAMES):
        own = {int(value[0]): known[plain(title, mesh.field_data)]
               for title, value in mesh.field_data.items() if value[1] == dim - behind}
        lines = [f"{k} {own.get(k, UNNAMED)}\n" for k in range(1, max(own, default=0) + 1)]
        if lines:
            data += b"\n%s\n%d\n%s" % (name, len(lines), "".join(lines).encode())
    if dim == 3:
        data = _with_domains(_with_edges(data), np.asarray(mesh.points))
    whole = data + b"\n" + end + rest
    path.write_bytes(gzip.compress(whole) if path.suffix.lower() == ".gz" else whole)
    return []


def _with_edges(data: bytes) -> bytes:
    """A file whose segments tell their numbers where Netgen has those of edges."""
    edits = []
    for row in segments(data)[0].rows:
        spans = row.spans(data)
        edits += [(*spans[k], row.words[0]) for k in (8, 10)]
    return edited(data, edits)


def _with_domains(data: bytes, points: NDArray[Any]) -> bytes:
    """A file whose triangles tell the materials behind them and before them, 0 of none."""
    if section(data, SURFACE) is None or section(data, VOLUME) is None:
        return data
    rows = [row for row in elements(data, SURFACE).rows if row.words[4] in (b"3", b"6")]
    bodies = [row for row in elements(data, VOLUME).rows if row.words[1] in (b"4", b"10")]
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
        spans = row.spans(data)
        edits += [(*spans[k], str(told[k - 2]).encode()) for k in (2, 3)]
    return edited(data, edits)


def _normals(points: NDArray[Any], faces: NDArray[np.int64]) -> NDArray[Any]:
    a, b, c = (points[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def completed(path: Path, mesh: Any) -> Any:
    """A mesh with what readers do not tell of a file: names, points that stay, segments by edges.

    Parameters
    ----------
    path : path
    mesh : meshio.Mesh    as it was read; segments have the nodes of the edges that they are
    """
    data = content(path)
    mesh.identified, mesh.field_data = identified(data), names(data)
    mesh = _with_lines(data, mesh)
    text, _, more = data.partition(b"endmesh")
    lines = any(block.type in LINES for block in mesh.cells)
    known = KNOWN + SEGMENTED * lines
    mesh.info = unread("the sections", [
        *({name.decode() for name in _sections(text) if not re.fullmatch(known, name)}),
        *(["of the geometry"] if more.strip() else [])])
    return mesh


def _sections(text: bytes) -> list[bytes]:
    """Names of the sections that have rows."""
    return re.findall(rb"(?m)^[ \t]*([a-z_]\w*)[ \t]*\r?\n\s*[1-9]\d*\s", text)


def _with_lines(data: bytes, mesh: Any) -> Any:
    """A mesh with the segments of a file, and with the points that its elements name."""
    import meshio

    named = table(data, rb"pointelements", KEPT[rb"pointelements"][0]).rows
    setattr(mesh, HELD, np.unique([int(row.words[0]) - 1 for row in named]).astype(np.int64))
    found, label = segments(data)
    nodes = _with_middles(np.array([row.points() for row in found.rows], dtype=np.int64), mesh)
    if nodes is None:
        return mesh
    other = [i for i, block in enumerate(mesh.cells) if block.type not in LINES]
    parts = lines_of(found.rows, label)
    kind = LINES[nodes.shape[1] - 2]
    cells = [mesh.cells[i] for i in other] + [(kind, nodes[own]) for own in parts]
    of = {name: [values[i] for i in other] for name, values in mesh.cell_data.items()}
    of = {INDEX: of.get(INDEX, []) + [label[own] for own in parts]} if of else {}
    out = meshio.Mesh(mesh.points, cells, mesh.point_data, of, mesh.field_data)
    vars(out).update({name: value for name, value in vars(mesh).items() if name not in vars(out)})
    setattr(out, HELD, getattr(mesh, HELD))
    return out


def _with_middles(ends: NDArray[np.int64], mesh: Any) -> NDArray[np.int64] | None:
    """Nodes (q, 2), or (q, 3) of second order, of segments; None where some are no edges."""
    kinds = {block.type for block in mesh.cells} - {*LINEAR}
    if not len(ends) or not kinds <= {*MIDDLES}:
        return None
    if not kinds:
        return ends
    edges = np.concatenate([np.asarray(block.data)[:, MIDDLES[block.type]].reshape(-1, 3)
                            for block in mesh.cells if block.type in MIDDLES])
    key = row_keys(np.sort(np.concatenate([ends, edges[:, :2]]), axis=1), len(mesh.points))
    known, first = np.unique(key[len(ends):], return_index=True)
    if not np.isin(key[: len(ends)], known).all():
        return None
    middle = edges[first[np.searchsorted(known, key[: len(ends)])], 2]
    return np.column_stack([ends, middle])


def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Replace the places of points, the rows of exchanged cells, and what is told of moved corners.

    Raises
    ------
    NotRewritable    points came or went, to which cells or sections may refer that are not known
    """
    data = content(source)
    before, curved = change.before.cells, False
    lines = [i for i, block in enumerate(before) if block.type in LINES]
    found, label = segments(data)
    if change.renumbered:
        other = {block.type for block in before} - {*NODES, *LINES, "vertex"}
        if other:
            msg = f"points came or went, to which its cells of type {min(other)} may refer"
            raise NotRewritable(msg)
        for name in _sections(data.partition(b"endmesh")[0]):
            if not re.fullmatch(FOLLOWED + SEGMENTED * bool(found.rows), name):
                msg = f"points came or went, to which its section {name.decode()} may refer"
                raise NotRewritable(msg)
    edits = _placed(data, change)
    lost: list[str] = []
    for of in (SURFACE, VOLUME):
        kinds = [kind for kind in NODES if (kind[:3] == "tet") == (of == VOLUME)]
        own = [i for i, block in enumerate(before) if block.type in kinds]
        exchanged = [i for i in own if _changed(change, i)]
        moved = [i for i in own if of == SURFACE and _moved(change, i)]
        if not exchanged and not moved:
            continue
        cells = elements(data, of)
        if not exchanged and not any(row.parameters for row in cells.rows):
            continue
        curved |= bool(exchanged) and section(data, rb"curvedelements") is not None
        edits += _exchanged(data, change, cells, _blocks(
            change, cells.rows, {before[i].type for i in exchanged + moved}))
    if curved:
        found_at = CURVED.search(data)
        if found_at is None:
            msg = "it has curved elements, and cells were exchanged"
            raise NotRewritable(msg)
        edits.append((*found_at.span(), b""))
        lost.append("the section curvedelements")
    told = any(row.parameters for row in found.rows)
    if any(_changed(change, i) or (told and _moved(change, i)) for i in lines):
        parts = lines_of(found.rows, label)
        if len(parts) != len(lines):
            msg = "its segments are not the lines that were read"
            raise NotRewritable(msg)
        edits += _exchanged(data, change, found, [
            (i, own, [0, 1]) for i, own in zip(lines, parts, strict=True)])
    whole = edited(data, edits)
    target.write_bytes(gzip.compress(whole) if target.suffix.lower() == ".gz" else whole)
    return lost


def _changed(change: Change, block: int) -> bool:
    """Whether rows of a block of cells are others, or other ones of the file."""
    return bool(change.renumbered or change.exchanged(block).any() or not np.array_equal(
        change.cells[block], np.arange(len(change.before.cells[block].data))))


def _moved(change: Change, block: int) -> bool:
    """Whether nodes of a block of cells are new or elsewhere."""
    return bool(change.moved[change.after.cells[block].data].any())


def _placed(data: bytes, change: Change) -> list[Edit]:
    """What replaces coordinates of points, and the numbers of those that sections name."""
    found = section(data, rb"points")
    if found is None or found[1] != len(change.before.points):
        msg = "it has another number of points than were read"
        raise NotRewritable(msg)
    at = found[0]
    first = re.compile(rb"[^\r\n]*\S").search(data, at)
    width = 3 if first is None else len(first[0].split())
    rows = table(data, rb"points", width).rows
    points, moved = np.asarray(change.after.points), change.moved
    if not change.renumbered:
        return [(*span, repr(x).encode()) for v in np.flatnonzero(moved).tolist()
                for span, x in zip(rows[v].spans(data), points[v].tolist(), strict=False)]
    text = []
    for old, there, x in zip(change.points.tolist(), moved.tolist(), points.tolist(), strict=True):
        words = [repr(each) for each in [*x, 0.0][:width]]
        text.append(" ".join(words).encode() if there else data[rows[old].start: rows[old].stop])
    end = b"\r\n" if data[:at].rstrip(b" \t").endswith(b"\r\n") else b"\n"
    edits = [(*number_before(data, at), str(len(text)).encode()),
             (rows[0].start, rows[-1].stop, end.join(text))]
    number = change.number
    stay = []
    for name, (size, named) in KEPT.items():
        found_rows = table(data, name, size)
        if found_rows.rows and name == b"identifications" and not _correspond(change):
            edits += [(*found_rows.number, b"0"), (found_rows.rows[0].start, found_rows.stop, b"")]
            continue
        stay += [(name.decode(), row, range(named)) for row in found_rows.rows]
    if not any(block.type in LINES for block in change.before.cells):
        stay += [("edgesegments", row, row.nodes) for row in segments(data)[0].rows]
    for section_name, row, of in stay:
        new = number[[int(row.words[k]) - 1 for k in of]] + 1
        if not new.all():
            msg = f"points went to which its section {section_name} refers"
            raise NotRewritable(msg)
        spans = row.spans(data)
        edits += [(*spans[k], b"%d" % each) for k, each in zip(of, new.tolist(), strict=True)]
    return edits


def _correspond(change: Change) -> bool:
    """Whether identified points stay, and labels have no others whose faces had only these."""
    before, kind = change.before, "line" if change.before.points.shape[1] == 2 else "triangle"
    held = np.zeros(len(before.points), dtype=np.bool_)
    held[before.identified] = True
    still = (change.points >= 0) & held[change.points]
    if still.sum() < held.sum():
        return False
    for i, block in enumerate(before.cells):
        if block.type.startswith(kind) and INDEX in before.cell_data:
            label = np.asarray(before.cell_data[INDEX][i])
            loose = label[~held[block.data].all(axis=1)]
            whole = ~np.isin(label[change.cells[i]], loose)
            if not still[np.asarray(change.after.cells[i].data)[whole]].all():
                return False
    return True


def _blocks(
    change: Change, rows: Sequence[Row], kinds: set[str]
) -> list[tuple[int, NDArray[np.int64], list[int]]]:
    """For every block of some types: its number, its rows in the file, and their order of nodes."""
    out = []
    for kind in sorted(kinds):
        size = NODES[kind]
        own = np.array([r for r, row in enumerate(rows) if len(row.nodes) == size])
        nodes = np.array([rows[r].points() for r in own]).reshape(-1, size)
        blocks = [i for i, block in enumerate(change.before.cells) if block.type == kind]
        before = np.concatenate([change.before.cells[i].data for i in blocks])
        order = next((p for p in (list(range(size)), ORDERS.get(kind, []))
                      if len(p) == size and nodes.shape == before.shape
                      and np.array_equal(before[:, p], nodes)), None)
        if order is None:
            msg = f"its rows of type {kind} are in another order than were read"
            raise NotRewritable(msg)
        ends = np.cumsum([len(change.before.cells[i].data) for i in blocks])[:-1]
        out += [(i, part, order) for i, part in zip(blocks, np.split(own, ends), strict=True)]
    return out


def _exchanged(
    data: bytes, change: Change, found: Rows, parts: Sequence[tuple[int, Any, list[int]]]
) -> list[Edit]:
    """What replaces the rows of a section: every row is followed by those that come from it.

    ``parts`` are the blocks of cells with the rows that they are, and the order of their nodes.
    """
    rows = found.rows
    lines: dict[int, list[bytes]] = {}
    for i, own, order in parts:
        lines |= {r: [] for r in own.tolist()}
        after = np.asarray(change.after.cells[i].data)[:, order]
        old, fresh = own[change.cells[i]], change.exchanged(i) | change.renumbered
        if rows and rows[0].parameters:
            fresh = fresh | change.moved[change.after.cells[i].data].any(axis=1)
        there = iter(_told(change, rows, old[fresh], after[fresh]))
        for r, nodes, other in zip(old.tolist(), (after.astype(np.int64) + 1).tolist(),
                                   fresh.tolist(), strict=True):
            row = rows[r]
            lines[r].append(_with_words(row, nodes, next(there)) if other
                            else data[row.start: row.stop])
    gaps = [data[one.stop: two.start] for one, two in pairwise(rows)]
    gaps = [*gaps[:1], *gaps]
    out = [(gap, text) for r, (row, gap) in enumerate(zip(rows, gaps or [b""], strict=True))
           for text in lines.get(r, [data[row.start: row.stop]])]
    body = b"".join(part for pair in out for part in pair)[len(out[0][0]) if out else 0:]
    return [(*found.number, str(len(out)).encode()), (rows[0].start, found.stop, body)]


def _told(
    change: Change, rows: Sequence[Row], old: NDArray[np.int64], after: NDArray[Any]
) -> list[list[tuple[int, bytes]]]:
    """Words, and their places, that tell of nodes ``after`` (m, k) of rows that come from ``old``.

    Parameters are linear on the old row, numbers are those of its nearest node. Of what other rows
    tell of a node that is where it was, it is the nearest to that, as both sides of a seam tell
    others.
    """
    own = [rows[r] for r in old.tolist()]
    if not own or not own[0].parameters:
        return [[] for _ in own]
    known: dict[tuple[bytes, int], dict[tuple[float, ...], None]] = {}
    for row in rows:
        for k, node in enumerate(row.points()):
            known.setdefault((row.of, node), {})[row.values(k)] = None
    count, numbers = min(after.shape[1], 3), own[0].numbers
    places = np.asarray(change.after.points)[after]
    corners = np.asarray(change.before.points)[[row.points()[:count] for row in own]]
    values = np.array([[row.values(k) for k in range(count)] for row in own])
    part = _parts(places - corners[:, :1], corners[:, 1:] - corners[:, :1])
    rise = values[:, 1:] - values[:, :1]
    told = values[:, :1] + (part[..., None] * rise[:, None]).sum(axis=2)
    nearest = ((places[:, :, None] - corners[:, None]) ** 2).sum(axis=3).argmin(axis=2)
    told[..., :numbers] = np.take_along_axis(values, nearest[..., None], axis=1)[..., :numbers]
    came = np.where(change.moved, -1, change.points)[after]
    out = []
    for row, nodes, here in zip(own, came.tolist(), told.tolist(), strict=True):
        words = []
        for node, at, each in zip(nodes, row.parameters, here, strict=False):
            others = known.get((row.of, node), (each,))
            best = min(others, key=lambda other, each=each: [
                max((abs(a - b) for a, b in zip(other[part], each[part], strict=True)), default=0)
                for part in (slice(numbers, None), slice(numbers))])
            words += [(place, repr(value if i >= numbers else int(value)).encode())
                      for i, (place, value) in enumerate(zip(at, best, strict=True))]
        out.append(words)
    return out


def _parts(ways: NDArray[Any], sides: NDArray[Any]) -> NDArray[Any]:
    """How much (m, k, s) of each of one or two sides (m, s, d) there is in ways (m, k, d)."""
    along = (ways[:, :, None] * sides[:, None]).sum(axis=3)
    inner = (sides[:, :, None] * sides[:, None]).sum(axis=3)
    if sides.shape[1] == 1:
        other, square = along, inner[:, 0, 0]
    else:
        other = along * inner[:, None, [1, 0], [1, 0]] - along[..., ::-1] * inner[:, None, :1, 1]
        square = inner[:, 0, 0] * inner[:, 1, 1] - inner[:, 0, 1] ** 2
    square = square[:, None, None]
    out: NDArray[Any] = np.divide(other, square, out=np.zeros_like(other), where=square > 0.0)
    return out


def _with_words(row: Row, nodes: Sequence[int], told: Sequence[tuple[int, bytes]]) -> bytes:
    """A row with other nodes, and other words at some places."""
    words = list(row.words)
    words[row.nodes.start: row.nodes.stop] = [b"%d" % node for node in nodes]
    for place, word in told:
        words[place] = word
    return b" ".join(words)
