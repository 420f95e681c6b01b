"""Figures: histograms and energy of a report, and cut-open meshes coloured by quality.

Only matplotlib is needed, and of it only its own rasteriser: no display, no graphics driver.
"""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from os import PathLike, fspath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from odt_plugins.errors import MeshFileError, MissingDependencyError
from odt_plugins.figures import QualitySummary, radius_ratio
from odt_plugins.promise.locked_facets import locked_facets

INK = "#22313f"
GREY = "#9aa5b1"
BLUE = "#2f6fb0"

SCALE = (0.3, 1.0)
"""Radius ratios at the ends of the colour scale; worse cells have the colour of the lower end."""


def plot_report(report: Any, path: str | PathLike[str]) -> None:
    """Draw the histograms before and after (cf. Figs 6 and 10 of the paper) and the energy.

    Parameters
    ----------
    report : Report
    path : str or path-like      .png, .pdf or .svg

    Raises
    ------
    MissingDependencyError       matplotlib is not installed
    MeshFileError                the figure cannot be written there
    """
    with_energy = len(report.energy) > 1
    figure = _figure((13.5 if with_energy else 9.0, 3.6))
    axes = figure.subplots(1, 3 if with_energy else 2)
    top = 1.08 * max(*report.histogram_before, *report.histogram_after, 1)
    _histogram(axes[0], report.histogram_before, report.before, "before", GREY, top)
    _histogram(axes[1], report.histogram_after, report.after, "after", BLUE, top)
    if with_energy:
        _energy(axes[2], report.energy)
    figure.tight_layout(w_pad=2.0)
    _save(figure, path, dpi=150)


def plot_before_after(
    before: tuple[NDArray[np.float64], NDArray[Any]],
    after: tuple[NDArray[np.float64], NDArray[Any]],
    report: Any,
    path: str | PathLike[str],
    *,
    title: str = "",
    up: int = 2,
) -> None:
    """Draw a mesh before and after, coloured by radius ratio; a tetrahedral one is cut open.

    Parameters
    ----------
    before, after : (points, cells)      (n, 3) and (m, 4) or (m, 3); one colour scale for both
    report : Report                      of the run, for the histograms beneath
    path : str or path-like              .png
    title : str                          over the picture
    up : int                             axis that points upwards, 1 (y) or 2 (z)

    Raises
    ------
    MissingDependencyError               matplotlib is not installed
    MeshFileError                        the picture cannot be written there
    """
    figure = _figure((12.0, 8.4))
    grid = figure.add_gridspec(2, 2, height_ratios=(3.1, 1.0), hspace=0.10, wspace=0.08,
                               left=0.065, right=0.90, top=0.915, bottom=0.075)
    top = 1.08 * max(*report.histogram_before, *report.histogram_after, 1)
    columns = (("before", before, report.histogram_before, report.before, GREY),
               ("after", after, report.histogram_after, report.after, BLUE))
    for column, (name, mesh, counts, summary, colour) in enumerate(columns):
        picture = figure.add_subplot(grid[0, column])
        painted = paint_mesh(picture, *mesh, up=up)
        picture.set_title(name, fontsize=14, color=INK)
        _histogram(figure.add_subplot(grid[1, column]), counts, summary, "", colour, top)
        if column:
            figure.axes[-1].set(ylabel="", yticklabels=[])
    bar = figure.colorbar(painted, cax=figure.add_axes((0.925, 0.40, 0.014, 0.42)), extend="min")
    label = f"radius ratio {before[1].shape[1] - 1} r / R"
    bar.set_label(label, color=INK, fontsize=11)
    bar.outline.set_visible(False)
    if title:
        figure.suptitle(title, fontsize=16, color=INK, x=0.4825, y=0.985, weight="bold")
    _save(figure, path, dpi=130, colours=256)


def _histogram(
    axes: Any, counts: Sequence[int], summary: QualitySummary, title: str, colour: str, top: float
) -> None:
    width = 1.0 / len(counts)
    axes.bar(np.arange(len(counts)) * width, counts, width=width, align="edge", color=colour,
             edgecolor="white", linewidth=0.4)
    text = (f"min {summary.min_quality:.3f}\n1 % {summary.p1_quality:.3f}\n"
            f"mean {summary.mean_quality:.3f}")
    axes.text(0.03, 0.95, text, transform=axes.transAxes, va="top", fontsize=11, color=INK,
              linespacing=1.4)
    axes.set(xlim=(0, 1), ylim=(0, top), xlabel="radius ratio", ylabel="cells")
    _plain_frame(axes, title)


