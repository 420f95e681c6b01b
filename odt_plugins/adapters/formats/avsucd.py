"""AVS's unstructured cell data, .avs: also arrays of cells of several types, as text."""

from __future__ import annotations

from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.decks import refuse_types
from odt_plugins.adapters.formats.titles import decoded
from odt_plugins.errors import MeshFileError

LABEL = "avsucd:material"
"""Array of the materials of cells."""

MOST = float(np.finfo(np.float32).max)
"""Largest number of an array."""

TYPES = {
    "pt": ("vertex", [0]), "line": ("line", [0, 1]), "tri": ("triangle", [0, 1, 2]),
    "quad": ("quad", [0, 1, 2, 3]), "tet": ("tetra", [0, 1, 3, 2]),
    "pyr": ("pyramid", [1, 2, 3, 4, 0]), "prism": ("wedge", [3, 4, 5, 0, 1, 2]),
    "hex": ("hexahedron", [4, 5, 6, 7, 0, 1, 2, 3]),
}
"""Types of cells by the words of files, and where each of their nodes stands in a row."""


class _Lines:
    """Lines of a file that are not empty, behind the remarks at its start."""

    def __init__(self, data: bytes) -> None:
        self.lines = [line for line in data.splitlines() if line.strip()]
        self.at = 0
        while self.lines[self.at: self.at + 1] and self.lines[self.at].lstrip().startswith(b"#"):
            self.at += 1

    def take(self, count: int, what: str, width: int = 0) -> list[bytes]:
        """The next lines, so many words at least in each."""
        found = self.lines[self.at: self.at + count]
        if len(found) < count:
            msg = f"it declares {count} lines of {what} and holds {len(found)}"
            raise MeshFileError(msg)
        if width and any(len(line.split()) < width for line in found):
            msg = f"a line of {what} ends before its {width} words"
            raise MeshFileError(msg)
        self.at += count
        return found

    def words(self, count: int, what: str, width: int) -> list[list[bytes]]:
        """The words of the next lines."""
        return [line.split() for line in self.take(count, what, width)]

    def table(self, count: int, what: str, width: int) -> tuple[list[int], NDArray[np.float64]]:
        """Numbers at the starts of the next lines, and so many values (count, width) behind each.

        Exponents may be as Fortran writes them.
        """
        rows = self.take(count, what, width + 1)
        text = b"\n".join(rows).translate(bytes.maketrans(b"Dd", b"ee"))
        values = np.loadtxt(text.splitlines(), usecols=range(width + 1), comments=None,
                            ndmin=2) if rows else np.zeros((0, width + 1))
        own = values[:, 0].astype(np.int64)
        there, times = np.unique(own, return_counts=True)
        if len(there) < count:
            msg = f"it has {times.max()} lines of {what} {there[times.argmax()]}"
            raise MeshFileError(msg)
        return own.tolist(), values[:, 1:]


def read(path: Path) -> Any:
    """Read points, cells with their materials, and arrays of both.

    Returns
    -------
    meshio.Mesh      a block a type of cells

    Raises
    ------
    MeshFileError    it ends too early, or has cells of an unknown type
    """
    from meshio import Mesh

    lines = _Lines(path.read_bytes())
    n, m, of_points, of_cells = map(int, lines.words(1, "its head", 4)[0][:4])
    numbers, points = lines.table(n, "nodes", 3)
    node = {number: i for i, number in enumerate(numbers)}
    rows = lines.words(m, "cells", 3)
    where: dict[str, list[int]] = {}
    for i, row in enumerate(rows):
        where.setdefault(row[2].decode("latin-1").lower(), []).append(i)
    cells: list[Any] = []
    for word, of in where.items():
        kind, order = TYPES.get(word, ("", []))
        least = min(len(rows[i]) for i in of) - 3
        if not kind or least < len(order):
            msg = f"it has a cell of type {word} with {least} nodes"
            raise MeshFileError(msg)
        nodes = [[node[int(k)] for k in rows[i][3: 3 + len(order)]] for i in of]
        cells.append((kind, np.array(nodes)[:, order]))
    cell = {int(row[0]): i for i, row in enumerate(rows)}
    materials = np.array([int(row[1]) for row in rows], dtype=np.int64)
    point_data = _arrays(lines, node, "values of nodes") if of_points else {}
    cell_data = _arrays(lines, cell, "values of cells", LABEL) if of_cells else {}
    return Mesh(points, cells, point_data, {
        name: [values[of] for of in where.values()]
        for name, values in ({LABEL: materials} | cell_data).items()})


