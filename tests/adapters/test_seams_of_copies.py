"""Seams of a texture along which vertices are doubled, as readers of OBJ files make them."""

from __future__ import annotations

from itertools import product

import numpy as np
import pymeshlab
import pytest
import pyvista
import trimesh

import odt_plugins

open3d = pytest.importorskip("open3d")


def around(radius, n=32, m=12):
    """A surface around the axis with the profile: places, triangles, coordinates of vertices."""
    i, j = np.meshgrid(np.arange(n + 1), np.arange(m + 1), indexing="ij")
    turn, r, z = 2 * np.pi * (i % n) / n, *radius(j / m)
    points = np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=-1).reshape(-1, 3)
    at = np.arange(i.size).reshape(i.shape)
    a, b, c, d = (at[p, q].ravel() for p, q in (
        (slice(-1), slice(-1)), (slice(1, None), slice(-1)), (slice(1, None), slice(1, None)),
        (slice(-1), slice(1, None))))
    cells = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return points, cells, np.stack([i / n, j / m], axis=-1).reshape(-1, 2)


SURFACES = {
    "sphere": lambda v: (np.sin(np.pi * (0.05 + 0.9 * v)), -np.cos(np.pi * (0.05 + 0.9 * v))),
    "tube": lambda v: (1.0 + 0.0 * v, 2 * v),
    "cone": lambda v: (1.1 - v, 2 * v),
}


def pairs(*lists):
    """Every other combination, so that any two values of two lists meet."""
    return [chosen for chosen in product(*lists)
            if sum(map(list.index, lists, chosen)) % 2 == 0]


def made(kind, points, cells, uv):
    """A mesh of a toolkit, and how to read coordinates and places of the corners of triangles."""
    if kind == "open3d":
        mesh = open3d.geometry.TriangleMesh(open3d.utility.Vector3dVector(points),
                                            open3d.utility.Vector3iVector(cells))
        mesh.triangle_uvs = open3d.utility.Vector2dVector(uv[cells].reshape(-1, 2))
        return mesh, lambda out: (np.asarray(out.triangle_uvs).reshape(-1, 3, 2),
                                  np.asarray(out.vertices)[np.asarray(out.triangles)])
    if kind == "tensor":
        mesh = open3d.t.geometry.TriangleMesh(points.astype(np.float32), cells.astype(np.int32))
        mesh.vertex["texture_uvs"] = open3d.core.Tensor(uv)
        return mesh, lambda out: (x[out.triangle.indices.numpy()] for x in (
            out.vertex["texture_uvs"].numpy(), out.vertex.positions.numpy()))
    if kind == "trimesh":
        mesh = trimesh.Trimesh(points, cells, process=False)
        mesh.visual = trimesh.visual.TextureVisuals(uv=uv)
        return mesh, lambda out: (out.visual.uv[out.faces], out.vertices[out.faces])
    if kind == "pyvista":
        mesh = pyvista.PolyData.from_regular_faces(points, cells)
        mesh.active_texture_coordinates = uv
        return mesh, lambda out: (np.array(out.active_texture_coordinates)[out.regular_faces],
                                  out.points[out.regular_faces])
    mesh = pymeshlab.Mesh(points, cells, w_tex_coords_matrix=uv[cells].reshape(-1, 2))
    return mesh, lambda out: (out.wedge_tex_coord_matrix().reshape(-1, 3, 2),
                              out.vertex_matrix()[out.face_matrix()])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("kind", "surface", "scale"), pairs(
    ["open3d", "tensor", "trimesh", "pyvista", "pymeshlab"], [*SURFACES], [0.8, 1.5]))
def test_triangles_on_both_sides_keep_their_own(kind, surface, scale):
    points, cells, uv = around(SURFACES[surface])
    mesh, read = made(kind, points, cells, uv)
    found, places = read(odt_plugins.remesh(mesh, scale=scale))
    assert len(found) != len(cells)
    assert np.ptp(found, axis=1).max() < 0.4
    off = found[..., 0] - np.arctan2(places[..., 1], places[..., 0]) / (2 * np.pi)
    assert np.abs(off - np.round(off)).max() < 0.01


@pytest.mark.parametrize("kind", ["open3d", "pyvista"])
@pytest.mark.parametrize("surface", ["sphere", "cone"])
@pytest.mark.parametrize("scale", [0.8, 1.5])
def test_fields_of_vertices_do_not_mix_across_the_seam(kind, surface, scale):
    points, cells, uv = around(SURFACES[surface])
    mesh, _ = made(kind, points, cells, uv)
    if kind == "open3d":
        mesh.vertex_colors = open3d.utility.Vector3dVector(uv[:, [0, 1, 1]])
    else:
        mesh.point_data["turn"] = uv[:, 0]
    out = odt_plugins.remesh(mesh, scale=scale)
    found = (np.asarray(out.vertex_colors)[np.asarray(out.triangles), 0] if kind == "open3d"
             else out.point_data["turn"][out.regular_faces])
    assert np.ptp(found, axis=1).max() < 0.4


