"""Tables of Gmsh's files of versions 1, 2, 4.0 and 4.1, text or binary, and where they stand.

https://gmsh.info/doc/texinfo/gmsh.html#MSH-file-format
"""

from __future__ import annotations

import re
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.titles import titled
from odt_plugins.errors import MeshFileError

PHYSICAL, ENTITY, NODE_ENTITY = "gmsh:physical", "gmsh:geometrical", "gmsh:dim_tags"
PARTITION, BOUNDS = "gmsh:partition", "gmsh:bounding_entities"

BOOKKEEPING = (NODE_ENTITY, BOUNDS)
"""Arrays and sets that mean something to Gmsh alone."""

TAGS = (PHYSICAL, ENTITY, PARTITION)
"""Arrays of what the element is of."""

OLD = {"NOD": "Nodes", "ELM": "Elements"}
"""Sections of version 1, which end with $ENDNOD and $ENDELM."""

DATA = ("NodeData", "ElementData", "ElementNodeData")
"""Sections of values, each of one view at one of its steps."""

MESH = ("MeshFormat", "PhysicalNames", "Entities", "PartitionedEntities", "Nodes", "Elements",
        "Periodic", "GhostElements", "Parametrizations", "InterpolationScheme")
"""Sections that Gmsh writes again with every view that it appends to a file."""

FORTRAN = rb"(?<=[\d.])[dD](?=[+-]?\d)"
"""The letter of an exponent as Fortran writes it."""


class Section(NamedTuple):
    """A section, by its name of version 2 and later, and where its body starts and stops."""

    name: str
    start: int
    stop: int


class File(NamedTuple):
    """Content of a file.

    Attributes
    ----------
    data : bytes
    version : str       "1", "2" of 2.0 to 2.2, "4.0" or "4.1"
    text : bool
    order : str         of the bytes, "<" or ">"
    long : str          type of counts, and of tags of nodes and elements in version 4.1
    sections : list of Section
    """

    data: bytes
    version: str
    text: bool
    order: Literal["<", ">"]
    long: str
    sections: list[Section]

    def all(self, name: str) -> list[Section]:
        """All sections of a name."""
        return [section for section in self.sections if section.name == name]


class Block(NamedTuple):
    """Nodes of an entity that follow each other: rows from `first` to `last`, that not included.

    Attributes
    ----------
    entity : (int, int)     dimension and tag; (0, 0) in versions before 4
    parametric : bool       whether parameters on the entity follow the coordinates
    at : (int, int)         where the bytes of their number stand
    first, last : int
    """

    entity: tuple[int, int]
    parametric: bool
    at: tuple[int, int]
    first: int
    last: int


class Nodes(NamedTuple):
    """Nodes in the order of the file.

    Attributes
    ----------
    tags : (n,) int64
    points : (n, 3) float64
    entities : (n, 2) int64     dimension and tag
    spans : (n, 3, 2) int64     where the bytes of each coordinate start and stop
    heads : (n, 2) int64        those of each tag
    rows : (n, 2) int64         those of the tag, but for version 4.1, coordinates and parameters
    blocks : list of Block
    counted : bool              whether they have new tags, from 1 on, where nodes come and go
    """

    tags: NDArray[np.int64]
    points: NDArray[np.float64]
    entities: NDArray[np.int64]
    spans: NDArray[np.int64]
    heads: NDArray[np.int64]
    rows: NDArray[np.int64]
    blocks: list[Block]
    counted: bool = False


class Run(NamedTuple):
    """Consecutive elements of one type, in version 4 also of one entity.

    Attributes
    ----------
    kind : int                  number of the type
    numbers : (m,) int64
    tags : (m, t) int64         group, entity, number of parts, parts; none in version 4
    nodes : (m, k) int64        tags of nodes
    entity : (int, int)         dimension and tag, in version 4
    at : (int, int)             where the bytes of their number stand; (0, 0) where each row has
                                a head of its own
    rows : (m, 2) int64         where each row starts, with that head, and stops
    """

    kind: int
    numbers: NDArray[np.int64]
    tags: NDArray[np.int64]
    nodes: NDArray[np.int64]
    entity: tuple[int, int]
    at: tuple[int, int]
    rows: NDArray[np.int64]


