"""Pictures of the worst cells, before and after, for the page."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from io import BytesIO
from typing import Any

import numpy as np

from odt_plugins.compare.contestants import OURS
from odt_plugins.compare.hull import shell
from odt_plugins.compare.rows import MeshResult, Row
from odt_plugins.errors import MissingDependencyError
from odt_plugins.mesh.arrays import FloatArray
from odt_plugins.report.plotting import BLUE, GREY, INK, slightly_turned

SCALE = (0.0, 0.6)
"""Radius ratios at the ends of the colours."""

MOST_FACETS = 40_000
"""Facets of the outline that are drawn at most."""

Worst = Sequence[tuple[list[list[float]], float]]


def worst_cells(result: MeshResult) -> str:
    """Draw the start, ours and the best other with their worst cells.

    Returns
    -------
    str    a data URI of a PNG, "" when matplotlib is not installed
    """
    shown = [("start", result.measured.worst)]
    shown += [(row.contestant, row.measured.worst) for row in _chosen(result) if row.measured]
    try:
        figure = _figure(len(shown))
    except MissingDependencyError:
        return ""
    axes = np.atleast_1d(figure.subplots(1, len(shown)))
    painted = None
    for axis, (name, worst) in zip(axes, shown, strict=True):
        draw = _draw_planar if result.start.kind == "planar" else _draw_solid
        painted = draw(axis, result, worst)
        axis.set_title(f"{name}\nleast {worst[0][1]:.4f}", fontsize=11,
                       color=BLUE if name == OURS else INK)
        axis.set_aspect("equal")
        axis.set_axis_off()
    figure.subplots_adjust(left=0.01, right=0.93, top=0.86, bottom=0.02, wspace=0.03)
    bar = figure.colorbar(painted, cax=figure.add_axes((0.945, 0.2, 0.01, 0.5)), extend="max")
    bar.set_label("radius ratio", color=INK, fontsize=9)
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=8, colors=INK)
    buffer = BytesIO()
    figure.savefig(buffer, dpi=110, format="png")
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")


def _chosen(result: MeshResult) -> list[Row]:
    """Ours, and of the others without inverted cells the two with the best worst cell."""
    ours = [r for r in result.rows if r.contestant == OURS and r.measured]
    others = [r for r in result.rows if r.family != OURS and r.measured
              and r.measured.summary.inverted == 0]
    others.sort(key=lambda r: -(r.measured.summary.min_quality if r.measured else 0.0))
    return ours + others[: 1 if ours else 2]


def _figure(count: int) -> Any:
    try:
        from matplotlib.figure import Figure
    except ImportError as exc:
        msg = 'pictures need matplotlib; try pip install "odt-plugins[compare]"'
        raise MissingDependencyError(msg) from exc
    return Figure(figsize=(3.9 * count + 0.5, 4.1), facecolor="white")


def _draw_planar(axis: Any, result: MeshResult, worst: Worst) -> Any:
    from matplotlib.collections import LineCollection

    start = result.start
    axis.add_collection(LineCollection(start.points[shell(start)], colors=INK, linewidths=1.0))
    corners = np.array([c for c, _ in worst])
    painted = _paint(axis, corners, np.array([q for _, q in worst]))
    _halo(axis, corners.mean(axis=1))
    _limits(axis, start.points)
    return painted


def _draw_solid(axis: Any, result: MeshResult, worst: Worst) -> Any:
    from matplotlib.collections import PolyCollection

    start, view = result.start, slightly_turned()
    points = start.points @ view.T
    facets = shell(start)
    corners = points[facets[:: len(facets) // MOST_FACETS + 1]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    facing = np.abs(normal[:, 2])
    seen = np.argsort(corners.mean(axis=1)[:, 2], kind="stable")
    tint = np.column_stack([np.tile([0.35, 0.42, 0.5], (len(seen), 1)),
                            0.02 + 0.10 * (1.0 - facing[seen]) ** 2])
    axis.add_collection(PolyCollection(corners[seen][:, :, :2], facecolors=tint,
                                       edgecolors="none", rasterized=True))
    cells = np.array([c for c, _ in worst]) @ view.T
    quality = np.array([q for _, q in worst])
    _halo(axis, cells.mean(axis=1))
    sides = ((0, 1, 2),) if cells.shape[1] == 3 else ((1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2))
    faces = np.concatenate([cells[:, list(s)] for s in sides])
    order = np.argsort(faces.mean(axis=1)[:, 2], kind="stable")
    painted = _paint(axis, faces[order], np.tile(quality, len(sides))[order])
    _limits(axis, points)
    return painted


def _paint(axis: Any, corners: FloatArray, quality: FloatArray) -> Any:
    from matplotlib.collections import PolyCollection

    painted = PolyCollection(list(corners[:, :, :2]), cmap="RdYlBu", edgecolors=INK, linewidths=0.2,
                             zorder=3)
    painted.set_array(quality)
    painted.set_clim(*SCALE)
    axis.add_collection(painted)
    return painted


def _halo(axis: Any, centres: FloatArray) -> None:
    """Ring the places of the cells, which alone may be too small to see."""
    axis.scatter(centres[:, 0], centres[:, 1], s=70, facecolors="none", edgecolors=GREY,
                 linewidths=0.5, zorder=2)


def _limits(axis: Any, points: FloatArray) -> None:
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    room = 0.04 * (high - low).max()
    axis.set(xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room))
