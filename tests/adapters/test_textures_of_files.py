"""Texture coordinates of vertices in files, which stay where they were on a curved surface."""

from __future__ import annotations

from functools import partial

import meshio
import numpy as np
import pytest
import surface_meshes
from scipy.spatial import Delaunay

import odt_plugins
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file
from odt_plugins.errors import DataNotKeptWarning

NAMES = [("off:texture",), ("Texture Coordinates",), ("TCoords",), ("s", "t"),
         ("texture_u", "texture_v"), ("u", "v")]


def sheet(names):
    """A bent sheet whose texture coordinates are x and y, and another array that stays."""
    flat = np.random.default_rng(2).random((300, 2))
    points = np.c_[flat, 0.2 * np.sin(3 * flat[:, 0]) * np.cos(2 * flat[:, 1])]
    data = {names[0]: flat} if len(names) == 1 else dict(zip(names, flat.T.copy(), strict=True))
    return meshio.Mesh(points, [("triangle", Delaunay(flat).simplices)],
                       data | {"own": flat[:, 0].copy()})


def texture_of(mesh, names):
    return np.column_stack([mesh.point_data[name] for name in names])[:, :2]


@pytest.mark.parametrize("names", NAMES)
@pytest.mark.parametrize("regions", ["auto", "charts"])
def test_they_follow_the_surface(regions, names):
    mesh = sheet(names)
    better = odt_plugins.optimize(mesh, keep=(), regions=regions)
    assert np.abs(better.points - mesh.points).max() > 0.01
    np.testing.assert_allclose(texture_of(better, names), better.points[:, :2], atol=1e-12)
    assert np.array_equal(better.point_data["own"], mesh.point_data["own"])
    finer = odt_plugins.remesh(mesh, scale=0.8, regions=regions)
    np.testing.assert_allclose(texture_of(finer, names), finer.points[:, :2], atol=1e-12)


def test_components_of_a_vector_are_none():
    mesh = sheet(("u", "v"))
    mesh.point_data["w"] = mesh.points[:, 2].copy()
    better = odt_plugins.optimize(mesh, keep=())
    assert all(np.array_equal(better.point_data[name], mesh.point_data[name]) for name in "uvw")


@pytest.mark.parametrize("fields", ["auto", "keep"])
@pytest.mark.parametrize("value", [-2.0, np.nan])
def test_velocities_in_the_surface_are_none(value, fields):
    mesh = sheet(("u", "v"))
    mesh.point_data["u"][mesh.points[:, 0] > 0.5] = value
    better = odt_plugins.optimize(mesh, keep=(), fields=fields)
    assert not np.array_equal(better.points, mesh.points)
    for name in "uv":
        np.testing.assert_array_equal(better.point_data[name], mesh.point_data[name])


@pytest.mark.parametrize(("suffix", "names"), [(".off", NAMES[0]), (".ply", NAMES[3]),
                                               (".vtp", NAMES[1]), (".vtu", NAMES[2])])
def test_they_follow_the_surface_in_files(suffix, names, tmp_path):
    if suffix == ".vtp":
        pytest.importorskip("pyvista")
    mesh, source, target = sheet(names), tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    if suffix == ".off":
        del mesh.point_data["own"]
    write_file(source, mesh)
    optimize_file(source, target, keep=())
    before, back = read_file(source), read_file(target)
    assert np.abs(back.points - before.points).max() > 0.01
    np.testing.assert_allclose(texture_of(back, names), back.points[:, :2], atol=1e-6)


def tube(path, n=24, rows=6):
    """Write a tube whose texture goes once around, with one seam, as OBJ."""
    turn = np.linspace(0.0, 1.0, n + 1)
    u, z = (part.ravel() for part in np.meshgrid(turn, np.linspace(0, 1, rows + 1)))
    number = np.arange((n + 1) * (rows + 1)).reshape(rows + 1, n + 1)
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:],
                                            number[1:, :-1]))
    place = np.unique(np.stack([np.round(z * rows), np.round(u * n) % n], axis=1), axis=0,
                      return_index=True, return_inverse=True)
    x = np.stack([np.cos(2 * np.pi * u), np.sin(2 * np.pi * u), z], axis=1)[place[1]]
    lines = ["v {} {} {}".format(*row) for row in x.tolist()]
    lines += [f"vt {s} {t}" for s, t in zip(u.tolist(), z.tolist(), strict=True)]
    for tri in np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]):
        lines.append("f " + " ".join(f"{place[2].ravel()[i] + 1}/{i + 1}" for i in tri.tolist()))
    path.write_text("\n".join(lines) + "\n")


