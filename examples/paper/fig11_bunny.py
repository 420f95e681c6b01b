"""Fig 11: ODT, CPT and CVT on a bunny from Delaunay refinement (Section 5.4).

The density is that of the paper: sizes are the mean distance from a vertex to the circumcenters of
its star, rho = 1/h^3, kept from the start mesh. The boundary is fixed, Delaunay follows each step.

python examples/paper/fig11_bunny.py [FOLDER]
"""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
from paper_common import curves, figures, histogram, picture, run, save, show

import odt_plugins
from odt_plugins.engine.cells.geometry import circumcenters
from odt_plugins.engine.odt.cvt import cvt_step
from odt_plugins.engine.odt.density import make_density
from odt_plugins.engine.odt.sweeps import gauss_seidel_sweep
from odt_plugins.figures import angles, radius_ratio, volumes
from odt_plugins.paper.loop import delaunay_cells, iterate
from odt_plugins.report.plotting import paint_mesh

STEPS = 10
SLIVER = 10.0
"""Degrees of the smallest dihedral angle."""


def bunny():
    """Points and positive cells of the start mesh."""
    path = Path(odt_plugins.__file__).parent / "compare" / "data" / "cgal-bunny.vtu"
    mesh = meshio.read(path)
    points, cells = np.array(mesh.points, dtype=float), mesh.cells[0].data.astype(np.int32)
    turned = volumes(points, cells) < 0
    cells[turned, :2] = cells[turned, 1::-1]
    return points, cells


def density(points, cells):
    """Make rho = 1/h^3, h at a vertex the mean distance to the circumcenters of its star."""
    center = circumcenters(points, cells)
    distance = np.linalg.norm(points[cells] - center[:, None], axis=2)
    count = np.bincount(cells.ravel(), minlength=len(points))
    size = np.bincount(cells.ravel(), distance.ravel(), len(points)) / np.maximum(count, 1)
    return make_density(size**-3.0, None, points, cells)


def main(folder=None, steps=STEPS, slide=True):
    """Smooth by each method; optimize is run with a fixed and with a sliding surface."""
    points, cells = bunny()
    rho = density(points, cells)
    methods = {
        "ODT": lambda x, top: gauss_seidel_sweep(x, top, rho.at(x)),
        "CPT": lambda x, top: gauss_seidel_sweep(x, top, rho.at(x), method="cpt"),
        "CVT": lambda x, top: cvt_step(x, top, rho.at(x)),
    }
    meshes, means = {"original": (points, cells)}, {}
    for name, step in methods.items():
        means[name] = []
        for mesh in iterate(points, cells, step, delaunay_cells, steps):
            means[name].append(figures(*mesh).mean)
        meshes[name] = mesh
    meshes["odt_plugins.optimize"] = odt_plugins.optimize((points, cells))
    notes = []
    if slide:
        moved, report = odt_plugins.optimize_with_report((points, cells), boundary="slide")
        meshes["optimize, boundary='slide'"] = moved
        notes = [line for line in str(report).splitlines() if line.startswith("slid ")]
    result = {name: (float(radius_ratio(*mesh).mean()),
                     int((angles(*mesh).min(axis=1) < SLIVER).sum())) for name, mesh in
              meshes.items()}
    show(f"Fig 11, {steps} steps (paper: start 0.78, then ODT > CPT > CVT) "
         f"({len(points)} vertices, {len(cells)} tetrahedra)",
         ("", "mean q", f"cells below {SLIVER:g} deg"),
         [[name, *values] for name, values in result.items()])
    print(*notes, sep="\n")
    show("Mean q by step", ("step", *map(str, range(steps + 1))),
         [[name, *values] for name, values in means.items()])
    image = picture((12.0, 7.5))
    upper, lower = image.subplots(2, 4)
    for axes, name in zip(upper, ("original", *methods), strict=True):
        paint_mesh(axes, *meshes[name], up=1)
        axes.set_title(f"{name}: mean(q) {result[name][0]:.3f}", fontsize=9)
    for axes, name in zip(lower, ("ODT", "CPT", "CVT"), strict=False):
        histogram(axes, radius_ratio(*meshes[name]), name)
    curves(lower[3], means, "mean q")
    save(image, folder, "fig11.png")
    return result, means


if __name__ == "__main__":
    run(main)
