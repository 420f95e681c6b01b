"""Plain files `.vtu` without VTK: one piece of an unstructured grid, binary arrays of numbers.

VTK takes most of a second to start. What is not plain, or does not fit together, is left to it.

Source: https://docs.vtk.org/en/latest/design_documents/VTKFileFormats.html.
"""

from __future__ import annotations

import binascii
import itertools
import re
import sys
import zlib
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.stated import PACKED
from odt_plugins.adapters.vtk_cells import Dataset, blocks_of, dataset_of
from odt_plugins.errors import InvalidMeshError, UnsupportedMeshError

Array = NDArray[Any]

TYPES = {f"{word}{8 * size}": np.dtype(f"{code}{size}")
         for word, code, sizes in (("Int", "i", (1, 2, 4, 8)), ("UInt", "u", (1, 2, 4, 8)),
                                   ("Float", "f", (4, 8)))
         for size in sizes}
"""Words of the format for types of numbers."""

WORDS = {kind: word for word, kind in TYPES.items()}
ORDER = f"{sys.byteorder.capitalize()}Endian"
ORDERS: dict[str, Literal["<", ">"]] = {"LittleEndian": "<", "BigEndian": ">"}
COMPRESSOR = "vtkZLibDataCompressor"

GRID: dict[str, set[str | None]] = {
    "type": {"UnstructuredGrid"}, "version": {"0.1", "1.0"}, "byte_order": {*ORDERS},
    "header_type": {None, "UInt32", "UInt64"}, "compressor": {None, COMPRESSOR}}
"""Attributes of a plain file."""

PARTS = {"FieldData", "PointData", "CellData", "Points", "Cells"}
NAME = re.compile(r"[\w.:-]+", re.ASCII)
"""Names that every reader takes alike."""

COMMENT = re.compile(rb"<!--(?:(?!--)[^<>])*+-->")
"""Remarks such as that of meshio."""

BLOCK = 1 << 15
"""Bytes of a block that is packed by itself, as VTK has them."""

LEVEL = 5
"""How hard zlib tries, as for VTK."""


class _Other(Exception):
    """The file is not plain."""


def read(path: Path) -> Any:
    """Read a plain file as VTK does: one block for each type of cells, all arrays in their types.

    Returns
    -------
    meshio.Mesh, or None where the file is left to VTK
    """
    # Where something is missing or too much, VTK finds the words.
    try:
        mesh, said = blocks_of(_dataset(path.read_bytes()))
    except (_Other, ElementTree.ParseError, UnicodeDecodeError, LookupError, ValueError,
            zlib.error, InvalidMeshError, UnsupportedMeshError):
        return None
    return None if said else mesh


def _expect(fits: Any) -> None:
    if not fits:
        raise _Other


