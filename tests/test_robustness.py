"""The promise on many kinds of meshes: clustered, stretched, thin, needle-like, sliver-ridden."""

from __future__ import annotations

import numpy as np
import planar_meshes as pm
import pytest
import tet_meshes as tm
from scipy.spatial import Delaunay
from test_driver import assert_promise, measure, mesh_of, volumes

from odt_plugins.engine.driver import run
from odt_plugins.options import Options


def delaunay(points):
    """Delaunay cells of points, positive, flat ones left out."""
    cells = Delaunay(points).simplices
    return points, (pm if points.shape[1] == 2 else tm).oriented(points, cells)


def clustered(rng, dim):
    centers = rng.random((6, dim))
    return np.vstack([c + 10.0 ** rng.uniform(-4, -1) * rng.normal(size=(60, dim))
                      for c in centers])


def flattened(rng, dim, factor):
    points = rng.random((400, dim))
    points[:, -1] *= factor
    return points


def needles(rng, dim):
    points = rng.random((300, dim))
    points[:, 0] *= 50.0
    return points


def graded(rng, dim):
    return rng.random((400, dim)) ** 3


def lattice(rng, dim):
    axes = [np.arange(6.0)] * dim
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, dim)
    return points + 1e-3 * rng.uniform(-1, 1, points.shape)


def sphere_shell(rng, dim):
    points = rng.normal(size=(300, dim))
    points /= np.linalg.norm(points, axis=1)[:, None]
    return np.vstack([points, 0.5 * points[:100]])


CLOUDS = {
    "clustered": clustered,
    "thin plate": lambda rng, dim: flattened(rng, dim, 0.02),
    "very thin plate": lambda rng, dim: flattened(rng, dim, 1e-4),
    "needles": needles,
    "graded": graded,
    "lattice": lattice,
    "shell": sphere_shell,
}


@pytest.mark.parametrize("name", CLOUDS)
@pytest.mark.parametrize("seed", [1, 2])
def test_delaunay_of_hard_clouds(d, name, seed):
    points, cells = delaunay(CLOUDS[name](np.random.default_rng(seed), d))
    mesh = mesh_of(points, cells)
    assert_promise(mesh, run(mesh, Options()))


def pressed(points, cells, rng, angle):
    """Press interior vertices towards an opposite facet until cells are as flat as the angle."""
    interior = np.ones(len(points), dtype=bool)
    for facet, owners in tm.facets_of(cells).items():
        if len(owners) == 1:
            interior[list(facet)] = False
    points = points.copy()
    for c in rng.permutation(len(cells))[:40]:
        v = cells[c][interior[cells[c]]]
        if not v.size:
            continue
        base = points[cells[c][cells[c] != v[0]]].mean(axis=0)
        old = points[v[0]].copy()
        points[v[0]] = base + angle * (old - base)
        if (tm.signed_volumes(points, cells) <= 0).any():
            points[v[0]] = old
    return points


@pytest.mark.parametrize("angle", [1e-2, 2e-4])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_slivers_of_a_hundredth_of_a_degree(angle, seed):
    points, cells = tm.ball(300, seed)
    points = pressed(points, cells, np.random.default_rng(seed), angle)
    assert tm.dihedral_angles(points, cells).min() < 60 * angle + 0.5
    mesh = mesh_of(points, cells)
    outcome = run(mesh, Options())
    assert_promise(mesh, outcome)
    assert measure(outcome.points, outcome.cells)[2] > measure(points, cells)[2] + 0.05


@pytest.mark.parametrize("hole", [True, False])
@pytest.mark.parametrize("labels", [1, 2, 5])
def test_holes_and_regions(hole, labels):
    points, cells = tm.grid(5, 4, hole=hole)
    center = points[cells].mean(axis=1)
    regions = (np.floor(center[:, 0]) + np.floor(center[:, 1])).astype(np.int32) % labels
    mesh = mesh_of(points, cells, regions)
    assert_promise(mesh, run(mesh, Options()))


def test_random_labels_everywhere(d):
    rng = np.random.default_rng(5)
    points, cells = delaunay(rng.random((200, d)))
    mesh = mesh_of(points, cells, rng.integers(0, 3, len(cells)).astype(np.int32))
    assert_promise(mesh, run(mesh, Options()))


def test_two_parts_that_touch_in_a_vertex_or_an_edge():
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0],
                       [0.05, 0.1, 0.3], [0, -0.2, -1]], dtype=float)
    cells = tm.oriented(points, [[0, 1, 2, 6], [0, 1, 3, 6], [0, 2, 3, 6], [1, 2, 3, 6],
                                 [0, 4, 5, 7]])
    mesh = mesh_of(points, cells)
    outcome = run(mesh, Options())
    assert_promise(mesh, outcome)
    assert measure(outcome.points, outcome.cells)[2] > measure(points, cells)[2]


@pytest.mark.parametrize("scale", [1e-9, 1e9])
@pytest.mark.parametrize("shift", [0.0, 1e6])
def test_result_does_not_depend_on_unit_and_place(d, scale, shift):
    points, cells = delaunay(np.random.default_rng(3).random((200, d)))
    points = points.astype(np.float32).astype(float)
    here = run(mesh_of(points, cells), Options(rounds=3, finish=False))
    placed = points + shift
    if shift:
        points = placed - shift
        here = run(mesh_of(points, cells), Options(rounds=3, finish=False))
    there = run(mesh_of(placed * scale, cells), Options(rounds=3, finish=False))
    assert (volumes(there.points, there.cells) > 0).all()
    assert there.cells.tobytes() == here.cells.tobytes()
    assert there.points / scale - shift == pytest.approx(here.points, abs=1e-6 if shift else 1e-9)
