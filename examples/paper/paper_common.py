"""What the scripts of this folder share: the paper's loops, its figures, tables and pictures."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import meshio
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from odt_plugins import optimize
from odt_plugins.engine.odt.sweeps import gauss_seidel_sweep
from odt_plugins.figures import radius_ratio, uniformity
from odt_plugins.paper.loop import flip_once, iterate

MESHES = Path(__file__).parents[1] / "meshes"
LINE, FACE, BAR = "#22313f", "#eaf1f8", "#2f6fb0"
COLOURS = 64


class Figures(NamedTuple):
    """Least and mean radius ratio (5.1), uniformity in per cent."""

    least: float
    mean: float
    uniformity: float


def figures(points, cells, h=None) -> Figures:
    """The three figures of the paper; h(x) are the wanted sizes."""
    q = radius_ratio(points, cells)
    return Figures(float(q.min()), float(q.mean()), 100.0 * uniformity(points, cells, h))


def local_steps(points, cells, steps: int, **options: Any) -> list[tuple[Any, Any]]:
    """The local loop of Section 5, alpha = 1: every mesh from the start on.

    The options are those of ``gauss_seidel_sweep``: method, inverse_volume, boundary_rule.
    """
    def step(x, topology):
        return gauss_seidel_sweep(x, topology, **options)

    return list(iterate(points, cells, step, flip_once, steps))


def default(points, cells, **options: Any) -> tuple[Any, Any]:
    """What ``odt_plugins.optimize`` makes of the mesh."""
    return optimize((points, cells), **options)


def read(name: str) -> tuple[Any, Any]:
    """Points and cells of a stored mesh."""
    mesh = meshio.read(MESHES / name)
    cells = mesh.cells[0].data.astype(np.int32)
    return np.ascontiguousarray(mesh.points[:, : cells.shape[1] - 1], dtype=float), cells


def show(title: str, heads: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table."""
    table = [list(map(text, row)) for row in (heads, *rows)]
    widths = [max(len(row[k]) for row in table) for k in range(len(heads))]
    print(f"\n{title}")
    for row in table:
        print("  ".join(f"{cell:<{w}}" if k == 0 else f"{cell:>{w}}"
                        for k, (cell, w) in enumerate(zip(row, widths, strict=True))))


def text(value: object) -> str:
    """A number with four digits, anything else as it is."""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def beside(name: str, paper: Sequence[object], ours: Sequence[object]) -> list[object]:
    """A row of "paper | ours" pairs."""
    return [name, *(f"{text(a)} | {text(b)}" for a, b in zip(paper, ours, strict=True))]


def draw_mesh(axes: Any, points, cells, title: str = "") -> None:
    """A planar mesh as the paper draws it."""
    axes.tripcolor(points[:, 0], points[:, 1], cells, np.zeros(len(cells)),
                   cmap=_one(FACE), edgecolors="none")
    axes.triplot(points[:, 0], points[:, 1], cells, color=LINE, linewidth=0.35)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(title, fontsize=9, color=LINE)


def histogram(axes: Any, q, title: str = "") -> None:
    """Histogram of radius ratios, as in Figs 6 and 10."""
    axes.hist(q, bins=np.linspace(0.0, 1.0, 51), color=BAR)
    axes.set_xlim(0.0, 1.0)
    axes.set_xlabel("q")
    axes.text(0.04, 0.92, f"min(q) {q.min():.2f}\nmean(q) {q.mean():.2f}", va="top",
              transform=axes.transAxes, fontsize=9)
    axes.set_title(title, fontsize=9, color=LINE)


def curves(axes: Any, named: dict[str, Sequence[float]], title: str = "", log: bool = False
           ) -> None:
    """One curve over the steps for every name, as in Figs 5 and 8."""
    for (name, values), mark in zip(named.items(), ("o-", "s-", "^-", "d-", "v-"), strict=False):
        axes.plot(range(len(values)), values, mark, markersize=3, linewidth=1, label=name)
    if log:
        axes.set_yscale("log")
    axes.set_xlabel("step")
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.set_title(title, fontsize=9, color=LINE)
    axes.legend(frameon=False, fontsize=9)


def picture(size: tuple[float, float]) -> Figure:
    """An empty picture."""
    return Figure(figsize=size, layout="constrained")


def save(figure: Figure, folder: str | Path | None, name: str) -> None:
    """Write a picture of few colours; without a folder nothing is written."""
    if folder is not None:
        Path(folder).mkdir(parents=True, exist_ok=True)
        buffer = BytesIO()
        figure.savefig(buffer, dpi=110, format="png")
        few = Image.open(buffer).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
        few.save(Path(folder) / name, optimize=True)


def run(main: Callable[[str | None], Any]) -> None:
    """Call main with the folder for the pictures, the only argument of the command line."""
    main(sys.argv[1] if len(sys.argv) > 1 else None)


def _one(colour: str) -> Any:
    from matplotlib.colors import ListedColormap

    return ListedColormap([colour])
