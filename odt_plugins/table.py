"""The figures of meshes side by side, as aligned text and as HTML for notebooks."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

ROWS = (
    ("min_quality", "min quality", ".4f"),
    ("p1_quality", "1 % quality", ".4f"),
    ("mean_quality", "mean quality", ".4f"),
    ("min_angle", "smallest {angle}", ".2f"),
    ("max_angle", "largest {angle}", ".2f"),
    ("min_altitude", "least altitude", ".4g"),
    ("mean_amips", "mean AMIPS energy", ".4f"),
    ("max_amips", "max AMIPS energy", ".4f"),
    ("below_5", "cells below 5 deg", "d"),
    ("below_10", "cells below 10 deg", "d"),
    ("below_20", "cells below 20 deg", "d"),
    ("inverted", "cells not positive", "d"),
    ("turned", "cells turned", "d"),
    ("uniformity", "uniformity", ".4f"),
    ("volume", "{size}", ".6g"),
    ("n_points", "vertices", "d"),
    ("n_cells", "cells", "d"),
)
"""Rows of every table: name in QualitySummary, heading, format. That of `turned` is left out where
no cell was."""

LARGE = 1e5
"""Figures from here on, as energies of nearly flat cells, are written with an exponent."""


def table_lines(columns: Mapping[str, Any]) -> list[str]:
    """Set summaries (QualitySummary) side by side as aligned text, one row per figure."""
    rows = [("", list(columns)), *_rows(columns)]
    width = max(10, *(len(cell) + 2 for _, cells in rows for cell in cells))
    return [f"{head:<20}{''.join(f'{cell:>{width}}' for cell in cells)}" for head, cells in rows]


def table_html(columns: Mapping[str, Any]) -> str:
    """Set summaries side by side as a table of HTML; the heads of the columns are left out of one
    column without a name.
    """
    heads = "".join(f"<th>{escape(name)}</th>" for name in ["", *columns] if any(columns))
    rows = "".join(f"<tr><th>{escape(head)}</th>"
                   + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>"
                   for head, cells in _rows(columns))
    return f"<table>{f'<tr>{heads}</tr>' if heads else ''}{rows}</table>"


def text_html(text: str) -> str:
    """Set lines of text as HTML."""
    return f"<pre>{escape(text)}</pre>"


def _rows(columns: Mapping[str, Any]) -> Iterator[tuple[str, list[str]]]:
    """Heading and figures of every row."""
    words = {"angle": "dihedral" if all(s.dim == 3 for s in columns.values()) else "angle",
             "size": "area" if all(s.dim == 2 for s in columns.values()) else "volume"}
    for name, heading, form in ROWS:
        values = [getattr(summary, name) for summary in columns.values()]
        if name == "turned" and not any(values):
            continue
        yield heading.format(**words), [_figure(value, form) for value in values]


def _figure(value: float, form: str) -> str:
    """Give a figure as text; without decimals where they say nothing."""
    huge = form.endswith("f") and LARGE <= abs(value) < math.inf
    return f"{value:.3g}" if huge else format(value, form)
