"""Figs 7 and 8: the local method against the global one (Section 5.2).

Three inner vertices of a regular mesh of an equilateral triangle are moved and the mesh is refined:
its error is in the low frequencies.

python examples/paper/fig07_08_global.py [FOLDER]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from paper_common import beside, curves, draw_mesh, figures, picture, run, save, show

from odt_plugins.engine.odt.energy import energy
from odt_plugins.engine.odt.global_step import global_step
from odt_plugins.engine.odt.sweeps import gauss_seidel_sweep, jacobi_sweep
from odt_plugins.figures import radius_ratio
from odt_plugins.generate.clouds import SEED
from odt_plugins.paper.loop import delaunay_cells, iterate

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests"))

from measure.local_global import moved_triangle

LOCAL, GLOBAL = 42, 4
"""Steps that the paper shows."""


def main(folder=None, level=3, seed=SEED):
    """Run all methods from one start and print how near to equilateral they come."""
    points, regular, cells = moved_triangle(level, seed)
    methods = {
        "Jacobi": (LOCAL, lambda x, top: jacobi_sweep(x, top, boundary_rule=False)),
        "Gauss-Seidel": (LOCAL, lambda x, top: gauss_seidel_sweep(x, top, boundary_rule=False)),
        "global, alpha 1": (GLOBAL, lambda x, top: global_step(
            x, top, alpha=1.0, boundary_rule=False)),
        "global, alpha by energy": (GLOBAL, lambda x, top: global_step(
            x, top, boundary_rule=False)),
        "global, alpha 0.75": (8, lambda x, top: global_step(
            x, top, alpha=0.75, boundary_rule=False)),
    }
    runs = {name: list(iterate(points, cells, step, delaunay_cells, steps))
            for name, (steps, step) in methods.items()}
    least = energy(regular, cells)
    gaps = {name: [energy(*mesh) - least for mesh in meshes] for name, meshes in runs.items()}
    result = {name: (len(gaps[name]) - 1, *figures(*meshes[-1]), gaps[name][-1] / gaps[name][0])
              for name, meshes in runs.items()}
    start = figures(points, cells)
    steps_paper = {"Jacobi": "42, not yet", "global, alpha 1": "4, equilateral"}
    show(f"Figs 7 and 8, paper | ours ({len(points)} vertices, start: min q {start.least:.3f})",
         ("", "steps", "min q", "mean q", "uniformity [%]", "energy gap over that of the start"),
         [beside(name, (steps_paper.get(name, ""), *([""] * 4)), result[name])
          for name in result])
    enough = {name: next((k for k, (p, t) in enumerate(meshes)
                          if radius_ratio(p, t).min() > 1.0 - 1e-3), None)
              for name, meshes in runs.items()}
    show("Steps until every triangle has q > 0.999", list(enough),
         [["not in " + str(LOCAL) if k is None else k for k in enough.values()]])
    image = picture((9.0, 8.0))
    shown = (("(a) three vertices moved", moved_triangle(0, seed)[::2]),
             ("(b) the start, refined", (points, cells)),
             (f"(c) {LOCAL} steps of the local method (Jacobi)", runs["Jacobi"][-1]),
             (f"(d) {GLOBAL} steps of the global method", runs["global, alpha 1"][-1]))
    for axes, (title, mesh) in zip(np.ravel(image.subplots(2, 2)), shown, strict=True):
        draw_mesh(axes, *mesh, title)
    save(image, folder, "fig07.png")
    image = picture((5.5, 3.8))
    drawn = {name: np.maximum(values, 1e-14) for name, values in gaps.items()}
    curves(image.subplots(), drawn, "energy above the least", log=True)
    save(image, folder, "fig08.png")
    return result, enough


if __name__ == "__main__":
    run(main)
