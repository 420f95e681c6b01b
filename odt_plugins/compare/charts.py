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
    figure = blank_figure(11.4, 3.2)
    for axes, (title, name) in zip(figure.subplots(1, 3), (
        ("mean radius ratio", "mean_quality"), ("1 % radius ratio", "p1_quality"),
        ("least radius ratio", "min_quality"),
    ), strict=True):
        plain_axes(axes, title)
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
    return as_svg(figure, "chart", f"quality against time on {result.start.name}")


def histograms(result: MeshResult) -> str:
    """Draw the histogram of everybody's radius ratios, that of the start behind."""
    rows = [(i, r) for i, r in enumerate(result.rows, 1) if r.measured]
    if not rows:
        return ""
    down = -(-len(rows) // ACROSS)
    figure = blank_figure(11.4, 1.9 * down)
    grid = figure.subplots(down, ACROSS, squeeze=False, sharex=True, sharey=True).ravel()
    before = _shares(result.measured.histogram)
    edges = [k / len(before) for k in range(len(before) + 1)]
    for axes, (i, row) in zip(grid, rows, strict=False):
        plain_axes(axes, f"{i}. {row.contestant}")
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
    return as_svg(figure, "chart", f"histograms of {result.start.name}")


def _shares(histogram: Sequence[int]) -> list[float]:
    return [100.0 * count / sum(histogram) for count in histogram]


def plain_axes(axes: Any, title: str) -> None:
    """Give axes a title and a grid, and no frame."""
    axes.set_title(title, loc="left", size=9.5, color=INK)
    axes.grid(color=GRID)
    axes.set_axisbelow(True)
    axes.spines[:].set_visible(False)
    axes.tick_params(colors=GREY, length=0, labelsize=8)


def blank_figure(width: float, height: float) -> Any:
    """Make an empty figure of so many inches."""
    from matplotlib.figure import Figure

    return Figure((width, height), layout="constrained")


def as_svg(figure: Any, style: str, label: str) -> str:
    """The element of a figure: text as text, the same bytes for the same figure."""
    from matplotlib import rc_context

    page = StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": label}):
        figure.savefig(page, format="svg", transparent=True, metadata={"Date": None})
    element = page.getvalue()[page.getvalue().index("<svg"):]
    return element.replace(
        "<svg ", f'<svg class="{style}" role="img" aria-label="{escape(label)}" ', 1)