def write(path: Path, mesh: Any, binary: bool | None) -> list[str]:
    """Write points, cells with their materials, which are 0 without any, and arrays of both.

    Arrays with numbers that VTK does not read, which breaks off there, are left out.

    Raises
    ------
    UnsupportedMeshError    there are cells of a type that the format does not know
    """
    del binary
    words = {kind: (word, np.argsort(order)) for word, (kind, order) in TYPES.items()}
    refuse_types({block.type for block in mesh.cells if len(block.data)} - words.keys())
    points = np.zeros((len(mesh.points), 3))
    points[:, : np.shape(mesh.points)[1]] = mesh.points
    labels = mesh.cell_data.get(LABEL, [np.zeros(len(b.data), dtype=np.int64) for b in mesh.cells])
    of_cells = {name: np.concatenate(parts) for name, parts in mesh.cell_data.items()
                if name != LABEL and len(parts)}
    data = [{name: values for name, values in own.items() if np.all(np.abs(values) <= MOST)}
            for own in (mesh.point_data, of_cells)]
    cells = [f"{material} {words[block.type][0]} {' '.join(map(str, row))}"
             for block, own in zip(mesh.cells, labels, strict=True) if len(block.data)
             for material, row in zip(np.asarray(own).tolist(), (np.asarray(block.data)[
                 :, words[block.type][1]].astype(np.int64) + 1).tolist(), strict=True)]
    tables = [[np.asarray(values, dtype=np.float64).reshape(
        len(values), int(np.prod(np.shape(values)[1:]))) for values in own.values()]
        for own in data]
    widths = [sum(part.shape[1] for part in table) for table in tables]
    lines = [f"{len(points)} {len(cells)} {widths[0]} {widths[1]} 0"]
    lines += [f"{i} {' '.join(map(repr, place))}" for i, place in enumerate(points.tolist(), 1)]
    lines += [f"{i} {cell}" for i, cell in enumerate(cells, 1)]
    for own, table in zip(data, tables, strict=True):
        if table:
            lines.append(" ".join(map(str, [len(table), *(part.shape[1] for part in table)])))
            lines += [f"{name}, real" for name in own]
            lines += [f"{i} {' '.join(map(repr, row))}"
                      for i, row in enumerate(np.concatenate(table, axis=1).tolist(), 1)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return []


def _arrays(lines: _Lines, place: dict[int, int], what: str, *taken: str) -> dict[str, Any]:
    """Arrays by their names, other than some, and each once; `place` has that of each number."""
    widths = [int(word) for word in lines.words(1, what, 1)[0][1:]]
    names = [decoded(line).rpartition(",")[0].strip() or decoded(line).strip()
             for line in lines.take(len(widths), what)]
    own, values = lines.table(len(place), what, sum(widths))
    table = np.zeros(values.shape)
    table[[place[number] for number in own]] = values
    out: dict[str, Any] = {}
    for name, part in zip(names, np.split(table, np.cumsum(widths)[:-1], axis=1), strict=True):
        free = (title for title in chain([name], (f"{name}_{k}" for k in count(2)))
                if title not in {*out, *taken})
        out[next(free)] = part[:, 0] if part.shape[1] == 1 else part
    return out
