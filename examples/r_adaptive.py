"""The same vertices, elsewhere: solve, estimate, move them by `density=`, repeat.

python examples/r_adaptive.py [--cells 3000] [--steps 5]

The problem of examples/adaptive.py in the plane, with meshes that all have as many vertices. The
first has cells of one size; every following one is `odt_plugins.optimize` of the one before with a
density of which the error asks. Prints unknowns, error in the energy norm and mean quality, and by
how much the error fell. No figure is kept and cells are not finished by their quality, since cells
of one size are better shaped than graded ones.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable

import numpy as np
from adaptive import REGULAR, Solved, estimate, solve, start, volume

import odt_plugins


def density(solved: Solved) -> np.ndarray:
    """Rho = h^-4 at every vertex for the sizes h that make the error least.

    The squared error of a cell is e h^2 times its volume, and h^-4 is in proportion to e. Means
    over the cells around a vertex, three times, take the noise out of the estimate.
    """
    cells = solved.mesh[1]
    size = volume(solved.mesh)
    dense = estimate(solved) / (size / REGULAR[2] * size)
    for _ in range(3):
        around = np.bincount(cells.ravel(), np.repeat(dense, 3)) / np.bincount(cells.ravel())
        dense = around[cells].mean(axis=1)
    return np.asarray(np.maximum(around, 1e-3 * np.median(around)))


def main(argv: Iterable[str] | None = None) -> list[Solved]:
    """Solve on the meshes one after the other, and print the table."""
    parser = argparse.ArgumentParser(description="Adaptivity that moves vertices.")
    parser.add_argument("--cells", type=int, default=3000)
    parser.add_argument("--steps", type=int, default=5)
    given = parser.parse_args(None if argv is None else list(argv))
    size = (3.0 / given.cells / REGULAR[2]) ** 0.5
    even = odt_plugins.remesh(start(2), size)
    done = [solve(odt_plugins.optimize(even, density="uniform", boundary="slide", keep=()))]
    for _ in range(given.steps):
        mesh = odt_plugins.optimize(
            done[-1].mesh, density=density(done[-1]), boundary="slide", finish=False, keep=())
        done.append(solve(mesh))
    print("| step | unknowns | error | mean q |")
    print("|---|---|---|---|")
    for step, solved in enumerate(done):
        quality = odt_plugins.quality(solved.mesh).mean_quality
        print(f"| {step} | {solved.unknowns} | {solved.error:.4f} | {quality:.3f} |")
    best = min(solved.error for solved in done)
    print(f"the error fell by {100 * (1 - best / done[0].error):.0f} % with as many vertices")
    return done


if __name__ == "__main__":
    main()
