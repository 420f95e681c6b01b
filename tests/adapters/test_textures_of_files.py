"""Texture coordinates of vertices in files, which stay where they were on a curved surface."""

from __future__ import annotations

import meshio
import numpy as np
import pytest
from scipy.spatial import Delaunay

import odt_plugins
from odt_plugins.adapters.files import read_file, write_file
from odt_plugins.api import optimize_file

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
