"""Legacy files of VTK: whether all data are there that the file announces, with all their digits.

Neither VTK nor meshio notices when the last arrays of a file are cut off, and VTK writes 6 and 11
digits of numbers of 32 and 64 bits as text.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import MeshFileError

SIZES = {b"bit": 0, b"char": 1, b"signed_char": 1, b"unsigned_char": 1, b"short": 2,
         b"unsigned_short": 2, b"int": 4, b"unsigned_int": 4, b"long": 8, b"unsigned_long": 8,
         b"float": 4, b"double": 8, b"vtkidtype": 4, b"vtktypeint64": 8, b"vtktypeuint64": 8,
         b"vtktypeint32": 4, b"vtktypeuint32": 4, b"vtktypeint16": 2, b"vtktypeuint16": 2,
         b"vtktypeint8": 1, b"vtktypeuint8": 1}
"""Bytes of a number of each type; eight bits are one."""

OWN = b"own"
"""In place of a type: a line before the values has a word and their type."""

LISTS = (b"CELLS", b"VERTICES", b"LINES", b"POLYGONS", b"TRIANGLE_STRIPS")

NAMED = (b"SCALARS", b"VECTORS", b"NORMALS", b"TENSORS", b"TENSORS6", b"TEXTURE_COORDINATES",
         b"GLOBAL_IDS", b"PEDIGREE_IDS")
"""Words before the name of an array; fields have the name in front."""

PER_LINE = 9
"""Numbers on a line."""

COMPONENTS = {b"VECTORS": 3, b"NORMALS": 3, b"TENSORS": 9, b"TENSORS6": 6}


def widen(mesh: Any) -> None:
    """Exchange integers of less than eight bytes, which meshio writes in words VTK lacks."""

    def wide(values: Any) -> NDArray[Any]:
        array = np.asarray(values)
        return array.astype(np.int64) if array.dtype.kind in "biu" and array.itemsize < 8 else array

    mesh.point_data = {name: wide(values) for name, values in mesh.point_data.items()}
    mesh.cell_data = {name: [*map(wide, values)] for name, values in mesh.cell_data.items()}
    mesh.field_data = {name: wide(values) for name, values in mesh.field_data.items()}


def expect_whole(path: Path) -> None:
    """Walk through a file from one announcement to the next, as far as its words are known.

    Raises
    ------
    MeshFileError    the file ends within what it announces
    """
    with path.open("rb") as file:
        for _ in _blocks(file):
            continue


def write_exactly(path: Path, values: Callable[[str, str], NDArray[Any] | None]) -> None:
    """Write the floating-point numbers of a file of text anew, with all of their digits.

    Parameters
    ----------
    path : path          of what VTK wrote, which has fewer digits
    values : callable    from the section (POINTS, POINT_DATA, CELL_DATA or FIELD) and a name to
                         an array, or to None
    """
    data = path.read_bytes()
    if data.split(b"\n", 3)[2].strip().upper() != b"ASCII":
        return
    out, done = [], 0
    with path.open("rb") as file:
        for block in _blocks(file):
            if block.kind.lower() not in (b"float", b"double"):
                continue
            array = values(block.home, block.name)
            if array is None or array.size != block.size:
                continue
            words = array.ravel().astype(str).tolist()
            lines = (" ".join(words[i: i + PER_LINE]) for i in range(0, len(words), PER_LINE))
            out += [data[done: block.start], "\n".join(lines).encode(), b"\n"]
            done = block.stop
    path.write_bytes(b"".join([*out, data[done:]]))


class _Block(NamedTuple):
    """Values in a file: of which section and name, how many of what type, and where they stand."""

    home: str
    name: str
    size: int
    kind: bytes
    start: int
    stop: int


def _blocks(file: BinaryIO) -> Iterator[_Block]:
    """All values of a file that it announces.

    Raises
    ------
    MeshFileError    the file ends within what it announces
    """
    file.readline()
    file.readline()
    text = file.readline().strip().upper() == b"ASCII"
    rows, home = 0, "FIELD"
    try:
        while line := file.readline():
            words = line.split()
            if not words:
                continue
            first = words[0].upper()
            if first in (b"POINT_DATA", b"CELL_DATA"):
                rows, home = int(words[1]), first.decode()
            elif first == b"METADATA":
                while file.readline().strip():
                    pass
            elif first not in (b"DATASET", b"FIELD"):
                named = words[1 if first in NAMED else 0].decode("utf-8", "replace")
                for count, kind in _announced(words, rows, file):
                    start = file.tell()
                    _pass(file, count, kind, text, words)
                    yield _Block("POINTS" if first == b"POINTS" else home, unquote(named), count,
                                 kind, start, file.tell())
    # A word that VTK may know; the readers judge the rest.
    except (KeyError, IndexError, ValueError):
        return


def _announced(words: list[bytes], rows: int, file: BinaryIO) -> list[tuple[int, bytes]]:
    """Numbers and types of the values that follow a line.

    Raises
    ------
    KeyError, IndexError, ValueError    it is none that announces values
    """
    name = words[0].upper()
    if name == b"POINTS":
        return [(3 * int(words[1]), words[2])]
    if name in LISTS:
        at = file.tell()
        follows = file.readline().split()
        file.seek(at)
        if follows[0].upper() != b"OFFSETS":
            return [(int(words[2]), b"int")]
        return [(int(words[1]), OWN), (int(words[2]), OWN)]
    if name in (b"GLOBAL_IDS", b"PEDIGREE_IDS"):
        return [(rows, words[2])]
    if name == b"CELL_TYPES":
        return [(int(words[1]), b"int")]
    if name == b"SCALARS":
        return [(-1, b""), (rows * int(words[3] if len(words) > 3 else 1), words[2])]
    if name == b"LOOKUP_TABLE":
        return [(4 * int(words[2]), b"unsigned_char")]
    if name == b"COLOR_SCALARS":
        return [(rows * int(words[2]), b"unsigned_char")]
    if name == b"TEXTURE_COORDINATES":
        return [(rows * int(words[2]), words[3])]
    if name in COMPONENTS:
        return [(rows * COMPONENTS[name], words[2])]
    return [(int(words[1]) * int(words[2]), words[3])]


def _pass(file: BinaryIO, count: int, kind: bytes, text: bool, words: list[bytes]) -> None:
    """Go on behind values, or behind a line where the count is -1."""
    if count < 0:
        while (line := file.readline()) and not line.strip():
            pass
        return
    if kind == OWN:
        while not (line := file.readline()).strip() and line:
            pass
        kind = line.split()[1]
    size = SIZES[kind.lower()] if kind.lower() != b"string" or not text else 0
    if text and kind.lower() == b"string":
        while count > 0 and file.readline():
            count -= 1
        there = count <= 0
    elif text:
        while count > 0 and (line := file.readline()):
            count -= len(line.split())
        there = count <= 0
    else:
        wanted = count * size if size else -(-count // 8)
        end = file.seek(0, 1) + wanted
        there = end <= file.seek(0, 2)
        file.seek(end)
    if not there:
        said = b" ".join(words).decode("ascii", "replace")
        msg = f"it ends within what {said[:60]!r} announces"
        raise MeshFileError(msg)
