"""Meshes of trimesh."""

from __future__ import annotations

import numpy as np
import pytest
import surface_meshes as sm

import odt_plugins
from odt_plugins.errors import InvalidMeshError, UnsupportedMeshError

trimesh = pytest.importorskip("trimesh")


def ball():
    mesh = trimesh.creation.icosphere(2)
    step = np.random.default_rng(1).normal(size=mesh.vertices.shape)
    mesh.vertices += 0.04 * np.cross(step, mesh.vertices)
    mesh.vertices /= np.linalg.norm(mesh.vertices, axis=1)[:, None]
    return mesh


def test_colours_and_what_is_set_survive_on_a_curved_surface():
    mesh = ball()
    rng = np.random.default_rng(5)
    mesh.visual.vertex_colors = rng.integers(0, 256, (len(mesh.vertices), 4), dtype=np.uint8)
    mesh.density, mesh.center_mass = 3.0, [0.1, 0.2, 0.3]
    mesh.vertex_attributes["heat"] = mesh.vertices[:, 2].copy()
    mesh.face_attributes["odd"] = np.arange(len(mesh.faces) + 1)
    before = mesh.vertices.copy()
    out, report = odt_plugins.optimize_with_report(mesh, envelope=0.02, fields="interpolate")
    assert np.array_equal(mesh.vertices, before)
    assert report.after.mean_quality > report.before.mean_quality
    assert out.is_watertight
    assert (out.density, out.center_mass.tolist()) == (3.0, [0.1, 0.2, 0.3])
    assert out.visual.kind == "vertex"
    colours = np.array(mesh.visual.vertex_colors)
    assert np.array_equal(out.visual.vertex_colors, np.rint(report.transfer(colours * 1.0)))
    kept = odt_plugins.optimize(mesh, envelope=0.02)
    assert (kept.vertices != before).any()
    assert np.array_equal(kept.visual.vertex_colors, colours)
    assert np.array_equal(out.face_attributes["odd"], mesh.face_attributes["odd"])
    assert np.abs(out.vertex_attributes["heat"] - out.vertices[:, 2]).max() < 1e-9
    assert (out.vertex_normals * out.vertices).sum(axis=1).min() > 0.95
    assert (out.face_normals * out.triangles_center).sum(axis=1).min() > 0.9


def test_texture_coordinates_are_interpolated():
    p, t = sm.bowl(15)
    uv = p[:, :2] * [0.25, 0.5] + 0.5
    mesh = trimesh.Trimesh(p, t, process=False, visual=trimesh.visual.TextureVisuals(
        uv=uv, material=trimesh.visual.material.SimpleMaterial(diffuse=[1, 2, 3, 4])))
    out = odt_plugins.optimize(mesh, envelope=0.02)
    moved = (out.vertices != p).any(axis=1)
    assert moved.sum() > 50
    assert np.abs(out.visual.uv - (out.vertices[:, :2] * [0.25, 0.5] + 0.5)).max() < 1e-9
    assert out.visual.material.diffuse.tolist() == [1, 2, 3, 4]
    assert np.array_equal(mesh.visual.uv, uv)


def test_a_class_of_the_users_comes_back_and_normals_that_were_set_do_where_nothing_moved():
    class Mine(trimesh.Trimesh):
        mine = None

    mesh = Mine(*sm.bowl(5), process=False)
    mesh.mine = ["kept"]
    mesh.vertex_normals = np.tile([0.6, 0.0, 0.8], (len(mesh.vertices), 1))
    mesh.face_normals = -mesh.face_normals
    out = odt_plugins.optimize(mesh, fixed=np.ones(len(mesh.vertices), bool),
                               smoothing={"connectivity": "none"}, finish=False)
    assert type(out) is Mine
    assert out.mine == ["kept"]
    assert out.mine is not mesh.mine
    assert np.array_equal(out.vertex_normals, mesh.vertex_normals)
    out.vertices[0] += 1.0
    assert not np.array_equal(out.vertices, mesh.vertices)


