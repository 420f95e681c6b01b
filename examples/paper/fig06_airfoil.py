"""Fig 6: three ODT steps with rho = 1/|tau| on a graded mesh around an airfoil (Section 5.1.2).

python examples/paper/fig06_airfoil.py [FOLDER]
"""

from __future__ import annotations

import numpy as np
from paper_common import beside, draw_mesh, histogram, local_steps, picture, read, run, save, show

from odt_plugins import optimize_with_report
from odt_plugins.engine.odt.density import size_field
from odt_plugins.figures import radius_ratio

PAPER = {"original": (0.25, 0.90, "", ""), "ODT, 3 steps": (0.57, 0.95, "kept", "none"),
         "odt_plugins.optimize": ("", "", "", "")}
STEPS = 3


def main(folder=None):
    """Smooth with the density of the mesh itself, and with the defaults of optimize."""
    points, cells = read("airfoil.vtu")
    literal = local_steps(points, cells, STEPS, inverse_volume=True)[-1]
    best, report = optimize_with_report((points, cells))
    meshes = dict(zip(PAPER, ((points, cells), literal, best), strict=True))
    sizes = np.log(size_field(points, cells))
    result = {}
    for name, (p, t) in meshes.items():
        q = radius_ratio(p, t)
        change = float(np.exp(np.abs(np.log(size_field(p, t)) - sizes).mean()) - 1.0)
        deleted = len(points) - len(np.unique(t))
        result[name] = float(q.min()), float(q.mean()), f"{change:.1%}", deleted
    show(f"Fig 6, paper | ours ({len(points)} vertices)",
         ("", "min q", "mean q", "mean change of size", "deleted vertices"),
         [beside(name, PAPER[name], result[name]) for name in PAPER])
    print("\nWhat binds the minimum of optimize:")
    for cell in report.binding[:4]:
        print(f"  {cell}")
    image = picture((11.0, 7.0))
    for column, (axes, (name, (p, t))) in enumerate(
            zip(image.subplots(2, 3).T, meshes.items(), strict=True)):
        draw_mesh(axes[0], p, t, f"({'abc'[column]}) {name}")
        axes[0].set(xlim=(-0.75, 0.75), ylim=(-0.6, 0.6))
        histogram(axes[1], radius_ratio(p, t))
    save(image, folder, "fig06.png")
    return result


if __name__ == "__main__":
    run(main)