@pytest.mark.parametrize(("kind", "surface", "scale"), pairs(
    ["tensor", "trimesh", "pyvista"], ["sphere", "cone"], [None, 0.8, 1.5]))
def test_soups_keep_all_coordinates_of_one_place(kind, surface, scale):
    """As pyvista reads OBJ files: every triangle has vertices of its own."""
    points, cells, uv = around(SURFACES[surface])
    rows = np.arange(cells.size).reshape(-1, 3)
    mesh, read = made(kind, points[cells].reshape(-1, 3), rows, uv[cells].reshape(-1, 2))
    out = odt_plugins.remesh(mesh, scale=scale) if scale else odt_plugins.optimize(mesh)
    found, places = read(out)
    assert np.ptp(found, axis=1).max() < 0.4
    off = found[..., 0] - np.arctan2(places[..., 1], places[..., 0]) / (2 * np.pi)
    assert np.abs(off - np.round(off)).max() < 0.01
    assert np.isin([0.0, 1.0], found[..., 0].astype(np.float32)).all()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("kind", "scale"), pairs(["open3d", "trimesh", "pyvista"], [0.8, 1.4]))
def test_patches_with_zigzag_rims_do_not_mix(kind, scale):
    """Each patch is in a square of the texture of its own, as tools that unwrap surfaces lay it."""
    ball = trimesh.creation.icosphere(4)
    places = ball.vertices * (1.0 + 0.1 * np.sin(5.0 * ball.vertices[:, [0]]))
    cells = np.asarray(ball.faces)
    middle = ball.triangles_center
    of = np.abs(middle + 0.3 * np.sin(40.0 * middle[:, [1, 2, 0]])).argmax(axis=1)
    corner = places[cells] / 2.6 + 0.5
    uv = np.where(of[:, None, None] == 0, corner[..., 1:], corner[..., [0, 2]])
    uv[of == 2] = corner[of == 2][..., :2]
    uv = (uv + of[:, None, None] * [1.0, 0.0]) * [0.3, 1.0]
    rows, number = np.unique(
        np.concatenate([places[cells], uv], axis=2).reshape(-1, 5), axis=0, return_inverse=True)
    mesh, read = made(kind, rows[:, :3].copy(), number.reshape(-1, 3).astype(cells.dtype),
                      rows[:, 3:].copy())
    found, _ = read(odt_plugins.remesh(mesh, scale=scale, envelope=0.01))
    square = found[..., 0] // 0.3
    assert len(found) != len(cells)
    assert (square == square[:, :1]).all()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("kind", "scale"), pairs(["tensor", "trimesh", "pyvista"], [0.7, 1.5]))
def test_soups_keep_patches_of_one_triangle(kind, scale):
    """Every triangle has a place of its own in the texture, as trivial parametrisations lay it."""
    ball = trimesh.creation.icosphere(2)
    n = len(ball.faces)
    at = np.stack([np.arange(n) % 20, np.arange(n) // 20], axis=1)[:, None]
    uv = (at + np.array([[0.1, 0.1], [0.9, 0.1], [0.1, 0.8]])) / 20
    rows = np.arange(3 * n).reshape(-1, 3)
    mesh, read = made(kind, ball.triangles.reshape(-1, 3).copy(), rows, uv.reshape(-1, 2))
    out, report = odt_plugins.remesh_with_report(mesh, scale=scale, envelope=0.01)
    found, _ = read(out)
    assert (found * 20 // 1 == found[:, :1] * 20 // 1).all()
    assert len(found) > n if scale < 1 else len(found) == n
    assert not any(note.startswith("0 of") for note in report.notes)


def test_coordinates_too_large_for_their_squares_follow_without_a_word():
    points, cells, uv = around(SURFACES["cone"])
    points[:, 2] += 0.05 * np.sin(9 * points[:, 0])
    mesh = open3d.t.geometry.TriangleMesh(points.astype(np.float32), cells.astype(np.int32))
    mesh.triangle["texture_uvs"] = open3d.core.Tensor(np.float32(1e30 * uv[cells]))
    out = odt_plugins.optimize(mesh, envelope=0.01)
    assert np.ptp(out.triangle["texture_uvs"].numpy(), axis=1).max() < 0.5e30
