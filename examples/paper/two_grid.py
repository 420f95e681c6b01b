"""Section 4.3, its end: solve on a coarse mesh, refine, take a few steps on the fine one.

The starts are the disturbed channel of Fig 4 and the ball of Fig 10. Either one is refined as it is
and the fine mesh is solved, or it is solved first and then refined. Steps are global; in the plane
a pass of flips follows each, in space Delaunay on the coarse mesh only, which on the fine one would
make slivers.

python examples/paper/two_grid.py [FOLDER]
"""

from __future__ import annotations

import time

import numpy as np
from fig04_05_channel import disturbed
from fig10_ball import truss_ball
from paper_common import figures, picture, run, save, show

from odt_plugins.engine.odt.energy import energy
from odt_plugins.engine.odt.global_step import global_step
from odt_plugins.generate.refine3d import red_refinement
from odt_plugins.paper.loop import delaunay_cells, flip_once, iterate

COARSE_STEPS, FEW, FINE_STEPS = 15, 3, 20


def refined(points, cells, levels):
    """The mesh with every cell cut into 2^d so often."""
    for _ in range(levels):
        fine = red_refinement(points, cells)
        points, cells = fine.points, fine.cells
    return points, cells


def solve(points, cells, reconnect, steps):
    """The last mesh, and of every step the processor seconds so far and the energy."""
    clock, curve = time.process_time(), []
    for mesh in iterate(points, cells, global_step, reconnect, steps):
        curve.append((time.process_time() - clock, energy(*mesh)))
    return mesh, np.array(curve)


def compare(title, start, on_coarse, on_fine, levels, axes):
    """Go both ways, print and draw their energies, cost and quality."""
    solve(*start, on_coarse, 1)
    fine, fine_curve = solve(*refined(*start, levels), on_fine, FINE_STEPS)
    coarse, coarse_curve = solve(*start, on_coarse, COARSE_STEPS)
    both, both_curve = solve(*refined(*coarse, levels), on_fine, FEW)
    both_curve[:, 0] += coarse_curve[-1, 0]
    share = len(start[1]) / len(fine[1])
    rows = {
        f"fine mesh, {FINE_STEPS} steps": (fine_curve[-1], float(FINE_STEPS), figures(*fine)),
        f"two grids, {COARSE_STEPS} coarse + {FEW} fine steps": (
            both_curve[-1], FEW + share * COARSE_STEPS, figures(*both)),
    }
    show(f"Section 4.3, {title}: {len(start[0])} and {len(fine[0])} vertices",
         ("", "work in fine steps", "processor [s]", "energy", "min q", "mean q",
          "uniformity [%]"),
         [[name, work, *map(float, end), *q] for name, (end, work, q) in rows.items()])
    least = min(fine_curve[-1, 1], both_curve[-1, 1])
    axes.plot(fine_curve[1:, 0], fine_curve[1:, 1] / least, "o-", markersize=3, label="fine mesh")
    axes.plot(both_curve[:, 0], both_curve[:, 1] / least, "s-", markersize=3, label="two grids")
    axes.set(xlabel="processor seconds", ylabel="energy over the least found", xlim=(0, None),
             title=title)
    axes.legend(frameon=False)
    return [(float(end[1]), work, q) for end, work, q in rows.values()]


def main(folder=None, levels=3, space_levels=2):
    """Compare both ways in the plane and in space."""
    image = picture((9.0, 3.8))
    plane, space = image.subplots(1, 2)
    result = {
        "channel": compare("channel", disturbed(), flip_once, flip_once, levels, plane),
        "ball": compare("ball", truss_ball(), delaunay_cells, None, space_levels, space),
    }
    save(image, folder, "two_grid.png")
    return result


if __name__ == "__main__":
    run(main)
