"""Curvature against spheres, cylinders, tori and saddles; the density made of it."""

from __future__ import annotations

import numpy as np
import pytest
import surface_meshes as sm
from scipy.spatial import ConvexHull

from odt_plugins.engine.ground.reference import make_surface
from odt_plugins.engine.surface.curvature import RATIO, curvature_density, vertex_curvature


def random_sphere(n, radius):
    """A sphere through random points, oriented outwards."""
    x = np.random.default_rng(21).normal(size=(n, 3))
    x /= np.linalg.norm(x, axis=1)[:, None]
    cells = ConvexHull(x).simplices
    a, b, c = (x[cells[:, i]] for i in range(3))
    inwards = (np.cross(b - a, c - a) * a).sum(axis=1) < 0
    cells[inwards] = cells[inwards][:, ::-1]
    return radius * x, cells.astype(np.int32)


def chart(k, form, noise=0.25):
    """A grid, its inner points shaken, bent by form(u, v)."""
    flat, cells = sm.sheet(k)
    u, v = flat[:, 0], flat[:, 1]
    inside = (np.minimum(u, v) > 0) & (np.maximum(u, v) < 1)
    shaken = flat[:, :2] + noise / k * np.random.default_rng(22).normal(size=(len(flat), 2)) / 2
    u, v = np.where(inside[:, None], shaken, flat[:, :2]).T
    return np.stack(form(u, v), axis=1), cells, u, v


def curvature(points, cells):
    return vertex_curvature(points, cells, make_surface(points, cells).neighbors)


@pytest.mark.parametrize("radius", [0.01, 1.0, 300.0])
def test_sphere(radius):
    points, cells = random_sphere(3000, radius)
    relative = curvature(points, cells) * radius / np.sqrt(2)
    assert abs(relative.mean() - 1) < 0.05
    assert relative.std() < 0.05
    points, cells = sm.sphere(4)
    relative = curvature(radius * points, cells) * radius / np.sqrt(2)
    assert abs(relative.mean() - 1) < 0.03


def test_noise_averages_out():
    points, cells = sm.sphere(4, 0.1)
    edge = np.linalg.norm(points[cells[:, 0]] - points[cells[:, 1]], axis=1).mean()
    rough = points + 0.05 * edge * np.random.default_rng(24).normal(size=points.shape)
    relative = curvature(rough, cells) / np.sqrt(2)
    assert abs(relative.mean() - 1) < 0.02
    assert relative.std() < 0.1


def test_one_row_of_triangles_is_known_to_be_curved():
    points, cells, _, _ = chart(12, lambda u, v: (np.cos(2 * u), np.sin(2 * u), 0.1 * v), 0.0)
    row = cells[(points[cells][:, :, 2] < 0.015).all(axis=1)]
    kappa = curvature(points, row)[np.unique(row)]
    assert ((kappa > 0.3) & (kappa < 1.2)).all()


def test_cylinder_and_its_open_ends():
    points, cells, _, _ = chart(
        40, lambda u, v: (2 * np.cos(2 * u), 2 * np.sin(2 * u), 3 * v)
    )
    kappa = curvature(points, cells)
    assert abs(kappa.mean() * 2 - 1) < 0.02
    assert np.abs(kappa * 2 - 1).max() < 0.25


def test_torus_and_saddle_vary_as_they_should():
    points, cells, _, v = chart(
        60,
        lambda u, v: (
            (2 + np.cos(6 * v)) * np.cos(3 * u), (2 + np.cos(6 * v)) * np.sin(3 * u), np.sin(6 * v)
        ),
    )
    exact = np.hypot(1.0, np.cos(6 * v) / (2 + np.cos(6 * v)))
    relative = curvature(points, cells) / exact
    assert abs(relative.mean() - 1) < 0.05
    assert relative.std() < 0.06
    points, cells, u, v = chart(60, lambda u, v: (u, v, (u - 0.5) ** 2 - (v - 0.5) ** 2))
    middle = np.hypot(u - 0.5, v - 0.5) < 0.05
    np.testing.assert_allclose(curvature(points, cells)[middle], np.sqrt(8), rtol=0.1)


def test_plane_is_flat_and_gets_an_even_density():
    points, cells, _, _ = chart(9, lambda u, v: (u, v, 2 * u - v))
    np.testing.assert_allclose(curvature(points, cells), 0.0, atol=1e-10)
    neighbors = make_surface(points, cells).neighbors
    np.testing.assert_allclose(curvature_density(points, cells, neighbors), 1.0, rtol=1e-12)


def test_turning_scaling_and_reversing_change_nothing():
    points, cells = sm.sphere(3)
    points = points * [1.0, 0.6, 0.3]
    neighbors = make_surface(points, cells).neighbors
    rho = curvature_density(points, cells, neighbors)
    assert rho.max() > 3 * rho.min()
    turn = np.linalg.qr(np.random.default_rng(23).normal(size=(3, 3)))[0]
    moved = 50.0 * points @ turn.T + [3.0, 4.0, 5.0]
    np.testing.assert_allclose(curvature_density(moved, cells, neighbors), rho, rtol=1e-9)
    other = np.ascontiguousarray(cells[:, ::-1])
    other_neighbors = np.ascontiguousarray(neighbors[:, ::-1])
    np.testing.assert_allclose(curvature_density(points, other, other_neighbors), rho, rtol=1e-9)


def test_density_is_bounded_and_stops_at_features_and_bears_flat_triangles():
    points, cells = sm.sphere(4)
    thin = points * [1.0, 1.0, 0.02]
    neighbors = make_surface(thin, cells).neighbors
    h = curvature_density(thin, cells, neighbors) ** -0.25
    assert h.mean() == pytest.approx(1.0)
    assert 1.5 < h.max() / h.min() <= RATIO
    box = sm.sheet(6)[0]
    box[:, 2] = np.maximum(box[:, 0] - 0.5, 0.0) * 3
    cells = sm.sheet(6)[1]
    bent = make_surface(box, cells).neighbors
    ridge = box[cells][:, :, 0].mean(axis=1) < 0.5
    across = np.where(bent >= 0, ridge[np.maximum(bent, 0)] != ridge[:, None], False)
    assert curvature_density(box, cells, bent).std() > 0.1
    cut = np.where(across, -1, bent)
    np.testing.assert_allclose(curvature_density(box, cells, cut), 1.0, rtol=1e-12)
    flat = np.concatenate([cells, [[0, 0, 1], [0, 1, 2]]]).astype(np.int32)
    assert np.isfinite(curvature_density(box, flat, make_surface(box, flat).neighbors)).all()


def test_vertices_of_no_triangle_and_no_triangles():
    points, cells = sm.sphere(1)
    more = np.concatenate([points, [[1e9, 0, 0]]])
    neighbors = make_surface(points, cells).neighbors
    rho = curvature_density(points, cells, neighbors)
    with_more = curvature_density(more, cells, neighbors)
    np.testing.assert_array_equal(with_more[:-1], rho)
    assert np.isfinite(with_more[-1])
    none = np.empty((0, 3), dtype=np.int32)
    np.testing.assert_array_equal(curvature_density(points, none, none), 1.0)