class Values(NamedTuple):
    """Values of a view at a step.

    Attributes
    ----------
    kind : str                  one of DATA
    name : str
    step : int
    time : float
    at : (int, int)             where the number of rows stands
    tags : (k,) int64           of nodes or elements
    values : (k, w) float64     components; of element nodes those of all nodes, the rest not a
                                number
    spans : (k, w, 2) int64     where they stand
    rows : (k, 2) int64
    """

    kind: str
    name: str
    step: int
    time: float
    at: tuple[int, int]
    tags: NDArray[np.int64]
    values: NDArray[np.float64]
    spans: NDArray[np.int64]
    rows: NDArray[np.int64]


def parsed(data: bytes) -> File:
    """Find the sections of a file.

    Raises
    ------
    MeshFileError    it is none of Gmsh's files, or of a version that is not known
    EOFError         a section does not end
    """
    at = 0
    found: list[Section] = []
    while (first := re.compile(rb"\S").search(data, at)) is not None:
        line = re.compile(rb"([^\r\n]*)(?:\r?\n|\r|$)").match(data, first.start())
        word = line[1].strip() if line else b""
        if line is None or word[:1] != b"$":
            said = word[:60].decode("latin-1")
            msg = (f"it has the line {said!r} between sections" if found
                   else "it does not begin with $MeshFormat")
            raise MeshFileError(msg)
        name = word[1:].decode("latin-1")
        close = (b"$END" if name in OLD else b"$End") + word[1:]
        stop = data.find(close, line.end())
        if stop < 0:
            msg = f"it ends too early, within the section {name}"
            raise EOFError(msg)
        found.append(Section(OLD.get(name, name), line.end(), stop))
        at = stop + len(close)
    head = next((s for s in found if s.name == "MeshFormat"), None)
    if head is None:
        if not re.match(rb"\s*(?:\$Comments.*?)?\$NOD\s", data, re.DOTALL):
            msg = "it does not begin with $MeshFormat"
            raise MeshFileError(msg)
        return File(data, "1", True, "<", "u8", found)
    words = data[head.start: head.stop].split(None, 3)
    number, binary, size = words[0].decode("latin-1"), int(words[1]), int(words[2])
    version = {"4": "4.0", "2.0": "2", "2.1": "2", "2.2": "2"}.get(number, number)
    if version not in ("2", "4.0", "4.1") or size not in (4, 8):
        msg = f"it is of version {number}, with numbers of {size} bytes"
        raise MeshFileError(msg)
    start = data.index(b"\n", head.start) + 1 if binary else 0
    swapped = binary and data[start: start + 4] != b"\1\0\0\0"
    order: Literal["<", ">"] = ">" if swapped else "<"
    return File(data, version, not binary, order, f"u{size}", found)


def put_first(file: File, first: list[Section], others: list[Section]) -> bytes:
    """The file with some sections, then some others, and none besides."""
    out = []
    for section in first + others:
        close = re.compile(rb"[^\r\n]*(?:\r?\n|\r|$)").match(file.data, section.stop)
        start = file.data.rindex(b"$", 0, section.start)
        out.append(file.data[start: close.end() if close else section.stop])
    return b"".join(out)


