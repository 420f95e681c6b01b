"""TetGen's and Triangle's files, .node and .ele, with the faces and edges beside them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.change import Change
from odt_plugins.adapters.formats.decks import (
    Edit,
    Row,
    as_lines,
    edited,
    expect_points,
    numbers,
    real,
    refuse_types,
    rows_of,
)
from odt_plugins.errors import MeshFileError, counted

REF, ATTRIBUTE = "tetgen:ref", "tetgen:attr"
"""Array of the markers of points and faces, and of the first attribute of cells; attributes of
points, with their number."""

KINDS = {
    (3, 4): ("tetra", [0, 1, 2, 3]), (3, 10): ("tetra10", [0, 1, 2, 3, 6, 7, 9, 5, 8, 4]),
    (2, 3): ("triangle", [0, 1, 2]), (2, 6): ("triangle6", [0, 1, 2, 5, 3, 4]),
}
"""Types of cells by dimension and number of points, and where each point stands in a row."""

BESIDE = {".face": ("triangle", "triangle6"), ".edge": ("line", "line3")}
"""Files beside: types of their cells, of first and of second order."""

WIDTH = {"triangle": 3, "triangle6": 6, "line": 2, "line3": 3}
"""Numbers of points of these."""

STALE = (".neigh", ".v.node", ".v.edge", ".v.face", ".v.cell")
"""Files beside that tell of neighbours, which are others afterwards."""


class Table(NamedTuple):
    """A file: its text, its numbers of entries and what follows these, and its rows."""

    data: bytes
    head: Row
    counts: list[int]
    rows: list[Row]


def read(path: Path) -> Any:
    """Read points and cells, and the faces and edges that have a marker.

    Returns
    -------
    meshio.Mesh      tetrahedra, or triangles where points have two coordinates

    Raises
    ------
    MeshFileError    a file ends too early, numbers have gaps, or cells are of another order
    """
    from meshio import Mesh

    nodes, cells = _table(path.with_suffix(".node"), 4), _table(path.with_suffix(".ele"), 3)
    first = int(nodes.rows[0].words[0]) if nodes.rows else 0
    if [int(row.words[0]) for row in nodes.rows] != list(range(first, first + len(nodes.rows))):
        msg = "its points are not numbered one after another"
        raise MeshFileError(msg)
    dim, attributes, marks = nodes.counts[1:4]
    table = np.array([numbers(row.words[1: 1 + dim + attributes + marks]) for row in nodes.rows])
    table = table.reshape(len(nodes.rows), dim + attributes + marks)
    size, more = cells.counts[1:3]
    if (dim, size) not in KINDS:
        msg = (f"it has cells of {size} points in {dim} dimensions, expected 4 or 10 in space, or "
               f"3 or 6 in the plane")
        raise MeshFileError(msg)
    kind, places = KINDS[dim, size]
    rows = _cells(cells, size, first, len(nodes.rows))[:, places]
    point_data: dict[str, Any] = {f"{ATTRIBUTE}{k + 1}": table[:, dim + k]
                                  for k in range(attributes)}
    point_data |= {_ref(k): _whole(table[:, dim + attributes + k]) for k in range(marks)}
    own = [numbers(row.words[1 + size: 1 + size + more]) for row in cells.rows]
    values = np.array(own, dtype=np.float64).reshape(len(cells.rows), more)
    blocks: list[Any] = [(kind, rows)]
    refs: dict[str, list[Any]] = {_ref(k): [_whole(values[:, k])] for k in range(more)}
    for suffix, kind in _files_beside(dim, size):
        beside = _beside(path, suffix)
        marked = [] if beside is None else _marked(beside, WIDTH[kind])
        if beside is not None and marked:
            part = beside._replace(rows=[row for row, _ in marked])
            blocks.append((kind, _cells(part, WIDTH[kind], first, len(nodes.rows))))
            refs.setdefault(REF, [np.zeros(len(rows), dtype=np.int64)] * (len(blocks) - 1))
            for name, arrays in refs.items():
                arrays.append(np.array([mark if name == REF else 0 for _, mark in marked]))
    return Mesh(table[:, :dim], blocks, point_data, refs)


def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Replace the places of points that moved and the rows of cells, and write what lies beside.

    All rows are written anew where points came or went.
    """
    nodes, cells = _table(source.with_suffix(".node"), 4), _table(source.with_suffix(".ele"), 3)
    first = int(nodes.rows[0].words[0]) if nodes.rows else 0
    dim, size = nodes.counts[1], cells.counts[1]
    places = np.argsort(KINDS[dim, size][1])
    after, own = change.after, np.asarray(change.after.cells[0].data)[:, places]
    names = [f"{ATTRIBUTE}{k + 1}" for k in range(nodes.counts[2])]
    if change.renumbered:
        marks = [_ref(k) for k in range(nodes.counts[3])]
        target.with_suffix(".node").write_bytes(_replaced(
            nodes, first, np.asarray(after.points),
            *(np.asarray(after.point_data[name]) for name in names + marks)))
        target.with_suffix(".ele").write_bytes(_replaced(
            cells, first, own + first,
            *(np.asarray(after.cell_data[_ref(k)][0]) for k in range(cells.counts[2]))))
    else:
        before, now = (np.column_stack([mesh.points, *(mesh.point_data[name] for name in names)])
                       for mesh in (change.before, after))
        words: Any = now.tolist()
        target.with_suffix(".node").write_bytes(edited(nodes.data, [
            as_lines(nodes.data, nodes.rows[v], [
                {k: real(x) for k, x in enumerate(words[v], 1) if x != before[v, k - 1]}])
            for v in np.flatnonzero((before != now).any(axis=1)).tolist()]))
        lines: list[list[dict[int, Any]]] = [[] for _ in cells.rows]
        for row, r in zip((own + first).tolist(), change.cells[0].tolist(), strict=True):
            lines[r].append(dict(enumerate(row, 1)))
        target.with_suffix(".ele").write_bytes(_written(cells, lines))
    lost = []
    blocks = {block.type: i for i, block in enumerate(after.cells)}
    for suffix, kind in _files_beside(dim, size):
        beside = _beside(source, suffix)
        if beside is None:
            continue
        i = blocks.get(kind)
        if change.renumbered or (i is not None and change.exchanged(i).any()):
            gone = len(beside.rows) - len(_marked(beside, WIDTH[kind]))
            parts: list[Any] = [np.zeros((0, WIDTH[kind])), np.zeros(0)] if i is None else [
                np.asarray(after.cells[i].data) + first, np.asarray(after.cell_data[REF][i])]
            if not beside.counts[1]:
                del parts[1]
            data = _replaced(beside, first, *parts)
        else:
            here = _parts_of(own[:, : dim + 1], int(WIDTH[BESIDE[suffix][0]]))
            rows = _cells(beside, WIDTH[kind], first, len(nodes.rows))
            there = [tuple(sorted(row)) in here
                     for row in rows[:, : WIDTH[BESIDE[suffix][0]]].tolist()]
            gone = there.count(False)
            data = _written(beside, [[{}] if keep else [] for keep in there])
        target.with_suffix(suffix).write_bytes(data)
        if gone:
            lost.append(f"{counted(gone, 'cell')} of type {kind} without a marker in {suffix}")
    stale = [suffix for suffix in STALE if source.with_suffix(suffix).is_file()]
    return lost + [f"{source.stem}{suffix}, which tells of neighbours" for suffix in stale]


