"""Nastran's bulk data, .bdf: grid points and elements in fixed and free fields."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.decks import (
    CORNERS,
    DECK,
    FACES,
    HELD,
    ORDERS,
    REMARKS,
    fits,
    joint_labels,
    load_labels,
    order_of,
    unread,
    with_included,
)
from odt_plugins.adapters.formats.nastran_tables import (
    BEAMS,
    ELEMENT,
    KINDS,
    LISTS,
    MOST,
    NAMED,
    NODES,
    ORIENTED,
    RIGID,
)
from odt_plugins.errors import MeshFileError

LABEL = "nastran:ref"
"""Array of the properties of elements."""

PART = "nastran:part"
"""Array of labels of elements, equal where their properties and all that loads say are equal."""

MOST_SETS = 100
"""Most sets of elements that values of loads make."""

INCLUDED = re.compile(
    rb"(?i)(?:\A|(?<=[\r\n]))[ \t]*INCLUDE[ \t]+(?P<file>'[^']*'|\"[^\"]*\"|[^\s'\"$]+)")
"""Entries that name a file which stands in their place."""

UNEVEN = re.compile(rb"[,\t*$]|[\r\n][^\r\n]")
"""What lines do not have whose fields have eight letters each."""


class Field(NamedTuple):
    """A field of a card: its text, where it starts and stops, and its letters, 0 of a free one."""

    text: str
    start: int
    stop: int
    width: int


class Card:
    """An entry of bulk data with its continuations: name, start and stop; its fields on demand."""

    __slots__ = ("data", "name", "start", "stop")

    def __init__(self, name: str, data: bytes, start: int, stop: int) -> None:
        self.name, self.data, self.start, self.stop = name, data, start, stop

    @property
    def words(self) -> list[str]:
        """Texts of the fields from 0 on."""
        text = self.data[self.start: self.stop]
        if UNEVEN.search(text):
            return [field.text for field in self.fields]
        plain = text.decode("latin-1").rstrip().upper()
        return [plain[i: i + 8].strip() for i in range(8, min(len(plain), 72), 8)]

    @property
    def fields(self) -> list[Field]:
        """Fields from 0 on."""
        out: list[Field] = []
        most = 8
        at = self.start
        for line in self.data[self.start: self.stop].splitlines(keepends=True):
            start, at = at, at + len(line)
            body = _body(line)
            if body:
                found = _fields(body, start)
                out += [Field("", 0, 0, 0)] * (-len(out) % most)
                out += found[1:]
                most = 4 if "*" in found[0].text else 8
        return out

    def whole(self, words: list[str]) -> list[int]:
        """Whole numbers in some of its words, 0 where they are blank.

        Raises
        ------
        MeshFileError    there is something else
        """
        try:
            return [int(word or 0) for word in words]
        except ValueError as exc:
            bad = next(word for word in words if word and not re.fullmatch(r"[+-]?\d+", word))
            msg = f"{self.name} {self.words[0]} has {bad!r} in place of a number"
            raise MeshFileError(msg) from exc

    def number(self, i: int) -> int:
        """Whole number in a field, 0 where it is blank."""
        return self.whole(self.words[i: i + 1] or [""])[0]

    def reals(self, first: int, last: int) -> list[float]:
        """Numbers in some fields, however Nastran writes them, 0 where they are blank."""
        words = self.words[first: last + 1]
        return [_real(word) for word in words] + [0.0] * (last + 1 - first - len(words))


def _real(text: str) -> float:
    try:
        return float(text or 0)
    except ValueError:
        return float(re.sub(r"(?<=[\d.])(?:[dDeE]|(?=[+-]))(?=[+-]?\d+$)", "e", text))


class Block(NamedTuple):
    """Elements of a type: rows of points, cards, numbers and properties."""

    kind: str
    rows: Any
    cards: list[Card]
    ids: list[int]
    labels: list[int]


class Deck(NamedTuple):
    """A deck, read.

    Attributes
    ----------
    data : bytes
    cards : list of Card
    grids : list of Card             of every point
    number : dict                    index of a point by "" and its number
    points : (n, 3)
    blocks : list of Block
    held : (k,) int                  points that are named, or lie in a system of their own
    sets : dict of (k,) int          points of every card SPC1
    sides : list of (card, nodes)    faces that loads are on
    lists : list of (card, title, elements)    those that other loads and sets name, by numbers
    others : list of str             names of elements of other types
    last : int                       largest number of an element
    system : str                     coordinate system of new points, as the cards have it
    """

    data: bytes
    cards: list[Card]
    grids: list[Card]
    number: dict[tuple[str, int], int]
    points: NDArray[np.float64]
    blocks: list[Block]
    held: NDArray[np.int64]
    sets: dict[str, NDArray[np.int64]]
    sides: list[tuple[Card, list[int]]]
    lists: list[tuple[Card, str, set[int]]]
    others: list[str]
    last: int
    system: str


def read(path: Path) -> Any:
    """Read a deck; loads on faces of tetrahedra are triangles, in a block for every set of loads.

    Returns
    -------
    meshio.Mesh      a block a type of elements, their properties as labels, points of SPC1 as sets,
                     and elements with one load

    Raises
    ------
    MeshFileError    it ends before ENDDATA, or refers to what is not there
    """
    from meshio import Mesh

    deck = parsed(path)
    cells: list[Any] = [(block.kind, block.rows) for block in deck.blocks]
    labels: list[Any] = [np.array(block.labels, dtype=np.int64) for block in deck.blocks]
    region = {i: label for block in deck.blocks if deck.sides and block.kind[:5] == "tetra"
              for i, label in zip(block.ids, block.labels, strict=True)}
    for (_, _, kind), own in side_blocks(deck).items():
        told = [tuple(deck.sides[k][0].words[slice(1, 2) if name == "PLOAD" else slice(2, 6)])
                for k in own for name in [deck.sides[k][0].name]]
        rows = np.array([deck.sides[k][1] for k in own], dtype=np.int64)
        cards = [deck.sides[k][0] for k in own]
        regions = np.array([0 if c.name == "PLOAD" else region[c.number(1)] for c in cards])
        cells.append((kind, rows))
        labels.append(load_labels(told, rows, regions))
    sets: Any = deck.sets
    numbers = [block.ids for block in deck.blocks] + [[]] * (len(cells) - len(deck.blocks))
    members: Any = {title: [np.array([k for k, i in enumerate(ids) if i in own], dtype=np.int64)
                            for ids in numbers] for title, own in element_sets(deck).items()}
    data: Any = {LABEL: labels} | _parts(deck, labels, members)
    mesh = Mesh(deck.points, cells, cell_data=data, point_sets=sets, cell_sets=members)
    setattr(mesh, HELD, deck.held)
    setattr(mesh, DECK, deck)
    mesh.info = unread("what is said by", {
        card.name for card in deck.cards} - {"GRID", "SPC1", "ENDDATA"} - (
            KINDS.keys() - set(deck.others)) | (
                {"CASE CONTROL"} if re.match(rb"(?is)(?!\s*BEGIN).*?BEGIN", deck.data) else set()))
    if deck.others:
        setattr(mesh, REMARKS, [
            f"elements of type {', '.join(deck.others)} stay as they are with their nodes"])
    return mesh


def _parts(deck: Deck, labels: list[Any], members: dict[str, Any]) -> dict[str, Any]:
    """Labels of elements that are optimised, if sets part them otherwise than properties do."""
    kind = next((kind for kind in ORDERS if any(b.kind == kind for b in deck.blocks)), "")
    b = next((b for b, block in enumerate(deck.blocks) if block.kind == kind), -1)
    if b < 0 or not members:
        return {}
    inside = {}
    for title, own in members.items():
        inside[title] = np.zeros(len(labels[b]), dtype=np.bool_)
        inside[title][own[b]] = True
    joint = joint_labels([labels[b]], inside, deck.blocks[b].rows[:, : len(FACES[kind])])
    if joint is None or joint.max() == len(np.unique(labels[b])):
        return {}
    return {PART: [joint if k == b else np.zeros_like(own) for k, own in enumerate(labels)]}


def parsed(path: Path) -> Deck:
    """Take a deck apart."""
    data = with_included(path, INCLUDED, b"$ ")
    cards = list(_cards(data))
    if not cards or cards[-1].name != "ENDDATA":
        msg = "it ends before ENDDATA"
        raise MeshFileError(msg)
    grids, number, points, held, system = _placed(cards)
    at = {i: v for (_, i), v in number.items()}
    found: dict[str, Block] = {}
    others: set[str] = set()
    last = 0
    for card in cards:
        element = ELEMENT.fullmatch(card.name)
        where = NAMED.get(card.name, RIGID if card.name[:2] == "RB" else ())
        if element:
            words = card.words
            last = max(last, int(words[0]) if words and words[0].isdigit() else 0)
            if _taken(card, words, at, found):
                where = ORIENTED if card.name in BEAMS else ()
            else:
                where = NAMED.get(card.name, NODES)
                others.add(card.name)
        held += _named(card, at, where) if where else []
    order = order_of(found)
    for kind in [kind for kind in found if not fits(kind, order)]:
        block = found.pop(kind)
        held += [v for row in block.rows for v in row]
        others |= {card.name for card in block.cards}
    blocks = [block._replace(rows=np.array(block.rows, dtype=np.int64)) for block in found.values()]
    deck = Deck(data, cards, grids, number, points, blocks,
                np.unique(np.array(held, dtype=np.int64)), _sets(cards, at), [], [],
                sorted(others), last, system)
    deck.sides.extend(_sides(deck))
    deck.lists.extend(_lists(deck))
    return deck


def _taken(card: Card, words: list[str], at: dict[int, int], found: dict[str, Any]) -> bool:
    """Add an element to the block of its type; False if the type is not known.

    Raises
    ------
    KeyError    it has a point that is not there
    """
    known = KINDS.get(card.name)
    if known is None:
        return False
    number, label, *nodes = card.whole(words[: 2 + MOST.get(card.name, max(known))]) or (0, 0)
    while nodes and not nodes[-1]:
        nodes.pop()
    kind = known.get(len(nodes))
    if kind is None or min(nodes) <= 0:
        return False
    into = found.setdefault(kind, Block(kind, [], [], [], []))
    into.rows.append([at[node] for node in nodes])
    into.cards.append(card)
    into.ids.append(number)
    into.labels.append(label)
    return True


def _cards(data: bytes) -> Iterator[Card]:
    """Entries of bulk data, with ENDDATA as the last one."""
    begin = re.search(rb"(?im)^[ \t]*BEGIN[ \t]+(?:BULK|SUPER).*$", data)
    at = begin.end() if begin else 0
    card: Card | None = None
    known: dict[bytes, str] = {}
    for line in data[at:].splitlines(keepends=True):
        start, at = at, at + len(line)
        key = line[:8]
        name = None if b"," in line else known.get(key)
        if name is None:
            body = _body(line)
            if not body:
                continue
            head = body.partition(b",")[0] if b"," in body else body.expandtabs(8)[:8]
            name = head.decode("latin-1").strip().upper()
            if key.isalnum() or re.fullmatch(rb"\w+ +", key):
                known[key] = name
        if card is not None and (name == "" or name[0] in "+*"):
            card.stop = at
            continue
        if card is not None:
            yield card
        card = Card(name.rstrip("*_ "), data, start, at)
        if card.name == "ENDDATA":
            break
    if card is not None:
        yield card


def _body(line: bytes) -> bytes:
    """A line without comment, empty where it is nothing else."""
    body = line.partition(b"$")[0].rstrip()
    return b"" if body.startswith((b"//", b"#")) else body


def _fields(body: bytes, start: int) -> list[Field]:
    """Fields of a line, the first one and as many as have data, without that of continuations."""
    if b"," in body:
        words = body.split(b",")
        large = b"*" in words[0]
        out, at = [], start
        for word in words[: 5 if large else 9]:
            text = word.strip()
            left = at + len(word) - len(word.lstrip())
            out.append(Field(text.decode("latin-1").upper(), left if text else at,
                             left + len(text) if text else at, 0))
            at += len(word) + 1
        return out
    places = list(range(len(body)))
    if b"\t" in body:
        places = []
        for k, letter in enumerate(body):
            places += [k] * (8 - len(places) % 8 if letter == 9 else 1)
    large = b"*" in body[: places[8] if len(places) > 8 else len(body)]
    ends = [0, 8, 24, 40, 56, 72] if large else list(range(0, 73, 8))
    out = []
    for a, b in pairwise(ends):
        if a >= len(places):
            break
        i, j = places[a], places[b] if b < len(places) else len(body)
        out.append(Field(body[i:j].strip().decode("latin-1").upper(), start + i, start + j, b - a))
    return out


def _named(card: Card, at: dict[int, int], where: Iterable[slice]) -> list[int]:
    """Points that a card names in some of its fields, each or from one THRU another."""
    words = card.words
    if (card.name == "DMIG" and words[1:2] == ["0"]) or (
            card.name == "SET3" and words[1:2] not in (["GRID"], ["POINT"])):
        return []
    out = []
    for part in where:
        texts = [text for text in words[part] if text.isdigit() or text == "THRU"]
        out += [at[int(text)] for text in texts if text != "THRU" and int(text) in at]
        for first, text, last in zip(texts, texts[1:], texts[2:], strict=False):
            if text == "THRU" != first and last != "THRU":
                out += [v for i, v in at.items() if int(first) <= i <= int(last)]
    return out


def spc1_of(cards: list[Card]) -> dict[str, list[Card]]:
    """Cards SPC1 by their number and components."""
    found: dict[str, list[Card]] = {}
    for card in cards:
        if card.name == "SPC1":
            found.setdefault("_".join(["SPC1", *card.words[:2]]), []).append(card)
    return found


def _sets(cards: list[Card], at: dict[int, int]) -> dict[str, NDArray[np.int64]]:
    """Points of the cards SPC1, by their number and components."""
    return {name: np.unique(np.array([v for card in own for v in _named(
        card, at, (slice(2, None),))], dtype=np.int64)) for name, own in spc1_of(cards).items()}


def _sides(deck: Deck) -> Iterator[tuple[Card, list[int]]]:
    """Cards of loads on triangles, and the nodes of these."""
    loads = [card for card in deck.cards if card.name in ("PLOAD", "PLOAD4")]
    rows = {i: (block.kind, nodes) for block in deck.blocks if loads and block.kind[:5] == "tetra"
            for i, nodes in zip(block.ids, block.rows.tolist(), strict=True)}
    for card in loads:
        if card.name == "PLOAD":
            corners = [deck.number.get(("", i), -1) for i in card.whole(card.words[2:6]) if i]
            if len(corners) == CORNERS["tetra"] and min(corners) >= 0:
                yield card, corners
            continue
        if card.number(1) not in rows or not card.number(7):
            continue
        away = deck.number.get(("", card.number(7)))
        kind, nodes = rows[card.number(1)]
        if away not in nodes[:4]:
            msg = f"PLOAD4 names grid {card.number(7)}, which its element does not have"
            raise MeshFileError(msg)
        face = next(face for face in FACES[kind] if nodes.index(away) not in face)
        yield card, [nodes[k] for k in face]


def _lists(deck: Deck) -> Iterator[tuple[Card, str, set[int]]]:
    """Cards that name elements by numbers: the title of what they say, and the elements."""
    known = {id(card) for card, _ in deck.sides}
    ids = np.unique([i for block in deck.blocks for i in block.ids])
    for card in deck.cards:
        if card.name not in LISTS or id(card) in known:
            continue
        words = card.words
        told, first = LISTS[card.name]
        if card.name == "SET3" and words[1:2] not in (["ELEM"], ["ELEMENT"]):
            continue
        texts = words[first:]
        if card.name == "PLOAD4":
            if words[6:7] not in ([], [""], ["THRU"]):
                continue
            texts = texts[:1] + words[6:8]
        title = "_".join([card.name, *(words[k] for k in told if any(words[k: k + 1]))])
        yield card, title, set(_elements(card, texts, ids))


def _elements(card: Card, words: list[str], ids: NDArray[np.int64]) -> Iterator[int]:
    """Existing numbers of elements in a list of numbers and of ranges with THRU and BY."""
    words = [word for word in words if word]
    k = 0
    while k < len(words):
        first = last = card.whole(words[k: k + 1])[0]
        step, k = 1, k + 1
        if words[k: k + 1] == ["THRU"]:
            last, k = card.whole(words[k + 1: k + 2])[0], k + 2
            if words[k: k + 1] == ["BY"]:
                step, k = card.whole(words[k + 1: k + 2])[0], k + 2
        near = ids[np.searchsorted(ids, first): np.searchsorted(ids, last, side="right")]
        yield from near[(near - first) % max(step, 1) == 0].tolist()


def element_sets(deck: Deck) -> dict[str, set[int]]:
    """Numbers of the elements of which cards say the same, or where this is too much name them."""
    out: dict[str, set[int]] = {}
    few = len({title for _, title, _ in deck.lists}) <= MOST_SETS
    for card, title, own in deck.lists:
        out.setdefault(title if few else f"{card.name}_{card.number(0)}", set()).update(own)
    return out


def side_blocks(deck: Deck) -> dict[tuple[str, int, str], list[int]]:
    """Sides by name and set of their loads and type of cells, of which each is a block of cells."""
    out: dict[tuple[str, int, str], list[int]] = {}
    for k, (card, rows) in enumerate(deck.sides):
        kind = "triangle" if len(rows) == CORNERS["tetra"] else "triangle6"
        out.setdefault((card.name, card.number(0), kind), []).append(k)
    return out


def _placed(
    cards: list[Card]
) -> tuple[list[Card], dict[tuple[str, int], int], NDArray[np.float64], list[int], str]:
    """Cards, indices and places of points, points in another system, and the system of new points.

    Where all points are in one that is rectangular or not there, it serves as the basic one.

    Raises
    ------
    MeshFileError    a system is not known
    """
    grids = [card for card in cards if card.name == "GRID"]
    default = next((card.number(1) for card in cards if card.name == "GRDSET"), 0)
    number, places, systems_of = {}, [], []
    for v, card in enumerate(grids):
        words = [*card.words[:5], "", "", "", "", ""]
        i, system = card.whole(words[:2])
        number["", i] = v
        systems_of.append(system if words[1] else default)
        places.append([_real(word) for word in words[2:5]])
    points, given = np.array(places).reshape(-1, 3), np.array(systems_of, dtype=np.int64)
    systems = {card.number(0): card for card in cards if re.fullmatch("CORD2[RCS]", card.name)}
    used = np.unique(given[given != 0])
    plain = [i for i in used.tolist() if i not in systems or systems[i].name == "CORD2R"]
    if len(used) == 0 or (len(plain) == 1 and (given == plain[0]).all()):
        return grids, number, points, [], words[1] if grids else ""
    out = points.copy()
    for i in used.tolist():
        own = given == i
        out[own] = _in_basic(points[own], i, systems)
    return grids, number, out, np.flatnonzero(given != 0).tolist(), "0"


def _in_basic(
    x: NDArray[np.float64], i: int, systems: dict[int, Card], depth: int = 0
) -> NDArray[np.float64]:
    """Places in the basic system of those in another one."""
    if i == 0:
        return x
    if i not in systems or depth > len(systems):
        msg = f"it has grid points in the coordinate system {i}, expected 0 or one of CORD2R/C/S"
        raise MeshFileError(msg)
    card = systems[i]
    frame = np.array(card.reals(2, 10)).reshape(3, 3)
    frame = _in_basic(frame, card.number(1), systems, depth + 1)
    third = frame[1] - frame[0]
    second = np.cross(third, frame[2] - frame[0])
    axes = np.stack([np.cross(second, third), second, third])
    axes /= np.sqrt((axes * axes).sum(axis=1, keepdims=True))
    if card.name == "CORD2C":
        x = np.array([[r * _cos(t), r * _cos(t - 90), z] for r, t, z in x.tolist()])
    elif card.name == "CORD2S":
        x = np.array([[r * _cos(t - 90) * _cos(p), r * _cos(t - 90) * _cos(p - 90), r * _cos(t)]
                      for r, t, p in x.tolist()])
    return np.asarray(frame[0] + (x[:, :, None] * axes).sum(axis=1))


def _cos(degrees: float) -> float:
    return math.cos(math.radians(degrees))
