"""Abaqus decks written into themselves: other places and nodes, and sets and faces that follow."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from odt_plugins.adapters.formats.abaqus import cell_sets, faces_only, titles
from odt_plugins.adapters.formats.abaqus_deck import (
    Deck,
    Section,
    Side,
    elements_of,
    face_of,
    generated,
    home_of,
    members,
    parsed,
    resolved,
    side_blocks,
    words_of,
)
from odt_plugins.adapters.formats.change import Change, NotRewritable
from odt_plugins.adapters.formats.decks import (
    Edit,
    Name,
    Names,
    deck_of,
    edited,
    faces_of,
    real,
    substituted,
)
from odt_plugins.adapters.formats.titles import encoded

WIDEST = 20
"""Letters of a number that Abaqus and CalculiX read."""

A_LINE = 16
"""Most numbers on a line of a set."""

VALUES = ("DISTRIBUTION", "INITIALCONDITIONS", "MODELCHANGE", "DLOAD", "DFLUX", "FILM", "RADIATE")
"""Keywords that may tell of elements by their numbers."""

def rewrite(source: Path, target: Path, change: Change) -> list[str]:
    """Replace the places of nodes that moved and the nodes of elements that were exchanged.

    Elements keep their numbers. New ones have numbers behind the largest, and are in the sets of
    those that they come from; faces of surfaces and of loads are those of the elements that have
    them now.

    Raises
    ------
    NotRewritable    nodes went that are named
    """
    deck = deck_of(change, source, parsed)
    data = b"".join(deck.texts)
    names = Names(
        change, deck.number, [(block.part, block.ids) for block in deck.blocks], _kinds(deck),
        _largest(deck))
    if {deck.number[name] for name in names.lost} & set(deck.held.tolist()):
        msg = "nodes went that it refers to"
        raise NotRewritable(msg)
    edits = _nodes(deck, names, change)
    for b in range(len(deck.blocks)):
        edits += _elements(deck, data, b, names, change)
    hidden, lines = _faces(deck, names, change)
    edits += lines
    alias = resolved(deck.sections)
    for section in deck.sections:
        if section.name in ("ELSET", "NSET"):
            edits += _set(deck, section, names, home_of(section, alias), hidden)
        told = [i for i in section.lines if section.name in VALUES
                and face_of(section, words_of(deck.texts[i])) is None]
        numbers = {int(w) for w in (words_of(deck.texts[i])[0] for i in told) if w.isdigit()}
        if {(section.part, number) for number in numbers} & names.gone:
            msg = f"*{section.name} tells of elements that are no more"
            raise NotRewritable(msg)
    target.write_bytes(edited(data, edits))
    return []


def _line_edit(deck: Deck, i: int, text: bytes, last: int | None = None) -> Edit:
    """Put text in the place of a line, or of several."""
    last = i if last is None else last
    return deck.starts[i], deck.starts[last] + len(deck.texts[last]), text


def _spans(text: bytes) -> list[tuple[int, int]]:
    """Where the words between commas start and stop, in lines that are no comments."""
    out = []
    at = 0
    for line in text.splitlines(keepends=True):
        if line.strip() and not line.lstrip().startswith(b"**"):
            body = line.rstrip()
            here = at
            words = body.split(b",")
            for word in words[:-1] if body.endswith(b",") else words:
                left = len(word) - len(word.lstrip()) if word.strip() else 0
                out.append((here + left, here + len(word.rstrip()) if word.strip() else here))
                here += len(word) + 1
        at += len(line)
    return out


def _nodes(deck: Deck, names: Names, change: Change) -> list[Edit]:
    """What replaces the lines of nodes that moved or went, and those of new ones."""
    lines = {deck.lines[deck.number[name]]: b"" for name in names.lost}
    last: dict[str, int] = {}
    for part, number in deck.number:
        i = deck.lines[deck.number[part, number]]
        last[part] = max(last.get(part, 0), i)
    spots = np.asarray(change.after.points).tolist()
    for v in np.flatnonzero(change.moved & (change.points >= 0)).tolist():
        i = deck.lines[change.points[v]]
        lines[i] = _moved(deck.texts[i], spots[v])
    for part, i in last.items():
        fresh = [v for v in np.flatnonzero(change.points < 0).tolist() if names.parts[v] == part]
        rows = {int(names.nodes[v]): _moved(_exchanged(deck.texts[i], [b"%d" % names.nodes[v]]),
                                            spots[v]) for v in fresh}
        if rows:
            own = lines.get(i, deck.texts[i])
            lines[i] = b"".join([own, b"" if not own or _end(own) else b"\n",
                                 *_sorted_nodes(deck, names, part, i, rows)])
    return [_line_edit(deck, i, text) for i, text in lines.items()]


def _sorted_nodes(
    deck: Deck, names: Names, part: str, last: int, rows: dict[int, bytes]
) -> list[bytes]:
    """Lines of new nodes, to stand behind the last node, with the sets that the nodes join."""
    own = [s for s in deck.sections if s.name == "NODE" and s.part == part]
    sets = dict.fromkeys(s.params["NSET"] for s in own if "NSET" in s.params)
    behind = next(s.params.get("NSET", "") for s in own if last in s.lines)
    known = {key: title for title, key in titles(deck, "NSET").items()}
    joined = {name: names.of_set(known[part, name.upper()], part) & {*rows} for name in sets}
    inside = joined.pop(behind, set()) if behind else {*rows}
    out = [text for number, text in rows.items() if number in inside]
    others = [text for number, text in rows.items() if number not in inside]
    end = _end(deck.texts[last]) or b"\n"
    out += [b"*NODE" + end, *others] if others else []
    whole = b"".join(deck.texts)
    for name, numbers in joined.items():
        if numbers:
            out += [b"*NSET, NSET=" + encoded(name, whole) + end, *_listed(sorted(numbers), end)]
    return out


def _listed(numbers: list[int], end: bytes) -> list[bytes]:
    """Lines of the numbers of a set."""
    return [", ".join(map(str, numbers[k: k + A_LINE])).encode() + end
            for k in range(0, len(numbers), A_LINE)]


def _moved(text: bytes, place: list[float]) -> bytes:
    """A line of a node at another place."""
    words = [real(x, WIDEST) for x in place]
    missing = words[text.rstrip().rstrip(b",").count(b","):]
    if missing:
        end = len(text.rstrip().rstrip(b","))
        text = text[:end] + b"".join(b", " + word for word in missing) + text[len(text.rstrip()):]
    return _exchanged(text, [None, *words])


def _exchanged(text: bytes, words: Sequence[bytes | None]) -> bytes:
    """The lines of an entry with other words between its commas, where they are not None."""
    if text.count(b"\n") > 1 or text.count(b"\r") > 1 or text.lstrip()[:2] == b"**":
        return substituted(text, _spans(text), {
            k: word for k, word in enumerate(words) if word is not None})
    parts = text.split(b",")
    for k, word in enumerate(words):
        old = parts[k].strip()
        if word is not None and old != word:
            parts[k] = parts[k].replace(old, word, 1) if old else word
    return b",".join(parts)


def _end(text: bytes) -> bytes:
    """End of a line."""
    return text[len(text.rstrip(b"\r\n")):]


def _elements(deck: Deck, data: bytes, b: int, names: Names, change: Change) -> list[Edit]:
    """What replaces the lines of the elements of a block."""
    block, fresh = deck.blocks[b], change.exchanged(b).tolist()
    nodes = names.nodes[np.asarray(change.after.cells[b].data)].tolist()
    edits = []
    for r, slot in enumerate(names.slots[b]):
        if len(slot) == 1 and not fresh[slot[0]] and names.of[b][slot[0]] == block.ids[r]:
            continue
        first, last = block.lines[r]
        start, stop, _ = _line_edit(deck, first, b"", last)
        text = data[start:stop]
        parts = []
        for i in slot:
            part = _exchanged(text, [b"%d" % k for k in (names.of[b][i], *nodes[i])])
            parts.append(part if _end(part) or i == slot[-1] else part + b"\n")
        edits.append((start, stop, b"".join(parts)))
    return edits


def _kinds(deck: Deck) -> list[list[int]]:
    """By block and element what tells apart those that are not in the same sets."""
    kinds: list[Any] = [[() for _ in block.ids] for block in deck.blocks]
    for k, rows in enumerate(cell_sets(deck).values()):
        for b, own in rows.items():
            for r in own:
                kinds[b][r] = (*kinds[b][r], k)
    return kinds


def _largest(deck: Deck) -> dict[str, int]:
    """Largest number of an element of every part."""
    out: dict[str, int] = {}
    for block in deck.blocks:
        out[block.part] = max(out.get(block.part, 0), max(block.ids))
    for section in deck.sections:
        if section.name == "ELEMENT" and section.part in out:
            for i in section.lines:
                word = deck.texts[i].split(b",")[0].strip()
                if word.isdigit() and i not in deck.begun:
                    out[section.part] = max(out[section.part], int(word))
    return out


def _faces(
    deck: Deck, names: Names, change: Change
) -> tuple[dict[tuple[str, str], set[Name]], list[Edit]]:
    """Sets that are of faces only, as they are to be, and what replaces lines with faces."""
    hidden = faces_only(deck)
    lines: dict[int, list[Side]] = {}
    places: dict[int, list[tuple[Name, int]]] = {}
    for side, pairs in zip(deck.sides, _found(deck, names, change), strict=True):
        lines.setdefault(side.line, []).append(side)
        places.setdefault(side.line, []).extend(pairs)
    uses: dict[tuple[str, str], list[int]] = {}
    for i, sides in lines.items():
        uses.setdefault(_key(deck, i, sides), []).append(sides[0].face)
    _sorted(deck, lines, places, {key for key in hidden if len(uses.get(key, ())) == 1})
    sets: dict[tuple[str, str], set[Name]] = {}
    edits = []
    for i, sides in lines.items():
        key, face = _key(deck, i, sides), sides[0].face
        part, word = key[0], words_of(deck.texts[i])[0]
        pairs = places[i]
        others = {_name(deck, b, r) for b, r in elements_of(deck, part, word)} - {
            _name(deck, side.block, r) for side in sides for r in side.rows}
        pairs += [(name, face) for name in sorted(others)]
        own = {name for name, at in pairs if at == face}
        before = _prefixes(deck, part, word)
        if key in hidden and {*uses[key]} == {face}:
            sets[key] = own
            pairs = [pair for pair in pairs if pair[1] != face]
            if pairs or not own:
                edits.append(_line_edit(deck, i, _lines_of(
                    deck.texts[i], None if own else [], pairs, before)))
            continue
        if {(name, face) for name in _after(deck, names, part, word)} != set(pairs):
            edits.append(_line_edit(deck, i, _lines_of(deck.texts[i], pairs, [], before)))
    return sets, edits


def _key(deck: Deck, i: int, sides: list[Side]) -> tuple[str, str]:
    """Part and name in capitals of the set of a line with sides."""
    return deck.sections[sides[0].section].part, words_of(deck.texts[i])[0].upper()


def _sorted(
    deck: Deck, lines: dict[int, list[Side]], places: dict[int, list[tuple[Name, int]]],
    sets: set[tuple[str, str]],
) -> None:
    """Let faces of lines of some sets stand at the line of one that has others of their number."""
    of_number = {}
    for i, sides in lines.items():
        key = _key(deck, i, sides)
        for part in {deck.blocks[b].part for b, _ in members(deck, *key)} if key in sets else ():
            more = tuple(words_of(deck.texts[i])[2:])
            of_number[sides[0].section, more, part, sides[0].face] = i
    for i, pairs in [*places.items()]:
        places[i] = []
        for name, face in pairs:
            more = tuple(words_of(deck.texts[i])[2:])
            to = of_number.get((lines[i][0].section, more, name[0], face), i)
            places[to if _key(deck, i, lines[i]) in sets else i].append((name, face))


def _name(deck: Deck, b: int, row: int) -> Name:
    return deck.blocks[b].part, deck.blocks[b].ids[row]


def _prefixes(deck: Deck, part: str, word: str) -> dict[str, bytes]:
    """What stands before the numbers of elements of a set, by their parts.

    Raises
    ------
    NotRewritable    the set has elements of several instances of one part
    """
    alias = resolved(deck.sections)
    given = [s.params["INSTANCE"] for s in deck.sections
             if s.name == "ELSET" and s.part == part and "INSTANCE" in s.params
             and s.params.get("ELSET", "").upper() == word.upper()]
    given += [word.partition(".")[0]] if "." in word else []
    out: dict[str, bytes] = {}
    for instance in given:
        prefix = encoded(f"{instance}.", b"".join(deck.texts))
        home = alias.get(instance.upper(), "") or instance.upper()
        if out.setdefault(home, prefix).upper() != prefix.upper():
            msg = f"set {word} has elements of several instances of part {home}"
            raise NotRewritable(msg)
    return out


def _after(deck: Deck, names: Names, part: str, word: str) -> set[Name]:
    """Names of the elements of a set afterwards, or of one that is told by its number."""
    instance, _, last = word.upper().rpartition(".")
    if last.isdigit():
        alias = resolved(deck.sections) if instance else {}
        return {(alias.get(instance, "") or instance or part, int(last))}
    out: set[Name] = set()
    for b, r in members(deck, part, word):
        out |= {(deck.blocks[b].part, names.of[b][i]) for i in names.slots[b][r]}
    return out


def _found(deck: Deck, names: Names, change: Change) -> list[list[tuple[Name, int]]]:
    """Name of the element and face, of every face that the faces of every side have become."""
    kinds = [block.kind for block in deck.blocks]
    out: list[list[tuple[Name, int]]] = [[] for _ in deck.sides]
    for m, own in enumerate(side_blocks(deck).values(), len(kinds)):
        side = np.repeat(own, [len(deck.sides[k].rows) for k in own])[change.cells[m]]
        for k, (b, i, face) in zip(side.tolist(), faces_of(change, kinds, m), strict=True):
            out[k].append(((deck.blocks[b].part, names.of[b][i]), face))
    return out


def _lines_of(
    text: bytes, instead: list[tuple[Name, int]] | None, more: list[tuple[Name, int]],
    before: dict[str, bytes],
) -> bytes:
    """A line with a face, or lines of elements instead of it, and more of them behind."""
    spans = _spans(text)
    end = _end(text) or b"\n"
    old = text[slice(*spans[1])]
    body = [text.rstrip(b"\r\n")] if instead is None else []
    for (part, number), face in [*(instead or []), *more]:
        word = b"".join(str(face + 1).encode() if 48 <= c < 58 else bytes([c]) for c in old)
        body.append(substituted(text, spans, {
            0: before.get(part, b"") + str(number).encode(), 1: word}).rstrip(b"\r\n"))
    return end.join(body) + (_end(text) if body else b"")


def _set(
    deck: Deck, section: Section, names: Names, home: str, hidden: dict[tuple[str, str], set[Name]]
) -> list[Edit]:
    """What replaces lines of a set of nodes or elements."""
    own: set[int] = set()
    for i in section.lines:
        words = words_of(deck.texts[i])
        own |= set(generated(words)) if "GENERATE" in section.params else {
            int(word) for word in words if word.isdigit()}
    key = (section.part, section.params.get("ELSET", "").upper())
    if not hidden.get(key, True):
        return [_line_edit(deck, i, b"") for i in [*_head(deck, section), *section.lines]]
    if section.name == "NSET":
        drop = {number for number in own if (home, number) in names.lost}
        title = next(t for t, k in titles(deck, "NSET").items() if k == (
            section.part, section.params.get("NSET", "").upper()))
        add = names.of_set(title, home) - {n for part, n in deck.number if part == home} if (
            own) else set()
    elif key in hidden:
        alias = resolved(deck.sections)
        last = [s for s in deck.sections if s.name == "ELSET" and s.part == section.part
                and s.params.get("ELSET", "").upper() == key[1] and home_of(s, alias) == home][-1]
        before = {deck.blocks[b].ids[r] for b, r in members(deck, *key)
                  if deck.blocks[b].part == home}
        after = {number for part, number in hidden[key] if part == home}
        drop = own & (before - after)
        add = after - before if section is last else set()
    else:
        drop = {number for number in own if (home, number) in names.gone}
        add = {new for number in own for new in names.fresh.get((home, number), ())}
    if not (drop or add):
        return []
    edits = []
    ranges = "GENERATE" in section.params
    for i in section.lines:
        text = deck.texts[i]
        words = words_of(text)
        new = text
        if ranges:
            numbers = [n for n in generated(words) if n not in drop]
            if len(numbers) != len(generated(words)):
                new = b"".join(_runs(numbers, _end(text) or b"\n"))
        elif any(word.isdigit() and int(word) in drop for word in words):
            kept = [word for word in words if word and not (word.isdigit() and int(word) in drop)]
            comma = b"," if text.rstrip().endswith(b",") else b""
            new = encoded(", ".join(kept), text) + comma + _end(text) if kept else b""
        if add and i == section.lines[-1]:
            end = _end(text) or b"\n"
            numbers = sorted(add)
            new += b"" if not new or _end(new) else end
            new += b"".join(_runs(numbers, end) if ranges else _listed(numbers, end))
        if new is not text:
            edits.append(_line_edit(deck, i, new))
    return edits


def _head(deck: Deck, section: Section) -> range:
    """Lines of a keyword."""
    first = section.head
    while not deck.texts[first].lstrip().startswith(b"*"):
        first -= 1
    return range(first, section.head + 1)


def _runs(numbers: list[int], end: bytes) -> list[bytes]:
    """Lines of first, last and step."""
    breaks = [0, *(k for k, (a, b) in enumerate(pairwise(numbers), 1) if b != a + 1), len(numbers)]
    return [f"{numbers[a]}, {numbers[b - 1]}, 1".encode() + end for a, b in pairwise(breaks)
            if b > a]
