"""AFLR's UGRID files: text in all digits, and binary ones with the records that Fortran reads."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.decks import refuse_types
from odt_plugins.errors import MeshFileError

REF = "ugrid:ref"
"""Array of the numbers of boundaries, 0 of volumes."""

KIND = r"(l?)(b|r)([48])(l?)"
"""What stands before the suffix of binary files: order of bytes, C or Fortran, widths."""

FLAT = {"triangle": 3, "quad": 4}
SOLID = {"tetra": 4, "pyramid": 5, "wedge": 6, "hexahedron": 8}
"""Types of cells, in the order of files, and their numbers of nodes."""

PYRAMID = [1, 0, 3, 4, 2]
"""Places in a file of the nodes of pyramids."""


class Form(NamedTuple):
    """How a file holds its numbers: types of reals and integers, and whether Fortran wrote it."""

    real: str
    whole: str
    fortran: bool


def form_of(path: Path) -> Form | None:
    """Form of a binary file, by its name; None of one of text."""
    parts = path.name.split(".")
    found = re.fullmatch(KIND, parts[-2]) if len(parts) > 1 else None
    if found is None:
        return None
    order = "<" if found[1] else ">"
    return Form(f"{order}f{found[3]}", f"{order}i{8 if found[4] else 4}", found[2] == "r")


class _Source:
    """Numbers of a file, one after another."""

    def __init__(self, path: Path) -> None:
        self.form = form_of(path)
        self.data: Any = path.read_bytes()
        self.at = 0
        if self.form is None:
            self.data = re.sub(rb"([\d.])[dD]([+-]?\d)", rb"\1e\2", self.data).split()

    def take(self, count: int, *, real: bool = False) -> NDArray[Any]:
        """Take the next numbers.

        Raises
        ------
        MeshFileError    there are fewer
        """
        form = self.form or Form("f8", "i8", fortran=False)
        kind = np.dtype(form.real if real else form.whole)
        size = count * (kind.itemsize if self.form else 1)
        piece = self.data[self.at: self.at + size]
        if count < 0 or len(piece) < size:
            msg = "it ends too early"
            raise MeshFileError(msg)
        self.at += size
        if self.form:
            return np.frombuffer(piece, kind).astype(kind.newbyteorder("="))
        return np.array(piece, dtype="S").astype(np.float64 if real else np.int64)

    def mark(self) -> None:
        """Step over what Fortran puts before and behind a record."""
        self.at += 4 * bool(self.form and self.form.fortran)


def read(path: Path) -> Any:
    """Read points, boundaries with their numbers, and volumes.

    Raises
    ------
    MeshFileError    it ends too early, or a cell refers to a point that is not there
    """
    from meshio import Mesh

    source = _Source(path)
    source.mark()
    head = source.take(7).tolist()
    source.mark()
    source.mark()
    points = source.take(3 * head[0], real=True).reshape(-1, 3)
    cells, labels = [], []
    for count, (kind, width) in zip(head[1:3], FLAT.items(), strict=True):
        cells.append((kind, source.take(count * width).reshape(-1, width)))
    labels = [source.take(count).astype(np.int64) for count in head[1:3]]
    for count, (kind, width) in zip(head[3:], SOLID.items(), strict=True):
        rows = source.take(count * width).reshape(-1, width)
        cells.append((kind, rows[:, PYRAMID] if kind == "pyramid" else rows))
        labels.append(np.zeros(count, dtype=np.int64))
    for kind, rows in cells:
        bad = rows[(rows < 1) | (rows > len(points))]
        if bad.size:
            msg = f"a {kind} refers to point {bad[0]} of {len(points)}"
            raise MeshFileError(msg)
    there = [i for i, (_, rows) in enumerate(cells) if len(rows)]
    return Mesh(points, [(cells[i][0], cells[i][1].astype(np.int64) - 1) for i in there],
                cell_data={REF: [labels[i] for i in there]})


def write(path: Path, mesh: Any, binary: bool | None) -> list[str]:
    """Write points, boundaries with their numbers, and volumes, in the form that the name tells.

    The mesh has at most one block of each type.

    Raises
    ------
    UnsupportedMeshError    the format does not hold such cells
    """
    del binary
    known = FLAT | SOLID
    place = {block.type: i for i, block in enumerate(mesh.cells)}
    refuse_types(place.keys() - known.keys())
    rows = {kind: np.asarray(mesh.cells[i].data, dtype=np.int64) + 1 for kind, i in place.items()}
    if "pyramid" in rows:
        rows["pyramid"] = rows["pyramid"][:, np.argsort(PYRAMID)]
    labels = mesh.cell_data.get(REF)
    marks = {kind: np.ones(len(rows[kind]), dtype=np.int64) if labels is None
             else np.asarray(labels[place[kind]]) for kind in FLAT if kind in rows}
    head = np.array([[len(mesh.points), *(len(rows.get(kind, ())) for kind in known)]])
    tables = [*(rows[kind] for kind in FLAT if kind in rows),
              *(mark.reshape(-1, 1) for mark in marks.values()),
              *(rows[kind] for kind in SOLID if kind in rows)]
    form = form_of(path)
    if form is None:
        lines = [" ".join(map(repr, row)) for table in (head, np.asarray(mesh.points), *tables)
                 for row in table.tolist()]
        path.write_text("\n".join(lines) + "\n")
        return []
    first = head.astype(form.whole).tobytes()
    second = np.asarray(mesh.points).astype(form.real).tobytes()
    second += b"".join(table.astype(form.whole).tobytes() for table in tables)
    path.write_bytes(first + second if not form.fortran
                     else b"".join(_record(piece, form) for piece in (first, second)))
    return []


def _record(piece: bytes, form: Form) -> bytes:
    """A record of Fortran: its number of bytes before and behind."""
    count = np.array([len(piece)]).astype(form.whole[0] + "u4").tobytes()
    return count + piece + count