class Numbers:
    """Takes the numbers of a section one after another, and says where they stand."""

    def __init__(self, file: File, start: int, stop: int) -> None:
        self.file, self.stop = file, stop
        self.at = 0 if file.text else start
        self.edges = np.zeros((0, 2), dtype=np.int64)
        if not file.text:
            return
        body = file.data[start:stop]
        blank = np.ones(len(body) + 2, dtype=np.bool_)
        blank[1:-1] = np.frombuffer(body, np.uint8) <= ord(" ")
        turns = np.flatnonzero(blank[1:] != blank[:-1]).reshape(-1, 2)
        self.edges = turns + start
        plain = re.sub(FORTRAN, b"e", body) if b"d" in body.lower() else body
        self.values = np.fromstring(plain, dtype=np.float64, sep=" ")
        if len(self.values) != len(turns):
            msg = "it has words where numbers are expected"
            raise MeshFileError(msg)

    def take(self, kind: Any, count: int) -> NDArray[Any]:
        """Take some numbers of one type, or rows of several types.

        Raises
        ------
        EOFError    there are fewer
        """
        if self.file.text:
            values = self.values[self.at: self.at + count]
            self.at += count
            if len(values) == count >= 0:
                return values.astype(kind)
        else:
            dtype = np.dtype(kind).newbyteorder(self.file.order)
            end = self.at + count * dtype.itemsize
            if count >= 0 and end <= self.stop:
                start, self.at = self.at, end
                return np.frombuffer(self.file.data, dtype, count, start)
        msg = "it ends too early"
        raise EOFError(msg)

    def integers(self, kind: str, count: int) -> list[int]:
        """Take some whole numbers."""
        return [int(value) for value in self.take(kind, count).tolist()]

    def table(self, kinds: list[tuple[str, int]], count: int) -> tuple[list[Any], Any]:
        """Take `count` rows of numbers of several types, of each type so many.

        Returns
        -------
        columns : list of arrays (count, number)
        spans : (count, numbers of a row, 2) int64    where they stand
        """
        width = sum(number for _, number in kinds)
        if self.file.text:
            edges = self.edges[self.at: self.at + count * width]
            rows = self.take("f8", count * width).reshape(count, width)
            ends = np.cumsum([0, *(number for _, number in kinds)])
            columns = [rows[:, a:b].astype(kind) for (kind, _), a, b in
                       zip(kinds, ends[:-1], ends[1:], strict=True)]
            return columns, edges.reshape(count, width, 2)
        at = self.at
        sizes = np.concatenate([np.full(number, np.dtype(kind).itemsize) for kind, number in kinds])
        records = self.take([(f"f{i}", kind, (number,))
                             for i, (kind, number) in enumerate(kinds)], count)
        starts = np.cumsum([0, *sizes[:-1]]) + at + sizes.sum() * np.arange(count)[:, None]
        spans = np.stack([starts, starts + sizes], axis=2)
        return [records[f"f{i}"].astype(records[f"f{i}"].dtype.newbyteorder("="))
                for i in range(len(kinds))], spans

    def here(self, kind: str) -> tuple[int, int]:
        """Where the bytes of the next number stand."""
        if not self.file.text:
            return self.at, self.at + np.dtype(kind).itemsize
        start, stop = self.edges[self.at].tolist() if self.at < len(self.edges) else (0, 0)
        return start, stop


def counted(file: File, section: Section) -> tuple[int, tuple[int, int], Numbers]:
    """Number of rows in the first line of a section, where it stands, and what follows."""
    line = re.compile(rb"\s*(\d+)[ \t]*(?:\r?\n|\r|$)")
    head = line.match(file.data, section.start, section.stop)
    if head is None:
        msg = f"the section {section.name} does not say how much it has"
        raise EOFError(msg)
    return int(head[1]), head.span(1), Numbers(file, head.end(), section.stop)


def line_end(file: File) -> bytes:
    """What ends the lines of a file of text."""
    found = re.search(rb"\r?\n|\r", file.data)
    return found[0] if found else b"\n"


def heads(file: File, section: Section) -> list[tuple[int, int]]:
    """Where the numbers stand that tell how much the section has."""
    if file.version in ("1", "2"):
        return [counted(file, section)[1]]
    numbers = Numbers(file, section.start, section.stop)
    count = 4 if file.version == "4.1" else 2
    return [(int(start), int(stop)) for start, stop in
            numbers.table([(file.long, count)], 1)[1][0].tolist()]


