"""Curved surfaces in their hosts: texture coordinates, normals, filters."""

from __future__ import annotations

import json
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import surface_meshes as sm

import odt_plugins
from odt_plugins.cli import main as cli
from odt_plugins.errors import DataNotKeptWarning, InvalidOptionError
from odt_plugins.figures import radius_ratio

ENVELOPE = 3e-3


def textured_bowl():
    """A bowl with texture coordinates linear in x and y, in two charts that part at x = 0."""
    p, t = sm.bowl(25, noise=0.0)
    rng = np.random.default_rng(31)
    rim = np.unique([v for e, d in sm.edge_set(t).items() if d == 1 for v in e])
    free = np.setdiff1d(np.arange(len(p)), rim)
    seam = np.abs(p[:, 0]) < 1e-12
    p[free, :2] += 0.03 * rng.uniform(-1, 1, (len(free), 2))
    p[seam, 0] = 0.0
    p[:, 2] = 0.3 * (p[:, 0] ** 2 - 0.5 * p[:, 1] ** 2)
    chart = (p[t].mean(axis=1)[:, 0] > 0).astype(int)
    return p, t, chart, texture(p, t, chart)


def texture(p, t, chart):
    """Texture coordinates of every wedge."""
    return p[t][:, :, :2] * [0.25, 0.5] + 0.5 + 2.0 * chart[:, None, None]


def check_texture(p, t, x, c, uv, tolerance, seams):
    """The wedges have the texture coordinates of the places where their vertices are now.

    Where a triangle lies across the seam its chart is continued, along a plane.
    """
    chart = (uv.mean(axis=(1, 2)) > 1.5).astype(int)
    side = x[c][:, :, 0] * np.where(chart, 1, -1)[:, None]
    across = (side < -1e-9).any(axis=1)
    exact = texture(x, c, chart)
    assert uv[~across] == pytest.approx(exact[~across], abs=tolerance)
    assert uv[across] == pytest.approx(exact[across], abs=0.02)
    assert across.any() != seams
    assert (x != p).any(axis=1).sum() > 100
    assert radius_ratio(x, c).mean() > radius_ratio(p, t).mean() + 0.02
    assert max(sm.two_sided(p, t, x, c, 2)) <= ENVELOPE * sm.diagonal(p) * (1 + 1e-6)


def run(mesh, flips, seams):
    """Optimise; triangles across the seam are warned of."""
    options = {"smoothing": {"connectivity": "auto" if flips else "none"}, "finish": flips,
               "regions": "charts" if seams else None}
    warned = nullcontext() if seams else pytest.warns(DataNotKeptWarning, match="across seams")
    with warned:
        return odt_plugins.optimize(mesh, envelope=ENVELOPE, **options)


@pytest.mark.parametrize(("flips", "seams"), [(True, False), (False, False), (True, True)])
@pytest.mark.parametrize("kind", ["legacy", "tensor"])
def test_open3d_interpolates_texture_coordinates(kind, flips, seams):
    open3d = pytest.importorskip("open3d")
    p, t, _, uv = textured_bowl()
    if kind == "legacy":
        mesh = open3d.geometry.TriangleMesh(open3d.utility.Vector3dVector(p),
                                            open3d.utility.Vector3iVector(t))
        mesh.triangle_uvs = open3d.utility.Vector2dVector(uv.reshape(-1, 2))
    else:
        mesh = open3d.t.geometry.TriangleMesh(p, t.astype(np.int64))
        mesh.triangle["texture_uvs"] = uv
    out = run(mesh, flips, seams)
    if kind == "legacy":
        x, c = np.asarray(out.vertices), np.asarray(out.triangles)
        new = np.asarray(out.triangle_uvs).reshape(-1, 3, 2)
    else:
        x, c = out.vertex["positions"].numpy(), out.triangle["indices"].numpy()
        new = out.triangle["texture_uvs"].numpy().reshape(-1, 3, 2)
    check_texture(p, t, x, c, new, 1e-9, seams)


