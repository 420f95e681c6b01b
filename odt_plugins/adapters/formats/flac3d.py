"""FLAC3D's grids: zones and faces with their groups, which meshio reads by wrong numbers."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.decks import indices
from odt_plugins.adapters.formats.titles import CONTROL, written
from odt_plugins.errors import MeshFileError

ORDER = {"triangle": [0, 1, 2], "quad": [0, 1, 2, 3], "tetra": [0, 1, 2, 3],
         "pyramid": [0, 1, 3, 4, 2], "wedge": [0, 1, 3, 2, 4, 5],
         "hexahedron": [0, 1, 3, 4, 2, 7, 5, 6]}
"""Nodes of cells, in the order in which files have them."""

TURNED = {"tetra": [0, 2, 1, 3], "pyramid": [0, 3, 1, 4, 2], "wedge": [0, 2, 3, 1, 5, 4],
          "hexahedron": [0, 3, 1, 4, 2, 5, 7, 6]}
"""Order of nodes of cells that are the other way round: first edges have to be right-handed."""

WORDS = {"triangle": "T3", "quad": "Q4", "tetra": "T4", "pyramid": "P5", "wedge": "W6",
         "hexahedron": "B8"}
"""What the types of cells are called in files."""

SLOT = "Default"
"""Slot whose groups are sets of their bare names."""

HEAD = (1375135718, 3)
"""Numbers at the start of binary files."""

MOST = 8
"""Most nodes of a cell."""

GROUP = re.compile(
    rb"^[ \t]*([ZF]GROUP)[ \t]+(?:\"(?P<a>[^\"\n]*)\"|'(?P<b>[^'\n]*)'|(?P<c>[^\s\"']+))"
    rb"(?:[ \t]+SLOT[ \t]+[\"']?(?P<slot>[^\"'\n]*?)[\"']?)?[ \t]*$", re.MULTILINE)
"""Line that begins a group: its name and its slot may be in quotes, and the slot is not said by
all programs."""

ROW = 20
"""Numbers of cells in a line."""


class Part(NamedTuple):
    """Zones or faces of a file: their word, types with rows of nodes from 1 on, and groups.

    Attributes
    ----------
    word : str
    cells : list of (str, (m, k) int)
    groups : dict                        from name and slot to numbers of cells
    """

    word: str
    cells: list[tuple[str, NDArray[np.int64]]]
    groups: dict[tuple[str, str], NDArray[np.int64]]


def expect_whole(path: Path) -> None:
    """See whether a binary file holds what it states, before memory is taken for that.

    Raises
    ------
    MeshFileError    it ends too early, or has cells of more nodes than there are types for
    """
    data = path.read_bytes()
    if b"\0" not in data[:8]:
        return
    at = 8

    def word(size: int = 4) -> int:
        nonlocal at
        at += size
        if at > len(data):
            msg = "it ends too early"
            raise MeshFileError(msg)
        return int.from_bytes(data[at - size: at], "little")

    count = word()
    at += 28 * count
    for _ in range(2):
        for _ in range(word()):
            word()
            nodes = word()
            if nodes > MOST:
                msg = f"it has a cell of {nodes} nodes, expected {MOST} at most"
                raise MeshFileError(msg)
            at += 4 * nodes
        for _ in range(word()):
            for _ in range(2):
                count = word(2)
                at += count
            count = word()
            at += 4 * count
    if at > len(data):
        msg = "it ends too early"
        raise MeshFileError(msg)


def with_slots(data: bytes) -> bytes:
    """The same text with groups as meshio reads them: names in quotes, slots in none."""
    return GROUP.sub(lambda found: found[1] + b' "' + (
        found["a"] or found["b"] or found["c"] or b"") + b'" SLOT ' + (
            found["slot"] or SLOT.encode()), data)


def completed(path: Path, mesh: Any) -> Any:
    """A mesh that meshio read, with the groups of its own cells as sets.

    meshio counts the members of groups over all blocks, and not in each. Groups of the slot
    `Default` are sets of their names, others `zone:name:slot` or `face:name:slot`.
    """
    del path
    starts = np.cumsum([0, *(len(block.data) for block in mesh.cells)])
    sets: dict[str, list[NDArray[np.int64]]] = {}
    for title, members in mesh.cell_sets.items():
        _, name, slot = _parted(title)
        plain = name if slot == SLOT else title
        rows = [np.asarray(part, dtype=np.int64) - start
                for part, start in zip(members, starts, strict=False)]
        before = sets.get(plain, [row[:0] for row in rows])
        sets[plain] = [np.union1d(one, two) for one, two in zip(before, rows, strict=True)]
    mesh.cell_sets = sets
    mesh.cell_data.pop("cell_ids", None)
    return mesh


def _parted(title: str) -> tuple[str, str, str]:
    """Kind, name and slot of a group."""
    found = re.fullmatch(r"(zone|face):(.*):(.*?)", title)
    return (found[1], found[2], found[3]) if found else ("", title, SLOT)


def write(path: Path, mesh: Any, binary: bool | None) -> list[str]:
    """Write zones and faces of linear cells, and cell sets as groups of these."""
    points = np.asarray(mesh.points, dtype=np.float64)
    zones = _part(mesh, points, "zone", 0)
    faces = _part(mesh, points, "face", sum(len(rows) for _, rows in zones.cells))
    path.write_bytes(_packed(points, zones, faces) if binary else _text(points, zones, faces))
    return []


def _part(mesh: Any, points: NDArray[np.float64], word: str, start: int) -> Part:
    dim = 3 if word == "zone" else 2
    own = [i for i, block in enumerate(mesh.cells) if block.dim == dim]
    cells = [(mesh.cells[i].type, _rows(mesh.cells[i], points) + 1) for i in own]
    first = start + 1 + np.cumsum([0, *(len(rows) for _, rows in cells)])
    groups = {}
    titles = written(mesh.cell_sets, CONTROL)
    titles |= written(title for title in titles if not _parted(title)[0])
    for key, members in mesh.cell_sets.items():
        title = titles[key]
        kind, name, slot = _parted(title)
        numbers = np.concatenate([np.zeros(0, dtype=np.int64), *(
            np.sort(indices(members[i])) + at for i, at in zip(own, first, strict=False))])
        if len(numbers) and kind in ("", word):
            groups[name, slot] = numbers
        elif len(numbers):
            groups[title, SLOT] = numbers
    return Part(word, cells, groups)


def _rows(block: Any, points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Rows of nodes in the order of files."""
    rows = np.asarray(block.data, dtype=np.int64)
    there = rows[:, ORDER[block.type]]
    if block.type not in TURNED:
        return there
    corners = points[there[:, :4]]
    a, b, c = (corners[:, k] - corners[:, 0] for k in (1, 2, 3))
    right = np.einsum("ij,ij->i", np.cross(a, b), c) > 0
    return np.where(right[:, None], there, rows[:, TURNED[block.type]])


