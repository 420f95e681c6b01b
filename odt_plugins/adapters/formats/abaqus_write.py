"""Abaqus decks written anew: nodes, elements that solvers compute with, and sets."""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np

from odt_plugins.adapters.formats.abaqus_tables import IN_PLANE, IN_SPACE, WORDS
from odt_plugins.adapters.formats.decks import indices, real, refuse_types

WIDEST, A_LINE, LONGEST = 20, 16, 80
"""Letters of a number, numbers on a line, and letters of a name that Abaqus reads."""


def write(path: Path, mesh: Any, binary: bool | None) -> list[str]:
    """Write nodes, a section of elements a block, and all sets.

    Raises
    ------
    UnsupportedMeshError    there are cells that no element is known for
    """
    points: Any = np.asarray(mesh.points).tolist()
    words = WORDS | (IN_PLANE if mesh.points.shape[1] == 2 else IN_SPACE)
    refuse_types({block.type for block in mesh.cells if len(block.data)} - words.keys())
    lines = ["*HEADING", "*NODE"]
    lines += [", ".join([str(v + 1), *(real(float(x), WIDEST).decode() for x in place)])
              for v, place in enumerate(points)]
    starts = np.cumsum([1, *(len(block.data) for block in mesh.cells)]).tolist()
    for block, start in zip(mesh.cells, starts, strict=False):
        if not len(block.data):
            continue
        lines.append(f"*ELEMENT, TYPE={words[block.type]}")
        for i, row in enumerate((np.asarray(block.data) + 1).tolist(), start):
            lines += _lines([i, *row], ",")
    taken: set[str] = set()
    for name, rows in mesh.cell_sets.items():
        own = [number for part, start in zip(rows, starts, strict=False) if part is not None
               for number in (indices(part) + start).tolist()]
        if own:
            title = _name(name, taken, mesh.cell_sets)
            lines += [f"*ELSET, ELSET={title}", *_lines(own, "")]
    taken = set()
    for name, nodes in mesh.point_sets.items():
        if len(nodes):
            lines += [f"*NSET, NSET={_name(name, taken, mesh.point_sets)}",
                      *_lines((indices(nodes) + 1).tolist(), "")]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return []


def _name(name: str, taken: set[str], names: Iterable[str]) -> str:
    """Name of a set, in quotes where it begins with no letter or has letters that end one.

    What ends a name in quotes becomes ``_``, and names that are too long are cut. Small letters
    and capitals are the same to Abaqus: a number tells names apart, of which none is one of all
    ``names``.
    """
    others = {other.upper() for other in names}
    plain = re.sub(r'["\x00-\x1f]', "_", name)
    titles = (plain[: LONGEST - len(end)] + end
              for end in chain([""], (f"_{k}" for k in count(2))))
    title = next(title for title in titles if title.upper() not in taken
                 and (title == name or title.upper() not in others))
    taken.add(title.upper())
    return title if re.fullmatch(r"[^\W\d][\w.-]*", title) else f'"{title}"'


def _lines(numbers: list[int], comma: str) -> list[str]:
    """Write numbers in lines, with a comma at the end of all lines but the last."""
    parts = [", ".join(map(str, numbers[k: k + A_LINE])) for k in range(0, len(numbers), A_LINE)]
    return [*(part + comma for part in parts[:-1]), parts[-1]]
