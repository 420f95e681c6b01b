"""Abaqus and CalculiX decks, .inp: nodes, elements, sets, and the faces of surfaces and loads."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.adapters.formats.abaqus_deck import (
    Deck,
    face_of,
    generated,
    home_of,
    members,
    parsed,
    resolved,
    side_blocks,
    side_rows,
    words_of,
)
from odt_plugins.adapters.formats.abaqus_tables import OF_MESHES, PLAIN
from odt_plugins.adapters.formats.decks import (
    DECK,
    FACES,
    HELD,
    ORDERS,
    REMARKS,
    joint_labels,
    load_labels,
    unread,
)

LABEL = "abaqus:elset"
"""Array of labels of cells, by the sets that they are in."""


def read(path: Path) -> Any:
    """Read a deck with all that it includes; parts stand where their own coordinates say.

    Returns
    -------
    meshio.Mesh      a block for each type and set of elements, then one for each surface and load
                     of faces, which are lines or triangles; `held` are nodes that have to stay,
                     `remarks` tell of elements of other types

    Raises
    ------
    MeshFileError    its parts do not fit together, or it makes nodes or elements out of others
    """
    from meshio import Mesh

    deck = parsed(path)
    cells: list[Any] = [(block.kind, block.rows) for block in deck.blocks]
    merged = side_blocks(deck)
    named = [(deck.sections[section].params.get("NAME", ""), len(cells) + i)
             for i, (section, _) in enumerate(merged)]
    cells += [(kind, np.concatenate([side_rows(deck, deck.sides[k]) for k in own]))
              for (_, kind), own in merged.items()]
    sets = cell_sets(deck)
    whole: dict[str, Any] = {
        name: [np.asarray(sorted(rows.get(i, ())), dtype=np.int64) for i in range(len(cells))]
        for name, rows in sets.items()}
    for name, i in named:
        if name:
            empty = [np.zeros(0, dtype=np.int64) for _ in cells]
            whole.setdefault(name, empty)[i] = np.arange(len(cells[i][1]))
    sizes = [len(rows) for _, rows in cells]
    label = _labels(deck, sets, sizes)
    for i, own in enumerate(merged.values(), len(deck.blocks)):
        label[i] = _loads(deck, own, np.asarray(cells[i][1]), label)
    data: Any = {LABEL: label} if any(numbers.any() for numbers in label) else {}
    mesh = Mesh(deck.points, cells, cell_data=data, cell_sets=whole, point_sets=point_sets(deck))
    setattr(mesh, HELD, deck.held)
    setattr(mesh, DECK, deck)
    mesh.info = unread("what is said by", [
        *(f"*{s.name}" for s in deck.sections if s.name not in OF_MESHES),
        *(f"*ELEMENT of type {word}" for word in [*deck.others, *(b.word for b in deck.blocks)]
          if word not in PLAIN)])
    if deck.others:
        setattr(mesh, REMARKS, [
            f"elements of type {', '.join(deck.others)} stay as they are with their nodes"])
    return mesh


def _labels(
    deck: Deck, sets: dict[str, dict[int, set[int]]], sizes: list[int]
) -> list[NDArray[np.int64]]:
    """Labels of cells: equal in the same sets of those that have a section or part the mesh."""
    out = [np.zeros(size, dtype=np.int64) for size in sizes]
    main = [b for b, block in enumerate(deck.blocks) if block.kind in ORDERS
            and block.kind == next(k for k in ORDERS if any(k == o.kind for o in deck.blocks))]
    if not main:
        return out
    rows = np.concatenate([deck.blocks[b].rows[:, : len(FACES[deck.blocks[b].kind])] for b in main])
    starts = dict(zip(main, np.cumsum([0, *(sizes[b] for b in main)]).tolist(), strict=False))
    inside = {}
    for title, own in sets.items():
        inside[title] = np.zeros(len(rows), dtype=np.bool_)
        for b in own.keys() & starts.keys():
            inside[title][starts[b] + np.array(sorted(own[b]))] = True
    given = {(s.part, s.params["ELSET"].upper()) for s in deck.sections
             if s.name.endswith("SECTION") and "ELSET" in s.params}
    known = titles(deck, "ELSET")
    taken = [inside.pop(title) for title in [*inside] if known[title] in given]
    label = joint_labels(taken, inside, rows)
    if label is not None:
        for b in main:
            out[b] = label[starts[b]: starts[b] + sizes[b]]
    return out


def _loads(
    deck: Deck, own: list[int], rows: NDArray[np.int64], label: list[NDArray[np.int64]]
) -> NDArray[np.int64]:
    """Numbers from 0 on of the loads on the faces (k, r) of some sides."""
    sides = [deck.sides[k] for k in own]
    told = [(re.sub(r"\d", "", words[1].upper()), *words[2:])
            for side in sides for words in [words_of(deck.texts[side.line])] for _ in side.rows]
    return load_labels(told, rows, np.concatenate([label[side.block][side.rows] for side in sides]))


def titles(deck: Deck, word: str) -> dict[str, tuple[str, str]]:
    """Parts and names in capitals of all sets of a kind by their titles; parts tell equal ones."""
    found: dict[tuple[str, str], str] = {}
    for section in deck.sections:
        name = section.params.get(word, "")
        if name and section.name in ("NODE", "ELEMENT", word):
            found.setdefault((section.part, name.upper()), name)
    names = [name.upper() for name in found.values()]
    return {f"{key[0]}.{name}" if names.count(name.upper()) > 1 else name: key
            for key, name in found.items()}


def faces_only(deck: Deck) -> set[tuple[str, str]]:
    """Sets of elements, by numbers, that nothing refers to but lines with a face in their part."""
    used = {(deck.sections[side.section].part, word.upper()) for side in deck.sides
            for word in words_of(deck.texts[side.line])[:1] if not word.isdigit()}
    for section in deck.sections:
        if section.name in ("NODE", "NSET") and "ELSET" not in section.params:
            continue
        values = {value.upper() for value in section.params.values()}
        if section.name == "ELSET":
            values.discard(section.params.get("ELSET", "").upper())
        for i in () if section.name == "ELEMENT" else section.lines:
            words = words_of(deck.texts[i])
            if section.name == "ELSET" and not all(w.isdigit() for w in words if w):
                used.discard((section.part, section.params["ELSET"].upper()))
            if face_of(section, words) is None or "." in words[0]:
                values |= {word.upper() for word in words if word[:1].isalpha() or "_" in word}
        for value in values:
            used -= {key for key in used if value.rpartition(".")[2] == key[1]}
    return used & {*titles(deck, "ELSET").values()}


def cell_sets(deck: Deck) -> dict[str, dict[int, set[int]]]:
    """Rows of every block in every set of elements, but for those of faces only."""
    hidden = faces_only(deck)
    out: dict[str, dict[int, set[int]]] = {}
    for title, key in titles(deck, "ELSET").items():
        if key in hidden:
            continue
        rows = out.setdefault(title, {})
        for b, r in members(deck, *key):
            rows.setdefault(b, set()).add(r)
    return out


def point_sets(deck: Deck) -> dict[str, Any]:
    """Nodes of every set of them."""
    alias = resolved(deck.sections)
    known = titles(deck, "NSET")
    found: dict[tuple[str, str], list[int]] = {key: [] for key in known.values()}
    for _ in range(2):
        for section in deck.sections:
            name = section.params.get("NSET", "").upper()
            if not name or section.name not in ("NODE", "NSET"):
                continue
            out = found[section.part, name]
            home = home_of(section, alias)
            if section.name == "NODE":
                out += [deck.number[home, int(deck.texts[i].split(b",")[0])] for i in section.lines]
                continue
            if "ELSET" in section.params:
                out += [v for b, r in members(deck, home, section.params["ELSET"])
                        for v in deck.blocks[b].rows[r].tolist()]
            for words in (words_of(deck.texts[i]) for i in section.lines):
                if "GENERATE" in section.params:
                    words = list(map(str, generated(words)))
                for word in words:
                    if word.isdigit():
                        out += [deck.number[home, int(word)]] if (home, int(word)) in (
                            deck.number) else []
                    elif word:
                        out += found.get((home, word.upper()), [])
    return {title: np.unique(np.array(found[key], dtype=np.int64)) for title, key in known.items()}
