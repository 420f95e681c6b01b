"""A pyvista grid before and after, cut open, rendered without a window.

python examples/pyvista_before_after.py [PICTURE.png]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pyvista
from PIL import Image

import odt_plugins


def start(n: int = 1200) -> pyvista.UnstructuredGrid:
    """Delaunay tetrahedra of random points in a ball."""
    random = np.random.default_rng(5)
    points = random.normal(size=(n, 3))
    points *= (random.random(n) ** (1 / 3) / np.linalg.norm(points, axis=1))[:, None]
    grid = pyvista.PolyData(points).delaunay_3d()
    grid.cell_data["first"] = np.arange(grid.n_cells)
    return grid


def picture(before: pyvista.UnstructuredGrid, after: pyvista.UnstructuredGrid, path: Path) -> None:
    """Render both with one colour scale, half of the cells taken away."""
    plotter = pyvista.Plotter(off_screen=True, shape=(1, 2), window_size=[1200, 600])
    for column, (title, grid) in enumerate((("before", before), ("after", after))):
        plotter.subplot(0, column)
        coloured = grid.odt.cell_quality()
        behind = coloured.extract_cells(coloured.cell_centers().points[:, 1] > 0)
        plotter.add_mesh(behind, scalars="odt_radius_ratio", clim=(0.2, 1.0), cmap="RdYlBu",
                         show_edges=True, ambient=0.3, show_scalar_bar=column == 1,
                         scalar_bar_args={"title": "radius ratio\n", "n_labels": 3})
        plotter.add_text(title)
        plotter.view_xz()
    image = Image.fromarray(plotter.screenshot(return_img=True)).convert("RGB")
    image.quantize(128, Image.Quantize.MAXCOVERAGE).save(path, optimize=True)
    plotter.close()


def main(path: Path | None = None) -> tuple[float, float]:
    """Return the mean radius ratio before and after."""
    odt_plugins.register("pyvista")
    before = start()
    after = before.odt.optimize()
    if path:
        with pyvista.vtk_verbosity("error"):  # where there is no display, VTK warns of that
            picture(before, after, path)
    return before.odt.quality().mean_quality, after.odt.quality().mean_quality


if __name__ == "__main__":
    target = Path(sys.argv[1] if len(sys.argv) > 1 else "pyvista.png")
    first, last = main(target)
    print(f"mean radius ratio {first:.3f} -> {last:.3f}, picture in {target}")
