"""Draws the pictures of the gallery (examples/README.md) that no other script draws.

python examples/gallery.py [NAME ...] [--folder FOLDER]

Names are those of PICTURES; without one all are drawn. All start meshes come with the package.
"""

from __future__ import annotations

import argparse
import csv
import tempfile
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import skfem
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from PIL import Image
from scipy.spatial import ConvexHull

import odt_plugins
from odt_plugins.adapters.files import read_file
from odt_plugins.cli.demo import read_obj
from odt_plugins.cli.main import main as command
from odt_plugins.compare.contestants import choose
from odt_plugins.compare.rows import compare_on
from odt_plugins.compare.runner import Limits
from odt_plugins.compare.start import stored
from odt_plugins.distributed import optimize as blockwise
from odt_plugins.distributed.partition import bricks
from odt_plugins.figures import angles, radius_ratio
from odt_plugins.report.interpolation import interpolation_errors
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
    q = odt_plugins.quality(mesh)
    return (f"q {q.min_quality:.2f} / {q.p1_quality:.2f} / {q.mean_quality:.3f}, "
            f"angles {q.min_angle:.0f}..{q.max_angle:.0f}")


def side_by_side(meshes: dict[str, Arrays], path: Path, up: int = 1) -> None:
    """Draw meshes in space beside each other, coloured by radius ratio, tetrahedra cut open."""
    figure, panels = row_of(len(meshes))
    for axes, (title, mesh) in zip(panels, meshes.items(), strict=True):
        painted = paint_mesh(axes, *mesh, up=up)
        axes.set_title(f"{title}\n{caption(mesh)}", fontsize=10)
    with_scale(figure, painted, path)


def in_the_plane(meshes: dict[str, Arrays], path: Path) -> None:
    """Draw planar meshes beside each other, coloured by radius ratio."""
    figure, panels = row_of(len(meshes))
    for axes, (title, (p, t)) in zip(panels, meshes.items(), strict=True):
        drawn = PolyCollection(p[t][:, :, :2], array=radius_ratio(p, t), cmap="RdYlBu",
                               edgecolors="#26323a", linewidths=0.3)
        drawn.set_clim(*SCALE)
        axes.add_collection(drawn)
        axes.set(aspect="equal", xlim=np.array([p[:, 0].min(), p[:, 0].max()]),
                 ylim=np.array([p[:, 1].min(), p[:, 1].max()]))
        axes.set_title(f"{title}\n{caption((p, t))}", fontsize=10)
        axes.set_axis_off()
    with_scale(figure, drawn, path)


def row_of(count: int) -> tuple[Any, Any]:
    """Return a figure with so many panels beside each other, and room for a scale."""
    width = 4.2 * count + 0.9
    figure = Figure(figsize=(width, 4.6))
    panels = figure.subplots(1, count)
    figure.subplots_adjust(left=0.01, right=1 - 1.0 / width, bottom=0.02, top=0.86, wspace=0.03)
    return figure, panels


def with_scale(figure: Any, painted: Any, path: Path) -> None:
    """Add the scale of the radius ratios and save."""
    width = figure.get_size_inches()[0]
    place = (1 - 0.85 / width, 0.1, 0.15 / width, 0.7)
    figure.colorbar(painted, cax=figure.add_axes(place), extend="min", label="radius ratio q")
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
    """Random points on the surface x^8 + y^8 + z^8 = 1, joined by their convex hull."""
    points = np.random.default_rng(4).normal(size=(n, 3))
    points /= (points**8).sum(axis=1, keepdims=True) ** (1 / 8)
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
    mesh = before.points[:, :2], before.cells_dict["triangle"]
    in_the_plane({"before": mesh, "after": odt_plugins.optimize(mesh)}, path)


def front(x: np.ndarray) -> np.ndarray:
    """A layer along the circle or the sphere of radius .7 around the origin."""
    return np.asarray(np.tanh(30 * (np.linalg.norm(x, axis=1) - 0.7)))


def adapted_to_front(d: int, cells: int, rounds: int = 4) -> Arrays:
    """The unit square or cube, remeshed in the metric of that layer."""
    axis = np.linspace(0.0, 1.0, 30 if d == 2 else 9)
    grid = (skfem.MeshTri if d == 2 else skfem.MeshTet).init_tensor(*[axis] * d)
    mesh: Arrays = grid.p.T.copy(), grid.t.T.copy()
    for _ in range(rounds):
        metric = odt_plugins.metric_from_field(mesh, front, cells)
        mesh = odt_plugins.remesh(mesh, metric=metric)
    return mesh