def nodes(file: File, section: Section) -> Nodes:
    """Read the nodes."""
    old, new = file.version in ("1", "2"), file.version == "4.1"
    blocks: list[Block] = []
    parts: list[Any] = [(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 2), np.int64),
                         np.zeros((0, 3, 2), np.int64), *[np.zeros((0, 2), np.int64)] * 2)]
    if old:
        count, where, numbers = counted(file, section)
        waiting = 1
    else:
        numbers = Numbers(file, section.start, section.stop)
        waiting = numbers.integers(file.long, 4 if new else 2)[0]
    for _ in range(waiting):
        dim, tag, parametric = (0, 0, 0) if old else numbers.integers("i4", 3)
        dim, tag = (dim, tag) if new else (tag, dim)
        if not old:
            where = numbers.here(file.long)
            count = numbers.integers(file.long, 1)[0]
        width = 3 + (dim if parametric else 0)
        if new:
            (tags,), head = numbers.table([(file.long, 1)], count)
            (points,), spans = numbers.table([("f8", width)], count)
            rows = np.stack([spans[:, 0, 0], spans[:, -1, 1]], axis=1)
        else:
            (tags, points), spans = numbers.table([("i4", 1), ("f8", width)], count)
            rows = np.stack([spans[:, 0, 0], spans[:, -1, 1]], axis=1)
            head, spans = spans[:, :1], spans[:, 1:]
        first = blocks[-1].last if blocks else 0
        blocks.append(Block((dim, tag), bool(parametric), where, first, first + count))
        parts.append((tags[:, 0].astype(np.int64), points[:, :3], np.tile([dim, tag], (count, 1)),
                      spans[:, :3], head[:, 0], rows))
    tags, points, entities, spans, head, rows = (
        np.concatenate(of) for of in zip(*parts, strict=True))
    return Nodes(tags, points, entities, spans, head, rows, blocks)


def elements(file: File, section: Section, sizes: dict[int, int]) -> list[Run]:
    """Read the elements; `sizes` are their numbers of nodes by the numbers of their types.

    Raises
    ------
    MeshFileError    a type is not known
    """
    if file.version in ("1", "2"):
        count, _, numbers = counted(file, section)
        read = _old_rows if file.text else _old_binary
        return read(file, numbers, count, sizes)
    numbers = Numbers(file, section.start, section.stop)
    new = file.version == "4.1"
    blocks = numbers.integers(file.long, 4 if new else 2)[0]
    out = []
    for _ in range(blocks):
        dim, tag, kind = numbers.integers("i4", 3)
        dim, tag = (dim, tag) if new else (tag, dim)
        where = numbers.here(file.long)
        count = numbers.integers(file.long, 1)[0]
        width = 1 + _size(sizes, kind)
        (rows,), spans = numbers.table([(file.long if new else "i4", width)], count)
        rows = rows.astype(np.int64)
        out.append(Run(kind, rows[:, 0], np.zeros((count, 0), np.int64), rows[:, 1:], (dim, tag),
                       where, np.stack([spans[:, 0, 0], spans[:, -1, 1]], axis=1)))
    return out


def _size(sizes: dict[int, int], kind: int) -> int:
    if kind not in sizes:
        msg = f"it has elements of type {kind}"
        raise MeshFileError(msg)
    return sizes[kind]


def _old_rows(file: File, numbers: Numbers, count: int, sizes: dict[int, int]) -> list[Run]:
    """Rows of text of versions 1 and 2: each has its type, and in version 2 some tags."""
    words = numbers.values.astype(np.int64)
    listed = words.tolist()
    first = file.version == "1"
    rows, at = [], 0
    for _ in range(count):
        if at + 5 > len(listed):
            msg = "it ends too early"
            raise EOFError(msg)
        kind, tags = listed[at + 1], 2 if first else listed[at + 2]
        rows.append((at, kind, tags, _size(sizes, kind)))
        at += (5 if first else 3 + tags) + rows[-1][3]
        if first and listed[rows[-1][0] + 4] != rows[-1][3]:
            msg = f"an element of type {kind} has {listed[rows[-1][0] + 4]} nodes"
            raise MeshFileError(msg)
    if at > len(listed):
        msg = "it ends too early"
        raise EOFError(msg)
    table = np.array(rows, dtype=np.int64).reshape(-1, 4)
    cuts = 1 + np.flatnonzero((table[1:, 1:] != table[:-1, 1:]).any(axis=1))
    out = []
    for part in np.split(table, cuts) if len(table) else []:
        start = part[:, 0]
        kind, tags, size = (int(value) for value in part[0, 1:])
        behind = start[:, None] + (5 if first else 3 + tags)
        last = behind[:, 0] + size - 1
        out.append(Run(
            kind, words[start], words[start[:, None] + (2 if first else 3) + np.arange(tags)],
            words[behind + np.arange(size)], (0, 0), (0, 0),
            np.stack([numbers.edges[start, 0], numbers.edges[last, 1]], axis=1)))
    return out