def _energy(axes: Any, energy: Sequence[tuple[str, float]]) -> None:
    """Draw the energy above its last value, as the paper does in Figs 5 and 8."""
    value = np.array([e for _, e in energy])
    axes.plot(np.arange(len(value)), value, "o-", color=BLUE, markersize=4)
    axes.set(xlabel="round", ylabel="ODT energy", ylim=(None, None))
    axes.xaxis.get_major_locator().set_params(integer=True)
    _plain_frame(axes, "energy")


def _plain_frame(axes: Any, title: str) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(GREY)
    axes.tick_params(colors=INK, labelsize=9)
    axes.xaxis.label.set_color(INK)
    axes.yaxis.label.set_color(INK)
    if title:
        axes.set_title(title, fontsize=13, color=INK)


def paint_mesh(axes: Any, points: NDArray[np.float64], cells: NDArray[Any], *, up: int = 2) -> Any:
    """Paint a surface, or the far half of a tetrahedral mesh, from the back to the front.

    Parameters
    ----------
    axes : matplotlib axes
    points : (n, 3) float64
    cells : (m, 3) or (m, 4) int
    up : int                  axis that points upwards, 1 (y) or 2 (z)

    Returns
    -------
    PolyCollection            its colours are the radius ratios, see SCALE
    """
    from matplotlib.collections import PolyCollection

    view = slightly_turned(up)
    x = (points - (points.min(axis=0) + points.max(axis=0)) / 2) @ view.T
    facets, quality = cells, radius_ratio(points, cells)
    if cells.shape[1] == 4:
        facets, quality = _cut_open(x, cells)
    corners = x[facets]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal *= np.where(normal[:, 2:] < 0.0, -1.0, 1.0) / np.where(length > 0.0, length, 1.0)
    order = np.argsort(corners.mean(axis=1)[:, 2], kind="stable")
    light = np.array([-0.35, 0.5, 0.8]) / np.linalg.norm([-0.35, 0.5, 0.8])
    shade = 0.76 + 0.24 * np.clip(normal[order] @ light, 0, 1)
    painted = PolyCollection(corners[order][:, :, :2], linewidths=0.25, rasterized=True,
                             cmap="RdYlBu")
    painted.set_clim(*SCALE)
    colour: Any = painted.to_rgba(quality[order])
    colour[:, :3] *= shade[:, None]
    painted.set_facecolor(colour)
    edges: Any = np.column_stack([0.45 * colour[:, :3], np.ones(len(colour))])
    painted.set_edgecolor(edges)
    axes.add_collection(painted)
    low, high = x[:, :2].min(axis=0), x[:, :2].max(axis=0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set_axis_off()
    return painted


def _cut_open(
    x: NDArray[np.float64], cells: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[np.float64]]:
    """Facets of the far half, whole cells only, that face the eye; and the radius ratios."""
    behind = cells[x[cells].mean(axis=1)[:, 2] < 0.0]
    quality = np.abs(radius_ratio(x, behind))
    shell = locked_facets(behind, np.zeros(len(behind), np.int32), len(x))
    corners = x[shell.facets]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = np.einsum(
        "fd,fd->f", normal, corners.mean(axis=1) - x[behind[shell.cells]].mean(axis=1)
    )
    seen = np.sign(outward) * normal[:, 2] > 0
    return shell.facets[seen], quality[shell.cells[seen]]


def slightly_turned(up: int = 1) -> NDArray[np.float64]:
    """Rows: right, up and towards the eye of a slightly turned view, with axis `up` upwards."""
    turn, tilt = np.radians(-18.0), np.radians(14.0)
    c, s = np.cos(turn), np.sin(turn)
    around = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    c, s = np.cos(tilt), np.sin(tilt)
    over = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    axes = np.eye(3) if up == 1 else np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    return np.asarray(over @ around @ axes)


def _figure(size: tuple[float, float]) -> Any:
    try:
        from matplotlib.figure import Figure
    except ImportError as exc:
        msg = ("got a request for a figure and no matplotlib; expected it to be installed, try "
               'pip install "odt-plugins[plot]"')
        raise MissingDependencyError(msg) from exc
    return Figure(figsize=size, facecolor="white")


def _save(figure: Any, path: str | PathLike[str], dpi: int, colours: int = 0) -> None:
    """Write a figure; a PNG with few colours is a third of the size."""
    try:
        if not colours:
            figure.savefig(fspath(path), dpi=dpi)
            return
        from PIL import Image

        buffer = BytesIO()
        figure.savefig(buffer, dpi=dpi, format="png")
        picture = Image.open(buffer).convert("RGB")
        few = picture.quantize(colours, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
        few.save(fspath(path), optimize=True)
    except (OSError, ValueError) as exc:
        msg = f"got {fspath(path)!r} for a figure, it cannot be written: {exc}"
        raise MeshFileError(msg) from exc
