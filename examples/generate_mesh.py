"""Meshes made from distance functions: a plate with holes, and two domains of the paper.

python examples/generate_mesh.py [PICTURE.png]
"""

from __future__ import annotations

import sys
from io import BytesIO

import numpy as np

import odt_plugins
from odt_plugins.generate import SAMPLES, dcircle, ddiff, drectangle0, dunion, hgraded, odtmesh2d

CORNERS = [[0, 0], [3, 0], [3, 1], [0, 1]]
HOLES = [(0.5, 0.5, 0.3), (1.35, 0.35, 0.15), (1.75, 0.7, 0.08), (2.5, 0.5, 0.25)]


def holes(p: np.ndarray) -> np.ndarray:
    """Signed distance to the nearest hole."""
    return dunion(*(dcircle(p, *hole) for hole in HOLES))


def plate(p: np.ndarray) -> np.ndarray:
    """Signed distance to the plate without its holes."""
    return ddiff(drectangle0(p, 0, 3, 0, 1), holes(p))


def main(picture: str | None = None) -> dict[str, odt_plugins.QualitySummary]:
    """Make the meshes, draw them when a file is named, and return their figures."""
    size = hgraded(holes, 0.025, 0.2)
    meshes = {"plate": odtmesh2d(plate, size, 0.025, [[0, 0], [3, 1]], CORNERS)}
    for name in ("crescent", "pie"):
        s = SAMPLES[name]
        meshes[name] = odtmesh2d(s.fd, s.fh, s.h0, s.bbox, s.pfix)
    if picture:
        draw(meshes, picture)
    return {name: odt_plugins.quality(mesh) for name, mesh in meshes.items()}


def draw(meshes: dict[str, tuple[np.ndarray, np.ndarray]], path: str) -> None:
    """Draw meshes side by side, coloured by the radius ratio of their triangles."""
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure
    from PIL import Image

    from odt_plugins.figures import radius_ratio

    spans = [np.ptp(points, axis=0) for points, _ in meshes.values()]
    figure = Figure(figsize=(12, 2.5))
    panels = figure.subplots(1, len(meshes), width_ratios=[x / y for x, y in spans])
    figure.subplots_adjust(left=0.01, right=0.9, bottom=0.02, top=0.9, wspace=0.03)
    for axes, (name, (points, cells)) in zip(panels, meshes.items(), strict=True):
        drawn = PolyCollection(points[cells], array=radius_ratio(points, cells), cmap="viridis",
                               edgecolors="#26323a", linewidths=0.3)
        drawn.set_clim(0.5, 1.0)
        axes.add_collection(drawn)
        axes.set(aspect="equal", title=f"{name}, {len(points)} vertices")
        axes.autoscale_view()
        axes.set_axis_off()
    figure.colorbar(drawn, cax=figure.add_axes((0.92, 0.08, 0.012, 0.8)), label="radius ratio")
    buffer = BytesIO()
    figure.savefig(buffer, dpi=120, format="png")
    few = Image.open(buffer).convert("RGB").quantize(64, dither=Image.Dither.NONE)
    few.save(path, optimize=True)


if __name__ == "__main__":
    for name, figures in main(sys.argv[1] if len(sys.argv) > 1 else "generated.png").items():
        print(f"{name:10} {figures.n_points} vertices, radius ratio from {figures.min_quality:.3f},"
              f" mean {figures.mean_quality:.4f}")
