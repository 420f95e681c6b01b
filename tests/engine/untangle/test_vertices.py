"""Vertices inserted around inverted cells: which cells they take, make and leave, and where."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import random_delaunay
from tangled_meshes import schoenhardt

from odt_plugins.engine.untangle.run import Wishes, untangled
from odt_plugins.engine.untangle.vertices import inserted
from odt_plugins.figures import volumes
from odt_plugins.mesh.facets import uneven_facets
from odt_plugins.mesh.simplex import SimplexMesh, cell_signs


def mesh_of(points, cells, regions=None, frozen=None):
    n, m = len(points), len(cells)
    return SimplexMesh(
        np.asarray(points, dtype=float), np.asarray(cells, dtype=np.int32),
        np.zeros(m, np.int32) if regions is None else np.asarray(regions, np.int32),
        np.zeros(n, bool), np.zeros(m, bool) if frozen is None else frozen)


def signs(points, cells):
    return cell_signs(points, np.asarray(cells, dtype=np.int32))[0]


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("turn", [0.1, 0.4, 0.8])
def test_a_prism_that_no_cells_of_its_vertices_fill_is_filled_from_one_inside(turn, unit):
    points, cells = schoenhardt(turn)
    points = unit * (points + np.array([3.0, -2.0, 1.0]))
    mesh = mesh_of(points, cells)
    assert untangled(mesh).bad.any()
    found = untangled(mesh, wishes=Wishes(insert=1))
    assert not found.bad.any()
    assert np.array_equal(found.points[:6], points)
    assert (found.points.shape, found.cells.shape) == ((7, 3), (8, 4))
    assert (found.cells == 6).any(axis=1).all()
    assert (signs(found.points, found.cells) > 0).all()
    total = volumes(points, cells).sum()
    assert volumes(found.points, found.cells).sum() == pytest.approx(total)


def test_as_many_vertices_come_as_may_and_one_for_each_place():
    """Three prisms apart from each other, of which two may be filled."""
    points, cells = schoenhardt()
    three = np.concatenate([points + 4.0 * i * np.eye(3)[0] for i in range(3)])
    mesh = mesh_of(three, np.concatenate([cells + 6 * i for i in range(3)]))
    for most in range(4):
        found = untangled(mesh, wishes=Wishes(insert=most))
        assert len(found.points) == 18 + most
        assert found.bad.sum() == 3 - most


def test_cavities_neither_cross_interfaces_nor_take_frozen_cells():
    points, cells = schoenhardt()
    bad = signs(points, cells) <= 0
    assert bad.sum() == 1
    assert inserted(points, mesh_of(points, cells), bad, 1) is not None
    assert inserted(points, mesh_of(points, cells, regions=range(4)), bad, 1) is None
    for one in range(4):
        frozen = np.arange(4) == one
        assert inserted(points, mesh_of(points, cells, frozen=frozen), bad, 1) is None


@given(d=st.sampled_from([2, 3]), seed=st.integers(0, 200), share=st.sampled_from([0.05, 0.3]))
def test_cells_of_a_cavity_fit_together_whatever_is_inverted(d, seed, share):
    """Vertices of a valid mesh moved at random: no vertex and no facet of the others is lost."""
    points, cells = random_delaunay(d, 5, seed)
    rng = np.random.default_rng(seed)
    moved = rng.random(len(points)) < share
    points = points + rng.normal(size=points.shape) * moved[:, None] * np.ptp(points) / 5
    mesh = mesh_of(points, cells)
    bad = signs(points, cells) <= 0
    found = inserted(points, mesh, bad, 100)
    if found is None:
        return
    k = len(found.points) - len(points)
    assert k >= 1
    assert np.array_equal(found.points[: len(points)], points)
    kept = (found.cells < len(points)).all(axis=1)
    assert np.array_equal(found.cells[kept], mesh.cells[found.source[kept]])
    assert set(found.cells.ravel().tolist()) >= set(mesh.cells.ravel().tolist())
    old, new = uneven_facets(mesh.cells, len(points)), uneven_facets(found.cells, len(found.points))
    assert len(new.crowded) == 0
    assert set(map(tuple, old.open.tolist())) == set(map(tuple, new.open.tolist()))
    now = signs(found.points, found.cells)
    assert (now[~kept] > 0).all()
    assert (now <= 0).sum() < bad.sum()
    assert volumes(found.points, found.cells).sum() == pytest.approx(volumes(points, cells).sum())


def test_a_cell_that_is_a_single_point_takes_no_vertex():
    points = np.zeros((5, 3))
    points[4] = 1.0
    mesh = mesh_of(points, [[0, 1, 2, 3], [0, 2, 1, 4]])
    assert inserted(points, mesh, np.array([True, False]), 1) is None
