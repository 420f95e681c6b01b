"""Texture coordinates of vertices and of triangles, which move along the surface or in a plane."""

from __future__ import annotations

import warnings
from functools import partial

import contract
import meshio
import numpy as np
import pytest
import pyvista
import trimesh

import odt_plugins

open3d = pytest.importorskip("open3d")


def textured(*, soup):
    """A sphere whose texture coordinates are its x and y, linear on every triangle."""
    ball = open3d.geometry.TriangleMesh.create_sphere(1, 16)
    points, rows = np.asarray(ball.vertices), np.asarray(ball.triangles)
    if soup:
        points, rows = points[rows].reshape(-1, 3), np.arange(rows.size).reshape(-1, 3)
    mesh = open3d.t.geometry.TriangleMesh(points.astype(np.float32), rows.astype(np.int32))
    mesh.vertex["texture_uvs"] = open3d.core.Tensor(points[:, :2].astype(np.float32))
    return mesh


@pytest.mark.parametrize("soup", [False, True])
@pytest.mark.parametrize("run", [
    odt_plugins.optimize,
    lambda mesh: odt_plugins.remesh(mesh, scale=1.5, envelope=0.02),
    lambda mesh: odt_plugins.remesh(mesh, scale=0.7, envelope=0.02)])
def test_they_stay_where_they_were_on_the_surface(run, soup):
    mesh = textured(soup=soup)
    before = mesh.vertex["texture_uvs"].numpy().copy()
    out = run(mesh)
    uv, points = out.vertex["texture_uvs"].numpy(), out.vertex["positions"].numpy()
    assert uv.dtype == np.float32
    np.testing.assert_allclose(uv, points[:, :2], atol=1e-6)
    np.testing.assert_array_equal(mesh.vertex["texture_uvs"].numpy(), before)


@pytest.mark.parametrize("regions", ["auto", "charts"])
@pytest.mark.parametrize("scale", [0.7, 1.3])
@pytest.mark.parametrize("round_", [False, True])
def test_vertices_on_seams_have_the_texture_of_both_charts(round_, scale, regions):
    """Charts are the sides of a box, whose edges are seams, or halves of a ball."""
    box = trimesh.creation.box().subdivide().subdivide()
    made = trimesh.creation.icosphere(3) if round_ else box
    points, cells = np.array(made.vertices), np.array(made.faces)

    def texture(corners):
        centre = corners.mean(axis=1)
        axis = np.full(len(centre), 2) if round_ else np.abs(centre).argmax(axis=1)
        row = np.arange(len(centre))
        chart = 2 * axis + (centre[row, axis] > 0)
        flat = np.stack([corners[row, :, (axis + 1) % 3], corners[row, :, (axis + 2) % 3]], axis=2)
        return flat + 4.0 * chart[:, None, None]

    mesh = open3d.geometry.TriangleMesh(open3d.utility.Vector3dVector(points),
                                     open3d.utility.Vector3iVector(cells))
    mesh.triangle_uvs = open3d.utility.Vector2dVector(texture(points[cells]).reshape(-1, 2))
    across = round_ and regions == "auto"
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        out = odt_plugins.remesh(mesh, scale=scale, regions=regions)
    assert bool(told) == across
    corners = np.asarray(out.vertices)[np.asarray(out.triangles)]
    found = np.asarray(out.triangle_uvs).reshape(-1, 3, 2)
    off = (found - texture(corners)) / 4
    if not across:
        np.testing.assert_allclose(off, np.rint(off) if round_ else 0.0, rtol=0, atol=1e-9)
        assert np.ptp(np.rint(off), axis=1).max() == 0


def in_plane(kind):
    """A jittered square whose texture coordinates are its x and y; how to read these and places."""
    points, cells, _ = contract.grid(2, 10)
    space, uv = contract.in_space(points), points.copy()
    if kind == "trimesh":
        mesh = trimesh.Trimesh(space, cells, process=False)
        mesh.visual = trimesh.visual.TextureVisuals(uv=uv)
        return mesh, lambda out: (out.visual.uv, out.vertices)
    if kind == "open3d":
        mesh = open3d.t.geometry.TriangleMesh(space, cells)
        mesh.vertex["texture_uvs"] = open3d.core.Tensor(uv)
        return mesh, lambda out: (out.vertex["texture_uvs"].numpy(),
                                  out.vertex["positions"].numpy())
    if kind == "meshio":
        mesh = meshio.Mesh(space, [("triangle", cells)], point_data={"TCoords": uv})
        return mesh, lambda out: (out.point_data["TCoords"], out.points)
    mesh = pyvista.PolyData.from_regular_faces(space, cells)
    mesh.active_texture_coordinates = uv
    return mesh, lambda out: (np.array(out.active_texture_coordinates), out.points)


@pytest.mark.parametrize("run", [
    partial(odt_plugins.optimize, fields="interpolate"),
    partial(odt_plugins.optimize, fields="interpolate", boundary="slide"),
    partial(odt_plugins.remesh, scale=1.5), partial(odt_plugins.remesh, scale=0.7)])
@pytest.mark.parametrize("kind", ["trimesh", "open3d", "meshio", "pyvista"])
def test_they_stay_where_they_were_in_the_plane(kind, run):
    mesh, read = in_plane(kind)
    uv, points = read(run(mesh))
    assert len(points) != 121 or np.abs(points - read(mesh)[1]).max() > 0.01
    np.testing.assert_allclose(uv, points[:, :2], atol=1e-9)


@pytest.mark.parametrize("kind", ["trimesh", "open3d", "meshio", "pyvista"])
def test_in_the_plane_they_do_what_fields_do(kind):
    """They stay with their vertices where the toolkit's own filters keep, or the caller says so."""
    mesh, read = in_plane(kind)
    for options in ({}, {"fields": "keep"}):
        uv, points = read(odt_plugins.optimize(mesh, **options))
        where = read(mesh)[1] if options or kind == "open3d" else points
        np.testing.assert_allclose(uv, where[:, :2], atol=1e-9)
