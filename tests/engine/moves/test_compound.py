"""Compound moves: what does not pay is taken back to the bit, what stays lowers the sum."""

from __future__ import annotations

import numpy as np
import pytest
import tet_meshes as tm
from complexes import OPEN, assert_sound, complex_of, contents, run_pass
from hypothesis import given
from hypothesis import strategies as st
from promises import assert_promise, mesh_of
from strategies import SEEDS

from odt_plugins.engine.cells.cost import Cost
from odt_plugins.engine.cells.measures import QUALITY
from odt_plugins.engine.finish.phases import Phase
from odt_plugins.engine.finish.volume import finish
from odt_plugins.engine.moves import compound
from odt_plugins.engine.moves.cavity import make_journal, make_ring, take_back
from odt_plugins.engine.moves.flips3d import flip_facet, remove_edge
from odt_plugins.engine.run.plan import run
from odt_plugins.engine.topology.tets import FREE
from odt_plugins.options import Options


@pytest.mark.usefixtures("kernels_in_python")
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


@pytest.mark.usefixtures("nothing_compiled")
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


@pytest.mark.parametrize("share", [0.5, np.nextafter(1.0, 0.0), 1.0])
def test_a_phase_may_start_from_all_cells_of_a_mesh_without_free_slots(share):
    points = np.array([[0, 0, 0], [1, 0, 0], [0.5, 1, 0], [0.5, 0.35, 0.05]])
    for cells in ([[0, 1, 2, 3]], tm.grid(1, 0)[1]):
        corners = points if len(cells) == 1 else tm.grid(1, 0)[0]
        mesh = complex_of(corners, np.array(cells, dtype=np.int32))
        assert mesh.slots[FREE] == 0
        finish(mesh, (Phase(2.0, share, 1, 1, 1),), OPEN, None, 1)
        assert_sound(mesh, mesh.points, tm.signed_volumes(corners, np.array(cells)).sum())


@given(SEEDS, st.integers(1, 4), st.integers(0, 60))
def test_small_components_beside_a_mesh_keep_the_promise(seed, loose, n):
    rng = np.random.default_rng(seed)
    parts = [tm.ball(n, seed)] if n >= 4 else []
    for k in range(loose):
        corners = rng.normal(size=(4, 3)) * [1.0, 1.0, 10.0 ** -rng.uniform(0, 2)]
        shift = np.array([4.0 * (k + 1), 0.0, 0.0])
        parts.append((corners + shift, np.arange(4)[None]))
    offsets = np.cumsum([0, *(len(points) for points, _ in parts)])
    points = np.concatenate([points for points, _ in parts])
    cells = tm.oriented(points, np.concatenate(
        [cells + start for (_, cells), start in zip(parts, offsets[:-1], strict=True)]))
    mesh = mesh_of(points, cells)
    assert_promise(mesh, run(mesh, Options()))
