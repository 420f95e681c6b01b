"""Prints how near blocks come to the run in one piece, for meshes in several orders.

python examples/blocks.py [--blocks N] [--least N] [--orders N] MESH...

A mesh is a file, or the name of one that is stored with the package, such as bunny or cgal-bunny.
Blocks may have fewer cells here than the package gives them, which does such meshes in one piece.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from unittest import mock

import odt_plugins
from odt_plugins.compare.start import STORED, read_start, reordered, stored
from odt_plugins.distributed import optimize as blockwise

HEADER = (
    "| start | cells | mean in one piece | blocks to it: mean | 1 % |\n"
    "|---|---|---|---|---|"
)


def row(name: str, blocks: int, orders: int) -> str:
    """One line of the table: the mesh as it is, and in random orders."""
    start = stored(name) if name in STORED else read_start(Path(name))
    found = []
    for given in (start, *(reordered(start, seed) for seed in range(orders))):
        mesh = given.points, given.cells
        one = odt_plugins.quality(odt_plugins.optimize(mesh))
        cut = odt_plugins.quality(odt_plugins.optimize(mesh, blocks=blocks))
        found.append((one.mean_quality, cut.mean_quality - one.mean_quality,
                      cut.p1_quality - one.p1_quality))
    mean, by, p1 = ((min(column), max(column)) for column in zip(*found, strict=True))
    return (f"| {Path(name).stem} | {len(start.cells)} | {mean[0]:.4f}..{mean[1]:.4f} | "
            f"{by[0]:+.4f}..{by[1]:+.4f} | {p1[0]:+.4f}..{p1[1]:+.4f} |")


def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("meshes", nargs="+", metavar="MESH")
    parser.add_argument("--blocks", type=int, default=4)
    parser.add_argument("--orders", type=int, default=6, help="random ones besides the given")
    parser.add_argument("--least", type=int, default=5000, help="cells of a block")
    given = parser.parse_args(arguments)
    print(HEADER)
    with mock.patch.object(blockwise, "LEAST_CELLS", given.least):
        for name in given.meshes:
            print(row(name, given.blocks, given.orders), flush=True)


if __name__ == "__main__":
    main()
