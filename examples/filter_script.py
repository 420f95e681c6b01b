"""A filter script (.mlx) with filters of MeshLab and of odt_plugins, applied to a plate.

The same from a shell:  odt-plugins script examples/filter_script.mlx plate.ply better.ply
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pymeshlab
from scipy.spatial import Delaunay

import odt_plugins


def plate() -> pymeshlab.Mesh:
    """Unit square with even points on its sides and random ones inside."""
    side = np.linspace(0.0, 1.0, 9)[:-1]
    zero, one = np.zeros(8), np.ones(8)
    rim = np.concatenate([np.stack(s, axis=1) for s in (
        (side, zero), (one, side), (1 - side, one), (zero, 1 - side))])
    inner = np.random.default_rng(7).uniform(0.06, 0.94, (60, 2))
    points = np.concatenate([rim, inner])
    faces = Delaunay(points).simplices
    return pymeshlab.Mesh(np.column_stack([points, np.zeros(len(points))]), faces)


def main() -> tuple[float, float]:
    """Return the mean radius ratio of the faces before and after."""
    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(plate(), "plate")
    before = odt_plugins.quality(meshes).mean_quality
    script = Path(__file__).with_suffix(".mlx")
    *_, last = odt_plugins.run_filter_script(meshes, script)
    return before, last["mean_radius_ratio"]


if __name__ == "__main__":
    print("mean radius ratio {:.3f} -> {:.3f}".format(*main()))
