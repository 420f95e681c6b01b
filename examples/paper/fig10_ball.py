"""Fig 10: 40 steps of ODT and of CPT on a mesh of the unit ball, rho = 1 (Section 5.4).

The start is made as distmesh makes it, h0 = 0.2; Delaunay follows every second step. In space
that leaves slivers, which the finishing of ``odt_plugins.optimize`` removes.

python examples/paper/fig10_ball.py [FOLDER]
"""

from __future__ import annotations

import numpy as np
from paper_common import beside, default, figures, histogram, picture, run, save, show
from scipy.spatial import Delaunay

from odt_plugins.engine.odt.sweeps import gauss_seidel_sweep
from odt_plugins.figures import radius_ratio, volumes
from odt_plugins.paper.loop import delaunay_cells, iterate
from odt_plugins.report.plotting import paint_mesh

H0, TRUSS_STEPS, STEPS, EVERY = 0.2, 50, 40, 2
PAPER = {"(a) original": (0.74, "some"), "(c) ODT, 40 steps": ("", ""),
         "(e) CPT, 40 steps": ("", ""), "odt_plugins.optimize": ("", "")}


def distance(x):
    """Signed distance to the unit sphere."""
    return np.linalg.norm(x, axis=1) - 1.0


def tetrahedra(points):
    """Delaunay tetrahedra of positive volume whose center lies in the ball."""
    cells = Delaunay(points).simplices.astype(np.int32)
    cells = cells[distance(points[cells].mean(axis=1)) < -1e-3 * H0]
    volume = volumes(points, cells)
    cells[volume < 0, :2] = cells[volume < 0, 1::-1]
    return cells[np.abs(volume) > 1e-6 * H0**3]


def truss_ball():
    """Distmesh in space from a cubic lattice: bars that only push, outer vertices projected."""
    axis = np.arange(-1.0, 1.0 + H0, H0)
    lattice = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    points = lattice[distance(lattice) < 1e-1 * H0]
    for _ in range(TRUSS_STEPS):
        cells = tetrahedra(points)
        bars = np.unique(np.sort(np.concatenate(
            [cells[:, [i, j]] for i in range(4) for j in range(i)]), axis=1), axis=0)
        vector = points[bars[:, 0]] - points[bars[:, 1]]
        length = np.linalg.norm(vector, axis=1)
        wanted = 1.1 * (np.mean(length**3)) ** (1 / 3)
        push = (np.maximum(wanted - length, 0.0) / length)[:, None] * vector
        force = np.zeros_like(points)
        np.add.at(force, bars[:, 0], push)
        np.add.at(force, bars[:, 1], -push)
        points = points + 0.1 * force
        outside = distance(points) > 0.0
        points[outside] /= np.linalg.norm(points[outside], axis=1)[:, None]
    return points, tetrahedra(points)


def main(folder=None):
    """Smooth, compare the slivers and draw cut-open balls with their histograms."""
    start = truss_ball()
    meshes = [start]
    for method in ("odt", "cpt"):
        def step(x, topology, method=method):
            return gauss_seidel_sweep(x, topology, method=method)

        *_, last = iterate(*start, step, delaunay_cells, STEPS, every=EVERY)
        meshes.append(last)
    meshes.append(default(*start, density="uniform"))
    result = {}
    for name, mesh in zip(PAPER, meshes, strict=True):
        q, f = radius_ratio(*mesh), figures(*mesh)
        result[name] = f.mean, int((q <= 0.4).sum()), f.least, f.uniformity
    show(f"Fig 10, paper | ours ({len(start[0])} vertices, {len(start[1])} tetrahedra)",
         ("", "mean q", "cells with q <= 0.4", "min q", "uniformity [%]"),
         [[*beside(name, PAPER[name], result[name][:2]), *result[name][2:]] for name in PAPER])
    image = picture((7.0, 11.0))
    for axes, name, mesh in zip(image.subplots(4, 2), PAPER, meshes, strict=True):
        paint_mesh(axes[0], *mesh)
        axes[0].set_title(name, fontsize=9)
        histogram(axes[1], radius_ratio(*mesh))
    save(image, folder, "fig10.png")
    return result


if __name__ == "__main__":
    run(main)
