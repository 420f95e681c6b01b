"""Decks of Abaqus and CalculiX taken apart: keywords, nodes, elements, sets and their faces."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import accumulate
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.abaqus_tables import (
    NAMING,
    NODES,
    OF_ELEMENTS,
    SIDES,
    is_shell,
    type_of,
)
from odt_plugins.adapters.formats.decks import (
    FACES,
    fits,
    order_of,
    with_included,
)
from odt_plugins.adapters.formats.titles import decoded
from odt_plugins.errors import MeshFileError

MADE = ("NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SYSTEM")
"""Keywords that make nodes or elements out of others, or place them otherwise."""

FACED = {"SURFACE": "SE", "DLOAD": "P", "DFLUX": "S", "FILM": "F", "RADIATE": "R"}
"""Keywords with lines of an element, or a set of some, and a face, and the letters of that."""

MOST = 20_000_000
"""Numbers that a line of a set may generate."""


class Section(NamedTuple):
    """A keyword with what belongs to it.

    Attributes
    ----------
    name : str                         in capitals, without blanks
    params : dict of str to str        by names in capitals
    lines : list of int                those of its data
    part : str                         part in which it stands, "" outside of parts
    head : int                         last line of the keyword itself
    """

    name: str
    params: dict[str, str]
    lines: list[int]
    part: str
    head: int


class Block(NamedTuple):
    """Elements of one type, part and set: rows of nodes, numbers, and lines (first, last) each."""

    kind: str
    part: str
    word: str
    rows: NDArray[np.int64]
    ids: list[int]
    lines: list[tuple[int, int]]


class Side(NamedTuple):
    """Faces that a line of a section tells: whose they are, and the number of each from 0 on."""

    section: int
    line: int
    block: int
    rows: list[int]
    face: int


INCLUDED = re.compile(
    rb"(?i)(?:\A|(?<=[\r\n]))[ \t]*\*[ \t]*(?:INCLUDE|NODE|ELEMENT)\b[^\r\n]*?"
    rb"(?P<cut>,\s*INPUT\s*=\s*(?P<file>\"[^\"]*\"|[^\s,]+))")
"""Lines that name a file which stands in their place."""


class Deck(NamedTuple):
    """A deck, read.

    Attributes
    ----------
    texts, starts : lists            of every line, those of files that are included in the place
                                     of the line that does so: its text, and where that starts
    sections : list of Section
    number : dict                    index of a node by part and number
    lines : list of int              line of every node
    points : (n, dimension)
    blocks : list of Block           elements of known types
    held : (k,) int                  nodes of other elements, and those that are named one by one
    others : list of str             types of other elements
    elements : dict                  block and row of an element by part and number
    begun : dict                     block and row of the element that begins on a line
    sides : list of Side
    """

    texts: list[bytes]
    starts: list[int]
    sections: list[Section]
    number: dict[tuple[str, int], int]
    lines: list[int]
    points: NDArray[np.float64]
    blocks: list[Block]
    held: NDArray[np.int64]
    others: list[str]
    elements: dict[tuple[str, int], tuple[int, int]]
    begun: dict[int, tuple[int, int]]
    sides: list[Side]


def parsed(path: Path) -> Deck:
    """Take a deck apart."""
    texts = with_included(path, INCLUDED, b"** ").splitlines(keepends=True)
    sections = list(_sections(texts))
    if not sections:
        msg = "it has no keyword, which begins with *, try the suffix .avs for a file of AVS-UCD"
        raise MeshFileError(msg)
    made = sorted({s.name for s in sections if s.name in MADE})
    made += [s.name for s in sections if s.name == "NODE" and
             s.params.get("SYSTEM", "R").upper() != "R"][:1]
    if made:
        msg = f"it has *{made[0]}, expected nodes and elements that are all written out"
        raise MeshFileError(msg)
    number: dict[tuple[str, int], int] = {}
    lines: list[int] = []
    places: list[list[float]] = []
    for section in sections:
        if section.name != "NODE":
            continue
        for i in section.lines:
            words = texts[i].split(b",")
            number[section.part, int(words[0])] = len(lines)
            lines.append(i)
            places.append([float(w.replace(b"D", b"e").replace(b"d", b"e")) if w.strip() else 0.0
                           for w in words[1:4]])
    dim = max((2, *map(len, places)))
    if places and min(map(len, places)) == dim:
        points = np.array(places, dtype=np.float64)
    else:
        points = np.array([[*x, *(dim - len(x)) * [0.0]] for x in places]).reshape(-1, dim)
    while points.shape[1] > 2 and not points.size:
        points = points[:, :2]
    return _with_elements(texts, sections, number, lines, points)


def words_of(text: bytes) -> list[str]:
    """Words of a line of data."""
    return [word.strip().strip('"') for word in decoded(text).strip().split(",")]


def resolved(sections: list[Section]) -> dict[str, str]:
    """Part of every instance."""
    return {s.params["NAME"].upper(): s.params.get("PART", "").upper()
            for s in sections if s.name == "INSTANCE" and "NAME" in s.params}


def _sections(texts: list[bytes]) -> Iterator[Section]:
    """Keywords with their data, comments left out."""
    part, outer = "", ""
    found: Section | None = None
    i = 0
    while i < len(texts):
        if found is not None and texts[i][:1].isdigit():
            found.lines.append(i)
            i += 1
            continue
        line = texts[i].lstrip()
        if not line.strip() or line.startswith(b"**"):
            i += 1
            continue
        if not line.startswith(b"*"):
            if found is not None:
                found.lines.append(i)
            i += 1
            continue
        head = line.strip()
        while head.endswith(b",") and i + 1 < len(texts) and not texts[i + 1].startswith(b"*"):
            i += 1
            head += texts[i].strip()
        if found is not None:
            yield found
        word, _, rest = decoded(head).partition(",")
        params = {}
        for item in re.findall(r'(?:"[^"]*"|[^,])+', rest):
            key, _, value = item.partition("=")
            params[re.sub(r"\s", "", key).upper()] = value.strip().strip('"')
        name = re.sub(r"\s", "", word[1:]).upper()
        if name == "PART":
            part = params.get("NAME", "").upper()
        elif name == "INSTANCE":
            outer, part = part, params.get("NAME", "").upper()
        elif name == "ENDINSTANCE":
            part = outer
        elif name == "ENDPART":
            part = ""
        found = Section(name, params, [], part, i)
        i += 1
    if found is not None:
        yield found


def _with_elements(
    texts: list[bytes], sections: list[Section],
    number: dict[tuple[str, int], int], lines: list[int], points: NDArray[np.float64],
) -> Deck:
    found: dict[tuple[str, ...], tuple[list[int], list[list[int]], list[tuple[int, int]]]] = {}
    others: dict[str, list[int]] = {}
    held: list[int] = []
    order = order_of(type_of(s.params.get("TYPE", "").upper()) or "" for s in sections
                     if s.name == "ELEMENT" and s.lines)
    alias = resolved(sections)
    by_part: dict[str, dict[int, int]] = {section.part: {} for section in sections}
    for (part, i), v in number.items():
        by_part[part][i] = v
    for section in sections:
        for word in _named(texts, section):
            instance, _, text = word.upper().rpartition(".")
            home = alias.get(instance, "") or instance or section.part
            if text.isdigit() and (home, int(text)) in number:
                held.append(number[home, int(text)])
        if section.name != "ELEMENT":
            continue
        word = section.params.get("TYPE", "").upper()
        kind = type_of(word)
        if kind is None or not fits(kind, order):
            nodes = others.setdefault(word, [])
            for i in section.lines:
                nodes += [number[section.part, int(w)] for w in texts[i].split(b",")
                          if w.strip().isdigit() and (section.part, int(w)) in number]
            continue
        key = (section.part, word, section.params.get("ELSET", "").upper(), kind)
        _take(texts, section, NODES[kind], by_part[section.part],
              found.setdefault(key, ([], [], [])))
    blocks = [Block(key[3], key[0], key[1], np.array(rows, dtype=np.int64).reshape(
        -1, NODES[key[3]]), ids, spans) for key, (ids, rows, spans) in found.items() if ids]
    elements = {(block.part, i): (b, row) for b, block in enumerate(blocks)
                for row, i in enumerate(block.ids)}
    held += [v for nodes in others.values() for v in nodes]
    starts = [0, *accumulate(map(len, texts))]
    deck = Deck(texts, starts, sections, number, lines, points, blocks,
                np.unique(np.array(held, dtype=np.int64)), [w for w, v in others.items() if v],
                elements, {first: (b, row) for b, block in enumerate(blocks)
                           for row, (first, _) in enumerate(block.lines)}, [])
    deck.sides.extend(_sides(deck))
    return deck


def _named(texts: list[bytes], section: Section) -> Iterator[str]:
    """Words of a keyword and its lines that may name nodes."""
    yield from (value for key, value in section.params.items() if key.endswith("NODE"))
    where = NAMING.get(section.name)
    kind = re.sub(r"\s", "", section.params.get("TYPE", section.params.get("DEFINITION", "")))
    if section.name == "SURFACE" and kind.upper() != "NODE":
        where = None
    if section.name == "ORIENTATION" and "NODES" not in kind.upper():
        where = None
    if where is None or kind.upper() in OF_ELEMENTS:
        return
    for i in section.lines:
        words = words_of(texts[i])
        if section.name != "EQUATION" or len(words) > 2:
            yield from words[where]


def _take(
    texts: list[bytes], section: Section, size: int, at: dict[int, int],
    into: tuple[list[int], list[list[int]], list[tuple[int, int]]],
) -> None:
    """Read the elements of a section, each of as many lines as it needs."""
    ids, rows, spans = into
    lines = [texts[i] for i in section.lines]
    words = list(map(int, b" ".join(lines).replace(b",", b" ").split()))
    if {line.count(b",") for line in lines} == {size} and len(words) == len(lines) * (size + 1):
        ids += words[:: size + 1]
        rows += [[at[n] for n in words[k + 1: k + size + 1]]
                 for k in range(0, len(words), size + 1)]
        spans += [(i, i) for i in section.lines]
        return
    words = []
    first = -1
    for i, line in zip(section.lines, lines, strict=True):
        first = i if not words else first
        words += [int(w) for w in line.split(b",") if not w.isspace() and w]
        if len(words) <= size:
            continue
        ids.append(words[0])
        rows.append([at[n] for n in words[1: size + 1]])
        spans.append((first, i))
        words = []
    if words:
        msg = f"it ends within element {words[0]}, which has {len(words) - 1} nodes of {size}"
        raise MeshFileError(msg)


def elements_of(deck: Deck, part: str, word: str, seen: frozenset[Any] = frozenset()) -> set[Any]:
    """Elements (block, row) that a word on a line tells: the one of a number, or those of a set."""
    if "." in word:
        alias = resolved(deck.sections)
        of, _, own = word.partition(".")
        if of.upper() in alias:
            part, word = alias[of.upper()] or of.upper(), own
    if word.isdigit():
        found = deck.elements.get((part, int(word)))
        return set() if found is None else {found}
    return members(deck, part, word, seen)


def members(deck: Deck, part: str, name: str, seen: frozenset[Any] = frozenset()) -> set[Any]:
    """Elements (block, row) of a set, whose name may be a number."""
    alias = resolved(deck.sections)
    if "." in name and name.partition(".")[0].upper() in alias:
        return elements_of(deck, part, name, seen)
    key = (part, name.upper())
    out: set[Any] = set()
    if key in seen:
        return out
    for section in deck.sections:
        if section.params.get("ELSET", "").upper() != key[1] or section.part != part:
            continue
        home = home_of(section, alias)
        if section.name == "ELEMENT":
            out |= {deck.begun[i] for i in section.lines if i in deck.begun}
        elif section.name == "ELSET":
            for words in (words_of(deck.texts[i]) for i in section.lines):
                if "GENERATE" in section.params:
                    words = [str(i) for i in generated(words)]
                for word in filter(None, words):
                    if word.isdigit():
                        found = deck.elements.get((home, int(word)))
                        out |= set() if found is None else {found}
                    else:
                        out |= elements_of(deck, home, word, seen | {key})
    return out


def home_of(section: Section, alias: dict[str, str]) -> str:
    """Part whose numbers a set has."""
    instance = section.params.get("INSTANCE", "").upper()
    return section.part if not instance else alias.get(instance, "") or instance


def generated(words: list[str]) -> range:
    """Numbers that a line of first, last and step makes.

    Raises
    ------
    MeshFileError    they are more than any mesh has that is read here
    """
    first, last, *step = [int(word) for word in words if word]
    found = range(first, last + 1, max(1, *step) if step else 1)
    if len(found) > MOST:
        msg = f"a set is generated from {first} to {last}, expected {MOST} numbers at most"
        raise MeshFileError(msg)
    return found


def _sides(deck: Deck) -> Iterator[Side]:
    """Faces of elements that may be optimised, line by line."""
    known: dict[tuple[str, str], set[Any]] = {}
    for s, section in enumerate(deck.sections):
        if section.name not in FACED:
            continue
        for i in section.lines:
            face = face_of(section, words_of(deck.texts[i]))
            if face is None:
                continue
            key = (section.part, words_of(deck.texts[i])[0])
            if key not in known:
                known[key] = elements_of(deck, *key)
            rows: dict[int, list[int]] = {}
            for b, r in sorted(known[key]):
                block = deck.blocks[b]
                if face < len(FACES.get(block.kind, ())) and not (
                        is_shell(block.word) and "E" not in words_of(deck.texts[i])[1].upper()):
                    rows.setdefault(b, []).append(r)
            yield from (Side(s, i, b, own, face) for b, own in rows.items())


def face_of(section: Section, words: list[str]) -> int | None:
    """Number from 0 on of the face that a line tells; None of none."""
    letters = FACED.get(section.name, "")
    if len(words) < 2 or not letters:
        return None
    found = re.fullmatch(rf"[{letters}](\d)(NU)?", words[1].upper())
    return None if found is None else int(found[1]) - 1


def side_rows(deck: Deck, side: Side) -> NDArray[np.int64]:
    """Nodes of faces, (k, nodes of one)."""
    block = deck.blocks[side.block]
    return np.asarray(block.rows[side.rows][:, FACES[block.kind][side.face]])


def side_blocks(deck: Deck) -> dict[tuple[int, str], list[int]]:
    """Sides by their section and the type of their faces, of which each is a block of cells."""
    out: dict[tuple[int, str], list[int]] = {}
    for k, side in enumerate(deck.sides):
        kind = deck.blocks[side.block].kind
        size = len(FACES[kind][side.face])
        flat = kind.startswith("triangle") and size == 3
        out.setdefault((side.section, "line3" if flat else SIDES[size]), []).append(k)
    return out
