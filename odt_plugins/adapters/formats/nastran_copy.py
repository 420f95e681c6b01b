"""Nastran's decks written into themselves: other places and nodes, and faces of loads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from odt_plugins.adapters.formats.change import Change, NotRewritable
from odt_plugins.adapters.formats.decks import (
    Edit,
    Names,
    deck_of,
    edited,
    faces_of,
    real,
    turned,
)
from odt_plugins.adapters.formats.nastran import Block, Deck, Field, parsed

TELLING = {"BSURFS": "tetra", "CHBDYE": "t", "QHBDY": "t", "CHACBR": "t"}
"""Cards that tell of sides of elements in ways that do not follow, and of which types."""

LISTING = ("PLOAD2", "PLOAD4", "BSURF", "SET3", "TEMPP1", "TEMPRB", "TEMPP3")
"""Cards with numbers of elements."""

LETTERS = 16
"""Letters of a number in a large field."""


def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Replace grid points that moved, nodes of elements that were exchanged, and faces of loads.

    Points are written as GRID*, whose numbers have 16 letters.

    Raises
    ------
    NotRewritable    points went that are named, or cards tell of elements that changed
    """
    deck = deck_of(change, source, parsed)
    names = Names(change, deck.number, [("", block.ids) for block in deck.blocks],
                  [block.labels for block in deck.blocks], {"": deck.last})
    named = set(deck.held.tolist())
    for members in deck.sets.values():
        named |= set(members.tolist())
    if {deck.number[name] for name in names.lost} & named:
        msg = "grid points went that it refers to"
        raise NotRewritable(msg)
    edits = _grids(deck, names, change)
    for b, block in enumerate(deck.blocks):
        own = _elements(deck.data, block, b, names, change)
        edits += own
        bad = next((card.name for card in deck.cards
                    if block.kind.startswith(TELLING.get(card.name, "-"))), None)
        if own and bad:
            msg = f"it has {bad}, which tells of sides of elements that were exchanged"
            raise NotRewritable(msg)
    edits += _loads(deck, names, change)
    target.write_bytes(edited(deck.data, edits))
    return []


def _put(data: bytes, field: Field, word: bytes) -> Edit:
    """Put a word into a field, at the same side of it.

    Raises
    ------
    NotRewritable    the field has no room
    """
    old = data[field.start: field.stop]
    if field.width == 0:
        return field.start, field.stop, word
    if len(word) > field.width:
        msg = f"{word.decode()} does not fit into {field.width} letters"
        raise NotRewritable(msg)
    if b"\t" in old:
        tab = old.endswith(b"\t") and len(word) < field.width
        return field.start, field.stop, word + b"\t" * tab
    whole = len(old) == field.width
    right = old[:1] == b" " and old[-1:] != b" "
    return field.start, field.stop, word.rjust(field.width if whole else len(old)) if right else (
        word.ljust(field.width) if whole else word)


def _ends(data: bytes) -> bytes:
    return b"\r\n" if b"\r\n" in data else b"\n"


def _grid(number: int, place: list[float], words: list[str], end: bytes) -> bytes:
    """A card GRID* with system of places, of displacements, constraints and superelement."""
    x = [real(v, LETTERS).decode().replace("e", "E") for v in place]
    first = f"GRID*   {number:>16}{words[0]:>16}{x[0]:>16}{x[1]:>16}*".encode()
    return first + end + f"*       {x[2]:>16}{words[1]:>16}{words[2]:>16}{words[3]:>16}".rstrip(
        ).encode() + end


def _grids(deck: Deck, names: Names, change: Change) -> list[Edit]:
    """What replaces the cards of points that moved or went, and those of new ones."""
    end = _ends(deck.data)
    places: Any = np.asarray(change.after.points).tolist()
    cards = {deck.number[name]: b"" for name in names.lost}
    for v in np.flatnonzero(change.moved & (change.points >= 0)).tolist():
        old = int(change.points[v])
        words = [*deck.grids[old].words, *(8 * [""])]
        cards[old] = _grid(int(names.nodes[v]), places[v], [words[i] for i in (1, 5, 6, 7)], end)
    last = len(deck.grids) - 1
    fresh = np.flatnonzero(change.points < 0).tolist()
    if fresh:
        card = deck.grids[last]
        cards[last] = cards.get(last, deck.data[card.start: card.stop]) + b"".join(
            _grid(int(names.nodes[v]), places[v], [deck.system, "", "", ""], end) for v in fresh)
    return [(deck.grids[v].start, deck.grids[v].stop, text) for v, text in cards.items()]


def _elements(data: bytes, block: Block, b: int, names: Names, change: Change) -> list[Edit]:
    """What replaces the cards of the elements of a block."""
    after, fresh = np.asarray(change.after.cells[b].data), change.exchanged(b).tolist()
    nodes = names.nodes[after].tolist()
    out: list[Edit] = []
    for card, number, slot in zip(block.cards, block.ids, names.slots[b], strict=True):
        if len(slot) == 1 and not fresh[slot[0]] and names.of[b][slot[0]] == number:
            continue
        fields = card.fields
        places = [0, *(i for i, field in enumerate(fields[2:], 2) if field.text)]
        text = b""
        for i in slot:
            edits = [_put(data, fields[k], str(word).encode())
                     for k, word in zip(places, [names.of[b][i], *nodes[i]], strict=False)
                     if int(fields[k].text) != word]
            text += edited(data[card.start: card.stop], [
                (start - card.start, stop - card.start, new) for start, stop, new in edits])
        out.append((card.start, card.stop, text))
    return out


def _loads(deck: Deck, names: Names, change: Change) -> list[Edit]:
    """What replaces elements and points in loads on faces.

    Raises
    ------
    NotRewritable    a face is no more, or a card lists elements that went or to which others came
    """
    faces = faces_of(change, [block.kind for block in deck.blocks],
                     {v for _, rows in deck.sides for v in rows})
    edits: list[Edit] = []
    for card, rows in deck.sides:
        if turned(rows) not in faces:
            msg = f"a face of {card.name} is no more"
            raise NotRewritable(msg)
        if card.name == "PLOAD":
            continue
        b, i, _ = faces[turned(rows)]
        cells = np.asarray(change.after.cells[b].data)[i, :4]
        away = next(v for v in cells.tolist() if int(change.points[v]) not in rows)
        for k, word in ((1, names.of[b][i]), (7, int(names.nodes[away]))):
            if card.number(k) != word:
                edits.append(_put(deck.data, card.fields[k], str(word).encode()))
    known = {id(card) for card, _ in deck.sides}
    changed = {number for _, number in names.gone | names.fresh.keys()}
    for card in deck.cards:
        if card.name not in LISTING or id(card) in known:
            continue
        texts = card.words
        listed = {int(text) for text in texts[1:] if text.isdigit()}
        if "THRU" in texts[1:-1]:
            k = texts.index("THRU")
            listed |= {i for i in changed if int(texts[k - 1]) <= i <= int(texts[k + 1])}
        if listed & changed:
            msg = f"{card.name} lists elements that went or to which others came"
            raise NotRewritable(msg)
    return edits