def _dataset(content: bytes) -> Dataset:
    head, tag, appended = content.partition(b"<AppendedData")
    head = COMMENT.sub(b"", head)
    _expect(b"<!" not in head and b"&" not in head)
    root = ElementTree.fromstring(head + b"</VTKFile>" if tag else head)
    _expect(root.tag == "VTKFile")
    _expect(all(root.get(key) in known for key, known in GRID.items()))
    (grid,) = root
    *others, piece = grid
    _expect(grid.tag == "UnstructuredGrid" and piece.tag == "Piece" and len(others) <= 1)
    parts = {part.tag: list(part) for part in (*others, *piece)}
    _expect(set(parts) <= PARTS and len(parts) == len(others) + len(piece))
    _expect({part.tag for part in others} <= {"FieldData"})
    order = ORDERS[root.get("byte_order", "")]
    decode = _Decoder(np.dtype(TYPES[root.get("header_type", "UInt32")]).newbyteorder(order),
                      root.get("compressor") is not None, appended)
    n, m = (int(piece.get(f"NumberOf{what}", "")) for what in ("Points", "Cells"))
    _expect(n > 0 and m > 0)

    def arrays(part: str, count: int | None) -> dict[str, Array]:
        found = {}
        for element in parts.get(part, ()):
            name = element.get("Name", "")
            _expect(element.tag == "DataArray" and NAME.fullmatch(name) and name not in found)
            kind = TYPES[element.get("type", "")]
            columns = int(element.get("NumberOfComponents", "1"))
            _expect(columns > 0)
            rows = int(element.get("NumberOfTuples", "")) if part == "FieldData" else count
            data = decode(element, None if rows is None else rows * columns * kind.itemsize)
            values = np.frombuffer(data, kind.newbyteorder(order)).astype(kind)
            found[name] = values.reshape(-1, columns) if columns > 1 else values
        return found

    (points,) = arrays("Points", n).values()
    cells = arrays("Cells", None)
    _expect(points.dtype.kind == "f" and points.shape == (n, 3))
    _expect(set(cells) == {"connectivity", "offsets", "types"})
    types, ends, nodes = (cells[name] for name in ("types", "offsets", "connectivity"))
    _expect(types.shape == ends.shape == (m,) and nodes.ndim == 1)
    _expect(ends.dtype == nodes.dtype and nodes.dtype in (np.int32, np.int64))
    _expect(types.dtype.kind in "iu" and types.min() >= 0)
    _expect(len(nodes) and nodes.min() >= 0 and nodes.max() < n)
    return Dataset(points, types, np.append(nodes.dtype.type(0), ends), nodes,
                   arrays("PointData", n), arrays("CellData", m), arrays("FieldData", None))


class _Decoder:
    """Gives the bytes of an array, which stand in its element or after all of them."""

    def __init__(self, header: np.dtype[Any], packed: bool, appended: bytes) -> None:
        self.header, self.packed = header, packed
        self.raw, self.appended = False, b""
        if appended:
            tag, _, rest = appended.partition(b">")
            encoding = re.fullmatch(rb'\s*encoding\s*=\s*"(raw|base64)"\s*', tag)
            _expect(encoding)
            self.raw = encoding is not None and encoding[1] == b"raw"
            self.appended = rest.partition(b"_")[2]

    def __call__(self, element: Any, size: int | None) -> bytes:
        """The bytes of an array; so many are expected if any are."""
        way = element.get("format")
        _expect(way in ("binary", "appended"))
        _expect(all(child.tag == "InformationKey" for child in element))
        if way == "binary":
            text = (element.text or "").strip().encode("ascii")
            data, end = self._bytes(text, 0, raw=False, size=size)
            _expect(end == len(text))
            return data
        return self._bytes(self.appended, int(element.get("offset", "")), raw=self.raw,
                           size=size)[0]

    def _bytes(self, text: bytes, at: int, *, raw: bool, size: int | None) -> tuple[bytes, int]:
        """The bytes of the array that begins there, and where it ends."""
        take = _raw if raw else _base64
        width = self.header.itemsize
        if not self.packed:
            head, end = take(text, at, width)
            length = int(np.frombuffer(head, self.header)[0])
            _expect(size is None or length == size)
            if raw or b"=" in text[at:end]:
                return take(text, end, length)
            data, end = take(text, at, width + length)
            return data[width:], end
        head, _ = take(text, at, 3 * width)
        count, whole, last = np.frombuffer(head, self.header).tolist()
        _expect(count * width <= len(text) and whole <= PACKED * len(text))
        head, at = take(text, at, (3 + count) * width)
        lengths = np.frombuffer(head, self.header)[3:].tolist()
        packed, end = take(text, at, sum(lengths))
        sizes = [whole] * (count - 1) + [last or whole] if count else []
        _expect(last <= whole and (size is None or sum(sizes) == size))
        parts = []
        for length, full in zip(lengths, sizes, strict=True):
            tool = zlib.decompressobj()
            parts.append(tool.decompress(packed[:length], full + 1))
            _expect(len(parts[-1]) == full and tool.eof)
            packed = packed[length:]
        return b"".join(parts), end


