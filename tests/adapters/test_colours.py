"""Colours of bytes follow places as those of floating-point numbers do."""

from __future__ import annotations

import warnings

import boxes
import meshio
import numpy as np
import open3d
import pymeshlab
import pytest
import pyvista
import surface_meshes
import trimesh

import odt_plugins
from odt_plugins.adapters.colours import is_colour, is_paint
from odt_plugins.adapters.fields import dense, field_names
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.errors import DataNotKeptWarning, InvalidOptionError

SIZE = {"size": 0.31, "envelope": 0.05}


@pytest.fixture(scope="module")
def ball():
    points, cells = surface_meshes.sphere(3, 0.1)
    return points, cells.astype(np.int64)


def shades(points):
    return np.pad(0.5 + 0.4 * np.asarray(points, dtype=np.float64)[:, :3], ((0, 0), (0, 1)),
                  constant_values=0.8)


def in_bytes(points):
    return np.rint(255 * shades(points)).astype(np.uint8)


def off_by(points, colours):
    """Largest difference, in bytes, from the colours that belong to the places."""
    colours = np.asarray(colours)
    assert len(colours) == len(points)
    assert colours.dtype == np.uint8
    return np.abs(colours - 255 * shades(points)[:, : colours.shape[1]]).max()


def channels(points):
    return dict(zip(("red", "green", "blue", "alpha"), in_bytes(points).T, strict=True))


def with_colours(kind, points, cells):
    colours = in_bytes(points)
    if kind == "trimesh":
        return trimesh.Trimesh(points, cells, vertex_colors=colours, process=False,
                               vertex_attributes={"rgb": colours[:, :3]})
    if kind == "pyvista":
        mesh = pyvista.PolyData.from_regular_faces(points, cells)
        mesh["RGB"] = colours[:, :3]
        return mesh
    if kind == "meshio":
        return meshio.Mesh(points, [("triangle", cells)], point_data=channels(points))
    if kind == "open3d":
        mesh = open3d.t.geometry.TriangleMesh(*map(open3d.core.Tensor, (points, cells)))
        mesh.vertex["colors"] = open3d.core.Tensor(np.ascontiguousarray(colours[:, :3]))
        return mesh
    return pymeshlab.Mesh(points, cells, v_color_matrix=(colours + 0.5) / 255.5)


def found(kind, mesh):
    """Places and all colours of a mesh."""
    if kind == "trimesh":
        return mesh.vertices, [mesh.visual.vertex_colors, mesh.vertex_attributes["rgb"]]
    if kind == "pyvista":
        return mesh.points, [mesh["RGB"]]
    if kind == "meshio":
        return mesh.points, [np.stack([mesh.point_data[name] for name in channels(mesh.points)], 1)]
    if kind == "open3d":
        return mesh.vertex["positions"].numpy(), [mesh.vertex["colors"].numpy()]
    return mesh.vertex_matrix(), [np.rint(255 * mesh.vertex_color_matrix()).astype(np.uint8)]


@pytest.mark.parametrize("kind", ["trimesh", "pyvista", "meshio", "open3d", "pymeshlab"])
def test_new_and_moved_vertices_have_the_colours_of_their_places(ball, kind):
    mesh = with_colours(kind, *ball)
    for out in (odt_plugins.remesh(mesh, **SIZE),
                odt_plugins.optimize(mesh, fields="interpolate")):
        points, colours = found(kind, out)
        assert (np.shape(points) != ball[0].shape) or (points != ball[0]).any()
        for one in colours:
            assert off_by(points, one) < 2.0
    points, colours = found(kind, odt_plugins.optimize(mesh, fields="keep"))
    for one in colours:
        assert np.array_equal(one, in_bytes(ball[0])[:, : one.shape[1]])


def test_report_names_colours_that_were_interpolated(ball):
    for kind, names in (("trimesh", {"vertex_colors", "rgb"}), ("pymeshlab", {"vertex color"})):
        report = odt_plugins.remesh_with_report(with_colours(kind, *ball), **SIZE)[1]
        assert set(report.interpolated) == names
    plain = pymeshlab.Mesh(*ball)
    assert odt_plugins.remesh_with_report(plain, **SIZE)[1].interpolated == ()


