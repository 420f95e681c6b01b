"""Draws the pictures of the gallery (examples/README.md) that no other script draws.

python examples/gallery.py [NAME ...] [--folder FOLDER]

Names are those of PICTURES; without one all are drawn. All start meshes come with the package.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from PIL import Image
from scipy.spatial import ConvexHull

import odt_plugins
from odt_plugins.adapters.files import read_file
from odt_plugins.compare.start import stored
from odt_plugins.distributed.partition import bricks
from odt_plugins.quality import angles, radius_ratio
from odt_plugins.report.plotting import SCALE, paint_mesh

AIRFOIL = Path(__file__).parent / "meshes" / "airfoil.vtu"
COLOURS = 128

Arrays = tuple[np.ndarray, np.ndarray]


def arrays(name: str) -> Arrays:
    """Points and cells of a mesh that is stored with the package."""
    start = stored(name)
    return start.points, start.cells


def write(figure: Any, path: Path) -> None:
    """Save a figure with few colours: a third of the size."""
    buffer = BytesIO()
    figure.savefig(buffer, dpi=100, format="png")
    picture = Image.open(buffer).convert("RGB")
    picture.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
        path, optimize=True)


def caption(mesh: Arrays) -> str:
    """Three figures of a mesh, for its title."""
    q = odt_plugins.measure(mesh)
    return (f"q {q.min_quality:.2f} / {q.p1_quality:.2f} / {q.mean_quality:.3f}, "
            f"angles {q.min_angle:.0f}..{q.max_angle:.0f}")


def side_by_side(meshes: dict[str, Arrays], path: Path, up: int = 1) -> None:
    """Draw meshes in space beside each other, coloured by radius ratio, tetrahedra cut open."""
    figure = Figure(figsize=(4.2 * len(meshes), 4.6))
    panels = figure.subplots(1, len(meshes))
    figure.subplots_adjust(left=0.01, right=0.92, bottom=0.02, top=0.84, wspace=0.03)
    for axes, (title, mesh) in zip(panels, meshes.items(), strict=True):
        painted = paint_mesh(axes, *mesh, up=up)
        axes.set_title(f"{title}\n{caption(mesh)}", fontsize=10)
    figure.colorbar(painted, cax=figure.add_axes((0.94, 0.1, 0.012, 0.7)), extend="min",
                    label="radius ratio q")
    write(figure, path)


def slide(path: Path) -> None:
    """A boundary that stays, and one that slides."""
    before = arrays("cgal-bunny")
    side_by_side({
        "before": before,
        'boundary="fixed"': odt_plugins.optimize(before),
        'boundary="slide"': odt_plugins.optimize(before, boundary="slide"),
    }, path)


def insert(path: Path) -> None:
    """Vertices added and removed where nothing else helps."""
    before = arrays("cgal-bunny")
    plain, more = odt_plugins.optimize(before), odt_plugins.optimize(before, insert=True)
    side_by_side({f"{title}, {len(mesh[0])} vertices": mesh for title, mesh in
                  (("before", before), ("insert=False", plain), ("insert=True", more))}, path)


def rounded_box(n: int = 1500) -> Arrays:
    """Random points on the surface x^6 + y^6 + z^6 = 1, joined by their convex hull."""
    points = np.random.default_rng(4).normal(size=(n, 3))
    points /= (points**6).sum(axis=1, keepdims=True) ** (1 / 6)
    hull = ConvexHull(points)
    cells = hull.simplices
    a, b, c = points[cells].transpose(1, 0, 2)
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0
    cells[inward] = cells[inward][:, ::-1]
    return points, cells


def curvature(path: Path) -> None:
    """A surface with the sizes of the input, and one that is fine where it bends."""
    before = rounded_box()
    side_by_side({
        "before": before,
        **{f'density="{name}"': odt_plugins.optimize(before, density=name, envelope=5e-3)
           for name in ("uniform", "curvature")},
    }, path)


def plane(path: Path) -> None:
    """A graded planar mesh whose vertices were moved at random, around the airfoil."""
    before = read_file(AIRFOIL)
    points, cells = before.points[:, :2], before.cells_dict["triangle"]
    meshes = {"before": (points, cells), "after": odt_plugins.optimize((points, cells))}
    figure = Figure(figsize=(11, 4.2))
    panels = figure.subplots(1, 2)
    figure.subplots_adjust(left=0.01, right=0.91, bottom=0.02, top=0.86, wspace=0.03)
    low, high = points.min(axis=0), points.max(axis=0)
    for axes, (title, (p, t)) in zip(panels, meshes.items(), strict=True):
        quality = radius_ratio(p, t)
        drawn = PolyCollection(p[t], array=quality, cmap="RdYlBu", edgecolors="#26323a",
                               linewidths=0.3)
        drawn.set_clim(*SCALE)
        axes.add_collection(drawn)
        axes.set(aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        axes.set_title(f"{title}\n{caption((p, t))}", fontsize=10)
        axes.set_axis_off()
    figure.colorbar(drawn, cax=figure.add_axes((0.93, 0.1, 0.012, 0.7)), extend="min",
                    label="radius ratio q")
    write(figure, path)


def objectives(path: Path) -> None:
    """Dihedral angles of the bone by what finishing improves."""
    before = arrays("bone")
    figure = Figure(figsize=(11, 3.2))
    meshes = {"before": before}
    for name in ("radius_ratio", "min_dihedral", "amips"):
        meshes[f'objective="{name}"'] = odt_plugins.optimize(before, objective=name)
    panels = figure.subplots(1, len(meshes), sharey=True)
    figure.subplots_adjust(left=0.06, right=0.99, bottom=0.16, top=0.84, wspace=0.06)
    for axes, (title, mesh) in zip(panels, meshes.items(), strict=True):
        axes.hist(angles(*mesh).ravel(), bins=np.arange(0, 181, 5), color="#2f6fb0", log=True)
        axes.set_title(f"{title}\n{caption(mesh)}", fontsize=9)
        axes.set(xlabel="dihedral angle", xticks=range(0, 181, 45))
    panels[0].set_ylabel("angles")
    write(figure, path)


def blocks(path: Path) -> None:
    """The blocks into which a mesh is cut, drawn apart, and the mesh when they are glued."""
    points, cells = arrays("cgal-bunny")
    label = bricks(points, cells, 8)
    centres = points[cells].mean(axis=1)
    apart, own = [], []
    for block in range(8):
        shift = 0.35 * (centres[label == block].mean(axis=0) - centres.mean(axis=0))
        vertices, inverse = np.unique(cells[label == block], return_inverse=True)
        own.append(inverse.reshape(-1, 4) + sum(map(len, apart)))
        apart.append(points[vertices] + shift)
    side_by_side({
        "before, cut into 8 blocks": (np.concatenate(apart), np.concatenate(own)),
        "after, glued": odt_plugins.optimize_partitioned((points, cells), 8),
    }, path)


PICTURES: dict[str, Callable[[Path], None]] = {
    "slide": slide, "insert": insert, "curvature": curvature, "plane": plane,
    "objectives": objectives, "blocks": blocks,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw the pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(PICTURES))
    parser.add_argument("--folder", type=Path, default=Path())
    given = parser.parse_args(arguments)
    for name in given.names or PICTURES:
        PICTURES[name](given.folder / f"{name}.png")
        print(given.folder / f"{name}.png", flush=True)


if __name__ == "__main__":
    main()
