"""Meshes of Fluent, which tell of faces and the cells beside them: the cells are put together."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.decks import UNREAD
from odt_plugins.errors import MeshFileError

ZONE = "ansys:zone"
"""Array of the numbers of zones."""

POINTS, CELLS, FACES = 10, 12, 13
"""Numbers of sections."""

NAMES = (39, 45)
"""Numbers of the sections with names of zones."""

MIXED = (0, 5)
"""Types of faces whose rows start with their numbers of nodes, or with their type."""

INTERIOR = 2
"""Type of zones of faces inside."""


FORM = "types of zones of Fluent (.msh files are written as those of Gmsh)"
"""What no result has of a file."""


class Section(NamedTuple):
    """A section: its number, what stands in its head, and its numbers, None of a declaration."""

    number: int
    head: list[int]
    rows: Any


def has_faces(path: Path) -> bool:
    """Whether a file has faces with numbers of nodes and cells, and not cells alone."""
    return re.search(rb"\(\s*(?:20|30)?13\s*\([^()]*\)\s*\(", path.read_bytes()) is not None


def completed(path: Path, mesh: Any) -> Any:
    """A mesh that was read, which says that it is written in another form."""
    del path
    mesh.info = {UNREAD: [FORM]}
    return mesh


def read(path: Path) -> Any:
    """Read a mesh of tetrahedra, or of triangles in the plane, from its faces.

    Returns
    -------
    meshio.Mesh      zones are the array `ansys:zone`, and sets where they have names; faces inside
                     are left out

    Raises
    ------
    MeshFileError    it ends too early, its cells are others, or its sections are of a form that is
                     not known
    """
    from meshio import Mesh

    data = path.read_bytes()
    points, sides, zones = [], [], []
    labels: dict[int, str] = {}
    for section in _sections(data):
        if section.number in NAMES:
            labels[section.head[0]] = section.rows
        elif section.number == POINTS and section.rows is not None:
            points.append(section.rows)
        elif section.number == CELLS and section.head[0]:
            zones.append(section.head)
        elif section.number == FACES and section.rows is not None:
            sides.append(section)
    if not points or not sides:
        msg = "it has no points or faces"
        raise MeshFileError(msg)
    places = np.concatenate(points)
    width = places.shape[1]
    faces = np.concatenate([part.rows for part in sides])
    if faces.shape[1] != width + 2:
        msg = f"it has faces of {faces.shape[1] - 2} nodes, expected {width}"
        raise MeshFileError(msg)
    if faces[:, :width].min() < 1 or faces[:, :width].max() > len(places):
        msg = f"its faces refer to nodes beyond the {len(places)} that there are"
        raise MeshFileError(msg)
    numbers, cells = _cells(faces, width, places)
    kinds = ("line", "triangle") if width == 2 else ("triangle", "tetra")
    blocks: list[Any] = []
    tags: list[int] = []
    for head in zones:
        own = (numbers >= head[1]) & (numbers <= head[2])
        if own.any():
            blocks.append((kinds[1], cells[own]))
            tags.append(head[0])
    if sum(len(rows) for _, rows in blocks) != len(cells):
        msg = "its zones of cells do not hold the cells of its faces"
        raise MeshFileError(msg)
    for part in sides:
        if part.head[3] != INTERIOR:
            blocks.append((kinds[0], part.rows[:, :width] - 1))
            tags.append(part.head[0])
    sizes = [len(rows) for _, rows in blocks]
    sets: dict[str, Any] = {name: [np.arange(size if tag == zone else 0) for tag, size in zip(
        tags, sizes, strict=True)] for zone, name in labels.items() if zone in tags}
    return Mesh(places, blocks, cell_sets=sets, cell_data={
        ZONE: [np.full(size, tag) for tag, size in zip(tags, sizes, strict=True)]})


def _cells(
    faces: NDArray[np.int64], width: int, points: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Numbers and nodes of the cells beside faces, all of them with positive volumes."""
    rows = [np.stack([faces[:, width + side], faces[:, node]], axis=1)
            for side in (0, 1) for node in range(width)]
    pairs = np.unique(np.concatenate(rows), axis=0)
    pairs = pairs[pairs[:, 0] > 0]
    numbers, counts = np.unique(pairs[:, 0], return_counts=True)
    if (counts != width + 1).any():
        wrong = int(counts[counts != width + 1][0])
        msg = f"it has cells of {wrong} nodes, expected {width + 1}"
        raise MeshFileError(msg)
    cells = pairs[:, 1].reshape(-1, width + 1) - 1
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    if width == 2:
        size = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    else:
        size = np.einsum("ij,ij->i", np.cross(edges[:, 0], edges[:, 1]), edges[:, 2])
    cells[size < 0, :2] = cells[size < 0, 1::-1]
    return numbers, cells


