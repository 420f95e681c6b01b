"""Sections of Netgen's files: rows of points, segments and elements, and where their words are."""

from __future__ import annotations

import gzip
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.change import NotRewritable
from odt_plugins.adapters.host import each_once

SURFACE, VOLUME = rb"surfaceelements(?:gi|uv)?", rb"volumeelements"

HEAD = {SURFACE: 5, VOLUME: 2}
"""Words of a row before its nodes; the last one is the number of these."""

LABEL = {2: 0, 3: 8}
"""Place of the number of an edge in a row of `edgesegmentsgi2`, by the dimension of the mesh."""


class Form(NamedTuple):
    """Where rows of segments have what.

    Attributes
    ----------
    words : int              of a row
    node : int               place of the first node; the other one follows
    edge : int               place of the number of the edge, or of its descriptor
    parameters : two ints    places of the parameters of the nodes along the edge
    """

    words: int
    node: int
    edge: int
    parameters: tuple[int, int]


SEGMENTS = {
    rb"edgesegmentsgi2": Form(12, 2, 8, (9, 11)), rb"edgesegmentsgi3": Form(7, 0, 6, (4, 5))}


class Row(NamedTuple):
    """A row of a section.

    Attributes
    ----------
    start, stop : int
    words : list of bytes
    spans : list of pairs       where these start and stop
    nodes : range               places of the nodes among the words
    parameters : list of tuples places of what is told of each node
    of : bytes                  surface or edge
    """

    start: int
    stop: int
    words: list[bytes]
    spans: list[tuple[int, int]]
    nodes: range
    parameters: list[tuple[int, ...]]
    of: bytes

    def points(self) -> list[int]:
        """Numbers of the nodes, from 0 on."""
        return [int(self.words[k]) - 1 for k in self.nodes]

    def values(self, node: int) -> list[float]:
        """What is told of a node, by its place among those of the row."""
        return [float(self.words[k]) for k in self.parameters[node]]


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
    head = re.search(rb"(?:^|\n)[ \t]*(?:" + name + rb")[ \t]*\r?\n\s*(\d+)\s", data)
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
    words = re.compile(rb"\S+").finditer(data, at)
    rows = [_row([next(words) for _ in range(width)], range(width), [], b"") for _ in range(count)]
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
    words = re.compile(rb"\S+").finditer(data, at)
    rows = []
    for _ in range(count):
        row = [next(words) for _ in range(head)]
        nodes = int(row[-1][0])
        row += [next(words) for _ in range(nodes * (1 + width))]
        told = [tuple(range(head + nodes + k * width, head + nodes + (k + 1) * width))
                for k in range(nodes)]
        rows.append(_row(row, range(head, head + nodes), told, row[0][0]))
    return Rows(rows, number_before(data, at), rows[-1].stop if rows else at)


def segments(data: bytes) -> tuple[Rows, NDArray[np.int64]]:
    """Rows of segments in the forms that are known, and the numbers (q,) of their edges."""
    dim = re.search(rb"(?m)^[ \t]*dimension\s+(\d)", data)
    for name, form in SEGMENTS.items():
        found = section(data, name)
        if not (found and found[1] and dim):
            continue
        at, count = found
        lines = data[at:].split(b"\n", count)[:count]
        if any(len(line.split()) != form.words for line in lines):
            continue
        words = re.compile(rb"\S+").finditer(data, at)
        rows = []
        for _ in range(count):
            row = [next(words) for _ in range(form.words)]
            rows.append(_row(row, range(form.node, form.node + 2),
                             [(k,) for k in form.parameters], row[form.edge][0]))
        place = form.edge if name == rb"edgesegmentsgi3" else LABEL[int(dim[1])]
        label = np.array([int(row.words[place]) for row in rows], dtype=np.int64)
        if name == rb"edgesegmentsgi3":
            told = section(data, rb"edgedescriptors")
            own = [int(line.split()[0])
                   for line in (data[told[0]:].split(b"\n", told[1])[: told[1]] if told else ())]
            label = np.array(own, dtype=np.int64)[label]
        return Rows(rows, number_before(data, at), rows[-1].stop), label
    return Rows([], (0, 0), 0), np.zeros(0, dtype=np.int64)


def lines_of(rows: Sequence[Row], label: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Which rows of segments are blocks of lines, of which none has a line twice."""
    nodes = np.array([row.points() for row in rows], dtype=np.int64).reshape(-1, 2)
    return [own for _, own in each_once("line", nodes, label)]


def _row(
    words: list[re.Match[bytes]], nodes: range, parameters: list[tuple[int, ...]], of: bytes
) -> Row:
    return Row(words[0].start(), words[-1].end(), [word[0] for word in words],
               [word.span() for word in words], nodes, parameters, of)