@pytest.mark.parametrize("fields", ["interpolate", "conserve"])
def test_colours_are_no_densities(fields):
    points, cells = boxes.box(3, 4)
    mesh = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: cells}, points)
    mesh["RGB"], mesh["T"] = in_bytes(points)[:, :3], points[:, 0].copy()
    mesh.cell_data["paint"] = np.tile(np.uint8([200, 100, 50]), (len(cells), 1))
    out, report = odt_plugins.remesh_with_report(mesh, scale=0.8, fields=fields)
    assert off_by(out.points, out["RGB"]) < 2.0
    assert (out.cell_data["paint"] == [200, 100, 50]).all()
    assert set(report.interpolated) == {"RGB", "T"}
    with pytest.raises(InvalidOptionError, match="RGB"):
        odt_plugins.optimize(mesh, metric="RGB")


def test_own_arrays_of_colours_are_carried_alike(ball):
    out, report = odt_plugins.remesh_with_report(ball, **SIZE)
    assert off_by(out[0], report.transfer(in_bytes(ball[0]))) < 2.0
    number = np.arange(len(ball[0])) % 256
    assert set(report.transfer(number.astype(np.uint8))) <= set(number)


def test_mid_nodes_have_the_colours_of_their_places():
    places, wide = boxes.quadratic(*boxes.box(3, 3))
    grid = pyvista.UnstructuredGrid({pyvista.CellType.QUADRATIC_TETRA: wide}, places)
    grid["RGB"] = in_bytes(places)[:, :3]
    out = odt_plugins.optimize(grid)
    assert len(out.points) != len(places)
    assert off_by(out.points, out["RGB"]) < 2.5


@pytest.mark.parametrize("run", ["optimize", "remesh"])
@pytest.mark.parametrize("suffix", ["ply", "obj", "off"])
def test_files_of_colours(ball, tmp_path, suffix, run):
    points, cells = ball
    source, target = tmp_path / f"a.{suffix}", tmp_path / f"b.{suffix}"
    if suffix == "off":
        rows = [f"{x!r} {y!r} {z!r} {r} {g} {b} {a}" for (x, y, z), (r, g, b, a) in
                zip(points.tolist(), in_bytes(points).tolist(), strict=True)]
        rows += ["3 {} {} {}".format(*row) for row in cells.tolist()]
        source.write_text("\n".join([f"COFF\n{len(points)} {len(cells)} 0", *rows]) + "\n")
    else:
        with_colours("trimesh", points, cells).export(source)
    given = {"remesh": SIZE, "optimize": {"fields": "interpolate"}}[run]
    mesh = getattr(odt_plugins, run)(read_file(source), **given)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DataNotKeptWarning)
        write_file(target, mesh)
    back = pymeshlab.MeshSet()
    back.load_new_mesh(str(target))
    places = back.current_mesh().vertex_matrix()
    assert len(places) == len(mesh.points)
    colours = back.current_mesh().vertex_color_matrix()
    assert np.abs(colours - shades(places))[:, :3].max() < 0.012
    assert (np.abs(colours[:, 3] - 0.8) < 0.004).all() or suffix == "obj"


def test_what_is_a_colour():
    byte, wide = np.zeros((5, 3), dtype=np.uint8), np.zeros((5, 3), dtype=np.int64)
    assert is_colour("any", byte)
    assert is_colour("any", np.zeros((5, 4), dtype=np.uint8))
    assert is_colour("Red", byte[:, 0])
    assert not is_colour("mark", byte[:, 0])
    assert not is_colour("any", byte[:, :2])
    assert not is_colour("RGB", wide)
    assert not is_colour("red", wide[:, 0])
    assert is_colour("red", wide[:, 0].astype(np.uint16))
    assert not is_colour("mark", wide[:, 0].astype(np.uint16))
    assert not is_colour("RGB", wide.astype(np.uint16))
    assert field_names({"RGB": byte, "vtkGhostType": byte, "label": byte[:, 0]}) == ("RGB",)
    assert dense({"RGB": byte, "red": byte[:, 0], "T": byte[:, 0] * 1.0}).keys() == {"T"}


