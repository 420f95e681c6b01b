"""Nastran's decks written into themselves: other places and nodes, and faces of loads."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from odt_plugins.adapters.formats.change import Change, NotRewritable
from odt_plugins.adapters.formats.decks import Edit, Names, deck_of, edited, faces_of, indices, real
from odt_plugins.adapters.formats.nastran import (
    Block,
    Card,
    Deck,
    Field,
    element_sets,
    parsed,
    side_blocks,
    spc1_of,
)
from odt_plugins.adapters.formats.nastran_tables import LISTS

TELLING = {"BSURFS": "tetra", "CHBDYE": "t", "QHBDY": "t", "CHACBR": "t"}
"""Cards that tell of sides of elements in ways that do not follow, and of which types."""

LISTING = ("TEMPP1", "TEMPRB", "TEMPP3")
"""Cards with numbers of elements, which do not follow."""

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
    sets = [*element_sets(deck).values()]
    kinds = [[(label, *(k for k, own in enumerate(sets) if i in own))
              for label, i in zip(block.labels, block.ids, strict=True)] for block in deck.blocks]
    names = Names(change, deck.number, [("", block.ids) for block in deck.blocks], kinds,
                  {"": deck.last})
    if {deck.number[name] for name in names.lost} & set(deck.held.tolist()):
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
    edits += _lists(deck, names)
    edits += _constraints(deck, names, change)
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


def _with_numbers(
    data: bytes, card: Card, fields: list[Field], words: Iterable[tuple[int, int | str]]
) -> bytes:
    """Text of a card with other numbers in some of its fields."""
    edits = [_put(data, fields[k], str(word).encode()) for k, word in words
             if fields[k].text.lstrip("+0") != str(word)]
    return edited(data[card.start: card.stop], [
        (start - card.start, stop - card.start, new) for start, stop, new in edits])


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
            text += _with_numbers(data, card, fields, zip(
                places, [names.of[b][i], *nodes[i]], strict=False))
        out.append((card.start, card.stop, text))
    return out


def _loads(deck: Deck, names: Names, change: Change) -> list[Edit]:
    """What replaces cards of loads on faces: one each for every face that theirs has become.

    Raises
    ------
    NotRewritable    a load that differs from corner to corner is on another face
    """
    kinds = [block.kind for block in deck.blocks]
    edits: list[Edit] = []
    for m, own in enumerate(side_blocks(deck).values(), len(kinds)):
        parts: dict[int, list[bytes]] = {k: [] for k in own}
        rows = np.asarray(change.after.cells[m].data)[:, :3]
        for k, row, old, (b, i, _) in zip(
                np.array(own)[change.cells[m]].tolist(), rows.tolist(),
                change.points[rows].tolist(), faces_of(change, kinds, m), strict=True):
            card, corners = deck.sides[k]
            same = sorted(old) == sorted(corners[:3])
            if not same and any(card.words[3:6]) and card.name == "PLOAD4":
                msg = f"the load of {card.name} {card.words[0]} differs from corner to corner"
                raise NotRewritable(msg)
            cell = np.asarray(change.after.cells[b].data)[i, :4].tolist()
            away = next(v for v in cell if v not in row)
            words = {1: names.of[b][i], 7: int(names.nodes[away])}
            words |= {} if same else {6: int(names.nodes[row[0]])}
            if card.name == "PLOAD":
                words = {} if same else {j: int(names.nodes[v]) for j, v in enumerate(row, 2)}
            parts[k].append(_with_numbers(deck.data, card, card.fields, words.items()))
        for k, texts in parts.items():
            card = deck.sides[k][0]
            if texts != [deck.data[card.start: card.stop]]:
                edits.append((card.start, card.stop, b"".join(texts)))
    return edits


def _lists(deck: Deck, names: Names) -> list[Edit]:
    """Edits for cards that list elements of which some are gone or have successors.

    Raises
    ------
    NotRewritable    they are of a kind that does not follow
    """
    gone = {number for _, number in names.gone}
    fresh = {number: new for (_, number), new in names.fresh.items()}
    edits = []
    for card, _, own in deck.lists:
        if not own & (gone | fresh.keys()):
            continue
        now = sorted((own - gone) | {i for number in own for i in fresh.get(number, ())})
        if card.name == "PLOAD4":
            fields = card.fields
            blank = [(k, "") for k in (6, 7) if k < len(fields)]
            parts = [_with_numbers(deck.data, card, fields, [(1, i), *blank]) for i in now]
            edits.append((card.start, card.stop, b"".join(parts)))
            continue
        _, first = LISTS[card.name]
        head = card.words[:first]
        most = 8 - first if card.name == "PLOAD2" else len(now)
        edits.append((card.start, card.stop, b"".join(
            _card(card.name, [*head, *map(str, now[k: k + most])], _ends(deck.data))
            for k in range(0, len(now), max(most, 1)))))
    for card in deck.cards:
        if card.name not in LISTING:
            continue
        texts = card.words
        listed = {int(text) for text in texts[1:] if text.isdigit()}
        if "THRU" in texts[1:-1]:
            k = texts.index("THRU")
            listed |= {i for i in gone | fresh.keys()
                       if int(texts[k - 1]) <= i <= int(texts[k + 1])}
        if listed & (gone | fresh.keys()):
            msg = f"{card.name} lists elements that went or to which others came"
            raise NotRewritable(msg)
    return edits


def _constraints(deck: Deck, names: Names, change: Change) -> list[Edit]:
    """What replaces cards SPC1 of sets that have other points."""
    edits: list[Edit] = []
    number = names.nodes.tolist()
    for title, own in spc1_of(deck.cards).items():
        now = change.after.point_sets.get(title)
        if now is None or np.array_equal(np.sort(change.points[indices(now)]), deck.sets[title]):
            continue
        words = [*own[0].words[:2], *map(str, sorted(number[v] for v in indices(now).tolist()))]
        texts = [_card("SPC1", words, _ends(deck.data)), *[b""] * (len(own) - 1)]
        edits += [(card.start, card.stop, text) for card, text in zip(own, texts, strict=True)]
    return edits


def _card(name: str, words: list[str], end: bytes) -> bytes:
    """A card in fields of eight letters, or of sixteen where a word is longer."""
    large = max(map(len, words)) > 8
    size, width = (4, 16) if large else (8, 8)
    lines = [("*" if k and large else "" if k else name + "*" * large).ljust(8) + "".join(
        word.rjust(width) for word in words[k: k + size]) for k in range(0, len(words), size)]
    return b"".join(line.encode("latin-1") + end for line in lines)
