"""Texture coordinates of the vertices of open3d's tensor meshes, which move along the surface."""

from __future__ import annotations

import numpy as np
import pytest

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
