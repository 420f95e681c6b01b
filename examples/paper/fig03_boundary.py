"""Fig 3: why boundary elements use their barycenter (Section 4.2.1).

The neighbours of a vertex lie on a circle, and one edge between them is a boundary edge. The
weighted mean of the circumcenters is the center of the circle, close to that edge; with the
remedy the vertex stays away from it.

python examples/paper/fig03_boundary.py [FOLDER]
"""

from __future__ import annotations

import numpy as np
from paper_common import beside, draw_mesh, figures, picture, run, save, show

from odt_plugins.engine.cells.geometry import barycenters, circumcenters
from odt_plugins.engine.odt.sweeps import gauss_seidel_sweep
from odt_plugins.engine.topology.stencil import make_topology

HEIGHT = 0.12
"""Distance from the center of the unit circle to the boundary edge."""


def star():
    """A star of six triangles; its vertex 0 may move, the edge of 1 and 2 is on the boundary."""
    turn = np.arccos(HEIGHT)
    upper = np.linspace(turn, 2 * np.pi - turn, 6)[1:-1]
    angle = np.concatenate([[-turn, turn], upper]) - np.pi / 2
    points = np.vstack([[0.15, 0.4], np.column_stack([np.cos(angle), np.sin(angle)])])
    ring = np.arange(1, 7)
    cells = np.column_stack([np.zeros(6, int), ring, np.roll(ring, -1)]).astype(np.int32)
    movable, boundary = np.zeros(7, bool), np.zeros(7, bool)
    movable[0], boundary[[1, 2]] = True, True
    return points, cells, make_topology(cells, movable, boundary)


def main(folder=None):
    """Smooth the vertex until it rests, without and with the remedy."""
    points, cells, topology = star()
    rows, result = [], {}
    image = picture((7.5, 3.8))
    for axes, rule in zip(image.subplots(1, 2), (False, True), strict=True):
        new = points
        for _ in range(100):
            new, _ = gauss_seidel_sweep(new, topology, boundary_rule=rule)
        name = "barycenters at the boundary" if rule else "circumcenters only"
        distance = float(new[0, 1] + HEIGHT)
        least = figures(new, cells).least
        result[rule] = distance, least
        rows.append(beside(name, ("away" if rule else "squashed",) * 2, (distance, least)))
        draw_mesh(axes, new, cells, f"({'b' if rule else 'a'}) {name}")
        centers = circumcenters(new, cells)
        if rule:
            centers[topology.boundary_cells] = barycenters(new, cells)[topology.boundary_cells]
        axes.plot(*centers.T, "^", color="#b03a2e", markersize=5)
        axes.plot(*new[0], "o", color="black", markersize=5)
        axes.plot(*new[[1, 2]].T, color="black", linewidth=2)
        axes.set(xlim=(-1.1, 1.1), ylim=(-1.1, 1.1))
        circle = np.linspace(0, 2 * np.pi, 200)
        axes.plot(np.cos(circle), np.sin(circle), ":", color="#6b7785", linewidth=0.8)
    show("Fig 3, paper | ours: where the vertex comes to rest",
         ("", "distance to the edge", "least q"), rows)
    save(image, folder, "fig03.png")
    return result


if __name__ == "__main__":
    run(main)
