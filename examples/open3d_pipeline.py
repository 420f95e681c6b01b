"""From an open3d point cloud to improved tetrahedra, with a picture before and after.

python examples/open3d_pipeline.py [PICTURE.png]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import open3d as o3d

import odt_plugins
from odt_plugins.hosts.open3d_filters import optimize_odt
from odt_plugins.report.plotting import plot_before_after


def ball(n: int = 1500) -> o3d.geometry.PointCloud:
    """Random points in a ball, coloured by their height."""
    random = np.random.default_rng(3)
    points = random.normal(size=(n, 3))
    points *= (random.random(n) ** (1 / 3) / np.linalg.norm(points, axis=1))[:, None]
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    height = (points[:, 2:] + 1) / 2
    cloud.colors = o3d.utility.Vector3dVector(np.hstack([height, height, 1 - height]))
    return cloud


def main(picture: Path | None = None) -> tuple[float, float]:
    """Return the mean radius ratio of the tetrahedra before and after."""
    cloud = ball()
    tets, indices = o3d.geometry.TetraMesh.create_from_point_cloud(cloud)
    tets.vertex_colors = o3d.utility.Vector3dVector(np.asarray(cloud.colors)[list(indices)])
    better = optimize_odt(tets)
    if picture:
        before, after = ((np.asarray(m.vertices), np.asarray(m.tetras)) for m in (tets, better))
        _, report = odt_plugins.optimize_with_report(tets)
        plot_before_after(before, after, report, picture, title="open3d's tetrahedra in a ball")
    return odt_plugins.quality(tets).mean_quality, odt_plugins.quality(better).mean_quality


if __name__ == "__main__":
    target = Path(sys.argv[1] if len(sys.argv) > 1 else "open3d.png")
    before, after = main(target)
    print(f"mean radius ratio {before:.3f} -> {after:.3f}, picture in {target}")
