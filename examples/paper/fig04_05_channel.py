"""Figs 4 and 5: a wavy channel, ten steps of ODT and of CPT, rho = 1 (Section 5.1.1).

The paper's mesh is not at hand; these have about as many vertices, evenly spaced on the boundary
and moved at random inside. Figures are medians over the seeds, pictures show the first.

python examples/paper/fig04_05_channel.py [FOLDER]
"""

from __future__ import annotations

import numpy as np
from paper_common import (
    beside,
    curves,
    default,
    draw_mesh,
    figures,
    local_steps,
    picture,
    run,
    save,
    show,
)
from scipy.spatial import Delaunay, cKDTree

from odt_plugins.engine.odt.energy import energy
from odt_plugins.figures import radius_ratio, volumes
from odt_plugins.paper.loop import delaunay_cells

LENGTH, HEIGHT, WAVE, WAVES = 62.0, 11.0, 1.2, 4
AMOUNT, LEAST = 0.47, 0.141
"""Random moves in units of the cells, and the radius ratio below which they are shortened."""

PAPER = {
    "(a) original": (0.141, 0.875, 15.62),
    "(b) ODT, 10 steps": (0.709, 0.964, 5.16),
    "(c) CPT, 10 steps": (0.708, 0.967, 6.15),
    "odt_plugins.optimize": ("", "", ""),
}


def wave(x):
    """Height of the lower wall."""
    return WAVE * np.cos(2 * np.pi * WAVES * x / LENGTH)


def channel():
    """A regular mesh of the channel with edges of about 1: points, cells, number of wall nodes."""
    fine = np.linspace(0.0, LENGTH, 20001)
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(fine), np.diff(wave(fine))))])
    x = np.interp(np.linspace(0.0, arc[-1], round(arc[-1]) + 1), arc, fine)
    low = np.column_stack([x, wave(x)])
    side = np.linspace(0.0, HEIGHT, round(HEIGHT) + 1)[1:-1]
    ends = [np.column_stack([np.full_like(side, e), side + wave(e)]) for e in (0.0, LENGTH)]
    walls = np.vstack([low, low + np.array([0.0, HEIGHT]), *ends])

    def above(at):
        return at[:, 1] - np.interp(at[:, 0], x, low[:, 1])

    rows, columns = np.mgrid[-WAVE:HEIGHT + WAVE:0.75**0.5, 0.0:LENGTH]
    columns = columns + 0.5 * (np.arange(len(rows)) % 2)[:, None]
    lattice = np.column_stack([columns.ravel(), rows.ravel()])
    inside = (above(lattice) > 0) & (above(lattice) < HEIGHT) & (lattice[:, 0] < LENGTH)
    lattice = lattice[inside & (cKDTree(walls).query(lattice)[0] > 0.6)]
    points = np.vstack([walls, lattice])
    cells = Delaunay(points).simplices
    cells[volumes(points, cells) < 0] = cells[volumes(points, cells) < 0][:, ::-1]
    center = above(points[cells].mean(axis=1))
    cells = cells[(center > 0) & (center < HEIGHT) & (volumes(points, cells) > 1e-6)]
    points, cells = default(points, cells, density="uniform")
    return points, cells.astype(np.int32), len(walls)


def disturbed(seed=0):
    """The channel with its inner nodes moved at random, and their Delaunay connectivity."""
    points, cells, walls = channel()
    rng = np.random.default_rng(seed)
    star = np.bincount(cells.ravel(), np.repeat(volumes(points, cells), 3))
    move = AMOUNT * rng.uniform(-1.0, 1.0, points.shape) * np.sqrt(star / 6.0)[:, None]
    move[:walls] = 0.0
    while True:
        bad = np.unique(cells[radius_ratio(points + move, cells) < LEAST])
        if not bad.size:
            points = points + move
            return points, delaunay_cells(points, cells)
        move[bad] *= 0.8


def main(folder=None, seeds=range(5)):
    """Smooth ten times, print Fig 4 and draw both figures."""
    found, gaps = [], []
    for seed in seeds:
        start = disturbed(seed)
        runs = {method: local_steps(*start, 10, method=method) for method in ("odt", "cpt")}
        meshes = dict(zip(PAPER, (start, runs["odt"][-1], runs["cpt"][-1],
                                  default(*start, density="uniform")), strict=True))
        found.append([figures(*mesh) for mesh in meshes.values()])
        energies = {m: np.array([energy(*mesh) for mesh in run]) for m, run in runs.items()}
        gaps.append({m.upper(): e - energies["odt"][-1] for m, e in energies.items()})
        if folder is not None and len(gaps) == 1:
            _draw(folder, meshes, found[0], gaps[0])
    result = dict(zip(PAPER, np.median(found, axis=0).tolist(), strict=True))
    show(f"Fig 4, paper | ours, median of {len(gaps)} ({len(start[0])} vertices, {len(start[1])} "
         "triangles; the paper 875 and 1602)", ("", "min q", "mean q", "uniformity [%]"),
         [beside(name, PAPER[name], result[name]) for name in PAPER])
    show("Fig 5, ours: energy above that of ODT after ten steps", ("step", *map(str, range(11))),
         [[name, *map(float, values)] for name, values in gaps[0].items()])
    above = [k for k in range(11) if gaps[0]["ODT"][k] > gaps[0]["CPT"][k]]
    print("ODT is below CPT after every step" + (f" but {above}" if above else ""))
    return result, gaps


def _draw(folder, meshes, found, gaps):
    image = picture((9.0, 7.2))
    for axes, name, values in zip(image.subplots(4, 1), meshes, found, strict=True):
        draw_mesh(axes, *meshes[name], "{}: min(q) {:.3f}, mean(q) {:.3f}, uniformity {:.2f} %"
                  .format(name, *values))
    save(image, folder, "fig04.png")
    image = picture((5.0, 3.6))
    curves(image.subplots(), gaps, "energy above that of ODT after ten steps")
    save(image, folder, "fig05.png")


if __name__ == "__main__":
    run(main)