def write(path: Path, mesh: Any, binary: bool | None) -> list[str]:
    """Write tetrahedra with their labels, and triangles and lines, which have a marker.

    The mesh is in space, with at most one block of each type.

    Raises
    ------
    UnsupportedMeshError    the format does not hold such cells
    """
    del binary
    of = {kind: (dim, size) for (dim, size), (kind, _) in KINDS.items() if dim == 3}
    main = next((block.type for block in mesh.cells if block.type in of), "tetra")
    beside = {kind: suffix for suffix, kind in _files_beside(*of[main])}
    refuse_types({block.type for block in mesh.cells} - {main, *beside})
    labels = mesh.cell_data.get(REF)
    points = np.asarray(mesh.points)
    marks = [np.asarray(mesh.point_data[REF])] if REF in mesh.point_data else []
    _write(path.with_suffix(".node"), [points.shape[1], 0, len(marks)], points, *marks)
    for i, block in enumerate(mesh.cells):
        rows = np.asarray(block.data)
        own = [] if labels is None else [np.asarray(labels[i])]
        if block.type == main:
            places = np.argsort(KINDS[of[main]][1])
            _write(path.with_suffix(".ele"), [len(places), len(own)], rows[:, places], *own)
        else:
            mark = own[0] if own else np.ones(len(rows), dtype=np.int64)
            _write(path.with_suffix(beside[block.type]), [1], rows, np.where(mark == 0, -1, mark))
    return []