def adapted(path: Path) -> None:
    """Meshes adapted to a layer, in the plane and cut open in space."""
    figure, panels = row_of(2)
    (p, t), solid = adapted_to_front(2, 2500), adapted_to_front(3, 20_000)
    panels[0].add_collection(PolyCollection(p[t], facecolors="#eef3f7", edgecolors="#26323a",
                                            linewidths=0.3))
    panels[0].set(aspect="equal", xlim=(0, 1), ylim=(0, 1))
    panels[0].set_axis_off()
    painted = paint_mesh(panels[1], *solid)
    for axes, (points, cells) in zip(panels, ((p, t), solid), strict=True):
        error = interpolation_errors(points, cells, front)
        axes.set_title(f"{len(cells)} cells\nL2 error {error.l2:.1e}", fontsize=10)
    with_scale(figure, painted, path)


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
    label = bricks(points, cells, 2)
    centres = points[cells].mean(axis=1)
    apart, own = [], []
    for block in range(2):
        shift = 0.35 * (centres[label == block].mean(axis=0) - centres.mean(axis=0))
        vertices, inverse = np.unique(cells[label == block], return_inverse=True)
        own.append(inverse.reshape(-1, 4) + sum(map(len, apart)))
        apart.append(points[vertices] + shift)
    # So small a mesh would be done in one piece.
    with mock.patch.object(blockwise, "LEAST_CELLS", len(cells) // 2):
        glued = odt_plugins.optimize((points, cells), blocks=2)
    side_by_side({
        "before, cut into 2 blocks": (np.concatenate(apart), np.concatenate(own)),
        "after, glued": glued,
    }, path)


def script(path: Path) -> None:
    """A plate before and after the filter script of examples/filter_script.py."""
    import filter_script
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.add_mesh(filter_script.plate(), "plate")
    found = {}
    for title in ("the plate", "after examples/filter_script.mlx"):
        now = meshes.current_mesh()
        found[title] = (now.vertex_matrix().copy(), now.face_matrix().astype(np.int64))
        if len(found) == 1:
            odt_plugins.run_filter_script(meshes, AIRFOIL.parents[1] / "filter_script.mlx")
    in_the_plane(found, path)


def scan(path: Path) -> None:
    """A scan, and the tetrahedra that examples/meshlab_pipeline.py makes of it."""
    import meshlab_pipeline

    result = meshlab_pipeline.main()
    side_by_side({"the scan": read_obj(meshlab_pipeline.SCAN),
                  "holes closed, decimated, filled": (result["tet_vertex_matrix"],
                                                      result["tet_matrix"])}, path)


def sizes(path: Path) -> None:
    """The cube of examples/sizing_field.py: small tetrahedra on one side, large on the other."""
    import sizing_field

    side_by_side({name: (np.asarray(grid.points, dtype=float), grid.cells_dict[10])
                  for name, grid in sizing_field.meshes().items()}, path)


def others(path: Path) -> None:
    """Least, 1 % and mean radius ratio of the bone by tool."""
    tools = choose(("laplacian", "gmsh", "netgen", "mmg"))
    result = compare_on(stored("bone"), tools, Limits(20.0, 1), poisson=False)
    found = {"start": result.measured.summary}
    found |= {row.contestant: row.measured.summary for row in result.rows
              if row.measured is not None and not row.contestant.startswith("odt-plugins:")}
    figure = Figure(figsize=(9, 4.2), layout="constrained")
    axes = figure.subplots()
    for field, colour, label in (("min_quality", "#c0392b", "least"),
                                 ("p1_quality", "#9aa5b1", "1 %"),
                                 ("mean_quality", "#2f6fb0", "mean")):
        axes.plot([getattr(q, field) for q in found.values()], range(len(found)), "o",
                  color=colour, label=label)
    axes.set(yticks=range(len(found)), yticklabels=list(found), xlim=(0, 0.9),
             xlabel="radius ratio q of the cells of the bone")
    axes.invert_yaxis()
    axes.grid(axis="x", alpha=0.3)
    axes.legend(ncols=3, fontsize=9, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    write(figure, path)


def many(path: Path) -> None:
    """The mean quality of many models before and after, from the summary of a batch."""
    import batch_models

    with tempfile.TemporaryDirectory() as name:
        models = Path(name) / "models"
        batch_models.make_models(models, lengths=(1.4, 2.3, 3.5))
        command(["batch", str(models / "*.stl"), str(models / "*.ply"), "--out",
                 f"{name}/results", "--timeout", "60", "--quiet"])
        with (Path(name) / "results" / "summary.csv").open(encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    good = [row for row in rows if row["status"] == "ok"]
    figure = Figure(figsize=(9, 3.4), layout="constrained")
    axes = figure.subplots()
    for k, row in enumerate(good):
        before, after = float(row["before_mean_quality"]), float(row["after_mean_quality"])
        axes.plot([before, after], [k, k], color="#9aa5b1", zorder=1)
        axes.scatter([before, after], [k, k], c=["#9aa5b1", "#2f6fb0"], zorder=2)
    axes.set(yticks=range(len(good)), yticklabels=[Path(row["source"]).name for row in good],
             xlabel="mean radius ratio q before (grey) and after (blue)",
             title=", ".join(f"{row['status']}: {Path(row['source']).name}" for row in rows
                             if row["status"] != "ok"))
    axes.tick_params(labelsize=8)
    write(figure, path)


PICTURES: dict[str, Callable[[Path], None]] = {
    "slide": slide, "insert": insert, "curvature": curvature, "plane": plane,
    "objectives": objectives, "blocks": blocks, "script": script, "scan": scan, "sizes": sizes,
    "others": others, "many": many, "adapted": adapted,
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