def _raw(text: bytes, at: int, count: int) -> tuple[bytes, int]:
    """So many bytes from there on, and where they end."""
    _expect(0 <= at <= at + count <= len(text))
    return text[at : at + count], at + count


def _base64(text: bytes, at: int, count: int) -> tuple[bytes, int]:
    """The same of bytes that were encoded together."""
    end = at + 4 * -(-count // 3)
    data = binascii.a2b_base64(text[at:end])
    _expect(0 <= at and end <= len(text) and len(data) >= count)
    return data[:count], end


def _holds(mesh: Any) -> bool:
    """Whether a plain file holds a mesh with all its data."""
    cells = [np.asarray(block.data) for block in mesh.cells]
    of_points, of_cells = ((*getattr(mesh, f"{kind}_data"), *getattr(mesh, f"{kind}_sets"))
                           for kind in ("point", "cell"))
    names = (*of_points, *of_cells, *mesh.field_data)
    values = [*mesh.point_data.values(), *itertools.chain(*mesh.cell_data.values()),
              *mesh.field_data.values()]
    return (
        any(map(len, cells))
        and all(nodes.ndim == 2 and nodes.dtype.kind in "iu" for nodes in cells)
        and all(len(set(names)) == len(names) for names in (of_points, of_cells))
        and all(isinstance(name, str) and NAME.fullmatch(name) for name in names)
        and all((array.dtype.kind == "b" or array.dtype.newbyteorder("=") in WORDS)
                and 0 < array.ndim <= 2 and 0 not in array.shape[1:]
                for array in map(np.asarray, values))
    )


def write(path: Path, mesh: Any) -> Any:
    """Write a plain file as VTK does, and read it again.

    Returns
    -------
    meshio.Mesh, or None where a plain file does not hold the mesh

    Raises
    ------
    UnsupportedMeshError    the format does not hold such cells
    """
    if not _holds(mesh):
        return None
    data = dataset_of(mesh)
    cells = {"connectivity": data.nodes, "offsets": data.offset[1:], "types": data.types}
    with path.open("wb") as file:
        file.write(
            f'<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="0.1" '
            f'byte_order="{ORDER}" header_type="UInt32" compressor="{COMPRESSOR}">\n'
            '<UnstructuredGrid>\n<FieldData>\n'.encode())
        for name, values in data.field_data.items():
            file.write(_element(name, values, f' NumberOfTuples="{len(values)}"'))
        file.write(f'</FieldData>\n<Piece NumberOfPoints="{len(data.points)}" '
                   f'NumberOfCells="{len(data.types)}">\n'.encode())
        for part, arrays in (("PointData", data.point_data), ("CellData", data.cell_data),
                             ("Points", {"Points": data.points}), ("Cells", cells)):
            file.write(f"<{part}>\n".encode())
            for name, values in arrays.items():
                file.write(_element(name, values))
            file.write(f"</{part}>\n".encode())
        file.write(b"</Piece>\n</UnstructuredGrid>\n</VTKFile>\n")
    return read(path)


def _element(name: str, values: Array, more: str = "") -> bytes:
    """An array as it stands in the file."""
    content = np.ascontiguousarray(values).tobytes()
    parts = [content[at : at + BLOCK] for at in range(0, len(content), BLOCK)]
    packed = [zlib.compress(part, LEVEL) for part in parts]
    head = np.array([len(parts), BLOCK, len(content) % BLOCK, *map(len, packed)], dtype=np.uint32)
    if values.ndim > 1:
        more += f' NumberOfComponents="{values.shape[1]}"'
    return b"".join((
        f'<DataArray type="{WORDS[values.dtype]}" Name="{name}"{more} format="binary">'.encode(),
        binascii.b2a_base64(head.tobytes(), newline=False),
        binascii.b2a_base64(b"".join(packed), newline=False), b"</DataArray>\n"))