def _sections(data: bytes) -> Iterator[Section]:
    """Sections of a file, one after another."""
    at = 0
    dim = 3
    while start := re.compile(rb"\s*\(\s*(\d+)\s*").match(data, at):
        index = int(start[1])
        number, form = index % 100, index // 1000
        head = re.compile(rb"\(\s*([^()\"]*)\)\s*(\()?").match(data, start.end())
        if number in (POINTS, CELLS, FACES) and index // 100 in (0, 20, 30) and head:
            words = [int(word, 16) for word in head[1].split()]
            at = head.end()
            rows = None
            if head[2]:
                if number == POINTS and len(words) > 4:
                    dim = words[4]
                rows, at = _rows(data, at, (number, form, dim), words)
            closed = re.compile(rb"[^()]*\)").match(data, at)
            if closed is None:
                msg = "it ends too early"
                raise MeshFileError(msg)
            at = closed.end()
            yield Section(number, words, rows)
            continue
        if index == 2 and (told := re.compile(rb"\d+").match(data, start.end())):
            dim = int(told[0])
        named = index in NAMES and re.compile(rb"\(\s*(\d+)\s+\S+\s+([^\s()]+)").match(
            data, start.end())
        if named:
            yield Section(index, [int(named[1])], named[2].decode("utf-8", "replace"))
        at = _behind(data, start.start())


def _rows(data: bytes, at: int, what: tuple[int, int, int], head: list[int]) -> tuple[Any, int]:
    """Numbers of a section from a place on, and the place behind them."""
    number, form, dim = what
    count = head[2] - head[1] + 1
    kind = head[4] if len(head) > 4 else 0
    if number == CELLS and kind:
        msg = "it has both faces and cells with nodes"
        raise MeshFileError(msg)
    width = {POINTS: dim, CELLS: 1}.get(number, (dim if kind in MIXED else kind) + 2)
    if not form:
        end = data.find(b")", at)
        words = data[at: end if end >= 0 else len(data)].split()
        mixed = number == FACES and kind in MIXED
        if len(words) != count * (width + mixed):
            msg = (f"section {number} of zone {head[0]} has {len(words)} numbers, expected "
                   f"{count * (width + mixed)}")
            raise MeshFileError(msg)
        if number == POINTS:
            return np.array(words, dtype=object).astype(np.float64).reshape(count, width), end + 1
        table = np.array([int(word, 16) for word in words], dtype=np.int64).reshape(count, -1)
        if mixed and (table[:, 0] != dim).any():
            msg = f"it has faces of other numbers of nodes than {dim}"
            raise MeshFileError(msg)
        return table[:, int(mixed):], end + 1
    if number == FACES and kind in MIXED:
        msg = "it has faces of several types in binary form, which is not read"
        raise MeshFileError(msg)
    dtype = np.dtype(("<f" if number == POINTS else "<i") + ("4" if form == 2 else "8"))
    piece = data[at: at + count * width * dtype.itemsize]
    if len(piece) < count * width * dtype.itemsize:
        msg = "it ends too early"
        raise MeshFileError(msg)
    table = np.frombuffer(piece, dtype).reshape(count, width)
    behind = data.find(b")", at + len(piece)) + 1
    return table.astype(np.float64 if number == POINTS else np.int64), behind or len(data)


def _behind(data: bytes, at: int) -> int:
    """Place behind the brackets that open next."""
    depth = 0
    for found in re.compile(rb"\"[^\"]*\"|[()]").finditer(data, at):
        depth += {b"(": 1, b")": -1}.get(found[0], 0)
        if not depth and found[0] == b")":
            return found.end()
    return len(data)
