"""Nastran decks written anew: grid points in fields of sixteen letters, and elements."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from odt_plugins.adapters.formats.decks import real, refuse_types
from odt_plugins.adapters.formats.nastran import LABEL
from odt_plugins.adapters.formats.nastran_tables import KINDS

CARDS = {kind: name for name, kinds in reversed(KINDS.items()) for kind in kinds.values()}
"""Elements by types of cells, the first that has one."""

NARROW, WIDE = 8, 16
"""Letters of a field."""

A_LINE = {NARROW: 8, WIDE: 4}
"""Fields of a line, by their letters."""


def write(path: Path, mesh: Any, binary: bool | None) -> list[str]:
    """Write all points and elements, whose labels are their properties.

    Raises
    ------
    UnsupportedMeshError    there are cells that no element is known for
    """
    refuse_types({block.type for block in mesh.cells if len(block.data)} - CARDS.keys())
    points: Any = np.zeros((len(mesh.points), 3))
    points[:, : mesh.points.shape[1]] = mesh.points
    lines = ["BEGIN BULK"]
    for v, place in enumerate(points.tolist(), 1):
        words = [real(x, WIDE).decode().upper() for x in place]
        lines += _card("GRID", [str(v), "", *words], WIDE)
    labels = mesh.cell_data.get(LABEL) or [np.zeros(len(block.data), int) for block in mesh.cells]
    number = 0
    for block, own in zip(mesh.cells, labels, strict=True):
        rows: Any = (np.asarray(block.data) + 1).tolist()
        for row, label in zip(rows, np.asarray(own).tolist(), strict=True):
            number += 1
            words = [str(number), str(label) if label else "", *map(str, row)]
            lines += _card(CARDS[block.type], words,
                           NARROW if max(map(len, words)) < NARROW else WIDE)
    path.write_text("\n".join([*lines, "ENDDATA", ""]), encoding="ascii")
    return []


def _card(name: str, words: list[str], width: int) -> list[str]:
    """Lines of a card, whose names end with a star where fields are wide."""
    count, star = A_LINE[width], "*" if width == WIDE else ""
    parts = [words[k: k + count] for k in range(0, len(words), count)]
    return [((f"{name}{star}" if k == 0 else star or "+").ljust(NARROW)
             + "".join(word.rjust(width) for word in part)).rstrip()
            for k, part in enumerate(parts)]
