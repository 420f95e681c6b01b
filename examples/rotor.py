"""A rotor that turns in a box, step by step: untangling keeps the mesh around it valid.

python examples/rotor.py [--steps 100] [--turn 1000] [--picture rotor.png]

In every step the boundary of the rotor turns and the other vertices stay where they were, so that
cells are inverted; `odt_plugins.optimize` untangles and improves them. Prints how many were so
before each step and that none is after it, and draws the mesh at the start, halfway and at the end.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from gallery import in_the_plane

import odt_plugins
from odt_plugins.generate import ddiff, drectangle0, huniform, odtmesh2d

LENGTH, WIDTH = 0.75, 0.12
"""Half the length and half the width of the rotor, in a box from -1 to 1."""

BOX = [[-1.0, -1.0], [1.0, 1.0]]
CORNERS = [[x, y] for half in ((1.0, 1.0), (LENGTH, WIDTH))
           for x in (-half[0], half[0]) for y in (-half[1], half[1])]

Mesh = tuple[np.ndarray, np.ndarray]


def outside_of_the_rotor(p: np.ndarray) -> np.ndarray:
    """Distance to the box without the rotor."""
    return ddiff(drectangle0(p, -1, 1, -1, 1), drectangle0(p, -LENGTH, LENGTH, -WIDTH, WIDTH))


def turned(points: np.ndarray, degrees: float) -> np.ndarray:
    """Points (n, 2) turned around the origin."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return points @ np.array([[c, s], [-s, c]])


def run(mesh: Mesh, steps: int, turn: float) -> list[Mesh]:
    """The mesh after every step; vertices on the rotor turn with it, those on the box stay."""
    start = mesh[0]
    rotor = np.abs(outside_of_the_rotor(start)) < 1e-9
    rotor &= np.abs(start).max(axis=1) < 0.999
    meshes = [mesh]
    for step in range(1, steps + 1):
        points, cells = meshes[-1][0].copy(), meshes[-1][1]
        points[rotor] = turned(start[rotor], turn * step / steps)
        better, report = odt_plugins.optimize_with_report(
            (points, cells), density="uniform")
        left = odt_plugins.quality(better).inverted
        print(f"step {step:3d}: {report.before.inverted:3d} cells inverted before, {left} after; "
              f"mean q {report.after.mean_quality:.3f}, least {report.after.min_quality:.2f}")
        if left or not np.array_equal(better[0][rotor], points[rotor]):
            sys.exit("a cell is inverted, or the rotor is not where it should be")
        meshes.append(better)
    return meshes


def main(argv: Sequence[str] | None = None) -> None:
    """Turn the rotor."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--turn", type=float, default=1000.0, help="degrees in all")
    parser.add_argument("--size", type=float, default=0.07, help="length of edges")
    parser.add_argument("--picture", type=Path, default=Path("rotor.png"))
    given = parser.parse_args(argv)
    points, cells = odtmesh2d(outside_of_the_rotor, huniform, given.size, BOX, CORNERS)
    meshes = run((points, cells), given.steps, given.turn)
    shown = sorted({0, given.steps // 2, given.steps})
    in_the_plane({f"{given.turn * step / given.steps:.0f}°": meshes[step] for step in shown},
                 given.picture)
    print(f"written: {given.picture}")


if __name__ == "__main__":
    main()
