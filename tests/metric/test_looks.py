"""Which meshes look stretched on purpose."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np
import pytest
import surface_meshes as sm
from strategies import jittered, lattice, random_delaunay

import odt_plugins
from odt_plugins.mesh.simplex import simplex_mesh
from odt_plugins.mesh.surface import surface_mesh
from odt_plugins.metric.looks import looks_anisotropic

DATA = Path(__file__).parents[1] / "data"


def plain(d):
    return {"jittered": jittered(d, 12 if d == 2 else 6, 0),
            "lattice": lattice(d, 12 if d == 2 else 6),
            "random": random_delaunay(d, 150 if d == 2 else 120, 0)}


@pytest.mark.parametrize("kind", ["jittered", "lattice", "random"])
def test_isotropic_and_random_meshes_do_not(d, kind):
    assert not looks_anisotropic(simplex_mesh(*plain(d)[kind])[0])
    points, cells = plain(d)[kind]
    if kind != "random":
        # finer towards the origin
        away = points + 0.2
        graded = away * np.sqrt(np.linalg.norm(away, axis=1))[:, None]
        assert not looks_anisotropic(simplex_mesh(graded, cells)[0])


@pytest.mark.parametrize("kind", ["jittered", "lattice", "random"])
@pytest.mark.parametrize("stretch", [6.0, 100.0])
def test_stretched_ones_do_in_any_direction(d, kind, stretch):
    points, cells = plain(d)[kind]
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(d, d)))[0]
    scale = np.array([1.0] * (d - 1) + [1.0 / stretch])
    assert looks_anisotropic(simplex_mesh(points * scale @ turn.T, cells)[0])


def test_layers_that_grow_from_a_wall_do(d):
    points, cells = jittered(d, 16 if d == 2 else 8, 0, jitter=0.1)
    points = points.copy()
    points[:, -1] = 0.02 * (np.exp(2.0 * points[:, -1]) - 1.0)
    assert looks_anisotropic(simplex_mesh(points, cells)[0])


@pytest.mark.parametrize("name", [
    "bone05", "tetwild_airplane", "tetwild_bunny", "tetwild_csg", "tetwild_cube"])
def test_meshes_from_practice_do_not(name):
    mesh = meshio.read(DATA / f"{name}.vtu")
    assert not looks_anisotropic(simplex_mesh(mesh.points, mesh.cells_dict["tetra"])[0])


def test_nothing_is_said_of_surfaces():
    points, cells = sm.sphere(2)
    assert not looks_anisotropic(surface_mesh(points * np.array([1.0, 1.0, 20.0]), cells))


@pytest.mark.parametrize("free", [(), "layers"])
def test_the_report_of_a_stretched_mesh_names_its_metric(free):
    points, cells = jittered(2, 10, 0)
    for stretch, said in ((1.0, 0), (10.0, 1)):
        mesh = points * np.array([1.0, 1.0 / stretch]), cells
        report = odt_plugins.optimize_with_report(mesh, free=free, finish=False)[1]
        assert sum("metric='input'" in note for note in report.notes) == said
    _, report = odt_plugins.optimize_with_report(mesh, metric="input", finish=False)
    assert not report.notes
