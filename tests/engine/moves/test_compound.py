"""Compound moves: what does not pay is taken back to the bit, what stays lowers the sum."""

from __future__ import annotations

import numpy as np
import pytest
import tet_meshes as tm
from complexes import OPEN, assert_sound, complex_of, contents, run_pass

from odt_plugins.engine.cells.tetrahedron import QUALITY, Cost
from odt_plugins.engine.moves import compound
from odt_plugins.engine.moves.cavity import make_journal, make_ring, take_back
from odt_plugins.engine.moves.flips3d import flip_facet, remove_edge


@pytest.mark.parametrize("seed", [1, 2])
def test_the_journal_takes_every_flip_back(seed):
    points, cells = tm.ball(200, seed)
    mesh = complex_of(points, cells)
    before = contents(mesh)
    journal = make_journal(True, 1 << 14)
    ring = make_ring(np.empty(0), False)
    cost = Cost(QUALITY, 1.0)
    rng = np.random.default_rng(seed)
    done = 0
    for c in rng.permutation(len(cells)):
        if mesh.cells[c, 0] < 0:
            continue
        op = int(rng.integers(10))
        if op < 6:
            _, n_new = remove_edge(mesh.tets, c, op, cost, 10, OPEN, np.inf, ring, journal)
        else:
            _, n_new = flip_facet(mesh.tets, c, op - 6, cost, OPEN, np.inf, ring, journal)
        done += n_new > 0
        if done == 40:
            break
    assert done == 40
    assert contents(mesh) != before
    assert_sound(mesh, points, tm.signed_volumes(points, cells).sum())
    take_back(mesh.tets, journal)
    assert contents(mesh) == before


@pytest.mark.parametrize("seed", [4, 5, 6])
def test_what_stays_lowers_the_sum_and_locked_vertices_stay(seed):
    points, cells = tm.ball(300, seed)
    mesh = complex_of(points, cells)
    volume = tm.signed_volumes(points, cells).sum()
    last = float(tm.cost(points, cells, 4.0).sum())
    taken = run_pass(mesh)
    assert taken > 5
    after = mesh.mesh_arrays()[0]
    assert float(tm.cost(mesh.points, after, 4.0).sum()) < last
    assert_sound(mesh, mesh.points, volume)
    assert np.array_equal(mesh.points[mesh.locked], points[mesh.locked])


def test_a_pass_without_success_leaves_the_mesh_as_it_was():
    points, cells = tm.ball(200, 9)
    mesh = complex_of(points, cells)
    for _ in range(50):
        before = contents(mesh)
        if run_pass(mesh) == 0:
            break
        assert contents(mesh) != before
    else:
        pytest.fail("compound moves did not end")
    assert contents(mesh) == before


def test_star_is_gathered_over_facets():
    points, cells = tm.ball(100, 3)
    mesh = complex_of(points, cells)
    star = np.empty(128, dtype=np.int32)
    for v in range(0, len(points), 7):
        holders = np.flatnonzero((cells == v).any(axis=1))
        size = compound.gather_star(mesh.cells, mesh.neighbors, holders[-1], v, star)
        assert np.array_equal(np.sort(star[:size]), holders)
    assert compound.gather_star(mesh.cells, mesh.neighbors, holders[0], v, star[:2]) == 0


def test_cells_that_were_tried_are_passed_over_until_something_changes_near_them():
    points, cells = tm.ball(300, 4)
    mesh = complex_of(points, cells)
    tried = np.zeros(len(mesh.cells), dtype=bool)
    assert run_pass(mesh, tried=tried) > 0
    while run_pass(mesh, tried=tried):
        pass
    assert tried[mesh.live()].sum() >= 60
    before = contents(mesh)
    tried[:] = True
    assert run_pass(mesh, tried=tried) == 0
    assert contents(mesh) == before
