"""Rough surfaces, full of short feature lines: sizes give way to these as far as that pays."""

from __future__ import annotations

import numpy as np
import pytest

import odt_plugins


def rough(n, height, seed):
    """A sphere of marching cubes in noise."""
    pyvista = pytest.importorskip("pyvista")
    x = np.stack(np.meshgrid(*3 * [np.linspace(-1, 1, n)], indexing="ij"))
    noise = np.random.default_rng(seed).normal(size=x.shape[1:])
    grid = pyvista.ImageData(dimensions=(n, n, n), spacing=3 * (2 / (n - 1),))
    grid["f"] = ((x**2).sum(axis=0) - 0.6 + height * noise).ravel(order="F")
    surface = grid.contour([0.0], scalars="f").triangulate().clean().extract_largest()
    return surface.points.astype(np.float64), surface.faces.reshape(-1, 4)[:, 1:]


def test_a_rough_surface_that_is_to_be_coarser_does_not_get_many_times_as_many_triangles():
    points, triangles = rough(18, 0.12, 3)
    _, found = odt_plugins.remesh((points, triangles), scale=2.0)
    assert len(found) < 3 * len(triangles)