@pytest.mark.parametrize(("flips", "seams"), [(True, False), (False, False), (True, True)])
def test_pymeshlab_interpolates_texture_coordinates_of_wedges_and_vertices(flips, seams):
    pymeshlab = pytest.importorskip("pymeshlab")
    p, t, _, uv = textured_bowl()
    vertex = (p[:, :2] * [0.25, 0.5] + 0.5).astype(np.float32)
    mesh = pymeshlab.Mesh(p, t.astype(np.int32), v_tex_coords_matrix=vertex.astype(float),
                          w_tex_coords_matrix=uv.reshape(-1, 2))
    out = run(mesh, flips, seams)
    x, c = out.vertex_matrix(), out.face_matrix()
    new = out.wedge_tex_coord_matrix().reshape(-1, 3, 2)
    check_texture(p, t, x, c, new, 1e-6, seams)
    assert out.vertex_tex_coord_matrix() == pytest.approx(x[:, :2] * [0.25, 0.5] + 0.5, abs=1e-6)


def test_pyvista_interpolates_texture_coordinates_and_renews_normals():
    pyvista = pytest.importorskip("pyvista")
    p, t, _, _ = textured_bowl()
    mesh = pyvista.PolyData.from_regular_faces(p, t)
    mesh.compute_normals(cell_normals=True, point_normals=True, split_vertices=False,
                         auto_orient_normals=False, consistent_normals=False, inplace=True)
    mesh.point_data["uv"] = p[:, :2] * [0.25, 0.5] + 0.5
    mesh.point_data.active_texture_coordinates_name = "uv"
    mesh.point_data["temperature"] = np.arange(len(p)) / 3
    out = odt_plugins.optimize(mesh, envelope=ENVELOPE)
    x, c = np.asarray(out.points), out.regular_faces
    assert out.point_data["uv"] == pytest.approx(x[:, :2] * [0.25, 0.5] + 0.5, abs=1e-9)
    assert np.array_equal(out.point_data["temperature"], mesh.point_data["temperature"])
    normal = np.cross(x[c[:, 1]] - x[c[:, 0]], x[c[:, 2]] - x[c[:, 0]])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    assert (out.cell_data["Normals"] * normal).sum(axis=1).min() > 1 - 1e-6
    exact = np.stack([-0.6 * x[:, 0], 0.3 * x[:, 1], np.ones(len(x))], axis=1)
    exact /= np.linalg.norm(exact, axis=1)[:, None]
    assert (out.point_data["Normals"] * exact).sum(axis=1).min() > 0.99
    assert out.point_data["Normals"].dtype == mesh.point_data["Normals"].dtype
    named = mesh.copy()
    for data in (named.point_data, named.cell_data):
        data.active_normals_name = None
    named = odt_plugins.optimize(named, envelope=ENVELOPE)
    assert named.point_data.active_normals_name is None
    for one, other in ((named.point_data, out.point_data), (named.cell_data, out.cell_data)):
        assert np.array_equal(one["Normals"], other["Normals"])
    turned = mesh.copy()
    turned.point_data["Normals"] = -np.asarray(mesh.point_data["Normals"])
    turned.point_data.active_normals_name = "Normals"
    back = odt_plugins.optimize(turned, envelope=ENVELOPE)
    assert np.array_equal(back.point_data["Normals"], -np.asarray(out.point_data["Normals"]))


def test_the_accessor_of_pyvista_takes_curved_surfaces():
    pyvista = pytest.importorskip("pyvista")
    odt_plugins.register("pyvista")
    p, t = sm.torus(40, 16, noise=0.5)
    surface = pyvista.PolyData.from_regular_faces(p, t)
    out = surface.odt.optimize(envelope=5e-3)
    assert odt_plugins.quality(out).mean_quality > odt_plugins.quality(surface).mean_quality + 0.05
    assert max(sm.two_sided(p, t, np.asarray(out.points), out.regular_faces, 2)) <= (
        5e-3 * sm.diagonal(p))


