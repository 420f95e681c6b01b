"""Nastran's bulk data, .bdf: grid points and elements in fixed and free fields."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.decks import (
    CORNERS,
    FACES,
    HELD,
    REMARKS,
    fits,
    order_of,
)
from odt_plugins.errors import MeshFileError

KINDS = {
    "CTETRA": {10: "tetra10", 4: "tetra"}, "CTRIA3": {3: "triangle"}, "CTRIAR": {3: "triangle"},
    "CTRIA6": {6: "triangle6"}, "CQUAD4": {4: "quad"}, "CQUADR": {4: "quad"},
    "CSHEAR": {4: "quad"}, "CHEXA": {8: "hexahedron"}, "CPENTA": {6: "wedge"},
    "CPYRAM": {5: "pyramid"}, "CPYRA": {5: "pyramid"}, "CROD": {2: "line"}, "CBAR": {2: "line"},
    "CBEAM": {2: "line"}, "CTUBE": {2: "line"},
}
"""Types of cells by the names of elements and their numbers of nodes, the largest first."""

MOST = {"CTETRA": 10, "CHEXA": 20, "CPENTA": 15, "CPYRAM": 13, "CPYRA": 13}
"""Numbers of fields for nodes of elements that may have some between their corners."""

NAMED = {"FORCE": (1,), "MOMENT": (1,), "SPC": (1, 4), "SPCD": (1, 4), "CONM2": (1,),
         "CONM1": (1,), "CBUSH": (2, 3), "CELAS1": (2, 4), "CELAS2": (2, 4), "CDAMP1": (2, 4),
         "CDAMP2": (2, 4), "CONROD": (1, 2), "CGAP": (2, 3), "PLOTEL": (1, 2), "RBAR": (1, 2),
         "RROD": (1, 2), "CORD1R": (1, 2, 3), "CORD1C": (1, 2, 3), "CORD1S": (1, 2, 3)}
"""Cards that name grid points, and the fields that do."""

LISTS = {"RBE2": 1, "RBE1": 1, "RBE3": 2, "MPC": 1, "SUPORT": 0, "CHEXA": 2, "CPENTA": 2,
         "CPYRAM": 2, "CPYRA": 2, "CTRIA6": 2, "CQUAD8": 2, "CTETRA": 2, "CTRIAX6": 2,
         "CQUAD": 2, "CTRIAX": 2, "CSOLID": 2}
"""Cards in which whole numbers from some field on may be grid points."""

LABEL = "nastran:ref"
"""Array of the properties of elements."""


class Field(NamedTuple):
    """A field of a card: its text, where it starts and stops, and its letters, 0 of a free one."""

    text: str
    start: int
    stop: int
    width: int


class Card(NamedTuple):
    """An entry of bulk data with its continuations: name, fields from 0 on, start and stop."""

    name: str
    fields: list[Field]
    start: int
    stop: int

    def number(self, i: int) -> int:
        """Whole number in a field, 0 where it is blank.

        Raises
        ------
        MeshFileError    there is something else
        """
        text = self.fields[i].text if i < len(self.fields) else ""
        try:
            return int(text or 0)
        except ValueError as exc:
            msg = f"{self.name} {self.fields[0].text} has {text!r} in place of a number"
            raise MeshFileError(msg) from exc

    def real(self, i: int) -> float:
        """Number in a field, however Nastran writes it, 0 where it is blank."""
        text = self.fields[i].text if i < len(self.fields) else ""
        return float(re.sub(r"(?<=[\d.])(?:[dDeE]|(?=[+-]))(?=[+-]?\d+$)", "e", text) or 0)


class Deck(NamedTuple):
    """A deck, read.

    Attributes
    ----------
    data : bytes
    cards : list of Card
    grids : list of Card             of every point
    number : dict                    index of a point by "" and its number
    points : (n, 3)
    blocks : list                    type, rows of points and cards of every block of elements
    held : (k,) int                  points that are named, or lie in a system of their own
    sets : dict of (k,) int          points of every card SPC1
    sides : list of (card, row, rows of corners)    faces that loads are on
    others : list of str             names of elements of other types
    """

    data: bytes
    cards: list[Card]
    grids: list[Card]
    number: dict[tuple[str, int], int]
    points: NDArray[np.float64]
    blocks: list[tuple[str, NDArray[np.int64], list[Card]]]
    held: NDArray[np.int64]
    sets: dict[str, NDArray[np.int64]]
    sides: list[tuple[Card, list[int]]]
    others: list[str]


def read(path: Path) -> Any:
    """Read a deck; loads on faces of tetrahedra are triangles, of which each load has a block.

    Returns
    -------
    meshio.Mesh      a block a type of elements, their properties as labels, points of SPC1 as sets

    Raises
    ------
    MeshFileError    it ends before ENDDATA, or refers to what is not there
    """
    from meshio import Mesh

    deck = parsed(path)
    cells: list[Any] = [(kind, rows) for kind, rows, _ in deck.blocks]
    labels: list[Any] = [np.array([card.number(1) for card in cards], dtype=np.int64)
              for *_, cards in deck.blocks]
    if deck.sides:
        cells.append(("triangle", np.array([rows for _, rows in deck.sides], dtype=np.int64)))
        labels.append(np.zeros(len(deck.sides), dtype=np.int64))
    sets: Any = deck.sets
    mesh = Mesh(deck.points, cells, cell_data={LABEL: labels}, point_sets=sets)
    setattr(mesh, HELD, deck.held)
    if deck.others:
        setattr(mesh, REMARKS, [
            f"elements of type {', '.join(deck.others)} stay as they are with their nodes"])
    return mesh


def parsed(path: Path) -> Deck:
    """Take a deck apart."""
    data = path.read_bytes()
    cards = list(_cards(data))
    if not cards or cards[-1].name != "ENDDATA":
        msg = "it ends before ENDDATA"
        raise MeshFileError(msg)
    grids = [card for card in cards if card.name == "GRID"]
    number = {("", card.number(0)): v for v, card in enumerate(grids)}
    points = np.array([[card.real(2), card.real(3), card.real(4)] for card in grids]).reshape(-1, 3)
    points, held = _placed(cards, grids, points)
    found: dict[str, tuple[list[list[int]], list[Card]]] = {}
    others: set[str] = set()
    for card in cards:
        known = KINDS.get(card.name)
        if known is not None:
            most = MOST.get(card.name, max(known))
            nodes = [card.number(i) for i in range(2, 2 + most)]
            kind = known.get(sum(node > 0 for node in nodes))
            if kind is not None and all(nodes[: len(nodes) - nodes.count(0)]):
                rows = [number["", node] if ("", node) in number else _missing(node)
                        for node in nodes if node]
                into = found.setdefault(kind, ([], []))
                into[0].append(rows)
                into[1].append(card)
                continue
        if re.match(r"C[A-Z]+\d?$", card.name) and not card.name.startswith("CORD"):
            others.add(card.name)
        held += _named(card, number)
    order = order_of(found)
    for kind in [kind for kind in found if not fits(kind, order)]:
        rows_, cards_ = found.pop(kind)
        held += [v for row in rows_ for v in row]
        others |= {card.name for card in cards_}
    blocks = [(kind, np.array(rows, dtype=np.int64), own) for kind, (rows, own) in found.items()]
    sets = _sets(cards, number)
    deck = Deck(data, cards, grids, number, points, blocks,
                np.unique(np.array(held, dtype=np.int64)), sets, [], sorted(others))
    deck.sides.extend(_sides(deck))
    return deck


def _missing(node: int) -> int:
    raise KeyError(node)


def _cards(data: bytes) -> Iterator[Card]:
    """Entries of bulk data, with ENDDATA as the last one."""
    begin = re.search(rb"(?im)^[ \t]*BEGIN[ \t]+(?:BULK|SUPER).*$", data)
    at = begin.end() if begin else 0
    card: Card | None = None
    most = 8
    for line in data[at:].splitlines(keepends=True):
        start, at = at, at + len(line)
        body = line.partition(b"$")[0].rstrip()
        if not body or body.startswith((b"//", b"#")):
            continue
        fields = _fields(body, start)
        head = fields[0].text
        if card is not None and (head == "" or head[0] in "+*"):
            card.fields.extend([Field("", 0, 0, 0)] * (-len(card.fields) % most))
            card.fields.extend(fields[1:])
            most = 4 if "*" in head else 8
            card = card._replace(stop=at)
            continue
        if card is not None:
            yield card
        most = 4 if "*" in head else 8
        card = Card(head.rstrip("*").strip(), fields[1:], start, at)
        if card.name == "ENDDATA":
            break
    if card is not None:
        yield card


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


def _named(card: Card, number: dict[tuple[str, int], int]) -> list[int]:
    """Points that a card names, other than those of elements that are optimised."""
    places = [i for i in NAMED.get(card.name, ()) if i < len(card.fields)]
    places += range(LISTS.get(card.name, len(card.fields)), len(card.fields))
    texts = [card.fields[i].text for i in places]
    return [number["", int(text)] for text in texts
            if text.isdigit() and ("", int(text)) in number]


def _sets(cards: list[Card], number: dict[tuple[str, int], int]) -> dict[str, NDArray[np.int64]]:
    """Points of the cards SPC1, by their number and components."""
    found: dict[str, list[int]] = {}
    for card in cards:
        if card.name != "SPC1":
            continue
        texts = [field.text for field in card.fields[2:] if field.text]
        out = found.setdefault(f"SPC1_{card.number(0)}_{card.fields[1].text}", [])
        if texts[1:2] == ["THRU"]:
            out += [v for (_, i), v in number.items() if int(texts[0]) <= i <= int(texts[2])]
        else:
            out += [number["", int(text)] for text in texts if ("", int(text)) in number]
    return {name: np.unique(np.array(nodes, dtype=np.int64)) for name, nodes in found.items()}


def _sides(deck: Deck) -> Iterator[tuple[Card, list[int]]]:
    """Cards of loads on faces of tetrahedra, and the corners of these."""
    rows = {card.number(0): nodes for kind, table, cards in deck.blocks if kind[:5] == "tetra"
            for card, nodes in zip(cards, table.tolist(), strict=True)}
    for card in deck.cards:
        if card.name != "PLOAD4" or card.number(1) not in rows or not card.number(7):
            continue
        away = deck.number.get(("", card.number(7)))
        nodes = rows[card.number(1)][:4]
        if away not in nodes:
            msg = f"PLOAD4 names grid {card.number(7)}, which its element does not have"
            raise MeshFileError(msg)
        face = next(face for face in FACES["tetra"] if nodes.index(away) not in face)
        yield card, [nodes[k] for k in face[: CORNERS["tetra"]]]


def _placed(
    cards: list[Card], grids: list[Card], points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], list[int]]:
    """Places in the basic system, and points that are given in another one.

    Where all points are in one that is rectangular or not there, it serves as the basic one.

    Raises
    ------
    MeshFileError    a system is not known
    """
    default = next((card.number(1) for card in cards if card.name == "GRDSET"), 0)
    given = np.array([card.number(1) or default for card in grids], dtype=np.int64)
    systems = {card.number(0): card for card in cards if re.fullmatch("CORD2[RCS]", card.name)}
    used = np.unique(given[given != 0])
    plain = [i for i in used.tolist() if i not in systems or systems[i].name == "CORD2R"]
    if len(used) == 0 or (len(plain) == 1 and (given == plain[0]).all()):
        return points, []
    out = points.copy()
    for i in used.tolist():
        own = given == i
        out[own] = _in_basic(points[own], i, systems)
    return out, np.flatnonzero(given != 0).tolist()


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
    frame = np.array([card.real(k) for k in range(2, 11)]).reshape(3, 3)
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