def test_colours_of_open3d_stay_colours_where_integrals_are_kept():
    mesh = open3d.geometry.TriangleMesh.create_sphere(1.0, 20)
    mesh.vertex_colors = open3d.utility.Vector3dVector(
        (np.asarray(mesh.vertices) > 0).astype(np.float64))
    result = odt_plugins.remesh(mesh, 0.25, envelope=1e-2, fields="conserve")
    colours = np.asarray(result.vertex_colors)
    assert [colours.min(), colours.max()] == [0.0, 1.0]
    assert is_paint("triangle.colors", colours)
    assert not is_paint("velocity", colours)
    assert not is_paint("colour", colours[:, 0])


@pytest.mark.parametrize("scale", [None, 0.7])
def test_colours_of_bytes_behind_normals_of_off_stay_bytes(ball, scale, tmp_path):
    points, cells = ball
    lines = ["CNOFF", f"{len(points)} {len(cells)} 0"]
    lines += [" ".join(map(str, [*p, *n, *c])) for p, n, c in zip(
        points.tolist(), points.tolist(), in_bytes(points).tolist(), strict=True)]
    lines += ["3 {} {} {}".format(*c) for c in cells.tolist()]
    (tmp_path / "a.off").write_text("\n".join(lines) + "\n")
    mesh = read_file(tmp_path / "a.off")
    assert off_by(mesh.points, mesh.point_data["off:colour"]) <= 0.5
    made = odt_plugins.optimize(mesh) if scale is None else odt_plugins.remesh(mesh, scale=scale)
    write_file(tmp_path / "b.off", made)
    back = read_file(tmp_path / "b.off")
    assert back.point_data["off:colour"].dtype == np.uint8
    words = (tmp_path / "b.off").read_text().split("\n")[2].split()
    assert {*words[6:]} <= {*map(str, range(256))}
    if scale is not None:
        assert off_by(back.points, back.point_data["off:colour"]) <= 1
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(tmp_path / "b.off"))
    assert meshes.current_mesh().vertex_number() == len(back.points)


@pytest.mark.parametrize("scale", [None, 0.7])
@pytest.mark.parametrize("head", ["STCNOFF", "STCOFF", "STOFF"])
def test_texture_of_off_is_no_colour(ball, head, scale, tmp_path):
    points, cells = ball
    inside = [points] * ("N" in head) + [in_bytes(points)] * ("C" in head)
    parts = [points, *inside, 0.5 * points[:, :2]]
    lines = [head, f"{len(points)} {len(cells)} 0"]
    lines += [" ".join(str(x) for part in parts for x in part[i].tolist())
              for i in range(len(points))]
    lines += ["3 {} {} {}".format(*c) for c in cells.tolist()]
    (tmp_path / "a.off").write_text("\n".join(lines) + "\n")
    mesh = read_file(tmp_path / "a.off")
    made = odt_plugins.optimize(mesh) if scale is None else odt_plugins.remesh(mesh, scale=scale)
    write_file(tmp_path / "b.off", made)
    other = meshio.Mesh(made.points, made.cells, {
        key: made.point_data[key] for key in made.point_data if key.startswith("off:")})
    write_file(tmp_path / "c.off", other)
    for name in "bc":
        text = (tmp_path / f"{name}.off").read_text()
        assert text.startswith(head if name == "b" else head.replace("N", ""))
        back = read_file(tmp_path / f"{name}.off")
        assert np.array_equal(back.point_data["off:texture"], made.point_data["off:texture"])
        assert ("off:colour" in back.point_data) == ("C" in head)
        if "C" in head:
            assert back.point_data["off:colour"].dtype == np.uint8
