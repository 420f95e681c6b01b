"""Sections of Netgen's files: rows of points, segments and elements, and where their words are."""

from __future__ import annotations

import gzip
import re
from collections.abc import Sequence
from functools import cache
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.change import NotRewritable
from odt_plugins.adapters.host import each_once

SURFACE, VOLUME = rb"surfaceelements(?:gi|uv)?", rb"volumeelements"

HEAD = {SURFACE: 5, VOLUME: 2}
"""Words of a row before its nodes; the last one is the number of these."""


class Form(NamedTuple):
    """Where rows of segments have what.

    Attributes
    ----------
    words : int              of a row
    node : int               place of the first node; the other one follows
    edge : int               place of the number of the edge, or of its descriptor
    parameters : of Row      places of what is told of the nodes
    """

    words: int
    node: int
    edge: int
    parameters: Sequence[tuple[int, ...]]


SEGMENTS = {
    rb"edgesegments": Form(4, 2, 0, ()), rb"edgesegmentsgi": Form(6, 2, 0, ((4,), (5,))),
    rb"edgesegmentsgi2": Form(12, 2, 8, ((4, 9), (5, 11))),
    rb"edgesegmentsgi3": Form(7, 0, 6, ((2, 4), (3, 5))),
}


class Row(NamedTuple):
    """A row of a section.

    Attributes
    ----------
    start, stop : int
    words : list of bytes
    nodes : range               places of the nodes among the words
    parameters : list of tuples places of what is told of each node; empty where that is nothing
    numbers : int               how many of these, the first ones, are numbers of triangles
    of : bytes                  surface or edge
    """

    start: int
    stop: int
    words: list[bytes]
    nodes: range
    parameters: Sequence[tuple[int, ...]]
    numbers: int
    of: bytes

    def spans(self, data: bytes) -> list[tuple[int, int]]:
        """Where the words start and stop."""
        return [word.span() for word in re.compile(rb"\S+").finditer(data, self.start, self.stop)]

    def points(self) -> list[int]:
        """Numbers of the nodes, from 0 on."""
        return [int(self.words[k]) - 1 for k in self.nodes]

    def values(self, node: int) -> tuple[float, ...]:
        """What is told of a node, by its place among those of the row."""
        return tuple(float(self.words[k]) for k in self.parameters[node])


class Rows(NamedTuple):
    """Rows of a section, where its number begins and stops, and where the rows end."""

    rows: list[Row]
    number: tuple[int, int]
    stop: int


def content(path: Path) -> bytes:
    """What is in a file, which may be packed."""
    data = path.read_bytes()
    return gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data


def section(data: bytes, name: bytes) -> tuple[int, int] | None:
    """Where the rows of a section begin, and their number; None where there is none."""
    head = re.search(rb"(?m)^[ \t]*(?:" + name + rb")[ \t]*\r?\n\s*(\d+)(?!\S)[ \t\r]*\n?", data)
    return None if head is None else (head.end(), int(head[1]))


def number_before(data: bytes, at: int) -> tuple[int, int]:
    """Where the number of rows that begin at a place starts and stops."""
    found = list(re.compile(rb"\d+").finditer(data, max(at - 24, 0), at))
    return found[-1].span()


def table(data: bytes, name: bytes, width: int) -> Rows:
    """Rows of as many words each, which are all nodes; empty where there are none."""
    found = section(data, name)
    if found is None:
        return Rows([], (0, 0), 0)
    at, count = found
    rows = [Row(*row, range(width), [], 0, b"") for row in _words(data, at, count, width)]
    return Rows(rows, number_before(data, at), rows[-1].stop if rows else at)


def elements(data: bytes, name: bytes) -> Rows:
    """Rows of a section of elements, SURFACE or VOLUME.

    Raises
    ------
    NotRewritable    there is none
    """
    found = section(data, name)
    if found is None:
        msg = "it has none of the cells that were read"
        raise NotRewritable(msg)
    at, count = found
    head = HEAD[name]
    kind = re.search(rb"(?:^|\n)[ \t]*(" + name + rb")[ \t]*\r?\n", data)
    width = {b"gi": 1, b"uv": 2}.get(kind[1][-2:] if kind else b"", 0)
    forms: dict[int, tuple[range, list[tuple[int, ...]]]] = {}
    stop, rows = at, []
    for _ in range(count):
        start, middle, words = _words(data, stop, 1, head)[0]
        nodes = int(words[-1])
        if nodes not in forms:
            told = [tuple(range(head + nodes + k * width, head + nodes + (k + 1) * width))
                    for k in range(nodes if width else 0)]
            forms[nodes] = range(head, head + nodes), told
        _, stop, more = _words(data, middle, 1, nodes * (1 + width))[0]
        rows.append(Row(start, stop, words + more, *forms[nodes], int(width == 1), words[0]))
    return Rows(rows, number_before(data, at), rows[-1].stop if rows else at)


def segments(data: bytes) -> tuple[Rows, NDArray[np.int64]]:
    """Rows of segments in the forms that are known, and the numbers (q,) that names give these."""
    dim = re.search(rb"(?m)^[ \t]*dimension\s+(\d)", data)
    for name, form in SEGMENTS.items():
        found = section(data, name)
        if not (found and found[1] and dim):
            continue
        at, count = found
        rows = [Row(*row, range(form.node, form.node + 2), form.parameters, 1, row[2][form.edge])
                for row in _words(data, at, count, form.words)]
        # Rows of another form would end elsewhere, or amid a line.
        if len(rows) < count or not re.compile(rb"\s*\n\s*[#a-z]").match(data, rows[-1].stop):
            continue
        # Descriptors are counted from 0 on, names of edges from 1 on.
        first = int(name == rb"edgesegmentsgi3")
        place = form.edge if first or dim[1] == b"3" else 0
        label = np.array([int(row.words[place]) + first for row in rows], dtype=np.int64)
        return Rows(rows, number_before(data, at), rows[-1].stop), label
    return Rows([], (0, 0), 0), np.zeros(0, dtype=np.int64)


def lines_of(rows: Sequence[Row], label: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Which rows of segments are blocks of lines, of which none has a line twice."""
    nodes = np.array([row.points() for row in rows], dtype=np.int64).reshape(-1, 2)
    return [own for _, own in each_once("line", nodes, label)]


@cache
def _row_of(words: int) -> re.Pattern[bytes]:
    return re.compile(rb"\S+(?:\s+\S+){%d}" % (words - 1))


def _words(data: bytes, at: int, count: int, width: int) -> list[tuple[int, int, list[bytes]]]:
    """Where rows of so many words start and stop, and their words."""
    found = islice(_row_of(width).finditer(data, at), count)
    return [(*row.span(), row[0].split()) for row in found]
