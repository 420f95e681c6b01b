"""The header of a PLY file, and its elements as tables of columns."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import MeshFileError

TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "float": "f4", "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "float32": "f4", "float64": "f8", "int64": "i8",
    "uint64": "u8",
}
"""Types of PLY, their older names first, as those of NumPy."""

ORDER = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
"""Kinds of PLY files, and the order of their bytes."""

Table = dict[str, Any]
"""Columns by name: arrays (n,), arrays (n, k) of lists that are all as long, or lists of arrays."""


class Property(NamedTuple):
    """A column of an element: its type, and that of the number of entries if it holds lists."""

    name: str
    type: str
    listed: str | None = None


class Element(NamedTuple):
    """A table: its name, number of rows and columns."""

    name: str
    size: int
    properties: tuple[Property, ...]


def parsed(data: bytes) -> tuple[str, list[Element], int]:
    """Kind, elements, and the first byte behind the header of a file.

    Raises
    ------
    MeshFileError    the header is not one of PLY, or not whole
    """
    end = data.find(b"end_header")
    stop = data.find(b"\n", end)
    if not data.startswith(b"ply") or end < 0 or stop < 0:
        msg = "it has no whole header of PLY"
        raise MeshFileError(msg)
    kind, elements = "", []
    for line in data[:end].decode("ascii", "replace").splitlines():
        words = line.split()
        try:
            if words[:1] == ["format"]:
                kind = words[1]
            elif words[:1] == ["element"]:
                elements.append(Element(words[1], int(words[2]), ()))
            elif words[:1] == ["property"]:
                one = (Property(words[4], words[3], words[2]) if words[1] == "list"
                       else Property(words[2], words[1]))
                last = elements[-1]
                elements[-1] = last._replace(properties=(*last.properties, one))
        except (IndexError, ValueError) as exc:
            msg = f"its header has the line {line.strip()[:60]!r}"
            raise MeshFileError(msg) from exc
    known = [p.type in TYPES and (p.listed is None or p.listed in TYPES)
             for element in elements for p in element.properties]
    if kind not in ORDER or not all(known):
        msg = f"its header names a kind or a type that PLY does not know ({kind})"
        raise MeshFileError(msg)
    return kind, elements, stop + 1


def header(kind: str, elements: list[Element]) -> bytes:
    """The header of a file with some elements."""
    lines = ["ply", f"format {kind} 1.0"]
    for element in elements:
        lines.append(f"element {element.name} {element.size}")
        for name, of, count in element.properties:
            lines.append(f"property list {count} {of} {name}" if count else f"property {of} {name}")
    return "\n".join([*lines, "end_header", ""]).encode()


def changed_header(head: bytes, elements: list[Element]) -> bytes:
    """A header with other sizes and types, without the elements and properties that are gone."""
    left = {element.name: element for element in elements}
    now: Element | None = None
    out = []
    for line in head.splitlines(keepends=True):
        words = line.decode("ascii", "replace").split()
        end = line[len(line.rstrip()):]
        text = line
        if words[:1] == ["element"]:
            now = left.get(words[1])
            text = b"" if now is None else f"element {now.name} {now.size}".encode() + end
        elif words[:1] == ["property"]:
            of = next((p for p in now.properties if p.name == words[-1]), None) if now else None
            text = b"" if of is None else line
            if of is not None and of.type != words[-2]:
                text = " ".join([*words[:-2], of.type, of.name]).encode() + end
        out.append(text)
    return b"".join(out)


def decoded(
    data: bytes, kind: str, elements: list[Element], start: int
) -> tuple[dict[str, Table], dict[str, tuple[int, int]]]:
    """Tables of all elements by name, and their first and last bytes.

    Raises
    ------
    MeshFileError    the file ends too early
    """
    tables, spans, at = {}, {}, start
    for element in elements:
        try:
            if kind == "ascii":
                table, end = _of_text(data, element, at)
            else:
                table, end = _of_bytes(data, ORDER[kind], element, at)
        except (ValueError, IndexError) as exc:
            msg = f"it ends within its {element.size} rows of {element.name}, or one is broken"
            raise MeshFileError(msg) from exc
        tables[element.name], spans[element.name] = table, (at, end)
        at = end
    return tables, spans


def encoded(
    kind: str, element: Element, table: Table, old: Table | None = None,
    rows: NDArray[np.int64] | None = None, was: bytes = b"",
) -> bytes:
    """The rows of a table as bytes.

    Parameters
    ----------
    kind : str             of the file
    element : Element      name and columns
    table : Table          new values
    old, rows, was         of a file that is there its values, the row from which each new row
                           comes, and its bytes: in text rows with the same values stay
    """
    if kind != "ascii":
        return _as_bytes(ORDER[kind], element, table)
    lines = [line for line in was.splitlines(keepends=True) if line.strip()]
    end = b"\r\n" if b"\r\n" in was else b"\n"
    same = np.zeros(element.size, dtype=np.bool_)
    if old is not None and rows is not None:
        same[:] = True
        for name, *_ in element.properties:
            same &= _equal_rows(table[name], old[name], rows)
    columns = [_texts(table[name], count is not None) for name, _, count in element.properties]
    out = []
    for i in range(element.size):
        stays = rows is not None and bool(same[i])
        out.append(lines[rows[i]] if stays and rows is not None
                   else " ".join(column[i] for column in columns).encode() + end)
    return b"".join(out)


def _of_text(data: bytes, element: Element, at: int) -> tuple[Table, int]:
    rows: list[list[bytes]] = []
    while len(rows) < element.size:
        stop = data.find(b"\n", at)
        stop = len(data) if stop < 0 else stop + 1
        if stop == at:
            raise IndexError
        words = data[at:stop].split()
        at = stop
        if words:
            rows.append(words)
    if all(p.listed is None for p in element.properties):
        whole = np.array([row[: len(element.properties)] for row in rows], dtype=np.bytes_)
        whole = whole.reshape(element.size, len(element.properties))
        return {p.name: _numbers(whole[:, i], p.type) for i, p in enumerate(element.properties)}, at
    found: dict[str, list[Any]] = {p.name: [] for p in element.properties}
    for words in rows:
        k = 0
        for p in element.properties:
            size = 1 if p.listed is None else int(words[k])
            k += p.listed is not None
            if k + size > len(words):
                raise IndexError
            found[p.name].append(words[k: k + size])
            k += size
    out: Table = {}
    for p in element.properties:
        parts = found[p.name]
        flat = _numbers(np.array([word for part in parts for word in part], np.bytes_), p.type)
        out[p.name] = flat if p.listed is None else _ragged(flat, [len(part) for part in parts])
    return out, at


def _numbers(words: NDArray[np.bytes_], kind: str) -> NDArray[Any]:
    dtype = np.dtype(TYPES[kind])
    if not words.size:
        return np.zeros(0, dtype)
    # Whole numbers are written with a point by some programs.
    return words.astype(np.float64 if dtype.itemsize < 8 or dtype.kind == "f" else dtype).astype(
        np.float64 if kind in ("float", "float32") else dtype)


def _ragged(flat: NDArray[Any], sizes: list[int]) -> Any:
    """Lists one after another as rows if they are all as long, as a list of arrays otherwise."""
    if len(set(sizes)) == 1:
        return flat.reshape(len(sizes), -1)
    if not sizes:
        return np.zeros((0, 3), dtype=np.int64)
    return np.split(flat, np.cumsum(sizes)[:-1])


def _of_bytes(data: bytes, order: str, element: Element, at: int) -> tuple[Table, int]:
    def of(name: str) -> np.dtype[Any]:
        return np.dtype(order + TYPES[name])

    n = element.size
    row: list[Any] = []
    k = at
    for p in element.properties:
        if p.listed is None:
            row.append((p.name, of(p.type)))
            k += of(p.type).itemsize
            continue
        size = int(np.frombuffer(data, of(p.listed), 1, k)[0]) if n else 0
        row += [(f"{p.name} count", of(p.listed)), (p.name, of(p.type), (size,))]
        k += of(p.listed).itemsize + size * of(p.type).itemsize
    dtype = np.dtype(row)
    if at + n * dtype.itemsize <= len(data):
        whole = np.frombuffer(data, dtype, n, at)
        counts = [whole[f"{p.name} count"] for p in element.properties if p.listed is not None]
        if all((count == count[:1]).all() for count in counts):
            return {p.name: whole[p.name].astype(np.dtype(TYPES[p.type]))
                    for p in element.properties}, at + n * dtype.itemsize
    found: dict[str, list[NDArray[Any]]] = {p.name: [] for p in element.properties}
    for _ in range(n):
        for p in element.properties:
            size = 1
            if p.listed is not None:
                size = int(np.frombuffer(data, of(p.listed), 1, at)[0])
                at += of(p.listed).itemsize
            found[p.name].append(np.frombuffer(data, of(p.type), size, at))
            at += size * of(p.type).itemsize
    out: Table = {}
    for p in element.properties:
        parts = found[p.name]
        flat = np.concatenate(parts).astype(np.dtype(TYPES[p.type]))
        out[p.name] = flat if p.listed is None else _ragged(flat, [len(part) for part in parts])
    return out, at


def _as_bytes(order: str, element: Element, table: Table) -> bytes:
    if all(not isinstance(table[p.name], list) for p in element.properties):
        row: list[Any] = []
        for p in element.properties:
            kind = order + TYPES[p.type]
            if p.listed is not None:
                row.append((f"{p.name} count", order + TYPES[p.listed]))
            row.append((p.name, kind) if p.listed is None
                       else (p.name, kind, (table[p.name].shape[1],)))
        whole = np.zeros(element.size, np.dtype(row))
        for p in element.properties:
            whole[p.name] = table[p.name]
            if p.listed is not None:
                whole[f"{p.name} count"] = table[p.name].shape[1]
        return whole.tobytes()
    out = []
    for i in range(element.size):
        for p in element.properties:
            values = np.atleast_1d(table[p.name][i])
            if p.listed is not None:
                out.append(np.array(len(values)).astype(order + TYPES[p.listed]).tobytes())
            out.append(values.astype(order + TYPES[p.type]).tobytes())
    return b"".join(out)


def _equal_rows(new: Any, old: Any, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    if isinstance(new, list) or isinstance(old, list):
        return np.array([np.array_equal(a, old[i]) for a, i in zip(new, rows.tolist(),
                                                                   strict=True)], dtype=np.bool_)
    same = new == old[rows]
    return np.asarray(same.all(axis=1) if same.ndim > 1 else same)


def _texts(values: Any, lists: bool) -> list[str]:
    """Every row as text."""
    rows = [np.atleast_1d(row).tolist() for row in values]
    head = [f"{len(row)} " if lists else "" for row in rows]
    return [first + " ".join(map(repr, row)) for first, row in zip(head, rows, strict=True)]