def wedges(path):
    """Places (m, 3, 3) and texture coordinates (m, 3, 2) of the corners in an OBJ file."""
    rows = [line.split() for line in path.read_text().splitlines()]
    x, uv = (np.array([row[1:] for row in rows if row[0] == head], dtype=float)
             for head in ("v", "vt"))
    at = np.array([[word.split("/")[:2] for word in row[1:]] for row in rows if row[0] == "f"])
    return x[at[..., 0].astype(int) - 1], uv[at[..., 1].astype(int) - 1]


def around(path, how):
    """Wedges of a tube in an OBJ file after `remesh`, or `optimize` where sizes stay."""
    source, target = path / "a.obj", path / "b.obj"
    tube(source)
    run = odt_plugins.remesh if "scale" in how else odt_plugins.optimize
    write_file(target, run(read_file(source), envelope=0.02, **how))
    return wedges(target)


@pytest.mark.filterwarnings("ignore:.*across seams")
@pytest.mark.parametrize("how", [{}, {"scale": 0.7}, {"scale": 1.4}])
def test_a_texture_that_goes_around_goes_on_across_its_seam(how, tmp_path):
    """A vertex of the seam has two coordinates in one chart; one of them is far off."""
    x, uv = around(tmp_path, how)
    assert np.ptp(uv[..., 0], axis=1).max() < 0.3
    error = uv[..., 0] - np.arctan2(x[..., 1], x[..., 0]) / (2 * np.pi)
    assert np.abs(error - np.round(error)).max() < 0.01
    assert np.abs(uv[..., 1] - x[..., 2]).max() < 0.01


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("how", [{}, {"scale": 0.7}, {"scale": 1.4}])
def test_seams_of_the_texture_of_an_obj_file_stay_where_charts_are_regions(how, tmp_path):
    x, uv = around(tmp_path, {"regions": "charts", **how})
    seam = np.abs(x - [1, 0, 0])[..., :2].max(axis=2) < 1e-9
    assert (np.abs(uv[..., 0] - 0.5)[seam] == 0.5).all()
    assert np.abs(uv[..., 0] - 0.5).max() == 0.5
    assert np.ptp(uv[..., 0], axis=1).max() < 0.3


@pytest.mark.parametrize("how", [odt_plugins.optimize, partial(odt_plugins.remesh, scale=0.8)])
def test_materials_and_pictures_are_copied_beside_another_place(how, tmp_path):
    points, cells = surface_meshes.sphere(1)
    inside, out = tmp_path / "in", tmp_path / "out"
    (inside / "sub").mkdir(parents=True)
    out.mkdir()
    for name, text in (
            ("two words.mtl", "newmtl a\nmap_Kd -s 1 1 1 a b.png\nmap_Bump sub/c.png\n"),
            ("b.mtl", "new"), ("a b.png", "picture"), ("sub/c.png", "other"), ("d.png", "third")):
        (inside / name).write_text(text)
    (out / "b.mtl").write_text("own")
    lines = ["v {!r} {!r} {!r}".format(*p) for p in points.tolist()]
    lines += ["f {} {} {}".format(*(row + 1)) for row in cells]
    lines = ["mtllib two words.mtl", "mtllib b.mtl", *lines, ""]
    (inside / "m.obj").write_text("\n".join(lines))
    mesh = read_file(inside / "m.obj")
    with pytest.warns(DataNotKeptWarning, match="sub/c.png is not copied beside the result"):
        write_file(out / "m.obj", how(mesh))
    assert {p.name for p in out.iterdir()} == {"m.obj", "two words.mtl", "b.mtl", "a b.png"}
    assert [(out / name).read_text() for name in ("b.mtl", "a b.png")] == ["own", "picture"]
    ply = ["ply", "format ascii 1.0", "comment TextureFile d.png", f"element vertex {len(points)}",
           *(f"property double {x}" for x in "xyz"), f"element face {len(cells)}",
           "property list uchar int vertex_indices", "end_header",
           *("{!r} {!r} {!r}".format(*p) for p in points.tolist()),
           *("3 {} {} {}".format(*row) for row in cells.tolist())]
    (inside / "m.ply").write_text("\n".join(ply) + "\n")
    write_file(out / "m.ply", how(read_file(inside / "m.ply")))
    assert (out / "d.png").read_text() == "third"
    kept = {p: p.stat().st_mtime_ns for p in inside.iterdir() if p.is_file()}
    write_file(inside / "n.obj", how(mesh))
    assert {p: p.stat().st_mtime_ns for p in kept} == kept
