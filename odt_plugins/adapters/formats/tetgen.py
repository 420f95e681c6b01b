"""TetGen's and Triangle's files, .node and .ele, with the faces and edges beside them."""

from __future__ import annotations

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
    expect_same_points,
    numbers,
    real,
    rows_of,
)
from odt_plugins.errors import MeshFileError

REF = "tetgen:ref"
"""Array of the markers of points and faces, and of the first attribute of cells."""

BESIDE = {".face": ("triangle", 3), ".edge": ("line", 2)}
"""Files beside: types of their cells and numbers of points of these."""

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
    MeshFileError    a file ends too early, numbers have gaps, or cells are of second order
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
    if dim not in (2, 3) or size != dim + 1:
        msg = f"it has cells of {size} points in {dim} dimensions, expected {dim + 1} points"
        raise MeshFileError(msg)
    rows = _cells(cells, size, first, len(nodes.rows))
    point_data: dict[str, Any] = {f"tetgen:attr{k + 1}": table[:, dim + k]
                                  for k in range(attributes)}
    point_data |= {_ref(k): _whole(table[:, dim + attributes + k]) for k in range(marks)}
    own = [numbers(row.words[1 + size: 1 + size + more]) for row in cells.rows]
    values = np.array(own, dtype=np.float64).reshape(len(cells.rows), more)
    blocks: list[Any] = [("tetra" if dim == 3 else "triangle", rows)]
    refs: dict[str, list[Any]] = {_ref(k): [_whole(values[:, k])] for k in range(more)}
    for suffix, (kind, width) in BESIDE.items() if dim == 3 else ():
        beside = _beside(path, suffix)
        marked = [] if beside is None else _marked(beside, width)
        if beside is not None and marked:
            part = beside._replace(rows=[row for row, _ in marked])
            blocks.append((kind, _cells(part, width, first, len(nodes.rows))))
            refs.setdefault(REF, [np.zeros(len(rows), dtype=np.int64)] * (len(blocks) - 1))
            for name, arrays in refs.items():
                arrays.append(np.array([mark if name == REF else 0 for _, mark in marked]))
    return Mesh(table[:, :dim], blocks, point_data, refs)


def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Replace the places of points that moved and the rows of cells, and write what lies beside.

    Raises
    ------
    NotRewritable    points came or went
    """
    expect_same_points(change)
    nodes, cells = _table(source.with_suffix(".node"), 4), _table(source.with_suffix(".ele"), 3)
    first = int(nodes.rows[0].words[0]) if nodes.rows else 0
    names = [f"tetgen:attr{k + 1}" for k in range(nodes.counts[2])]
    before, now = (np.column_stack([mesh.points, *(mesh.point_data[name] for name in names)])
                      for mesh in (change.before, change.after))
    words: Any = now.tolist()
    target.with_suffix(".node").write_bytes(edited(nodes.data, [
        as_lines(nodes.data, nodes.rows[v], [
            {k: real(x) for k, x in enumerate(words[v], 1) if x != before[v, k - 1]}])
        for v in np.flatnonzero((before != now).any(axis=1)).tolist()]))
    lines: list[list[dict[int, Any]]] = [[] for _ in cells.rows]
    after: Any = np.asarray(change.after.cells[0].data).tolist()
    for i, r in enumerate(change.cells[0].tolist()):
        lines[r].append(dict(enumerate((v + first for v in after[i]), 1)))
    target.with_suffix(".ele").write_bytes(_written(cells, lines))
    lost = []
    for suffix, (kind, width) in BESIDE.items():
        beside = _beside(source, suffix)
        if beside is None:
            continue
        here = _parts_of(np.asarray(change.after.cells[0].data), width)
        rows = _cells(beside, width, first, len(nodes.rows))
        there = [tuple(sorted(row)) in here for row in rows.tolist()]
        target.with_suffix(suffix).write_bytes(
            _written(beside, [[{}] if keep else [] for keep in there]))
        gone = there.count(False)
        if gone:
            lost.append(f"{gone} cells of type {kind} without a marker in {suffix}")
    stale = [suffix for suffix in STALE if source.with_suffix(suffix).is_file()]
    return lost + [f"{source.stem}{suffix}, which tells of neighbours" for suffix in stale]


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
    """Rows that have a marker other than 0, and these."""
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
