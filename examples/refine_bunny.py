"""A bunny of TetWild's, made coarse, and a million tetrahedra made of it, beside each other.

python examples/refine_bunny.py [PICTURE.png] [--levels N] [--envelope E] [--surface FILE]
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import meshio
import numpy as np
import pymeshlab
import pyvista
from PIL import Image

import odt_plugins
from odt_plugins.generate import LevelsReport

BUNNY = Path(odt_plugins.__file__).parent / "compare" / "data" / "bunny-surface.vtu"

Arrays = tuple[np.ndarray, np.ndarray]


def closed(path: Path) -> Arrays:
    """Points and triangles of a surface, its holes closed."""
    mesh = meshio.read(path)
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(pymeshlab.Mesh(mesh.points, mesh.cells_dict["triangle"]))
    meshes.meshing_close_holes(maxholesize=1000, selfintersection=False)
    whole = meshes.current_mesh()
    return whole.vertex_matrix(), whole.face_matrix()


def picture(coarse: Arrays, fine: Arrays, path: Path) -> None:
    """Render both cut open, with one colour scale."""
    odt_plugins.register("pyvista")
    plotter = pyvista.Plotter(off_screen=True, shape=(1, 2), window_size=[1200, 600])
    for column, (points, cells) in enumerate((coarse, fine)):
        plotter.subplot(0, column)
        grid = pyvista.UnstructuredGrid({10: cells}, points).odt.cell_quality()
        middle = 0.5 * (points[:, 2].min() + points[:, 2].max())
        behind = grid.extract_cells(grid.cell_centers().points[:, 2] < middle)
        plotter.add_mesh(behind, scalars="odt_radius_ratio", clim=(0.2, 1.0), cmap="RdYlBu",
                         show_edges=True, line_width=0.2 if column else 1.0, ambient=0.3,
                         show_scalar_bar=column == 1,
                         scalar_bar_args={"title": "radius ratio\n", "n_labels": 3, "width": 0.34,
                                          "position_x": 0.62, "position_y": 0.88})
        plotter.add_text(f"{len(cells)} tetrahedra", font_size=11)
        plotter.view_xy()
        plotter.camera.zoom(1.3)
    image = Image.fromarray(plotter.screenshot(return_img=True)).convert("RGB")
    image.quantize(256, Image.Quantize.MAXCOVERAGE).save(path, optimize=True)
    plotter.close()


def main(
    path: Path | None = None, surface: Path = BUNNY, levels: int = 2, envelope: float = 1e-3,
    edge_length: float = 0.1,
) -> tuple[LevelsReport, float, float]:
    """Return the report, TetWild's seconds for a tetrahedron, and all seconds for one."""
    points, faces = closed(surface)
    start = time.perf_counter()
    coarse = odt_plugins.tetrahedralize(
        points, faces, edge_length_fac=edge_length, epsilon=0.75 * envelope, odt=False,
        vtk_ordering=True)
    tetwild = time.perf_counter() - start
    fine, report = odt_plugins.refine_with_report(
        coarse, levels, surface=(points, faces), envelope=envelope, threads=os.cpu_count() or 1)
    seconds = time.perf_counter() - start
    if path:
        with pyvista.vtk_verbosity("error"):  # where there is no display, VTK warns of that
            picture(coarse, fine, path)
    return report, tetwild / len(coarse[1]), seconds / len(fine[1])


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("path", nargs="?", type=Path, default=Path("levels.png"))
    parser.add_argument("--levels", type=int, default=2)
    parser.add_argument("--envelope", type=float, default=1e-3)
    parser.add_argument("--edge-length", type=float, default=0.1)
    parser.add_argument("--surface", type=Path, default=BUNNY)
    arguments = parser.parse_args()
    found, alone, whole = main(**vars(arguments))
    print(found)
    print(f"TetWild  {1e6 * alone:.0f} us a tetrahedron of its coarse mesh, all together "
          f"{1e6 * whole:.0f} us a tetrahedron of the fine one")