def _write(path: Path, counts: list[int], *columns: NDArray[Any]) -> None:
    """Write a file whose rows are numbered from 0 on."""
    head = " ".join(map(str, [len(columns[0]), *counts])).encode() + b"\n"
    path.write_bytes(head + _lines(0, b"\n", columns))


def _lines(first: int, end: bytes, columns: Sequence[NDArray[Any]]) -> bytes:
    """Rows of numbers behind their own."""
    words = [[real(x) if isinstance(x, float) else b"%d" % x for x in column.ravel().tolist()]
             for column in columns]
    widths = [column[:1].size for column in columns]
    return b"".join(b" ".join([b"%d" % (first + i), *(
        word for text, width in zip(words, widths, strict=True)
        for word in text[i * width: (i + 1) * width])]) + end for i in range(len(columns[0])))


def _replaced(table: Table, first: int, *columns: NDArray[Any]) -> bytes:
    """A file with other rows; what stands before and behind all of them stays."""
    head = table.data[table.head.start: table.head.stop]
    end = head[len(head.rstrip(b"\r\n")):] or b"\n"
    start = table.rows[0].start if table.rows else table.head.stop
    stop = table.rows[-1].stop if table.rows else table.head.stop
    return edited(table.data, [as_lines(table.data, table.head, [{0: len(columns[0])}]),
                               (start, stop, _lines(first, end, columns))])


def _files_beside(dim: int, size: int) -> list[tuple[str, str]]:
    """Suffixes of the files beside cells of so many points, and the types of their cells."""
    second = size > dim + 1
    return [(suffix, kinds[second]) for suffix, kinds in BESIDE.items()
            if dim == 3 or suffix == ".edge"]


def _ref(k: int) -> str:
    return REF + (str(k + 1) if k else "")


def _whole(values: NDArray[np.float64]) -> NDArray[Any]:
    """Integers where all values are such."""
    whole = np.isfinite(values).all() and (values == np.rint(values)).all()
    return values.astype(np.int64) if whole else values


def _table(path: Path, least: int) -> Table:
    data = path.read_bytes()
    rows = list(rows_of(data, b"#"))
    if not rows:
        msg = f"{path.name} ends before it says how much it holds"
        raise MeshFileError(msg)
    counts = [int(word) for word in rows[0].words]
    counts += [0] * (least - len(counts))
    if len(rows) - 1 != counts[0]:
        msg = f"{path.name} declares {counts[0]} entries and holds {len(rows) - 1}"
        raise MeshFileError(msg)
    return Table(data, rows[0], counts, rows[1:])


def _beside(path: Path, suffix: str) -> Table | None:
    other = path.with_suffix(suffix)
    return _table(other, 2) if other.is_file() else None


def _marked(table: Table, width: int) -> list[tuple[Row, int]]:
    """Rows that have a marker other than 0, each with its marker."""
    if not table.counts[1]:
        return []
    return [(row, int(row.words[1 + width])) for row in table.rows
            if int(row.words[1 + width]) != 0]


def _cells(table: Table, width: int, first: int, count: int) -> NDArray[np.int64]:
    """Points of cells, whose numbers begin with the first."""
    rows = [[int(word) for word in row.words[1: 1 + width]] for row in table.rows]
    if any(len(row) != width for row in rows):
        msg = f"a row ends before its {width} points"
        raise MeshFileError(msg)
    cells = np.array(rows, dtype=np.int64).reshape(-1, width) - first
    expect_points(cells, count, first)
    return cells


def _parts_of(cells: NDArray[Any], width: int) -> set[tuple[int, ...]]:
    """Corners of all faces or edges of cells."""
    rows = np.sort(cells, axis=1)
    picks = [list(pick) for pick in combinations(range(cells.shape[1]), width)]
    return set(map(tuple, rows[:, picks].reshape(-1, width).tolist()))


def _written(table: Table, lines: list[list[dict[int, Any]]]) -> bytes:
    """A file with other lines in the places of its rows, which are numbered one after another."""
    number = int(table.rows[0].words[0]) if table.rows else 0
    edits: list[Edit] = []
    for row, parts in zip(table.rows, lines, strict=True):
        for part in parts:
            part[0] = number
            number += 1
        edits.append(as_lines(table.data, row, parts))
    count = sum(map(len, lines))
    if count != len(table.rows):
        edits.append(as_lines(table.data, table.head, [{0: count}]))
    return edited(table.data, edits)
