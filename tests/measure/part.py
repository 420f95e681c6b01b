"""One part of the report of measurements: tables, charts, values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from odt_plugins.compare.charts import COLOURS, as_svg, blank_figure, plain_axes
from odt_plugins.compare.table import Table

MOST_DOTS = 40
"""Points of a line from which on only the line is drawn."""


@dataclass(frozen=True)
class Part:
    """One part of the scaling report.

    Attributes
    ----------
    tables : list of Table
    charts : list of str        inline SVG
    values : dict               what else belongs into JSON
    """

    tables: list[Table]
    charts: list[str] = field(default_factory=list)
    values: dict[str, Any] = field(default_factory=dict)


def power_laws(
    title: str, series: Sequence[tuple[str, Sequence[float], Sequence[float]]], x_label: str,
    y_label: str, *, log_x: bool = True, log_y: bool = True,
) -> str:
    """Draw lines through points on (double) logarithmic axes.

    Parameters
    ----------
    series : (name, x, y) of every line
    """
    if not any(len(x) for _, x, _ in series):
        return ""
    figure = blank_figure(5.6, 3.4)
    axes = figure.subplots()
    plain_axes(axes, title)
    axes.set(xscale="log" if log_x else "linear", yscale="log" if log_y else "linear",
             xlabel=x_label, ylabel=y_label)
    for (name, x, y), stroke in zip(series, [*COLOURS.values()] * len(series), strict=False):
        shown = [(a, b) for a, b in zip(x, y, strict=True) if b > 0 or not log_y]
        if shown:
            dot = "o" if len(shown) < MOST_DOTS else None
            axes.plot(*zip(*shown, strict=True), color=stroke, label=name, marker=dot, ms=4)
    axes.legend(frameon=False, fontsize=8)
    return as_svg(figure, "chart half", f"{title}: {y_label} over {x_label}")