def _text(points: NDArray[np.float64], zones: Part, faces: Part) -> bytes:
    lines = ["* GRIDPOINTS"]
    lines += [f"G {i} {x!r} {y!r} {z!r}" for i, (x, y, z) in enumerate(points.tolist(), 1)]
    number = 0
    for part in (zones, faces):
        if not part.cells:
            continue
        lines.append(f"* {part.word.upper()}S")
        for kind, rows in part.cells:
            for row in rows.tolist():
                number += 1
                lines.append(f"{part.word[0].upper()} {WORDS[kind]} {number} "
                             + " ".join(map(str, row)))
        if part.groups:
            lines.append(f"* {part.word.upper()} GROUPS")
        for (name, slot), numbers in part.groups.items():
            slot = slot if re.fullmatch(r"[\w.-]+", slot) else f'"{slot}"'
            lines.append(f'{part.word[0].upper()}GROUP "{name}" SLOT {slot}')
            lines += [" ".join(map(str, numbers[at: at + ROW].tolist()))
                      for at in range(0, len(numbers), ROW)]
    return ("\n".join(lines) + "\n").encode()


def _packed(points: NDArray[np.float64], zones: Part, faces: Part) -> bytes:
    table = np.zeros(len(points), dtype=[("number", "<u4"), ("place", "<f8", 3)])
    table["number"], table["place"] = np.arange(1, len(points) + 1), points
    out = [_words(*HEAD), _words(len(points)), table.tobytes()]
    number = 1
    for part in (zones, faces):
        out.append(_words(sum(len(rows) for _, rows in part.cells)))
        for _, rows in part.cells:
            out.append(np.column_stack([
                number + np.arange(len(rows)), np.full(len(rows), rows.shape[1]), rows,
            ]).astype("<u4").tobytes())
            number += len(rows)
        out.append(_words(len(part.groups)))
        for key, numbers in part.groups.items():
            for text in key:
                data = text.encode()
                out += [np.array([len(data)], dtype="<u2").tobytes(), data]
            out += [_words(len(numbers)), numbers.astype("<u4").tobytes()]
    return b"".join(out)


def _words(*numbers: int) -> bytes:
    return np.array(numbers, dtype="<u4").tobytes()
