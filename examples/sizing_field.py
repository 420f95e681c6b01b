"""A sizing field for TetWild that ODT keeps: small tetrahedra on one side, large on the other.

TetWild makes cells as large as the field asks for only with `coarsen`, and another mesh every time:
ODT is given the mesh that it is compared with, and keeps its sizes. Without ``odt=False`` one call
does both, and the field itself is the density.
"""

from __future__ import annotations

import numpy as np
import pyvista
from numpy.typing import NDArray

import odt_plugins

SMALL, GROWTH = 0.12, 0.25
"""Edge length at x = 0, and how much longer edges become on the way to x = 1."""


def size(points: NDArray[np.floating]) -> NDArray[np.floating]:
    """Edge length that is wanted at some points."""
    return SMALL + GROWTH * points[:, 0]


def background() -> pyvista.UnstructuredGrid:
    """Tetrahedra around the unit cube with an edge length at every vertex."""
    grid = pyvista.ImageData(dimensions=(4, 4, 4), spacing=(0.4,) * 3, origin=(-0.1,) * 3)
    tets = grid.to_tetrahedra()
    tets.point_data["size"] = size(tets.points)
    tets.set_active_scalars("size")
    return tets


def deviation(mesh: pyvista.UnstructuredGrid) -> float:
    """Spread of edge length over wanted edge length, as standard deviation of its logarithm."""
    cells = mesh.cells_dict[10]
    edges = cells[:, [0, 1, 0, 2, 0, 3, 1, 2, 1, 3, 2, 3]].reshape(-1, 2)
    pairs = np.unique(np.sort(edges), axis=0)
    ends = mesh.points[pairs]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    return float(np.log(length / size(ends.mean(axis=1))).std())


def meshes() -> dict[str, pyvista.UnstructuredGrid]:
    """Return the cube filled by TetWild, and that mesh after ODT."""
    odt_plugins.register("pyvista")
    cube = pyvista.Box((0, 1, 0, 1, 0, 1)).triangulate()
    grid = cube.odt.tetrahedralize(sizing_field=background(), edge_length_fac=0.15, coarsen=True,
                                   odt=False)
    return {"TetWild": grid, "TetWild and ODT": grid.odt.optimize()}


def main() -> dict[str, tuple[float, float]]:
    """Return mean radius ratio and spread of sizes before and after ODT."""
    return {name: (grid.odt.quality().mean_quality, deviation(grid))
            for name, grid in meshes().items()}


if __name__ == "__main__":
    for name, (quality, spread) in main().items():
        print(f"{name:16} mean radius ratio {quality:.3f}, spread of sizes {spread:.3f}")
