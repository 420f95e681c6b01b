"""Charts of the page, drawn by matplotlib as inline SVG: quality against time, and histograms."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from io import StringIO
from typing import Any

from odt_plugins.compare.rows import MeshResult
from odt_plugins.report.plotting import GREY, INK

COLOURS = {
    "odt-plugins": "#1f5fa8", "gmsh": "#d1603d", "netgen": "#3a8f5c", "mmg": "#8a5fb4",
    "cgal": "#b58b00", "tetwild": "#b03a6f", "laplacian": "#6b7785", "pymeshlab": "#0f8a93",
    "open3d": "#9a5b2f",
}
"""One colour for every family."""

MOST_DOTS = 40
"""Points of a line from which on only the line is drawn."""

ACROSS = 5
"""Histograms in a row."""

GRID = "#e3e8ed"
BEHIND = "#c9d1d9"


def colour(family: str) -> str:
    """Colour of a family."""
    return COLOURS.get(family, GREY)


def quality_against_time(result: MeshResult) -> str:
    """Draw least, 1 % and mean radius ratio over seconds; the numbers are those of the rows."""
    rows = [(i, r) for i, r in enumerate(result.rows, 1) if r.measured and r.timing]
    if not rows:
        return ""
    figure = _figure(11.4, 3.2)
    for axes, (title, name) in zip(figure.subplots(1, 3), (
        ("mean radius ratio", "mean_quality"), ("1 % radius ratio", "p1_quality"),
        ("least radius ratio", "min_quality"),
    ), strict=True):
        _plain(axes, title)
        axes.set(xscale="log", xlabel="seconds")
        start = getattr(result.measured.summary, name)
        axes.axhline(start, color=INK, linestyle="--", alpha=0.6)
        axes.annotate("start", (1.0, start), (0, 3), xycoords=("axes fraction", "data"),
                      textcoords="offset points", ha="right")
        for i, row in sorted(rows, key=lambda pair: pair[1].family == "odt-plugins"):
            if row.timing and row.measured:
                at = max(row.timing.median, 1e-4), getattr(row.measured.summary, name)
                axes.plot(*at, "o", ms=12, mec="white", color=colour(row.family))
                axes.annotate(str(i), at, ha="center", va="center_baseline", color="white",
                              weight="bold", size=7.5)
    return _svg(figure, "chart", f"quality against time on {result.start.name}")


def histograms(result: MeshResult) -> str:
    """Draw the histogram of everybody's radius ratios, that of the start behind."""
    rows = [(i, r) for i, r in enumerate(result.rows, 1) if r.measured]
    if not rows:
        return ""
    down = -(-len(rows) // ACROSS)
    figure = _figure(11.4, 1.9 * down)
    grid = figure.subplots(down, ACROSS, squeeze=False, sharex=True, sharey=True).ravel()
    before = _shares(result.measured.histogram)
    edges = [k / len(before) for k in range(len(before) + 1)]
    for axes, (i, row) in zip(grid, rows, strict=False):
        _plain(axes, f"{i}. {row.contestant}")
        axes.title.set_size(8)
        axes.spines["left"].set(visible=True, color=GREY)
        axes.tick_params(labelleft=True, labelbottom=True)
        axes.stairs(before, edges, fill=True, color=BEHIND)
        if row.measured:
            axes.stairs(_shares(row.measured.histogram), edges, fill=True, alpha=0.75,
                        color=colour(row.family))
    for axes in grid[::ACROSS]:
        axes.set_ylabel("% of the cells", size=8)
    for axes in grid[:len(rows)][-ACROSS:]:
        axes.set_xlabel("radius ratio", size=8)
    for axes in grid[len(rows):]:
        axes.set_visible(False)
    return _svg(figure, "chart", f"histograms of {result.start.name}")


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
    figure = _figure(5.6, 3.4)
    axes = figure.subplots()
    _plain(axes, title)
    axes.set(xscale="log" if log_x else "linear", yscale="log" if log_y else "linear",
             xlabel=x_label, ylabel=y_label)
    for (name, x, y), stroke in zip(series, [*COLOURS.values()] * len(series), strict=False):
        shown = [(a, b) for a, b in zip(x, y, strict=True) if b > 0 or not log_y]
        if shown:
            dot = "o" if len(shown) < MOST_DOTS else None
            axes.plot(*zip(*shown, strict=True), color=stroke, label=name, marker=dot, ms=4)
    axes.legend(frameon=False, fontsize=8)
    return _svg(figure, "chart half", f"{title}: {y_label} over {x_label}")


def _shares(histogram: Sequence[int]) -> list[float]:
    return [100.0 * count / sum(histogram) for count in histogram]


def _plain(axes: Any, title: str) -> None:
    axes.set_title(title, loc="left", size=9.5, color=INK)
    axes.grid(color=GRID)
    axes.set_axisbelow(True)
    axes.spines[:].set_visible(False)
    axes.tick_params(colors=GREY, length=0, labelsize=8)


def _figure(width: float, height: float) -> Any:
    from matplotlib.figure import Figure

    return Figure((width, height), layout="constrained")


def _svg(figure: Any, style: str, label: str) -> str:
    """The element of a figure: text as text, the same bytes for the same figure."""
    from matplotlib import rc_context

    page = StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": label}):
        figure.savefig(page, format="svg", transparent=True, metadata={"Date": None})
    element = page.getvalue()[page.getvalue().index("<svg"):]
    return element.replace(
        "<svg ", f'<svg class="{style}" role="img" aria-label="{escape(label)}" ', 1)
