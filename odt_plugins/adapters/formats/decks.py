"""Decks of text: records that are exchanged word by word, and who takes the place of whom."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.change import Change, NotRewritable
from odt_plugins.adapters.regions import region_names, spreads
from odt_plugins.errors import MeshFileError, UnsupportedMeshError

Name = tuple[str, int]
"""Part and number of a node or an element."""

Edit = tuple[int, int, bytes]
"""Where a piece of a file starts and stops, and what takes its place."""


REMARKS = "remarks"
"""Attribute of a meshio.Mesh: what its reader has to say, one sentence an entry."""

HELD = "held"
"""Attribute of a meshio.Mesh: vertices that have to stay, since its file refers to them."""

DECK = "deck"
"""Attribute of a meshio.Mesh that was just read: its file, taken apart."""

UNREAD = "unread"
"""Key of what a file says that its mesh does not hold, in `info` of a meshio.Mesh."""

ORDERS = {"tetra": 1, "tetra10": 2, "triangle": 1, "triangle6": 2}
"""Orders of the types of cells that may be optimised, the first that is there is."""

LINEAR = ("vertex", "line", "triangle", "quad", "tetra", "hexahedron", "wedge", "pyramid")

FACES = {
    "tetra": [[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]],
    "tetra10": [[0, 1, 2, 4, 5, 6], [0, 3, 1, 7, 8, 4], [1, 3, 2, 8, 9, 5], [2, 3, 0, 9, 7, 6]],
    "triangle": [[0, 1], [1, 2], [2, 0]],
    "triangle6": [[0, 1, 3], [1, 2, 4], [2, 0, 5]],
}
"""Places of the nodes of the faces, by their numbers from 1 on, in cells that may be optimised."""

CORNERS = {"tetra": 3, "tetra10": 3, "triangle": 2, "triangle6": 2}
"""Numbers of corners of the faces."""

QUADRATIC = ("line3", "triangle6", "tetra10")


def with_included(
    path: Path, words: re.Pattern[bytes], comment: bytes, outer: frozenset[Path] = frozenset()
) -> bytes:
    """A deck with the files that it includes in the place of the words that do so.

    Parameters
    ----------
    path : path
    words : pattern    its group `file` is the path of the other, and `cut` what is taken out of
                       the line, if that is no INCLUDE, which becomes a comment
    comment : bytes    what a comment begins with
    outer : set        files that are open already, which are not included again

    Raises
    ------
    MeshFileError    a file is not there
    """
    data, outer = path.read_bytes(), outer | {path.resolve()}
    out, at = [], 0
    for found in words.finditer(data):
        name = re.sub(r"\s*[\r\n]+\s*", "", found["file"].decode("utf-8", "replace")).strip("\"'")
        other = path.parent / name.replace("\\", "/")
        if not other.is_file():
            msg = f"it includes {name}, which is not there"
            raise MeshFileError(msg)
        last = re.compile(rb"\r?\n|\r|\Z").search(data, found.end())
        stop = len(data) if last is None else last.end()
        line = data[found.start(): stop].rstrip(b"\r\n")
        end = data[found.start() + len(line): stop] or b"\n"
        line = (comment + b" ".join(line.split()) if re.match(rb"(?i)\W*INCLUDE", found[0])
                else line.replace(found["cut"], b""))
        more = b""
        if other.resolve() not in outer:
            more = with_included(other, words, comment, outer)
        out += [data[at: found.start()], line, end, more]
        out += [end] if more and not more.endswith((b"\r", b"\n")) else []
        at = stop
    return b"".join([*out, data[at:]])


def edited(data: bytes, edits: Iterable[Edit]) -> bytes:
    """Put other text in the place of pieces of a file, which do not overlap."""
    out, at = [], 0
    for start, stop, text in sorted(edits, key=lambda edit: edit[:2]):
        out += [data[at:start], text]
        at = stop
    return b"".join([*out, data[at:]])


def substituted(text: bytes, spans: Sequence[tuple[int, int]], words: Mapping[int, bytes]) -> bytes:
    """Exchange some words of a record, which are told by their places among all of its spans."""
    return edited(text, [(*spans[i], word) for i, word in words.items()
                         if text[spans[i][0]: spans[i][1]] != word])


class Row(NamedTuple):
    """A line of words between blanks: the words, and where the line starts and stops."""

    words: list[bytes]
    start: int
    stop: int


def rows_of(data: bytes, comment: bytes) -> Iterator[Row]:
    """Lines of a file that have more than a comment, which begins as is told."""
    at = 0
    for line in data.splitlines(keepends=True):
        start, at = at, at + len(line)
        words = line.partition(comment)[0].split()
        if words:
            yield Row(words, start, at)


def as_lines(data: bytes, row: Row, parts: Sequence[Mapping[int, Any]]) -> Edit:
    """Put a line for each of some parts in the place of a line, with other words at some places."""
    text = data[row.start: row.stop]
    end = text[len(text.rstrip(b"\r\n")):] or b"\n"
    spans = [word.span() for word in re.finditer(rb"\S+", text)]
    lines = [substituted(text, spans, {
        i: word if isinstance(word, bytes) else str(word).encode() for i, word in part.items()
    }) for part in parts]
    return row.start, row.stop, b"".join(
        line if line.endswith((b"\n", b"\r")) or k == len(lines) - 1 else line + end
        for k, line in enumerate(lines))


def numbers(words: Sequence[bytes]) -> list[float]:
    """Numbers, whose exponents may be as Fortran writes them."""
    return [float(word.replace(b"D", b"e").replace(b"d", b"e")) for word in words]


def deck_of(change: Change, source: Path, parsed: Callable[[Path], Any]) -> Any:
    """The source of a change, taken apart: as it was when it was read, or by its reader."""
    return getattr(change.before, DECK, None) or parsed(source)


def unread(what: str, names: Iterable[str]) -> dict[str, list[str]]:
    """What a file says besides its mesh, as `info` of that: some sections, each named once."""
    found = sorted(set(names))
    return {UNREAD: [f"{what} {', '.join(found)}"] if found else []}


def indices(members: Any) -> NDArray[np.int64]:
    """Members of a set, which are given as such, as a mask, or as None where there are none."""
    given = np.asarray([] if members is None else members).ravel()
    return np.flatnonzero(given) if given.dtype == np.bool_ else given.astype(np.int64)


def expect_points(rows: NDArray[np.int64], count: int, first: int = 0) -> None:
    """See whether cells refer to points that are there.

    Raises
    ------
    KeyError    one is not
    """
    bad = rows[(rows < 0) | (rows >= count)]
    if bad.size:
        raise KeyError(int(bad[0]) + first)


def refuse_types(unknown: Collection[str]) -> None:
    """Refuse cells of types that a format does not hold, if there are any."""
    if unknown:
        msg = f"it holds no cells of type {', '.join(sorted(unknown))}"
        raise UnsupportedMeshError(msg)


def real(x: float, width: int = 24) -> bytes:
    """Text of at most `width` letters that reads as a number, or as the nearest that has one.

    Raises
    ------
    NotRewritable    there is no room for any digit
    """
    for digits in range(min(17, width - 1 - (x < 0)), 0, -1):
        y = float(f"{x:.{digits}g}")
        plain = repr(y)
        if "." in plain and len(plain) <= width:
            return plain.encode()
        short = plain.replace("0.", ".", 1) if abs(y) < 1 else plain
        if "." in short and len(short) <= width:
            return short.encode()
        form = np.format_float_scientific(y, trim="0", exp_digits=1)
        if len(form) <= width:
            return form.encode()
    msg = f"{x!r} needs more than {width} letters"
    raise NotRewritable(msg)


def places(
    rows: NDArray[np.int64], fresh: NDArray[np.bool_], kinds: Sequence[Any]
) -> list[list[tuple[int, int]]]:
    """Say which records new cells of a block take.

    A cell stands where the cell stood from which its data come, and takes its name; the names of
    cells that went pass to new ones of their kind.

    Parameters
    ----------
    rows : (m',) int          cell of before of every cell of after
    fresh : (m',) bool        those that are other cells
    kinds : (m,)              what tells apart cells whose names must not be exchanged

    Returns
    -------
    list of lists    for every row of before (cell of after, row whose name it takes or -1)
    """
    order = np.argsort(fresh, kind="stable")
    used, first = np.unique(rows[order], return_index=True)
    taken = np.full(len(rows), -1, dtype=np.int64)
    taken[order[first]] = used
    names = taken.tolist()
    unused = np.ones(len(kinds), dtype=np.bool_)
    unused[used] = False
    free: dict[Any, list[int]] = {}
    for r in np.flatnonzero(unused).tolist()[::-1]:
        free.setdefault(kinds[r], []).append(r)
    out: list[list[tuple[int, int]]] = [[] for _ in kinds]
    for i, r in enumerate(rows.tolist()):
        name = names[i]
        if name < 0 and free.get(kinds[r]):
            name = free[kinds[r]].pop()
        out[r].append((i, name))
    return out


class Names:
    """Numbers of the nodes and elements of a result, of those that went, and of new ones.

    Parameters
    ----------
    number : dict                index of every node by part and number
    blocks : list                part of every block, and numbers of its elements
    kinds : list of lists        for every block what tells apart elements whose numbers must not be
                                 exchanged
    last : dict                  largest number of an element of every part

    Attributes
    ----------
    nodes : (n',) int            number of every node
    parts : list of str          part of every node
    lost : set of Name           nodes that went
    of : list of list of int     for every block the number of every element
    slots : list of lists        for every block and old row the new rows in its place
    gone : set of Name
    fresh : dict                 numbers of new elements by that of the one they come from
    """

    def __init__(
        self, change: Change, number: Mapping[Name, int],
        blocks: Sequence[tuple[str, Sequence[int]]], kinds: Sequence[Sequence[Any]],
        last: Mapping[str, int],
    ) -> None:
        of = {v: name for name, v in number.items()}
        self.lost = {of[v] for v in np.flatnonzero(change.number < 0).tolist()}
        old = [of.get(v, ("", -1)) for v in change.points.tolist()]
        self._after = change.after
        most: dict[str, int] = {}
        for part, n in number:
            most[part] = max(most.get(part, 0), n)
        for b, (part, _) in enumerate(blocks):
            cells = np.asarray(change.after.cells[b].data)
            for row in cells[(change.points[cells] < 0).any(axis=1)].tolist():
                home = part if part in most else ""
                for v in row:
                    if old[v] == ("", -1):
                        most[home] += 1
                        old[v] = (home, most[home])
        self.parts = [part for part, _ in old]
        self.nodes = np.array([n for _, n in old], dtype=np.int64)
        self.of: list[list[int]] = []
        self.slots: list[list[list[int]]] = []
        self.gone: set[Name] = set()
        self.fresh: dict[Name, list[int]] = {}
        highest = dict(last)
        for b, (part, ids) in enumerate(blocks):
            table = places(change.cells[b], change.exchanged(b), kinds[b])
            names = [0] * len(change.cells[b])
            for r, slot in enumerate(table):
                for i, taken in slot:
                    names[i] = ids[taken]
                    if taken < 0:
                        highest[part] += 1
                        names[i] = highest[part]
                        self.fresh.setdefault((part, ids[r]), []).append(names[i])
            kept = set(names)
            self.gone |= {(part, i) for i in ids if i not in kept}
            self.of.append(names)
            self.slots.append([[i for i, _ in slot] for slot in table])

    def of_set(self, title: str, part: str) -> set[int]:
        """Numbers of the nodes of a part that are in a set of the result."""
        members = self._after.point_sets.get(title, ())
        return {int(self.nodes[v]) for v in indices(members).tolist() if self.parts[v] == part}


def faces_of(change: Change, kinds: Sequence[str], block: int) -> list[tuple[int, int, int]]:
    """Block, row and number of the face of the cells of a result that each row of a block is.

    Where two cells have it, it is that of the one whose corners there have the sense of the row.

    Parameters
    ----------
    kinds : types of the blocks of cells that are looked at, the first ones of the mesh
    block : int    a later one, of faces

    Raises
    ------
    NotRewritable    one is no face
    """
    rows = np.asarray(change.after.cells[block].data)
    rows = rows[:, : 2 if change.after.cells[block].type.startswith("line") else 3]
    near = np.zeros(len(change.after.points), dtype=np.bool_)
    near[rows] = True
    faces: dict[tuple[int, ...], tuple[int, int, int]] = {}
    for b, kind in enumerate(kinds):
        cells = np.asarray(change.after.cells[b].data)
        for face in range(len(FACES.get(kind, ()))):
            corners = cells[:, FACES[kind][face][: CORNERS[kind]]]
            for i in np.flatnonzero(near[corners].all(axis=1)).tolist():
                faces[_turned(corners[i].tolist())] = (b, i, face)
    out = [faces.get(_turned(row)) or faces.get(_turned(row[::-1])) for row in rows.tolist()]
    if None in out:
        msg = "it refers to a face that is no more"
        raise NotRewritable(msg)
    return [found for found in out if found]


def load_labels(
    told: Sequence[Any], rows: NDArray[np.int64], regions: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Numbers (k,) from 0 on of loads on faces, equal where they say the same.

    Where some are on both sides of a face, or twice on one, those of other regions are others.

    Parameters
    ----------
    told : what each of the loads says
    rows : (k, r) int       corners of the faces
    regions : (k,) int      labels of the cells that have them
    """
    known = {load: i for i, load in enumerate(dict.fromkeys(told))}
    label = np.array([known[load] for load in told], dtype=np.int64)
    if len(np.unique(np.sort(rows, axis=1), axis=0)) == len(rows):
        return label
    return np.unique(np.stack([label, regions], axis=1), axis=0, return_inverse=True)[1].ravel()


def _turned(row: list[int]) -> tuple[int, ...]:
    """Corners of a face, the smallest first, in the same sense."""
    k = row.index(min(row)) if len(row) > 2 else 0
    return (*row[k:], *row[:k])


def joint_labels(
    columns: Sequence[NDArray[Any]], sets: Mapping[str, NDArray[np.bool_]], cells: NDArray[Any]
) -> NDArray[np.int64] | None:
    """Labels (m,) from 1 on, equal where all columns and all sets that part the mesh are equal.

    Returns
    -------
    None    all cells would have the same
    """
    taken = [*columns, *(sets[name] for name in region_names([spreads(sets, cells)]))]
    if not taken:
        return None
    label = alike(taken)[1]
    return label + 1 if label.any() else None


def alike(columns: Sequence[NDArray[Any]]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First of the cells that are equal in all columns, and which of these every cell is like.

    As bytes, rows of a thousand sets are compared at once, and not set by set.

    Parameters
    ----------
    columns : (m,) each     numbers, then truth values: by these the first ones ascend
    """
    marks = [one for one in columns if one.dtype == np.bool_]
    parts = [np.unique(one, return_inverse=True)[1].astype(">i8").reshape(-1, 1).view(np.uint8)
             for one in columns if one.dtype != np.bool_]
    parts += [np.packbits(np.stack(marks, axis=1), axis=1)] if marks else []
    rows = np.ascontiguousarray(np.concatenate(parts, axis=1))
    _, first, inverse = np.unique(rows.view(f"V{rows.shape[1]}").ravel(), return_index=True,
                                  return_inverse=True)
    return first, inverse.ravel()


def order_of(kinds: Iterable[str]) -> int:
    """Order of the cells among some types that are optimised; 0 where there are none."""
    found = set(kinds)
    return next((order for kind, order in ORDERS.items() if kind in found), 0)


def fits(kind: str, order: int) -> bool:
    """Whether cells of a type may lie beside those of some order that are optimised."""
    return order == 0 or kind in LINEAR or (order == 2 and kind in QUADRATIC)
