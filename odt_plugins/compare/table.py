"""Tables of plain values, aligned by six lines of our own: rich takes twice as many and 16 ms.

The same table is shown in the terminal, on pages, in Markdown and in LaTeX; jinja2 writes the last
three. rich would also read units in brackets as its markup.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

Value = str | int | float

Say = Callable[[str], None]
"""Is told, line by line, what is measured."""


@dataclass(frozen=True)
class Table:
    """What one measurement found.

    Attributes
    ----------
    name : str                 key in JSON
    title : str                one line above the table
    heads : tuple of str       one per column; units in brackets
    rows : list of tuples      one value per column
    notes : list of str        sentences below the table
    """

    name: str
    title: str
    heads: tuple[str, ...]
    rows: list[tuple[Value, ...]]
    notes: Sequence[str] = ()


def shown(value: Value) -> str:
    """Give a value as text: three digits of what is not a whole number."""
    if not isinstance(value, float):
        return str(value)
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def as_text(table: Table) -> list[str]:
    """Give the lines of a table for a terminal, columns aligned: words left, numbers right."""
    grid = [list(table.heads), *([shown(v) for v in row] for row in table.rows)]
    widths = [max(len(line[k]) for line in grid) for k in range(len(table.heads))]
    words = [any(isinstance(row[k], str) for row in table.rows) for k in range(len(table.heads))]
    lines = ["  ".join(text.ljust(w) if left else text.rjust(w)
                       for text, w, left in zip(line, widths, words, strict=True)).rstrip()
             for line in grid]
    return ["", table.title, *lines, *table.notes]