def test_what_cannot_be_optimised_is_named():
    with pytest.raises(UnsupportedMeshError, match=r"primitive, Box, .*try mesh\.to_mesh\(\)"):
        odt_plugins.optimize(trimesh.primitives.Box())
    assert odt_plugins.quality(trimesh.primitives.Box().to_mesh()).n_cells == 12
    scene = trimesh.Scene([ball()])
    with pytest.raises(UnsupportedMeshError, match=r"trimesh.*try mesh\.to_mesh\(\)") as caught:
        odt_plugins.quality(scene)
    way = str(caught.value).rpartition("try ")[2]
    assert odt_plugins.quality(eval(way, {"mesh": scene})).n_cells == len(ball().faces)
    mesh = ball()
    mesh.faces[::2] = mesh.faces[::2, ::-1]
    with pytest.raises(InvalidMeshError, match=r"try mesh\.fix_normals\(\)"):
        odt_plugins.optimize(mesh)
    mesh.fix_normals()
    assert odt_plugins.quality(mesh).n_cells == len(mesh.faces)


@pytest.mark.parametrize("verb", ["interpolate", "keep", "remesh"])
def test_colours_beside_the_texture_coordinates_survive(verb):
    p, t = sm.bowl(15)
    mesh = trimesh.Trimesh(p, t, process=False, visual=trimesh.visual.TextureVisuals(uv=p[:, :2]))
    shade = np.rint(np.column_stack([p * 100 + 120, np.full(len(p), 255)])).astype(np.uint8)
    mesh.visual.vertex_attributes["color"] = shade
    mesh.vertex_attributes["color"] = np.arange(len(p))
    out = odt_plugins.remesh(mesh, scale=0.8, envelope=0.02) if verb == "remesh" else (
        odt_plugins.optimize(mesh, envelope=0.02, fields=verb))
    known = np.array(out.visual.vertex_attributes["color"])
    assert (known.dtype, known.shape) == (np.uint8, (len(out.vertices), 4))
    if verb == "keep":
        assert np.array_equal(known, shade)
    else:
        there = np.column_stack([out.vertices * 100 + 120, np.full(len(known), 255)])
        assert np.abs(known - there).max() < 1.1
    assert len(out.vertex_attributes["color"]) == len(out.vertices)
    same = trimesh.Trimesh(p, t, process=False, visual=mesh.visual.copy())
    same.visual.vertex_attributes["color"] = shade
    stays = odt_plugins.optimize(same, selection=[])
    assert np.array_equal(stays.visual.vertex_attributes["color"], shade)


def test_lists_of_several_lengths_stay_with_their_vertices_and_faces():
    mesh = ball()
    mesh.vertex_attributes["joints"] = [list(range(i % 3)) for i in range(len(mesh.vertices))]
    mesh.face_attributes["tags"] = [["a"] * (i % 2) for i in range(len(mesh.faces))]
    out, report = odt_plugins.remesh_with_report(mesh, scale=0.8)
    assert len(out.vertices) > len(mesh.vertices)
    tags = [mesh.face_attributes["tags"][i] for i in report.cell_origin]
    assert list(out.face_attributes["tags"]) == tags
    assert {len(joints) for joints in out.vertex_attributes["joints"]} == {0, 1, 2}


@pytest.mark.parametrize("entry", [
    lambda i: np.arange(i % 3), lambda i: [[1], [1, 2]], lambda i: {"bone": [1, 2]}])
def test_entries_of_any_kind_stay_with_their_vertices(entry):
    mesh = ball()
    values = [entry(i) for i in range(len(mesh.vertices))]
    mesh.vertex_attributes["joints"] = values
    out = odt_plugins.remesh(mesh, scale=0.8)
    got = out.vertex_attributes["joints"]
    assert len(got) == len(out.vertices) > len(values)
    assert {str(one) for one in got} == {str(one) for one in values}