@pytest.mark.filterwarnings("ignore:overflow encountered in scalar multiply")
@pytest.mark.parametrize("suffix", [".ply", ".stl", ".obj", ".vtu"])
def test_the_command_takes_files_of_curved_surfaces(suffix, tmp_path):
    meshio = pytest.importorskip("meshio")
    p, t = sm.torus(40, 16, noise=0.5)
    source, target, report = (tmp_path / name for name in
                              (f"in{suffix}", f"out{suffix}", "report.json"))
    meshio.write(source, meshio.Mesh(p, [("triangle", t.astype(np.int32))]))
    flags = ["--density", "curvature", "--envelope", "5e-3", "--feature-angle", "60",
             "--report", str(report)]
    assert cli.main(["optimize", str(source), str(target), *flags]) == 0
    old, new = meshio.read(source), meshio.read(target)
    before, after = (radius_ratio(m.points, m.cells_dict["triangle"]) for m in (old, new))
    assert after.mean() > before.mean() + 0.05
    away = sm.two_sided(old.points, old.cells_dict["triangle"], new.points,
                        new.cells_dict["triangle"], 2)
    assert max(away) <= 5e-3 * sm.diagonal(p) * (1 + 1e-5)
    told = json.loads(report.read_text())["surface"]
    assert away[0] <= told["forward"] * (1 + 1e-5)
    assert away[1] <= told["backward"] * (1 + 1e-5)
    assert told["envelope"] == pytest.approx(5e-3 * sm.diagonal(p), rel=1e-5)


@pytest.mark.parametrize("kind", ["legacy", "tensor"])
def test_the_filters_of_open3d_take_curved_surfaces(kind):
    open3d = pytest.importorskip("open3d")
    from odt_plugins.hosts import open3d_filters

    p, t = sm.torus(40, 16, noise=0.5)
    if kind == "legacy":
        mesh = open3d.geometry.TriangleMesh(open3d.utility.Vector3dVector(p),
                                            open3d.utility.Vector3iVector(t))
    else:
        mesh = open3d.t.geometry.TriangleMesh(p, t.astype(np.int64))
    before = odt_plugins.quality(mesh).mean_quality
    for name, gain in (("filter_smooth_odt", 0.01), ("filter_smooth_cpt", 0.01),
                       ("filter_smooth_odt_global", 0.0)):
        out = getattr(open3d_filters, name)(mesh, number_of_iterations=5, envelope=5e-3)
        assert type(out) is type(mesh)
        assert odt_plugins.quality(out).mean_quality > before + gain
    out = open3d_filters.optimize_odt(mesh, envelope=5e-3)
    assert odt_plugins.quality(out).mean_quality > before + 0.1


def test_a_texture_whose_charts_leave_nothing_to_move_is_kept():
    open3d = pytest.importorskip("open3d")
    p, t = sm.sphere(2, 0.1)
    mesh = open3d.geometry.TriangleMesh(open3d.utility.Vector3dVector(p),
                                        open3d.utility.Vector3iVector(t))
    uv = np.random.default_rng(3).random((3 * len(t), 2))
    mesh.triangle_uvs = open3d.utility.Vector2dVector(uv)
    out = odt_plugins.optimize(mesh, envelope=1e-2, regions="charts")
    assert np.array_equal(np.asarray(out.vertices), p)
    assert np.array_equal(np.asarray(out.triangle_uvs), uv)


def test_charts_need_a_texture():
    message = "'charts' names no cell array and finds no texture, the"
    with pytest.raises(InvalidOptionError, match=message):
        odt_plugins.optimize(sm.sphere(2), regions="charts")


def test_the_textured_sample_of_meshlab_gets_as_good_as_without_its_texture():
    pymeshlab = pytest.importorskip("pymeshlab")
    path = Path(pymeshlab.__file__).parent / "tests/sample_meshes/bunny10k_textured.obj"
    if not path.exists():
        pytest.skip("pymeshlab came without its sample meshes")
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(path))
    with pytest.warns(DataNotKeptWarning, match="across seams"):
        out, report = odt_plugins.optimize_with_report(meshes, envelope=2e-3)
    assert report.after.n_points == 5051
    assert report.after.mean_quality >= 0.93
    assert report.after.p1_quality >= 0.60
    assert report.after.below_20 <= 20
    size = report.surface["diagonal"]
    assert max(report.surface["forward"], report.surface["backward"]) <= 2e-3 * size
    assert out.current_mesh().has_wedge_tex_coord()
    assert out.current_mesh().texture_number() == 1
