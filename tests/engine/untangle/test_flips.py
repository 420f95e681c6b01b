"""Reconnections around inverted cells: what they take and make, and when they mend a mesh."""

from collections import Counter
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import random_delaunay

import odt_plugins
from odt_plugins.engine.untangle.flips import _Patch, alternatives, reconnected
from odt_plugins.mesh.simplex import SimplexMesh


def mesh_of(points, cells, regions=None, frozen=None):
    m = len(cells)
    return SimplexMesh(
        np.asarray(points, dtype=float), np.asarray(cells, dtype=np.int32),
        np.zeros(m, np.int32) if regions is None else np.asarray(regions, np.int32),
        np.zeros(len(points), bool), np.zeros(m, bool) if frozen is None else frozen)


def rim(cells):
    """Directed facets of some cells without those that two of them share."""
    found = set()
    for cell in cells:
        for i in range(len(cell)):
            facet = [v for j, v in enumerate(cell) if j != i]
            places = sorted(range(len(facet)), key=facet.__getitem__)
            odd = sum(x > y for x, y in combinations(places, 2)) + i
            key = tuple(sorted(facet))
            found ^= {(key, odd % 2)}
    twice = {key for key, odd in found if (key, 1 - odd) in found}
    return {(key, odd) for key, odd in found if key not in twice}


@given(d=st.sampled_from([2, 3]), seed=st.integers(0, 200))
def test_changes_keep_the_facets_around_them_and_make_no_facet_twice(d, seed):
    points, cells = random_delaunay(d, 6, seed)
    patch = _Patch(points, mesh_of(points, cells))
    whole = Counter(f for cell in patch.cells.values() for f in combinations(sorted(cell), d))
    seen = 0
    for number in range(len(cells)):
        for taken, made in patch.changes(number):
            seen += 1
            assert number in taken
            assert rim([patch.cells[i] for i in taken]) == rim(made)
            gone = Counter(f for i in taken for f in combinations(sorted(patch.cells[i]), d))
            count = Counter(f for cell in made for f in combinations(sorted(cell), d))
            assert all(n == 1 or whole[f] == gone[f] for f, n in count.items())
    assert seen


FLAT = np.array([[-1.0, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1]])
FLAT_CELLS = np.array([[0, 1, 2, 3], [0, 2, 3, 4], [1, 3, 2, 4]])
"""A flat cell at the surface, with the edge 0-1 on it and 2-3 under it."""

ARROW = np.array([[0.0, 0], [1, 0.2], [2, 0], [1, 1]])
ARROW_CELLS = np.array([[0, 1, 2], [0, 2, 3]])
"""A triangle turned by a vertex of the boundary that lies within the other one."""

CASES = {"space": (FLAT, FLAT_CELLS), "plane": (ARROW, ARROW_CELLS[:, [0, 1, 2]])}


@pytest.mark.parametrize("case", CASES)
def test_a_mesh_whose_vertices_are_all_on_the_boundary_is_mended(case):
    points, cells = CASES[case]
    found = odt_plugins.quality((points, cells))
    assert found.inverted > 0
    out, rows = odt_plugins.untangle((points, cells))
    assert np.array_equal(out, points)
    assert odt_plugins.quality((out, rows)).inverted == 0
    assert odt_plugins.quality((out, rows)).volume == pytest.approx(found.volume)
    labels = np.arange(len(cells))
    with pytest.raises(odt_plugins.TangledMeshError):
        odt_plugins.untangle((points, cells), regions=labels)


def test_cell_data_come_from_the_input_and_flips_are_counted():
    labels = np.full(len(FLAT_CELLS), 7)
    out = odt_plugins.untangle((FLAT, FLAT_CELLS, labels))
    assert len(out[1]) == 2
    assert out[2].tolist() == [7, 7]
    _, report = odt_plugins.optimize_with_report((FLAT, FLAT_CELLS, labels))
    assert report.untangled["flips"] == 1
    assert report.untangled["flat"] == 1
    assert len(report.cell_origin) == 2


def test_densities_of_cells_follow_the_flips():
    for density in ([1.0, 1.0, 2.0], np.ones(len(FLAT))):
        out = odt_plugins.optimize((FLAT, FLAT_CELLS), density=density)
        assert odt_plugins.quality(out).inverted == 0


@pytest.mark.parametrize("case", CASES)
def test_frozen_cells_stay(case):
    points, cells = CASES[case]
    frozen = np.zeros(len(cells), bool)
    frozen[-1] = True
    mesh = mesh_of(points, cells, frozen=frozen)
    bad = np.arange(len(cells)) == 0
    same, source, flips = reconnected(points, mesh, bad)
    assert flips == 0
    assert np.array_equal(same, cells)
    assert np.array_equal(source, np.arange(len(cells)))
    assert not list(alternatives(points, mesh, bad))
