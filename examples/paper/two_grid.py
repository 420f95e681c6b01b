"""Section 4.3, its end: solve on a coarse mesh, refine, take a few steps on the fine one.

The start is the disturbed channel of Fig 4. Either it is refined as it is and the fine mesh is
solved, or it is solved first and then refined. Steps are global, each followed by a pass of flips.

python examples/paper/two_grid.py [FOLDER]
"""

from __future__ import annotations

import time

import numpy as np
from fig04_05_channel import disturbed
from paper_common import figures, picture, run, save, show

from odt_plugins.engine.energy import energy
from odt_plugins.engine.graph_laplacian import global_step
from odt_plugins.engine.loop import flip_once, iterate
from odt_plugins.generate import refine_triangles

COARSE_STEPS, FEW, FINE_STEPS = 15, 3, 20


def refined(points, cells, levels):
    """The mesh with every triangle cut into 4^levels."""
    for _ in range(levels):
        points, cells, _ = refine_triangles(points, cells)
    return points, cells


def solve(points, cells, steps):
    """The last mesh, and of every step the processor seconds so far and the energy."""
    clock, curve = time.process_time(), []
    for mesh in iterate(points, cells, global_step, flip_once, steps):
        curve.append((time.process_time() - clock, energy(*mesh)))
    return mesh, np.array(curve)


def main(folder=None, levels=3):
    """Compare the energies, the cost and the quality of both ways."""
    start = disturbed()
    solve(*start, 1)
    solve(*refined(*start, 2), 1)
    fine, fine_curve = solve(*refined(*start, levels), FINE_STEPS)
    coarse, coarse_curve = solve(*start, COARSE_STEPS)
    both, both_curve = solve(*refined(*coarse, levels), FEW)
    both_curve[:, 0] += coarse_curve[-1, 0]
    share = 4.0**-levels
    rows = {
        f"fine mesh, {FINE_STEPS} steps": (fine_curve[-1], figures(*fine), float(FINE_STEPS)),
        f"fine mesh, {FEW} steps": (fine_curve[FEW], None, float(FEW)),
        f"two grids, {COARSE_STEPS} coarse + {FEW} fine steps": (
            both_curve[-1], figures(*both), FEW + share * COARSE_STEPS),
    }
    show(f"Section 4.3, ours ({len(start[0])} and {len(fine[0])} vertices)",
         ("", "work in fine steps", "processor [s]", "energy", "mean q", "min q"),
         [[name, work, *map(float, end), *(("", "") if q is None else (q.mean, q.least))]
          for name, (end, q, work) in rows.items()])
    image = picture((5.5, 3.8))
    axes = image.subplots()
    least = min(fine_curve[-1, 1], both_curve[-1, 1])
    axes.plot(fine_curve[1:, 0], fine_curve[1:, 1] / least, "o-", markersize=3, label="fine mesh")
    axes.plot(both_curve[:, 0], both_curve[:, 1] / least, "s-", markersize=3, label="two grids")
    axes.set(xlabel="processor seconds", ylabel="energy over the least found", xlim=(0, None))
    axes.legend(frameon=False)
    save(image, folder, "two_grid.png")
    return {name: (float(end[1]), work, q) for name, (end, q, work) in rows.items()}


if __name__ == "__main__":
    run(main)
