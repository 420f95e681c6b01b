"""Fig 9 and Table 1: six domains meshed as the paper does, and by odtmesh2d (Section 5.3).

Also the two step tables of Section 5.3. Figures are medians over seeds of the random start.

python examples/paper/fig09_table1.py [FOLDER]
"""

from __future__ import annotations

import math

import numpy as np
from paper_common import Figures, beside, draw_mesh, figures, picture, run, save, show

from odt_plugins.engine.cells.geometry import boundary_vertices
from odt_plugins.engine.odt.global_step import global_step
from odt_plugins.generate import SAMPLES, odtmesh2d, refine_triangles
from odt_plugins.generate.cleanup import clean_up
from odt_plugins.generate.domain import make_domain
from odt_plugins.generate.truss import initial_points, lattice, triangulate, truss_smoothing
from odt_plugins.paper.loop import iterate

TRUSS_STEPS, FINE_TRUSS_STEPS, GLOBAL_STEPS, ALPHA, EXPONENT = 100, 20, 3, 0.85, 3.0
"""What the tables are made with; the text says 80 and 10 steps of distmesh."""

STEPS = ("1. distmeshsmoothing", "2. uniform refinement", "3. distmeshsmoothing",
         "4. odtmeshoptimization", "5. clean up")
PAPER_STEPS = {
    "graded-square": ((0.48, 0.95, 5.1), (0.48, 0.95, 6.9), (0.25, 0.96, 4.6), (0.63, 0.97, 5.0),
                      (0.71, 0.97, 5.4)),
    "crescent": ((0.50, 0.96, 6.4), (0.50, 0.96, 6.4), (0.54, 0.96, 6.1), (0.73, 0.97, 6.1),
                 (0.73, 0.97, 6.1)),
}
SEEDS = range(5)


class Recipe:
    """The pipeline of Section 5.3 for one domain, every step by the engine's plain functions."""

    def __init__(self, sample, seed):
        self.domain = make_domain(sample.fd, sample.fh, sample.bbox)
        self.fixed = np.array(sample.pfix, dtype=float).reshape(-1, 2)
        inside = lattice(self.domain, sample.h0)
        inside = inside[self.domain.distance(inside) < 0.0]
        self.least = float(self.domain.size(inside).min())
        wanted = ((self.least / self.domain.size(inside)) ** 2).sum()
        self.level = max(round(math.log2(wanted / 300) / 2), 0)
        self.scale = sample.h0 * 2.0**self.level / self.least
        self.seed = seed

    def truss(self, points, steps):
        """Distmesh's steps; vertices close to the boundary go there."""
        points = truss_smoothing(points, self.domain, len(self.fixed), self.scale, steps)
        cells = triangulate(points, self.domain, self.scale)
        near = self.domain.distance(points) > -0.25 * self.scale * self.domain.size(points)
        near |= boundary_vertices(cells, len(points))
        near[: len(self.fixed)] = False
        points[near] = self.domain.project(points[near])
        return points, triangulate(points, self.domain, self.scale)

    def clean(self, points, cells):
        """Take out vertices of too few triangles."""
        points, cells, _ = clean_up(points, cells, np.arange(len(points)) < len(self.fixed))
        return points, cells

    def optimized(self, points, cells):
        """Global ODT steps, rho = 1/h^3, Delaunay after each."""
        def step(x, topology):
            rho = self.domain.size(x) ** -EXPONENT
            return global_step(x, topology, rho / rho.mean(), alpha=ALPHA)

        def reconnect(x, _):
            return triangulate(x, self.domain, self.scale)

        *_, mesh = iterate(points, cells, step, reconnect, GLOBAL_STEPS)
        return mesh

    def run(self):
        """The mesh after each of STEPS."""
        rng = np.random.default_rng(self.seed)
        mesh = self.truss(initial_points(self.domain, self.scale * self.least, self.least,
                                         self.fixed, rng), TRUSS_STEPS)
        meshes = [mesh]
        for _ in range(self.level):
            mesh = refine_triangles(*mesh)[:2]
            self.scale /= 2.0
        meshes.append(mesh)
        mesh = self.truss(mesh[0], FINE_TRUSS_STEPS)
        meshes.append(mesh)
        mesh = self.optimized(*mesh)
        meshes.append(mesh)
        meshes.append(self.clean(*mesh))
        return meshes


def main(folder=None, names=tuple(SAMPLES), seeds=SEEDS):
    """Mesh the domains, print both kinds of tables, draw Fig 9 with the meshes of odtmesh2d."""
    table, steps, drawn = {}, {}, []
    for name in names:
        s = SAMPLES[name]
        recipe = np.array([[figures(*mesh, s.fh) for mesh in Recipe(s, seed).run()]
                           for seed in seeds])
        meshes = [odtmesh2d(s.fd, s.fh, s.h0, s.bbox, s.pfix, seed=seed) for seed in seeds]
        ours = np.array([figures(*mesh, s.fh) for mesh in meshes])
        steps[name] = np.median(recipe, axis=0)
        table[name] = Figures(*steps[name][-1]), Figures(*np.median(ours, axis=0))
        drawn.append((s, meshes[0]))
    heads = ("", "min q", "mean q", "uniformity [%]")
    rows = []
    letters = dict(zip(SAMPLES, "abcdef", strict=True))
    for name in names:
        least, mean, u = SAMPLES[name].paper
        for what, got in zip(("the paper's steps", "odtmesh2d"), table[name], strict=True):
            rows.append(beside(f"({letters[name]}) {name}, {what}", (least, mean, 100 * u), got))
    show(f"Table 1, paper | ours, medians of {len(seeds)} seeds", heads, rows)
    for name in (n for n in names if n in PAPER_STEPS):
        show(f"Steps of Section 5.3 for {name}, paper | ours", heads,
             [beside(*row) for row in zip(STEPS, PAPER_STEPS[name], steps[name].tolist(),
                                          strict=True)])
    image = picture((11.0, 7.5))
    panels = np.ravel(image.subplots(2, 3))
    for axes in panels[len(names):]:
        axes.set_axis_off()
    for axes, name, (s, mesh) in zip(panels, names, drawn, strict=False):
        draw_mesh(axes, *mesh, f"({letters[name]}) {s.title}, {len(mesh[0])} vertices")
    save(image, folder, "fig09.png")
    return table, steps


if __name__ == "__main__":
    run(main)