def _old_binary(file: File, numbers: Numbers, count: int, sizes: dict[int, int]) -> list[Run]:
    """Runs of version 2 in binary; Gmsh gives each element a head of its own, others many one."""
    out: list[Run] = []
    while count > 0:
        at = numbers.at
        kind, size, tags = numbers.integers("i4", 3)
        width = 1 + tags + _size(sizes, kind)
        where = (at + 4, at + 8)
        if size == 1:
            numbers.at, where = at, (0, 0)
            size = _alike(file, numbers, count, 3 + width)
            (rows,), spans = numbers.table([("i4", 3 + width)], size)
            rows = rows[:, 3:]
        else:
            (rows,), spans = numbers.table([("i4", width)], size)
        rows = rows.astype(np.int64)
        out.append(Run(kind, rows[:, 0], rows[:, 1: 1 + tags], rows[:, 1 + tags:], (0, 0), where,
                       np.stack([spans[:, 0, 0], spans[:, -1, 1]], axis=1)))
        count -= size
    return out


def _alike(file: File, numbers: Numbers, most: int, width: int) -> int:
    """How many rows with a head of their own have the same one, one after another."""
    most = min(most, (numbers.stop - numbers.at) // (4 * width))
    table = np.frombuffer(file.data, "i4", most * width, numbers.at).reshape(most, width)
    found = 1
    while found < most:
        same = (table[found: 2 * found, :3] == table[0, :3]).all(axis=1)
        found += int(same.argmin()) if not same.all() else len(same)
        if not same.all():
            break
    return found


def values(file: File, section: Section) -> Values:
    """Read the values of a view at a step.

    Raises
    ------
    EOFError    there are fewer than it says
    """
    lines = re.compile(rb"[ \t]*([^\r\n]*?)[ \t]*(?:\r?\n|\r|$)")
    at = section.start
    groups: list[list[bytes]] = []
    count = (0, 0)
    for _ in range(3):
        head = lines.match(file.data, at, section.stop)
        if head is None or not head[1].isdigit():
            msg = f"the section {section.name} does not say how many tags it has"
            raise EOFError(msg)
        at, own = head.end(), []
        for i in range(int(head[1])):
            line = lines.match(file.data, at, section.stop)
            if line is None or at >= section.stop:
                msg = "it ends too early"
                raise EOFError(msg)
            own.append(line[1])
            at = line.end()
            count = line.span(1) if i == 2 else count
        groups.append(own)
    names, reals, integers = groups
    width, size = int(integers[1]), int(integers[2])
    numbers = Numbers(file, at, section.stop)
    name = names[0].strip().strip(b'"').decode("utf-8", "replace") if names else ""
    step, time = int(integers[0]), float(reals[0]) if reals else 0.0
    if section.name != "ElementNodeData":
        (tags, found), spans = numbers.table([("i4", 1), ("f8", width)], size)
        return Values(section.name, name, step, time, count, tags[:, 0].astype(np.int64), found,
                      spans[:, 1:], np.stack([spans[:, 0, 0], spans[:, -1, 1]], axis=1))
    tags_of, rows, parts = [], [], []
    for _ in range(size):
        start = numbers.here("i4")[0]
        tag, corners = numbers.integers("i4", 2)
        (found,), spans = numbers.table([("f8", width * corners)], 1)
        tags_of.append(tag)
        rows.append((start, int(spans[0, -1, 1]) if spans.size else start))
        parts.append(found[0])
    out = np.full((size, max(map(len, parts), default=0)), np.nan)
    for row, part in zip(out, parts, strict=True):
        row[: len(part)] = part
    return Values(section.name, name, step, time, count, np.array(tags_of, dtype=np.int64), out,
                  np.zeros((size, 0, 2), np.int64), np.array(rows, dtype=np.int64).reshape(-1, 2))


def names(file: File) -> dict[str, NDArray[np.int64]]:
    """Tag and dimension of every named physical group."""
    found = []
    for section in file.all("PhysicalNames"):
        body = file.data[section.start: section.stop].decode("utf-8", "replace")
        found += re.findall(r'(\d+)\s+(-?\d+)\s+"([^"\r\n]*)"', body)
    return titled((name, int(dim), int(tag)) for dim, tag, name in found)
